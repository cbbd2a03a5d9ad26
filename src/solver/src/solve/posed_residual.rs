//! Right-hand side and residual of a pose, and the norms of both, in one pass over the rows.

use crate::lanes::{Lanes, WIDTH, WideLanes};
use crate::solve::frame_rows::FrameRows;
use crate::solve::problem::ColumnGroup;
use crate::storage::SLICE_ROWS;

/// b − A x of every row that is solved for, 0 of masked ones. Returns its squared norms, and those of b with the given values
/// moved into it.
pub(crate) fn posed_residual(
    problem: &ColumnGroup<'_>,
    frames: &FrameRows<'_>,
    x: &[WideLanes],
    out: &mut [Lanes],
) -> [WideLanes; 2] {
    let level = &problem.hierarchy.levels[0];
    let n = level.rows();
    assert!(x.len() == n && out.len() == n && frames.rows.len() == n);
    match &level.weights {
        None => residual_with::<false>(problem, frames, x, out),
        Some(_) => residual_with::<true>(problem, frames, x, out),
    }
}

fn residual_with<const WEIGHTED: bool>(
    problem: &ColumnGroup<'_>,
    frames: &FrameRows<'_>,
    x: &[WideLanes],
    out: &mut [Lanes],
) -> [WideLanes; 2] {
    let (level, mask) = (&problem.hierarchy.levels[0], &problem.system.masks[0]);
    let stiffness = &problem.system.stiffness;
    problem.sums(out, |rows, out| {
        let mut norms = [[0.0; WIDTH]; 2];
        let bundles = out.as_chunks_mut::<SLICE_ROWS>().0.iter_mut();
        for (out, k) in bundles.zip(rows.start / SLICE_ROWS..) {
            let equations = frames.equations::<WEIGHTED>(level, k);
            for ((out, equation), i) in out.iter_mut().zip(equations).zip(k * SLICE_ROWS..) {
                if !mask.free(i) {
                    *out = Lanes::ZERO;
                    continue;
                }
                let (mut r, b) = (equation.residual, equation.rhs);
                if let Some(s) = stiffness.get(i) {
                    r -= Lanes::from_wide(x[i]) * *s as f32;
                }
                *out = r;
                let (r, mut b) = (r.to_wide(), b.to_wide());
                if mask.on_border(i) {
                    problem.move_given(x, i, &mut b);
                }
                for c in 0..WIDTH {
                    norms[0][c] += r[c] * r[c];
                    norms[1][c] += b[c] * b[c];
                }
            }
        }
        norms
    })
}
