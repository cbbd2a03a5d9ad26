//! What ties cost: `cargo test --release -p pliant-core --test engine -- --ignored cost --nocapture`. In soups in which every
//! triangle is a part of its own, time and memory stay in proportion to them.

use crate::data;
use super::sweep::models_of_parts;
use glam::DVec3;
use pliant_core::asset::shapes::Shape;
use pliant_core::asset::{Limits, Model};
use pliant_core::exec::Exec;
use pliant_core::graph::{TieOptions, VolumeOptions, surface, tie_parts, volume};
use pliant_core::mesh::{Mesh, Weld};
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;
use std::time::{Duration, Instant};

const RUNS: usize = 5;

/// The least time of several runs, and what the last one made.
fn least<T>(mut work: impl FnMut() -> T) -> (Duration, T) {
    let mut run = || {
        let started = Instant::now();
        let made = work();
        (started.elapsed(), made)
    };
    let (mut least, mut made) = run();
    for _ in 1..RUNS {
        let (time, again) = run();
        (least, made) = (least.min(time), again);
    }
    (least, made)
}

#[test]
#[ignore = "prints figures"]
fn cost_of_ties() {
    let Some(root) = data::data_folder("what ties cost") else {
        return;
    };
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    for (name, files) in models_of_parts(&root) {
        let Ok(model) = Model::read(files, None, &Limits::default()) else {
            continue;
        };
        let Ok(mesh) = Mesh::build(&model.positions, &model.triangles, Weld::Exact) else {
            continue;
        };
        let options = VolumeOptions::default();
        let build = || {
            volume(&mesh, &options, &exec)
                .expect("fits")
                .unwrap_or_else(|| surface(&mesh, options.weights))
        };
        let (graph_time, graph) = least(build);
        let mut graphs: Vec<_> = (0..RUNS).map(|_| graph.clone()).collect();
        let (tie_time, tied) = least(|| {
            let graph = graphs.pop().unwrap_or_else(|| graph.clone());
            tie_parts(graph, &mesh, &TieOptions::default(), &exec).expect("ties")
        });
        let Some(ties) = &tied.ties else { continue };
        eprintln!(
            "{name:36} {:7} vertices {:7} nodes {:7} ties: graph {:8.1} ms, ties {:7.2} ms, {:4.1} %",
            mesh.positions.len(),
            graph.nodes(),
            ties.edge_count(),
            graph_time.as_secs_f64() * 1e3,
            tie_time.as_secs_f64() * 1e3,
            100.0 * tie_time.as_secs_f64() / (graph_time + tie_time).as_secs_f64(),
        );
    }
}

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

/// Ties a soup, and counts the ties.
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

/// `cargo test --release -p pliant-core --test engine -- --ignored million --nocapture`
#[test]
#[ignore = "prints figures"]
fn a_million_parts_of_one_triangle() {
    tied(1_000_000);
}
