//! The paper's own operators: slow, but they keep every promise of a solve.

use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::{Progress, Silent};
use pliant_solver::{
    BuildOptions, CoarseOperators, Constraints, Error, Hierarchy, InitialGuess, IterationReport, SolveControl,
    SolveMethod, SolveOptions,
};

use super::case::{CancelAfter, SolverCase, full, largest_distance, started, to, twist};
use super::graphs::{TestGraph, lattice, random_graph, star, surface};

/// The same case with the paper's operators.
fn paper(case: SolverCase, interleave: Option<usize>, threads: usize) -> SolverCase {
    let options = BuildOptions {
        operators: CoarseOperators::Paper,
        interleave,
        ..BuildOptions::default()
    };
    let pool = Pool::new(threads).unwrap();
    let hierarchy = Hierarchy::build(&case.graph.view(), &options, &Exec::new(&pool, &Silent)).unwrap();
    let constraints = Constraints {
        fixed: &case.fixed,
        stiffness: case.stiffness.as_deref(),
    };
    let system = hierarchy.constrain(&constraints, &pool).unwrap();
    SolverCase {
        hierarchy,
        system,
        pool,
        ..case
    }
}

/// A body that hangs at its lower end by hard constraints and at its upper end by soft ones.
fn soft(graph: TestGraph) -> SolverCase {
    let ends = graph.ends(2, 0.9);
    let up = |i: usize| graph.positions[i][2] > 2.0;
    let fixed = (0..graph.len()).map(|i| ends[i] && !up(i)).collect();
    let stiffness = (0..graph.len())
        .map(|i| if ends[i] && up(i) { 0.5 } else { 0.0 })
        .collect();
    SolverCase::new(graph, fixed, Some(stiffness), 1)
}

fn framed<'a>(frames: &'a [[f32; 9]], options: SolveOptions<'a>) -> SolveOptions<'a> {
    let frames = Some(frames);
    SolveOptions {
        start: full(frames, None),
        ..options
    }
}

#[test]
fn cycles_reach_what_is_asked_where_that_is_little() {
    for case in [
        SolverCase::ends(lattice(12, 12, 24), 2),
        SolverCase::ends(surface(40, 30), 0),
    ] {
        let case = paper(case, None, 1);
        let (rhs, start, frames) = twist(&case, 0.3);
        let mut x = start.clone();
        let stats = case.solve(3, &rhs, &mut x, &framed(&frames, to(1e-2)));
        assert!(stats.converged && stats.method == SolveMethod::PaperCycles, "{stats:?}");
        let recomputed = case.residuals(3, &rhs, &x).into_iter().fold(0.0, f64::max);
        assert!(recomputed <= 1e-2 && (recomputed - stats.residual).abs() <= 1e-6 * recomputed);
        for i in (0..3 * case.n()).filter(|i| case.fixed[i / 3]) {
            assert_eq!(x[i].to_bits(), start[i].to_bits(), "given values stay");
        }
    }
}

#[test]
fn when_cycles_stall_conjugate_gradients_finish_and_say_so() {
    let graphs = [
        SolverCase::ends(lattice(12, 12, 16), 2),
        SolverCase::ends(surface(40, 30), 0),
        SolverCase::ends(lattice(10, 10, 12).weighted(-2.0, 2.0, 3), 2),
        soft(lattice(9, 9, 14)),
        SolverCase::ends(lattice(9, 9, 12), 2).without_positions(),
    ];
    for (k, case) in graphs.into_iter().enumerate() {
        let (rhs, start, _) = twist(&case, 1.0);
        let mut exact = start.clone();
        assert!(case.solve_to(3, &rhs, &mut exact, 1e-11).converged);
        for (interleave, begin) in [
            (None, InitialGuess::Zero),
            (Some(0), InitialGuess::Zero),
            (Some(0), full(None, None)),
        ] {
            let case = paper(
                SolverCase::new(case.graph.clone(), case.fixed.clone(), case.stiffness.clone(), 1),
                interleave,
                1,
            );
            let mut x = start.clone();
            let options = started(begin, 1e-8);
            let stats = case.solve(3, &rhs, &mut x, &options);
            assert!(stats.converged, "{stats:?}");
            // Some get there without, above all with two steps after each cycle.
            let gave_up = stats.method == SolveMethod::ConjugateGradients;
            assert!(gave_up || k > 1 || interleave.is_none(), "graph {k}: {stats:?}");
            assert!(case.residuals(3, &rhs, &x).iter().all(|r| *r <= 1.01e-8));
            let size = start
                .iter()
                .filter(|v| v.is_finite())
                .fold(0.0f64, |a, v| a.max(v.abs()));
            assert!(largest_distance(3, &x, &exact) < 1e-4 * size);
        }
    }
}

#[test]
fn an_error_that_is_asked_for_is_kept() {
    let case = SolverCase::ends(lattice(12, 12, 24), 2);
    let (rhs, start, frames) = twist(&case, 1.0);
    let mut exact = start.clone();
    assert!(case.solve_to(3, &rhs, &mut exact, 1e-11).converged);
    let case = paper(case, None, 1);
    for asked in [1.0, 1e-2, 1e-5] {
        let options = SolveOptions {
            tolerance: None,
            max_error: Some(asked),
            ..SolveOptions::default()
        };
        let mut x = start.clone();
        let stats = case.solve(3, &rhs, &mut x, &framed(&frames, options));
        let missing = largest_distance(3, &x, &exact);
        assert!(stats.converged && missing <= asked, "{missing} of {asked}: {stats:?}");
    }
}

