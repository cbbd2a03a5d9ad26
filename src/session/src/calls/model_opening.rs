//! Reserves what a session takes, a permit, memory and a place among those of its tenant, and builds its engine on the compute pool
//! within that.

use crate::answers::Tenant;
use crate::capacity::compute_slots::WorkLane;
use crate::capacity::memory_ledger::{MemoryReservation, MemoryShortage};
use crate::capacity::memory_use::MemoryUse;
use crate::capacity::work_watch::{CancelOnDrop, WorkWatch};
use crate::capacity::work_watch::{WorkKind, WorkSpan, report_vertices};
use crate::error::{Error, ErrorCode};
use crate::history::commit_history::CommitHistory;
use crate::history::loaded_deformer::LoadedDeformer;
use crate::history::session_state::EditedState;
use crate::keeping::sweep::evict_idle;
use crate::quota::tenant_account::{BytesToStore, TenantAccount, TenantSession};
use crate::shared::SharedResources;
use pliant_asset::FileSet;
use pliant_core::engine;
use pliant_core::engine::{ESTIMATED_MEMORY, HandleSet, OpenOptions, digest};
use pliant_exec::Exec;
use pliant_wire::session_message;
use std::sync::Arc;
use std::time::Instant;
use tokio::sync::OwnedSemaphorePermit;
use tracing::Span;

/// What a session is opened on.
#[derive(Clone)]
pub(crate) struct ModelToOpen {
    pub files: FileSet,
    pub options: OpenOptions,
    /// What the volume graph was fitted into when the session was created, where that is noted: its shapes depend on it.
    pub graph_bytes: Option<u64>,
}

/// A model, opened, with its history.
pub(crate) struct OpenedModel {
    /// What its volume graph was fitted into.
    pub graph_bytes: u64,
    pub deformer: LoadedDeformer,
    pub history: CommitHistory,
    pub build_ms: std::collections::BTreeMap<String, f64>,
    pub held: u64,
}

/// Builds the engine of a session and counts what it holds. Idle sessions that are kept make room for it: where its tenant's quota
/// is too small for all of them at a time those of the tenant, where the server's memory is those of all.
///
/// How fine the volume graph is follows from what the server and the tenant may hold in all, never from what happens to be
/// free: the same model gets the same shapes whatever else is open.
///
/// # Cancel safety
/// The work stops when `guard` is dropped.
pub(crate) async fn open_model(
    shared: &Arc<SharedResources>,
    places: &SessionPlaces,
    model: ModelToOpen,
    arrived: Instant,
    guard: &CancelOnDrop,
) -> Result<OpenedModel, Error> {
    loop {
        let built = build_model(shared, places, model.clone(), arrived, guard).await;
        let refused = match built {
            Ok(opened) => match places.admit(shared, opened.held) {
                Ok(()) => return Ok(opened),
                Err(refused) => {
                    shared.compute.discard(opened.deformer);
                    refused
                }
            },
            Err(refused) => refused,
        };
        let (refused, whose) = match refused {
            OpeningRefusal::TenantMemory(error) => (error, Some(places.of_tenant.tenant())),
            OpeningRefusal::ServerMemory(error) => (error, None),
            OpeningRefusal::Other(error) => return Err(error),
        };
        if !evict_idle(shared, whose).await {
            return Err(count_refusal(shared, refused));
        }
    }
}

