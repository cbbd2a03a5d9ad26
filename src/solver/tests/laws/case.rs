//! A graph under constraints, and what tests ask of it.

use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::{Progress, Silent};
use pliant_solver::{
    BuildOptions, Constraints, Error, Hierarchy, InitialGuess, IterationReport, LinearSystem, SolveControl,
    SolveOptions, SolveStats, Workspace,
};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use super::graphs::{SplitMix, TestGraph};

/// A graph with its hierarchy and a constraint set.
pub struct SolverCase {
    pub graph: TestGraph,
    pub fixed: Vec<bool>,
    pub stiffness: Option<Vec<f64>>,
    pub hierarchy: Hierarchy,
    pub system: LinearSystem,
    pub pool: Pool,
}

impl SolverCase {
    pub fn new(graph: TestGraph, fixed: Vec<bool>, stiffness: Option<Vec<f64>>, threads: usize) -> SolverCase {
        graph.view().check().unwrap();
        let pool = Pool::new(threads).unwrap();
        let hierarchy = Hierarchy::build(&graph.view(), &BuildOptions::default(), &Exec::new(&pool, &Silent)).unwrap();
        let constraints = Constraints {
            fixed: &fixed,
            stiffness: stiffness.as_deref(),
        };
        let system = hierarchy.constrain(&constraints, &pool).unwrap();
        SolverCase {
            graph,
            fixed,
            stiffness,
            hierarchy,
            system,
            pool,
        }
    }

    /// Both ends along `axis` are fixed.
    pub fn ends(graph: TestGraph, axis: usize) -> SolverCase {
        let fixed = graph.ends(axis, 0.9);
        SolverCase::new(graph, fixed, None, 1)
    }

    pub fn n(&self) -> usize {
        self.fixed.len()
    }

    pub fn solve(&self, columns: usize, rhs: &[f64], x: &mut [f64], options: &SolveOptions<'_>) -> SolveStats {
        let mut go_on = |_: &IterationReport<'_>| SolveControl::Continue;
        self.watched(columns, rhs, x, options, &Silent, &mut go_on).unwrap()
    }

