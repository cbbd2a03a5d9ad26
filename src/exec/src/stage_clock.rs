//! Measures how long the stages of a piece of work take.

use crate::progress::Progress;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Adds up the milliseconds of every stage that a piece of work reports. The caller gives the clock, because computing
/// crates read none. As a [`Progress`] it passes everything on to another watcher.
pub struct StageClock<'a> {
    now_ms: Box<dyn Fn() -> f64 + Send + Sync + 'a>,
    watcher: &'a dyn Progress,
    times: Mutex<StageTimes>,
}

#[derive(Default)]
struct StageTimes {
    /// The stage under way and when it began.
    open: Option<(&'static str, f64)>,
    /// Milliseconds of the stages that have ended.
    ended: BTreeMap<String, f64>,
}

impl StageTimes {
    fn end_open_stage(&mut self, now_ms: f64) {
        if let Some((stage, since)) = self.open.take() {
            *self.ended.entry(stage.into()).or_default() += now_ms - since;
        }
    }
}

impl<'a> StageClock<'a> {
    /// Creates an idle clock. `now_ms` returns milliseconds since any fixed moment; `watcher` receives every report
    /// too.
    pub fn new(now_ms: impl Fn() -> f64 + Send + Sync + 'a, watcher: &'a dyn Progress) -> Self {
        Self {
            now_ms: Box::new(now_ms),
            watcher,
            times: Mutex::default(),
        }
    }

    fn times(&self) -> MutexGuard<'_, StageTimes> {
        self.times.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins a stage; the one before it ends.
    pub fn begin_stage(&self, stage: &'static str) {
        let now_ms = (self.now_ms)();
        let mut times = self.times();
        times.end_open_stage(now_ms);
        times.open = Some((stage, now_ms));
    }

    /// Ends the stage under way and hands over the milliseconds of every stage since the last call.
    pub fn take_stage_ms(&self) -> BTreeMap<String, f64> {
        let now_ms = (self.now_ms)();
        let mut times = self.times();
        times.end_open_stage(now_ms);
        std::mem::take(&mut times.ended)
    }
}

impl Progress for StageClock<'_> {
    fn cancelled(&self) -> bool {
        self.watcher.cancelled()
    }

    fn may_hold(&self, bytes: u64) -> bool {
        self.watcher.may_hold(bytes)
    }

    fn report(&self, stage: &'static str, fraction: f32) {
        let is_running = self.times().open.is_some_and(|(open, _)| open == stage);
        if !is_running {
            self.begin_stage(stage);
        }
        self.watcher.report(stage, fraction);
    }
}

impl fmt::Debug for StageClock<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "StageClock({:?})", self.times().open)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

    #[test]
    fn a_stage_lasts_from_its_first_report_to_the_next_stage() {
        let ticks = AtomicU32::new(0);
        let clock = StageClock::new(|| f64::from(ticks.fetch_add(1, Relaxed)), &Silent);
        assert!(clock.take_stage_ms().is_empty());
        for (stage, fraction) in [("read", 0.0), ("read", 0.5), ("mesh", 0.0), ("read", 0.0)] {
            clock.report(stage, fraction);
        }
        let ms = clock.take_stage_ms();
        assert_eq!(Vec::from_iter(ms), [("mesh".to_owned(), 1.0), ("read".to_owned(), 2.0)]);
        assert!(clock.take_stage_ms().is_empty());
    }
}
