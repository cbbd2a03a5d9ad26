//! Remeshing: edges near the target, shape and lines kept, nothing outside the region noticed.

use super::edit_support::*;
use super::measures::*;
use glam::DVec3;
use pliant::edit::{Error, MENDED, RemeshOptions, RemeshTarget, SurfacePatch, remesh_region};
use pliant::progress::{CancelFlag, Progress, Silent};
use std::sync::atomic::{AtomicUsize, Ordering};

fn patch_of(model: &Model, faces: &[u32], target: RemeshTarget<'_>) -> SurfacePatch {
    let options = RemeshOptions::from(target);
    let remeshed = remesh_region(&model.surface(), faces, &options, &Silent);
    remeshed.expect("remeshes")
}

fn remeshed(model: &Model, faces: &[u32], length: f64) -> Model {
    let patch = patch_of(model, faces, RemeshTarget::Length(length));
    assert_outside_kept(model, faces, &patch);
    assert_blends(model, &patch);
    after(model, &patch)
}

#[test]
fn closed_shapes_stay_closed_and_keep_their_shape() {
    for (name, shape) in [
        ("sphere", sphere(4, 1.0)),
        ("torus", torus(60, 24, 2.0, 0.7)),
        ("cube", cube(4)),
    ] {
        let model = Model::of(shape);
        let (before, own) = (topology(&model), mean_length(&model));
        for factor in [0.6, 1.0, 1.8] {
            let now = remeshed(&model, &all(&model), own * factor);
            let t = topology(&now);
            assert!(
                t.is_closed() && t.euler == before.euler && t.components == 1,
                "{name} × {factor}: {t:?}"
            );
            let (v, w) = (volume(&model), volume(&now));
            // A coarser polyhedron in a curved surface holds less.
            let bound = 0.02 * factor * factor;
            assert!((v - w).abs() <= bound * v, "{name} × {factor}: volume {v} became {w}");
            assert!(
                (area(&model) - area(&now)).abs() <= bound * area(&model),
                "{name} × {factor}"
            );
            let within = lengths_within(&now, own * factor, 0.6..=1.6);
            assert!(
                within > 0.95,
                "{name} × {factor}: {within} of the edges are near the target"
            );
            assert!(worst_aspect(&now) < MENDED, "{name} × {factor}: {}", worst_aspect(&now));
            let agreement = least_agreement(&model, &now, |_| true);
            assert!(agreement > 0.5, "{name} × {factor}: {agreement}");
        }
    }
}

/// Two cones whose faces all reach from the rim to a tip.
fn double_cone(sides: u32) -> Shape {
    let rim = (0..sides).map(|k| {
        let (sin, cos) = (f64::from(k) / f64::from(sides) * std::f64::consts::TAU).sin_cos();
        DVec3::new(cos, sin, 0.0)
    });
    let points = rim.chain([DVec3::Z * 0.5, DVec3::NEG_Z * 0.5]).collect();
    let faces = (0..sides).flat_map(|k| {
        let next = (k + 1) % sides;
        [[k, next, sides], [next, k, sides + 1]]
    });
    (points, faces.collect())
}

#[test]
fn very_many_faces_that_meet_at_one_point_are_remeshed() {
    let model = Model::of(double_cone(700));
    let now = remeshed(&model, &all(&model), 0.1);
    let t = topology(&now);
    assert!(t.is_closed() && t.euler == 2 && t.components == 1, "{t:?}");
    let (v, w) = (volume(&model), volume(&now));
    assert!((v - w).abs() <= 0.05 * v, "volume {v} became {w}");
}

/// Is no longer wanted once it was asked so often.
struct GivenUpAfter(AtomicUsize);

impl Progress for GivenUpAfter {
    fn cancelled(&self) -> bool {
        let left = |left: usize| Some(left.saturating_sub(1));
        self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, left) == Ok(0)
    }
}

#[test]
fn a_remesh_of_faces_as_long_as_the_model_is_given_up_at_any_time() {
    let model = Model::of(double_cone(300));
    let options = RemeshOptions::from(RemeshTarget::Length(0.1));
    for asked in [0, 2, 6] {
        let watch = GivenUpAfter(AtomicUsize::new(asked));
        let given_up = remesh_region(&model.surface(), &all(&model), &options, &watch);
        assert_eq!(given_up, Err(Error::Cancelled), "after {asked}");
    }
}

#[test]
fn sharp_edges_of_a_cube_stay_to_the_last_corner() {
    let model = Model::of(cube(4));
    for length in [0.13, 0.3, 0.7] {
        let now = remeshed(&model, &all(&model), length);
        assert!((volume(&now) - 8.0).abs() < 1e-9, "{length}");
        assert!((area(&now) - 24.0).abs() < 1e-9, "{length}");
    }
}

