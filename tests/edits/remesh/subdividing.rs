//! Subdivision: four for one, neighbours fit, Loop smooths.

use super::edit_support::*;
use super::measures::*;
use glam::DVec3;
use pliant::edit::{CreaseOptions, SubdivisionScheme, subdivide_region};
use pliant::progress::Silent;

fn divided(model: &Model, faces: &[u32], scheme: SubdivisionScheme) -> Model {
    let patch = subdivide_region(&model.surface(), faces, scheme, &CreaseOptions::default(), &Silent).expect("divides");
    assert_blends(model, &patch);
    after(model, &patch)
}

#[test]
fn midpoints_keep_shape_and_topology_and_make_four_of_one() {
    for shape in [sphere(2, 1.0), torus(12, 8, 2.0, 0.6), cube(2), sheet(4, 5)] {
        let model = Model::of(shape);
        let now = divided(&model, &all(&model), SubdivisionScheme::Midpoint);
        assert_eq!(now.triangles.len(), 4 * model.triangles.len());
        assert_eq!(topology(&now).euler, topology(&model).euler);
        assert!(topology(&now).is_manifold());
        assert!((area(&now) / area(&model) - 1.0).abs() < 1e-12);
        assert!((volume(&now) - volume(&model)).abs() < 1e-12 * area(&model));
    }
}

#[test]
fn the_rim_of_a_region_has_no_t_junctions() {
    let model = Model::of(sphere(3, 1.0));
    for height in [0.8, 0.3, -0.2, -0.9] {
        for scheme in [SubdivisionScheme::Midpoint, SubdivisionScheme::Loop] {
            let faces = region(&model, |p| p.z > height);
            let patch = subdivide_region(&model.surface(), &faces, scheme, &CreaseOptions::default(), &Silent)
                .expect("divides");
            let now = after(&model, &patch);
            assert!(topology(&now).is_closed() && topology(&now).euler == 2);
            let fitted: Vec<u32> = patch
                .removed
                .iter()
                .copied()
                .filter(|t| faces.binary_search(t).is_err())
                .collect();
            assert_eq!(patch.removed.len(), faces.len() + fitted.len());
            assert!(!fitted.is_empty());
            // Points outside stay, and so do those on the rim.
            for (p, _) in &patch.moved {
                assert!(model.positions[*p as usize].z > height);
            }
            if scheme == SubdivisionScheme::Midpoint {
                assert!((area(&now) / area(&model) - 1.0).abs() < 1e-12 && patch.moved.is_empty());
            }
        }
    }
}

#[test]
fn seams_get_a_middle_on_either_side() {
    let model = with_seams(&Model::of(cube(2)), box_side, true);
    let now = divided(&model, &all(&model), SubdivisionScheme::Loop);
    assert!(topology(&now).is_closed() && topology(&now).euler == 2);
    assert_eq!(now.primitive_of.len(), 4 * model.primitive_of.len());
    // A cube of 8 quads a side: 8 · 8 · 2 points and more vertices than that along the sides.
    assert!(now.positions.len() > now.points as usize);
    let half = region(&model, |p| p.x >= -1e-9);
    let now = divided(&model, &half, SubdivisionScheme::Midpoint);
    assert!(topology(&now).is_closed());
}

#[test]
fn loop_subdivision_of_a_tetrahedron_grows_smooth() {
    let positions = [[1., 1., 1.], [1., -1., -1.], [-1., 1., -1.], [-1., -1., 1.]]
        .map(DVec3::from_array)
        .to_vec();
    let mut model = Model::of((positions, vec![[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]));
    let bend = |m: &Model| {
        let mut normals = std::collections::BTreeMap::new();
        let mut sharpest: f64 = 1.0;
        for t in all(m) {
            let c = corners(m, t);
            let n = (c[1] - c[0]).cross(c[2] - c[0]).normalize();
            let f = m.triangles[t as usize].map(|v| m.point_of[v as usize]);
            for i in 0..3 {
                normals.insert((f[i], f[(i + 1) % 3]), n);
                if let Some(o) = normals.get(&(f[(i + 1) % 3], f[i])) {
                    sharpest = sharpest.min(n.dot(*o));
                }
            }
        }
        sharpest
    };
    let mut before = bend(&model);
    for _ in 0..4 {
        let own = volume(&model);
        model = divided(&model, &all(&model), SubdivisionScheme::Loop);
        assert!(volume(&model) < own, "the limit lies inside a convex shape");
        let now = bend(&model);
        assert!(now > before, "edges of cosine {before} became {now}");
        before = now;
    }
    assert!(before > 0.9, "{before}");
    assert!(topology(&model).is_closed());
}

#[test]
fn loop_keeps_a_regular_plane_and_an_icosphere_gets_rounder() {
    let flat = Model::of(sheet(6, 6));
    let now = divided(&flat, &all(&flat), SubdivisionScheme::Loop);
    assert!(now.positions.iter().all(|p| p.z == 0.0));
    // The outline of a square sheet: corners are cut by its own curve, sides stay straight.
    let reach = now.positions.iter().fold(DVec3::ZERO, |m, p| m.max(*p));
    assert!(reach.x <= 6.0 && reach.x > 5.9);
    let ball = Model::of(sphere(1, 1.0));
    let roundness = |m: &Model| {
        let r: Vec<f64> = m.positions.iter().map(|p| p.length()).collect();
        let middle: Vec<f64> = all(m)
            .into_iter()
            .map(|t| corners(m, t).iter().sum::<DVec3>().length() / 3.0)
            .collect();
        let (most, least) = (
            r.iter().fold(0.0, |a: f64, b| a.max(*b)),
            middle.iter().fold(9.0, |a: f64, b| a.min(*b)),
        );
        most / least
    };
    let once = divided(&ball, &all(&ball), SubdivisionScheme::Loop);
    let twice = divided(&once, &all(&once), SubdivisionScheme::Loop);
    assert!(roundness(&once) < roundness(&ball) && roundness(&twice) < roundness(&once));
}

#[test]
fn data_meshes_of_any_kind_divide_without_new_cracks() {
    for name in [
        "truck.obj",
        "beetle.obj",
        "triple_vierbein.obj",
        "moebius.obj",
        "spot.obj",
        "cow.off",
    ] {
        let Some(model) = data(name) else { continue };
        for scheme in [SubdivisionScheme::Midpoint, SubdivisionScheme::Loop] {
            let before = topology(&model);
            let t = topology(&divided(&model, &all(&model), scheme));
            assert_eq!(
                (t.euler, t.components, t.pinched_points),
                (before.euler, before.components, before.pinched_points),
                "{name}"
            );
            assert_eq!(
                (t.rim_edges, t.crowded_edges),
                (2 * before.rim_edges, 2 * before.crowded_edges),
                "{name}"
            );
            let left = region(&model, |p| p.x < 0.1);
            if !left.is_empty() {
                let t = topology(&divided(&model, &left, scheme));
                assert_eq!((t.euler, t.components), (before.euler, before.components), "{name}");
            }
        }
    }
}
