//! Once its workspace has grown, a solve asks the allocator for nothing: counted by an allocator that counts.
//!
//! One thread: the returned [`SolveStats::residuals`](pliant_solver::SolveStats::residuals) is the only memory asked for. More
//! threads: what handing out work costs, which is bounded per iteration. A pool of one thread is never entered, so a
//! solve on it allocates nothing on its behalf either, from whichever thread it is called.

use case::{SolverCase, to, twist};
use counting_allocator::{Asked, CountingAllocator, counted};
use graphs::{lattice, surface};
use pliant_exec::Exec;
use pliant_exec::progress::Silent;
use pliant_solver::{InitialGuess, IterationReport, SolveControl, SolveMethod, SolveOptions, SolveStats, Workspace};

#[allow(dead_code)]
#[path = "laws/case.rs"]
mod case;
#[path = "support/counting_allocator.rs"]
mod counting_allocator;
#[allow(dead_code)]
#[path = "laws/graphs.rs"]
mod graphs;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// What the third of three equal solves asked for.
fn third_solve(
    case: &SolverCase,
    columns: usize,
    rhs: &[f64],
    from: &[f64],
    options: &SolveOptions<'_>,
) -> (SolveStats, Asked) {
    let mut workspace = Workspace::default();
    let (mut x, mut shown) = (from.to_vec(), from.to_vec());
    let exec = Exec::new(&case.pool, &Silent);
    let equations = case.system.equations(&case.hierarchy, columns, rhs);
    let mut solve = || {
        x.copy_from_slice(from);
        let mut watch = |iteration: &IterationReport<'_>| {
            iteration.copy_to(&mut shown);
            SolveControl::Continue
        };
        equations.solve(&mut x, options, &mut workspace, &exec, &mut watch)
    };
    for _ in 0..2 {
        solve().unwrap();
    }
    let (stats, asked) = counted(solve);
    (stats.unwrap(), asked)
}

/// One kind of solve.
struct CountedSolve<'a> {
    name: &'static str,
    columns: usize,
    rhs: Vec<f64>,
    from: Vec<f64>,
    options: SolveOptions<'a>,
}

/// Cold, warm and full-multigrid solves, to residuals that single precision reaches and beyond, and to errors.
fn kinds<'a>(case: &SolverCase, frames: &'a [[f32; 9]]) -> Vec<CountedSolve<'a>> {
    let (rhs, start, _) = twist(case, 1.0);
    let mut near = start.clone();
    case.solve_to(3, &rhs, &mut near, 1e-3);
    let full = InitialGuess::FullMultigrid {
        frames: Some(frames),
        rest: None,
    };
    let error = SolveOptions {
        tolerance: None,
        max_error: Some(1e-4),
        ..SolveOptions::default()
    };
    let kind = |name, from: &Vec<f64>, start, options: SolveOptions<'a>| CountedSolve {
        name,
        columns: 3,
        rhs: rhs.clone(),
        from: from.clone(),
        options: SolveOptions { start, ..options },
    };
    let mut kinds = vec![
        kind("zero to 1e-3", &start, InitialGuess::Zero, to(1e-3)),
        kind("zero to 1e-9", &start, InitialGuess::Zero, to(1e-9)),
        kind("warm to 1e-6", &near, InitialGuess::Given, to(1e-6)),
        kind("warm to an error", &near, InitialGuess::Given, error.clone()),
        kind("full multigrid to 1e-4", &start, full, to(1e-4)),
        kind("full multigrid to an error", &start, full, error),
    ];
    // Two groups of columns.
    kinds.push(CountedSolve {
        name: "five columns",
        columns: 5,
        rhs: (0..5 * case.n()).map(|k| (k % 11) as f64 - 5.0).collect(),
        from: (0..5 * case.n()).map(|k| (k % 7) as f64).collect(),
        options: to(1e-6),
    });
    kinds
}

fn one_thread() {
    let soft = lattice(10, 10, 14);
    let pulls = soft.ends(2, 0.9).iter().map(|e| f64::from(u8::from(*e))).collect();
    let loose = lattice(12, 12, 12);
    let few = lattice(9, 9, 9);
    let cases = [
        ("lattice", SolverCase::ends(lattice(16, 16, 20), 2)),
        ("surface", SolverCase::ends(surface(80, 90), 0)),
        (
            "weighted",
            SolverCase::ends(lattice(12, 12, 16).weighted(-1.0, 1.0, 5), 2),
        ),
        (
            "soft",
            SolverCase::new(soft.clone(), vec![false; soft.len()], Some(pulls), 1),
        ),
        (
            "loose",
            SolverCase::new(loose.clone(), vec![false; loose.len()], None, 1),
        ),
        (
            "direct",
            SolverCase::new(few.clone(), (0..few.len()).map(|i| i % 12 != 1).collect(), None, 1),
        ),
    ];
    for (name, case) in &cases {
        let (_, _, frames) = twist(case, 1.0);
        for mut kind in kinds(case, &frames) {
            // Where nothing or little is held, targets leave the start undefined.
            kind.from.iter_mut().filter(|v| v.is_nan()).for_each(|v| *v = 0.0);
            let (stats, asked) = third_solve(case, kind.columns, &kind.rhs, &kind.from, &kind.options);
            let iterations = stats.iterations;
            println!(
                "{name}, {}: {} calls in {iterations} iterations",
                kind.name, asked.calls
            );
            assert!(iterations > 0, "{name}, {}: something is solved", kind.name);
            assert_ne!(stats.method, SolveMethod::ConjugateGradients, "{name}, {}", kind.name);
            assert_eq!(
                (asked.calls, asked.bytes),
                (1, 8 * kind.columns),
                "{name}, {}: more than the residuals that are returned:\n{}",
                kind.name,
                asked.traces.join("\n")
            );
        }
    }
}

/// Calls of the allocator that handing out work may cost: for each iteration, and besides for each group of columns.
const PER_ITERATION: usize = 1;
const PER_GROUP: usize = 8;

fn more_threads() {
    for threads in [2, 4] {
        let graph = lattice(26, 26, 30);
        let fixed = graph.ends(2, 0.9);
        let case = SolverCase::new(graph, fixed, None, threads);
        let (_, _, frames) = twist(&case, 1.0);
        for mut kind in kinds(&case, &frames) {
            kind.from.iter_mut().filter(|v| v.is_nan()).for_each(|v| *v = 0.0);
            let (stats, asked) = third_solve(&case, kind.columns, &kind.rhs, &kind.from, &kind.options);
            let (calls, iterations) = (asked.calls, stats.iterations);
            let groups = kind.columns.div_ceil(4);
            println!(
                "{threads} threads, {}: {calls} calls in {iterations} iterations, {} bytes",
                kind.name, asked.bytes
            );
            assert!(
                calls <= groups * (PER_GROUP + PER_ITERATION * iterations),
                "{threads} threads, {}: {calls} calls in {iterations} iterations:\n{}",
                kind.name,
                asked.traces.join("\n")
            );
        }
    }
}

// One test, so that nothing else in the process allocates meanwhile.
#[test]
fn solves_ask_for_no_memory_once_warm() {
    one_thread();
    more_threads();
}
