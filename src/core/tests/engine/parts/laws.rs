//! What holds of every graph with ties, whatever is tied.

use super::shapes::{axe, block, moved, slices, strapped_ball, together, unwelded};
use glam::{DQuat, DVec3};
use pliant_core::asset::shapes::Shape;
use pliant_core::exec::Exec;
use pliant_core::graph::{
    LOOSE, MeshGraph, TieAnchor, TieFamilies, TieOptions, VolumeOptions, surface, tie_parts, volume,
};
use pliant_core::mesh::query::closest_point::closest_weights_on_triangle;
use pliant_core::mesh::{Components, Error, Mesh};
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;
use proptest::prelude::*;
use std::sync::Arc;

fn untied(mesh: &Mesh, threads: usize) -> MeshGraph {
    let pool = Pool::new(threads).expect("threads");
    let options = VolumeOptions::default();
    let inside = volume(mesh, &options, &Exec::new(&pool, &Silent)).expect("options that make sense");
    inside.unwrap_or_else(|| surface(mesh, options.weights))
}

fn tied_with(mesh: &Mesh, options: &TieOptions, threads: usize) -> MeshGraph {
    let pool = Pool::new(threads).expect("threads");
    tie_parts(untied(mesh, threads), mesh, options, &Exec::new(&pool, &Silent)).expect("ties")
}

fn tied(mesh: &Mesh) -> MeshGraph {
    tied_with(mesh, &TieOptions::default(), 2)
}

fn anchors(graph: &MeshGraph) -> &[TieAnchor] {
    graph.ties.as_ref().map_or(&[], |ties| ties.anchors())
}

/// What solving relies on, and that ties change nothing but rows of the surface and components.
fn check(graph: &MeshGraph, before: &MeshGraph, what: &str) {
    let weights = graph.weights.as_ref().expect("a graph with ties has weights");
    assert_eq!(weights.len(), graph.neighbours.len(), "{what}");
    let weight = |i: u32, k: usize| weights[graph.offsets[i as usize] as usize + k];
    for i in 0..graph.nodes() as u32 {
        let row = graph.row(i);
        assert!(row.windows(2).all(|w| w[0] < w[1]), "{what}: row {i} rises");
        for (k, &j) in row.iter().enumerate() {
            let back = graph.row(j).binary_search(&i).expect("both directions");
            assert_eq!(weight(i, k), weight(j, back), "{what}: {i} – {j}");
            assert!(weight(i, k) > 0.0 && weight(i, k).is_finite(), "{what}: {i} – {j}");
            assert_eq!(graph.component[i as usize], graph.component[j as usize], "{what}");
        }
        assert!(
            before.row(i).iter().all(|j| row.binary_search(j).is_ok()),
            "{what}: row {i} keeps its edges"
        );
        if i as usize >= graph.surface {
            assert_eq!(row, before.row(i), "{what}: nodes inside are not tied");
        }
    }
    assert_eq!(
        (&graph.positions, &graph.nearest_surface),
        (&before.positions, &before.nearest_surface)
    );
    let ties = graph.ties.as_ref().expect("ties");
    assert_eq!(graph.edges(), before.edges() + ties.edge_count(), "{what}");
    assert_eq!(ties.untied_component(), before.component, "{what}");
    assert_eq!(
        graph.component.iter().max().map(|c| *c as usize + 1),
        Some(graph.components),
        "{what}"
    );
}