#[test]
fn conjugate_gradient_steps_in_between_help() {
    let case = SolverCase::ends(lattice(16, 16, 24), 2);
    let (rhs, start, frames) = twist(&case, 1.0);
    let mut exact = start.clone();
    case.solve_to(3, &rhs, &mut exact, 1e-11);
    let mut case = case;
    let mut missing = Vec::new();
    for steps in [0, 2] {
        case = paper(case, Some(steps), 1);
        let options = SolveOptions {
            max_iterations: 10,
            ..to(1e-12)
        };
        let mut x = start.clone();
        let stats = case.solve(3, &rhs, &mut x, &framed(&frames, options));
        assert!(!stats.converged && stats.iterations == 10 && stats.method == SolveMethod::PaperCycles);
        missing.push(largest_distance(3, &x, &exact));
    }
    assert!(missing[1] < 0.9 * missing[0], "{missing:?}");
}

#[test]
fn the_bits_do_not_depend_on_the_pool() {
    let solve = |threads: usize| {
        let case = paper(SolverCase::ends(lattice(14, 14, 20), 2), None, threads);
        let (rhs, mut x, frames) = twist(&case, 1.0);
        let stats = case.solve(3, &rhs, &mut x, &framed(&frames, to(1e-6)));
        (x.iter().map(|v| v.to_bits()).collect::<Vec<_>>(), stats)
    };
    let one = solve(1);
    assert!(one.1.converged);
    for threads in [2, 3] {
        assert!(solve(threads) == one, "{threads} threads");
    }
}

#[test]
fn cancelling_stops_between_sweeps_and_watchers_can_stop() {
    let case = paper(SolverCase::ends(lattice(12, 12, 16), 2), Some(2), 1);
    let (rhs, start, _) = twist(&case, 1.0);
    let run = |progress: &dyn Progress, most: usize| {
        let (mut x, mut shown) = (start.clone(), start.clone());
        let mut seen = 0;
        let mut watch = |iteration: &IterationReport<'_>| {
            seen += 1;
            assert_eq!(iteration.index, seen);
            iteration.copy_to(&mut shown);
            if seen == most {
                SolveControl::Stop
            } else {
                SolveControl::Continue
            }
        };
        let result = case.watched(3, &rhs, &mut x, &to(1e-12), progress, &mut watch);
        (result, seen, x, shown)
    };
    // Four sweeps on each of several levels and two conjugate-gradient steps ask at least ten times per cycle.
    for questions in [0, 1, 2, 5, 9, 20, 40] {
        let (result, seen, ..) = run(&CancelAfter(questions.into()), usize::MAX);
        assert_eq!(result, Err(Error::Cancelled));
        assert!(seen <= questions / 10, "{seen} cycles after {questions} questions");
    }
    let (result, seen, x, shown) = run(&Silent, 3);
    let stats = result.unwrap();
    assert!(stats.stopped && !stats.converged && stats.iterations == 3 && seen == 3);
    assert_eq!(stats.method, SolveMethod::PaperCycles);
    assert_eq!(shown, x, "the last thing shown is what the caller gets");
}

#[test]
fn hard_graphs_end_with_a_result() {
    let held = |graph: TestGraph| {
        let fixed = (0..graph.len()).map(|i| i % 97 == 0).collect();
        SolverCase::new(graph, fixed, None, 1)
    };
    let free = |graph: TestGraph| {
        let fixed = vec![false; graph.len()];
        SolverCase::new(graph, fixed, None, 1)
    };
    let cases = [
        held(random_graph(3000, 40, 5)),
        held(lattice(10, 10, 10).disconnected(9)),
        held(lattice(10, 10, 10).weighted(-12.0, 12.0, 4)),
        held(star(4000)),
        free(lattice(9, 9, 9)),
        free(surface(30, 30).disconnected(2)),
        held(lattice(10, 10, 10).moved(|_| [1.0; 3])),
    ];
    for (k, case) in cases.into_iter().enumerate() {
        let case = paper(case, None, 1);
        let rhs: Vec<f64> = (0..2 * case.n()).map(|i| libm::sin(i as f64)).collect();
        for tolerance in [1e-2, 1e-6] {
            let mut x = vec![0.0; rhs.len()];
            let stats = case.solve(2, &rhs, &mut x, &to(tolerance));
            assert!(
                x.iter().all(|v| v.is_finite()) && stats.residual.is_finite(),
                "case {k}: {stats:?}"
            );
            assert!(stats.converged || k == 2, "case {k}: {stats:?}");
            if stats.converged {
                let own = case.own_residuals(2, &rhs, &x);
                assert!(own.iter().all(|r| *r <= 1.01 * tolerance), "case {k}: {own:?}");
            }
        }
    }
}

#[test]
fn too_many_steps_are_refused_by_name() {
    let case = SolverCase::ends(lattice(4, 4, 4), 2);
    let options = BuildOptions {
        interleave: Some(101),
        ..BuildOptions::default()
    };
    let refused = Hierarchy::build(&case.graph.view(), &options, &Exec::new(&case.pool, &Silent)).unwrap_err();
    assert!(refused.to_string().contains("interleave is 101"), "{refused}");
}
