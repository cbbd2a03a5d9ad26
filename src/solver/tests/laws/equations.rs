//! Solutions satisfy the equations, and depend on data as they must.

use pliant_exec::Exec;
use pliant_exec::progress::Silent;
use pliant_solver::{InitialGuess, IterationReport, SolveControl, SolveMethod, Workspace};

use super::case::{SolverCase, full, largest_distance, noise, started, twist};
use super::graphs::{lattice, random_graph, surface};

#[test]
fn equations_hold_to_every_tolerance() {
    let cases = [
        ("lattice", SolverCase::ends(lattice(14, 12, 20), 2)),
        ("surface", SolverCase::ends(surface(70, 90), 0)),
        (
            "random",
            SolverCase::ends(random_graph(6000, 4, 11).weighted(-1.0, 1.0, 5), 0),
        ),
        (
            "lattice without positions",
            SolverCase::ends(lattice(14, 12, 20), 2).without_positions(),
        ),
        (
            "weighted surface without positions",
            SolverCase::ends(surface(70, 90).weighted(-1.0, 1.0, 3), 0).without_positions(),
        ),
    ];
    for (name, case) in &cases {
        let (rhs, start, _) = twist(case, 1.0);
        for tolerance in [1e-3, 1e-5, 1e-7, 1e-9] {
            let mut x = start.clone();
            let stats = case.solve_to(3, &rhs, &mut x, tolerance);
            let seen = case.residuals(3, &rhs, &x);
            assert!(stats.converged, "{name}: {stats:?}");
            assert_eq!(stats.method, SolveMethod::Multigrid, "{name}");
            for (r, claimed) in seen.iter().zip(&stats.residuals) {
                assert!(*r <= tolerance, "{name}: residual {r:e} after solving to {tolerance:e}");
                assert!(
                    (r - claimed).abs() <= 0.05 * tolerance,
                    "{name}: claimed {claimed:e}, true {r:e}"
                );
            }
            let own = case.own_residuals(3, &rhs, &x);
            for (a, b) in own.iter().zip(&seen) {
                assert!((a - b).abs() <= 1e-3 * b + 1e-14, "{name}: {a:e} against {b:e}");
            }
        }
    }
}

#[test]
fn convergence_does_not_depend_on_size() {
    let factor = |case: SolverCase| {
        let (rhs, mut x, _) = twist(&case, 1.0);
        case.solve_to(3, &rhs, &mut x, 1e-6).factor
    };
    for (small, large) in [
        (
            factor(SolverCase::ends(lattice(8, 8, 8), 2)),
            factor(SolverCase::ends(lattice(28, 28, 28), 2)),
        ),
        (
            factor(SolverCase::ends(surface(30, 30), 0)),
            factor(SolverCase::ends(surface(200, 180), 0)),
        ),
    ] {
        assert!(
            large < 0.5 && large < small + 0.2,
            "{small} on the small graph, {large} on the large one"
        );
    }
}

#[test]
fn residual_rows_are_those_of_the_equations() {
    let case = SolverCase::ends(lattice(5, 6, 9).weighted(-2.0, 2.0, 1), 2);
    let (rhs, x) = (noise(2 * case.n(), 1), noise(2 * case.n(), 2));
    let mut rows = vec![f64::NAN; 2 * case.n()];
    case.system
        .equations(&case.hierarchy, 2, &rhs)
        .residual(&x, Some(&mut rows), &case.pool)
        .unwrap();
    for i in 0..case.n() {
        for c in 0..2 {
            let at = 2 * i + c;
            let sum: f64 = case.graph.row(i).map(|(j, w)| w * (x[at] - x[2 * j + c])).sum();
            let want = if case.fixed[i] { 0.0 } else { rhs[at] - sum };
            assert!(
                (rows[at] - want).abs() <= 1e-10 * (1.0 + want.abs()),
                "row {i}: {} against {want}",
                rows[at]
            );
        }
    }
}

