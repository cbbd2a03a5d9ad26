//! The free system alone, as the peers see it: set-up, solves from zero, memory.

use super::clock::{self, Times};
use super::figures::Figures;
use super::matrix::Laplacian;
use super::memory;
use super::problem::Problem;
use super::solver::{EXACT, Ready, Terms, failed, farthest, to_residual};
use crate::Failure;
use pliant::exec::Exec;
use pliant::progress::Silent;
use pliant::solver::{BuildOptions, Constraints, Graph, Hierarchy, Method, SolveOptions, Start, Workspace};
use sha2::{Digest, Sha256};

/// How far above its tolerance a recomputed residual may be, as for the peers.
const SLACK: f64 = 1.0001;
/// Residual down to which the convergence factor is observed.
const FACTOR: f64 = 1e-8;

/// Measures; false when a residual does not hold. `base` is what was resident once the problem was loaded.
pub(super) fn measure(problem: &Problem, base: u64, terms: &Terms, figures: &mut Figures) -> Result<bool, Failure> {
    let (graph, convert) = clock::timed(|| problem.matrix.laplacian());
    let graph = graph.map_err(Failure::Usage)?;
    figures.measured("convert_s", convert);
    let (ready, first) = clock::timed(|| set_up(&graph, problem, terms));
    let (ready, mut setup) = (ready?, Times::one(first));
    let mut workspace = Workspace::default();

    let n = problem.matrix.rows();
    let mut solutions = Vec::new();
    for (tag, tolerance) in [("3", 1e-3), ("5", 1e-5)] {
        let options = to_residual(tolerance);
        let zero = || vec![[0.0; 3]; n];
        let (x, stats, times) = ready.race(&problem.rhs, zero, &options, &mut workspace, terms)?;
        figures.measured(&format!("solve{tag}_s"), times.best);
        figures.measured(&format!("solve{tag}_first_s"), times.first);
        solutions.push((tag, tolerance, x, stats, times.best));
    }
    let peak = memory::peak();
    figures.megabytes("rss_peak_MB", peak as f64);
    figures.megabytes("peak_over_base_MB", peak as f64 - base as f64);
    note_memory(&ready, &workspace, problem, figures);

    // Set-up again, each time after the one before is gone.
    let mut ready = Some(ready);
    for _ in 1..terms.repeat {
        if !setup.may_repeat() {
            break;
        }
        drop(ready.take());
        let (again, seconds) = clock::timed(|| set_up(&graph, problem, terms));
        ready = Some(again?);
        setup.add(seconds);
    }
    let ready = match ready {
        Some(ready) => ready,
        None => set_up(&graph, problem, terms)?,
    };
    figures.measured("setup_s", setup.best);
    figures.measured("setup_first_s", setup.first);

    let mut good = true;
    for (tag, tolerance, x, stats, _) in &solutions {
        let (each, all) = problem.matrix.residuals(&problem.rhs, x);
        let largest = each.into_iter().fold(0.0, f64::max);
        good &= largest <= SLACK * tolerance;
        let it = stats.iterations;
        figures.set(&format!("it{tag}"), format!("{it}/{it}/{it}"));
        figures.measured(&format!("res{tag}"), largest);
        figures.measured(&format!("resF{tag}"), all);
    }
    figures.set("status", if good { "ok" } else { "residual above tolerance" });
    note_units(
        &solutions.iter().map(|s| (s.3.iterations, s.4)).collect::<Vec<_>>(),
        figures,
    );
    if let Some((.., x, stats, _)) = solutions.last() {
        figures.set("method", method(stats.method));
        figures.set("digest", digest(x));
        note_errors(problem, &ready, &solutions[0].2, x, &mut workspace, terms, figures)?;
    }
    Ok(good)
}

/// From the matrix as a graph to ready: the hierarchy, then the stiffness of the tied rows.
fn set_up(graph: &Laplacian, problem: &Problem, terms: &Terms) -> Result<Ready, Failure> {
    let view = Graph {
        offsets: &graph.offsets,
        neighbours: &graph.neighbours,
        weights: graph.weights.as_deref(),
        positions: Some(&problem.rest),
    };
    let hierarchy =
        Hierarchy::build(&view, &BuildOptions::default(), &Exec::new(&terms.pool, &Silent)).map_err(failed)?;
    let constraints = Constraints {
        fixed: &vec![false; graph.stiffness.len()],
        stiffness: Some(&graph.stiffness),
    };
    let system = hierarchy.constrain(&constraints, &terms.pool).map_err(failed)?;
    Ok(Ready { hierarchy, system })
}

