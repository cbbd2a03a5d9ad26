//! Opens sessions: checks what can be checked for nothing, takes a seat and memory, builds the engine, starts the task.

use super::actor::Actor;
use super::bench::Bench;
use super::budget::Reservation;
use super::commits::History;
use super::expiry::Lease;
use super::idempotency::{Claimed, Fingerprint};
use super::manager::Shared;
use super::registry::{Session, Streams, View};
use super::requests::Stored;
use super::stop::{CancelOnDrop, Stop};
use super::{Answer, Code, Engine, Error, Tenant};
use crate::asset::FileSet;
use crate::engine::digest;
use crate::exec::Exec;
use crate::wire;
use crate::wire::pb;
use prost::Message as _;
use std::sync::atomic::Ordering::SeqCst;
use std::sync::{Arc, OnceLock, RwLock};
use std::time::Duration;
use tokio::sync::{Notify, mpsc};
use tokio_util::sync::CancellationToken;

/// Bytes that a build is expected to need for each uploaded byte, until its real size is known.
const BYTES_PER_UPLOADED_BYTE: u64 = 32;
/// Bytes below which no build is tried.
const LEAST_BYTES: u64 = 1 << 20;

/// See [`super::Manager::create`].
///
/// # Cancel safety
/// Dropping the future stops the build; nothing exists then.
pub(super) async fn create(
    shared: &Arc<Shared>,
    tenant: &Tenant,
    files: FileSet,
    options: pb::CreateOptions,
    key: Option<&str>,
) -> Result<Answer<pb::Session>, Error> {
    if shared.draining.load(SeqCst) {
        return Err(Error::draining());
    }
    let config = &shared.config;
    let upload = files.total_bytes();
    if upload > config.upload_bytes {
        let text = format!(
            "the upload is {upload} bytes, at most {} are allowed",
            config.upload_bytes
        );
        return Err(Error::new(Code::TooLarge, text));
    }
    if options.label.len() > 256 {
        let text = format!("is {} bytes, at most 256 are allowed", options.label.len());
        return Err(Error::invalid("label", text));
    }
    let ttl = config.ttl(&options.ttl)?;
    let inside = shared.gate.enter();
    let claim = match key {
        None => None,
        Some(key) => {
            let (named, made) = (files.clone(), options.encode_to_vec());
            let fingerprint = shared.compute.offload(move || fingerprint(&named, &made)).await?;
            match shared.idempotency.claim(tenant, key, fingerprint)? {
                Claimed::Done(Stored::Session(value)) => {
                    return Ok(Answer {
                        value: *value,
                        repeated: true,
                    });
                }
                Claimed::Done(_) => return Err(Error::new(Code::Internal, "the kept answer is of another call")),
                Claimed::New(claim) => Some(claim),
            }
        }
    };
    let refuse = |text: String| {
        shared.metrics.refused.inc();
        Error::exhausted(text, 5)
    };
    let seat = Arc::clone(&shared.seats).try_acquire_owned().map_err(|_| {
        refuse(format!(
            "{} sessions are open, no more are allowed; delete one or wait for one to expire",
            config.sessions
        ))
    })?;
    let likely = upload
        .saturating_mul(BYTES_PER_UPLOADED_BYTE)
        .saturating_add(LEAST_BYTES);
    let mut memory = shared.budget.reserve(LEAST_BYTES, likely).ok_or_else(|| {
        refuse(format!(
            "{} bytes of memory are in use, no more sessions fit",
            shared.budget.used()
        ))
    })?;

    let guard = CancelOnDrop::default();
    let opened = open(shared, &memory, files, options.clone(), &guard).await?;
    let Opened {
        bench,
        facts,
        history,
        build_ms,
        held,
    } = opened;
    if !memory.resize(held) {
        shared.compute.discard(bench);
        return Err(refuse(format!(
            "the session needs {held} bytes and {} are in use",
            shared.budget.used() - held
        )));
    }
    let positions = bench.engine.rest();
    let (send, commands) = mpsc::channel(config.session_queue);
    let session = Arc::new(Session {
        id: new_id()?,
        tenant: tenant.clone(),
        number: shared.numbers.fetch_add(1, SeqCst),
        label: options.label,
        format: bench.engine.format(),
        limits: config.limits(),
        lease: Lease::new(ttl),
        commands: send,
        streams: Streams::new(config),
        wake: Arc::new(Notify::new()),
        cancel: Arc::default(),
        closing: CancellationToken::new(),
        ended: CancellationToken::new(),
        view: RwLock::new(Arc::new(View {
            revision: history.revision(),
            facts: Arc::new(facts),
            poses: history.current().poses.clone(),
            build_ms: build_ms.clone(),
            positions,
            digest: history.current().digest.clone(),
            history: history.describe(),
        })),
        why: OnceLock::new(),
    });
    shared.registry.insert(Arc::clone(&session));
    shared.metrics.sessions.inc();
    shared.metrics.sessions_created.inc();
    let actor = Actor {
        session: Arc::clone(&session),
        shared: Arc::clone(shared),
        commands,
        bench: Some(bench),
        history,
        build_ms,
        memory,
        seat,
        turn: 0,
    };
    tokio::spawn(actor.run());
    // An abort that began meanwhile may have missed this session.
    if shared.aborted.is_cancelled() {
        session.close(Error::draining());
        return Err(Error::draining());
    }
    let value = session.describe();
    if let Some(claim) = claim {
        let stored = Stored::Session(Box::new(value.clone()));
        let bytes = stored.bytes();
        claim.complete(stored, bytes);
    }
    tracing::info!(session.id = %session.id, size_bytes = upload, "session opened");
    drop(inside);
    Ok(Answer { value, repeated: false })
}

