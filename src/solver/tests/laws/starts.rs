//! Where iterations begin, and how far they know to have come.

use pliant_exec::Exec;
use pliant_exec::progress::Silent;
use pliant_solver::{InitialGuess, IterationReport, SolveControl, SolveOptions, Workspace};

use super::case::{SolverCase, full, largest_distance, started, twist};
use super::graphs::{lattice, random_graph, surface};

#[test]
fn a_warm_start_needs_fewer_iterations() {
    let case = SolverCase::ends(lattice(16, 16, 20), 2);
    let (rhs, start, _) = twist(&case, 1.0);
    let mut x = start.clone();
    let cold = case.solve_to(3, &rhs, &mut x, 1e-6);
    // The next frame of a drag: all targets 1 % further.
    for i in (0..case.n()).filter(|&i| case.fixed[i] && case.graph.positions[i][2] > 10.0) {
        x[3 * i] += 0.2;
    }
    let warm = case.solve(3, &rhs, &mut x, &started(InitialGuess::Given, 1e-6));
    assert!(
        warm.converged && warm.iterations + 2 <= cold.iterations,
        "{} against {}",
        warm.iterations,
        cold.iterations
    );
    let again = case.solve(3, &rhs, &mut x, &started(InitialGuess::Given, 1e-6));
    assert_eq!(again.iterations, 1, "a solution is recognised, and its error estimated");
}

#[test]
fn the_full_multigrid_start_saves_iterations() {
    for case in [
        SolverCase::ends(lattice(16, 16, 48), 2),
        SolverCase::ends(surface(120, 100), 0),
    ] {
        let (rhs, start, frames) = twist(&case, 1.5);
        let iterations = |start_at: InitialGuess<'_>| {
            let mut x = start.clone();
            let stats = case.solve(3, &rhs, &mut x, &started(start_at, 1e-3));
            assert!(stats.converged && case.residuals(3, &rhs, &x).iter().all(|r| *r <= 1e-3));
            stats.iterations
        };
        let zero = iterations(InitialGuess::Zero);
        let framed = iterations(full(Some(&frames), None));
        let rest = Some(case.graph.positions.as_slice());
        let given = iterations(full(Some(&frames), rest));
        assert!(
            framed < zero && given == framed,
            "{framed}, {given} iterations instead of {zero}"
        );
        // A harmonic field has no frames.
        let mut field: Vec<f64> = (0..case.n())
            .map(|i| if start[3 * i + 2] > 1.0 { 1.0 } else { 0.0 })
            .collect();
        let start_at = full(None, None);
        let stats = case.solve(1, &vec![0.0; case.n()], &mut field, &started(start_at, 1e-6));
        assert!(stats.converged);
    }
}

#[test]
fn a_rigid_motion_is_found_by_the_start_alone() {
    let case = SolverCase::ends(lattice(16, 16, 20), 2);
    let (c, s) = (0.6f64, 0.8f64);
    let apply = |p: [f64; 3]| [c * p[0] - s * p[1] + 7.0, s * p[0] + c * p[1] - 3.0, p[2] + 1.0];
    let frames = vec![[c as f32, s as f32, 0.0, -s as f32, c as f32, 0.0, 0.0, 0.0, 1.0]; case.n()];
    let moved: Vec<f64> = case.graph.positions.iter().flat_map(|&p| apply(p)).collect();
    let mut rhs = vec![0.0; 3 * case.n()];
    for i in 0..case.n() {
        for (j, w) in case.graph.row(i) {
            for k in 0..3 {
                rhs[3 * i + k] += w * (moved[3 * i + k] - moved[3 * j + k]);
            }
        }
    }
    let mut x = moved.clone();
    let options = started(full(Some(&frames), None), 1e-5);
    assert_eq!(case.solve(3, &rhs, &mut x, &options).iterations, 1);
    assert!(largest_distance(3, &x, &moved) < 1e-3);
}

#[test]
fn error_estimates_are_close_to_the_truth() {
    let mut bar = lattice(8, 8, 60).ends(2, 0.9);
    bar[0] = true;
    let cases = [
        SolverCase::ends(lattice(16, 16, 20), 2),
        SolverCase::new(lattice(8, 8, 60), bar, None, 1),
        SolverCase::ends(surface(90, 100), 0),
        SolverCase::ends(random_graph(5000, 4, 2), 0),
    ];
    for (number, case) in cases.iter().enumerate() {
        let (rhs, start, frames) = twist(case, 1.0);
        let mut exact = start.clone();
        case.solve_to(3, &rhs, &mut exact, 1e-12);
        for start_at in [InitialGuess::Zero, full(Some(&frames), None)] {
            let (mut x, mut now) = (start.clone(), start.clone());
            let mut ratios = Vec::new();
            let mut watch = |iteration: &IterationReport<'_>| {
                iteration.copy_to(&mut now);
                if iteration.index >= 2 {
                    // Towards the digits of single precision, and without geometry, only caution is asked for.
                    let most = match (number, iteration.residual < 1e-6) {
                        (3, _) => 24.0,
                        (_, true) => 8.0,
                        (_, false) => 4.0,
                    };
                    ratios.push((iteration.max_error / largest_distance(3, &now, &exact), most));
                }
                SolveControl::Continue
            };
            let options = started(start_at, 1e-7);
            let mut workspace = Workspace::default();
            let (hierarchy, pool) = (&case.hierarchy, &case.pool);
            case.system
                .equations(hierarchy, 3, &rhs)
                .solve(&mut x, &options, &mut workspace, &Exec::new(pool, &Silent), &mut watch)
                .unwrap();
            assert!(ratios.len() >= 3);
            assert!(
                ratios.iter().all(|(r, most)| (0.5..=*most).contains(r)),
                "case {number}: {ratios:?}"
            );
        }
    }
}

#[test]
fn a_solve_can_stop_at_an_error() {
    let mut tiny = vec![false; lattice(16, 16, 16).len()];
    let last = tiny.len() - 1;
    for i in [0, 1, 2, last - 2, last - 1, last] {
        tiny[i] = true;
    }
    for case in [
        SolverCase::ends(lattice(16, 16, 20), 2),
        SolverCase::ends(surface(90, 100), 0),
        SolverCase::new(lattice(16, 16, 16), tiny, None, 1),
    ] {
        let (rhs, start, _) = twist(&case, 1.0);
        let mut exact = start.clone();
        case.solve_to(3, &rhs, &mut exact, 1e-13);
        for goal in [1e-1, 1e-3, 1e-6] {
            let mut x = start.clone();
            let options = SolveOptions {
                tolerance: None,
                max_error: Some(goal),
                ..SolveOptions::default()
            };
            let stats = case.solve(3, &rhs, &mut x, &options);
            let error = largest_distance(3, &x, &exact);
            assert!(stats.converged && stats.max_error <= goal);
            assert!(error <= 2.0 * goal, "{error:e} left, {goal:e} asked");
        }
    }
}
