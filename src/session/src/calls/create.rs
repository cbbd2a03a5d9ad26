//! Opens sessions: checks what can be checked for nothing, takes a permit and memory, builds the engine, starts the task.

use crate::answers::{CallKey, Tenant};
use crate::audit::audit_entry::{AuditEntry, AuditedAction};
use crate::calls::command::StoredAnswer;
use crate::calls::idempotency::{ClaimOutcome, KeyClaim, RequestFingerprint};
use crate::calls::model_opening::{ModelToOpen, OpenedModel, open_model};
use crate::calls::model_opening::{SessionPlaces, place_of_tenant};
use crate::calls::shared_keys::claim_everywhere;
use crate::capacity::call_queue::CallQueue;
use crate::capacity::call_queue::SessionLease;
use crate::capacity::work_watch::CancelOnDrop;
use crate::error::{Error, ErrorCode};
use crate::keeping::kept_session::KeptSession;
use crate::keeping::kept_session::MemoryState;
use crate::registry::{OpenAnimations, OpenSession, OpenStreams};
use crate::shared::SharedResources;
use crate::store::{Commit, Generation, HeldSession, NewCommit, NewSession, SessionRecord};
use crate::task::session_task::{SessionTask, view_of};
use pliant_asset::FileSet;
use pliant_wire::record::{FileReferences, LoggedCommit, RecordedModel};
use pliant_wire::{SessionOptions, pb};
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::{Arc, Mutex, OnceLock, RwLock};
use std::time::{Duration, Instant};
use tokio::sync::{Notify, mpsc};
use tokio_util::sync::CancellationToken;

