//! Laws of weights for the bones of a rig.

use glam::{DQuat, DVec3};
use pliant_core::asset::shapes;
use pliant_core::exec::Exec;
use pliant_core::motion::BoneInfluences;
use pliant_core::motion::skin_weights::{SkinBone, SkinWeightError, SkinWeightOptions, skin_weights};
use pliant_core::pool::Pool;
use pliant_core::progress::{CancelFlag, Silent};

/// Few cells, so that tests are quick.
fn coarse() -> SkinWeightOptions {
    SkinWeightOptions {
        cells: 1 << 15,
        ..SkinWeightOptions::default()
    }
}

fn weights(positions: &[DVec3], triangles: &[[u32; 3]], bones: &[SkinBone], threads: usize) -> Vec<BoneInfluences> {
    let pool = Pool::new(threads).expect("threads");
    skin_weights(positions, triangles, bones, &coarse(), &Exec::new(&pool, &Silent)).expect("weights")
}

fn assert_all_weighted(found: &[BoneInfluences]) {
    for vertex in found {
        assert!((vertex.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(vertex.weights.iter().all(|w| *w >= 0.0));
    }
}

fn weight_of(vertex: &BoneInfluences, bone: usize) -> f64 {
    vertex.iter().find(|i| i.0 == bone).map_or(0.0, |i| i.1)
}

/// Bones one after the other, each on the one before.
fn chain(ends: impl IntoIterator<Item = [DVec3; 2]>) -> Vec<SkinBone> {
    let bones = ends.into_iter().enumerate().map(|(k, ends)| SkinBone {
        ends,
        parent: k.checked_sub(1),
    });
    bones.collect()
}

/// A bar of 6 by 1 by 1 and three bones along it.
fn bar() -> (Vec<DVec3>, Vec<[u32; 3]>, Vec<SkinBone>) {
    let (mut positions, triangles) = shapes::box_with_cells(DVec3::new(6.0, 1.0, 1.0), [30, 5, 5]);
    positions.iter_mut().for_each(|p| *p -= DVec3::new(0.0, 0.5, 0.5));
    let bones = (0..3).map(|k| [DVec3::X * (2.0 * f64::from(k)), DVec3::X * (2.0 * f64::from(k) + 2.0)]);
    (positions, triangles, chain(bones))
}

#[test]
fn weights_pass_from_bone_to_bone_along_a_bar() {
    let (positions, triangles, bones) = bar();
    let found = weights(&positions, &triangles, &bones, 2);
    assert_all_weighted(&found);
    for (p, vertex) in positions.iter().zip(&found) {
        let middle = (0..3).find(|k| (p.x - (2.0 * f64::from(*k) + 1.0)).abs() < 0.3);
        if let Some(bone) = middle {
            assert!(weight_of(vertex, bone as usize) > 0.7, "{p}");
        }
        if (p.x - 2.0).abs() < 1e-9 {
            assert!((weight_of(vertex, 0) - weight_of(vertex, 1)).abs() < 0.1, "{p}");
        }
    }
    // Along an edge of the bar the first bone's weight only falls.
    let mut edge: Vec<(f64, f64)> = (positions.iter().zip(&found))
        .filter(|(p, _)| (p.y + 0.5).abs() < 1e-9 && (p.z + 0.5).abs() < 1e-9)
        .map(|(p, v)| (p.x, weight_of(v, 0)))
        .collect();
    edge.sort_by(|a, b| a.0.total_cmp(&b.0));
    assert!(edge.len() > 20 && edge.windows(2).all(|w| w[1].1 <= w[0].1 + 1e-3));
}

#[test]
fn soups_open_surfaces_and_lone_points_are_weighted_too() {
    let (grid, sheet) = shapes::grid(6.0, 1.0, [60, 10]);
    // Every triangle of the sheet a part of its own, apart from its neighbours and of any orientation.
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for (k, t) in sheet.iter().enumerate() {
        let first = positions.len() as u32;
        let lift = DVec3::Z * (0.02 * (k % 3) as f64);
        positions.extend(t.map(|v| grid[v as usize] + lift));
        let turned = if k % 2 == 0 {
            [first, first + 1, first + 2]
        } else {
            [first + 1, first, first + 2]
        };
        triangles.push(turned);
    }
    positions.extend([DVec3::new(3.0, 40.0, 0.0), DVec3::new(-9.0, 0.0, 3.0)]);
    let bones = chain([[DVec3::ZERO, DVec3::X * 3.0], [DVec3::X * 3.0, DVec3::X * 6.0]]);
    let found = weights(&positions, &triangles, &bones, 2);
    assert_eq!(found.len(), positions.len());
    assert_all_weighted(&found);
    let whole = weights(&grid, &sheet, &bones, 2);
    assert_all_weighted(&whole);
    let low = grid.iter().map(|p| p.x).fold(f64::INFINITY, f64::min);
    let high = grid.iter().map(|p| p.x).fold(f64::NEG_INFINITY, f64::max);
    assert!(high > low);
    let heat = |p: f64| {
        whole
            .iter()
            .zip(&grid)
            .filter(|(_, g)| (g.x - p).abs() < 1e-9)
            .all(|(v, _)| v.weights[0] > 0.5)
    };
    assert!(heat(low) && heat(high));
}

#[test]
fn threads_change_no_bit() {
    let (positions, triangles, bones) = bar();
    assert_eq!(
        weights(&positions, &triangles, &bones, 1),
        weights(&positions, &triangles, &bones, 3)
    );
}

#[test]
fn a_scene_that_is_turned_moved_and_scaled_has_the_same_weights() {
    let (positions, triangles, bones) = bar();
    let here = weights(&positions, &triangles, &bones, 2);
    let turn = DQuat::from_xyzw(0.5, 0.5, 0.5, 0.5);
    let carry = |p: DVec3| turn * p * 40.0 + DVec3::new(7.0, -300.0, 12.0);
    let moved: Vec<DVec3> = positions.iter().map(|p| carry(*p)).collect();
    let carried = chain(bones.iter().map(|b| b.ends.map(carry)));
    let there = weights(&moved, &triangles, &carried, 2);
    for (a, b) in here.iter().zip(&there) {
        for bone in 0..3 {
            let (a, b) = (weight_of(a, bone), weight_of(b, bone));
            assert!((a - b).abs() < 1e-3, "{a} against {b}");
        }
    }
}

#[test]
fn many_bones_are_solved_in_groups_without_a_seam() {
    let (positions, triangles, _) = bar();
    let bones = chain((0..60).map(|k| [DVec3::X * (0.1 * f64::from(k)), DVec3::X * (0.1 * f64::from(k) + 0.1)]));
    let found = weights(&positions, &triangles, &bones, 2);
    assert_all_weighted(&found);
    for (p, vertex) in positions.iter().zip(&found).filter(|(p, _)| p.x > 0.5 && p.x < 5.5) {
        let mean: f64 = vertex.iter().map(|(b, w)| w * (0.1 * b as f64 + 0.05)).sum();
        assert!((mean - p.x).abs() < 0.3, "{p}: {mean}");
    }
}

#[test]
fn degenerate_meshes_and_bones_are_bound() {
    let at = chain([[DVec3::ZERO; 2]]);
    assert_eq!(weights(&[DVec3::ONE], &[], &at, 1), [BoneInfluences::one(0)]);
    let same = weights(&[DVec3::ONE; 5], &[[0, 1, 2], [4, 4, 4]], &at, 1);
    assert!(same.iter().all(|v| *v == BoneInfluences::one(0)));
    // Two bones that are one share.
    let (positions, triangles, bones) = bar();
    let twice = weights(&positions, &triangles, &chain([bones[0].ends; 2]), 2);
    assert!(twice.iter().all(|v| (weight_of(v, 0) - 0.5).abs() < 1e-3));
}

#[test]
fn what_cannot_be_is_refused_with_what_may() {
    let (positions, triangles, bones) = bar();
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let refused = |p: &[DVec3], t: &[[u32; 3]], b: &[SkinBone], o: &SkinWeightOptions| {
        skin_weights(p, t, b, o, &exec).expect_err("refused").to_string()
    };
    let usual = coarse();
    assert_eq!(
        refused(&[], &[], &bones, &usual),
        "the mesh: has no vertex, at least one is needed"
    );
    assert_eq!(
        refused(&[DVec3::ZERO, DVec3::NAN], &[], &bones, &usual),
        "vertex 1: is not a point of finite numbers"
    );
    assert_eq!(
        refused(&[DVec3::ZERO], &[[0, 0, 1]], &bones, &usual),
        "triangle 0: names a vertex that is not there, there are 1"
    );
    assert_eq!(
        refused(&positions, &triangles, &[], &usual),
        "bones: are 0, allowed are 1 to 4096"
    );
    let nowhere = chain([[DVec3::ZERO, DVec3::INFINITY]]);
    assert_eq!(
        refused(&positions, &triangles, &nowhere, &usual),
        "bone 0: has an end that is not a point of finite numbers"
    );
    let circle = [SkinBone {
        parent: Some(0),
        ..bones[0]
    }];
    assert_eq!(
        refused(&positions, &triangles, &circle, &usual),
        "bone 0: has a parent that does not come before it; parents come first"
    );
    let with = |change: fn(&mut SkinWeightOptions)| {
        let mut options = coarse();
        change(&mut options);
        refused(&positions, &triangles, &bones, &options)
    };
    assert_eq!(with(|o| o.influences = 9), "influences: are 9, allowed are 1 to 8");
    assert_eq!(with(|o| o.cells = 8), "cells: are 8, allowed are 512 to 67108864");
    assert_eq!(
        with(|o| o.stiffness = 0.0),
        "stiffness: is 0, a number above 0 is needed"
    );
}

#[test]
fn cancelled_work_ends() {
    let (positions, triangles, bones) = bar();
    let pool = Pool::new(1).expect("a thread");
    let flag = CancelFlag::default();
    flag.cancel();
    let ended = skin_weights(&positions, &triangles, &bones, &coarse(), &Exec::new(&pool, &flag));
    assert!(matches!(ended, Err(SkinWeightError::Cancelled(_))));
}
