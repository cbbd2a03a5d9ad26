//! What a graph promises after an edit, and short ways to build and follow one.
#![allow(dead_code)]

use super::resampling::{Edited, NONE, Plan, Surface};
use super::shapes;
use glam::DVec3;
use pliant::exec::Exec;
use pliant::graph::{MeshGraph, ResampledGraph, VolumeOptions, WindingTree, resample, volume};
use pliant::mesh::{Mesh, Weld};
use pliant::pool::Pool;
use pliant::progress::Silent;

pub fn pool(threads: usize) -> Pool {
    Pool::new(threads).expect("threads start")
}

/// A new graph of a surface, with the lengths of another graph.
pub fn built_new(surface: &Surface, graph: &MeshGraph) -> MeshGraph {
    let same = VolumeOptions {
        interval: Some(graph.stats.interval),
        shell_offset: Some(graph.stats.shell_offset),
        ..shapes::paper_graph()
    };
    let fresh = volume(&mesh_of(surface), &same, &Exec::new(&pool(2), &Silent));
    fresh.expect("valid").expect("an inside")
}

pub fn mesh_of(surface: &Surface) -> Mesh {
    let mesh = Mesh::build(&surface.points, &surface.faces, Weld::Exact).expect("a mesh");
    assert_eq!(mesh.positions, surface.points, "points are distinct, used and in order");
    mesh
}

pub fn volume_of(surface: &Surface) -> MeshGraph {
    volume(&mesh_of(surface), &shapes::paper_graph(), &Exec::new(&pool(2), &Silent))
        .expect("valid options")
        .expect("an inside")
}

/// The graph after an edit; `None` where it is left to a new graph.
pub fn try_follow(graph: &MeshGraph, edited: &Edited, threads: usize) -> Option<ResampledGraph> {
    let exec_pool = pool(threads);
    let exec = Exec::new(&exec_pool, &Silent);
    resample(graph, &graph.positions, &edited.change(), &exec).expect("not cancelled")
}

pub fn follow(graph: &MeshGraph, edited: &Edited) -> ResampledGraph {
    try_follow(graph, edited, 2).expect("can be followed")
}

/// The graph after an edit, once all that must hold was checked.
pub fn followed(graph: &MeshGraph, edited: &Edited) -> ResampledGraph {
    let after = follow(graph, edited);
    check(graph, edited, &after);
    after
}

/// What must hold after any edit.
pub fn check(before: &MeshGraph, edited: &Edited, after: &ResampledGraph) {
    let graph = &after.graph;
    shapes::check_graph(graph, &mesh_of(&edited.surface));
    // Maps are inverse to each other, keep the order of each kind, and agree with the points'.
    let kinds = |g: &MeshGraph| [g.surface, g.surface + g.stats.shell_nodes, g.nodes()];
    let kind = |g: &MeshGraph, node: u32| kinds(g).partition_point(|&end| end <= node as usize);
    assert_eq!(
        (after.new_from_old.len(), after.old_from_new.len()),
        (before.nodes(), graph.nodes())
    );
    for (o, &n) in (0u32..).zip(&after.new_from_old).filter(|m| *m.1 != NONE) {
        assert_eq!(after.old_from_new[n as usize], o);
        assert_eq!(kind(before, o), kind(graph, n));
    }
    let mut from = 0;
    for end in kinds(graph) {
        let own = &after.old_from_new[from..end];
        let kept = own.partition_point(|&o| o != NONE);
        assert!(own[..kept].is_sorted() && own[kept..].iter().all(|&o| o == NONE));
        from = end;
    }
    let left = after.old_from_new.iter().filter(|&&o| o != NONE).count();
    assert_eq!(left, after.new_from_old.iter().filter(|&&n| n != NONE).count());
    assert_eq!(after.old_from_new[..graph.surface], edited.old_from_new);
    // Components are numbered by their smallest node.
    let mut seen = 0;
    for &c in &graph.component {
        assert!(c <= seen);
        seen = seen.max(c + 1);
    }
    assert_eq!(seen as usize, graph.components);
    // They are the ones of the graph.
    let mut reached = vec![false; graph.nodes()];
    let mut parts = 0;
    for first in 0..graph.nodes() as u32 {
        if std::mem::replace(&mut reached[first as usize], true) {
            continue;
        }
        parts += 1;
        let mut front = vec![first];
        while let Some(here) = front.pop() {
            front.extend(
                graph
                    .row(here)
                    .iter()
                    .copied()
                    .filter(|&m| !std::mem::replace(&mut reached[m as usize], true)),
            );
        }
    }
    assert_eq!(parts, graph.components);
    for c in 0..graph.components as u32 {
        let inner = (graph.surface..graph.nodes()).any(|i| graph.component[i] == c);
        assert_eq!(graph.stats.component_has_volume[c as usize], inner);
    }
    // What is not touched is as it was.
    assert!(after.touched.windows(2).all(|w| w[0] < w[1]));
    let weights = |g: &MeshGraph, i: u32| {
        g.weights
            .as_ref()
            .map(|w| w[g.offsets[i as usize] as usize..g.offsets[i as usize + 1] as usize].to_vec())
    };
    for n in 0..graph.nodes() as u32 {
        let o = after.old_from_new[n as usize];
        let same = o != NONE && graph.positions[n as usize] == before.positions[o as usize] && {
            let row: Vec<u32> = before.row(o).iter().map(|&m| after.new_from_old[m as usize]).collect();
            row == graph.row(n) && weights(before, o) == weights(graph, n)
        };
        assert_eq!(!same, after.touched.binary_search(&n).is_ok(), "node {n}");
    }
}

