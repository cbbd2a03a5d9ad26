//! A hierarchy that follows its graph solves as a fresh one does, after any number of changes.

use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::{CancelFlag, Silent};
use pliant_solver::{
    BuildOptions, CoarseOperators, Constraints, Error, GraphChange, Hierarchy, RepairReport, WeightedGraph,
};

use super::case::{SolverCase, largest_distance, twist};
use super::edits::{EditableGraph, EditedGraph};
use super::graphs::{TestGraph, lattice, surface};

fn built(graph: &TestGraph) -> Hierarchy {
    Hierarchy::build(
        &graph.view(),
        &BuildOptions::default(),
        &Exec::new(&Pool::new(1).unwrap(), &Silent),
    )
    .unwrap()
}

fn repaired(hierarchy: &mut Hierarchy, cast: &EditedGraph, threads: usize) -> RepairReport {
    cast.graph.view().check().unwrap();
    let pool = Pool::new(threads).unwrap();
    hierarchy
        .repair(&cast.graph.view(), &cast.change(), &Exec::new(&pool, &Silent))
        .unwrap()
}

/// A case on the graph of `cast`, ends along `axis` held, with that hierarchy.
fn case_with(graph: &TestGraph, axis: usize, hierarchy: Hierarchy) -> SolverCase {
    let fixed = graph.ends(axis, 1.1);
    let pool = Pool::new(1).unwrap();
    let constraints = Constraints {
        fixed: &fixed,
        stiffness: None,
    };
    let system = hierarchy.constrain(&constraints, &pool).unwrap();
    SolverCase {
        graph: graph.clone(),
        fixed,
        stiffness: None,
        hierarchy,
        system,
        pool,
    }
}

/// Iterations to 1e-6 and the solution to 1e-10.
fn solved(case: &SolverCase) -> (usize, Vec<f64>) {
    let (rhs, start, _) = twist(case, 1.1);
    let mut x = start.clone();
    let stats = case.solve_to(3, &rhs, &mut x, 1e-6);
    assert!(stats.converged, "{stats:?}");
    let mut x = start;
    assert!(case.solve_to(3, &rhs, &mut x, 1e-10).converged);
    (stats.iterations, x)
}

/// Compares `hierarchy` with a fresh one of its graph.
fn compare(graph: &TestGraph, axis: usize, hierarchy: &Hierarchy, what: &str) {
    let fresh = case_with(graph, axis, built(graph));
    let (want, exact) = solved(&fresh);
    let (seen, x) = solved(&case_with(graph, axis, hierarchy.clone()));
    assert!(seen <= want + 1, "{what}: {seen} iterations, {want} after a build");
    let apart = largest_distance(3, &x, &exact);
    assert!(apart < 1e-6, "{what}: solutions are {apart} apart");
}

/// Edits `graph` at random places and compares once in a while.
fn many_edits(graph: TestGraph, axis: usize, weighted: bool, degree: usize, edits: usize, seed: u64) {
    let mut clay = EditableGraph::new(&graph, weighted, seed);
    let mut cast = clay.cast(&[]);
    let mut hierarchy = built(&cast.graph);
    let mut followed = 0;
    for k in 1..=edits {
        clay.edit(degree);
        let ids = std::mem::take(&mut cast.ids);
        cast = clay.cast(&ids);
        followed += usize::from(!repaired(&mut hierarchy, &cast, 1).rebuilt);
        if k % (edits / 4) == 0 {
            let facts = hierarchy.level_sizes()[0];
            assert_eq!(facts.vertices, cast.graph.len());
            assert_eq!(facts.edges, cast.graph.edges().count());
            compare(&cast.graph, axis, &hierarchy, &format!("after {k} edits"));
        }
    }
    assert_eq!(followed, edits, "none of these edits is worth a build");
}

#[test]
fn volumes_converge_as_after_a_build_whatever_was_edited() {
    many_edits(lattice(18, 18, 34), 2, false, 14, 300, 1);
}