    /// Solves in a workspace of its own while `progress` allows it; `watch` sees each iteration.
    pub fn watched(
        &self,
        columns: usize,
        rhs: &[f64],
        x: &mut [f64],
        options: &SolveOptions<'_>,
        progress: &dyn Progress,
        watch: &mut dyn FnMut(&IterationReport<'_>) -> SolveControl,
    ) -> Result<SolveStats, Error> {
        let (mut workspace, exec) = (Workspace::default(), Exec::new(&self.pool, progress));
        let equations = self.system.equations(&self.hierarchy, columns, rhs);
        equations.solve(x, options, &mut workspace, &exec, watch)
    }

    /// The residuals that the solver itself finds.
    pub fn own_residuals(&self, columns: usize, rhs: &[f64], x: &[f64]) -> Vec<f64> {
        let equations = self.system.equations(&self.hierarchy, columns, rhs);
        equations.residual(x, None, &self.pool).unwrap()
    }

    /// Solves to `tolerance` from zero.
    pub fn solve_to(&self, columns: usize, rhs: &[f64], x: &mut [f64], tolerance: f64) -> SolveStats {
        self.solve(columns, rhs, x, &to(tolerance))
    }

    /// ‖b − A x‖ / ‖b‖ per column, from the graph alone and independent of the solver.
    pub fn residuals(&self, columns: usize, rhs: &[f64], x: &[f64]) -> Vec<f64> {
        let g = &self.graph;
        let (mut rr, mut bb) = (vec![0.0; columns], vec![0.0; columns]);
        for i in (0..self.n()).filter(|&i| !self.fixed[i]) {
            for c in 0..columns {
                let (mut r, mut b) = (rhs[i * columns + c], rhs[i * columns + c]);
                for (j, w) in g.row(i) {
                    r -= w * (x[i * columns + c] - x[j * columns + c]);
                    if self.fixed[j] {
                        b += w * x[j * columns + c];
                    }
                }
                r -= self.stiffness.as_ref().map_or(0.0, |s| s[i]) * x[i * columns + c];
                rr[c] += r * r;
                bb[c] += b * b;
            }
        }
        rr.iter()
            .zip(&bb)
            .map(|(r, b): (&f64, &f64)| if *r == 0.0 { 0.0 } else { (r / b).sqrt() })
            .collect()
    }

    pub fn without_positions(self) -> SolverCase {
        SolverCase::new(self.graph.without_positions(), self.fixed, self.stiffness, 1)
    }
}

/// Is cancelled at the n-th question.
pub struct CancelAfter(pub AtomicUsize);

impl Progress for CancelAfter {
    fn cancelled(&self) -> bool {
        let asked = self.0.fetch_update(Relaxed, Relaxed, |n| Some(n.saturating_sub(1)));
        asked.unwrap_or(0) == 0
    }
}

/// The full multigrid start.
pub fn full<'a>(frames: Option<&'a [[f32; 9]]>, rest: Option<&'a [[f64; 3]]>) -> InitialGuess<'a> {
    InitialGuess::FullMultigrid { frames, rest }
}

/// A solve to a tolerance from a start.
pub fn started(start: InitialGuess<'_>, tolerance: f64) -> SolveOptions<'_> {
    SolveOptions { start, ..to(tolerance) }
}

pub fn to(tolerance: f64) -> SolveOptions<'static> {
    SolveOptions {
        tolerance: Some(tolerance),
        ..SolveOptions::default()
    }
}

/// Reproducible numbers between −1 and 1.
pub fn noise(count: usize, seed: u64) -> Vec<f64> {
    let mut random = SplitMix::new(seed);
    (0..count).map(|_| 2.0 * random.unit() - 1.0).collect()
}

/// Right-hand side and fixed values of a twisted and stretched body, 3 columns; free rows of x are NaN.
pub fn twist(case: &SolverCase, angle: f64) -> (Vec<f64>, Vec<f64>, Vec<[f32; 9]>) {
    let g = &case.graph;
    let height = g.positions.iter().map(|p| p[2]).fold(1e-9, f64::max);
    let turn = |i: usize| {
        let t = angle * g.positions[i][2] / height;
        (libm::cos(t), libm::sin(t))
    };
    let apply = |(c, s): (f64, f64), v: [f64; 3]| [c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]];
    let (mut rhs, mut x) = (vec![0.0; 3 * case.n()], vec![f64::NAN; 3 * case.n()]);
    let mut frames = Vec::new();
    for i in 0..case.n() {
        let (c, s) = turn(i);
        frames.push([c as f32, s as f32, 0.0, -s as f32, c as f32, 0.0, 0.0, 0.0, 1.0]);
        for (j, w) in g.row(i) {
            let edge = [0, 1, 2].map(|k| g.positions[i][k] - g.positions[j][k]);
            let (a, b) = (apply(turn(i), edge), apply(turn(j), edge));
            for k in 0..3 {
                rhs[3 * i + k] += 0.5 * w * (a[k] + b[k]);
            }
        }
        if case.fixed[i] {
            let p = apply((c, s), g.positions[i]);
            let lift = if g.positions[i][2] > 0.5 * height {
                0.3 * height
            } else {
                0.0
            };
            x[3 * i..3 * i + 3].copy_from_slice(&[p[0], p[1], p[2] + lift]);
        }
    }
    (rhs, x, frames)
}

pub fn largest_distance(columns: usize, a: &[f64], b: &[f64]) -> f64 {
    let distance = |(a, b): (&[f64], &[f64])| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
    a.chunks(columns)
        .zip(b.chunks(columns))
        .map(distance)
        .fold(0.0, f64::max)
}
