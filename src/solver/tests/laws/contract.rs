//! Watching, stopping, cancelling, refusing.

use pliant_exec::Exec;
use pliant_exec::progress::{CancelFlag, Progress, Silent};
use pliant_solver::{
    BuildOptions, Constraints, Error, Hierarchy, InitialGuess, IterationReport, SolveControl, SolveOptions, Workspace,
};

use super::case::{CancelAfter, SolverCase, full, started, to, twist};
use super::graphs::lattice;

#[test]
fn watchers_see_every_iteration_and_can_stop() {
    let case = SolverCase::ends(lattice(12, 12, 16), 2);
    let (rhs, start, _) = twist(&case, 1.0);
    let (mut x, mut shown) = (start.clone(), start.clone());
    let mut indices = Vec::new();
    let mut watch = |iteration: &IterationReport<'_>| {
        indices.push(iteration.index);
        iteration.copy_to(&mut shown);
        if iteration.index == 3 {
            SolveControl::Stop
        } else {
            SolveControl::Continue
        }
    };
    let stats = case.watched(3, &rhs, &mut x, &to(1e-9), &Silent, &mut watch).unwrap();
    assert!(stats.stopped && !stats.converged && stats.iterations == 3);
    assert_eq!(indices, [1, 2, 3]);
    assert_eq!(shown, x, "the last thing shown is what the caller gets");
    let limited = case.solve(
        3,
        &rhs,
        &mut start.clone(),
        &SolveOptions {
            max_iterations: 2,
            ..to(1e-9)
        },
    );
    assert!(!limited.converged && limited.iterations == 2);
}

#[test]
fn cancelling_stops_within_a_cycle() {
    let case = SolverCase::ends(lattice(12, 12, 16), 2);
    let (rhs, start, _) = twist(&case, 1.0);
    let flag = CancelFlag::default();
    flag.cancel();
    let view = case.graph.view();
    assert!(matches!(
        Hierarchy::build(&view, &BuildOptions::default(), &Exec::new(&case.pool, &flag)),
        Err(Error::Cancelled)
    ));
    for questions in [0, 1, 2, 5, 20] {
        let progress = CancelAfter(questions.into());
        let mut x = start.clone();
        let mut iterations = 0;
        let mut watch = |_: &IterationReport<'_>| {
            iterations += 1;
            SolveControl::Continue
        };
        let result = case.watched(3, &rhs, &mut x, &to(1e-12), &progress, &mut watch);
        assert_eq!(result, Err(Error::Cancelled));
        assert!(
            iterations <= questions / 3,
            "{iterations} iterations after {questions} questions"
        );
    }
}

#[test]
fn a_cancelled_solve_stops_within_an_iteration_and_leaves_its_workspace_usable() {
    let case = SolverCase::ends(lattice(12, 12, 16), 2);
    let (rhs, start, frames) = twist(&case, 1.0);
    for start_at in [InitialGuess::Zero, full(Some(&frames), None)] {
        let options = started(start_at, 1e-9);
        let mut want = start.clone();
        case.solve(3, &rhs, &mut want, &options);
        let mut workspace = Workspace::default();
        let mut solve = |x: &mut [f64],
                         progress: &dyn Progress,
                         watch: &mut dyn FnMut(&IterationReport<'_>) -> SolveControl| {
            let (hierarchy, pool) = (&case.hierarchy, &case.pool);
            let system = &case.system;
            system
                .equations(hierarchy, 3, &rhs)
                .solve(x, &options, &mut workspace, &Exec::new(pool, progress), watch)
        };
        for at in [1, 2, 4] {
            // Raised while iteration `at` is shown: the next one is not finished.
            let flag = CancelFlag::default();
            let (mut x, mut last) = (start.clone(), 0);
            let result = solve(&mut x, &flag, &mut |iteration| {
                last = iteration.index;
                if last == at {
                    flag.cancel();
                }
                SolveControl::Continue
            });
            assert_eq!((result, last), (Err(Error::Cancelled), at));
            let given = |i: &usize| case.fixed[*i / 3];
            assert!((0..x.len()).filter(given).all(|k| x[k].to_bits() == start[k].to_bits()));
        }
        // At any question, also inside the start and between the sweeps of a cycle.
        for questions in 0..40 {
            let mut x = start.clone();
            let result = solve(&mut x, &CancelAfter(questions.into()), &mut |_| SolveControl::Continue);
            assert_eq!(result, Err(Error::Cancelled), "after {questions} questions");
        }
        let mut x = start.clone();
        solve(&mut x, &Silent, &mut |_| SolveControl::Continue).unwrap();
        assert!(
            x.iter().zip(&want).all(|(a, b)| a.to_bits() == b.to_bits()),
            "what was cancelled leaves no trace"
        );
    }
}

