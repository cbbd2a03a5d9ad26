//! A piece of work: whose it is, its span, what it reported, and why it should stop.

use crate::capacity::memory_ledger::MemoryReservation;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::{CancelFlag, Progress, Silent};
use pliant_exec::stage_clock::StageClock;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tracing::Span;
use tracing::field::Empty;

/// Where a piece of work runs: the threads, the watch that stops it, and how long it waited for its slot.
pub(crate) struct Work<'a> {
    pub pool: &'a Pool,
    pub watch: &'a WorkWatch,
    pub queued: Duration,
}

impl Work<'_> {
    /// What kernels are called with.
    pub fn exec(&self) -> Exec<'_> {
        Exec::new(self.pool, self.watch)
    }
}

/// Raises its flag when dropped. The caller holds it, so that work stops when the caller leaves.
#[derive(Debug, Default)]
pub(crate) struct CancelOnDrop(pub Arc<CancelFlag>);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.cancel();
    }
}

/// Watches one piece of work: stops it when any of its flags is raised or its time is over, and measures its stages.
#[derive(Debug)]
pub(crate) struct WorkWatch {
    flags: Vec<Arc<CancelFlag>>,
    started: Instant,
    waited: Duration,
    limit: Duration,
    deadline: Instant,
    /// What the work is counted against, and the bytes of it that something else holds.
    memory: Option<(Arc<MemoryReservation>, u64)>,
    stages: StageClock<'static>,
    /// The newest report.
    newest: Mutex<Option<(&'static str, f32)>>,
}

impl WorkWatch {
    /// The time starts running now.
    pub fn new(flags: Vec<Arc<CancelFlag>>, limit: Duration) -> Self {
        Self::since(Instant::now(), flags, limit)
    }

    /// The time of `limit` has been running since a call arrived.
    pub fn since(arrived: Instant, flags: Vec<Arc<CancelFlag>>, limit: Duration) -> Self {
        let started = Instant::now();
        Self {
            flags,
            started,
            waited: started.saturating_duration_since(arrived),
            limit,
            deadline: arrived.checked_add(limit).unwrap_or(started + limit),
            memory: None,
            stages: StageClock::new(move || started.elapsed().as_secs_f64() * 1e3, &Silent),
            newest: Mutex::default(),
        }
    }

    /// Counts what the work is about to hold against a reservation, which grows as long as there is room; `beside` bytes of it are of
    /// something else.
    pub fn within(self, memory: Arc<MemoryReservation>, beside: u64) -> Self {
        Self {
            memory: Some((memory, beside)),
            ..self
        }
    }

    /// Whether the work was given up.
    pub fn abandoned(&self) -> bool {
        self.flags.iter().any(|flag| flag.cancelled())
    }

    /// The time that the work may take.
    pub fn limit(&self) -> Duration {
        self.limit
    }

    /// Time from the arrival of the call to the start.
    pub fn waited(&self) -> Duration {
        self.waited
    }

    /// Time since the start.
    pub fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }

    /// The stage under way and how much of it is done, once there was a report.
    pub fn newest_report(&self) -> Option<(&'static str, f32)> {
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Milliseconds of every stage reported so far; the last one ends now.
    pub fn take_stage_ms(&self) -> BTreeMap<String, f64> {
        self.stages.take_stage_ms()
    }
}

impl Progress for WorkWatch {
    fn cancelled(&self) -> bool {
        self.abandoned() || Instant::now() >= self.deadline
    }

    fn may_hold(&self, bytes: u64) -> bool {
        let memory = self.memory.as_ref();
        memory.is_none_or(|(memory, beside)| memory.grow_to(bytes.saturating_add(*beside)).is_ok())
    }

    fn report(&self, stage: &'static str, fraction: f32) {
        *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = Some((stage, fraction));
        self.stages.report(stage, fraction);
    }
}

/// The target of every span: off in logs unless asked for, and what is exported.
pub const SPANS: &str = "pliant_spans";

macro_rules! work_kinds {
    ($($(#[$doc:meta])* $kind:ident $name:literal,)*) => {
        /// A kind of work on the compute pool: its name is that of its spans, and the label of its time in the metrics.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum WorkKind {
            $($(#[$doc])* $kind,)*
        }

        impl WorkKind {
            /// Every kind.
            pub const ALL: &[Self] = &[$(Self::$kind,)*];

            /// What its spans are called.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$kind => $name,)*
                }
            }
        }
    };
}

work_kinds! {
    /// A model is opened.
    Build "build",
    /// A session comes back from its store.
    Replay "replay",
    /// Handles are set, changed or removed.
    Handles "handles",
    /// A pose is committed.
    Solve "solve",
    /// A pose of a stream is solved that is not committed.
    Drag "drag",
    /// A stream works ahead after a frame of a drag.
    Settle "settle",
    /// The topology is edited.
    Edit "edit",
    /// A commit is undone or redone.
    History "history",
    /// The answer of an earlier commit is computed again.
    Recall "recall",
    /// The model is written.
    Export "export",
    /// Points or another model are carried along with the shape.
    Carry "carry",
    /// The shape is read, for a picture or to resolve words.
    Look "look",
    /// Crossings of the current shape are looked for.
    Crossings "crossings",
    /// A rig is made.
    Rig "rig",
    /// Blend shapes or a pose come from another model.
    Transfer "transfer",
    /// An animation is prepared.
    Animate "animate",
    /// A frame of an animation is solved.
    Frame "frame",
    /// The frames of an animation become one file.
    Clip "clip",
}

/// A piece of work as operators see it: its kind, and its span.
#[derive(Debug)]
pub(crate) struct WorkSpan {
    /// What it is called and counted under.
    pub kind: WorkKind,
    /// From its request for a slot to its result.
    pub span: Span,
}

impl WorkSpan {
    /// A span of work of a kind for a session, if it has an id yet; a child of `call`.
    pub fn new(kind: WorkKind, session: &str, call: &Span) -> Self {
        let span = tracing::info_span!(
            target: SPANS,
            parent: call,
            "work",
            otel.name = kind.name(),
            session.id = session,
            queue_ms = Empty,
            cycles = Empty,
            residual = Empty,
            vertices = Empty,
        );
        Self { kind, span }
    }
}

/// Records the result of a solve in the current span.
pub(crate) fn report_solve(cycles: u32, residual: f64, vertices: usize) {
    let span = Span::current();
    // Collectors know no unsigned numbers.
    span.record("cycles", i64::from(cycles));
    span.record("residual", residual);
    report_vertices(vertices);
}

/// Records the size of the model in the current span.
pub(crate) fn report_vertices(vertices: usize) {
    Span::current().record("vertices", i64::try_from(vertices).unwrap_or(i64::MAX));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_flag_or_the_clock_stops_the_work() {
        let guard = CancelOnDrop::default();
        let flags = vec![Arc::new(CancelFlag::default()), Arc::clone(&guard.0)];
        let stop = WorkWatch::new(flags, Duration::from_secs(3600));
        assert!(!stop.cancelled());
        drop(guard);
        assert!(stop.cancelled() && stop.abandoned());
        let late = WorkWatch::new(Vec::new(), Duration::ZERO);
        assert!(late.cancelled() && !late.abandoned());
    }
}