#[test]
fn weighted_volumes_converge_as_after_a_build_whatever_was_edited() {
    many_edits(lattice(16, 16, 30), 2, true, 14, 300, 2);
}

#[test]
fn surfaces_converge_as_after_a_build_whatever_was_edited() {
    many_edits(surface(170, 110), 0, false, 6, 300, 3);
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let digests: Vec<(Vec<u64>, usize)> = [1, 2, 3, 8]
        .map(|threads| {
            let mut clay = EditableGraph::new(&lattice(20, 20, 30), false, 5);
            let mut cast = clay.cast(&[]);
            let mut hierarchy = built(&cast.graph);
            for _ in 0..6 {
                (0..8).for_each(|_| clay.edit(14));
                let ids = std::mem::take(&mut cast.ids);
                cast = clay.cast(&ids);
                assert!(!repaired(&mut hierarchy, &cast, threads).rebuilt);
            }
            let mut case = case_with(&cast.graph, 2, hierarchy);
            case.pool = Pool::new(threads).unwrap();
            let bits = solved(&case).1.iter().map(|v| v.to_bits()).collect();
            (bits, case.hierarchy.byte_size())
        })
        .into();
    assert!(digests.iter().all(|d| *d == digests[0]));
}

#[test]
fn nothing_changes_nothing() {
    let graph = lattice(16, 16, 16);
    let before = case_with(&graph, 2, built(&graph));
    let mut hierarchy = before.hierarchy.clone();
    let same: Vec<u32> = (0..graph.len() as u32).collect();
    let change = GraphChange {
        new_from_old: &same,
        touched: &[],
    };
    let pool = Pool::new(1).unwrap();
    let report = hierarchy
        .repair(&graph.view(), &change, &Exec::new(&pool, &Silent))
        .unwrap();
    assert_eq!(
        report,
        RepairReport {
            rebuilt: false,
            moved: 0
        }
    );
    assert!(!hierarchy.is_worn());
    let after = case_with(&graph, 2, hierarchy);
    assert!(solved(&before) == solved(&after), "to the bit");
}

#[test]
fn systems_from_before_are_refused() {
    let mut clay = EditableGraph::new(&lattice(14, 14, 14), false, 9);
    let first = clay.cast(&[]);
    let mut case = case_with(&first.graph, 2, built(&first.graph));
    clay.edit(14);
    let cast = clay.cast(&first.ids);
    repaired(&mut case.hierarchy, &cast, 1);
    let text = case
        .system
        .equations(&case.hierarchy, 1, &[0.0])
        .residual(&[0.0], None, &case.pool)
        .unwrap_err()
        .to_string();
    assert!(text.contains("another hierarchy"), "{text}");
}

#[test]
fn large_changes_and_other_kinds_of_graphs_are_rebuilt() {
    let graph = lattice(14, 14, 14);
    let pool = Pool::new(1).unwrap();
    let same: Vec<u32> = (0..graph.len() as u32).collect();
    let half = GraphChange {
        new_from_old: &same,
        touched: &same[..graph.len() / 2],
    };
    let few = GraphChange {
        new_from_old: &same,
        touched: &same[..9],
    };
    let fresh = |graph: &TestGraph| solved(&case_with(graph, 2, built(graph)));
    for (graph, change) in [
        (graph.clone(), half),
        (graph.clone().weighted(0.0, 1.0, 3), few),
        (graph.clone().without_positions(), few),
    ] {
        let mut hierarchy = built(&lattice(14, 14, 14));
        let report = hierarchy
            .repair(&graph.view(), &change, &Exec::new(&pool, &Silent))
            .unwrap();
        assert!(report.rebuilt);
        assert!(solved(&case_with(&graph, 2, hierarchy)) == fresh(&graph), "to the bit");
    }
    let options = BuildOptions {
        operators: CoarseOperators::Paper,
        ..BuildOptions::default()
    };
    let mut paper = Hierarchy::build(&graph.view(), &options, &Exec::new(&pool, &Silent)).unwrap();
    assert!(
        paper
            .repair(&graph.view(), &few, &Exec::new(&pool, &Silent))
            .unwrap()
            .rebuilt
    );
}

