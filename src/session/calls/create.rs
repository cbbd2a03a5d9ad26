//! Opens sessions: checks what can be checked for nothing, takes a seat and memory, builds the engine, starts the task.

use crate::asset::{self, FileSet};
use crate::engine::{self, HandleSet, OpenOptions, digest};
use crate::exec::Exec;
use crate::session::animation::open_animations::OpenAnimations;
use crate::session::answers::{CallKey, SessionFacts, Tenant};
use crate::session::calls::command::StoredAnswer;
use crate::session::calls::idempotency::{ClaimOutcome, KeyClaim, RequestFingerprint};
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::memory_ledger::MemoryReservation;
use crate::session::capacity::memory_use::MemoryUse;
use crate::session::capacity::session_lease::SessionLease;
use crate::session::capacity::work_watch::{CancelOnDrop, WorkWatch};
use crate::session::engine::Engine;
use crate::session::error::{Error, ErrorCode};
use crate::session::history::commit_history::CommitHistory;
use crate::session::history::loaded_deformer::LoadedDeformer;
use crate::session::history::session_state::EditedState;
use crate::session::keeping::kept_session::KeptSession;
use crate::session::keeping::made_room::make_room;
use crate::session::keeping::residence::Residence;
use crate::session::registry::{OpenSession, OpenStreams, SessionView};
use crate::session::shared::SharedResources;
use crate::session::store::{NewCommit, NewSession};
use crate::session::task::session_task::SessionTask;
use crate::wire::SessionOptions;
use crate::wire::record::{FileReferences, LoggedCommit, RecordedModel};
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::{Arc, OnceLock, RwLock};
use std::time::{Duration, Instant};
use tokio::sync::{Notify, OwnedSemaphorePermit, mpsc};
use tokio_util::sync::CancellationToken;

/// Bytes that a build is expected to need for each uploaded byte, until its real size is known.
const BYTES_PER_UPLOADED_BYTE: u64 = 32;
/// Bytes below which no build is tried.
const LEAST_BYTES: u64 = 1 << 20;

/// See [`super::Manager::create`].
///
/// # Cancel safety
/// Dropping the future stops the build; nothing exists then.
pub(in crate::session) async fn create_session(
    shared: &Arc<SharedResources>,
    tenant: &Tenant,
    files: FileSet,
    options: SessionOptions,
    key: Option<CallKey>,
) -> Result<CreatedSession, Error> {
    if shared.draining.load(SeqCst) {
        return Err(Error::draining());
    }
    let upload = files.total_bytes();
    if upload > shared.config.upload_bytes {
        let text = format!(
            "the upload is {upload} bytes, at most {} are allowed",
            shared.config.upload_bytes
        );
        return Err(Error::new(ErrorCode::TooLarge, text));
    }
    let inside = shared.gate.enter();
    let claim = match claim_key(shared, tenant, &files, key).await? {
        Some(ClaimOutcome::Done(answer)) => return Ok(CreatedSession::Before(answer)),
        Some(ClaimOutcome::New(claim)) => Some(claim),
        None => None,
    };
    let arrived = Instant::now();
    let (seat, memory) = reserve_place(shared, upload).await?;
    let guard = CancelOnDrop::default();
    let SessionOptions { open, label, ttl } = options;
    let kept_files = shared.store.is_some().then(|| (files.clone(), open.clone()));
    let opened = open_model(shared, &memory, (files, open), arrived, &guard).await?;
    if !memory.resize(opened.held) {
        let used = shared.ledger.used().saturating_sub(opened.held);
        shared.compute.discard(opened.deformer);
        let text = format!("the session needs {} bytes and {used} are in use", opened.held);
        return Err(refuse(shared, text));
    }
    let owner = SessionOwner {
        id: new_id()?,
        number: shared.numbers.fetch_add(1, SeqCst),
        tenant: tenant.clone(),
        label,
        ttl: ttl.unwrap_or(shared.config.default_ttl),
    };
    let kept = match (&shared.store, kept_files) {
        (Some(store), Some((files, open))) => {
            let new = new_session(&owner, (files, open), &opened, claim.as_ref().map(KeyClaim::logged));
            let kept = KeptSession::new(Arc::clone(store));
            store.create(kept.first_of(new)).await.inspect_err(|error| {
                shared.metrics.store_failures.inc();
                tracing::error!("a session could not be stored: {error}");
            })?;
            Some(kept)
        }
        _ => None,
    };
    let session = start_session(shared, owner, opened, (memory, seat), kept);
    shared.metrics.sessions_created.inc();
    // An abort that began meanwhile may have missed this session.
    if shared.aborted.is_cancelled() {
        session.close(Error::draining());
        return Err(Error::draining());
    }
    let value = session.describe();
    if let Some(claim) = claim {
        let stored = StoredAnswer::Session(Box::new(value.clone()));
        let bytes = stored.byte_size();
        claim.complete(stored, bytes);
    }
    tracing::info!(session.id = %session.id, size_bytes = upload, "session opened");
    drop(inside);
    Ok(CreatedSession::Now(Box::new(value)))
}

