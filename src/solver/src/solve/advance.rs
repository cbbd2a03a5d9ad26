//! Vector work of the outer iteration: the residual of a run, one step, adding the correction.

use crate::lanes::{Lanes, SLICE_ROWS, WIDTH, WideLanes, per_lane, ratio};
use crate::solve::cycle::{CoarseVectors, MultigridCycle};
use crate::solve::group::FineVectors;
use crate::solve::problem::ColumnGroup;
use crate::solve::sweep::{LaneDots, MaskedLevel, SweepVectors};
use pliant_exec::progress::Cancelled;

/// What one step leaves.
pub(crate) struct StepNorms {
    /// Squared norms of the residual.
    pub(crate) rr: WideLanes,
    /// Squared norms of the correction.
    pub(crate) ee: WideLanes,
    /// Largest row of the step, as a vector of weighted lanes.
    pub(crate) longest: f64,
    /// True if the matrix or the preconditioner looked indefinite to an open lane.
    pub(crate) broken: bool,
}

/// Norms of b, which residuals are compared with.
pub(crate) fn rhs_reference_norms(problem: &ColumnGroup<'_>, x: &[WideLanes]) -> WideLanes {
    let norms = problem.rhs_norms(x);
    let means = problem.system.floating.mean_norms(|i| problem.rhs(i));
    per_lane(|c| (norms[c] - means[c]).max(0.0).sqrt())
}

/// Fills `fine.r` with the residual of an x that is 0 on free rows; returns the squared norms.
pub(crate) fn first_residual(problem: &ColumnGroup<'_>, x: &[WideLanes], fine: &mut FineVectors) -> WideLanes {
    let norms = problem.first_residual(x, &mut fine.r, Lanes::from_wide);
    without_means(problem, fine, [1.0; WIDTH], norms)
}

/// Fills `fine.r` with the residual of x, times `scale`; returns the squared norms without that factor.
pub(crate) fn residual(
    problem: &ColumnGroup<'_>,
    x: &[WideLanes],
    fine: &mut FineVectors,
    scale: WideLanes,
) -> WideLanes {
    let convert = |r: WideLanes| Lanes::from_wide(per_lane(|c| r[c] * scale[c]));
    let norms = problem.residual(x, true, &mut fine.r, convert);
    without_means(problem, fine, scale, norms)
}

/// Takes the means of floating components out of `fine.r`; returns the squared norms of what is left, over `scale`.
fn without_means(problem: &ColumnGroup<'_>, fine: &mut FineVectors, scale: WideLanes, norms: WideLanes) -> WideLanes {
    let floating = &problem.system.floating;
    if floating.is_empty() {
        return norms;
    }
    // Not norms minus means: of a right-hand side that is mostly mean that would leave nothing but rounding.
    floating.remove_means(&mut fine.r);
    let r = &fine.r;
    problem.norms((), |rows, ()| {
        let mut norms = [0.0; WIDTH];
        for r in &r[rows] {
            let r = r.to_wide();
            for c in 0..WIDTH {
                norms[c] += (r[c] / scale[c]) * (r[c] / scale[c]);
            }
        }
        norms
    })
}

/// What holds for one step of conjugate gradients.
pub(crate) struct StepTerms {
    /// The correction begins here, at 0.
    pub(crate) fresh: bool,
    /// The residual after a fresh step is made from the correction itself.
    pub(crate) exact: bool,
    /// 1 for lanes that move, 0 for the others.
    pub(crate) open: WideLanes,
    /// Weights of the lanes in [`StepNorms::longest`].
    pub(crate) weights: WideLanes,
}

/// One iteration: precondition, make the direction conjugate to the last step, step.
///
/// With d the last step, the new one is α (z + β d), β making it conjugate to d. d and A d are kept as differences of
/// corrections and residuals, which saves two vectors' traffic over the usual form.
///
/// `direction` holds (d, A d), if there was a step.
pub(crate) fn step_conjugate(
    cycle: &MultigridCycle<'_>,
    grid: &MaskedLevel<'_>,
    fine: &mut FineVectors,
    coarse: &mut [CoarseVectors],
    direction: &mut Option<WideLanes>,
    terms: &StepTerms,
) -> Result<StepNorms, Cancelled> {
    let lengths = precondition(cycle, grid, fine, coarse, direction, terms)?;
    let (mut rr, ee, longest) = take_step(grid, fine, &lengths, terms);
    if terms.fresh && terms.exact {
        // The first correction is the largest by far. From what single precision makes of it, not from the step that
        // was meant, comes a residual that stays true for longer.
        rr = residual_of_correction(grid, fine);
    }
    Ok(StepNorms {
        rr,
        ee,
        longest,
        broken: lengths.broken,
    })
}

/// The step as a combination of the preconditioned residual and the last step.
struct StepLengths {
    /// True if there was no last step.
    first: bool,
    /// α, of the preconditioned residual.
    alpha: WideLanes,
    /// α β, of the last step.
    gamma: WideLanes,
    /// True if an open lane would go backwards.
    broken: bool,
}

