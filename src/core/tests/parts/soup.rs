//! Soups in which every triangle is a part of its own: time and memory stay in proportion to them.

use glam::DVec3;
use pliant_core::asset::shapes::Shape;
use pliant_core::exec::Exec;
use pliant_core::graph::{TieOptions, VolumeOptions, surface, tie_parts, volume};
use pliant_core::mesh::{Mesh, Weld};
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;
use std::time::Instant;

/// So many triangles at places and in directions that look random, together as dense as a filled box.
fn soup(count: usize) -> Shape {
    let mut state = 0x9E37_79B9_7F4A_7C15u64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let side = libm::cbrt(count as f64).recip();
    let mut points = Vec::with_capacity(3 * count);
    for _ in 0..count {
        let at = DVec3::new(next(), next(), next());
        for _corner in 0..3 {
            points.push(at + DVec3::new(next() - 0.5, next() - 0.5, next() - 0.5) * (1.5 * side));
        }
    }
    let faces = (0..count as u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    (points, faces)
}

/// Ties a soup, and tells how many ties there are.
fn tied(count: usize) -> usize {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (points, faces) = soup(count);
    let started = Instant::now();
    let mesh = Mesh::build(&points, &faces, Weld::Exact).expect("a mesh");
    let welded = started.elapsed();
    let options = VolumeOptions::default();
    let graph = volume(&mesh, &options, &exec).expect("fits");
    let graph = graph.unwrap_or_else(|| surface(&mesh, options.weights));
    let built = started.elapsed();
    let (nodes, bytes) = (graph.nodes(), graph.byte_size());
    let tied = tie_parts(graph, &mesh, &TieOptions::default(), &exec).expect("ties");
    let ties = tied.ties.as_ref().map_or(0, |ties| ties.edge_count());
    println!(
        "{count} triangles: welded {:.2} s, graph of {nodes} nodes after {:.2} s, {ties} ties after {:.2} s, {:.0} then {:.0} bytes a vertex",
        welded.as_secs_f64(),
        built.as_secs_f64(),
        started.elapsed().as_secs_f64(),
        bytes as f64 / mesh.positions.len() as f64,
        tied.byte_size() as f64 / mesh.positions.len() as f64,
    );
    // Each vertex is tied to three corners in up to three other parts.
    assert!(ties <= 9 * mesh.positions.len(), "{ties}");
    assert!(tied.byte_size() < 1200 * mesh.positions.len(), "{}", tied.byte_size());
    ties
}

#[test]
fn a_hundred_thousand_parts_of_one_triangle_have_ties_in_proportion() {
    let few = tied(10_000);
    let many = tied(100_000);
    assert!(few > 0 && many < 11 * few, "{few} then {many}");
}

/// `cargo test --release -p pliant-core --test parts -- --ignored million --nocapture`
#[test]
#[ignore = "prints figures"]
fn a_million_parts_of_one_triangle() {
    tied(1_000_000);
}
