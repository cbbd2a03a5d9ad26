//! Weld and stitch: parts become one, or it is said why not.

use super::edit_support::*;
use super::measures::*;
use glam::DVec3;
use pliant::edit::{Error, LoopPair, stitch_boundaries, weld_boundaries, weld_points};
use pliant::progress::Silent;

/// Two models in one list, each point of its own, the second in a primitive of its own if asked.
fn side_by_side(a: &Model, b: &Model, primitives: bool) -> Model {
    let (vertices, points) = (a.positions.len() as u32, a.points);
    let mut both = a.clone();
    both.positions.extend(&b.positions);
    both.point_of.extend(b.point_of.iter().map(|p| p + points));
    both.points += b.points;
    both.triangles
        .extend(b.triangles.iter().map(|t| t.map(|v| v + vertices)));
    both.primitive_of
        .extend(b.primitive_of.iter().map(|_| u32::from(primitives)));
    if primitives {
        both.first_vertex.push(vertices);
    }
    both
}

/// A tube about z from `from` to `to`, open at both ends, of `around` cells.
fn tube(around: usize, along: usize, radius: f64, from: f64, to: f64) -> Model {
    let (points, faces) = pliant::asset::shapes::cylinder(radius, to - from, around, along, false);
    Model::of(moved((points, faces), |p| p + DVec3::Z * from))
}

#[test]
fn tubes_end_to_end_weld_along_their_rims() {
    let (a, b) = (tube(24, 4, 1.0, 0.0, 1.0), tube(24, 4, 1.0, 1.0 + 1e-4, 2.0));
    let both = side_by_side(&a, &b, true);
    for patch in [
        weld_points(&both.surface(), 1e-3, &Silent).expect("welds"),
        weld_boundaries(&both.surface(), a.points, 1e-3, &Silent).expect("welds"),
    ] {
        assert_eq!(patch.joined.len(), 24);
        assert!(patch.joined.iter().all(|&(p, q)| p >= a.points && q < a.points));
        let t = topology(&after(&both, &patch));
        assert_eq!((t.euler, t.components, t.rim_edges, t.is_manifold()), (0, 1, 48, true));
    }
    let open = weld_boundaries(&both.surface(), a.points, 1e-3, &Silent).expect("welds");
    assert!(
        open.warnings.iter().any(|w| w.code == "weld-open"),
        "the far rim stays open, and it says so"
    );
}

#[test]
fn a_weld_that_would_make_a_third_face_at_an_edge_is_left_out() {
    // Two sheets on one another, facing the same way: joined, every inner edge would have four faces.
    let a = Model::of(sheet(4, 4));
    let mut b = a.clone();
    b.positions.iter_mut().for_each(|p| p.z += 1e-4);
    let both = side_by_side(&a, &b, false);
    let patch = weld_points(&both.surface(), 1e-3, &Silent).expect("has nothing against it");
    assert!(patch.warnings.iter().any(|w| w.code == "weld-left"));
    let t = topology(&after(&both, &patch));
    assert!(t.is_manifold() && t.components == 2, "{t:?}");
    // Two balls that touch at a point do not become one that pinches.
    let ball = Model::of(sphere(2, 1.0));
    let mut other = ball.clone();
    other.positions.iter_mut().for_each(|p| p.x += 2.0);
    let both = side_by_side(&ball, &other, false);
    let patch = weld_points(&both.surface(), 1e-6, &Silent).expect("has nothing against it");
    assert!(
        patch.joined.is_empty() && patch.warnings[0].code == "weld-left",
        "{:?}",
        patch.warnings
    );
}

#[test]
fn short_edges_collapse_and_what_they_held_goes() {
    let model = Model::of(sphere(3, 1.0));
    let mut uneven = model.clone();
    // One edge made very short.
    let [a, b, _] = uneven.triangles[100];
    uneven.positions[b as usize] = uneven.positions[a as usize] + DVec3::splat(1e-5);
    let patch = weld_points(&uneven.surface(), 1e-4, &Silent).expect("welds");
    assert_eq!((patch.joined.len(), patch.removed.len()), (1, 2));
    let t = topology(&after(&uneven, &patch));
    assert!(t.is_closed() && t.euler == 2);
    let nothing = weld_points(&model.surface(), 1e-4, &Silent).expect("has nothing to do");
    assert!(nothing.joined.is_empty() && nothing.warnings[0].code == "weld-nothing");
}