#[test]
fn bad_arguments_are_named() {
    let case = SolverCase::ends(lattice(12, 12, 12), 2);
    let other = SolverCase::ends(lattice(12, 12, 12), 2);
    let n = case.n();
    let solve = |case: &SolverCase,
                 hierarchy: &Hierarchy,
                 columns: usize,
                 rhs: &[f64],
                 x: &mut [f64],
                 options: &SolveOptions<'_>| {
        let mut workspace = Workspace::default();
        let mut watch = |_: &IterationReport<'_>| SolveControl::Continue;
        case.system
            .equations(hierarchy, columns, rhs)
            .solve(x, options, &mut workspace, &Exec::new(&case.pool, &Silent), &mut watch)
            .unwrap_err()
            .to_string()
    };
    let zeros = vec![0.0; 3 * n];
    let h = &case.hierarchy;
    assert!(solve(&case, &other.hierarchy, 3, &zeros, &mut zeros.clone(), &to(1e-3)).contains("another hierarchy"));
    assert!(solve(&case, h, 2, &zeros, &mut zeros.clone(), &to(1e-3)).contains("2 columns"));
    assert!(solve(&case, h, usize::MAX, &zeros, &mut zeros.clone(), &to(1e-3)).contains("columns"));
    assert!(solve(&case, h, 3, &zeros, &mut zeros.clone(), &to(0.0)).contains("tolerance is 0"));
    assert!(solve(&case, h, 3, &zeros, &mut zeros.clone(), &to(f64::NAN)).contains("tolerance"));
    let mut bad = zeros.clone();
    let inside = case.fixed.iter().position(|f| !f).unwrap();
    bad[3 * inside + 1] = f64::INFINITY;
    assert!(solve(&case, h, 3, &bad, &mut zeros.clone(), &to(1e-3)).contains("column 1 of the right-hand side"));
    let given = started(InitialGuess::Given, 1e-3);
    assert!(solve(&case, h, 3, &zeros, &mut bad, &given).contains("column 1 of the start"));
    let frames = vec![[f32::NAN; 9]; n];
    let framed = |frames| started(full(Some(frames), None), 1e-3);
    assert!(solve(&case, h, 3, &zeros, &mut zeros.clone(), &framed(&frames)).contains("finite"));
    assert!(solve(&case, h, 3, &zeros, &mut zeros.clone(), &framed(&frames[1..])).contains("frames"));

    let constrain = |fixed: &[bool], stiffness: Option<&[f64]>| {
        h.constrain(&Constraints { fixed, stiffness }, &case.pool)
            .unwrap_err()
            .to_string()
    };
    assert!(constrain(&case.fixed[1..], None).contains("constraint flags"));
    assert!(constrain(&case.fixed, Some(&zeros[..n - 1])).contains("stiffness values"));
    for bad in [-1.0, f64::NAN, 1e15] {
        let mut stiffness = vec![0.0; n];
        stiffness[5] = bad;
        assert!(constrain(&case.fixed, Some(&stiffness)).contains("vertex 5"));
    }
    let build = |options: BuildOptions| {
        Hierarchy::build(&case.graph.view(), &options, &Exec::new(&case.pool, &Silent))
            .unwrap_err()
            .to_string()
    };
    assert!(
        build(BuildOptions {
            coarsening: 0.0,
            ..Default::default()
        })
        .contains("coarsening is 0")
    );
    assert!(
        build(BuildOptions {
            coarsest: 0,
            ..Default::default()
        })
        .contains("coarsest is 0")
    );
}
