//! A session that is not in memory comes back from its store.

use crate::answers::Tenant;
use crate::calls::create::start_session;
use crate::calls::model_opening::{
    ModelToOpen, OpenedModel, OpeningRefusal, SessionPlaces, count_refusal, no_place, open_model, opening_stopped,
    run_opening,
};
use crate::capacity::work_watch::{CancelOnDrop, WorkKind, WorkWatch};
use crate::error::{Error, ErrorCode};
use crate::keeping::kept_session::KeptSession;
use crate::keeping::replay::{Replay, ReplayError, ReplayedLog};
use crate::keeping::sweep::evict_idle;
use crate::registry::OpenSession;
use crate::shared::SharedResources;
use crate::store::{Generation, HeldSession, SessionClaim, Store, StoreError, StoredSession, millis, read_shape};
use pliant_asset::FileSet;
use pliant_core::engine;
use pliant_exec::Exec;
use pliant_wire::record::{FileReferences, LoggedCommit};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use std::time::{Duration, Instant};

/// How long a node that is about to stop may take to give a session back.
const GIVEN_BACK_WITHIN: Duration = Duration::from_secs(3);
/// Between two checks of that.
const BETWEEN_LOOKS: Duration = Duration::from_millis(25);

/// Opens a stored session, or finds it when another call has opened it.
///
/// # Errors
/// `NOT_FOUND`; `UNAVAILABLE` when the store does not answer, `DATA_LOSS` when what it holds is damaged; errors of
/// opening any session.
pub(crate) async fn reopen_session(
    shared: &Arc<SharedResources>,
    store: &Arc<Store>,
    tenant: &Tenant,
    id: &str,
) -> Result<Arc<OpenSession>, Error> {
    if shared.draining.load(SeqCst) {
        return Err(Error::draining());
    }
    if store.ownership().is_none() && !store.holds(tenant, id).await? {
        return Err(Error::no_session(id));
    }
    let lock = shared.locks.lock(id).await;
    if let Ok(session) = shared.registry.find(tenant, id) {
        return Ok(session);
    }
    let inside = shared.gate.enter();
    let generation = claim_session(shared, store, tenant, id).await?;
    let opened = open_claimed(shared, store, tenant, id, generation).await;
    if opened.is_err() {
        // Another node may have room for it.
        give_back(store, id, generation).await;
    }
    drop((lock, inside));
    opened
}

/// Makes a session this node's, where several share the store.
///
/// # Errors
/// `NOT_FOUND`; `UNAVAILABLE` with the node that has it, or when the store does not answer.
pub(crate) async fn claim_session(
    shared: &SharedResources,
    store: &Store,
    tenant: &Tenant,
    id: &str,
) -> Result<Generation, Error> {
    let Some(ownership) = store.ownership() else {
        return match store.holds(tenant, id).await? {
            true => Ok(Generation::default()),
            false => Err(Error::no_session(id)),
        };
    };
    let until = tokio::time::Instant::now() + GIVEN_BACK_WITHIN;
    loop {
        match ownership.claim(tenant, id).await? {
            SessionClaim::Here(generation) => return Ok(generation),
            SessionClaim::Missing => return Err(Error::no_session(id)),
            SessionClaim::Elsewhere { is_leaving: true, .. } if tokio::time::Instant::now() < until => {
                tokio::time::sleep(BETWEEN_LOOKS).await;
            }
            SessionClaim::Elsewhere { owner, .. } => {
                shared.metrics.sent_elsewhere.inc();
                return Err(Error::elsewhere(owner));
            }
        }
    }
}

/// Gives back a session that this node does not need.
pub(crate) async fn give_back(store: &Store, id: &str, generation: Generation) {
    let session = HeldSession {
        id: id.to_owned(),
        generation,
    };
    if let Some(ownership) = store.ownership()
        && let Err(error) = ownership.release(&session, 0).await
    {
        tracing::warn!(session.id = %id, "a session stays this node's: {error}");
    }
}

/// Opens a stored session that is this node's.
async fn open_claimed(
    shared: &Arc<SharedResources>,
    store: &Arc<Store>,
    tenant: &Tenant,
    id: &str,
    generation: Generation,
) -> Result<Arc<OpenSession>, Error> {
    let stored = store.load(tenant, id).await.inspect_err(|error| {
        tracing::error!(session.id = %id, "a stored session cannot be read: {error}");
    })?;
    let stored = stored.ok_or_else(|| Error::no_session(id))?;
    let last_use = stored.used_ms.max(shared.started_ms);
    if last_use.saturating_add(millis(stored.record.ttl)) < shared.surroundings.now_ms() {
        return Err(Error::no_session(id));
    }
    open_stored(shared, store, stored, generation)
        .await
        .inspect_err(|error| {
            tracing::error!(session.id = %id, "a stored session cannot be opened: {error}");
        })
}

