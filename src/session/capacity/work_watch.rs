//! Why a piece of work should stop, and what it reported.

use crate::exec::Exec;
use crate::pool::Pool;
use crate::progress::{CancelFlag, Progress, Silent};
use crate::session::capacity::memory_ledger::MemoryReservation;
use crate::stage_clock::StageClock;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Where a piece of work runs: the threads, the watch that stops it, and how long it waited for its slot.
pub(in crate::session) struct Work<'a> {
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
pub(in crate::session) struct CancelOnDrop(pub Arc<CancelFlag>);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.cancel();
    }
}

/// Watches one piece of work: stops it when any of its flags is raised or its time is over, and measures its stages.
#[derive(Debug)]
pub(in crate::session) struct WorkWatch {
    flags: Vec<Arc<CancelFlag>>,
    started: Instant,
    waited: Duration,
    limit: Duration,
    deadline: Instant,
    /// What the work is counted against, and the bytes of it that something else holds.
    memory: Option<(Arc<MemoryReservation>, u64)>,
    stages: StageClock<'static>,
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
        self.stages.report(stage, fraction);
    }
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
