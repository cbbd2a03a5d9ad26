//! Cuts, holes and curves on surfaces that are hard: seams, several primitives, soups of triangles, scanned meshes.

use super::edit_support;
use edit_support::*;
use glam::DVec3;
use pliant::edit::{
    CutPlane, Error, KeptSide, SurfaceCurve, SurfacePatch, SurfaceTopology, cut_along_curve, cut_by_plane,
    delete_faces, fill_holes, insert_curve,
};
use pliant::progress::{CancelFlag, Silent};
use proptest::prelude::*;
use std::collections::BTreeSet;

/// A cube whose six sides have render vertices of their own, three sides to a primitive; sides in order.
fn sided_cube() -> (Model, Vec<u32>) {
    let welded = Model::of(cube(3));
    let side_of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| welded.positions[v as usize]);
        let n = (b - a).cross(c - a).normalize();
        (0..6u32)
            .find(|&s| n[s as usize % 3] * (if s < 3 { 1.0 } else { -1.0 }) > 0.9)
            .expect("a side")
    };
    let mut model = Model {
        positions: Vec::new(),
        triangles: Vec::new(),
        primitive_of: Vec::new(),
        point_of: Vec::new(),
        points: welded.points,
        first_vertex: Vec::new(),
    };
    let mut side_of_vertex = Vec::new();
    for side in 0..6 {
        if side % 3 == 0 {
            model.first_vertex.push(model.positions.len() as u32);
        }
        let mut own = std::collections::BTreeMap::new();
        for t in welded.triangles.iter().filter(|t| side_of(t) == side) {
            let triangle = t.map(|v| {
                *own.entry(v).or_insert_with(|| {
                    model.positions.push(welded.positions[v as usize]);
                    model.point_of.push(welded.point_of[v as usize]);
                    side_of_vertex.push(side);
                    model.positions.len() as u32 - 1
                })
            });
            model.triangles.push(triangle);
            model.primitive_of.push(side / 3);
        }
    }
    (model, side_of_vertex)
}

/// Each new vertex is blended from vertices of one side, and where it is said to be; with moved points, near it.
fn check_blends(model: &Model, side: &[u32], patch: &SurfacePatch, near: f64) {
    assert!(!patch.vertices.is_empty());
    for v in &patch.vertices {
        let parts = || v.of.iter().zip(&v.weights).filter(|(_, w)| **w > 0.0);
        let sides: BTreeSet<u32> = parts().map(|(&of, _)| side[of as usize]).collect();
        assert_eq!(sides.len(), 1, "{v:?}");
        let blended: DVec3 = parts().map(|(&of, &w)| model.positions[of as usize] * w).sum();
        assert!(blended.distance(v.position) <= near, "{v:?} is blended to {blended}");
    }
}

#[test]
fn seams_and_primitives_stay_apart_and_blends_are_exact() {
    let (model, side) = sided_cube();
    assert!(topology(&model).is_closed());
    let plane = CutPlane {
        normal: DVec3::new(0.3, 0.4, 1.0),
        offset: 0.13,
    };
    for keep in [KeptSide::Both, KeptSide::Above, KeptSide::Below] {
        let patch = model.cut(&plane, &cut_options(keep, false, &[])).expect("cuts");
        check_blends(&model, &side, &patch, 1e-12);
        let t = topology(&after(&model, &patch));
        assert!(t.is_manifold() && t.rim_edges > 0, "{t:?}");
    }
    let ring = [
        DVec3::X,
        DVec3::new(0.1, 1.0, 0.2),
        DVec3::NEG_X,
        DVec3::new(-0.1, -1.0, 0.1),
    ]
    .map(|p| p * 1.2);
    let patch = model.insert(&ring, true).expect("inserts");
    let points = &patch.curve;
    check_blends(&model, &side, &patch, 1e-12);
    assert!(points.len() > 16 && topology(&after(&model, &patch)).is_closed());
}

