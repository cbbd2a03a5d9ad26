//! What the solves of earlier poses came to, used for the next one (Fischer 1998).
//!
//! The corrections that consecutive poses of a drag need span a small space. Each is kept with its product with the matrix; the
//! next residual is first freed of what they can explain, the best combination in the energy norm, column by column. It takes
//! two passes over the rows and leaves one iteration or none, where without it there would be two or more.

use crate::lanes::{Lanes, SLICE_ROWS, WIDTH, WideLanes, per_lane, resize_untouched};
use crate::solve::problem::ColumnGroup;
use crate::solve::sweep::{LaneDots, MaskedLevel};

/// Corrections that are kept, and the one that the present pose makes.
const PLACES: usize = 4;
/// By what the error of a pose that needs no iteration may be larger than those of poses that needed one.
const CAUTION: f64 = 1.5;

/// Corrections d of earlier poses with A d.
#[derive(Debug, Default)]
pub(crate) struct SolutionSubspace {
    steps: [SubspaceStep; PLACES],
    /// Those that are known.
    known: [bool; PLACES],
    /// The one that the present pose makes; not known.
    present: usize,
    /// (d_i, A d_j), columns apart.
    products: [[WideLanes; PLACES]; PLACES],
}

#[derive(Debug, Default)]
struct SubspaceStep {
    d: Vec<Lanes>,
    product: Vec<Lanes>,
    /// The largest distance that a vertex was moved by iterations, for a relative residual of 1 before them.
    error_of_residual: Option<f64>,
}

impl SolutionSubspace {
    /// Forgets all of them, as another matrix needs.
    pub(crate) fn forget(&mut self) {
        self.known = [false; PLACES];
    }

    pub(crate) fn byte_size(&self) -> usize {
        self.steps
            .iter()
            .map(|s| 16 * (s.d.capacity() + s.product.capacity()))
            .sum()
    }

    /// Takes out of the residual r what the steps explain, adds it to x, and begins a step of the present pose. Returns the squared
    /// norms of the residual that is left; `None` where nothing is known.
    pub(crate) fn take_out(
        &mut self,
        problem: &ColumnGroup<'_>,
        x: &mut [WideLanes],
        r: &mut [Lanes],
    ) -> Option<WideLanes> {
        let n = r.len();
        let (known, present) = (self.known, self.present);
        let is_any_known = known.contains(&true);
        let factors = match is_any_known {
            true => self.best_combination(problem, r).map(Lanes::from_wide),
            false => [Lanes::ZERO; PLACES],
        };
        let mut step = std::mem::take(&mut self.steps[present]);
        resize_untouched(&mut step.d, n);
        resize_untouched(&mut step.product, n);
        let vectors = ((step.d.as_mut_slice(), step.product.as_mut_slice()), (x, r));
        let steps = &self.steps;
        let norms = problem.norms(vectors, |rows, ((step_d, step_product), (x, r))| {
            let mut norms = Lanes::ZERO;
            let made = step_d.iter_mut().zip(step_product);
            for ((i, (x, r)), (step_d, step_product)) in rows.zip(x.iter_mut().zip(r)).zip(made) {
                let (mut d, mut product) = (Lanes::ZERO, Lanes::ZERO);
                for k in (0..PLACES).filter(|&k| known[k]) {
                    d += steps[k].d[i] * factors[k];
                    product += steps[k].product[i] * factors[k];
                }
                // What is left of the residual in the end is taken off it, which makes it A d.
                *step_product = *r;
                *r -= product;
                norms += *r * *r;
                let wide = d.to_wide();
                (0..WIDTH).for_each(|c| x[c] += wide[c]);
                *step_d = d;
            }
            norms.to_wide()
        });
        self.steps[present] = step;
        is_any_known.then_some(norms)
    }

    /// The factors with which the steps explain most of r.
    fn best_combination(&self, problem: &ColumnGroup<'_>, r: &[Lanes]) -> [WideLanes; PLACES] {
        let known = self.known;
        let steps = &self.steps;
        let right: [WideLanes; PLACES] = problem.sums((), |rows, ()| {
            let mut sums = [Lanes::ZERO; PLACES];
            for i in rows {
                for k in (0..PLACES).filter(|&k| known[k]) {
                    sums[k] += steps[k].d[i] * r[i];
                }
            }
            sums.map(Lanes::to_wide)
        });
        let mut factors = [[0.0; WIDTH]; PLACES];
        for c in 0..WIDTH {
            let matrix = |i: usize, j: usize| self.products[i][j][c];
            let found = solve_small(known, &matrix, &right.map(|r| r[c]));
            (0..PLACES).for_each(|k| factors[k][c] = found[k]);
        }
        factors
    }

