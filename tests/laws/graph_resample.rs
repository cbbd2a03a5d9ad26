//! Laws of graphs that follow an edit: what the graph promises holds, far nodes keep their bits, near ones are what a new
//! graph would have.

use crate::support::data::data_bytes;
use glam::DVec3;
use laws::*;
use pliant::asset::{FileSet, Limits, Model};
use pliant::exec::Exec;
use pliant::graph::{EdgeWeights, MeshGraph, VolumeOptions, WindingTree, surface, volume};
use pliant::mesh::{Mesh, Weld};
use pliant::progress::Silent;
use resampling::{Plan, Surface};

mod laws;
mod resampling;
mod shape_kind;
use crate::support::shapes;

fn ball() -> Surface {
    Surface::of(shapes::sphere(5, 1.0))
}

#[test]
fn an_edit_that_changes_nothing_touches_nothing() {
    let ball = ball();
    let graph = volume_of(&ball);
    let same = ball.apply(&Plan::default());
    let after = follow(&graph, &same);
    assert!(after.touched.is_empty() && after.graph == graph);
    // Faces that go and come back as they were change no node either.
    let plan = Plan {
        removed: vec![7, 8, 9],
        faces: ball.faces[7..10].to_vec(),
        ..Plan::default()
    };
    let edited = ball.apply(&plan);
    let after = followed(&graph, &edited);
    assert!(after.touched.is_empty(), "{} touched", after.touched.len());
    assert_eq!(after.graph, graph);
}

#[test]
fn a_disc_filled_with_others_is_followed() {
    for (name, surface, seed) in [
        ("ball", ball(), 100),
        ("ring", Surface::of(shapes::torus(120, 60, 2.0, 0.7)), 30),
        ("box", Surface::of(shapes::cube(6)), 700),
    ] {
        let graph = volume_of(&surface);
        let edge = surface.mean_edge();
        let normal = DVec3::new(0.3, 0.5, 0.2);
        for (how, plan) in [
            ("refilled", surface.refill(seed, 5, normal * edge * 0.2)),
            ("collapsed", surface.collapse(seed, 4)),
            ("subdivided", surface.subdivide(seed, 5)),
        ] {
            try_edit(&format!("{name} {how}"), &surface, &graph, &plan);
        }
    }
}

#[test]
fn pulling_out_and_pushing_in_make_and_take_nodes() {
    let ball = ball();
    let graph = volume_of(&ball);
    let seed = 100;
    let outward = ball.points[seed as usize].normalize();
    for by in [8.0, -8.0] {
        let plan = ball.pull(seed, 8, outward * by * ball.mean_edge());
        let (edited, after) = try_edit(&format!("pulled by {by}"), &ball, &graph, &plan);
        // And back again.
        let back: Vec<(u32, DVec3)> = plan.moved.iter().map(|m| (m.0, ball.points[m.0 as usize])).collect();
        let again = edited.surface.apply(&Plan {
            moved: back,
            ..Plan::default()
        });
        let there = followed(&after.graph, &again);
        let sorted = |g: &MeshGraph| {
            let mut all: Vec<[u64; 3]> = g.positions.iter().map(|p| p.to_array().map(f64::to_bits)).collect();
            all.sort_unstable();
            all
        };
        assert_eq!(there.graph.edges(), graph.edges());
        let (ours, first) = (sorted(&there.graph), sorted(&graph));
        let differ = ours.iter().filter(|p| first.binary_search(p).is_err()).count();
        assert!(
            ours.len() == first.len() && differ < 300,
            "{differ} of {} differ",
            ours.len()
        );
    }
}

