//! Laws of graphs: symmetry, connectivity, where nodes may lie, and the same bits for any thread count.

use crate::support::data::data_bytes;
use glam::{DQuat, DVec3};
use pliant::asset::{FileSet, Limits, Model};
use pliant::exec::Exec;
use pliant::graph::{EdgeWeights, InteriorKind, MeshGraph, VolumeOptions, WindingTree, surface, volume};
use pliant::mesh::{Adjacency, Error, Mesh, Weld, mean_edge_length};
use pliant::pool::Pool;
use pliant::progress::{CancelFlag, Silent};
use proptest::prelude::*;
use shapes::Shape;

use crate::support::shapes;

fn pool(threads: usize) -> Pool {
    Pool::new(threads).expect("threads start")
}

fn volume_with(shape: &Shape, options: &VolumeOptions, threads: usize) -> Option<MeshGraph> {
    volume(&shapes::mesh(shape), options, &Exec::new(&pool(threads), &Silent)).expect("valid options")
}

fn volume_of(shape: &Shape, kind: InteriorKind) -> Option<MeshGraph> {
    volume_with(shape, &of_kind(kind), 2)
}

/// The graph of a shape with an inside, after all that it promises was checked.
fn sound(shape: &Shape, kind: InteriorKind) -> MeshGraph {
    let graph = volume_of(shape, kind).expect("an inside");
    shapes::check_graph(&graph, &shapes::mesh(shape));
    graph
}

/// Checks that a graph encloses so much, as a share of a ball of radius 1.
fn encloses(graph: &MeshGraph, share: std::ops::Range<f64>) {
    let ball = 4.0 / 3.0 * std::f64::consts::PI;
    assert!(
        share.contains(&(graph.stats.enclosed_volume / ball)),
        "{:?}",
        graph.stats
    );
}

const KINDS: [InteriorKind; 2] = [InteriorKind::Shape, InteriorKind::Paper];
use InteriorKind::Paper;

fn of_kind(kind: InteriorKind) -> VolumeOptions {
    VolumeOptions {
        kind,
        ..VolumeOptions::default()
    }
}

#[test]
fn closed_shapes_get_connected_graphs_of_the_expected_size() {
    let cases = [
        ("cube", shapes::cube(6), 8.0),
        ("torus", shapes::torus(120, 60, 2.0, 0.7), 19.3),
        ("sphere", shapes::sphere(5, 1.0), 4.18),
    ];
    for (name, shape, expected) in cases {
        let mesh = shapes::mesh(&shape);
        for kind in KINDS {
            let graph = volume_of(&shape, kind).expect("an inside");
            shapes::check_graph(&graph, &mesh);
            let volumes = graph.stats.component_has_volume.as_slice();
            assert_eq!((graph.components, volumes), (1, &[true][..]), "{name}");
            assert!(
                (graph.stats.enclosed_volume / expected - 1.0).abs() < 0.02,
                "{name}: {:?}",
                graph.stats
            );
            let ratio = graph.nodes() as f64 / graph.surface as f64;
            let degree = graph.neighbours.len() as f64 / graph.nodes() as f64;
            let (shell, ratios, degrees) = match kind {
                InteriorKind::Paper => (graph.surface, 2.6..3.2, 10.5..12.5),
                InteriorKind::Shape => (0, 1.05..4.0, 6.0..15.0),
            };
            assert!(ratios.contains(&ratio), "{name}: {ratio} nodes per vertex");
            assert!(degrees.contains(&degree), "{name}: {degree} neighbours per node");
            assert_eq!(graph.stats.shell_nodes, shell, "{name}: there is room for each copy");
        }
    }
}

#[test]
fn a_lattice_follows_the_shape_and_not_its_triangles() {
    // A ball of ten thousand vertices, and one of forty thousand.
    let (coarse, fine) = (shapes::sphere(5, 1.0), shapes::sphere(6, 1.0));
    let [coarse, fine] = [coarse, fine].map(|shape| volume_of(&shape, InteriorKind::Shape).expect("an inside"));
    assert!((coarse.stats.interval / fine.stats.interval - 1.0).abs() < 0.01);
    assert!(coarse.stats.lattice_nodes.abs_diff(fine.stats.lattice_nodes) * 50 < fine.stats.lattice_nodes);
    assert!(
        fine.nodes() * 10 < fine.surface * 14,
        "{} nodes of {}",
        fine.nodes(),
        fine.surface
    );
}

