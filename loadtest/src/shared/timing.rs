//! How long things take: the fastest of a few runs.

use std::time::Instant;

/// No further run begins once all before it took this many seconds.
const PATIENCE: f64 = 4.0;

/// Run times are how many seconds the runs of one piece of work took.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RunTimes {
    /// The fastest.
    pub best: f64,
    /// The first, which also pays for fresh memory.
    pub first: f64,
    /// All together.
    pub sum: f64,
}

impl RunTimes {
    /// Starts with the time of one run.
    pub fn from_one(seconds: f64) -> Self {
        Self {
            best: seconds,
            first: seconds,
            sum: seconds,
        }
    }

    /// Adds a run.
    pub fn add_run(&mut self, seconds: f64) {
        self.best = self.best.min(seconds);
        self.sum += seconds;
    }

    /// Whether another run may begin.
    pub fn may_repeat(&self) -> bool {
        self.sum < PATIENCE
    }
}

/// Runs `work` and times it in seconds.
pub(crate) fn time_once<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let result = work();
    (result, start.elapsed().as_secs_f64())
}

/// Runs `work` at most `repeat` times; the result is that of the last run. Each run gets what `prepare` made, outside
/// the clock, after the result before it is gone.
pub(crate) fn time_best_of<S, T, E>(
    repeat: u32,
    mut prepare: impl FnMut() -> S,
    mut work: impl FnMut(S) -> Result<T, E>,
) -> Result<(T, RunTimes), E> {
    let subject = prepare();
    let (first, seconds) = time_once(|| work(subject));
    let (mut last, mut times) = (first?, RunTimes::from_one(seconds));
    for _ in 1..repeat {
        if !times.may_repeat() {
            break;
        }
        drop(last);
        let subject = prepare();
        let (next, seconds) = time_once(|| work(subject));
        last = next?;
        times.add_run(seconds);
    }
    Ok((last, times))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_end_early_when_they_fail_or_enough_are_done() {
        let mut runs = 0;
        let (last, times) = time_best_of(
            3,
            || 2,
            |two| {
                runs += 1;
                Ok::<_, ()>(runs * two)
            },
        )
        .unwrap();
        assert_eq!((runs, last), (3, 6));
        assert!(times.best <= times.first && times.first <= times.sum);
        let mut runs = 0;
        let failed = time_best_of(
            3,
            || (),
            |()| {
                runs += 1;
                if runs == 2 { Err(runs) } else { Ok(()) }
            },
        );
        assert_eq!(failed.err(), Some(2));
        assert!(!RunTimes::from_one(PATIENCE).may_repeat());
    }
}