fn note_memory(ready: &Ready, workspace: &Workspace, problem: &Problem, figures: &mut Figures) {
    let held = (ready.hierarchy.bytes() + ready.system.bytes()) as f64;
    let matrix = problem.matrix.bytes() as f64;
    figures.megabytes("mem_MB", held);
    figures.set("mem_what", "reported by the solver");
    figures.measured("mem_ratio", held / matrix);
    figures.measured("mem_all_ratio", (held + workspace.bytes() as f64) / matrix);
    let levels = ready.hierarchy.levels();
    figures.set("levels", levels.len());
    let vertices: Vec<usize> = levels.iter().map(|l| l.vertices).collect();
    figures.set("level_vertices", vertices);
    let edges: usize = levels.iter().map(|l| l.edges).sum();
    figures.measured("complexity", edges as f64 / levels[0].edges.max(1) as f64);
}

/// Everything in work units, and the cost of one iteration from the two solves (iterations, seconds).
fn note_units(solves: &[(usize, f64)], figures: &mut Figures) {
    let unit = figures.number("wu_s").unwrap_or(f64::NAN);
    for key in ["setup", "solve3", "solve5"] {
        if let Some(seconds) = figures.number(&format!("{key}_s")) {
            figures.measured(&format!("{key}_wu"), seconds / unit);
        }
    }
    if let [(it3, s3), (it5, s5)] = solves
        && it5 > it3
    {
        figures.measured("iter_wu", (s5 - s3) / (it5 - it3) as f64 / unit);
    }
}

/// The convergence factor, and how far the two solutions are from the exact one.
fn note_errors(
    problem: &Problem,
    ready: &Ready,
    x3: &[[f64; 3]],
    x5: &[[f64; 3]],
    workspace: &mut Workspace,
    terms: &Terms,
    figures: &mut Figures,
) -> Result<(), Failure> {
    let mut residuals = Vec::new();
    let mut x = vec![[0.0; 3]; x5.len()];
    let options = to_residual(FACTOR);
    ready.solve(&problem.rhs, &mut x, &options, workspace, terms, Some(&mut residuals))?;
    // The first iteration mostly takes away what zero is wrong by everywhere; the rest tell the rate.
    if let [first, .., last] = residuals[..] {
        figures.measured("factor", (last / first).powf(1.0 / (residuals.len() - 1) as f64));
    }
    if terms.fast {
        return Ok(());
    }
    let options = SolveOptions {
        start: Start::Given,
        ..to_residual(EXACT)
    };
    let stats = ready.solve(&problem.rhs, &mut x, &options, workspace, terms, None)?;
    let diagonal = diagonal(&problem.rest);
    figures.measured("err3", farthest(x3, &x) / diagonal);
    figures.measured("err5", farthest(x5, &x) / diagonal);
    figures.measured("exact_res", stats.residual);
    Ok(())
}

/// Length of the bounding box diagonal; 1 for a point.
fn diagonal(points: &[[f64; 3]]) -> f64 {
    let side = |c: usize| {
        let range = points
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| {
                (low.min(p[c]), high.max(p[c]))
            });
        range.1 - range.0
    };
    let length = (0..3).map(|c| side(c) * side(c)).sum::<f64>().sqrt();
    if length > 0.0 { length } else { 1.0 }
}

fn method(method: Method) -> &'static str {
    match method {
        Method::Trivial => "trivial",
        Method::Direct => "direct",
        Method::Multigrid => "multigrid",
        Method::PaperCycles => "paper-cycles",
        Method::ConjugateGradients => "conjugate-gradients",
    }
}

/// SHA-256 of the bits of a solution, to compare runs on different numbers of threads.
fn digest(x: &[[f64; 3]]) -> String {
    let mut hasher = Sha256::new();
    for row in x {
        row.iter().for_each(|v| hasher.update(v.to_bits().to_le_bytes()));
    }
    hasher.finalize().iter().map(|b| format!("{b:02x}")).collect()
}