/// Makes z from the residual, and the lengths that make the step conjugate to the last one. `direction` becomes that of the
/// new step.
fn precondition(
    cycle: &MultigridCycle<'_>,
    grid: &MaskedLevel<'_>,
    fine: &mut FineVectors,
    coarse: &mut [CoarseVectors],
    direction: &mut Option<WideLanes>,
    terms: &StepTerms,
) -> Result<StepLengths, Cancelled> {
    let (first, open) = (direction.is_none(), terms.open);
    let FineVectors {
        r,
        z,
        t,
        last_r,
        last_e,
        partials,
        ..
    } = fine;
    let last = (!first).then_some(last_r.as_slice());
    let vectors = SweepVectors { x: z, t, partials };
    let [zr, zv, zl] = cycle.run(0, r, vectors, last, coarse)?;
    let dd = direction.unwrap_or([0.0; WIDTH]);
    let zd = per_lane(|c| if first { 0.0 } else { zl[c] - zr[c] });
    let beta = per_lane(|c| -ratio(zd[c], dd[c]));
    let pp = per_lane(|c| zv[c] + 2.0 * beta[c] * zd[c] + beta[c] * beta[c] * dd[c]);
    // Within a run the last step is orthogonal to r; the true residual that began this one may differ.
    let dr = if terms.fresh && !first {
        inner_product(grid, last_e, r, partials).map(|v| -v)
    } else {
        [0.0; WIDTH]
    };
    let alpha = per_lane(|c| open[c] * ratio(zr[c] + beta[c] * dr[c], pp[c]));
    *direction = Some(per_lane(|c| alpha[c] * alpha[c] * pp[c]));
    Ok(StepLengths {
        first,
        alpha,
        gamma: per_lane(|c| alpha[c] * beta[c]),
        broken: (0..WIDTH).any(|c| open[c] > 0.0 && alpha[c] <= 0.0),
    })
}

/// Takes the step. Returns the squared norms of residual and correction, and the largest row of the step.
fn take_step(
    grid: &MaskedLevel<'_>,
    fine: &mut FineVectors,
    lengths: &StepLengths,
    terms: &StepTerms,
) -> (WideLanes, WideLanes, f64) {
    let FineVectors {
        r,
        z,
        e,
        last_r,
        last_e,
        partials,
        ..
    } = fine;
    let (first, fresh) = (lengths.first, terms.fresh);
    let (alpha, gamma) = (Lanes::from_wide(lengths.alpha), Lanes::from_wide(lengths.gamma));
    let weights = Lanes::from_wide(terms.weights);
    let z = &*z;
    let (r_now, e_now) = (&*r, &*e);
    let next = (last_r.as_mut_slice(), last_e.as_mut_slice());
    let [rr, ee, _] = grid.sum_over_blocks(next, partials, |rows, (r_next, e_next)| {
        let (mut rr, mut ee, mut longest) = (Lanes::ZERO, Lanes::ZERO, 0.0f32);
        let next = r_next.as_chunks_mut::<SLICE_ROWS>().0.iter_mut();
        let next = next.zip(e_next.as_chunks_mut::<SLICE_ROWS>().0);
        let now = r_now[rows.clone()].as_chunks::<SLICE_ROWS>().0.iter();
        let now = now.zip(e_now[rows.clone()].as_chunks::<SLICE_ROWS>().0);
        let made = z[rows.clone()].as_chunks::<SLICE_ROWS>().0;
        for (k, (((r_next, e_next), (r, e)), zs)) in (rows.start / SLICE_ROWS..).zip(next.zip(now).zip(made)) {
            let v = grid.edge_flows(z, k);
            for d in 0..SLICE_ROWS {
                let (step, residual) = if first {
                    (zs[d] * alpha, r[d] - v[d] * alpha)
                } else {
                    let step = zs[d] * alpha + (e[d] - e_next[d]) * gamma;
                    (step, r[d] - v[d] * alpha + (r[d] - r_next[d]) * gamma)
                };
                let correction = if fresh { step } else { e[d] + step };
                r_next[d] = residual;
                e_next[d] = correction;
                rr += residual * residual;
                ee += correction * correction;
                let weighted = step * weights;
                longest = longest.max((weighted * weighted).sum_lanes());
            }
        }
        [rr, ee, Lanes::splat(longest)]
    });
    std::mem::swap(r, last_r);
    std::mem::swap(e, last_e);
    let longest = partials.iter().fold(0.0f32, |a, p| a.max(p[2].0[0]));
    (rr, ee, f64::from(longest).sqrt())
}