#[test]
fn a_thin_part_has_a_finer_lattice_and_leaves_that_of_a_thick_one_alone() {
    let body = shapes::cube(5);
    let rod = shapes::moved(shapes::cube(6), |p| p * DVec3::new(0.1, 0.1, 1.5) + DVec3::X * 3.0);
    let alone = volume_of(&body, InteriorKind::Shape).expect("an inside");
    let both = volume_of(&shapes::both(body, rod), InteriorKind::Shape).expect("an inside");
    let inside = |g: &MeshGraph, beyond: bool| {
        let lattice = &g.positions[g.surface..];
        lattice.iter().filter(|p| (p.x > 2.0) == beyond).count()
    };
    assert_eq!(inside(&both, false), alone.stats.lattice_nodes);
    assert!(inside(&both, true) > 100, "{:?}", both.stats);
}

#[test]
fn what_is_too_thin_for_a_lattice_has_struts_across() {
    let plate = shapes::moved(shapes::cube(6), |p| p * DVec3::new(1.0, 1.0, 0.01));
    let graph = sound(&plate, InteriorKind::Shape);
    assert_eq!(graph.stats.lattice_nodes, 0);
    assert_eq!(graph.stats.component_has_volume, [true]);
    let is_across = |i: u32| {
        let here = graph.positions[i as usize];
        let over = |&&j: &&u32| graph.positions[j as usize].z * here.z < 0.0;
        here.truncate().abs().max_element() > 0.99 || graph.row(i).iter().any(|j| over(&j))
    };
    assert!((0..graph.surface as u32).all(is_across), "{:?}", graph.stats);
}

/// Every query sees every face where all are as long as the shape, so that finding an inside costs the square of their number.
#[test]
fn work_on_faces_as_long_as_the_shape_has_a_bound_and_can_be_given_up() {
    let mut long = shapes::mesh(&shapes::torus(200, 100, 2.0, 0.4));
    let mut state = 0u64;
    for last in (1..long.positions.len()).rev() {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        long.positions.swap(last, (state >> 33) as usize % (last + 1));
    }
    let options = VolumeOptions::default();
    let refusal = volume(&long, &options, &Exec::new(&pool(2), &Silent)).err();
    assert!(matches!(refusal, Some(Error::FacesTooLong { .. })), "{refusal:?}");
    let cancelled = CancelFlag::default();
    cancelled.cancel();
    let given_up = volume(&long, &options, &Exec::new(&pool(1), &cancelled));
    assert!(matches!(given_up, Err(Error::Cancelled)));
}

#[test]
fn inner_nodes_lie_inside_and_away_from_the_surface() {
    for shape in [
        shapes::torus(60, 24, 2.0, 0.4),
        shapes::inside_out(shapes::sphere(4, 2.0)),
        shapes::cube(4),
    ] {
        let mesh = shapes::mesh(&shape);
        let tree = WindingTree::build(&mesh.positions, &mesh.triangles, &pool(1));
        for kind in KINDS {
            let graph = volume_of(&shape, kind).expect("an inside");
            let offset = graph.stats.shell_offset;
            for (i, &p) in graph.positions.iter().enumerate().skip(graph.surface) {
                let depth = tree.bvh().closest_point(p).expect("a surface").distance;
                assert!(shapes::winding_by_sum(&shape, p).abs() > 0.99, "node {i} is inside");
                if i < graph.surface + graph.stats.shell_nodes {
                    let way = p.distance(mesh.positions[graph.nearest_surface[i] as usize]);
                    assert!(
                        way <= offset * 1.000_001 && depth >= way * 0.499_999,
                        "node {i}: {depth} deep, {way} away"
                    );
                } else {
                    let least = match kind {
                        InteriorKind::Paper => 1.25 * offset,
                        InteriorKind::Shape => 0.6 * graph.stats.interval,
                    };
                    assert!(depth >= least, "lattice node {i} is {depth} deep");
                    let way = mesh.positions[graph.nearest_surface[i] as usize].distance(p);
                    let least = mesh
                        .positions
                        .iter()
                        .map(|v| v.distance(p))
                        .fold(f64::INFINITY, f64::min);
                    assert!(
                        way <= least * 1.05,
                        "lattice node {i}: {way} to its vertex, {least} to the nearest"
                    );
                }
            }
        }
    }
}