#[test]
fn a_part_cut_off_is_gone_and_a_part_cut_loose_is_its_own() {
    let ring = Surface::of(shapes::torus(120, 60, 2.0, 0.7));
    let graph = volume_of(&ring);
    // A slice of the ring goes; both ends are closed.
    let slice = |p: DVec3| p.x > 1.0 && p.y.abs() < 0.5;
    let plan = ring.capped(ring.faces_in(|v| slice(ring.points[v as usize])));
    try_edit("slice taken out", &ring, &graph, &plan);
    let (edited, after) = try_edit(
        "slice cut loose",
        &ring,
        &graph,
        &ring.cut(slice, |p| p - DVec3::Y * p.y * 0.05),
    );
    assert_eq!(after.graph.components, 2);
    // And merged with the ring again by a bridge: both parts lose a disc, and a band joins the rims.
    let graph = after.graph;
    let surface = edited.surface;
    try_edit("another disc", &surface, &graph, &surface.refill(200, 3, DVec3::ZERO));
}

#[test]
fn a_bridge_joins_two_parts() {
    let ball = shapes::sphere(5, 1.0);
    let mirrored = shapes::inside_out(shapes::moved(ball.clone(), |p| DVec3::new(2.4 - p.x, p.y, p.z)));
    let two = Surface::of(shapes::both(ball, mirrored));
    let graph = volume_of(&two);
    assert_eq!(graph.components, 2);
    let half = two.points.len() as u32 / 2;
    // The vertices that face each other have numbers half the count apart.
    let right = (0..half)
        .find(|&v| two.points[v as usize] == DVec3::X)
        .expect("a vertex");
    let disc = two.disc(right, 6);
    let mut removed = two.faces_in(|v| disc.contains(&v));
    let rim = two.rims(&removed).remove(0);
    removed.extend(two.faces_in(|v| v >= half && disc.contains(&(v - half))));
    let mut faces = Vec::new();
    for (k, &a) in rim.iter().enumerate() {
        let b = rim[(k + 1) % rim.len()];
        faces.extend([[a, b, b + half], [a, b + half, a + half]]);
    }
    let plan = Plan {
        removed,
        faces,
        ..Plan::default()
    };
    let edited = two.apply(&plan);
    let adjacency = pliant::mesh::Adjacency::build(edited.surface.points.len(), &edited.surface.faces);
    assert!(adjacency.is_balanced(), "the test makes a closed surface");
    let (_, after) = try_edit("bridge", &two, &graph, &plan);
    assert_eq!(after.graph.components, 1);
}

#[test]
fn parts_that_come_have_an_inside_and_parts_that_go_leave_none() {
    let ball = ball();
    let graph = volume_of(&ball);
    let more = Surface::of(shapes::moved(shapes::sphere(4, 0.4), |p| p + DVec3::new(2.0, 0.3, 0.1)));
    for inside_out in [false, true] {
        let first = ball.points.len() as u32;
        let turn = |[a, b, c]: [u32; 3]| if inside_out { [a, c, b] } else { [a, b, c] };
        let plan = Plan {
            points: more.points.clone(),
            faces: more.faces.iter().map(|t| turn(t.map(|v| v + first))).collect(),
            ..Plan::default()
        };
        let edited = ball.apply(&plan);
        let after = followed(&graph, &edited);
        assert_eq!(
            (
                after.graph.components,
                after.graph.stats.component_has_volume.as_slice()
            ),
            (2, &[true, true][..])
        );
        check_places(&edited, &after.graph, 1.25 * graph.stats.shell_offset * (1.0 - 1e-9));
        // And gone again.
        let removed = edited.surface.faces_in(|v| v >= first);
        let back = edited.surface.apply(&Plan::without(removed));
        let there = followed(&after.graph, &back);
        assert_eq!(there.graph.nodes(), graph.nodes());
        assert_eq!(there.graph.positions, graph.positions);
        assert_eq!(there.graph.neighbours, graph.neighbours);
    }
    // A sheet stays one.
    let sheet = Surface::of(shapes::moved(shapes::sheet(12, 12), |p| {
        p * 0.05 + DVec3::new(1.5, 0.0, 0.0)
    }));
    let first = ball.points.len() as u32;
    let plan = Plan {
        points: sheet.points.clone(),
        faces: sheet.faces.iter().map(|t| t.map(|v| v + first)).collect(),
        ..Plan::default()
    };
    let edited = ball.apply(&plan);
    let after = followed(&graph, &edited);
    assert_eq!(after.graph.stats.component_has_volume, [true, false]);
}

