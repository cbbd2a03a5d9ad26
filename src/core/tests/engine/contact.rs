//! Commits that keep surfaces from crossing.

use crate::surface_files::file_of_parts;
use glam::{DQuat, DVec3};
use pliant_core::asset::{FileSet, shapes};
use pliant_core::engine::{
    Contact, Deformer, DeformerLimits, Handle, HandlePose, HandleRotation, ModelShape, OpenOptions, Region,
    SolveSettings,
};
use pliant_core::exec::Exec;
use pliant_core::mesh::PairKind;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

const AVOIDED: Contact = Contact::Avoided { clearance: None };

/// A closed tube along z from 0 to 4.
fn tube(around: usize, along: usize) -> FileSet {
    file_of_parts(&[(&shapes::cylinder(0.5, 4.0, around, along, true), DVec3::ZERO)])
}

/// Two parts, of which handles hold a region each.
fn two_parts(parts: &[(&shapes::Shape, DVec3); 2], held: [Region; 2], exec: &Exec<'_>) -> Deformer {
    let mut options = OpenOptions::default();
    options.body.ties = None;
    let mut deformer =
        Deformer::open(file_of_parts(parts), &options, &DeformerLimits::default(), exec).expect("a model");
    let [still, pushed] = held;
    let handles = [Handle::new("still", still), Handle::new("pushed", pushed)];
    deformer.set_handles(handles.to_vec(), exec).expect("right handles");
    deformer
}

/// Moves what the second handle of two parts holds.
fn pushed(deformer: &mut Deformer, by: DVec3, contact: Contact, exec: &Exec<'_>) -> ModelShape {
    let settings = SolveSettings {
        contact,
        ..SolveSettings::default()
    };
    let pose = HandlePose::translation(by.to_array());
    deformer.commit([("pushed", pose)], &settings, exec).expect("a shape")
}

/// A tube of which handles hold both ends, up to `held` from each.
fn held_tube(held: f64, exec: &Exec<'_>) -> Deformer {
    with_ends_held(tube(24, 48), held, exec)
}

fn with_ends_held(tube: FileSet, held: f64, exec: &Exec<'_>) -> Deformer {
    let mut deformer =
        Deformer::open(tube, &OpenOptions::default(), &DeformerLimits::default(), exec).expect("a model");
    let ends = [
        Handle::new("bottom", Region::half_space([0.0, 0.0, -1.0], 1e-6 - held)),
        Handle::new("top", Region::half_space([0.0, 0.0, 1.0], 4.0 - held + 1e-6)),
    ];
    deformer.set_handles(ends.to_vec(), exec).expect("right handles");
    deformer
}

/// Bends the tube.
fn bent(deformer: &mut Deformer, degrees: f64, contact: Contact, exec: &Exec<'_>) -> ModelShape {
    let pose = HandlePose {
        rotation: Some(HandleRotation::Vector(DVec3::X * degrees.to_radians())),
        ..HandlePose::default()
    };
    let settings = SolveSettings {
        contact,
        ..SolveSettings::default()
    };
    deformer.commit([("top", pose)], &settings, exec).expect("a shape")
}

fn new_pairs(deformer: &Deformer, shape: &ModelShape, exec: &Exec<'_>) -> u64 {
    deformer
        .crossing_pairs(&shape.positions, 0, exec)
        .expect("no cancel")
        .new
}

fn volume(deformer: &Deformer, shape: &ModelShape, exec: &Exec<'_>) -> f64 {
    deformer
        .measure(&shape.positions, false, exec)
        .expect("no cancel")
        .volume_change
}