/// See [`super::Manager::create`].
///
/// # Cancel safety
/// Dropping the future stops the build; nothing exists then.
pub(crate) async fn create_session(
    shared: &Arc<SharedResources>,
    tenant: &Tenant,
    who: &Arc<str>,
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
    let of_tenant = place_of_tenant(shared, tenant, upload).await?;
    let mut places = SessionPlaces::reserve(shared, of_tenant, upload).await?;
    let guard = CancelOnDrop::default();
    let SessionOptions {
        open,
        create,
        label,
        ttl,
    } = options;
    let kept_files = shared.store.is_some().then(|| files.clone());
    let model = ModelToOpen {
        files,
        options: open,
        graph_bytes: None,
    };
    let opened = open_model(shared, &places, model, arrived, &guard).await?;
    let record = SessionRecord {
        id: format!("{:032x}", shared.surroundings.random()?),
        number: next_number(shared).await?,
        tenant: tenant.clone(),
        label,
        created_ms: shared.surroundings.now_ms(),
        ttl: ttl.unwrap_or_else(|| default_ttl(shared, &places)),
    };
    let mut generation = Generation::default();
    let audit = AuditEntry {
        tenant: tenant.clone(),
        who: Arc::clone(who),
        what: AuditedAction::Create,
        session: record.id.clone(),
    };
    let kept = match (&shared.store, kept_files) {
        (Some(store), Some(files)) => {
            let key = claim.as_ref().map(KeyClaim::logged);
            let new = new_session(&record, files, create, &opened, key, audit);
            let kept = KeptSession::new(Arc::clone(store));
            generation = store.create(kept.first_of(new)).await.inspect_err(|error| {
                shared.metrics.store_failures.inc();
                tracing::error!("a session could not be stored: {error}");
            })?;
            places.of_tenant.outlive();
            Some(kept)
        }
        _ => {
            audit.log();
            None
        }
    };
    let session = start_session(shared, record, generation, opened, places, kept);
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

/// The number of a new session: the next one of all nodes, where there are several.
async fn next_number(shared: &SharedResources) -> Result<u64, Error> {
    match shared.store.as_ref().and_then(|store| store.ownership()) {
        Some(ownership) => Ok(ownership.next_number().await?),
        None => Ok(shared.numbers.fetch_add(1, SeqCst)),
    }
}

/// How long a session of its tenant lives that names no time.
fn default_ttl(shared: &SharedResources, places: &SessionPlaces) -> Duration {
    let quota = places.of_tenant.account().quota();
    let ttl = quota.ttl.unwrap_or(shared.config.default_ttl);
    quota.max_ttl.map_or(ttl, |longest| ttl.min(longest))
}

/// A session that was created, now or by an earlier call with the same key, whose answer is kept.
pub(crate) enum CreatedSession {
    Now(Box<pb::Session>),
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
    claim_everywhere(shared, tenant, &key, fingerprint).await.map(Some)
}

/// A session as its store keeps it.
fn new_session(
    record: &SessionRecord,
    files: FileSet,
    options: pb::CreateOptions,
    opened: &OpenedModel,
    key: Option<(Tenant, String, u128)>,
    audit: AuditEntry,
) -> NewSession {
    let state = opened.history.current();
    NewSession {
        record: record.clone(),
        model: RecordedModel {
            files: FileReferences::default(),
            options,
            of_today: true,
            loose_vertices_ride: true,
            near_origin: true,
            every_cut_ends_lines: true,
            riders_keep_sides: true,
            follows_edits: true,
            local_fields: true,
            label: record.label.clone(),
            format: opened.deformer.engine.format(),
            graph_bytes: Some(opened.graph_bytes),
        },
        files,
        first: NewCommit {
            session: HeldSession {
                id: record.id.clone(),
                generation: Generation::default(),
            },
            commit: Commit {
                sequence: 0,
                revision: opened.history.revision(),
                digest: state.digest.clone(),
                build: String::new(),
                facts_at: 0,
                poses_at: 0,
                record: LoggedCommit::Create {
                    facts: Box::new((*state.facts).clone()),
                },
            },
            files: None,
            key,
            audit,
        },
    }
}

/// Registers a session on an opened model and starts its task.
pub(crate) fn start_session(
    shared: &Arc<SharedResources>,
    record: SessionRecord,
    generation: Generation,
    opened: OpenedModel,
    places: SessionPlaces,
    kept: Option<KeptSession>,
) -> Arc<OpenSession> {
    let OpenedModel {
        deformer,
        history,
        build_ms,
        ..
    } = opened;
    let view = view_of(&history, &build_ms);
    let (send, commands) = mpsc::channel(shared.config.session_queue);
    let session = Arc::new(OpenSession {
        held: HeldSession {
            id: record.id.clone(),
            generation,
        },
        id: record.id,
        tenant: record.tenant,
        number: record.number,
        label: record.label,
        created_ms: record.created_ms,
        format: deformer.engine.format(),
        lease: SessionLease::new(record.ttl),
        commands: send,
        streams: OpenStreams::new(&shared.config),
        animations: OpenAnimations::default(),
        wake: Arc::new(Notify::new()),
        cancel: Arc::default(),
        closing: CancellationToken::new(),
        ended: CancellationToken::new(),
        line: CallQueue::default(),
        view: RwLock::new(Arc::new(view)),
        why: OnceLock::new(),
        leave: AtomicBool::new(false),
        unloaded: AtomicBool::new(false),
        busy: AtomicBool::new(false),
        work: Mutex::default(),
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
        memory: places.memory,
        place: places.of_tenant,
        session_permit: places.session_permit,
        next_stream: 0,
        kept,
        memory_state: MemoryState::Full,
        adopted_parts: None,
        acting: "pliant".into(),
    };
    task.publish_view();
    tokio::spawn(task.run());
    session
}

fn fingerprint(files: &FileSet, options: &[u8]) -> RequestFingerprint {
    let mut parts: Vec<&[u8]> = vec![options, files.name.as_bytes(), &files.main];
    for (uri, bytes) in &files.companions {
        parts.extend([uri.as_bytes(), bytes]);
    }
    RequestFingerprint::of("create", &parts)
}