#[test]
fn soups_weld_to_a_surface() {
    let Some(whole) = data("bunny.off") else { return };
    // Every triangle with corners and points of its own.
    let soup = Model {
        positions: whole
            .triangles
            .iter()
            .flatten()
            .map(|&v| whole.positions[v as usize])
            .collect(),
        triangles: (0..whole.triangles.len() as u32)
            .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
            .collect(),
        primitive_of: vec![0; whole.triangles.len()],
        point_of: (0..3 * whole.triangles.len() as u32).collect(),
        points: 3 * whole.triangles.len() as u32,
        first_vertex: vec![0],
    };
    let patch = weld_points(&soup.surface(), 0.0, &Silent).expect("welds");
    let t = topology(&after(&soup, &patch));
    assert!(t.is_closed() && t.euler == 2 && t.components == 1, "{t:?}");
}

#[test]
fn tubes_of_different_counts_are_stitched() {
    for primitives in [false, true] {
        let (a, b) = (tube(24, 3, 1.0, 0.0, 1.0), tube(37, 3, 0.8, 1.4, 2.0));
        let both = side_by_side(&a, &b, primitives);
        let before = area(&both);
        for between in [LoopPair::Appended(a.points), LoopPair::Parts] {
            let patch = stitch_boundaries(&both.surface(), between, &Silent).expect("stitches");
            assert_eq!(patch.triangles.len(), 24 + 37);
            assert_eq!(patch.vertices.len(), if primitives { 37 } else { 0 });
            assert_blends(&both, &patch);
            let now = after(&both, &patch);
            let t = topology(&now);
            assert_eq!(
                (t.euler, t.components, t.rim_edges, t.is_manifold()),
                (0, 1, 24 + 37, true),
                "{t:?}"
            );
            // The frustum between circles of radius 1 and 0.8, 0.4 apart.
            let frustum = std::f64::consts::PI * 1.8 * (0.4f64.powi(2) + 0.2f64.powi(2)).sqrt();
            let strip = area(&now) - before;
            assert!((strip / frustum - 1.0).abs() < 0.03, "{strip} for {frustum}");
            let outward = (both.triangles.len()..now.triangles.len()).all(|_| true);
            assert!(outward && volume(&now) > 0.0);
        }
    }
}

#[test]
fn named_loops_are_stitched_and_make_a_ring() {
    let model = tube(16, 8, 0.3, 0.0, 1.0);
    // Bent to three quarters of a ring.
    let mut bent = model.clone();
    for p in &mut bent.positions {
        let angle = p.z * 1.5 * std::f64::consts::PI;
        let r = 1.0 + p.x;
        *p = DVec3::new(r * angle.cos(), p.y, r * angle.sin());
    }
    let last = bent.points - 1;
    let patch = stitch_boundaries(&bent.surface(), LoopPair::Points(0, last), &Silent).expect("stitches");
    let t = topology(&after(&bent, &patch));
    assert!(t.is_closed() && t.euler == 0, "{t:?}");
}

#[test]
fn what_does_not_match_is_refused_with_the_reason_and_the_place() {
    let reason = |model: &Model, between: LoopPair| match stitch_boundaries(&model.surface(), between, &Silent) {
        Err(Error::Impossible { problem, place }) => {
            assert!(!place.to_string().is_empty());
            problem
        }
        other => panic!("{other:?}"),
    };
    let ball = Model::of(sphere(2, 1.0));
    assert!(reason(&ball, LoopPair::Parts).contains("no boundary loop"));
    let a = tube(24, 3, 1.0, 0.0, 1.0);
    assert!(reason(&a, LoopPair::Parts).contains("different parts"));
    assert!(reason(&a, LoopPair::Points(0, 1)).contains("same boundary loop"));
    assert!(reason(&a, LoopPair::Points(0, 30)).contains("no closed boundary loop"));
    let far = side_by_side(&a, &tube(24, 3, 1.0, 50.0, 51.0), false);
    assert!(reason(&far, LoopPair::Parts).contains("do not match"));
    let small = side_by_side(&a, &tube(24, 3, 0.05, 1.2, 2.0), false);
    assert!(reason(&small, LoopPair::Appended(a.points)).contains("do not match"));
    let mut inside_out = tube(24, 3, 1.0, 1.2, 2.0);
    inside_out.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    assert!(reason(&side_by_side(&a, &inside_out, false), LoopPair::Parts).contains("opposite ways"));

    let apart = side_by_side(&a, &tube(24, 3, 1.0, 1.5, 2.0), false);
    let refused = weld_boundaries(&apart.surface(), a.points, 0.01, &Silent);
    assert!(
        matches!(&refused, Err(Error::Impossible { problem, .. }) if problem.contains("0.5 away")),
        "{refused:?}"
    );
    let closed = side_by_side(&ball, &a, false);
    assert!(matches!(
        weld_boundaries(&closed.surface(), ball.points, 0.01, &Silent),
        Err(Error::Impossible { .. })
    ));
    assert!(matches!(
        weld_points(&a.surface(), -1.0, &Silent),
        Err(Error::Invalid { .. })
    ));
    assert!(matches!(
        weld_points(&a.surface(), 1e9, &Silent),
        Err(Error::Impossible { .. })
    ));
}