#[test]
fn seams_and_primitive_borders_stay_lines_with_their_own_vertices() {
    for primitives in [false, true] {
        let plain = Model::of(sphere(4, 1.0));
        // Seams without any crease: only topology can keep them.
        let model = with_seams(&plain, box_side, primitives);
        let own: Vec<DVec3> = {
            let mut side = vec![DVec3::ZERO; model.positions.len()];
            for t in 0..model.triangles.len() as u32 {
                let c = corners(&model, t);
                let number = f64::from(box_side((c[0] + c[1] + c[2]) / 3.0));
                model.triangles[t as usize]
                    .iter()
                    .for_each(|&v| side[v as usize] = DVec3::splat(number));
            }
            side
        };
        let patch = patch_of(&model, &all(&model), RemeshTarget::Length(0.12));
        assert_blends(&model, &patch);
        let carried = carry(&model, &patch, &own);
        let now = after(&model, &patch);
        assert!(topology(&now).is_closed() && topology(&now).euler == 2);
        for t in &now.triangles {
            let [a, b, c] = t.map(|v| carried[v as usize]);
            let whole = a.x.round();
            let same = [a, b, c].iter().all(|v| (v.x - whole).abs() < 1e-9);
            assert!(same, "a triangle mixes sides {a} {b} {c}");
        }
        let moved = patch
            .vertices
            .iter()
            .filter(|v| v.weights.iter().filter(|w| **w > 0.0).count() > 1);
        assert!(moved.count() > 100, "something was remeshed");
        // The line between two sides has as long a way as before, within what a chord cuts off.
        let seam = |m: &Model| seam_length(m);
        assert!(
            (seam(&now) - seam(&model)).abs() < 0.03 * seam(&model),
            "{} {}",
            seam(&model),
            seam(&now)
        );
    }
}

fn seam_length(model: &Model) -> f64 {
    let mut sides = std::collections::BTreeMap::new();
    let mut length = 0.0;
    for t in &model.triangles {
        for i in 0..3 {
            let (v, w) = (t[i], t[(i + 1) % 3]);
            let (p, q) = (model.point_of[v as usize], model.point_of[w as usize]);
            if let Some((b, a)) = sides.insert((p, q), (v, w)) {
                panic!("edge {p}–{q} is passed twice the same way by {a} and {b}");
            }
            if sides.get(&(q, p)).is_some_and(|&(b, a)| a != v || b != w) {
                length += model.positions[v as usize].distance(model.positions[w as usize]);
            }
        }
    }
    length
}

#[test]
fn attributes_come_from_where_a_vertex_lies() {
    // An attribute that is the position itself must come out as the position.
    let model = Model::of(sheet(20, 20));
    let patch = patch_of(&model, &all(&model), RemeshTarget::Length(0.7));
    let carried = carry(&model, &patch, &model.positions);
    let now = after(&model, &patch);
    for (v, p) in now.positions.iter().enumerate() {
        assert!(
            carried[v].distance(*p) < 1e-9,
            "vertex {v} at {p} is made of {}",
            carried[v]
        );
    }
    assert!((area(&now) - 400.0).abs() < 1e-9, "an open sheet keeps its outline");
    assert!(lengths_within(&now, 0.7, 0.6..=1.6) > 0.95 && worst_aspect(&now) < MENDED);
}

#[test]
fn a_region_is_remeshed_and_its_surroundings_are_not() {
    let model = Model::of(sphere(5, 1.0));
    let faces = region(&model, |p| p.z > 0.5);
    for factor in [0.4, 1.0, 2.5] {
        let length = factor * mean_length(&model);
        let now = remeshed(&model, &faces, length);
        let t = topology(&now);
        assert!(t.is_closed() && t.euler == 2, "{t:?}");
        assert!((volume(&now) / volume(&model) - 1.0).abs() < 0.01);
        assert!(worst_aspect(&now) < MENDED, "{factor}: {}", worst_aspect(&now));
        let count = now.triangles.len() as f64 - model.triangles.len() as f64;
        assert!(if factor < 1.0 {
            count > 0.0
        } else {
            count < 0.2 * faces.len() as f64
        });
        // What is outside is still there, bit for bit.
        let outside = |m: &Model| {
            let mut kept: Vec<[[u64; 3]; 3]> = region(m, |p| p.z < 0.45)
                .into_iter()
                .map(|t| corners(m, t).map(|p| p.to_array().map(f64::to_bits)))
                .collect();
            kept.sort_unstable();
            kept
        };
        assert_eq!(outside(&model), outside(&now));
    }
}

#[test]
fn the_same_again_changes_little() {
    let model = Model::of(torus(60, 24, 2.0, 0.7));
    let length = mean_length(&model);
    let once = remeshed(&model, &all(&model), length);
    let twice = remeshed(&once, &all(&once), length);
    let change = twice.triangles.len() as f64 / once.triangles.len() as f64;
    assert!(
        (change - 1.0).abs() < 0.03,
        "{} became {}",
        once.triangles.len(),
        twice.triangles.len()
    );
    assert!((volume(&once) / volume(&twice) - 1.0).abs() < 0.005);
}