#[test]
fn a_hollow_ball_has_no_nodes_in_its_hollow() {
    for kind in KINDS {
        let wall = shapes::both(shapes::sphere(5, 1.0), shapes::inside_out(shapes::sphere(4, 0.5)));
        let graph = sound(&wall, kind);
        assert_eq!(graph.components, 1, "the wall joins its two surfaces");
        assert!(
            graph.positions.iter().all(|p| p.length() > 0.48),
            "no node in the hollow"
        );
        let solid = 4.0 / 3.0 * std::f64::consts::PI * (1.0 - 0.125);
        assert!(
            (graph.stats.enclosed_volume / solid - 1.0).abs() < 0.02,
            "{:?}",
            graph.stats
        );
        // Wound the same way, the inner surface bounds nothing: the ball is solid and shares one lattice.
        let ball = shapes::both(shapes::sphere(5, 1.0), shapes::sphere(4, 0.5));
        let graph = sound(&ball, kind);
        assert_eq!(graph.components, 1);
        assert!(graph.positions.iter().any(|p| p.length() < 0.2), "nodes in the middle");
    }
}

#[test]
fn separate_parts_stay_separate_however_close() {
    for kind in KINDS {
        // Two bars side by side, closer to each other than a lattice cell is wide.
        let bar = shapes::moved(shapes::cube(5), |p| p * DVec3::new(1.0, 1.0, 4.0));
        let gap = shapes::both(bar.clone(), shapes::moved(bar, |p| p + DVec3::X * 2.01));
        let graph = sound(&gap, kind);
        assert!(
            graph.stats.lattice_nodes > 100 && graph.stats.interval > 0.05,
            "{:?}",
            graph.stats
        );
        assert_eq!((graph.components, graph.stats.component_has_volume.len()), (2, 2));
        for i in 0..graph.nodes() as u32 {
            let side = graph.positions[i as usize].x < 1.005;
            let is_here = |&j: &u32| (graph.positions[j as usize].x < 1.005) == side;
            assert!(graph.row(i).iter().all(is_here));
        }
    }
}

#[test]
fn a_sheet_beside_a_ball_keeps_surface_edges_only() {
    for kind in KINDS {
        let (ball, sheet) = (
            shapes::sphere(4, 1.0),
            shapes::moved(shapes::sheet(20, 20), |p| p * 0.2 - DVec3::Z * 3.0),
        );
        let scene = shapes::both(ball, sheet);
        let graph = sound(&scene, kind);
        assert_eq!(graph.stats.component_has_volume, [true, false]);
    }
}

#[test]
fn sheets_enclose_nothing() {
    for kind in KINDS {
        let bent = shapes::moved(shapes::sheet(30, 30), |p| {
            DVec3::new(p.x, p.y, (0.2 * p.x).sin() + 0.02 * p.y * p.y)
        });
        for sheet in [shapes::sheet(12, 5), bent] {
            assert!(volume_of(&sheet, kind).is_none());
            let mesh = shapes::mesh(&sheet);
            let graph = surface(&mesh, EdgeWeights::Uniform);
            shapes::check_graph(&graph, &mesh);
            assert_eq!(
                (
                    graph.nodes(),
                    graph.components,
                    graph.stats.component_has_volume.as_slice()
                ),
                (mesh.positions.len(), 1, &[false][..])
            );
        }
    }
}

#[test]
fn a_model_with_holes_still_has_an_inside() {
    let (p, f) = shapes::sphere(5, 1.0);
    let holed: Vec<[u32; 3]> = f.into_iter().filter(|t| p[t[0] as usize].z < 0.9).collect();
    let shape = (p, holed);
    let graph = sound(&shape, Paper);
    encloses(&graph, 0.85..1.05);
    assert!(graph.stats.lattice_nodes > graph.surface / 2);
}