#[test]
fn graphs_without_positions_are_followed() {
    let graph = lattice(18, 18, 18).without_positions();
    let mut clay = EditableGraph::new(&graph, false, 4);
    let mut cast = clay.cast(&[]);
    let mut hierarchy = built(&cast.graph.clone().without_positions());
    for _ in 0..20 {
        clay.edit(14);
        let ids = std::mem::take(&mut cast.ids);
        cast = clay.cast(&ids);
        cast.graph = cast.graph.without_positions();
        assert!(!repaired(&mut hierarchy, &cast, 1).rebuilt);
    }
    compare(&cast.graph, 2, &hierarchy, "without positions");
}

/// A change that is refused, and what the refusal names.
fn refused(graph: &WeightedGraph<'_>, change: &GraphChange<'_>, named: &str) {
    let before = lattice(14, 14, 14);
    let mut hierarchy = built(&before);
    let want = solved(&case_with(&before, 2, hierarchy.clone()));
    let error = hierarchy
        .repair(graph, change, &Exec::new(&Pool::new(1).unwrap(), &Silent))
        .unwrap_err();
    assert!(error.to_string().contains(named), "{error}");
    assert!(solved(&case_with(&before, 2, hierarchy)) == want, "nothing happened");
}

#[test]
fn contradictions_are_refused_and_change_nothing() {
    let graph = lattice(14, 14, 14);
    let n = graph.len() as u32;
    let same: Vec<u32> = (0..n).collect();
    let view = graph.view();
    let with = |map: &[u32], touched: &[u32], named: &str| {
        let change = GraphChange {
            new_from_old: map,
            touched,
        };
        refused(&view, &change, named);
    };
    with(&same[1..], &[], "maps 5487 old vertices");
    with(&same, &[3, 3], "must rise");
    with(&same, &[n], "not one of");
    let mut map = same.clone();
    map[7] = 8;
    with(&map, &[7], "so does another");
    map[7] = n + 5;
    with(&map, &[7], "becomes 5493");
    map[7] = u32::MAX;
    with(&map, &[], "all new vertices must be");
    // Vertex 7 is gone and a new one stands in its place: its neighbours have changed.
    with(&map, &[7], "is not among the touched ones");
    // Two vertices trade places.
    map[7] = 3000;
    map[3000] = 7;
    with(&map, &[7, 3000], "is not among the touched ones");

    let lacks = |drop: (u32, u32)| {
        TestGraph::from_edges(graph.positions.clone(), graph.edges().filter(|e| *e != drop).collect())
    };
    let cut = lacks((0, 1));
    let change = GraphChange {
        new_from_old: &same,
        touched: &[0],
    };
    refused(&cut.view(), &change, "vertex 1 is not among the touched ones");
    let short = WeightedGraph {
        positions: Some(&graph.positions[1..]),
        ..view
    };
    refused(&short, &change, "positions for");
}

#[test]
fn cancelled_repairs_change_nothing() {
    let graph = lattice(14, 14, 14);
    let mut hierarchy = built(&graph);
    let want = solved(&case_with(&graph, 2, hierarchy.clone()));
    let same: Vec<u32> = (0..graph.len() as u32).collect();
    let change = GraphChange {
        new_from_old: &same,
        touched: &[1, 2, 3],
    };
    let flag = CancelFlag::default();
    flag.cancel();
    let error = hierarchy
        .repair(&graph.view(), &change, &Exec::new(&Pool::new(1).unwrap(), &flag))
        .unwrap_err();
    assert_eq!(error, Error::Cancelled);
    assert!(solved(&case_with(&graph, 2, hierarchy)) == want, "nothing happened");
}
