//! Builds the engine of a session on the compute pool, within what its tenant and the server have left.

use crate::asset::{self, FileSet};
use crate::engine::{self, ESTIMATED_MEMORY, HandleSet, OpenOptions, digest};
use crate::exec::Exec;
use crate::session::calls::session_places::{OpeningRefusal, SessionPlaces, count_refusal, no_place, no_place_until};
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::memory_ledger::{MemoryReservation, MemoryShortage};
use crate::session::capacity::work_span::{WorkKind, WorkSpan, tell_vertices};
use crate::session::capacity::work_watch::{CancelOnDrop, WorkWatch};
use crate::session::engine::Engine;
use crate::session::error::{Error, ErrorCode};
use crate::session::history::commit_history::CommitHistory;
use crate::session::history::loaded_deformer::LoadedDeformer;
use crate::session::history::session_state::EditedState;
use crate::session::keeping::made_room::make_room;
use crate::session::quota::tenant_account::TenantSession;
use crate::session::shared::SharedResources;
use crate::wire::session_message;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tracing::Span;

/// What a session is opened on.
#[derive(Clone)]
pub(in crate::session) struct ModelToOpen {
    pub files: FileSet,
    pub options: OpenOptions,
    /// What the volume graph was fitted into when the session was created, where that is noted: its shapes depend on it.
    pub graph_bytes: Option<u64>,
}

/// A model, opened, with its history.
pub(in crate::session) struct OpenedModel {
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
pub(in crate::session) async fn open_model(
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
        if !make_room(shared, whose).await {
            return Err(count_refusal(shared, refused));
        }
    }
}

async fn build_model(
    shared: &Arc<SharedResources>,
    SessionPlaces { memory, of_tenant, .. }: &SessionPlaces,
    ModelToOpen {
        files,
        options,
        graph_bytes,
    }: ModelToOpen,
    arrived: Instant,
    guard: &CancelOnDrop,
) -> Result<OpenedModel, OpeningRefusal> {
    let account = of_tenant.account();
    account.check_work()?;
    let owner = of_tenant.work_owner();
    let slot = tokio::select! {
        biased;
        () = shared.aborted.cancelled() => return Err(Error::draining().into()),
        slot = shared.compute.slot(WorkLane::Builds, &owner, (arrived, shared.config.build)) => slot?,
    };
    let config = &shared.config;
    let room = memory.room();
    let may_hold = account.memory_quota().unwrap_or(u64::MAX).min(shared.ledger.total());
    let graph_bytes = graph_bytes.unwrap_or(may_hold);
    let limits = engine::DeformerLimits {
        graph_bytes: Some(graph_bytes),
        ..config.deformer_limits(room)
    };
    let flags = vec![Arc::clone(&guard.0), Arc::clone(&shared.abort_flag)];
    let watch = Arc::new(WorkWatch::since(arrived, flags, config.build).within(Arc::clone(memory), 0));
    let (inner_watch, inside) = (Arc::clone(&watch), Arc::clone(shared));
    let begun = Instant::now();
    let span = WorkSpan::new(WorkKind::Build, "", &Span::current());
    let built = slot.run(span, move |pool| -> Result<OpenedModel, engine::Error> {
        crate::progress::check(&*inner_watch)?;
        let engine: Box<dyn Engine> = inside
            .opener
            .open(files, &options, &limits, &Exec::new(pool, &*inner_watch))?;
        let build_ms = inner_watch.take_stage_ms();
        inside.metrics.observe_stages(&build_ms);
        let rest = engine.rest_shape();
        tell_vertices(rest.positions.len());
        let state = EditedState {
            topology: engine.topology_state(),
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
    });
    let built = built.await.map_err(|panicked| {
        tracing::error!(panic = panicked.0, "opening a model panicked");
        Error::from(panicked)
    })?;
    shared.metrics.build.observe(watch.elapsed().as_secs_f64());
    account.charge_work(begun.elapsed());
    built.map_err(|error| match error {
        engine::Error::Cancelled if shared.aborted.is_cancelled() => Error::draining().into(),
        engine::Error::Cancelled if watch.abandoned() => Error::new(ErrorCode::Cancelled, "the caller gave up").into(),
        engine::Error::Cancelled => build_took_too_long(watch.limit()).into(),
        error => match memory_needed(&error, room) {
            Some(needed) => lacks_memory(shared, (memory.as_ref(), of_tenant), needed),
            None => Error::from(error).into(),
        },
    })
}

/// The bytes in all for which an engine that has `room` refuses something; `None` where it refuses for something else.
pub(in crate::session) fn memory_needed(error: &engine::Error, room: u64) -> Option<u64> {
    match error {
        engine::Error::TooLarge { seen, limit, .. }
        | engine::Error::Asset(asset::Error::TooLarge { seen, limit, .. })
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
    (memory, of_tenant): (&MemoryReservation, &TenantSession),
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

fn build_took_too_long(limit: Duration) -> Error {
    let text = format!(
        "building the session took longer than the {} ms that are allowed",
        limit.as_millis()
    );
    Error::new(ErrorCode::DeadlineExceeded, text)
}