/// The residual from the one before and the correction as it is; returns its squared norms.
fn residual_of_correction(grid: &MaskedLevel<'_>, fine: &mut FineVectors) -> WideLanes {
    let FineVectors {
        r, e, last_r, partials, ..
    } = fine;
    let e = &*e;
    let before = &*last_r;
    let [rr, _, _] = grid.sum_over_blocks(r.as_mut_slice(), partials, |rows, r| {
        let before = before[rows.clone()].as_chunks::<SLICE_ROWS>().0;
        let mut rr = Lanes::ZERO;
        for (k, (r, before)) in
            (rows.start / SLICE_ROWS..).zip(r.as_chunks_mut::<SLICE_ROWS>().0.iter_mut().zip(before))
        {
            let v = grid.edge_flows(e, k);
            for d in 0..SLICE_ROWS {
                r[d] = before[d] - v[d];
                rr += r[d] * r[d];
            }
        }
        [rr, Lanes::ZERO, Lanes::ZERO]
    });
    rr
}

fn inner_product(grid: &MaskedLevel<'_>, a: &[Lanes], b: &[Lanes], partials: &mut Vec<LaneDots>) -> WideLanes {
    let [sum, _, _] = grid.sum_over_blocks((), partials, |rows, ()| {
        let mut sum = Lanes::ZERO;
        for (a, b) in a[rows.clone()].iter().zip(&b[rows]) {
            sum += *a * *b;
        }
        [sum, Lanes::ZERO, Lanes::ZERO]
    });
    sum
}

/// Largest row of the last step, as a vector of weighted lanes.
pub(crate) fn longest_step(grid: &MaskedLevel<'_>, fine: &mut FineVectors, weights: WideLanes) -> f64 {
    let weights = Lanes::from_wide(weights);
    let FineVectors {
        e, last_e, partials, ..
    } = fine;
    let (e, last_e) = (&*e, &*last_e);
    grid.sum_over_blocks((), partials, |rows, ()| {
        let mut longest = 0.0f32;
        for (e, last_e) in e[rows.clone()].iter().zip(&last_e[rows]) {
            let step = (*e - *last_e) * weights;
            longest = longest.max((step * step).sum_lanes());
        }
        [Lanes::ZERO, Lanes::ZERO, Lanes::splat(longest)]
    });
    let longest = partials.iter().fold(0.0f32, |a, p| a.max(p[2].0[0]));
    f64::from(longest).sqrt()
}

/// x += e / scale on free rows, and the correction begins at 0 again; residual and direction stay as they are.
pub(crate) fn fold_correction(grid: &MaskedLevel<'_>, fine: &mut FineVectors, scale: WideLanes, x: &mut [WideLanes]) {
    let inverse = per_lane(|c| 1.0 / scale[c]);
    let corrections = (fine.e.as_mut_slice(), fine.last_e.as_mut_slice());
    grid.each_block((x, corrections), |_, _, (x, (e, last_e))| {
        for ((x, e), last_e) in x.iter_mut().zip(e).zip(last_e) {
            *last_e -= *e;
            let e = std::mem::replace(e, Lanes::ZERO).to_wide();
            for c in 0..WIDTH {
                x[c] += e[c] * inverse[c];
            }
        }
    });
}

/// x += e / scale on free rows. Floating components keep their means. Then the correction is 0 again, and `last_e`
/// and `last_r` hold the last step, negative, and A times it.
pub(crate) fn add_correction(
    problem: &ColumnGroup<'_>,
    grid: &MaskedLevel<'_>,
    fine: &mut FineVectors,
    scale: WideLanes,
    x: &mut [WideLanes],
) {
    let FineVectors {
        r, e, last_r, last_e, ..
    } = fine;
    if !problem.system.floating.is_empty() {
        problem.system.floating.remove_means(e);
    }
    let inverse = per_lane(|c| 1.0 / scale[c]);
    let r = &*r;
    let vectors = ((x, e.as_mut_slice()), (last_r.as_mut_slice(), last_e.as_mut_slice()));
    grid.each_block(vectors, |_, rows, ((x, e), (last_r, last_e))| {
        for (k, r) in r[rows].iter().enumerate() {
            last_r[k] -= *r;
            last_e[k] -= e[k];
            let e = std::mem::replace(&mut e[k], Lanes::ZERO).to_wide();
            for c in 0..WIDTH {
                x[k][c] += e[c] * inverse[c];
            }
        }
    });
}

/// After [`add_correction`] and a new residual: makes the differences of residuals and of corrections the last step
/// again, `factor` times as large.
pub(crate) fn resume_direction(
    grid: &MaskedLevel<'_>,
    fine: &mut FineVectors,
    factor: WideLanes,
    direction: &mut Option<WideLanes>,
) {
    let Some(dd) = direction else { return };
    *dd = per_lane(|c| dd[c] * factor[c] * factor[c]);
    let factor = Lanes::from_wide(factor);
    let r = &fine.r;
    let last = (fine.last_r.as_mut_slice(), fine.last_e.as_mut_slice());
    grid.each_block(last, |_, rows, (last_r, last_e)| {
        for (k, r) in r[rows].iter().enumerate() {
            last_r[k] = *r + last_r[k] * factor;
            last_e[k] = last_e[k] * factor;
        }
    });
}
