//! Vector work of the outer iteration: the residual of a stretch, one step, adding the correction.

use super::cycle::{Coarse, Cycle, per_lane, ratio};
use super::lanes::{Lanes, Shared, WIDTH, Wide};
use super::problem::Problem;
use super::sweep::{Dots, Grid};
use super::workspace::Fine;
use crate::progress::Cancelled;

/// What one step leaves.
pub(crate) struct Advance {
    /// Squared norms of the residual.
    pub(crate) rr: Wide,
    /// Squared norms of the correction.
    pub(crate) ee: Wide,
    /// Largest row of the step, as a vector of weighted lanes.
    pub(crate) longest: f64,
    /// True if the matrix or the preconditioner looked indefinite to an open lane.
    pub(crate) broken: bool,
}

/// Norms of b, which residuals are compared with.
pub(crate) fn reference(problem: &Problem<'_>, x: &[Wide]) -> Wide {
    let norms = problem.rhs_norms(x);
    let means = problem.system.floating.mean_norms(|i| problem.rhs(i));
    per_lane(|c| (norms[c] - means[c]).max(0.0).sqrt())
}

/// Fills `fine.r` with the residual of x, times `scale`; returns the squared norms without that factor.
pub(crate) fn residual(problem: &Problem<'_>, x: &[Wide], fine: &mut Fine, scale: Wide) -> Wide {
    let convert = |r: Wide| Lanes::from_wide(per_lane(|c| r[c] * scale[c]));
    let norms = problem.residual(x, true, &mut fine.r, convert);
    let floating = &problem.system.floating;
    if floating.is_empty() {
        return norms;
    }
    // Not norms minus means: of a right-hand side that is mostly mean that would leave nothing but rounding.
    floating.remove_means(&mut fine.r);
    let r = &fine.r;
    problem.norms(|rows| {
        let mut norms = [0.0; WIDTH];
        for r in &r[rows] {
            let r = r.wide();
            for c in 0..WIDTH {
                norms[c] += (r[c] / scale[c]) * (r[c] / scale[c]);
            }
        }
        norms
    })
}

/// One iteration: precondition, make the direction conjugate to the last one, step.
///
/// `direction` holds (p, A p) of the last direction, if there was one. `fresh`: the correction begins here. Lanes
/// that are not `open` do not move. `weights` are those of [`Advance::longest`].
pub(crate) fn advance(
    cycle: &Cycle<'_>,
    grid: &Grid<'_>,
    fine: &mut Fine,
    coarse: &mut [Coarse],
    direction: &mut Option<Wide>,
    fresh: bool,
    open: Wide,
    weights: Wide,
) -> Result<Advance, Cancelled> {
    cycle.run(0, &fine.r, &mut fine.z, &mut fine.t, coarse)?;
    let last_q = direction.is_some().then_some(fine.q.as_slice());
    let [zr, zv, zq] = grid.apply(&fine.z, &mut fine.t, &fine.r, last_q, &mut fine.partials);
    let first = direction.is_none();
    // p = z + β p, conjugate to the last p; (p, A p) follows from products that are known.
    let last = direction.unwrap_or([0.0; WIDTH]);
    let beta = per_lane(|c| if first { 0.0 } else { -ratio(zq[c], last[c]) });
    let pq = per_lane(|c| {
        if first {
            zv[c]
        } else {
            zv[c] + 2.0 * beta[c] * zq[c] + beta[c] * beta[c] * last[c]
        }
    });
    // Within a stretch the last p is orthogonal to r; the true residual that began this one may differ.
    let pr = if fresh && !first {
        inner_product(grid, &fine.p, &fine.r, &mut fine.partials)
    } else {
        [0.0; WIDTH]
    };
    let alpha = per_lane(|c| open[c] * ratio(zr[c] + beta[c] * pr[c], pq[c]));
    let broken = (0..WIDTH).any(|c| open[c] > 0.0 && alpha[c] <= 0.0);
    *direction = Some(pq);
    let (beta, alpha) = (Lanes::from_wide(beta), Lanes::from_wide(alpha));
    let weights = Lanes::from_wide(weights);

    let Fine {
        r,
        z,
        t,
        p,
        q,
        e,
        partials,
    } = fine;
    let (z, t) = (&*z, &*t);
    let (r, p, q, e) = (Shared::new(r), Shared::new(p), Shared::new(q), Shared::new(e));
    let [rr, ee, _] = grid.dots(partials, |rows| {
        // SAFETY: blocks are disjoint and each is visited once.
        let (r, p, q, e) = unsafe {
            (
                r.rows(rows.clone()),
                p.rows(rows.clone()),
                q.rows(rows.clone()),
                e.rows(rows.clone()),
            )
        };
        let (z, t) = (&z[rows.clone()], &t[rows]);
        let (mut rr, mut ee, mut longest) = (Lanes::ZERO, Lanes::ZERO, 0.0f32);
        for i in 0..z.len() {
            (p[i], q[i]) = if first {
                (z[i], t[i])
            } else {
                (z[i] + p[i] * beta, t[i] + q[i] * beta)
            };
            let step = p[i] * alpha;
            e[i] = if fresh { step } else { e[i] + step };
            r[i] -= q[i] * alpha;
            rr += r[i] * r[i];
            ee += e[i] * e[i];
            let weighted = step * weights;
            longest = longest.max((weighted * weighted).sum());
        }
        [rr, ee, Lanes::splat(longest)]
    });
    let longest = partials.iter().fold(0.0f32, |a, p| a.max(p[2].0[0]));
    Ok(Advance {
        rr,
        ee,
        longest: f64::from(longest).sqrt(),
        broken,
    })
}

fn inner_product(grid: &Grid<'_>, a: &[Lanes], b: &[Lanes], partials: &mut Vec<Dots>) -> Wide {
    let [sum, _, _] = grid.dots(partials, |rows| {
        let mut sum = Lanes::ZERO;
        for (a, b) in a[rows.clone()].iter().zip(&b[rows]) {
            sum += *a * *b;
        }
        [sum, Lanes::ZERO, Lanes::ZERO]
    });
    sum
}

/// x += e / scale on free rows. Floating components keep their means.
pub(crate) fn add_correction(problem: &Problem<'_>, grid: &Grid<'_>, e: &mut [Lanes], scale: Wide, x: &mut [Wide]) {
    if !problem.system.floating.is_empty() {
        problem.system.floating.remove_means(e);
    }
    let e = &*e;
    let x = Shared::new(x);
    grid.each_block(|_, rows| {
        // SAFETY: blocks are disjoint and each is visited once.
        let x = unsafe { x.rows(rows.clone()) };
        for (x, e) in x.iter_mut().zip(&e[rows]) {
            let e = e.wide();
            for c in 0..WIDTH {
                x[c] += e[c] / scale[c];
            }
        }
    });
}