    /// Adds a correction e / scale that the present pose got to its step.
    pub(crate) fn add(&mut self, problem: &ColumnGroup<'_>, e: &[Lanes], scale: WideLanes) {
        let inverse = Lanes::from_wide(per_lane(|c| 1.0 / scale[c]));
        let d = self.steps[self.present].d.as_mut_slice();
        problem.norms(d, |rows, d| {
            d.iter_mut().zip(&e[rows]).for_each(|(d, e)| *d += *e * inverse);
            [0.0; WIDTH]
        });
    }

    /// Makes the present residual, times `scale`, from the one that the pose began with and the step so far: half the work of making it
    /// from frames and positions in double precision, and as exact as the first one was while steps are short. Returns its squared
    /// norms and those of the step.
    pub(crate) fn residual(
        &self,
        grid: &MaskedLevel<'_>,
        out: &mut [Lanes],
        partials: &mut Vec<LaneDots>,
        scale: WideLanes,
    ) -> [WideLanes; 2] {
        let SubspaceStep { d, product: before, .. } = &self.steps[self.present];
        let scale_by = Lanes::from_wide(scale);
        let [squares, lengths, _] = grid.sum_over_blocks(out, partials, |rows, out| {
            let (mut squares, mut lengths) = (Lanes::ZERO, Lanes::ZERO);
            let slices = out.as_chunks_mut::<SLICE_ROWS>().0.iter_mut();
            for (k, out) in (rows.start / SLICE_ROWS..).zip(slices) {
                let flows = grid.edge_flows(d, k);
                for (n, out) in out.iter_mut().enumerate() {
                    let i = k * SLICE_ROWS + n;
                    let left = before[i] - flows[n];
                    squares += left * left;
                    lengths += d[i] * d[i];
                    *out = left * scale_by;
                }
            }
            [squares, lengths, Lanes::ZERO]
        });
        [squares, lengths]
    }

    /// The error that a pose is expected to have whose relative residual is this before any iteration: the largest that those of
    /// the known steps would have had. Residuals of one norm differ much in how far vertices are off.
    pub(crate) fn expected_error(&self, relative: f64) -> Option<f64> {
        let known = self.steps.iter().zip(self.known).filter(|step| step.1);
        let errors = known.filter_map(|(step, _)| step.error_of_residual);
        errors.reduce(f64::max).map(|error| error * relative * CAUTION)
    }

    /// Ends the present pose, whose residual is now r / scale: its step is known from here on, and the oldest one is not.
    /// Iterations moved a vertex by `moved` at most, from a relative residual of `relative`.
    pub(crate) fn keep(&mut self, problem: &ColumnGroup<'_>, r: &[Lanes], scale: WideLanes, moved: f64, relative: f64) {
        let inverse = Lanes::from_wide(per_lane(|c| 1.0 / scale[c]));
        let present = self.present;
        self.steps[present].error_of_residual = (relative > 0.0).then(|| moved / relative);
        self.known[present] = true;
        let known = self.known;
        let mut product = std::mem::take(&mut self.steps[present].product);
        let steps = &self.steps;
        let sums: [WideLanes; PLACES] = problem.sums(product.as_mut_slice(), |rows, product| {
            let mut sums = [Lanes::ZERO; PLACES];
            for (i, product) in rows.zip(product) {
                *product -= r[i] * inverse;
                for k in (0..PLACES).filter(|&k| known[k]) {
                    sums[k] += steps[k].d[i] * *product;
                }
            }
            sums.map(Lanes::to_wide)
        });
        self.steps[present].product = product;
        for (k, sum) in sums.into_iter().enumerate() {
            self.products[k][present] = sum;
            self.products[present][k] = sum;
        }
        self.present = (present + 1) % PLACES;
        self.known[self.present] = false;
    }
}

