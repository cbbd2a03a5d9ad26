//! Fixed vertices, springs, loose parts, changed handles.

use pliant_solver::{Constraints, InitialGuess, SolveMethod, SolveOptions};

use super::case::{SolverCase, full, largest_distance, noise, started, to, twist};
use super::graphs::{TestGraph, lattice};

#[test]
fn fixed_rows_are_never_written() {
    let case = SolverCase::ends(lattice(10, 10, 16), 2);
    let (mut rhs, start, _) = twist(&case, 1.0);
    // What the right-hand side holds on fixed rows does not matter.
    for i in (0..case.n()).filter(|&i| case.fixed[i]) {
        rhs[3 * i] = f64::NAN;
    }
    let mut x = start.clone();
    assert!(case.solve_to(3, &rhs, &mut x, 1e-6).converged);
    for i in 0..case.n() {
        for k in 3 * i..3 * i + 3 {
            assert!(x[k].is_finite());
            assert!(!case.fixed[i] || x[k].to_bits() == start[k].to_bits());
        }
    }
}

#[test]
fn stiffness_pulls_towards_its_target() {
    let graph = lattice(10, 10, 18);
    let soft = graph.ends(2, 0.9);
    let none = vec![false; graph.len()];
    let height = 17.5;
    // Harder and harder springs approach the hard constraint.
    let mut hard: Vec<f64> = graph.positions.iter().map(|p| p[2] / height * 5.0).collect();
    let targets = hard.clone();
    let reference = SolverCase::new(graph.clone(), soft.clone(), None, 1);
    reference.solve_to(1, &vec![0.0; graph.len()], &mut hard, 1e-10);
    let mut last = f64::INFINITY;
    for stiffness in [1e-3, 0.1, 10.0, 1e4, 1e8] {
        let alpha: Vec<f64> = soft.iter().map(|s| if *s { stiffness } else { 0.0 }).collect();
        let rhs: Vec<f64> = alpha.iter().zip(&targets).map(|(a, t)| a * t).collect();
        let case = SolverCase::new(graph.clone(), none.clone(), Some(alpha), 1);
        let mut x = vec![0.0; graph.len()];
        let options = SolveOptions {
            max_error: Some(1e-6),
            tolerance: Some(1e-8),
            ..SolveOptions::default()
        };
        let stats = case.solve(1, &rhs, &mut x, &options);
        assert!(stats.converged, "stiffness {stiffness}: {stats:?}");
        assert!(case.residuals(1, &rhs, &x)[0] <= 1e-8);
        let distance = largest_distance(1, &x, &hard);
        assert!(distance < last, "stiffness {stiffness}: {distance} after {last}");
        last = distance;
    }
    assert!(last < 1e-5);
}

#[test]
fn loose_parts_keep_their_mean() {
    // A held block, a loose block, a loose pair and loose points; the last one alone in its corner.
    let block = lattice(8, 8, 8);
    let mut positions = block.positions.clone();
    let mut edges: Vec<(u32, u32)> = block.edges().collect();
    let base = positions.len() as u32;
    positions.extend(block.positions.iter().map(|p| [p[0] + 20.0, p[1], p[2]]));
    edges.extend(block.edges().map(|(a, b)| (a + base, b + base)));
    let pair = positions.len() as u32;
    positions.extend([[50.0, 0.0, 0.0], [51.0, 0.0, 0.0], [60.0, 0.0, 0.0], [70.0, 1.0, 0.0]]);
    edges.push((pair, pair + 1));
    let fixed: Vec<bool> = (0..positions.len()).map(|i| i < 30).collect();
    let case = SolverCase::new(TestGraph::from_edges(positions, edges), fixed, None, 1);
    let n = case.n();
    let mut rhs = noise(n, 4);
    // Consistent on the pair; on the block and the points it is not, which must do no harm.
    (rhs[pair as usize], rhs[pair as usize + 1]) = (1.0, -1.0);
    let start = noise(n, 5);
    let mut x = start.clone();
    let stats = case.solve(1, &rhs, &mut x, &started(InitialGuess::Given, 1e-8));
    assert!(stats.converged && x.iter().all(|v| v.is_finite()), "{stats:?}");
    let mean = |x: &[f64], from: usize, to: usize| x[from..to].iter().sum::<f64>() / (to - from) as f64;
    let (a, b) = (base as usize, pair as usize);
    assert!((mean(&x, a, b) - mean(&start, a, b)).abs() < 1e-6);
    assert!((mean(&x, b, b + 2) - mean(&start, b, b + 2)).abs() < 1e-6);
    assert!(
        (x[b] - x[b + 1] - 1.0).abs() < 1e-6,
        "inside a loose part the equations hold"
    );
    assert!(
        x[b + 2] == start[b + 2] && x[b + 3] == start[b + 3],
        "loose points stay"
    );
    let relative = case.own_residuals(1, &rhs, &x);
    assert!(relative[0] < 1e-7);
    for start in [InitialGuess::Zero, full(None, None)] {
        let mut y = x.clone();
        assert!(
            case.solve(1, &rhs, &mut y, &SolveOptions { start, ..to(1e-8) })
                .converged
        );
        assert!(mean(&y, a, b).abs() < 1e-6, "other starts have mean 0");
    }
}

