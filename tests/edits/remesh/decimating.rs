//! Decimation: the ratio is reached, topology and lines are kept.

use super::edit_support::*;
use super::measures::*;
use pliant::edit::{Error, decimate_region};
use pliant::progress::Silent;

#[test]
fn the_ratio_is_reached_within_a_tenth_and_the_shape_is_kept() {
    for (name, shape) in [
        ("sphere", sphere(5, 1.0)),
        ("torus", torus(80, 40, 2.0, 0.7)),
        ("cube", cube(5)),
    ] {
        let model = Model::of(shape);
        let before = topology(&model);
        for ratio in [0.7, 0.3, 0.1] {
            let patch = decimate_region(&model.surface(), &all(&model), ratio, &Silent).expect("thins out");
            assert!(patch.vertices.is_empty() && patch.moved.is_empty() && patch.warnings.is_empty());
            let now = after(&model, &patch);
            let reached = now.triangles.len() as f64 / model.triangles.len() as f64;
            assert!((reached / ratio - 1.0).abs() < 0.1, "{name}: {reached} for {ratio}");
            let t = topology(&now);
            assert!(t.is_closed() && t.euler == before.euler, "{name}: {t:?}");
            let kept = volume(&now) / volume(&model);
            assert!((kept - 1.0).abs() < 0.004 / ratio, "{name} {ratio}: {kept}");
            assert!(
                deviation(&model, &now) < 0.05,
                "{name} {ratio}: {}",
                deviation(&model, &now)
            );
            assert!(least_agreement(&model, &now, |_| true) > 0.0, "{name} {ratio}");
        }
    }
}

#[test]
fn flat_sides_thin_out_and_edges_of_a_cube_stay() {
    let model = Model::of(cube(5));
    let patch = decimate_region(&model.surface(), &all(&model), 0.05, &Silent).expect("thins out");
    let now = after(&model, &patch);
    assert!((volume(&now) - 8.0).abs() < 1e-9 && (area(&now) - 24.0).abs() < 1e-9);
}

#[test]
fn rims_seams_and_boundaries_stay() {
    let plain = Model::of(sphere(5, 1.0));
    let model = with_seams(&plain, box_side, true);
    let faces = region(&model, |p| p.z > 0.0);
    let patch = decimate_region(&model.surface(), &faces, 0.2, &Silent).expect("thins out");
    assert_outside_kept(&model, &faces, &patch);
    let now = after(&model, &patch);
    let t = topology(&now);
    assert!(t.is_closed() && t.euler == 2, "{t:?}");
    for (t, &p) in now.triangles.iter().zip(&now.primitive_of) {
        let c = t.map(|v| now.positions[v as usize]);
        // Sides of a ball overlap a cube's by what a coarser line cuts off.
        let middle = (c[0] + c[1] + c[2]) / 3.0;
        let axis = (p / 2) as usize;
        assert!(
            middle[axis].abs() > 0.3 && (middle[axis] > 0.0) == (p % 2 == 1),
            "{middle} in {p}"
        );
    }
    let sheet = Model::of(sheet(30, 20));
    let patch = decimate_region(&sheet.surface(), &all(&sheet), 0.1, &Silent).expect("thins out");
    let now = after(&sheet, &patch);
    assert!((area(&now) - 600.0).abs() < 1e-9 && topology(&now).euler == 1);
}

#[test]
fn a_cut_whose_sides_lie_at_one_place_is_not_zipped_up() {
    // Two half sheets that touch along a line, but share no point there.
    let (mut positions, faces) = sheet(10, 10);
    let count = positions.len() as u32;
    positions.extend(positions.clone());
    let mut triangles = faces.clone();
    for t in &mut triangles {
        if t.iter().any(|&v| positions[v as usize].x > 5.5) {
            *t = t.map(|v| v + count);
        }
    }
    let used: std::collections::BTreeSet<u32> = triangles.iter().flatten().copied().collect();
    let numbers: std::collections::BTreeMap<u32, u32> = used.iter().zip(0..).map(|(&v, i)| (v, i)).collect();
    let model = Model {
        positions: used.iter().map(|&v| positions[v as usize]).collect(),
        primitive_of: vec![0; triangles.len()],
        triangles: triangles.iter().map(|t| t.map(|v| numbers[&v])).collect(),
        point_of: (0..used.len() as u32).collect(),
        points: used.len() as u32,
        first_vertex: vec![0],
    };
    let before = topology(&model);
    assert_eq!(before.components, 2);
    let patch = decimate_region(&model.surface(), &all(&model), 0.2, &Silent).expect("thins out");
    let t = topology(&after(&model, &patch));
    assert!(t.components == 2 && t.euler == 2 && t.is_manifold(), "{t:?}");
}

#[test]
fn data_meshes_of_any_kind_keep_their_topology() {
    for name in [
        "bunny.off",
        "camelhead.off",
        "spot.obj",
        "cow.off",
        "truck.obj",
        "beetle.obj",
        "teapot.obj",
        "moebius.obj",
        "triple_vierbein.obj",
    ] {
        let Some(model) = data(name) else { continue };
        let before = topology(&model);
        for ratio in [0.5, 0.15] {
            let patch = decimate_region(&model.surface(), &all(&model), ratio, &Silent).expect("thins out");
            let now = after(&model, &patch);
            let t = topology(&now);
            assert_eq!(kind(&t), kind(&before), "{name}");
            let reached = now.triangles.len() as f64 / model.triangles.len() as f64;
            assert!(
                reached < 1.1 * ratio || !patch.warnings.is_empty(),
                "{name}: {reached} for {ratio} in silence"
            );
        }
    }
}

#[test]
fn ratios_out_of_range_are_refused() {
    let model = Model::of(sphere(1, 1.0));
    for ratio in [0.0, 1.0, -0.5, f64::NAN, 2.0] {
        let refused = decimate_region(&model.surface(), &all(&model), ratio, &Silent);
        assert!(
            matches!(
                &refused,
                Err(Error::Invalid { field, .. }) if field == "decimate.ratio"
            ),
            "{refused:?}"
        );
    }
}