/// Solves a small symmetric system in the unknowns of `known`; directions that depend on others get 0.
fn solve_small(known: [bool; PLACES], matrix: &dyn Fn(usize, usize) -> f64, right: &[f64; PLACES]) -> [f64; PLACES] {
    /// A pivot below this part of its diagonal is rounding.
    const DEPENDENT: f64 = 1e-4;
    let mut a: [[f64; PLACES]; PLACES] = std::array::from_fn(|i| std::array::from_fn(|j| matrix(i, j)));
    let mut b = *right;
    let mut used = [false; PLACES];
    for p in (0..PLACES).filter(|&p| known[p]) {
        let diagonal = matrix(p, p);
        used[p] = a[p][p].is_finite() && b[p].is_finite() && diagonal > 0.0 && a[p][p] > DEPENDENT * diagonal;
        if !used[p] {
            continue;
        }
        for i in (0..PLACES).filter(|&i| i != p && known[i]) {
            let factor = a[i][p] / a[p][p];
            for j in 0..PLACES {
                a[i][j] -= factor * a[p][j];
            }
            b[i] -= factor * b[p];
        }
    }
    std::array::from_fn(|p| match used[p] {
        true => Some(b[p] / a[p][p]).filter(|v| v.is_finite()).unwrap_or(0.0),
        false => 0.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::NO_ROW;
    use crate::options::Constraints;
    use crate::solve::pose::{PoseParts, PoseRows};
    use crate::solve::problem::posed_residual;
    use crate::testing::{BoxLattice, pool};
    use crate::threads::Parallelism;

    #[test]
    fn a_residual_follows_the_steps_of_a_pose() {
        let block = BoxLattice::new(14, 10, 9).weighted();
        let (hierarchy, pool) = (block.hierarchy(60), pool());
        let fixed: Vec<bool> = block.positions.iter().map(|p| p[0] == 0.0).collect();
        let stiffness: Vec<f64> = block.positions.iter().map(|p| 0.3 * p[1]).collect();
        let constraints = Constraints {
            fixed: &fixed,
            stiffness: Some(&stiffness),
        };
        let system = hierarchy.constrain(&constraints, &pool).unwrap();
        let rest = |v: usize| block.positions[v].map(|x| x / 14.0);
        let bent = |v: usize| {
            let [x, y, z] = rest(v);
            [x, y + 0.2 * x * x, z]
        };
        let mut pose = PoseRows::default();
        pose.begin(&hierarchy, rest, bent, &pool);
        pose.show_positions(&pool);
        let threads = Parallelism::from_pool(&pool);
        let PoseParts { frames, x, .. } = pose.parts(&hierarchy);
        let problem = ColumnGroup::of_pose(&hierarchy, &system, threads, frames);
        let grid = MaskedLevel::new(&hierarchy.levels[0], &system.masks[0], threads);
        let n = x.len();
        let mut r = vec![Lanes::ZERO; n];
        posed_residual(&problem, &frames, x, &mut r);
        let mut recalled = SolutionSubspace::default();
        recalled.take_out(&problem, x, &mut r);

        let scale = [4.0, 2.0, 1.0, 1.0];
        let mut length = 0.0;
        for round in 0..2 {
            let mut e = vec![Lanes::ZERO; n];
            for (i, &v) in hierarchy.order.iter().enumerate().filter(|(_, v)| **v != NO_ROW) {
                if !fixed[v as usize] {
                    e[i] = Lanes([0.01, -0.02, 0.03, 0.0]) * libm::sinf((v + round) as f32);
                }
                (0..3).for_each(|c| x[i][c] += f64::from(e[i].0[c]) / scale[c]);
            }
            recalled.add(&problem, &e, scale);
        }
        for d in &recalled.steps[recalled.present].d {
            length += f64::from(d.0[1]).powi(2);
        }
        let mut followed = vec![Lanes::ZERO; n];
        let [squares, lengths] = recalled.residual(&grid, &mut followed, &mut Vec::new(), [8.0; WIDTH]);
        let mut truth = vec![[0.0; WIDTH]; n];
        let norms = problem.residual(x, true, &mut truth, |r| r);
        for c in 0..3 {
            assert!(
                (squares[c] - norms[c]).abs() < 1e-5 * norms[c],
                "{squares:?}, in truth {norms:?}"
            );
            for (followed, truth) in followed.iter().zip(&truth) {
                let off = (f64::from(followed.0[c]) / 8.0 - truth[c]).abs();
                assert!(off < 1e-5 * norms[c].sqrt(), "column {c} is off by {off:.1e}");
            }
        }
        assert!((lengths[1] - length).abs() < 1e-5 * length && length > 0.0);
    }

    #[test]
    fn small_systems_are_solved_and_dependent_directions_left_out() {
        let m = [
            [4.0, 1.0, 8.0, 9.0],
            [1.0, 3.0, 2.0, 9.0],
            [8.0, 2.0, 16.0, 9.0],
            [9.0; 4],
        ];
        let known = [true, true, true, false];
        let found = solve_small(known, &|i, j| m[i][j], &[6.0, 7.0, 12.0, 1.0]);
        // The third is twice the first.
        assert_eq!(found[2..], [0.0, 0.0]);
        assert!(
            (found[0] - 1.0).abs() < 1e-12 && (found[1] - 2.0).abs() < 1e-12,
            "{found:?}"
        );
        assert_eq!(solve_small([false; 4], &|_, _| f64::NAN, &[1.0; 4]), [0.0; 4]);
        assert_eq!(solve_small([true; 4], &|_, _| f64::NAN, &[1.0; 4]), [0.0; 4]);
    }
}