#[test]
fn holes_keep_the_inside_and_filling_them_closes_it() {
    let ball = ball();
    let graph = volume_of(&ball);
    let disc = ball.disc(100, 5);
    let removed = ball.faces_in(|v| disc.contains(&v));
    let open = ball.apply(&Plan::without(removed.clone()));
    let after = followed(&graph, &open);
    let tree = WindingTree::build(&open.surface.points, &open.surface.faces, &pool(1));
    let inside = (after.graph.surface..after.graph.nodes())
        .filter(|&i| tree.winding_number(after.graph.positions[i]).abs() > 0.5)
        .count();
    assert!(inside + 60 > after.graph.nodes() - after.graph.surface);
    assert!(after.graph.stats.lattice_nodes + 120 > graph.stats.lattice_nodes);
    // The same faces come back, with new points.
    let rim = open.surface.rims(&open.surface.faces_in(|_| true)).remove(0);
    let middle = open.surface.points.len() as u32;
    let next = rim.iter().cycle().skip(1);
    let plan = Plan {
        points: vec![ball.points[100]],
        faces: rim.iter().zip(next).map(|(&a, &b)| [b, a, middle]).collect(),
        ..Plan::default()
    };
    try_edit("hole filled", &open.surface, &after.graph, &plan);
}

#[test]
fn wide_openings_and_large_edits_are_left_to_a_new_graph() {
    let ball = ball();
    let graph = volume_of(&ball);
    let ask = |plan: Plan| {
        let edited = ball.apply(&plan);
        try_follow(&graph, &edited, 2).is_none()
    };
    let above = |h: f64| ball.faces_in(|v| ball.points[v as usize].z > h);
    assert!(ask(Plan::without(above(0.6))), "a bowl");
    assert!(ask(ball.capped(above(0.2))), "more than a quarter goes");
    assert!(!ask(ball.capped(above(0.6))));
}

#[test]
fn weights_near_the_edit_are_found_again() {
    let ball = ball();
    let options = VolumeOptions {
        weights: EdgeWeights::Cotangent,
        ..shapes::paper_graph()
    };
    let mesh = mesh_of(&ball);
    for graph in [
        volume(&mesh, &options, &Exec::new(&pool(2), &Silent))
            .expect("valid")
            .expect("an inside"),
        surface(&mesh, EdgeWeights::Cotangent),
    ] {
        let edited = ball.apply(&ball.refill(100, 5, DVec3::splat(0.005)));
        let after = followed(&graph, &edited);
        let fresh = surface(&mesh_of(&edited.surface), EdgeWeights::Cotangent);
        let scale = |g: &MeshGraph, from: u32, to: u32| {
            let at = g.row(from).binary_search(&to).expect("an edge");
            g.weights.as_ref().expect("weights")[g.offsets[from as usize] as usize + at]
        };
        for v in 0..fresh.surface as u32 {
            for &w in fresh.row(v) {
                let (ours, theirs) = (scale(&after.graph, v, w), scale(&fresh, v, w));
                assert!((ours / theirs - 1.0).abs() < 0.01, "{v} – {w}: {ours}, new {theirs}");
            }
        }
    }
}

#[test]
fn a_surface_without_inside_is_followed() {
    let sheet = Surface::of(shapes::sheet(40, 40));
    let graph = surface(&mesh_of(&sheet), EdgeWeights::Uniform);
    for plan in [
        sheet.subdivide(800, 4),
        sheet.collapse(800, 4),
        Plan::without(sheet.faces_in(|v| (400..600).contains(&v))),
        Plan::without(sheet.faces_in(|v| (700..782).contains(&v))),
    ] {
        let edited = sheet.apply(&plan);
        let after = followed(&graph, &edited);
        let fresh = surface(&mesh_of(&edited.surface), EdgeWeights::Uniform);
        assert_eq!(
            (&after.graph.neighbours, &after.graph.offsets),
            (&fresh.neighbours, &fresh.offsets)
        );
        assert_eq!(after.graph.component, fresh.component);
    }
}