#[test]
fn auto_mends_what_is_stretched_and_leaves_the_rest() {
    let rest = Model::of(sphere(5, 1.0));
    // The top pulled out to more than four times its height.
    let mut pulled = rest.clone();
    for p in &mut pulled.positions {
        let above = (p.z - 0.2).max(0.0);
        p.z += 4.5 * above * above;
    }
    let patch = patch_of(&pulled, &all(&pulled), RemeshTarget::Auto { rest: &rest.positions });
    let now = after(&pulled, &patch);
    assert!(topology(&now).is_closed() && topology(&now).euler == 2);
    assert!(worst_aspect(&now) < MENDED, "{}", worst_aspect(&now));
    assert!(least_agreement(&pulled, &now, |_| true) > 0.0);
    assert!((volume(&now) / volume(&pulled) - 1.0).abs() < 0.01);
    let low = patch.removed.iter().filter(|&&t| corners(&rest, t)[0].z < 0.0).count();
    assert_eq!(low, 0, "the lower half was not stretched");
    assert!(now.triangles.len() > rest.triangles.len() + 1000);
    // In the rest pose there is nothing to do, and it says so.
    let nothing = patch_of(&rest, &all(&rest), RemeshTarget::Auto { rest: &rest.positions });
    assert!(nothing.removed.is_empty() && nothing.warnings[0].code == "remesh-nothing");
}

#[test]
fn pulling_and_remeshing_in_turns_keeps_triangles_good() {
    let mut model = Model::of(sphere(4, 1.0));
    let mut top = 1.0f64;
    for round in 0..8 {
        let rest = model.clone();
        for p in &mut model.positions {
            p.z += 0.5 * (p.z / top).max(0.0).powi(2);
        }
        top += 0.5;
        let patch = patch_of(&model, &all(&model), RemeshTarget::Auto { rest: &rest.positions });
        model = after(&model, &patch);
        assert!(topology(&model).is_closed(), "round {round}");
        assert!(
            worst_aspect(&model) < 1.3 * MENDED,
            "round {round}: {}",
            worst_aspect(&model)
        );
    }
    assert!(top > 4.5);
}

#[test]
fn data_meshes_keep_topology_and_get_good_triangles() {
    for name in [
        "bunny.off",
        "camelhead.off",
        "spot.obj",
        "cow.off",
        "teapot.obj",
        "truck.obj",
        "beetle.obj",
        "woody.obj",
        "moebius.obj",
    ] {
        let Some(model) = data(name) else { continue };
        let before = topology(&model);
        let length = mean_length(&model);
        let patch = patch_of(&model, &all(&model), RemeshTarget::Length(length));
        assert_blends(&model, &patch);
        let now = after(&model, &patch);
        let t = topology(&now);
        assert_eq!(kind(&t), kind(&before), "{name}");
        assert!(
            (area(&model) - area(&now)).abs() <= 0.05 * area(&model),
            "{name}: {} {}",
            area(&model),
            area(&now)
        );
        let share = |m: &Model| {
            let bad = all(m).into_iter().filter(|&t| aspect(corners(m, t)) > MENDED).count();
            bad as f64 / m.triangles.len() as f64
        };
        assert!(
            share(&now) <= share(&model).max(0.002),
            "{name}: {} of the triangles were bad, {} are",
            share(&model),
            share(&now)
        );
    }
}

#[test]
fn refusals_name_the_argument_and_what_is_allowed() {
    let model = Model::of(sphere(2, 1.0));
    let faces = all(&model);
    let subject =
        |faces: &[u32], target: RemeshTarget| match remesh_region(&model.surface(), faces, &target.into(), &Silent) {
            Err(Error::Invalid { field, .. }) => field,
            other => panic!("{other:?}"),
        };
    for length in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(subject(&faces, RemeshTarget::Length(length)), "remesh.edgeLength");
    }
    assert_eq!(subject(&faces, RemeshTarget::Auto { rest: &[] }), "remesh.auto");
    assert_eq!(subject(&[], RemeshTarget::Length(1.0)), "region");
    assert_eq!(subject(&[3, 3], RemeshTarget::Length(1.0)), "region");
    assert_eq!(subject(&[1_000_000], RemeshTarget::Length(1.0)), "region");
    let tiny = remesh_region(&model.surface(), &faces, &RemeshTarget::Length(1e-12).into(), &Silent);
    assert!(matches!(tiny, Err(Error::TooLarge { .. })), "{tiny:?}");
    let flag = CancelFlag::default();
    flag.cancel();
    assert_eq!(
        remesh_region(&model.surface(), &faces, &RemeshTarget::Length(0.1).into(), &flag),
        Err(Error::Cancelled)
    );
}
