//! The work unit that all solvers are compared in.

use super::matrix::CompressedRows;
use crate::shared::timing::time_once;
use std::time::Instant;

/// Measures the seconds of one work unit: the matrix times three columns on one thread, the fastest of at least 5 runs and as many as
/// fit 0.3 s (at most 40), after one that is not counted.
pub(super) fn measure_work_unit(matrix: &CompressedRows) -> f64 {
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
        let ((), seconds) = time_once(|| matrix.multiply(&x, &mut y));
        best = best.min(seconds);
        // The product must be wanted, or the compiler may leave it out.
        std::hint::black_box(&mut y);
    }
    best
}
