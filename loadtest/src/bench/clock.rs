//! How long things take: the fastest of a few runs, and the work unit that all solvers are compared in.

use super::matrix::Matrix;
use std::time::Instant;

/// No further run begins once all before it took this many seconds.
const PATIENCE: f64 = 4.0;

/// What runs of one piece of work took, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Times {
    /// The fastest.
    pub best: f64,
    /// The first, which also pays for fresh memory.
    pub first: f64,
    /// All together.
    pub sum: f64,
}

impl Times {
    /// Of one run.
    pub fn one(seconds: f64) -> Self {
        Self {
            best: seconds,
            first: seconds,
            sum: seconds,
        }
    }

    /// Adds a run.
    pub fn add(&mut self, seconds: f64) {
        self.best = self.best.min(seconds);
        self.sum += seconds;
    }

    /// Whether another run may begin.
    pub fn may_repeat(&self) -> bool {
        self.sum < PATIENCE
    }
}

/// Runs `work` and tells what it took.
pub(super) fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let result = work();
    (result, start.elapsed().as_secs_f64())
}

/// Runs `work` at most `repeat` times; the result is that of the last run. Each run gets what `prepare` made, outside
/// the clock, after the result before it is gone.
pub(super) fn best_of<S, T, E>(
    repeat: u32,
    mut prepare: impl FnMut() -> S,
    mut work: impl FnMut(S) -> Result<T, E>,
) -> Result<(T, Times), E> {
    let subject = prepare();
    let (first, seconds) = timed(|| work(subject));
    let (mut last, mut times) = (first?, Times::one(seconds));
    for _ in 1..repeat {
        if !times.may_repeat() {
            break;
        }
        drop(last);
        let subject = prepare();
        let (next, seconds) = timed(|| work(subject));
        last = next?;
        times.add(seconds);
    }
    Ok((last, times))
}

/// Seconds of one work unit: the matrix times three columns on one thread, the fastest of at least 5 runs and as many as
/// fit 0.3 s (at most 40), after one that is not counted.
pub(super) fn work_unit(matrix: &Matrix) -> f64 {
    let x: Vec<[f64; 3]> = (0..matrix.rows())
        .map(|i| [0, 1, 2].map(|c| 1.0 + ((3 * i + c) % 7) as f64))
        .collect();
    let mut y = vec![[0.0; 3]; matrix.rows()];
    matrix.multiply(&x, &mut y);
    let (mut best, start) = (f64::INFINITY, Instant::now());
    for run in 0..40 {
        if run >= 5 && start.elapsed().as_secs_f64() >= 0.3 {
            break;
        }
        let ((), seconds) = timed(|| matrix.multiply(&x, &mut y));
        best = best.min(seconds);
        // The product must be wanted, or the compiler may leave it out.
        std::hint::black_box(&mut y);
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_end_early_when_they_fail_or_enough_are_done() {
        let mut runs = 0;
        let (last, times) = best_of(
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
        let failed = best_of(
            3,
            || (),
            |()| {
                runs += 1;
                if runs == 2 { Err(runs) } else { Ok(()) }
            },
        );
        assert_eq!(failed.err(), Some(2));
        assert!(!Times::one(PATIENCE).may_repeat());
    }
}
