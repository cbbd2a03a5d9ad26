//! The free system alone, as the peers see it: set-up, solves from zero, memory.

use super::problem::{GraphLaplacian, LinearProblem};
use super::ready::{BenchTerms, EXACT_RESIDUAL, ReadySystem, largest_distance, options_to_residual, peak_bytes};
use crate::failure::LoadtestFailure;
use crate::measurements::{Measurements, RunTimes, time_once};
use pliant::solver::{
    BuildOptions, Constraints, InitialGuess, IterationReport, SolveMethod, SolveOptions, WeightedGraph,
};
use sha2::{Digest, Sha256};

/// How far above its tolerance a recomputed residual may be, as for the peers.
const SLACK: f64 = 1.0001;
/// Residual down to which the convergence factor is observed.
const FACTOR: f64 = 1e-8;

/// Measures the free system; the answer is false when a residual does not hold. `base` is what was resident once the problem was loaded.
pub(super) fn measure_free_system(
    problem: &LinearProblem,
    base: u64,
    terms: &BenchTerms,
    measurements: &mut Measurements,
) -> Result<bool, LoadtestFailure> {
    let (graph, convert) = time_once(|| problem.matrix.laplacian());
    let graph = graph.map_err(LoadtestFailure::Usage)?;
    measurements.set_number("convert_s", convert);
    let (ready, first) = time_once(|| build_ready_system(&graph, problem, terms));
    let (mut ready, mut setup) = (ready?, RunTimes::from_one(first));

    let n = problem.matrix.rows();
    let mut solutions = Vec::new();
    for (tag, tolerance) in [("3", 1e-3), ("5", 1e-5)] {
        let options = options_to_residual(tolerance);
        let zero = || vec![[0.0; 3]; n];
        let (x, stats, times) = ready.solve_and_time(&problem.rhs, zero, &options)?;
        measurements.set_number(&format!("solve{tag}_s"), times.best);
        measurements.set_number(&format!("solve{tag}_first_s"), times.first);
        solutions.push((tag, tolerance, x, stats, times.best));
    }
    let peak = peak_bytes();
    measurements.set_megabytes("rss_peak_MB", peak as f64);
    measurements.set_megabytes("peak_over_base_MB", peak as f64 - base as f64);
    note_memory(&ready, problem, measurements);

    // Set-up again, each time after the one before is gone.
    let mut ready = Some(ready);
    for _ in 1..terms.repeat {
        if !setup.may_repeat() {
            break;
        }
        drop(ready.take());
        let (again, seconds) = time_once(|| build_ready_system(&graph, problem, terms));
        ready = Some(again?);
        setup.add_run(seconds);
    }
    let mut ready = match ready {
        Some(ready) => ready,
        None => build_ready_system(&graph, problem, terms)?,
    };
    measurements.set_number("setup_s", setup.best);
    measurements.set_number("setup_first_s", setup.first);

    let mut good = true;
    for (tag, tolerance, x, stats, _) in &solutions {
        let (each, all) = problem.matrix.residuals(&problem.rhs, x);
        let largest = each.into_iter().fold(0.0, f64::max);
        good &= largest <= SLACK * tolerance;
        let it = stats.iterations;
        measurements.set_value(&format!("it{tag}"), format!("{it}/{it}/{it}"));
        measurements.set_number(&format!("res{tag}"), largest);
        measurements.set_number(&format!("resF{tag}"), all);
    }
    measurements.set_value("status", if good { "ok" } else { "residual above tolerance" });
    note_units(
        &solutions.iter().map(|s| (s.3.iterations, s.4)).collect::<Vec<_>>(),
        measurements,
    );
    if let Some((.., x, stats, _)) = solutions.last() {
        measurements.set_value("method", method_name(stats.method));
        measurements.set_value("digest", solution_digest(x));
        note_errors(problem, &mut ready, &solutions[0].2, x, measurements)?;
    }
    Ok(good)
}

/// Builds the hierarchy of the matrix as a graph, then the stiffness of the tied rows.
fn build_ready_system<'a>(
    graph: &GraphLaplacian,
    problem: &LinearProblem,
    terms: &'a BenchTerms,
) -> Result<ReadySystem<'a>, LoadtestFailure> {
    let view = WeightedGraph {
        offsets: &graph.offsets,
        neighbours: &graph.neighbours,
        weights: graph.weights.as_deref(),
        positions: Some(&problem.rest),
    };
    let constraints = Constraints {
        fixed: &vec![false; graph.stiffness.len()],
        stiffness: Some(&graph.stiffness),
    };
    ReadySystem::build(&view, &BuildOptions::default(), &constraints, terms)
}