#[test]
fn caps_take_the_primitive_of_most_of_their_rim_and_hard_ones_their_own_vertices() {
    let (model, _) = sided_cube();
    let plane = CutPlane {
        normal: DVec3::Z,
        offset: 0.3,
    };
    for (hard, own) in [(&[true, true], true), (&[false, false], false)] {
        let patch = model
            .cut(&plane, &cut_options(KeptSide::Below, true, hard))
            .expect("cuts");
        let whole = after(&model, &patch);
        assert!(topology(&whole).is_closed());
        let flat = |t: &&[u32; 3]| t.iter().all(|&v| whole.positions[v as usize].z == 0.3);
        let cap: BTreeSet<u32> = whole.triangles.iter().filter(flat).flatten().copied().collect();
        let wall: BTreeSet<u32> = whole.triangles.iter().filter(|t| !flat(t)).flatten().copied().collect();
        assert!(cap.len() > 8);
        assert_eq!(cap.is_disjoint(&wall), own);
    }
}

#[test]
fn deleting_corner_to_corner_leaves_no_pinched_point() {
    let whole = Model::of(sheet(6, 6));
    // Two squares that touch at a corner.
    let picked: Vec<u32> = [2 * (2 * 6 + 2), 2 * (3 * 6 + 3)]
        .iter()
        .flat_map(|&f| [f, f + 1])
        .collect();
    for fill in [false, true] {
        let patch = whole.delete(&picked, fill).expect("deletes");
        let rest = after(&whole, &patch);
        let t = topology(&rest);
        assert!(t.is_manifold(), "{t:?}");
        assert_eq!(t.euler, if fill { 1 } else { 0 }, "{t:?}");
    }
    // At the rim there is nothing to close.
    let corner = whole.delete(&[0, 1], true).expect("deletes");
    assert!(
        corner.triangles.is_empty() && corner.warnings[0].code == "open-rim",
        "{:?}",
        corner.warnings
    );
}

#[test]
fn cancelled_work_stops() {
    let whole = Model::of(sphere(4, 1.0));
    let flag = CancelFlag::default();
    flag.cancel();
    let plane = CutPlane {
        normal: DVec3::Z,
        offset: 0.1,
    };
    let line = [DVec3::X, DVec3::Y, DVec3::Z];
    assert_eq!(
        cut_by_plane(&whole.surface(), &plane, &cut_options(KeptSide::Both, true, &[]), &flag),
        Err(Error::Cancelled)
    );
    assert_eq!(
        delete_faces(&whole.surface(), &[0, 1], true, &flag),
        Err(Error::Cancelled)
    );
    assert_eq!(
        insert_curve(&whole.surface(), &SurfaceCurve::Drawn(&line), true, &flag),
        Err(Error::Cancelled)
    );
}

/// Whether two triangles have the same three points: front and back of nothing, which a split cannot distinguish.
fn twins(model: &Model) -> bool {
    let mut corners: Vec<[u32; 3]> = model
        .triangles
        .iter()
        .map(|t| t.map(|v| model.point_of[v as usize]))
        .collect();
    corners.iter_mut().for_each(|t| t.sort_unstable());
    corners.sort_unstable();
    corners.windows(2).any(|w| w[0] == w[1])
}

/// All operations of this file's kind on one model, somewhere; every result is applied and checked.
fn everything(model: &Model, plane: &CutPlane, drawn: &[DVec3], faces: &[u32]) -> Vec<SurfacePatch> {
    let s = model.surface();
    let mut results = Vec::new();
    for keep in [KeptSide::Both, KeptSide::Above, KeptSide::Below] {
        for fill in [false, true] {
            results.push(cut_by_plane(&s, plane, &cut_options(keep, fill, &[true]), &Silent));
            results.push(cut_along_curve(
                &s,
                &SurfaceCurve::Drawn(drawn),
                true,
                &cut_options(keep, fill, &[true]),
                &Silent,
            ));
        }
    }
    results.push(cut_along_curve(
        &s,
        &SurfaceCurve::Drawn(drawn),
        false,
        &cut_options(KeptSide::Both, false, &[]),
        &Silent,
    ));
    results.push(insert_curve(&s, &SurfaceCurve::Drawn(drawn), false, &Silent));
    results.push(delete_faces(&s, faces, false, &Silent));
    results.push(delete_faces(&s, faces, true, &Silent));
    results.push(fill_holes(&s, None, &Silent));
    results.push(fill_holes(&s, Some(faces), &Silent));
    let patches: Vec<SurfacePatch> = results.into_iter().filter_map(Result::ok).collect();
    let before = SurfaceTopology::from_surface(&s);
    for (op, patch) in patches.iter().enumerate() {
        // A curve may close on itself around everything that is left.
        let Ok(applied) = pliant::edit::apply_patch(&s, patch, &model.first_vertex) else {
            panic!("{:?}", pliant::edit::apply_patch(&s, patch, &model.first_vertex));
        };
        pliant::edit::verify_surface(&applied.surface()).expect("consistent");
        if before.is_manifold() && !twins(model) {
            let now = SurfaceTopology::from_surface(&applied.surface());
            assert!(
                !twins(&after(model, patch)),
                "{op} doubles a triangle {patch:?} {model:?}"
            );
            assert!(now.is_manifold(), "{op} {before:?} {now:?} {patch:?} {model:?}");
        }
    }
    patches
}