async fn build_model(
    shared: &Arc<SharedResources>,
    places: &SessionPlaces,
    ModelToOpen {
        files,
        options,
        graph_bytes,
    }: ModelToOpen,
    arrived: Instant,
    guard: &CancelOnDrop,
) -> Result<OpenedModel, OpeningRefusal> {
    let SessionPlaces { memory, of_tenant, .. } = places;
    let account = of_tenant.account();
    account.check_work()?;
    let room = memory.room();
    let may_hold = account.memory_quota().unwrap_or(u64::MAX).min(shared.ledger.total());
    let graph_bytes = graph_bytes.unwrap_or(may_hold);
    let limits = engine::DeformerLimits {
        graph_bytes: Some(graph_bytes),
        ..shared.config.deformer_limits(room)
    };
    let inside = Arc::clone(shared);
    let work = move |exec: &Exec<'_>, watch: &WorkWatch| -> Result<OpenedModel, engine::Error> {
        exec.check()?;
        let mut engine = inside.opener.open(files, &options, &limits, exec)?;
        let build_ms = watch.take_stage_ms();
        inside.metrics.observe_stages(&build_ms);
        let rest = engine.rest_shape();
        report_vertices(rest.positions.len());
        let state = EditedState {
            topology: engine.deformer().map(|deformer| deformer.topology_state()),
            diagonal: engine.diagonal(),
            handles: HandleSet::default(),
            poses: engine.initial_poses(),
            facts: Box::new(session_message(&engine.facts())),
            digest: digest(&rest.positions),
            solved_with: None,
        };
        let config = &inside.config;
        let history = CommitHistory::new(state, rest, config.history, config.snapshot_bytes);
        let deformer = LoadedDeformer::new(engine, history.current().handles.id);
        let held = deformer.byte_size().saturating_add(history.byte_size());
        Ok(OpenedModel {
            graph_bytes,
            deformer,
            history,
            build_ms,
            held,
        })
    };
    let (built, watch) = run_opening(shared, places, WorkKind::Build, arrived, guard, work).await?;
    shared.metrics.build.observe(watch.elapsed().as_secs_f64());
    built.map_err(|error| match error {
        engine::Error::Cancelled => {
            let limit = watch.limit().as_millis();
            let late = format!("building the session took longer than the {limit} ms that are allowed");
            opening_stopped(shared, &watch, late).into()
        }
        error => match memory_needed(&error, room) {
            Some(needed) => lacks_memory(shared, memory.as_ref(), of_tenant, needed),
            None => Error::from(error).into(),
        },
    })
}

/// Runs work of a session that is being opened on the compute pool, within the memory of its place; with the watch that stopped it or not.
///
/// # Cancel safety
/// The work stops when `guard` is dropped.
pub(crate) async fn run_opening<R: Send + 'static>(
    shared: &Arc<SharedResources>,
    places: &SessionPlaces,
    kind: WorkKind,
    arrived: Instant,
    guard: &CancelOnDrop,
    work: impl FnOnce(&Exec<'_>, &WorkWatch) -> R + Send + 'static,
) -> Result<(R, Arc<WorkWatch>), Error> {
    let (owner, limit) = (places.of_tenant.work_owner(), shared.config.build);
    let slot = tokio::select! {
        biased;
        () = shared.aborted.cancelled() => return Err(Error::draining()),
        slot = shared.compute.slot(WorkLane::Builds, &owner, arrived, limit) => slot?,
    };
    let flags = vec![Arc::clone(&guard.0), Arc::clone(&shared.abort_flag)];
    let watch = Arc::new(WorkWatch::since(arrived, flags, limit).within(Arc::clone(&places.memory), 0));
    let inside = Arc::clone(&watch);
    let begun = Instant::now();
    let span = WorkSpan::new(kind, "", &Span::current());
    let ran = slot
        .run(span, move |pool| work(&Exec::new(pool, &*inside), &inside))
        .await;
    let value = ran.map_err(|panicked| {
        tracing::error!(panic = panicked.0, "opening a session panicked");
        Error::from(panicked)
    })?;
    places.of_tenant.account().charge_work(begun.elapsed());
    Ok((value, watch))
}

/// Why such work was stopped; `late` says it of one that took too long.
pub(crate) fn opening_stopped(shared: &SharedResources, watch: &WorkWatch, late: String) -> Error {
    if shared.aborted.is_cancelled() {
        return Error::draining();
    }
    match watch.abandoned() {
        true => Error::new(ErrorCode::Cancelled, "the caller gave up"),
        false => Error::new(ErrorCode::DeadlineExceeded, late),
    }
}