#[test]
fn thin_walls_get_thinner_shells_and_no_lattice() {
    let plate = shapes::moved(shapes::cube(6), |p| p * DVec3::new(1.0, 1.0, 0.05));
    let mesh = shapes::mesh(&plate);
    let graph = volume_of(&plate, Paper).expect("an inside");
    shapes::check_graph(&graph, &mesh);
    assert_eq!(graph.stats.lattice_nodes, 0);
    assert!(graph.stats.shell_nodes > graph.surface / 2, "{:?}", graph.stats);
    assert!(graph.positions.iter().all(|p| p.z.abs() <= 0.05));
}

#[test]
fn parts_too_thin_for_a_shell_are_surfaces_and_others_keep_their_inside() {
    let foil = shapes::moved(shapes::cube(6), |p| p * DVec3::new(1.0, 1.0, 0.002));
    assert!(volume_of(&foil, Paper).is_none(), "a foil alone is a surface");
    let beside = shapes::moved(foil, |p| p + DVec3::Z * 3.0);
    let scene = shapes::both(shapes::sphere(5, 1.0), beside);
    let graph = sound(&scene, Paper);
    assert_eq!(graph.stats.component_has_volume, [true, false]);
    let alone = volume_of(&shapes::sphere(5, 1.0), Paper).expect("an inside");
    assert!(
        graph.stats.lattice_nodes > alone.stats.lattice_nodes / 2,
        "{:?}",
        graph.stats
    );
}

#[test]
fn parts_that_overlap_share_one_lattice_and_nested_ones_too() {
    for kind in KINDS {
        let ball = shapes::sphere(5, 1.0);
        let overlapping = shapes::both(ball.clone(), shapes::moved(ball.clone(), |p| p * 0.9 + DVec3::X * 1.2));
        let nested = shapes::both(ball.clone(), shapes::moved(ball.clone(), |p| p * 0.6));
        let touching = shapes::both(shapes::cube(5), shapes::moved(shapes::cube(5), |p| p + DVec3::X * 1.9));
        // A bowl with its rim cut off beside the ball that it overlaps: one closed, one open.
        let bowl = {
            let (p, f) = shapes::moved(ball.clone(), |p| p + DVec3::X * 1.1);
            let faces = f.into_iter().filter(|t| p[t[0] as usize].x < 1.9).collect();
            (p, faces)
        };
        let open = shapes::both(ball, bowl);
        for (name, scene) in [
            ("overlapping", overlapping),
            ("nested", nested),
            ("touching", touching),
            ("open", open),
        ] {
            let graph = sound(&scene, kind);
            assert_eq!(graph.components, 1, "{name}: {:?}", graph.stats);
        }
    }
}

#[test]
fn soups_have_an_inside() {
    for kind in KINDS {
        // Every face on its own, a little smaller, so that no two share a vertex.
        let (p, f) = shapes::sphere(4, 1.0);
        let mut soup: Shape = Default::default();
        for t in f {
            let middle = t.iter().map(|&v| p[v as usize]).sum::<DVec3>() / 3.0;
            let first = soup.0.len() as u32;
            soup.0.extend(t.map(|v| middle + (p[v as usize] - middle) * 0.97));
            soup.1.push([first, first + 1, first + 2]);
        }
        let graph = sound(&soup, kind);
        let least = [200, 500][usize::from(kind == Paper)];
        assert!(graph.stats.lattice_nodes > least, "{:?}", graph.stats);
        encloses(&graph, 0.8..1.1);
        assert!(
            graph.components < soup.1.len() / 2,
            "the lattice joins faces: {} of {}",
            graph.components,
            soup.1.len()
        );
    }
}

