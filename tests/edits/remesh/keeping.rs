//! What a remesh keeps: thin limbs, sharp edges, fair triangles, and a distance to the old surface that it was given.

use super::edit_support::*;
use super::measures::*;
use glam::DVec3;
use pliant::edit::{DEVIATION, RemeshOptions, RemeshTarget, SurfacePatch, remesh_region};
use pliant::progress::Silent;
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

fn remeshed(model: &Model, options: &RemeshOptions<'_>) -> (Model, SurfacePatch) {
    let done = remesh_region(&model.surface(), &all(model), options, &Silent).expect("remeshes");
    assert_blends(model, &done);
    (after(model, &done), done)
}

fn auto(model: &Model) -> (Model, SurfacePatch) {
    remeshed(model, &RemeshTarget::Auto { rest: &model.positions }.into())
}

/// A limb of `around` sides that gets thinner, on which triangles are many times longer than wide.
fn limb(around: u32, rings: u32, radius: f64) -> Model {
    let mut positions = Vec::new();
    for ring in 0..=rings {
        let along = f64::from(ring) / f64::from(rings);
        let r = radius * (1.0 - 0.9 * along);
        for i in 0..around {
            let angle = (f64::from(i) + 0.3 * f64::from(ring)) / f64::from(around) * TAU;
            positions.push(DVec3::new(r * angle.cos(), r * angle.sin(), 4.0 * along));
        }
    }
    let (low, high) = (positions.len() as u32, positions.len() as u32 + 1);
    positions.extend([DVec3::ZERO, DVec3::Z * 4.0]);
    let id = |ring: u32, i: u32| ring * around + i % around;
    let mut triangles = Vec::new();
    for i in 0..around {
        for ring in 0..rings {
            let [a, b, c, d] = [id(ring, i), id(ring, i + 1), id(ring + 1, i + 1), id(ring + 1, i)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
        triangles.extend([[low, id(0, i + 1), id(0, i)], [high, id(rings, i), id(rings, i + 1)]]);
    }
    Model::of((positions, triangles))
}

fn diagonal(model: &Model) -> f64 {
    let (low, high) = bounds(&model.positions);
    high.distance(low)
}

/// The part of all triangles that are further than `most` from equilateral.
fn share_worse_than(model: &Model, most: f64) -> f64 {
    let bad = all(model)
        .into_iter()
        .filter(|&t| aspect(corners(model, t)) > most)
        .count();
    bad as f64 / model.triangles.len() as f64
}

/// The summed length of the edges at which triangles make more than 40°.
fn sharp_length(model: &Model) -> f64 {
    let mut sides: BTreeMap<[u32; 2], (f64, Vec<DVec3>)> = BTreeMap::new();
    for t in all(model) {
        let (p, c) = (
            model.triangles[t as usize].map(|v| model.point_of[v as usize]),
            corners(model, t),
        );
        for i in 0..3 {
            let (a, b) = (p[i], p[(i + 1) % 3]);
            let side = sides.entry([a.min(b), a.max(b)]).or_default();
            side.0 = c[i].distance(c[(i + 1) % 3]);
            side.1.push((c[1] - c[0]).cross(c[2] - c[0]).normalize_or_zero());
        }
    }
    let cosine = 40f64.to_radians().cos();
    let sharp = sides.values().filter(|(_, n)| n.len() == 2 && n[0].dot(n[1]) < cosine);
    sharp.map(|(length, _)| length).sum()
}

#[test]
fn a_thin_limb_stays_as_thick_as_it_is_and_its_triangles_get_fair() {
    for around in [8, 12, 20] {
        let model = limb(around, 10, 0.3);
        let (now, done) = auto(&model);
        let size = diagonal(&model);
        let t = topology(&now);
        assert!(t.is_closed() && t.euler == 2, "{t:?}");
        assert!(
            done.deviation > 0.0 && done.deviation <= DEVIATION * size,
            "{}",
            done.deviation
        );
        let apart = distance_between(&model, &now);
        assert!(apart <= DEVIATION * size, "{around}: {apart} of {size}");
        let kept = volume(&now) / volume(&model);
        assert!((kept - 1.0).abs() < 5e-3, "{around}: volume × {kept}");
        let (before, then) = (share_worse_than(&model, 4.0), share_worse_than(&now, 4.0));
        assert!(before > 0.1 && then < 0.25 * before, "{around}: {before} became {then}");
    }
}

#[test]
fn a_length_longer_than_a_limb_is_thick_does_not_cut_it_off() {
    let model = limb(16, 40, 0.3);
    let options = RemeshOptions::from(RemeshTarget::Length(0.4));
    let (now, done) = remeshed(&model, &options);
    let apart = distance_between(&model, &now);
    // A fifth of the length is the default.
    assert!(apart <= 0.08 && done.deviation <= 0.08, "{apart} {}", done.deviation);
    assert!(now.triangles.len() < model.triangles.len());
    let top = |m: &Model| m.positions.iter().fold(0.0f64, |z, p| z.max(p.z));
    assert!((top(&now) - 4.0).abs() <= 0.08, "{}", top(&now));
    let narrow = RemeshOptions {
        max_deviation: Some(0.005),
        ..options
    };
    let (finer, _) = remeshed(&model, &narrow);
    assert!(distance_between(&model, &finer) <= 0.005);
    assert!(finer.triangles.len() > now.triangles.len());
}

#[test]
fn sharp_edges_stay_edges_and_the_angle_says_which_are_sharp() {
    let model = Model::of(cube(2));
    let before = sharp_length(&model);
    for length in [0.15, 0.4] {
        let (now, _) = remeshed(&model, &RemeshTarget::Length(length).into());
        assert!((sharp_length(&now) / before - 1.0).abs() < 1e-9, "{length}");
        // Corners are where they were.
        let has = |p: DVec3| now.positions.iter().any(|q| q.distance(p) < 1e-12);
        let sign = |bit: u32| f64::from(bit & 1) * 2.0 - 1.0;
        assert!((0..8).all(|k| has(DVec3::new(sign(k), sign(k >> 1), sign(k >> 2)))));
    }
    // Eight sides that meet at 45°: edges below 40°, curvature below 60°.
    let model = limb(8, 6, 0.5);
    let with = |sharp_degrees: f64| {
        let options = RemeshOptions {
            max_deviation: Some(0.05),
            sharp_degrees,
            ..RemeshTarget::Length(0.25).into()
        };
        sharp_length(&remeshed(&model, &options).0) / sharp_length(&model)
    };
    let (edges, curvature) = (with(40.0), with(60.0));
    assert!(edges > 0.9 && curvature < 0.8 * edges, "{edges} {curvature}");
}

#[test]
fn fair_triangles_stay_where_no_unfair_one_is_beside_them() {
    let mut model = Model::of(sphere(4, 1.0));
    // One place is squeezed to slivers.
    for p in &mut model.positions {
        if p.z > 0.9 {
            p.x *= 0.1;
        }
    }
    let (now, done) = auto(&model);
    assert!(share_worse_than(&now, 4.0) < 0.5 * share_worse_than(&model, 4.0));
    let far = |t: &u32| corners(&model, *t).iter().all(|p| p.z < 0.6);
    assert_eq!(done.removed.iter().filter(|t| far(t)).count(), 0);
}

/// Remeshes one of four shapes, and looks whether the result is closed and no farther from the shape than allowed.
fn stays_near(shape: usize, length: f64, allowed: f64, sharp: f64) -> Result<(), TestCaseError> {
    let model = match shape {
        0 => Model::of(sphere(3, 1.0)),
        1 => Model::of(torus(40, 16, 1.0, 0.3)),
        2 => limb(10, 12, 0.4),
        _ => with_seams(&Model::of(cube(3)), box_side, true),
    };
    let options = RemeshOptions {
        max_deviation: Some(allowed),
        sharp_degrees: sharp,
        ..RemeshTarget::Length(length).into()
    };
    let (now, done) = remeshed(&model, &options);
    prop_assert!(topology(&now).is_closed());
    prop_assert!(done.deviation <= allowed * (1.0 + 1e-12), "{}", done.deviation);
    let apart = distance_between(&model, &now);
    prop_assert!(apart <= allowed, "{} of {}", apart, allowed);
    Ok(())
}

#[test]
fn facets_that_a_new_edge_crosses_several_of_stay_near() {
    // A face between old edges that no place on the new ones saw.
    stays_near(2, 0.1, 0.003_672_000_748_226_951_7, 114.753_927_659_822_28).expect("near");
    stays_near(2, 0.1, 0.002_900_957_396_689_065, 89.936_156_658_208_38).expect("near");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_remesh_goes_farther_than_it_may(
        shape in 0..4usize,
        length in 0.1..0.8f64,
        allowed in 0.002..0.05f64,
        sharp in 20.0..120.0f64,
    ) {
        stays_near(shape, length, allowed, sharp)?;
    }
}

#[test]
fn animals_and_people_keep_their_limbs() {
    for name in ["camel.off.xz", "man.off.xz", "cow.off", "teapot.obj"] {
        let Some(model) = data(name) else { continue };
        let (now, done) = auto(&model);
        let size = diagonal(&model);
        assert_eq!(kind(&topology(&now)), kind(&topology(&model)), "{name}");
        assert!(
            done.deviation <= DEVIATION * size,
            "{name}: {} of {size}",
            done.deviation
        );
        let apart = distance_between(&model, &now);
        assert!(apart <= 2e-3 * size, "{name}: {apart} of {size}");
        let kept = volume(&now) / volume(&model);
        assert!((kept - 1.0).abs() < 5e-3, "{name}: volume × {kept}");
        let (before, then) = (share_worse_than(&model, 4.0), share_worse_than(&now, 4.0));
        assert!(then < 0.4 * before, "{name}: {before} became {then}");
    }
}