/// A session that was created, now or by an earlier call with the same key, whose answer is kept.
pub(in crate::session) enum CreatedSession {
    Now(Box<SessionFacts>),
    Before(StoredAnswer),
}

/// Claims the key of a creation; its request is the model too, which may be large.
async fn claim_key(
    shared: &Arc<SharedResources>,
    tenant: &Tenant,
    files: &FileSet,
    key: Option<CallKey>,
) -> Result<Option<ClaimOutcome<StoredAnswer>>, Error> {
    let Some(CallKey { key, request }) = key else {
        return Ok(None);
    };
    let files = files.clone();
    let fingerprint = shared.compute.offload(move || fingerprint(&files, &request)).await?;
    shared.idempotency.claim(tenant, &key, fingerprint).map(Some)
}

/// Counts a session that finds no place, and says why.
fn refuse(shared: &SharedResources, text: String) -> Error {
    shared.metrics.refused.inc();
    Error::exhausted(text, 5)
}

/// Takes a seat, and the memory that a model of `upload` bytes is likely to need. Idle sessions that are kept make room for it.
pub(in crate::session) async fn reserve_place(
    shared: &SharedResources,
    upload: u64,
) -> Result<(OwnedSemaphorePermit, Arc<MemoryReservation>), Error> {
    loop {
        match take_place(shared, upload) {
            Err(error) if !make_room(shared).await => return Err(error),
            Err(_) => {}
            place => return place,
        }
    }
}

fn take_place(shared: &SharedResources, upload: u64) -> Result<(OwnedSemaphorePermit, Arc<MemoryReservation>), Error> {
    let seat = Arc::clone(&shared.seats).try_acquire_owned().map_err(|_| {
        let text = format!(
            "{} sessions are open, no more are allowed; delete one or wait for one to expire",
            shared.config.sessions
        );
        refuse(shared, text)
    })?;
    let likely = upload
        .saturating_mul(BYTES_PER_UPLOADED_BYTE)
        .saturating_add(LEAST_BYTES);
    let memory = shared
        .ledger
        .reserve(MemoryUse::Sessions, LEAST_BYTES.max(upload), likely);
    let memory = memory.ok_or_else(|| {
        let used = shared.ledger.used();
        refuse(
            shared,
            format!("{used} bytes of memory are in use, no more sessions fit"),
        )
    })?;
    Ok((seat, Arc::new(memory)))
}

/// Which session it is, whose, and for how long.
pub(in crate::session) struct SessionOwner {
    pub id: String,
    /// Sessions are numbered in the order of their creation.
    pub number: u64,
    pub tenant: Tenant,
    pub label: String,
    pub ttl: Duration,
}

/// A session as its store keeps it.
fn new_session(
    owner: &SessionOwner,
    (files, options): (FileSet, OpenOptions),
    opened: &OpenedModel,
    key: Option<(Tenant, String, u128)>,
) -> NewSession {
    let state = opened.history.current();
    NewSession {
        id: owner.id.clone(),
        tenant: owner.tenant.clone(),
        number: owner.number,
        ttl: owner.ttl,
        model: RecordedModel {
            files: FileReferences::default(),
            options,
            label: owner.label.clone(),
            format: opened.deformer.engine.format(),
        },
        files,
        first: NewCommit {
            session: owner.id.clone(),
            sequence: 0,
            revision: opened.history.revision(),
            digest: state.digest.clone(),
            build: String::new(),
            facts_at: 0,
            poses_at: 0,
            commit: LoggedCommit::Create {
                facts: (*state.facts).clone(),
            },
            files: None,
            key,
        },
    }
}

/// Registers a session on an opened model and starts its task.
pub(in crate::session) fn start_session(
    shared: &Arc<SharedResources>,
    owner: SessionOwner,
    opened: OpenedModel,
    (memory, seat): (Arc<MemoryReservation>, OwnedSemaphorePermit),
    kept: Option<KeptSession>,
) -> Arc<OpenSession> {
    let OpenedModel {
        deformer,
        history,
        build_ms,
        ..
    } = opened;
    let state = history.current();
    let view = SessionView {
        revision: history.revision(),
        facts: Arc::clone(&state.facts),
        handles: Arc::clone(&state.handles),
        poses: state.poses.clone(),
        build_ms: build_ms.clone(),
        positions: deformer.engine.rest_shape().positions,
        digest: state.digest.clone(),
        history: history.show(),
    };
    let (send, commands) = mpsc::channel(shared.config.session_queue);
    let session = Arc::new(OpenSession {
        id: owner.id,
        tenant: owner.tenant,
        number: owner.number,
        label: owner.label,
        format: deformer.engine.format(),
        lease: SessionLease::new(owner.ttl),
        commands: send,
        streams: OpenStreams::new(&shared.config),
        animations: OpenAnimations::default(),
        wake: Arc::new(Notify::new()),
        cancel: Arc::default(),
        closing: CancellationToken::new(),
        ended: CancellationToken::new(),
        view: RwLock::new(Arc::new(view)),
        why: OnceLock::new(),
        leave: AtomicBool::new(false),
        unloaded: AtomicBool::new(false),
        busy: AtomicBool::new(false),
    });
    shared.registry.insert(Arc::clone(&session));
    shared.metrics.sessions.inc();
    let mut task = SessionTask {
        session: Arc::clone(&session),
        shared: Arc::clone(shared),
        commands,
        deformer: Some(deformer),
        history,
        build_ms,
        memory,
        seat,
        next_stream: 0,
        kept,
        residence: Residence::Whole,
    };
    task.publish_view();
    tokio::spawn(task.run());
    session
}

