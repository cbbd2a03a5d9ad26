//! Conjugate gradients preconditioned by the diagonal, all in double precision: slow, but it needs nothing of the
//! hierarchy. Used when multigrid stagnates.

use std::ops::Range;

use crate::error::Error;
use crate::lanes::{WIDTH, WideLanes, per_lane, ratio};
use crate::options::SolveMethod;
use crate::solve::group::{
    GroupOutcome, GroupSolve, IterationReport, IterationWatcher, SolutionSnapshot, SolveControl,
};
use crate::solve::problem::ColumnGroup;
use pliant_exec::progress::check;

/// Iterations per iteration that the caller allows: they are cheap compared with a cycle.
const ALLOWANCE: usize = 10;
/// The watcher is called, and the true residual looked at, once in this many iterations.
const LOOK: usize = 50;
/// Looks without progress after which rounding is all that is left.
const PATIENCE: usize = 4;

/// Goes on from `outer.workspace.x`.
pub(crate) fn conjugate_gradients(
    outer: &mut GroupSolve<'_, '_>,
    reference: WideLanes,
    mut outcome: GroupOutcome,
    watch: &mut IterationWatcher<'_>,
) -> Result<GroupOutcome, Error> {
    let (problem, pool, criteria) = (outer.problem, outer.pool, outer.criteria);
    let threads = problem.threads;
    let n = problem.hierarchy.levels[0].rows();
    let width = problem.width();
    let [r, p, q] = &mut outer.workspace.wide;
    for v in [&mut *r, &mut *p, &mut *q] {
        v.clear();
        v.resize(n, [0.0; WIDTH]);
    }
    let x = &mut outer.workspace.x;
    let floating = &problem.system.floating;
    outcome.method = SolveMethod::ConjugateGradients;
    let limit = outcome.iterations + criteria.max_iterations.saturating_mul(ALLOWANCE);
    let mut best = f64::INFINITY;
    let mut idle = 0;
    loop {
        // Each run starts from the true residual.
        let norms = threads.run_on(pool, || problem.wide_residual(x, r));
        outcome.relative = per_lane(|c| ratio(norms[c].sqrt(), reference[c]));
        let worst = outcome.relative.iter().fold(0.0f64, |a, &b| a.max(b));
        if norms.iter().any(|v| !v.is_finite()) {
            return Err(Error::Diverged {
                iterations: outcome.iterations,
                residual: best,
            });
        }
        idle = if worst < 0.9 * best { 0 } else { idle + 1 };
        best = best.min(worst);
        outcome.converged = criteria.hold(&outcome.relative[..width], outcome.max_error);
        if outcome.converged || outcome.stopped || idle >= PATIENCE || outcome.iterations >= limit {
            return Ok(outcome);
        }
        check(outer.cycle.progress)?;

        let mut rz_old = [0.0; WIDTH];
        let mut longest = 0.0f64;
        for k in 0..LOOK {
            let rz = diagonal_product(&problem, r);
            let beta = per_lane(|c| if k == 0 { 0.0 } else { ratio(rz[c], rz_old[c]) });
            rz_old = rz;
            let stepped = threads.run_on(pool, || {
                direction(&problem, r, p, beta);
                problem.residual(p, false, q, |v| v.map(|v| -v));
                step(&problem, rz, x, r, p, q)
            });
            longest = longest.max(stepped);
            outcome.iterations += 1;
            check(outer.cycle.progress)?;
            if outcome.iterations >= limit {
                break;
            }
        }
        if !floating.is_empty() {
            // Steps are conjugate to constants up to rounding; what drifted goes back.
            threads.run_on(pool, || floating.remove_wide_means(p));
        }
        let unit = problem.unit[..width].iter().fold(0.0f64, |a, &b| a.max(b));
        // All steps of a run together may still be to come once more.
        outcome.max_error = longest * unit * LOOK as f64;
        let iteration = IterationReport {
            index: outcome.iterations,
            columns: problem.columns(),
            residual: worst,
            max_error: outcome.max_error,
            snapshot: SolutionSnapshot {
                problem,
                x,
                e: None,
                caller: outer.caller,
            },
        };
        outcome.stopped = watch(&iteration) == SolveControl::Stop;
    }
}

/// (r, D⁻¹ r)
fn diagonal_product(problem: &ColumnGroup<'_>, r: &[WideLanes]) -> WideLanes {
    let mask = &problem.system.masks[0];
    let mut sum = [0.0; WIDTH];
    for (r, d) in r.iter().zip(&mask.inverses) {
        for c in 0..WIDTH {
            sum[c] += r[c] * r[c] * f64::from(*d);
        }
    }
    sum
}