/// The bytes in all for which an engine that has `room` refuses something; `None` where it refuses for something else.
pub(crate) fn memory_needed(error: &engine::Error, room: u64) -> Option<u64> {
    match error {
        engine::Error::TooLarge { seen, limit, .. }
        | engine::Error::Asset(pliant_asset::Error::TooLarge { seen, limit, .. })
            if *limit == room =>
        {
            Some(*seen)
        }
        _ => None,
    }
}

/// Of a model that takes more memory than it may have now: whether it may fit later, and whose memory is full.
fn lacks_memory(
    shared: &SharedResources,
    memory: &MemoryReservation,
    of_tenant: &TenantSession,
    needed: u64,
) -> OpeningRefusal {
    let quota = of_tenant.account().memory_quota().unwrap_or(u64::MAX);
    let total = shared.ledger.total();
    if needed > total && quota >= total {
        let text = format!("{ESTIMATED_MEMORY} is {needed}, at most {total} is allowed");
        return Error::new(ErrorCode::TooLarge, text).into();
    }
    if needed > quota {
        let text = format!("the session would need {needed} bytes of memory, your quota allows {quota}");
        return Error::new(ErrorCode::TooLarge, text).into();
    }
    let shortage = memory.shortage(needed);
    let text = format!("the session would need {needed} bytes of memory, and {shortage}");
    match shortage {
        MemoryShortage::Server { .. } => OpeningRefusal::ServerMemory(no_place(text)),
        MemoryShortage::Tenant { .. } => OpeningRefusal::TenantMemory(no_place_until(shared, text, of_tenant.tenant())),
    }
}

/// Bytes that a build is expected to need for each uploaded byte, until its real size is known.
const BYTES_PER_UPLOADED_BYTE: u64 = 32;
/// Bytes below which no build is tried.
const LEAST_BYTES: u64 = 1 << 20;

/// Why a model is not open.
pub(crate) enum OpeningRefusal {
    /// The tenant's sessions hold what it would take.
    TenantMemory(Error),
    /// All sessions hold what it would take.
    ServerMemory(Error),
    Other(Error),
}

impl From<Error> for OpeningRefusal {
    fn from(error: Error) -> Self {
        Self::Other(error)
    }
}

/// What a session has taken. Given back when dropped.
pub(crate) struct SessionPlaces {
    pub session_permit: OwnedSemaphorePermit,
    pub memory: Arc<MemoryReservation>,
    /// The place among the sessions of the tenant.
    pub of_tenant: TenantSession,
}

impl SessionPlaces {
    /// Takes a place among the sessions of the tenant, a permit, and the memory that a model of `upload` bytes is likely to need. Idle
    /// sessions that are kept make room for it.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED`.
    pub async fn reserve(shared: &SharedResources, of_tenant: TenantSession, upload: u64) -> Result<Self, Error> {
        loop {
            match take_place(shared, of_tenant.account(), upload) {
                Err((error, shortage)) => {
                    let whose = matches!(shortage, Some(MemoryShortage::Tenant { .. })).then(|| of_tenant.tenant());
                    if !evict_idle(shared, whose).await {
                        return Err(count_refusal(shared, error));
                    }
                }
                Ok((session_permit, memory)) => {
                    return Ok(Self {
                        session_permit,
                        memory,
                        of_tenant,
                    });
                }
            }
        }
    }

    /// Counts what an opened model holds.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` where that is more than the server or the tenant may hold.
    pub fn admit(&self, shared: &SharedResources, held: u64) -> Result<(), OpeningRefusal> {
        let Err(shortage) = self.memory.grow_to(held) else {
            let _ = self.memory.resize(held);
            return Ok(());
        };
        let text = format!("the session would need {held} bytes of memory, and {shortage}");
        Err(match shortage {
            MemoryShortage::Server { .. } => OpeningRefusal::ServerMemory(no_place(text)),
            MemoryShortage::Tenant { .. } => {
                OpeningRefusal::TenantMemory(no_place_until(shared, text, self.of_tenant.tenant()))
            }
        })
    }
}