#[test]
fn a_surface_parted_by_cracks_still_has_an_inside() {
    for kind in KINDS {
        // A ball in eight patches that do not meet.
        let (p, f) = shapes::sphere(5, 1.0);
        let mut cracked: Shape = Default::default();
        for octant in 0..8u32 {
            let sign = |k: u32| if octant >> k & 1 == 1 { 1.0 } else { -1.0 };
            let toward = DVec3::new(sign(0), sign(1), sign(2));
            let middle = |t: &[u32; 3]| t.iter().map(|&v| p[v as usize]).sum::<DVec3>();
            let own = f.iter().copied().filter(|t| (middle(t) * toward).min_element() > 0.0);
            cracked = shapes::both(cracked, (p.iter().map(|&p| p + toward * 1e-3).collect(), own.collect()));
        }
        let graph = sound(&cracked, kind);
        assert_eq!(graph.components, 1, "one lattice holds the patches together");
        encloses(&graph, 0.9..1.1);
    }
}

#[test]
fn the_same_bits_for_one_two_and_three_threads() {
    let scene = shapes::both(
        shapes::torus(80, 40, 2.0, 0.7),
        shapes::moved(shapes::sheet(25, 25), |p| p * 0.1 + DVec3::new(0.3, 0.1, 0.2)),
    );
    for shape in [shapes::sphere(5, 1.0), scene] {
        for weights in [EdgeWeights::Uniform, EdgeWeights::Cotangent] {
            for kind in KINDS {
                let options = VolumeOptions {
                    weights,
                    ..of_kind(kind)
                };
                let bits = |g: &MeshGraph| -> Vec<u64> {
                    g.positions
                        .iter()
                        .flat_map(|p| p.to_array())
                        .map(f64::to_bits)
                        .collect()
                };
                let one = volume_with(&shape, &options, 1).expect("an inside");
                for threads in [2, 3] {
                    let other = volume_with(&shape, &options, threads).expect("an inside");
                    assert_eq!(bits(&one), bits(&other));
                    assert!(one == other, "graphs differ between 1 and {threads} threads");
                }
            }
        }
    }
}

#[test]
fn turning_and_shifting_a_model_hardly_changes_the_counts() {
    let shape = shapes::torus(120, 60, 2.0, 0.6);
    for kind in KINDS {
        let rest = volume_of(&shape, kind).expect("an inside");
        let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, 1.1, -0.7);
        let moves: [&dyn Fn(DVec3) -> DVec3; 3] = [&|p| p + DVec3::new(1e4, -250.0, 33.3), &|p| turn * p, &|p| {
            (turn * p) * 1e-7 + DVec3::splat(5e-4)
        }];
        for to in moves {
            let graph = volume_of(&shapes::moved(shape.clone(), to), kind).expect("an inside");
            let close = |a: usize, b: usize| (a as f64 / b as f64 - 1.0).abs() < 0.02;
            for (what, now, then) in [
                ("nodes", graph.nodes(), rest.nodes()),
                ("edges", graph.edges(), rest.edges()),
            ] {
                assert!(close(now, then), "{now} {what}, {then} at rest");
            }
        }
    }
}

#[test]
fn options_do_what_they_say() {
    let shape = shapes::sphere(5, 1.0);
    let mesh = shapes::mesh(&shape);
    let base = of_kind(Paper);
    let rest = volume_with(&shape, &base, 2).expect("an inside");
    let with = |options: VolumeOptions| volume_with(&shape, &options, 2).expect("an inside");
    let coarse = with(VolumeOptions {
        interval: Some(0.3),
        ..base
    });
    assert_eq!(coarse.stats.interval, 0.3);
    assert!(coarse.stats.lattice_nodes < rest.stats.lattice_nodes);
    let eight = with(VolumeOptions { valence: 8, ..base });
    shapes::check_graph(&eight, &mesh);
    assert_eq!(eight.nodes(), rest.nodes());
    let most = |g: &MeshGraph| {
        let first = g.surface + g.stats.shell_nodes;
        (first..g.nodes())
            .map(|i| g.row(i as u32).iter().filter(|&&j| j as usize >= first).count())
            .max()
    };
    assert_eq!((most(&rest), most(&eight)), (Some(14), Some(8)));
    let shallow = with(VolumeOptions {
        shell_offset: Some(0.01),
        ..base
    });
    for i in shallow.surface..shallow.surface + shallow.stats.shell_nodes {
        let way = shallow.positions[i].distance(shallow.positions[shallow.nearest_surface[i] as usize]);
        assert!((way - 0.01).abs() < 1e-9);
    }
    let cotangent = VolumeOptions {
        weights: EdgeWeights::Cotangent,
        ..base
    };
    shapes::check_graph(&with(cotangent), &mesh);
}