#[test]
fn nothing_free_and_little_free() {
    let graph = lattice(10, 10, 10);
    let n = graph.len();
    let all = SolverCase::new(graph.clone(), vec![true; n], None, 1);
    let mut x = noise(3 * n, 1);
    let before = x.clone();
    let stats = all.solve_to(3, &vec![0.0; 3 * n], &mut x, 1e-6);
    assert!(stats.method == SolveMethod::Trivial && stats.converged && x == before && all.system.free_count() == 0);

    let few = SolverCase::new(graph.clone(), (0..n).map(|i| i % 50 != 7).collect(), None, 1);
    let stats = few.solve_to(3, &vec![0.0; 3 * n], &mut x, 1e-12);
    assert!(
        stats.method == SolveMethod::Direct && stats.converged && few.system.free_count() == 40,
        "{stats:?}"
    );
    assert!(few.residuals(3, &vec![0.0; 3 * n], &x).iter().all(|r| *r <= 1e-12));

    let some = SolverCase::new(graph, (0..n).map(|i| i % 4 != 1).collect(), None, 1);
    let stats = some.solve_to(3, &vec![0.0; 3 * n], &mut x, 1e-10);
    assert!(stats.method == SolveMethod::Multigrid && stats.converged, "{stats:?}");

    let empty = SolverCase::new(TestGraph::from_edges(Vec::new(), Vec::new()), Vec::new(), None, 1);
    assert!(empty.solve_to(3, &[], &mut [], 1e-6).converged);
    assert_eq!(few.solve_to(0, &[], &mut [], 1e-6).residuals.len(), 0);
}

#[test]
fn a_changed_handle_uses_the_same_hierarchy() {
    let case = SolverCase::ends(lattice(12, 12, 20), 2);
    let before = case.hierarchy.level_sizes();
    assert!(
        before.windows(2).all(|w| w[1].vertices * 2 < w[0].vertices),
        "levels shrink: {before:?}"
    );
    assert_eq!(before[0].edges, case.graph.edges().count());
    let other: Vec<bool> = case
        .graph
        .positions
        .iter()
        .map(|p| p[0] < 0.9 || (p[1] > 8.0 && p[2] > 12.0))
        .collect();
    let constraints = Constraints {
        fixed: &other,
        stiffness: None,
    };
    let system = case.hierarchy.constrain(&constraints, &case.pool).unwrap();
    let changed = SolverCase {
        fixed: other,
        system,
        ..case
    };
    let (rhs, mut x, _) = twist(&changed, 0.5);
    let stats = changed.solve_to(3, &rhs, &mut x, 1e-8);
    assert!(stats.converged && stats.factor < 0.4, "{stats:?}");
    assert!(changed.residuals(3, &rhs, &x).iter().all(|r| *r <= 1e-8));
}
