//! What ties cost: `cargo test --release -p pliant-core --test parts -- --ignored cost --nocapture`.

use crate::data;
use crate::sweep::models_of_parts;
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