/// Interior nodes lie inside, and as deep as in a new graph.
pub fn check_places(edited: &Edited, graph: &MeshGraph, depth: f64) {
    let (points, faces) = (&edited.surface.points, &edited.surface.faces);
    let tree = WindingTree::build(points, faces, &pool(2));
    for i in graph.surface..graph.nodes() {
        let p = graph.positions[i];
        assert!(
            tree.winding_number(p).abs() > 0.9,
            "node {i} at {p} is inside: {}",
            tree.winding_number(p)
        );
        let distance = tree.bvh().closest_point(p).expect("a surface").distance;
        if i < graph.surface + graph.stats.shell_nodes {
            let way = p.distance(points[graph.nearest_surface[i] as usize]);
            assert!(way <= graph.stats.shell_offset * 1.000_001, "copy {i} is {way} away");
            assert!(distance >= way * 0.499_999, "copy {i}: {distance} deep, {way} away");
        } else {
            assert!(distance >= depth, "lattice node {i} is {distance} deep, {depth} wanted");
            let near = points[graph.nearest_surface[i] as usize].distance(p);
            let least = points.iter().map(|v| v.distance(p)).fold(f64::INFINITY, f64::min);
            assert!(
                near <= least * 1.25,
                "lattice node {i}: {near} to its vertex, {least} to the nearest"
            );
        }
    }
}

/// Nodes no further than some edges from what changed.
pub fn near(graph: &MeshGraph, places: &[DVec3], within: f64) -> [usize; 2] {
    let mut count = [0; 2];
    for i in graph.surface..graph.nodes() {
        if places.iter().any(|q| q.distance(graph.positions[i]) < within) {
            count[usize::from(i >= graph.surface + graph.stats.shell_nodes)] += 1;
        }
    }
    count
}

/// Follows an edit and checks it against the graph before and against a new one.
pub fn try_edit(name: &str, before: &Surface, graph: &MeshGraph, plan: &Plan) -> (Edited, ResampledGraph) {
    let edited = before.apply(plan);
    let after = follow(graph, &edited);
    check(graph, &edited, &after);
    let depth = 1.25 * graph.stats.shell_offset;
    check_places(&edited, &after.graph, depth * (1.0 - 1e-9));
    let places = edited.changed_places(before);
    let within = 4.0 * graph.stats.interval;
    // Far from the edit nothing is touched, and no node is gone.
    let bounds = pliant::mesh::BoundingBox::of(&places);
    let far = |p: DVec3| (p - p.clamp(bounds.min, bounds.max)).length() > 6.0 * graph.stats.interval;
    for &n in &after.touched {
        assert!(
            !far(after.graph.positions[n as usize]),
            "{name}: node {n} is far from the edit"
        );
    }
    for (o, _) in after.new_from_old.iter().enumerate().filter(|m| *m.1 == NONE) {
        assert!(!far(graph.positions[o]), "{name}: old node {o} is far from the edit");
    }
    // As many nodes near the edit as with the same lengths from scratch.
    let fresh = built_new(&edited.surface, graph);
    let (ours, theirs) = (near(&after.graph, &places, within), near(&fresh, &places, within));
    println!(
        "{name}: {} points, {} nodes, {} touched; near the edit {ours:?}, in a new graph {theirs:?}; components {} {}; volume {} {}",
        edited.surface.points.len(),
        after.graph.nodes(),
        after.touched.len(),
        after.graph.components,
        fresh.components,
        after.graph.stats.enclosed_volume,
        fresh.stats.enclosed_volume,
    );
    for k in 0..2 {
        let slack = (0.15 * theirs[k] as f64).max(8.0);
        assert!(
            (ours[k] as f64 - theirs[k] as f64).abs() <= slack,
            "{name}: {ours:?} near the edit, new {theirs:?}"
        );
    }
    assert_eq!(after.graph.components, fresh.components, "{name}");
    let volume = (after.graph.stats.enclosed_volume, fresh.stats.enclosed_volume);
    assert!((volume.0 / volume.1 - 1.0).abs() < 1e-2, "{name}: {volume:?}");
    (edited, after)
}