#[test]
fn the_node_limit_widens_the_lattice_before_anything_large_is_made() {
    let shape = shapes::sphere(4, 1.0);
    let mesh = shapes::mesh(&shape);
    let (surface, shell) = (mesh.positions.len(), mesh.positions.len());
    for (interval, max_nodes) in [
        (Some(1e-9), 2 * surface + 500),
        (Some(1e-300), 100_000),
        (None, 2 * surface + 50),
    ] {
        let options = VolumeOptions {
            interval,
            max_nodes,
            ..of_kind(Paper)
        };
        let graph = volume_with(&shape, &options, 2).expect("an inside");
        shapes::check_graph(&graph, &mesh);
        assert!(
            graph.nodes() <= max_nodes && graph.stats.lattice_nodes > 0,
            "{:?}",
            graph.stats
        );
        assert!(
            graph.nodes() > surface + shell + (max_nodes - surface - shell) / 4,
            "{:?} of {max_nodes}",
            graph.stats
        );
    }
    for (interval, limit) in [
        (Some(1e-9), surface + 500),
        (Some(1e-300), 100_000),
        (None, surface + 50),
    ] {
        let options = VolumeOptions {
            interval,
            max_nodes: limit,
            ..VolumeOptions::default()
        };
        let graph = volume_with(&shape, &options, 2).expect("an inside");
        shapes::check_graph(&graph, &mesh);
        assert!(
            graph.nodes() <= limit && graph.stats.lattice_nodes > (limit - surface) / 4,
            "{:?}",
            graph.stats
        );
        assert!(graph.stats.interval > graph.stats.wanted_interval);
    }
    let tight = VolumeOptions {
        max_nodes: surface + 10,
        ..of_kind(Paper)
    };
    let refused = volume(&mesh, &tight, &Exec::new(&pool(1), &Silent)).expect_err("no room for the shell");
    assert_eq!(
        refused,
        Error::TooManyNodes {
            nodes: surface + shell,
            limit: surface + 10,
            surface
        }
    );
}

#[test]
fn senseless_options_are_refused_with_the_value_seen() {
    let mesh = shapes::mesh(&shapes::cube(2));
    let base = VolumeOptions::default();
    let spaced = |interval| VolumeOptions {
        interval: Some(interval),
        ..base
    };
    let offset = VolumeOptions {
        shell_offset: Some(-1.0),
        ..base
    };
    for (options, reason) in [
        (spaced(0.0), "interval: is 0"),
        (spaced(f64::NAN), "interval: is NaN"),
        (offset, "shell offset: is -1"),
        (VolumeOptions { valence: 6, ..base }, "allowed are 14 and 8"),
    ] {
        let refused = volume(&mesh, &options, &Exec::new(&pool(1), &Silent))
            .expect_err(reason)
            .to_string();
        assert!(refused.contains(reason), "{refused}");
        assert!(refused.starts_with(reason) || options.valence == 6, "{refused}");
    }
}

#[test]
fn cancelled_work_stops() {
    let flag = CancelFlag::default();
    flag.cancel();
    let mesh = shapes::mesh(&shapes::cube(3));
    let stopped = volume(&mesh, &VolumeOptions::default(), &Exec::new(&pool(1), &flag));
    assert_eq!(stopped, Err(Error::Cancelled));
}