async fn open_stored(
    shared: &Arc<SharedResources>,
    store: &Arc<Store>,
    stored: StoredSession,
    generation: Generation,
) -> Result<Arc<OpenSession>, Error> {
    let files = read_files(store, &stored.model.files).await?;
    let arrived = Instant::now();
    let of_tenant = shared.accounts.of(&stored.record.tenant)?.place_again();
    let places = SessionPlaces::reserve(shared, of_tenant, files.total_bytes()).await?;
    let guard = CancelOnDrop::default();
    let model = ModelToOpen {
        files,
        options: stored.model.open_options()?,
        graph_bytes: stored.model.graph_bytes,
    };
    let log = Arc::new(ReplayedLog {
        files: read_merged(store, &stored).await?,
        snapshot: read_snapshot(store, &stored).await,
        commits: stored.commits,
    });
    let (opened, kept, rerecorded) = loop {
        let opened = open_model(shared, &places, model.clone(), arrived, &guard).await?;
        match replay_log(shared, store, opened, Arc::clone(&log), &places, &guard).await {
            Ok(replayed) => break replayed,
            Err(OpeningRefusal::Other(error)) => return Err(error),
            Err(OpeningRefusal::TenantMemory(error) | OpeningRefusal::ServerMemory(error)) => {
                if !evict_idle(shared, None).await {
                    return Err(count_refusal(shared, error));
                }
            }
        }
    };
    // Counted even where it breaks the budget: the session was admitted before.
    let _ = places.memory.resize(opened.held);
    if !rerecorded.is_empty() {
        tracing::warn!(
            session.id = %stored.record.id,
            "{} commits of another build or processor were made again and recorded with this one's digests",
            rerecorded.len()
        );
        let session = HeldSession {
            id: stored.record.id.clone(),
            generation,
        };
        if store.is_writable() {
            store.rerecord_digests(session, &kept.build, rerecorded).await?;
        }
    }
    let session = start_session(shared, stored.record, generation, opened, places, Some(kept));
    shared.metrics.sessions_reopened.inc();
    tracing::info!(session.id = %session.id, "session came back from the store");
    Ok(session)
}

async fn read_files(store: &Store, names: &FileReferences) -> Result<FileSet, StoreError> {
    let mut files = FileSet::single(names.name.clone(), store.object(&names.main).await?);
    for (uri, object) in &names.companions {
        files.companions.insert(uri.clone(), store.object(object).await?);
    }
    Ok(files)
}

async fn read_merged(store: &Store, stored: &StoredSession) -> Result<BTreeMap<u64, FileSet>, StoreError> {
    let mut merged = BTreeMap::new();
    for commit in &stored.commits {
        if let LoggedCommit::Edit { files: Some(names), .. } = &commit.record {
            merged.insert(commit.sequence, read_files(store, names).await?);
        }
    }
    Ok(merged)
}

/// The newest kept shape. It only saves solving: one that is damaged is solved again, and compared with its digest.
async fn read_snapshot(store: &Store, stored: &StoredSession) -> Option<(u64, Arc<Vec<glam::DVec3>>)> {
    let snapshot = stored.snapshot.as_ref()?;
    let read = match store.object(&snapshot.object).await {
        Ok(bytes) => read_shape(&bytes),
        Err(error) => Err(error),
    };
    let positions = read
        .inspect_err(|error| tracing::warn!(session.id = %stored.record.id, "a kept shape is not used: {error}"))
        .ok()?;
    let commit = stored.commits.iter().find(|c| c.sequence == snapshot.sequence)?;
    if engine::digest(&positions) != commit.digest {
        tracing::warn!(session.id = %stored.record.id, "a kept shape is not used: it is not that of its commit");
        return None;
    }
    Some((snapshot.sequence, Arc::new(positions)))
}

type Replayed = (OpenedModel, KeptSession, Vec<(u64, String)>);

/// Replays the log on the compute pool.
async fn replay_log(
    shared: &Arc<SharedResources>,
    store: &Arc<Store>,
    opened: OpenedModel,
    log: Arc<ReplayedLog>,
    places: &SessionPlaces,
    guard: &CancelOnDrop,
) -> Result<Replayed, OpeningRefusal> {
    let (limit, room) = (shared.config.history, places.memory.room());
    let mut kept = KeptSession::new(Arc::clone(store));
    kept.shape_at = log.snapshot.as_ref().map_or(0, |(sequence, _)| *sequence);
    let work = move |exec: &Exec<'_>, _: &WorkWatch| -> Result<Replayed, ReplayError> {
        let mut opened = opened;
        let mut replay = Replay {
            deformer: &mut opened.deformer,
            history: &mut opened.history,
            kept: &mut kept,
            room,
            exec,
            rerecorded: Vec::new(),
        };
        replay.follow(&log, limit)?;
        let rerecorded = std::mem::take(&mut replay.rerecorded);
        opened.held = (opened.deformer.byte_size()).saturating_add(opened.history.byte_size());
        Ok((opened, kept, rerecorded))
    };
    let (done, watch) = run_opening(shared, places, WorkKind::Replay, Instant::now(), guard, work).await?;
    let refused = match done {
        Ok(replayed) => return Ok(replayed),
        // Nothing is wrong with it: the limits are lower than they were, or others hold the memory.
        Err(ReplayError::Engine(error @ engine::Error::TooLarge { .. })) => {
            let text = format!("the stored session does not fit the limits of this server at present: {error}");
            return Err(OpeningRefusal::ServerMemory(no_place(text)));
        }
        Err(ReplayError::Store(error)) => error.into(),
        Err(ReplayError::Engine(engine::Error::Cancelled)) => {
            let late = "opening the stored session took longer than allowed";
            opening_stopped(shared, &watch, late.into())
        }
        Err(ReplayError::Engine(error)) => {
            let text = format!("what is stored of the session cannot be followed and is not served: {error}");
            Error::new(ErrorCode::DataLoss, text)
        }
    };
    Err(refused.into())
}
