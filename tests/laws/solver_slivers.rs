//! The solver on graphs of degenerate meshes: slivers and coincident vertices.

use case::{SolverCase, noise};
use glam::DVec3;
use graphs::TestGraph;
use pliant::exec::Exec;
use pliant::graph::{EdgeWeights, VolumeOptions, volume};
use pliant::mesh::{Mesh, Weld};
use pliant::pool::Pool;
use pliant::progress::Silent;

#[allow(dead_code)]
#[path = "../../src/solver/tests/laws/case.rs"]
mod case;
#[allow(dead_code)]
#[path = "../../src/solver/tests/laws/graphs.rs"]
mod graphs;

/// The cube from 0 to 1 in `n` slabs along x, all squeezed against one end, so that triangles are `squeeze` times as
/// long as wide; opposite slabs coincide in single precision.
fn slivers(n: u32, squeeze: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let around = [[0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [1, 2], [0, 2], [0, 1]];
    let mut points = Vec::new();
    for slab in 0..=n {
        let at = if slab == n { 1.0 } else { f64::from(slab) / squeeze };
        points.extend(around.map(|[y, z]| DVec3::new(at, f64::from(y) / 2.0, f64::from(z) / 2.0)));
    }
    let mut faces = Vec::new();
    for slab in 0..n {
        for k in 0..8 {
            let [a, b] = [8 * slab + k, 8 * slab + (k + 1) % 8];
            faces.extend([[a, a + 8, b + 8], [a, b + 8, b]]);
        }
    }
    for k in 1..7 {
        faces.extend([[0, k, k + 1], [8 * n, 8 * n + k + 1, 8 * n + k]]);
    }
    (points, faces)
}

#[test]
fn graphs_of_slivers_and_coincident_vertices_converge() {
    let pool = Pool::new(1).unwrap();
    let mut solved = 0;
    for squeeze in [1e2, 1e6, 1e12] {
        let (points, faces) = slivers(600, squeeze);
        let mesh = Mesh::build(&points, &faces, Weld::Exact).unwrap();
        for weights in [EdgeWeights::Uniform, EdgeWeights::Cotangent] {
            let options = VolumeOptions {
                weights,
                max_nodes: 100_000,
                ..VolumeOptions::default()
            };
            let name = format!("squeezed {squeeze:e} times, {weights:?}");
            let inside = volume(&mesh, &options, &Exec::new(&pool, &Silent));
            // A lattice as fine as the slivers may be more than is allowed; the surface is always there.
            let graphs = [inside.ok().flatten(), Some(pliant::graph::surface(&mesh, weights))];
            for graph in graphs.into_iter().flatten() {
                let rows = (0..graph.nodes() as u32).flat_map(|i| graph.row(i).iter().map(move |&j| (i, j)));
                let positions: Vec<[f64; 3]> = graph.positions.iter().map(|p| p.to_array()).collect();
                let n = graph.nodes();
                let same = TestGraph::from_edges(positions, rows.collect());
                let same = match &graph.weights {
                    Some(w) => same.with_weights(w.clone()),
                    None => same,
                };
                let fixed: Vec<bool> = (0..n)
                    .map(|i| i < 8 || (graph.surface - 8..graph.surface).contains(&i))
                    .collect();
                let case = SolverCase::new(same, fixed, None, 1);
                let (rhs, mut x) = (vec![0.0; n], noise(n, 3));
                let stats = case.solve_to(1, &rhs, &mut x, 1e-8);
                assert!(
                    x.iter().all(|v| v.is_finite()) && stats.converged,
                    "{name}, {n} nodes: {stats:?}"
                );
                let seen = case.residuals(1, &rhs, &x);
                assert!(seen[0] <= 1e-8 * 1.001, "{name}, {n} nodes: {seen:?}");
                solved += 1;
            }
        }
    }
    assert!(solved >= 6, "all surfaces are solved on");
}