/// p = D⁻¹ r + β p
fn direction(problem: &ColumnGroup<'_>, r: &[WideLanes], p: &mut [WideLanes], beta: WideLanes) {
    for ((p, r), d) in p.iter_mut().zip(r).zip(&problem.system.masks[0].inverses) {
        for c in 0..WIDTH {
            p[c] = r[c] * f64::from(*d) + beta[c] * p[c];
        }
    }
}

/// x += α p, r −= α q; returns the largest row of the step.
fn step(
    problem: &ColumnGroup<'_>,
    rz: WideLanes,
    x: &mut [WideLanes],
    r: &mut [WideLanes],
    p: &[WideLanes],
    q: &[WideLanes],
) -> f64 {
    let mut pq = [0.0; WIDTH];
    for (p, q) in p.iter().zip(q) {
        for c in 0..WIDTH {
            pq[c] += p[c] * q[c];
        }
    }
    let alpha = per_lane(|c| ratio(rz[c], pq[c]));
    let longest_of_block = |rows: Range<usize>, (x, r): (&mut [WideLanes], &mut [WideLanes])| {
        let mut longest = 0.0f64;
        for (k, i) in rows.enumerate() {
            let mut length = 0.0;
            for c in 0..WIDTH {
                let s = alpha[c] * p[i][c];
                x[k][c] += s;
                r[k][c] -= alpha[c] * q[i][c];
                length += s * s;
            }
            longest = longest.max(length);
        }
        longest
    };
    let grid = problem.finest();
    grid.fold_blocks(false, (x, r), 0.0, longest_of_block, f64::max).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constrain::system::LinearSystem;
    use crate::error::Error;
    use crate::options::{SolveOptions, SolveStats};
    use crate::solve::group::SolveControl;
    use crate::solve::group::Workspace;
    use crate::testing::{BoxLattice, pool};
    use pliant_exec::Exec;
    use pliant_exec::progress::Silent;

    fn solve(
        block: &BoxLattice,
        break_it: impl Fn(&mut LinearSystem),
        tolerance: f64,
    ) -> (Result<SolveStats, Error>, Vec<f64>) {
        let hierarchy = block.hierarchy(100);
        let mut system = block.system(&hierarchy);
        break_it(&mut system);
        let mut x: Vec<f64> = block.positions.iter().flat_map(|p| [p[1], 1.0]).collect();
        let rhs = vec![0.0; x.len()];
        let options = SolveOptions {
            tolerance: Some(tolerance),
            ..SolveOptions::default()
        };
        let mut workspace = Workspace::default();
        let mut watch = |_: &IterationReport<'_>| SolveControl::Continue;
        let stats = system.equations(&hierarchy, 2, &rhs).solve(
            &mut x,
            &options,
            &mut workspace,
            &Exec::new(&pool(), &Silent),
            &mut watch,
        );
        (stats, x)
    }

    #[test]
    fn a_broken_hierarchy_still_gives_the_solution() {
        let block = BoxLattice::new(12, 10, 10).weighted();
        let (sound, want) = solve(&block, |_| {}, 1e-10);
        assert_eq!(sound.unwrap().method, SolveMethod::Multigrid);
        let scale = |factor: f32| {
            move |system: &mut LinearSystem| system.masks[1].inverses.iter_mut().for_each(|v| *v *= factor)
        };
        let (nan, x) = solve(&block, scale(f32::NAN), 1e-10);
        let nan = nan.unwrap();
        assert!(
            nan.converged && nan.method == SolveMethod::ConjugateGradients,
            "{nan:?}"
        );
        assert!(x.iter().zip(&want).all(|(a, b)| (a - b).abs() < 1e-7));
        // Inner products make up for a coarse level that points the wrong way, or something else takes over.
        let (negative, x) = solve(&block, scale(-1.0), 1e-10);
        assert!(negative.unwrap().converged);
        assert!(x.iter().zip(&want).all(|(a, b)| (a - b).abs() < 1e-7));
    }

    #[test]
    fn what_rounding_forbids_is_reported_not_chased() {
        let (stats, x) = solve(&BoxLattice::new(12, 10, 10), |_| {}, 1e-17);
        let stats = stats.unwrap();
        assert!(stats.residual < 1e-13 && stats.iterations < 100, "{stats:?}");
        assert!(x.iter().all(|v| v.is_finite()));
    }
}