struct Opened {
    bench: Bench,
    facts: pb::Session,
    history: History,
    build_ms: std::collections::BTreeMap<String, f64>,
    held: u64,
}

/// Builds the engine on the compute pool.
async fn open(
    shared: &Arc<Shared>,
    memory: &Reservation,
    files: FileSet,
    options: pb::CreateOptions,
    guard: &CancelOnDrop,
) -> Result<Opened, Error> {
    let slot = tokio::select! {
        biased;
        () = shared.aborted.cancelled() => return Err(Error::draining()),
        slot = shared.compute.slot() => slot?,
    };
    let config = &shared.config;
    let room = memory.room();
    let limits = config.bench_limits(room);
    let stop = Arc::new(Stop::new(
        vec![Arc::clone(&guard.0), Arc::clone(&shared.abort_flag)],
        config.build,
    ));
    let (watch, inside) = (Arc::clone(&stop), Arc::clone(shared));
    let built = slot.run(move |pool| -> Result<Opened, wire::Error> {
        crate::progress::check(&*watch)?;
        let engine: Box<dyn Engine> = inside
            .opener
            .open(files, &options, &limits, &Exec::new(pool, &*watch))?;
        let build_ms = watch.take_stage_ms();
        let facts = engine.facts();
        let rest = engine.rest();
        let digest = digest(&rest);
        let config = &inside.config;
        let history = History::new(
            facts.clone(),
            engine.initial_poses(),
            rest,
            digest,
            (engine.trail(), engine.diagonal()),
            config.history,
            config.snapshot_bytes,
        );
        let bench = Bench::new(engine, Arc::clone(&history.current().handles));
        let held = bench.bytes().saturating_add(history.bytes());
        Ok(Opened {
            bench,
            facts,
            history,
            build_ms,
            held,
        })
    });
    let built = built.await.map_err(|panicked| {
        tracing::error!(panic = panicked.0, "opening a model panicked");
        Error::from(panicked)
    })?;
    shared.metrics.build.observe(stop.elapsed().as_secs_f64());
    built.map_err(|error| match error {
        wire::Error::Cancelled if shared.aborted.is_cancelled() => Error::draining(),
        wire::Error::Cancelled if stop.abandoned() => Error::new(Code::Cancelled, "the caller gave up"),
        wire::Error::Cancelled => late(stop.limit()),
        // Too large for what is free now, not for the server: later it may fit.
        wire::Error::TooLarge { seen, limit, .. } if limit == room && seen <= shared.budget.total() => {
            shared.metrics.refused.inc();
            Error::exhausted(
                format!("the session would need {seen} bytes of memory, {room} are free"),
                5,
            )
        }
        error => error.into(),
    })
}

fn late(limit: Duration) -> Error {
    let text = format!(
        "building the session took longer than the {} ms that are allowed",
        limit.as_millis()
    );
    Error::new(Code::DeadlineExceeded, text)
}

fn fingerprint(files: &FileSet, options: &[u8]) -> Fingerprint {
    let mut parts: Vec<&[u8]> = vec![options, files.name.as_bytes(), &files.main];
    for (uri, bytes) in &files.companions {
        parts.extend([uri.as_bytes(), bytes]);
    }
    Fingerprint::of("create", &parts)
}

/// 128 random bits as 32 hexadecimal digits.
fn new_id() -> Result<String, Error> {
    let mut bytes = [0u8; 16];
    getrandom::fill(&mut bytes).map_err(|e| Error::new(Code::Internal, format!("no random numbers: {e}")))?;
    Ok(format!("{:032x}", u128::from_be_bytes(bytes)))
}
