//! Builds the engine of a session on the compute pool, within what its tenant and the server have left.

use crate::asset::{self, FileSet};
use crate::engine::{self, HandleSet, OpenOptions, digest};
use crate::exec::Exec;
use crate::session::calls::session_places::{SessionPlaces, refuse, refuse_until};
use crate::session::capacity::compute_slots::WorkLane;
use crate::session::capacity::work_span::{WorkSpan, tell_vertices};
use crate::session::capacity::work_watch::{CancelOnDrop, WorkWatch};
use crate::session::engine::Engine;
use crate::session::error::{Error, ErrorCode};
use crate::session::history::commit_history::CommitHistory;
use crate::session::history::loaded_deformer::LoadedDeformer;
use crate::session::history::session_state::EditedState;
use crate::session::keeping::made_room::make_room;
use crate::session::shared::SharedResources;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tracing::Span;

/// A model, opened, with its history.
pub(in crate::session) struct OpenedModel {
    pub deformer: LoadedDeformer,
    pub history: CommitHistory,
    pub build_ms: std::collections::BTreeMap<String, f64>,
    pub held: u64,
}

/// Builds the engine of a session and counts what it holds. Idle sessions of its tenant that are kept make room for it where the
/// tenant's quota is too small for all of them at a time.
///
/// # Cancel safety
/// The work stops when `guard` is dropped.
pub(in crate::session) async fn open_model(
    shared: &Arc<SharedResources>,
    places: &SessionPlaces,
    (files, options): (FileSet, OpenOptions),
    arrived: Instant,
    guard: &CancelOnDrop,
) -> Result<OpenedModel, Error> {
    let account = places.of_tenant.account();
    loop {
        let room = account.memory_room();
        let built = build_model(shared, places, (files.clone(), options.clone()), arrived, guard).await;
        let refused = match built {
            Ok(opened) => match places.admit(shared, opened.held) {
                Ok(()) => return Ok(opened),
                Err(error) => {
                    shared.compute.discard(opened.deformer);
                    error
                }
            },
            Err(error) => error,
        };
        let is_full = refused.code == ErrorCode::ResourceExhausted && account.memory_quota().is_some_and(|q| room < q);
        if !is_full || !make_room(shared, Some(places.of_tenant.tenant())).await {
            return Err(refused);
        }
    }
}

async fn build_model(
    shared: &Arc<SharedResources>,
    SessionPlaces { memory, of_tenant, .. }: &SessionPlaces,
    (files, options): (FileSet, OpenOptions),
    arrived: Instant,
    guard: &CancelOnDrop,
) -> Result<OpenedModel, Error> {
    let account = of_tenant.account();
    account.check_work()?;
    let owner = of_tenant.work_owner();
    let slot = tokio::select! {
        biased;
        () = shared.aborted.cancelled() => return Err(Error::draining()),
        slot = shared.compute.slot(WorkLane::Builds, &owner, (arrived, shared.config.build)) => slot?,
    };
    let config = &shared.config;
    // What is refused for the tenant's sake is told so; the smaller room counts.
    let own_room = account.memory_room();
    let room = memory.room().min(own_room);
    let limits = config.deformer_limits(room);
    let flags = vec![Arc::clone(&guard.0), Arc::clone(&shared.abort_flag)];
    let watch = Arc::new(WorkWatch::since(arrived, flags, config.build).within(Arc::clone(memory)));
    let (inner_watch, inside) = (Arc::clone(&watch), Arc::clone(shared));
    let begun = Instant::now();
    let span = WorkSpan::new("build", "", &Span::current());
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
    account.charge_work(begun.elapsed());
    built.map_err(|error| match error {
        engine::Error::Cancelled if shared.aborted.is_cancelled() => Error::draining(),
        engine::Error::Cancelled if watch.abandoned() => Error::new(ErrorCode::Cancelled, "the caller gave up"),
        engine::Error::Cancelled => build_took_too_long(watch.limit()),
        engine::Error::TooLarge { seen, limit, .. } if limit == own_room => match account.memory_quota() {
            Some(quota) if seen > quota => {
                let text = format!("the session would need {seen} bytes of memory, your quota allows {quota}");
                Error::new(ErrorCode::TooLarge, text)
            }
            _ => {
                let text = format!("the session would need {seen} bytes of memory, your quota has {room} left");
                refuse_until(shared, text, of_tenant.tenant())
            }
        },
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