#[test]
fn a_bent_tube_crosses_itself_without_and_not_with() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = held_tube(1.0, &exec);
    for degrees in [130.0, 140.0, 150.0] {
        let without = bent(&mut deformer, degrees, Contact::Ignored, &exec);
        let with = bent(&mut deformer, degrees, AVOIDED, &exec);
        assert!(new_pairs(&deformer, &without, &exec) > 20, "{degrees} degrees");
        assert_eq!(new_pairs(&deformer, &with, &exec), 0, "{degrees} degrees");
        let lost = (volume(&deformer, &with, &exec) - volume(&deformer, &without, &exec)).abs();
        assert!(lost < 0.06, "{degrees} degrees: {lost}");
        // What handles hold is where it was, and so is all that is far from the crease.
        let is_far = |z: f64| !(1.0..=3.0).contains(&z);
        for (v, rest) in deformer.rest().iter().enumerate().filter(|(_, rest)| is_far(rest.z)) {
            assert_eq!(without.positions[v], with.positions[v], "{rest}");
        }
        let settings = SolveSettings {
            contact: AVOIDED,
            ..SolveSettings::default()
        };
        let warnings = deformer
            .shape_warnings(&with.positions, &deformer.initial_poses(), &settings, &exec)
            .expect("no cancel");
        let left = warnings.iter().filter(|w| !w.message.contains("handles hold wholly"));
        assert_eq!(left.count(), 0, "{warnings:?}");
    }
}

#[test]
fn a_tube_that_is_folded_flat_is_parted_on_the_way_there() {
    let shapes = [1, 4].map(|threads| {
        let pool = Pool::new(threads).expect("threads");
        let exec = Exec::new(&pool, &Silent);
        let mut deformer = with_ends_held(tube(16, 64), 1.0, &exec);
        // Another pose before it does not matter.
        bent(&mut deformer, 30.0 * threads as f64, Contact::Ignored, &exec);
        let [without, with] = [Contact::Ignored, AVOIDED].map(|contact| bent(&mut deformer, 165.0, contact, &exec));
        assert!(new_pairs(&deformer, &without, &exec) > 200);
        assert_eq!(new_pairs(&deformer, &with, &exec), 0);
        // Poses that were solved on the way leave nothing.
        let again = bent(&mut deformer, 165.0, Contact::Ignored, &exec);
        assert_eq!(without.positions, again.positions);
        with.positions
    });
    assert_eq!(shapes[0], shapes[1]);
}

#[test]
fn what_does_not_cross_keeps_its_bits() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = held_tube(1.0, &exec);
    let [without, with] = [Contact::Ignored, AVOIDED].map(|contact| bent(&mut deformer, 100.0, contact, &exec));
    assert_eq!(new_pairs(&deformer, &without, &exec), 0);
    assert_eq!(without.positions, with.positions);
}

#[test]
fn the_same_pose_has_the_same_bits_for_any_number_of_threads() {
    let shapes = [1, 2, 5].map(|threads| {
        let pool = Pool::new(threads).expect("threads");
        let exec = Exec::new(&pool, &Silent);
        let mut deformer = held_tube(1.0, &exec);
        // Another pose before it does not matter.
        bent(&mut deformer, 30.0 * threads as f64, AVOIDED, &exec);
        bent(&mut deformer, 150.0, AVOIDED, &exec).positions
    });
    assert!(shapes.iter().all(|shape| *shape == shapes[0]));
}

#[test]
fn balls_that_are_pressed_together_flatten_each_other() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let ball = shapes::icosphere(1.0, 3);
    let turned: Vec<DVec3> = ball.0.iter().map(|p| DQuat::from_rotation_z(0.7) * *p).collect();
    let other = (turned, ball.1.clone());
    let halves = [
        Region::half_space([-1.0, 0.0, 0.0], 0.3),
        Region::half_space([1.0, 0.0, 0.0], 3.3),
    ];
    let mut deformer = two_parts(&[(&ball, DVec3::ZERO), (&other, DVec3::X * 3.0)], halves, &exec);
    for deep in [0.05, 0.1, 0.2] {
        let by = DVec3::NEG_X * (1.0 + deep);
        let [without, with] = [Contact::Ignored, AVOIDED].map(|contact| pushed(&mut deformer, by, contact, &exec));
        assert!(new_pairs(&deformer, &without, &exec) > 20, "{deep}");
        assert_eq!(new_pairs(&deformer, &with, &exec), 0, "{deep}");
        // Half of the way on each side.
        let ends = with.positions.split_at(ball.0.len());
        let most = ends.0.iter().map(|p| p.x).fold(f64::MIN, f64::max);
        let least = ends.1.iter().map(|p| p.x).fold(f64::MAX, f64::min);
        let middle = 1.0 - deep / 2.0;
        assert!(
            (most - middle).abs() < 0.4 * deep && (least - middle).abs() < 0.4 * deep,
            "{deep}: {most} {least}"
        );
    }
}

