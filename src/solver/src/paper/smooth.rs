//! The smoothing operator (7), residuals, and the conjugate-gradient steps of section 6.

use crate::lanes::{WIDTH, WideLanes, per_lane, ratio};
use crate::paper::level::{LevelEquations, PaperLevel};
use crate::paper::restrict::add;
use pliant_exec::progress::{Cancelled, Progress, check};

/// Sets x_i to what its equation says, given the present neighbours (7).
#[inline]
fn relax(level: &PaperLevel, equations: &LevelEquations, b: &[WideLanes], x: &mut [WideLanes], i: usize) {
    let diagonal = equations.diagonal[i];
    if diagonal > 0.0 {
        let mut sum = b[i];
        for (e, j) in level.edges(i) {
            add(&mut sum, equations.weights[e], x[j]);
        }
        x[i] = sum.map(|v| v / diagonal);
    }
}

/// One Gauss–Seidel sweep in storage order.
pub(super) fn sweep(level: &PaperLevel, equations: &LevelEquations, b: &[WideLanes], x: &mut [WideLanes]) {
    for i in 0..level.vertices() {
        relax(level, equations, b, x, i);
    }
}

/// One Gauss–Seidel sweep against storage order. The paper sweeps one way only; the other way makes the conjugate
/// gradients' preconditioner symmetric.
fn sweep_back(level: &PaperLevel, equations: &LevelEquations, b: &[WideLanes], x: &mut [WideLanes]) {
    for i in (0..level.vertices()).rev() {
        relax(level, equations, b, x, i);
    }
}

/// The defect ζ of (16) in terms of b = β + Σ w d: b_i − Σ_j w_ij (x_i − x_j) − α_i x_i.
pub(super) fn defect(
    level: &PaperLevel,
    equations: &LevelEquations,
    b: &[WideLanes],
    x: &[WideLanes],
    out: &mut [WideLanes],
) {
    for i in 0..level.vertices() {
        let mut r = b[i];
        add(&mut r, -equations.alphas[i], x[i]);
        for (e, j) in level.edges(i) {
            for c in 0..WIDTH {
                r[c] -= equations.weights[e] * (x[i][c] - x[j][c]);
            }
        }
        out[i] = r;
    }
}

/// Conjugate-gradient steps, with their vectors.
#[derive(Debug, Default)]
pub(super) struct ConjugateSteps {
    /// How many steps one run takes.
    steps: usize,
    r: Vec<WideLanes>,
    z: Vec<WideLanes>,
    p: Vec<WideLanes>,
    q: Vec<WideLanes>,
}

impl ConjugateSteps {
    pub(super) fn new(steps: usize) -> Self {
        Self {
            steps,
            ..Self::default()
        }
    }

    /// Improves `x` by all steps of conjugate gradients, all columns with their own step lengths.
    pub(super) fn run(
        &mut self,
        level: &PaperLevel,
        equations: &LevelEquations,
        b: &[WideLanes],
        x: &mut [WideLanes],
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        if self.steps == 0 {
            return Ok(());
        }
        let n = level.vertices();
        let ConjugateSteps { steps, r, z, p, q } = self;
        for v in [&mut *r, &mut *z, &mut *p, &mut *q] {
            v.clear();
            v.resize(n, [0.0; WIDTH]);
        }
        let still = vec![[0.0; WIDTH]; n];
        defect(level, equations, b, x, r);
        let mut last = [0.0; WIDTH];
        for _ in 0..*steps {
            check(progress)?;
            z.fill([0.0; WIDTH]);
            sweep(level, equations, r, z);
            sweep_back(level, equations, r, z);
            let product = dot(r, z);
            let beta = per_lane(|c| ratio(product[c], last[c]));
            last = product;
            for (p, z) in p.iter_mut().zip(&*z) {
                for c in 0..WIDTH {
                    p[c] = z[c] + beta[c] * p[c];
                }
            }
            // b − A p for b = 0.
            defect(level, equations, &still, p, q);
            let energy = dot(p, q);
            let length = per_lane(|c| ratio(product[c], -energy[c]));
            for i in 0..n {
                for c in 0..WIDTH {
                    x[i][c] += length[c] * p[i][c];
                    r[i][c] += length[c] * q[i][c];
                }
            }
        }
        Ok(())
    }
}

fn dot(a: &[WideLanes], b: &[WideLanes]) -> WideLanes {
    let mut sum = [0.0; WIDTH];
    for (a, b) in a.iter().zip(b) {
        for c in 0..WIDTH {
            sum[c] += a[c] * b[c];
        }
    }
    sum
}
