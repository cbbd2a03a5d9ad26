//! Laws of graphs whose interior follows the shape, after an edit: the lattice stays where the surface leaves it, and the surface is
//! tied to it as firmly as before.

use super::laws::{check, mesh_of, pool, try_follow};
use super::resampling::{Edited, Plan, Surface};
use super::shapes;
use glam::DVec3;
use pliant::exec::Exec;
use pliant::graph::{EdgeWeights, MeshGraph, ResampledGraph, VolumeOptions, WindingTree, surface, volume};
use pliant::progress::Silent;

fn shape_graph(surface: &Surface, options: &VolumeOptions) -> MeshGraph {
    let built = volume(&mesh_of(surface), options, &Exec::new(&pool(2), &Silent));
    built.expect("valid options").expect("an inside")
}

/// The sum of the weights of all edges between the surface and the lattice.
fn tied(graph: &MeshGraph) -> f64 {
    let weights = graph.weights.as_ref().expect("weights");
    let of = |node: usize| {
        let entries = graph.entries(node as u32);
        entries
            .filter(|&e| (graph.neighbours[e] as usize) < graph.surface)
            .map(|e| f64::from(weights[e]))
    };
    (graph.surface..graph.nodes()).flat_map(of).sum()
}

/// Follows an edit and checks all that holds for any.
fn follow_shape(name: &str, before: &Surface, graph: &MeshGraph, plan: &Plan) -> (Edited, ResampledGraph) {
    let edited = before.apply(plan);
    let after = try_follow(graph, &edited, 2).unwrap_or_else(|| panic!("{name} is followed"));
    assert!(
        try_follow(graph, &edited, 1).as_ref() == Some(&after),
        "{name}: the same bits on one thread"
    );
    check(graph, &edited, &after);
    let (points, faces) = (&edited.surface.points, &edited.surface.faces);
    let tree = WindingTree::build(points, faces, &pool(2));
    for i in after.graph.surface..after.graph.nodes() {
        let p = after.graph.positions[i];
        assert!(tree.winding_number(p).abs() > 0.9, "{name}: node {i} at {p} is inside");
    }
    // Edges of the mesh are those of a new graph, and weigh as much.
    let mesh = mesh_of(&edited.surface);
    let fresh = surface(&mesh, EdgeWeights::Cotangent);
    let weight = |g: &MeshGraph, e: usize| g.weights.as_ref().map_or(1.0, |w| w[e]);
    for v in 0..fresh.surface as u32 {
        let on_mesh: Vec<usize> = after
            .graph
            .entries(v)
            .filter(|&e| (after.graph.neighbours[e] as usize) < fresh.surface)
            .collect();
        let ours: Vec<u32> = on_mesh.iter().map(|&e| after.graph.neighbours[e]).collect();
        assert_eq!(ours, fresh.row(v), "{name}: vertex {v}");
        for (&e, f) in on_mesh.iter().zip(fresh.entries(v)) {
            let (ours, theirs) = (weight(&after.graph, e), weight(&fresh, f));
            assert!(
                (ours / theirs - 1.0).abs() < 0.01,
                "{name}: vertex {v}: {ours}, new {theirs}"
            );
        }
    }
    (edited, after)
}

#[test]
fn local_edits_keep_the_lattice_and_the_strength_of_its_ties() {
    for (name, surface, seed) in [
        ("ball", Surface::of(shapes::sphere(5, 1.0)), 100),
        ("ring", Surface::of(shapes::torus(120, 60, 2.0, 0.7)), 30),
        (
            "turned",
            Surface::of(shapes::inside_out(shapes::torus(120, 60, 2.0, 0.7))),
            30,
        ),
    ] {
        let graph = shape_graph(&surface, &VolumeOptions::default());
        let edge = surface.mean_edge();
        for (how, plan) in [
            (
                "refilled",
                surface.refill(seed, 5, DVec3::new(0.3, 0.5, 0.2) * edge * 0.2),
            ),
            ("collapsed", surface.collapse(seed, 4)),
            ("subdivided", surface.subdivide(seed, 5)),
            ("pulled", surface.pull(seed, 5, DVec3::new(0.3, 0.5, 0.2) * edge)),
        ] {
            let name = format!("{name} {how}");
            let (_, after) = follow_shape(&name, &surface, &graph, &plan);
            assert!(
                after.graph.stats.lattice_nodes + 8 > graph.stats.lattice_nodes,
                "{name}"
            );
            let (ours, before) = (tied(&after.graph), tied(&graph));
            assert!(
                (ours / before - 1.0).abs() < 0.1,
                "{name}: ties weigh {ours}, before {before}"
            );
            assert!(
                after.touched.len() < graph.nodes() / 8,
                "{name}: {} touched",
                after.touched.len()
            );
        }
    }
}

#[test]
fn nodes_of_what_is_cut_off_are_gone() {
    let ball = Surface::of(shapes::sphere(5, 1.0));
    let graph = shape_graph(&ball, &VolumeOptions::default());
    let plan = ball.capped(ball.faces_in(|v| ball.points[v as usize].z > 0.7));
    let (_, after) = follow_shape("capped", &ball, &graph, &plan);
    assert!(after.graph.stats.lattice_nodes < graph.stats.lattice_nodes);
    assert!(after.graph.stats.enclosed_volume < 0.98 * graph.stats.enclosed_volume);
}

#[test]
fn what_the_lattice_cannot_follow_is_left_to_a_new_graph() {
    let ball = Surface::of(shapes::sphere(5, 1.0));
    let graph = shape_graph(&ball, &VolumeOptions::default());
    let ask = |graph: &MeshGraph, plan: Plan| try_follow(graph, &ball.apply(&plan), 2).is_some();
    let disc = |rings: usize| {
        let disc = ball.disc(100, rings);
        ball.faces_in(|v| disc.contains(&v))
    };
    let outward = ball.points[100].normalize();
    assert!(!ask(&graph, Plan::without(disc(3))), "a hole");
    assert!(
        !ask(&graph, ball.pull(100, 10, outward)),
        "a horn as long as the ball is thick"
    );
    let above = |h: f64| ball.faces_in(|v| ball.points[v as usize].z > h);
    assert!(!ask(&graph, ball.capped(above(0.2))), "more than a quarter goes");
    // Sessions of before have a new graph after each edit.
    let before = VolumeOptions {
        follows_edits: false,
        ..VolumeOptions::default()
    };
    assert!(ask(&graph, ball.collapse(100, 3)));
    assert!(!ask(&shape_graph(&ball, &before), ball.collapse(100, 3)));
}