#[test]
fn scanned_and_broken_meshes_give_results_or_reasons() {
    let names = [
        "bunny.off",
        "cow.off",
        "camelhead.off",
        "arap_square_21_spikes.off",
        "moebius.obj",
        "triple_vierbein.obj",
        "plane_holes.obj",
        "decimated-knight.off",
        "suzanne.obj",
        "teapot.obj",
        "beetle.obj",
        "truck.obj",
        "woody.obj",
        "3holes.off",
        "arap_bar3.off",
        "face.obj",
        "doorman.obj",
    ];
    for name in names {
        let Some(model) = data(name) else {
            continue;
        };
        let (low, high) = bounds(&model.positions);
        let middle = (low + high) * 0.5;
        let plane = CutPlane {
            normal: DVec3::new(0.2, 0.9, 0.1),
            offset: DVec3::new(0.2, 0.9, 0.1).dot(middle),
        };
        let around = model.positions[model.triangles[model.triangles.len() / 3][0] as usize];
        let size = (high - low).length();
        let drawn = [DVec3::X, DVec3::Y, DVec3::Z].map(|e| around + e * 0.05 * size);
        let is_near = |v: &u32| model.positions[*v as usize].distance(around) < 0.07 * size;
        let faces = model.triangles_where(|t| t.iter().all(is_near));
        let done = everything(&model, &plane, &drawn, &faces).len();
        println!("{name}: {done} of 18 done, {:?}", topology(&model));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn soups_give_results_or_reasons(
        grid in prop::collection::vec((0..4i32, 0..4i32, 0..3i32), 5..12),
        corners in prop::collection::vec((0..12u32, 0..12u32, 0..12u32), 2..30),
        normal in (-2..3i32, -2..3i32, -2..3i32),
        offset in -3.0..6.0f64,
        picked in prop::collection::btree_set(0..30u32, 1..6),
        jitter: bool,
    ) {
        let shake = |i: usize| if jitter { 0.01 * (i as f64 * 1.7 % 1.0) } else { 0.0 };
        let positions: Vec<DVec3> = (grid.iter().enumerate())
            .map(|(i, &(x, y, z))| DVec3::new(f64::from(x) + shake(i), f64::from(y), f64::from(z) - shake(3 * i)))
            .collect();
        let n = positions.len() as u32;
        let triangles: Vec<[u32; 3]> = (corners.iter())
            .map(|&(a, b, c)| [a % n, b % n, c % n])
            .filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0])
            .collect();
        prop_assume!(!triangles.is_empty());
        let mut point_of = vec![u32::MAX; n as usize];
        let mut points = 0;
        for &v in triangles.iter().flatten() {
            if point_of[v as usize] == u32::MAX {
                point_of[v as usize] = points;
                points += 1;
            }
        }
        let faces: Vec<u32> = picked.into_iter().filter(|&f| (f as usize) < triangles.len()).collect();
        let model = Model {
            primitive_of: vec![0; triangles.len()],
            positions,
            triangles,
            point_of,
            points,
            first_vertex: vec![0],
        };
        let plane = CutPlane { normal: DVec3::new(normal.0.into(), normal.1.into(), normal.2.into()), offset };
        let drawn = [DVec3::new(0.2, 0.1, 0.0), DVec3::new(2.5, 1.0, 1.0), DVec3::new(1.0, 2.5, offset)];
        everything(&model, &plane, &drawn, &faces);
    }
}