/// Says why a session finds no place; it may find one yet, when idle sessions make room.
pub(crate) fn no_place(text: String) -> Error {
    Error::exhausted(text, 5)
}

/// Counts a call that ends because there is no place.
pub(crate) fn count_refusal(shared: &SharedResources, error: Error) -> Error {
    shared.metrics.refused.inc();
    error
}

/// The same for what one of the tenant's own sessions would make room for: the first of them that may end.
pub(crate) fn no_place_until(shared: &SharedResources, text: String, tenant: &Tenant) -> Error {
    let wait = shared.registry.soonest_end(tenant).as_secs().saturating_add(1);
    Error {
        retry_after_s: u32::try_from(wait).ok(),
        ..no_place(text)
    }
}

/// Takes a place for one more session of the tenant, whose model has `upload` bytes.
///
/// # Errors
/// `RESOURCE_EXHAUSTED` where the tenant has as many as it may have, or as many bytes in the store; `UNAVAILABLE` when the store does not
/// answer.
pub(crate) async fn place_of_tenant(
    shared: &SharedResources,
    tenant: &Tenant,
    upload: u64,
) -> Result<TenantSession, Error> {
    let account = shared.accounts.of(tenant)?;
    let counted = |_: &Error| {
        shared.metrics.refused.inc();
    };
    let storing = announce_stored(shared, &account, upload).await.inspect_err(counted)?;
    if let (Some(store), Some(_)) = (&shared.store, account.quota().sessions)
        && store.ownership().is_some()
    {
        // Other nodes open and delete them too.
        account.recount(store.count_sessions(tenant).await?);
    }
    let place = account.take_session(|| shared.registry.soonest_end(tenant));
    Ok(place.inspect_err(counted)?.with_stored(storing))
}

/// Takes `more` bytes of what a tenant may store, until what this returns is dropped: after they were written. `None` where it may
/// store as much as it likes.
///
/// # Errors
/// `RESOURCE_EXHAUSTED`; too large where it never may; `UNAVAILABLE` when the store does not answer.
pub(crate) async fn announce_stored(
    shared: &SharedResources,
    account: &Arc<TenantAccount>,
    more: u64,
) -> Result<Option<BytesToStore>, Error> {
    let (Some(store), Some(most)) = (&shared.store, account.stored_quota()) else {
        return Ok(None);
    };
    if more > most {
        let text = format!("{more} bytes are to be stored, your quota allows {most}");
        return Err(Error::new(ErrorCode::TooLarge, text));
    }
    let settled = account.settled_bytes();
    let used = store.stored_bytes(account.tenant()).await?;
    let announced = account.announce_stored(more, used, settled);
    announced.map(Some).ok_or_else(|| {
        let text = format!(
            "your sessions hold {used} bytes in the store, {more} more are to be stored and your quota allows {most}; delete a session"
        );
        Error::exhausted(text, 60)
    })
}

fn take_place(
    shared: &SharedResources,
    account: &Arc<TenantAccount>,
    upload: u64,
) -> Result<(OwnedSemaphorePermit, Arc<MemoryReservation>), (Error, Option<MemoryShortage>)> {
    let session_permit = Arc::clone(&shared.session_permits).try_acquire_owned().map_err(|_| {
        let text = format!(
            "{} sessions are open, no more are allowed; delete one or wait for one to expire",
            shared.config.sessions
        );
        (no_place(text), None)
    })?;
    let likely = upload
        .saturating_mul(BYTES_PER_UPLOADED_BYTE)
        .saturating_add(LEAST_BYTES);
    let of_quota = account.memory_quota().unwrap_or(LEAST_BYTES);
    let least = LEAST_BYTES.min(of_quota).max(upload);
    let memory = (shared.ledger).reserve(MemoryUse::Sessions, Some(account), least, likely);
    let memory = memory.map_err(|shortage| {
        let text = format!("the session would need {least} bytes of memory, and {shortage}");
        (no_place(text), Some(shortage))
    })?;
    Ok((session_permit, Arc::new(memory)))
}