#[test]
fn extreme_sizes_and_flat_boxes_are_no_trouble() {
    let shapes = [
        shapes::moved(shapes::sphere(3, 1.0), |p| p * 1e30),
        shapes::moved(shapes::sphere(3, 1.0), |p| p * 1e-30),
        shapes::moved(shapes::sphere(3, 1.0), |p| p * 1e37),
        shapes::moved(shapes::sphere(3, 1.0), |p| p * 1e-300),
        shapes::moved(shapes::sphere(3, 1.0), |p| p * DVec3::new(1e30, 1.0, 1e-30)),
        shapes::moved(shapes::sphere(3, 1.0), |p| p * 1e-9 + DVec3::splat(1e9)),
        shapes::moved(shapes::cube(3), |p| p * DVec3::new(1.0, 1.0, 0.0)),
        shapes::moved(shapes::cube(3), |p| p * DVec3::new(1.0, 0.0, 0.0)),
        shapes::both(
            shapes::sphere(2, 1e-6),
            shapes::moved(shapes::sphere(2, 1e-6), |p| p + DVec3::X * 1e6),
        ),
    ];
    for (i, shape) in shapes.iter().enumerate() {
        let Ok(mesh) = Mesh::build(&shape.0, &shape.1, Weld::Exact) else {
            continue;
        };
        shapes::check_graph(&surface(&mesh, EdgeWeights::Cotangent), &mesh);
        let built = volume(&mesh, &VolumeOptions::default(), &Exec::new(&pool(2), &Silent)).expect("valid options");
        if let Some(graph) = &built {
            shapes::check_graph(graph, &mesh);
            assert!(graph.nodes() < 10 * graph.surface, "shape {i}: {:?}", graph.stats);
        }
        // Size alone takes nothing away.
        assert!(
            i > 2 || built.is_some_and(|g| g.stats.lattice_nodes > g.surface / 4),
            "shape {i}"
        );
    }
    let one_point = Mesh::build(&[DVec3::ONE; 3], &[[0, 1, 2]], Weld::Exact);
    assert!(one_point.is_err());
}

#[test]
fn real_meshes_get_the_node_counts_of_the_paper() {
    let Some(bytes) = data_bytes("meshes/armadillo.obj") else {
        return;
    };
    let read = Model::read(FileSet::single("armadillo.obj", bytes), None, &Limits::default()).expect("a model");
    let shape: Shape = (read.positions.clone(), read.triangles.clone());
    let mesh = shapes::mesh(&shape);
    let graph = sound(&shape, Paper);
    assert_eq!((graph.surface, graph.components), (43_243, 1));
    assert!((125_000..132_000).contains(&graph.nodes()), "{} nodes", graph.nodes());
    let degree = graph.neighbours.len() as f64 / graph.nodes() as f64;
    assert!((11.4..11.9).contains(&degree), "{degree} neighbours per node");
    let report = shapes::report(&shape.0, &shape.1);
    assert!(report.closed && report.warnings.is_empty() && (graph.stats.enclosed_volume - report.volume).abs() < 1e-12);
    let edges = Adjacency::build(mesh.positions.len(), &mesh.triangles).edges;
    assert_eq!(graph.stats.shell_offset, mean_edge_length(&mesh.positions, &edges));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn any_soup_gives_a_sound_graph(
        points in prop::collection::vec(prop::array::uniform3(-4i32..5), 3..30),
        faces in prop::collection::vec(prop::array::uniform3(0u32..30), 1..50),
        scale in prop_oneof![Just(1.0), Just(1e30), Just(1e-30), Just(0.1)],
        valence in prop_oneof![Just(8u32), Just(14u32)],
        interval in prop_oneof![Just(None), Just(Some(0.3)), Just(Some(1e-20)), Just(Some(1e20))],
        max_nodes in prop_oneof![Just(200usize), Just(5000usize)],
        kind in prop_oneof![Just(InteriorKind::Shape), Just(InteriorKind::Paper)],
    ) {
        let points: Vec<DVec3> =
            points.into_iter().map(|p| DVec3::from_array(p.map(|c| f64::from(c) * scale))).collect();
        let n = points.len() as u32;
        let faces: Vec<[u32; 3]> = faces.into_iter().map(|f| f.map(|v| v % n)).collect();
        if let Ok(mesh) = Mesh::build(&points, &faces, Weld::Exact) {
            shapes::check_graph(&surface(&mesh, EdgeWeights::Cotangent), &mesh);
            let options = VolumeOptions { valence, interval, max_nodes, weights: EdgeWeights::Cotangent, ..of_kind(kind) };
            if let Ok(Some(graph)) = volume(&mesh, &options, &Exec::new(&pool(1), &Silent)) {
                shapes::check_graph(&graph, &mesh);
                prop_assert!(graph.nodes() <= max_nodes);
            }
        }
    }
}