fn scenes() -> [(&'static str, Shape); 3] {
    [
        ("axe", axe()),
        ("slices", slices(4, 1e-4)),
        ("strapped ball", strapped_ball()),
    ]
}

#[test]
fn graphs_with_ties_are_symmetric_and_whole() {
    for (name, shape) in scenes() {
        let mesh = unwelded(&shape);
        let graph = tied(&mesh);
        check(&graph, &untied(&mesh, 2), name);
        assert_eq!(graph.components, 1, "{name} hangs together");
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    for (name, shape) in scenes() {
        let mesh = unwelded(&shape);
        let one = tied_with(&mesh, &TieOptions::default(), 1);
        assert!(one == tied_with(&mesh, &TieOptions::default(), 4), "{name}");
    }
}

#[test]
fn a_part_alone_keeps_its_graph_to_the_bit() {
    let far = |k: f64| block([k * 10.0, 0.0, 0.0], [1.0; 3], [5; 3]);
    for (name, shape) in [
        ("one part", far(0.0)),
        ("parts out of reach", together([far(0.0), far(1.0)])),
    ] {
        let mesh = unwelded(&shape);
        assert!(tied(&mesh) == untied(&mesh, 2), "{name}");
    }
}

#[test]
fn ties_lead_to_the_nearest_places_of_the_three_nearest_parts() {
    let mut state = 7u64;
    let mut next = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    // So few triangles that all of them may be compared for each vertex.
    let mut crowd = vec![
        block([0.5; 3], [0.4; 3], [2; 3]),
        block([0.7; 3], [0.4; 3], [2; 3]),
        block([0.5, 0.5, 0.8], [0.2; 3], [2; 3]),
    ];
    crowd.extend((0..100).map(|_| {
        let middle = DVec3::new(next(), next(), next());
        let corners = (0..3).map(|_| middle + 0.3 * DVec3::new(next(), next(), next()));
        (corners.collect(), vec![[0, 1, 2]])
    }));
    let mesh = unwelded(&together(crowd));
    assert!(mesh.triangles.len() < 256);
    let parts = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
    let part = |v: u32| parts.of_vertex[v as usize];
    let square = |v: u32, t: &[u32; 3]| {
        let corners = t.map(|c| mesh.positions[c as usize]);
        closest_weights_on_triangle(mesh.positions[v as usize], corners).1
    };
    let (reach, mut most) = (0.1, 0);
    let options = TieOptions {
        distance: Some(reach),
        ..TieOptions::default()
    };
    let graph = tied_with(&mesh, &options, 2);
    for v in 0..mesh.positions.len() as u32 {
        let mut nearest = vec![f64::INFINITY; parts.count];
        for t in mesh.triangles.iter().filter(|t| part(t[0]) != part(v)) {
            let own = &mut nearest[part(t[0]) as usize];
            *own = own.min(square(v, t));
        }
        nearest.retain(|&square| square <= reach * reach);
        nearest.sort_by(f64::total_cmp);
        nearest.truncate(3);
        let own: Vec<&TieAnchor> = anchors(&graph).iter().filter(|a| a.vertex == v).collect();
        let mut found: Vec<f64> = own.iter().map(|a| square(v, &a.corners)).collect();
        found.sort_by(f64::total_cmp);
        let same = |(a, b): (&f64, &f64)| (a.sqrt() - b.sqrt()).abs() < 1e-12;
        assert!(
            found.len() == nearest.len() && found.iter().zip(&nearest).all(same),
            "vertex {v}: {found:?} for {nearest:?}"
        );
        most = most.max(found.len());
    }
    assert!(most == 3 && anchors(&graph).is_sorted_by_key(|a| a.vertex));
}

#[test]
fn only_parts_of_different_families_are_tied() {
    let mesh = unwelded(&slices(3, 1e-4));
    let third = mesh.positions.len() / 3;
    let family = |of: [u32; 3]| {
        let of_vertex = (0..mesh.positions.len()).map(|v| of[v / third]).collect();
        let families = TieFamilies::Of(Arc::new(of_vertex));
        let options = TieOptions {
            families,
            ..TieOptions::default()
        };
        let graph = tied_with(&mesh, &options, 2);
        let joined = |a: usize, b: usize| graph.component[a * third] == graph.component[b * third];
        let mut pairs: Vec<[usize; 2]> = anchors(&graph)
            .iter()
            .map(|a| [a.vertex as usize / third, a.corners[0] as usize / third])
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        (pairs, joined(0, 1), joined(1, 2))
    };
    assert_eq!(family([0, 0, 1]).0, [[1, 2], [2, 1]], "the first two were one part");
    assert_eq!(
        family([0, LOOSE, 1]).0,
        Vec::<[usize; 2]>::new(),
        "the one between is kept apart"
    );
    let (pairs, first, second) = family([5, 3, 9]);
    assert_eq!(pairs, [[0, 1], [1, 0], [1, 2], [2, 1]]);
    assert!(first && second);
    let one = TieOptions {
        families: TieFamilies::One,
        ..TieOptions::default()
    };
    assert!(tied_with(&mesh, &one, 2) == untied(&mesh, 2));
}

#[test]
fn a_distance_that_is_asked_for_is_kept_to() {
    let mesh = unwelded(&slices(2, 0.05));
    let reach = |distance| TieOptions {
        distance: Some(distance),
        ..TieOptions::default()
    };
    assert_eq!(tied_with(&mesh, &reach(0.049), 2).components, 2);
    assert_eq!(tied_with(&mesh, &reach(0.051), 2).components, 1);
    let pool = Pool::new(1).expect("a thread");
    for seen in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let graph = untied(&mesh, 1);
        let reported = tie_parts(graph, &mesh, &reach(seen), &Exec::new(&pool, &Silent)).expect_err("refused");
        assert!(
            matches!(&reported, Error::Invalid { field, .. } if field == "tie distance"),
            "{reported}"
        );
    }
}

#[test]
fn nearer_is_firmer_and_touching_is_as_firm_as_all_edges_together() {
    let weight = |gap: f64| {
        let graph = tied(&unwelded(&slices(2, gap)));
        let of = |a: &TieAnchor| a.weights.iter().map(|w| f64::from(*w)).sum::<f64>();
        anchors(&graph).iter().map(of).fold(0.0, f64::max)
    };
    let (touching, near, far) = (weight(1e-9), weight(0.01), weight(0.02));
    assert!(touching > near && near > far && far >= 1.0, "{touching} {near} {far}");
    let row = untied(&unwelded(&slices(1, 0.0)), 1);
    let edges = (0..row.surface as u32).map(|v| row.row(v).len()).max().unwrap_or(0) as f64;
    assert!(touching > 0.9 * edges, "{touching} for a vertex of {edges} edges");
}

#[test]
fn any_number_of_parts_in_one_place_is_bounded_and_distinguished_from_nothing() {
    // A thousand boxes in one place, and a soup in which every triangle is its own part.
    let pile = together((0..1000).map(|_| block([0.0; 3], [1.0; 3], [1; 3])));
    let mut state = 1u64;
    let mut next = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut triangle = |size: f64| {
        let middle = DVec3::new(next(), next(), next());
        let corners = (0..3).map(|_| middle + size * DVec3::new(next(), next(), next()));
        (corners.collect::<Vec<_>>(), vec![[0, 1, 2]])
    };
    let soup = together((0..20_000).map(|_| triangle(0.08)).collect::<Vec<_>>());
    for (name, shape) in [("pile", pile), ("soup", soup)] {
        let mesh = unwelded(&shape);
        let graph = surface(&mesh, VolumeOptions::default().weights);
        let pool = Pool::new(2).expect("threads");
        let after = tie_parts(graph.clone(), &mesh, &TieOptions::default(), &Exec::new(&pool, &Silent)).expect("ties");
        check(&after, &graph, name);
        let ties = after.ties.as_ref().expect("ties").edge_count();
        assert!(ties <= 9 * mesh.positions.len(), "{name}: {ties} ties");
        assert!(
            after.components < 2 + mesh.triangles.len() / 100,
            "{name}: {} pieces",
            after.components
        );
    }
}

#[test]
fn tiny_and_huge_models_are_tied_as_others_are() {
    let shape = axe();
    let pairs = |scale: f64| {
        let graph = tied(&unwelded(&moved(shape.clone(), |p| p * scale)));
        anchors(&graph)
            .iter()
            .map(|a| (a.vertex, a.corners))
            .collect::<Vec<_>>()
    };
    let expected = pairs(1.0);
    // Powers of two, so that lengths keep their digits.
    for exponent in [-100.0, -20.0, 20.0, 100.0] {
        assert_eq!(pairs(libm::exp2(exponent)), expected, "2^{exponent}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

    /// A model that is turned, moved and scaled has its ties where it had them, and as firm.
    #[test]
    fn ties_go_with_the_model(
        axis in prop::array::uniform3(-1.0..1.0f64),
        angle in 0.0..6.0f64,
        scale in -3.0..3.0f64,
        shift in prop::array::uniform3(-5.0..5.0f64),
    ) {
        let Some(axis) = DVec3::from_array(axis).try_normalize() else { return Ok(()) };
        let (turn, scale) = (DQuat::from_axis_angle(axis, angle), libm::exp2(scale));
        // The reach is a part of the bounding box's diagonal, which a turn changes, so it is given.
        let options = |scale: f64| TieOptions { distance: Some(0.03 * scale), ..TieOptions::default() };
        let shape = strapped_ball();
        let before = tied_with(&unwelded(&shape), &options(1.0), 2);
        let there = moved(shape, |p| turn * p * scale + DVec3::from_array(shift));
        let after = tied_with(&unwelded(&there), &options(scale), 2);
        let places = |graph: &MeshGraph| {
            let place = |a: &TieAnchor| {
                let weight: f64 = a.weights.iter().map(|w| f64::from(*w)).sum();
                (a.vertex, weight)
            };
            anchors(graph).iter().map(place).collect::<Vec<_>>()
        };
        let (before, after) = (places(&before), places(&after));
        prop_assert_eq!(before.len(), after.len());
        for (b, a) in before.iter().zip(&after) {
            prop_assert_eq!(b.0, a.0);
            prop_assert!((b.1 - a.1).abs() < 1e-4 * b.1, "vertex {}: {} and {}", b.0, b.1, a.1);
        }
    }
}