#[test]
fn an_open_sheet_gives_way_to_a_ball_from_either_side() {
    let ball = shapes::icosphere(0.4, 3);
    let sheet = shapes::grid(2.0, 2.0, [24, 24]);
    let middle = DVec3::new(1.0, 0.0, 1.0);
    let is_border = |p: &DVec3| (*p - middle).abs().max_element() > 0.95;
    let border: Vec<u32> = (0u32..)
        .zip(&sheet.0)
        .filter(|(_, p)| is_border(p))
        .map(|(v, _)| v)
        .collect();
    let first = sheet.0.len() as u32;
    let list = |indices: Vec<u32>| Region::Vertices {
        indices,
        ranges: Vec::new(),
    };
    for side in [1.0, -1.0] {
        let shapes = [1, 4].map(|threads| {
            let pool = Pool::new(threads).expect("threads");
            let exec = Exec::new(&pool, &Silent);
            let whole = (first..first + ball.0.len() as u32).collect();
            let parts = [(&sheet, DVec3::ZERO), (&ball, middle + DVec3::new(0.03, side, 0.02))];
            let mut deformer = two_parts(&parts, [list(border.clone()), list(whole)], &exec);
            let by = DVec3::Y * (-0.8 * side);
            let [without, with] = [Contact::Ignored, AVOIDED].map(|contact| pushed(&mut deformer, by, contact, &exec));
            assert!(new_pairs(&deformer, &without, &exec) > 50, "from {side}");
            assert_eq!(new_pairs(&deformer, &with, &exec), 0, "from {side}");
            with.positions
        });
        assert_eq!(shapes[0], shapes[1]);
        // The sheet has gone before the ball, not behind it.
        let height = |p: &DVec3| p.y * side;
        let lowest = shapes[0][..first as usize].iter().map(height).fold(f64::MAX, f64::min);
        assert!(lowest < -0.18, "from {side}: {lowest}");
        let highest = shapes[0][..first as usize].iter().map(height).fold(f64::MIN, f64::max);
        assert!(highest < 0.1, "from {side}: {highest}");
    }
}

#[test]
fn what_handles_push_through_each_other_is_told() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = held_tube(1.8, &exec);
    let [without, with] = [Contact::Ignored, AVOIDED].map(|contact| bent(&mut deformer, 150.0, contact, &exec));
    let pairs = |shape: &ModelShape| {
        deformer
            .crossing_pairs(&shape.positions, 1000, &exec)
            .expect("no cancel")
    };
    let (before, after) = (pairs(&without), pairs(&with));
    assert!(
        after.held > 0 && after.held == before.held && after.new <= before.new,
        "{} {}",
        before.new,
        after.new
    );
    let held = after
        .pairs
        .iter()
        .find(|pair| pair.kind == PairKind::Held)
        .expect("a pair");
    let settings = SolveSettings {
        contact: AVOIDED,
        ..SolveSettings::default()
    };
    let warnings = deformer
        .shape_warnings(&with.positions, &deformer.initial_poses(), &settings, &exec)
        .expect("no cancel");
    let about_held = warnings
        .iter()
        .find(|w| w.message.contains("handles hold wholly"))
        .expect("a warning");
    assert!(about_held.code == "contact-left" && about_held.message.starts_with(&after.held.to_string()));
    let place = format!("{:?}", about_held.place);
    assert!(
        place.contains(&format!("{} and {}", held.triangles[0], held.triangles[1])),
        "{place}"
    );
}
