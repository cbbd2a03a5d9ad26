//! Why a piece of work should stop, and what it said while it ran.

use crate::progress::{CancelFlag, Progress};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Raises its flag when dropped: held by whoever waits for the work, so that work nobody waits for stops.
#[derive(Debug, Default)]
pub(super) struct CancelOnDrop(pub Arc<CancelFlag>);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.cancel();
    }
}

/// Watches one piece of work: stops it when any of its flags is raised or its time is over, and measures its stages.
#[derive(Debug)]
pub(super) struct Stop {
    flags: Vec<Arc<CancelFlag>>,
    started: Instant,
    limit: Duration,
    stages: Mutex<Vec<(&'static str, Instant)>>,
}

impl Stop {
    /// The time starts running now.
    pub fn new(flags: Vec<Arc<CancelFlag>>, limit: Duration) -> Self {
        Self {
            flags,
            started: Instant::now(),
            limit,
            stages: Mutex::default(),
        }
    }

    /// Whether somebody gave the work up.
    pub fn abandoned(&self) -> bool {
        self.flags.iter().any(|flag| flag.cancelled())
    }

    /// The time that the work may take.
    pub fn limit(&self) -> Duration {
        self.limit
    }

    /// Time since the start.
    pub fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }

    /// Milliseconds of every stage reported so far; the last one ends now.
    pub fn stage_ms(&self) -> BTreeMap<String, f64> {
        let now = Instant::now();
        let stages = self.stages.lock().unwrap_or_else(PoisonError::into_inner);
        let ends = stages.iter().skip(1).map(|&(_, start)| start).chain([now]);
        let mut ms = BTreeMap::new();
        for (&(stage, start), end) in stages.iter().zip(ends) {
            *ms.entry(stage.to_owned()).or_default() += end.duration_since(start).as_secs_f64() * 1e3;
        }
        ms
    }
}

impl Progress for Stop {
    fn cancelled(&self) -> bool {
        self.abandoned() || self.started.elapsed() >= self.limit
    }

    fn report(&self, stage: &'static str, _fraction: f32) {
        let mut stages = self.stages.lock().unwrap_or_else(PoisonError::into_inner);
        if stages.last().is_none_or(|&(last, _)| last != stage) {
            stages.push((stage, Instant::now()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_flag_or_the_clock_stops_the_work() {
        let guard = CancelOnDrop::default();
        let flags = vec![Arc::new(CancelFlag::default()), Arc::clone(&guard.0)];
        let stop = Stop::new(flags, Duration::from_secs(3600));
        assert!(!stop.cancelled());
        drop(guard);
        assert!(stop.cancelled() && stop.abandoned());
        let late = Stop::new(Vec::new(), Duration::ZERO);
        assert!(late.cancelled() && !late.abandoned());
    }

    #[test]
    fn stages_are_measured_by_their_starts() {
        let stop = Stop::new(Vec::new(), Duration::from_secs(1));
        assert!(stop.stage_ms().is_empty());
        for (stage, fraction) in [("read", 0.0), ("read", 0.5), ("mesh", 0.0), ("read", 0.0)] {
            stop.report(stage, fraction);
        }
        let ms = stop.stage_ms();
        assert_eq!(ms.keys().map(String::as_str).collect::<Vec<_>>(), ["mesh", "read"]);
        assert!(ms.values().all(|&ms| (0.0..1e3).contains(&ms)));
    }
}
