//! How long each pass over the rows of a frame takes.

use pliant::progress::Progress;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Clocks passes.
pub(crate) struct PassClock {
    start: Instant,
    passes: Mutex<ClockedPasses>,
}

/// Passes with seconds.
#[derive(Default)]
struct ClockedPasses {
    /// The one under way, and when it began.
    current: Option<(&'static str, f64)>,
    /// Those before it, in the order in which they first began, and how long they took.
    done: Vec<(&'static str, f64)>,
}

impl PassClock {
    /// Creates a clock on which nothing runs.
    pub(crate) fn new() -> Self {
        Self {
            start: Instant::now(),
            passes: Mutex::default(),
        }
    }

    fn switch_to(&self, next: Option<&'static str>) {
        let now = self.start.elapsed().as_secs_f64();
        let mut passes = self.passes.lock().unwrap_or_else(PoisonError::into_inner);
        let ClockedPasses { current, done } = &mut *passes;
        if let Some((pass, begun)) = current.take() {
            match done.iter_mut().find(|(name, _)| *name == pass) {
                Some((_, seconds)) => *seconds += now - begun,
                None => done.push((pass, now - begun)),
            }
        }
        *current = next.map(|pass| (pass, now));
    }

    /// Ends the pass under way. Returns the seconds of every pass since the last time, in the order in which they first began.
    pub(crate) fn take(&self) -> Vec<(&'static str, f64)> {
        self.switch_to(None);
        let mut passes = self.passes.lock().unwrap_or_else(PoisonError::into_inner);
        std::mem::take(&mut passes.done)
    }
}

impl Progress for PassClock {
    fn begin_pass(&self, pass: &'static str) {
        self.switch_to(Some(pass));
    }
}