#[test]
fn any_number_of_columns_gives_the_same_solutions() {
    let case = SolverCase::ends(lattice(7, 7, 12), 2);
    let n = case.n();
    let (rhs, values) = (noise(7 * n, 5), noise(7 * n, 6));
    let mut all = values.clone();
    case.solve_to(7, &rhs, &mut all, 1e-10);
    for columns in [1, 2, 3, 5] {
        let pick = |v: &[f64]| -> Vec<f64> { v.chunks(7).flat_map(|row| row[..columns].to_vec()).collect() };
        let mut x = pick(&values);
        let stats = case.solve_to(columns, &pick(&rhs), &mut x, 1e-10);
        assert_eq!(stats.residuals.len(), columns);
        assert!(largest_distance(columns, &x, &pick(&all)) < 1e-6, "{columns} columns");
    }
}

#[test]
fn a_column_is_not_disturbed_by_its_neighbours() {
    let case = SolverCase::ends(lattice(7, 7, 12), 2);
    let n = case.n();
    let column = noise(n, 8);
    let mut alone = column.clone();
    case.solve_to(1, &vec![0.0; n], &mut alone, 1e-9);
    // One neighbour is zero, one is enormous, one tiny.
    let mut together: Vec<f64> = column.iter().flat_map(|v| [0.0, *v, v * 1e30, v * 1e-30]).collect();
    let stats = case.solve_to(4, &vec![0.0; 4 * n], &mut together, 1e-9);
    assert!(stats.converged && stats.residuals[0] == 0.0, "{stats:?}");
    for (i, row) in together.chunks(4).enumerate() {
        assert!(row[0] == 0.0 && (row[1] - alone[i]).abs() < 1e-6, "row {i}");
        assert!(
            (row[2] * 1e-30 - alone[i]).abs() < 1e-6 && (row[3] * 1e30 - alone[i]).abs() < 1e-6,
            "row {i}"
        );
    }
}

#[test]
fn bits_do_not_depend_on_threads() {
    let graphs = [
        lattice(22, 22, 24),
        surface(130, 110).weighted(-1.0, 1.0, 9),
        random_graph(12000, 3, 4).without_positions(),
    ];
    for graph in graphs {
        let mut results: Vec<(Vec<u64>, usize)> = Vec::new();
        for threads in [1, 2, 3, 4] {
            let fixed = graph.ends(2, 0.9);
            let stiffness = noise(fixed.len(), 3).iter().map(|v| v.max(0.0)).collect();
            let case = SolverCase::new(graph.clone(), fixed, Some(stiffness), threads);
            let (rhs, start, frames) = twist(&case, 1.0);
            let rest = Some(case.graph.positions.as_slice());
            let mut bits = Vec::new();
            for start_at in [InitialGuess::Zero, full(Some(&frames), rest)] {
                let mut x = start.clone();
                let stats = case.solve(3, &rhs, &mut x, &started(start_at, 1e-8));
                assert!(stats.converged);
                bits.extend(x.iter().map(|v| v.to_bits()));
                bits.push(stats.max_error.to_bits());
            }
            results.push((bits, case.hierarchy.level_sizes().len()));
        }
        assert!(results[0].1 > 2, "the graph is large enough to have levels");
        assert!(results.iter().all(|r| r == &results[0]));
    }
}

#[test]
fn a_workspace_leaves_no_trace() {
    let cases = [
        SolverCase::ends(lattice(12, 12, 12), 2),
        SolverCase::ends(surface(60, 40), 0),
        SolverCase::ends(lattice(5, 5, 6), 2),
    ];
    let mut workspace = Workspace::default();
    for round in 0..2 {
        for case in &cases {
            let (rhs, start, frames) = twist(case, 0.7);
            let (mut a, mut b) = (start.clone(), start.clone());
            let options = started(full(Some(&frames), None), 1e-6);
            case.solve(3, &rhs, &mut a, &options);
            let (system, hierarchy) = (&case.system, &case.hierarchy);
            let mut watch = |_: &IterationReport<'_>| SolveControl::Continue;
            system
                .equations(hierarchy, 3, &rhs)
                .solve(
                    &mut b,
                    &options,
                    &mut workspace,
                    &Exec::new(&case.pool, &Silent),
                    &mut watch,
                )
                .unwrap();
            assert!(
                a.iter().zip(&b).all(|(a, b)| a.to_bits() == b.to_bits()),
                "round {round}"
            );
        }
    }
    assert!(workspace.byte_size() > 0);
}