fn note_memory(ready: &ReadySystem<'_>, problem: &LinearProblem, measurements: &mut Measurements) {
    let held = (ready.hierarchy.byte_size() + ready.system.byte_size()) as f64;
    let matrix = problem.matrix.byte_size() as f64;
    measurements.set_megabytes("mem_MB", held);
    measurements.set_value("mem_what", "reported by the solver");
    measurements.set_number("mem_ratio", held / matrix);
    measurements.set_number("mem_all_ratio", (held + ready.workspace.byte_size() as f64) / matrix);
    let levels = ready.hierarchy.level_sizes();
    measurements.set_value("levels", levels.len());
    let vertices: Vec<usize> = levels.iter().map(|l| l.vertices).collect();
    measurements.set_value("level_vertices", vertices);
    let edges: usize = levels.iter().map(|l| l.edges).sum();
    measurements.set_number("complexity", edges as f64 / levels[0].edges.max(1) as f64);
}

/// Notes everything in work units, and the cost of one iteration from the two solves (iterations, seconds).
fn note_units(solves: &[(usize, f64)], measurements: &mut Measurements) {
    let unit = measurements.number("wu_s").unwrap_or(f64::NAN);
    for key in ["setup", "solve3", "solve5"] {
        if let Some(seconds) = measurements.number(&format!("{key}_s")) {
            measurements.set_number(&format!("{key}_wu"), seconds / unit);
        }
    }
    if let [(it3, s3), (it5, s5)] = solves
        && it5 > it3
    {
        measurements.set_number("iter_wu", (s5 - s3) / (it5 - it3) as f64 / unit);
    }
}

/// Notes the convergence factor, and how far the two solutions are from the exact one.
fn note_errors(
    problem: &LinearProblem,
    ready: &mut ReadySystem<'_>,
    x3: &[[f64; 3]],
    x5: &[[f64; 3]],
    measurements: &mut Measurements,
) -> Result<(), LoadtestFailure> {
    let (mut x, mut residuals) = (vec![[0.0; 3]; x5.len()], Vec::new());
    let mut watch = |iteration: &IterationReport<'_>| residuals.push(iteration.residual);
    let (rhs, flat) = (problem.rhs.as_flattened(), x.as_flattened_mut());
    ready.solve_columns(3, rhs, flat, &options_to_residual(FACTOR), &mut watch)?;
    // The first iteration mostly takes away what zero is wrong by everywhere; the others show the rate.
    if let [first, .., last] = residuals[..] {
        measurements.set_number("factor", (last / first).powf(1.0 / (residuals.len() - 1) as f64));
    }
    if ready.terms.fast {
        return Ok(());
    }
    let options = SolveOptions {
        start: InitialGuess::Given,
        ..options_to_residual(EXACT_RESIDUAL)
    };
    let stats = ready.solve(&problem.rhs, &mut x, &options)?;
    let diagonal = box_diagonal(&problem.rest);
    measurements.set_number("err3", largest_distance(x3, &x) / diagonal);
    measurements.set_number("err5", largest_distance(x5, &x) / diagonal);
    measurements.set_number("exact_res", stats.residual);
    Ok(())
}

/// Computes the length of the bounding box diagonal; 1 for a point.
fn box_diagonal(points: &[[f64; 3]]) -> f64 {
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

fn method_name(method: SolveMethod) -> &'static str {
    match method {
        SolveMethod::Trivial => "trivial",
        SolveMethod::Direct => "direct",
        SolveMethod::Multigrid => "multigrid",
        SolveMethod::PaperCycles => "paper-cycles",
        SolveMethod::ConjugateGradients => "conjugate-gradients",
    }
}

/// Computes the SHA-256 of the bits of a solution, to compare runs on different numbers of threads.
fn solution_digest(x: &[[f64; 3]]) -> String {
    let mut hasher = Sha256::new();
    for row in x {
        row.iter().for_each(|v| hasher.update(v.to_bits().to_le_bytes()));
    }
    hasher.finalize().iter().map(|b| format!("{b:02x}")).collect()
}