/// A model, opened, with its history.
pub(in crate::session) struct OpenedModel {
    pub deformer: LoadedDeformer,
    pub history: CommitHistory,
    pub build_ms: std::collections::BTreeMap<String, f64>,
    pub held: u64,
}

/// Builds the engine on the compute pool.
pub(in crate::session) async fn open_model(
    shared: &Arc<SharedResources>,
    memory: &Arc<MemoryReservation>,
    (files, options): (FileSet, OpenOptions),
    arrived: Instant,
    guard: &CancelOnDrop,
) -> Result<OpenedModel, Error> {
    let slot = tokio::select! {
        biased;
        () = shared.aborted.cancelled() => return Err(Error::draining()),
        slot = shared.compute.slot(WorkLane::Builds, arrived) => slot?,
    };
    let config = &shared.config;
    let room = memory.room();
    let limits = config.deformer_limits(room);
    let flags = vec![Arc::clone(&guard.0), Arc::clone(&shared.abort_flag)];
    let watch = Arc::new(WorkWatch::since(arrived, flags, config.build).within(Arc::clone(memory)));
    let (inner_watch, inside) = (Arc::clone(&watch), Arc::clone(shared));
    let built = slot.run(move |pool| -> Result<OpenedModel, engine::Error> {
        crate::progress::check(&*inner_watch)?;
        let engine: Box<dyn Engine> = inside
            .opener
            .open(files, &options, &limits, &Exec::new(pool, &*inner_watch))?;
        let build_ms = inner_watch.take_stage_ms();
        let rest = engine.rest_shape();
        let state = EditedState {
            topology: engine.topology_state(),
            diagonal: engine.diagonal(),
            handles: HandleSet::default(),
            poses: engine.initial_poses(),
            facts: engine.facts(),
            digest: digest(&rest.positions),
            solved_with: None,
        };
        let config = &inside.config;
        let history = CommitHistory::new(state, rest, config.history, config.snapshot_bytes);
        let deformer = LoadedDeformer::new(engine, history.current().handles.id);
        let held = deformer.byte_size().saturating_add(history.byte_size());
        Ok(OpenedModel {
            deformer,
            history,
            build_ms,
            held,
        })
    });
    let built = built.await.map_err(|panicked| {
        tracing::error!(panic = panicked.0, "opening a model panicked");
        Error::from(panicked)
    })?;
    shared.metrics.build.observe(watch.elapsed().as_secs_f64());
    built.map_err(|error| match error {
        engine::Error::Cancelled if shared.aborted.is_cancelled() => Error::draining(),
        engine::Error::Cancelled if watch.abandoned() => Error::new(ErrorCode::Cancelled, "the caller gave up"),
        engine::Error::Cancelled => build_took_too_long(watch.limit()),
        // Too large for what is free now, not for the server: later it may fit.
        engine::Error::TooLarge { seen, limit, .. }
        | engine::Error::Asset(asset::Error::TooLarge { seen, limit, .. })
            if limit == room && seen <= shared.ledger.total() =>
        {
            let text = format!("the session would need {seen} bytes of memory, {room} are free");
            refuse(shared, text)
        }
        error => error.into(),
    })
}

fn build_took_too_long(limit: Duration) -> Error {
    let text = format!(
        "building the session took longer than the {} ms that are allowed",
        limit.as_millis()
    );
    Error::new(ErrorCode::DeadlineExceeded, text)
}

fn fingerprint(files: &FileSet, options: &[u8]) -> RequestFingerprint {
    let mut parts: Vec<&[u8]> = vec![options, files.name.as_bytes(), &files.main];
    for (uri, bytes) in &files.companions {
        parts.extend([uri.as_bytes(), bytes]);
    }
    RequestFingerprint::of("create", &parts)
}

/// 128 random bits as 32 hexadecimal digits.
fn new_id() -> Result<String, Error> {
    let mut bytes = [0u8; 16];
    getrandom::fill(&mut bytes).map_err(|e| Error::new(ErrorCode::Internal, format!("no random numbers: {e}")))?;
    Ok(format!("{:032x}", u128::from_be_bytes(bytes)))
}