#[test]
fn a_deformed_lattice_is_filled_up() {
    let ring = Surface::of(shapes::torus(120, 60, 2.0, 0.7));
    let graph = volume_of(&ring);
    let bent = |p: DVec3| DVec3::new(p.x * 1.6, p.y + 0.2 * (p.x * 1.1).sin(), p.z * 0.9 + 0.1 * p.x * p.y);
    let moved = resampling::warped(&graph, bent);
    let surface = Surface {
        points: ring.points.iter().map(|&p| bent(p)).collect(),
        faces: ring.faces.clone(),
    };
    let (seed, edge) = (30, surface.mean_edge());
    let outward = (surface.points[seed as usize] - bent(DVec3::new(2.0, 0.0, 0.0))).normalize_or(DVec3::X);
    for (name, plan) in [
        ("refilled", surface.refill(seed, 6, DVec3::splat(0.1 * edge))),
        ("subdivided", surface.subdivide(seed, 6)),
        ("pulled", surface.pull(seed, 8, outward * 8.0 * edge)),
        ("pushed", surface.pull(seed, 8, -outward * 5.0 * edge)),
        (
            "sliced",
            surface.capped(surface.faces_in(|v| surface.points[v as usize].x > 3.9)),
        ),
    ] {
        let edited = surface.apply(&plan);
        let after = followed(&moved, &edited);
        let places = edited.changed_places(&surface);
        let fresh = built_new(&edited.surface, &graph);
        let within = 3.0 * graph.stats.interval;
        println!(
            "{name}: {:?}, new {:?}, touched {}",
            near(&after.graph, &places, within),
            near(&fresh, &places, within),
            after.touched.len()
        );
        let tree = WindingTree::build(&edited.surface.points, &edited.surface.faces, &pool(1));
        for i in after.graph.surface..after.graph.nodes() {
            let p = after.graph.positions[i];
            assert!(tree.winding_number(p).abs() > 0.9, "{name}: node {i} at {p} is inside");
        }
        // No node hangs by a thread.
        for &n in &after.touched {
            assert!(
                after.graph.row(n).len() >= 3,
                "{name}: node {n} has {:?}",
                after.graph.row(n)
            );
        }
    }
}

#[test]
fn two_hundred_edits_in_sequence_keep_what_a_graph_promises() {
    let mut state = 11u64;
    let mut next = move |n: usize| {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 33) as usize % n
    };
    let mut now = Surface::of(shapes::torus(60, 30, 2.0, 0.7));
    let mut graph = volume_of(&now);
    let mut rebuilt = 0;
    for step in 0..200 {
        let seed = next(now.points.len()) as u32;
        let edge = now.mean_edge();
        let rings = 2 + next(3);
        let plan = match next(5) {
            0 => now.refill(seed, rings, DVec3::new(0.02, -0.03, 0.01) * edge),
            1 if now.points.len() < 4000 => now.subdivide(seed, rings),
            2 => now.collapse(seed, rings),
            3 => {
                let p = now.points[seed as usize];
                let outward = (p - DVec3::new(p.x, p.y, 0.0).normalize_or_zero() * 2.0).normalize_or(DVec3::X);
                now.pull(seed, rings + 2, outward * edge * (next(5) as f64 - 2.0))
            }
            _ => now.pull(seed, rings, DVec3::new(0.1, 0.2, -0.1) * edge),
        };
        let edited = now.apply(&plan);
        // A plan that folds the surface over itself is not a test of the graph.
        if Mesh::build(&edited.surface.points, &edited.surface.faces, Weld::Exact)
            .is_ok_and(|m| m.positions != edited.surface.points || m.triangles != edited.surface.faces)
        {
            continue;
        }
        match try_follow(&graph, &edited, 1) {
            Some(after) => {
                check(&graph, &edited, &after);
                if step % 20 == 0 {
                    let three = try_follow(&graph, &edited, 3);
                    assert!(
                        three.as_ref() == Some(&after),
                        "step {step}: the same bits for any number of threads"
                    );
                }
                graph = after.graph;
            }
            None => {
                rebuilt += 1;
                graph = volume_of(&edited.surface);
            }
        }
        now = edited.surface;
    }
    println!(
        "{} points, {} nodes, rebuilt {rebuilt} times",
        now.points.len(),
        graph.nodes()
    );
    assert!(rebuilt < 20);
    let fresh = built_new(&now, &graph);
    let (ours, theirs) = (graph.stats.lattice_nodes as f64, fresh.stats.lattice_nodes as f64);
    println!(
        "lattice {ours}, new {theirs}; shell {}, new {}",
        graph.stats.shell_nodes, fresh.stats.shell_nodes
    );
    assert!(
        (ours / theirs - 1.0).abs() < 0.15,
        "{ours} lattice nodes, {theirs} in a new graph"
    );
}