#[test]
fn solutions_are_linear_in_the_data() {
    let case = SolverCase::ends(lattice(9, 9, 14), 2);
    let n = case.n();
    let (b1, b2, f1, f2) = (noise(n, 1), noise(n, 2), noise(n, 3), noise(n, 4));
    let mix = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| 2.5 * a - 0.75 * b).collect() };
    let solve = |rhs: &[f64], values: &[f64]| {
        let mut x = values.to_vec();
        case.solve_to(1, rhs, &mut x, 1e-11);
        x
    };
    let (x1, x2, x12) = (solve(&b1, &f1), solve(&b2, &f2), solve(&mix(&b1, &b2), &mix(&f1, &f2)));
    assert!(largest_distance(1, &x12, &mix(&x1, &x2)) < 1e-7);
}

#[test]
fn constants_are_preserved() {
    for case in [
        SolverCase::ends(lattice(12, 12, 14), 2),
        SolverCase::ends(surface(80, 60).weighted(-2.0, 2.0, 7), 0),
    ] {
        for value in [1.0, -3e7, 1e-20] {
            let mut x = vec![value; case.n()];
            let stats = case.solve_to(1, &vec![0.0; case.n()], &mut x, 1e-10);
            assert!(stats.converged);
            assert!(
                x.iter().all(|v| (v - value).abs() <= 1e-7 * value.abs()),
                "constant {value:e}"
            );
        }
    }
}

#[test]
fn harmonic_columns_stay_between_their_fixed_values() {
    let case = SolverCase::ends(lattice(12, 10, 24).weighted(-1.5, 1.5, 2), 2);
    let mut x: Vec<f64> = case
        .graph
        .positions
        .iter()
        .map(|p| f64::from(u8::from(p[2] > 12.0)))
        .collect();
    case.solve_to(1, &vec![0.0; case.n()], &mut x, 1e-8);
    assert!(x.iter().all(|v| (-1e-6..=1.0 + 1e-6).contains(v)));
    let inside = (0..case.n()).filter(|&i| !case.fixed[i]).map(|i| x[i]);
    assert!(
        inside.clone().fold(1.0, f64::min) < 0.2 && inside.fold(0.0, f64::max) > 0.8,
        "both ends pull"
    );
}

#[test]
fn moving_everything_moves_the_solution() {
    let case = SolverCase::ends(lattice(10, 10, 16), 2);
    let (rhs, start, _) = twist(&case, 1.0);
    let (c, s) = (0.6, 0.8);
    let turn = |v: &[f64]| -> Vec<f64> {
        v.chunks(3)
            .flat_map(|p| [c * p[0] - s * p[2], p[1], s * p[0] + c * p[2]])
            .collect()
    };
    let shift = [1000.0, -20.0, 3.0];
    let mut here = start.clone();
    case.solve_to(3, &rhs, &mut here, 1e-11);
    let mut there: Vec<f64> = turn(&start)
        .chunks(3)
        .flat_map(|p| [p[0] + shift[0], p[1] + shift[1], p[2] + shift[2]])
        .collect();
    case.solve_to(3, &turn(&rhs), &mut there, 1e-11);
    let moved: Vec<f64> = turn(&here)
        .chunks(3)
        .flat_map(|p| [p[0] + shift[0], p[1] + shift[1], p[2] + shift[2]])
        .collect();
    assert!(largest_distance(3, &there, &moved) < 1e-5);
}