#[test]
fn edits_of_a_real_mesh_are_followed() {
    let Some(bytes) = data_bytes("meshes/armadillo.obj") else {
        return;
    };
    let read = Model::read(FileSet::single("armadillo.obj", bytes), None, &Limits::default()).expect("a model");
    let mut model = Surface {
        points: read.positions.clone(),
        faces: read.triangles.clone(),
    };
    let mut graph = volume_of(&model);
    let first = graph.clone();
    let edge = model.mean_edge();
    let below = model.points.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
    for step in 0..6 {
        let seed = 1000 + 5000 * step;
        let plan = match step {
            0 => model.refill(seed, 12, DVec3::splat(0.1 * edge)),
            1 => model.subdivide(seed, 10),
            2 => model.collapse(seed, 6),
            3 => model.pull(seed, 10, DVec3::new(6.0, 2.0, 3.0) * edge),
            4 => model.pull(seed, 10, DVec3::new(-2.0, 1.0, -3.0) * edge),
            // The feet are cut off.
            _ => model.capped(model.faces_in(|v| model.points[v as usize].y < below + 12.0 * edge)),
        };
        let edited = model.apply(&plan);
        let after = followed(&graph, &edited);
        let fresh = built_new(&edited.surface, &first);
        let tree = WindingTree::build(&edited.surface.points, &edited.surface.faces, &pool(2));
        for &n in after.touched.iter().filter(|&&n| n as usize >= after.graph.surface) {
            let p = after.graph.positions[n as usize];
            assert!(tree.winding_number(p).abs() > 0.5, "step {step}: node {n} is inside");
            if n as usize >= after.graph.surface + after.graph.stats.shell_nodes {
                let distance = tree.bvh().closest_point(p).expect("a surface").distance;
                assert!(
                    distance >= 1.25 * graph.stats.shell_offset * (1.0 - 1e-9),
                    "step {step}: node {n} is deep"
                );
            }
        }
        let lattice = (after.graph.stats.lattice_nodes, fresh.stats.lattice_nodes);
        let shell = (after.graph.stats.shell_nodes, fresh.stats.shell_nodes);
        println!(
            "step {step}: {} touched, lattice {lattice:?}, shell {shell:?}",
            after.touched.len()
        );
        // With the same interval the whole lattice has the same density, on a grid that may be shifted.
        assert!(
            (lattice.0 as f64 / lattice.1 as f64 - 1.0).abs() < 0.01,
            "step {step}: {lattice:?}"
        );
        assert!(
            (shell.0 as f64 / shell.1 as f64 - 1.0).abs() < 0.01,
            "step {step}: {shell:?}"
        );
        assert!(
            after.touched.len() < graph.nodes() / 8,
            "step {step}: {} touched",
            after.touched.len()
        );
        (model, graph) = (edited.surface, after.graph);
    }
}
