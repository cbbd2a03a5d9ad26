//! Handles that turn by half a circle and more.

use super::scene::*;
use crate::support::bench::largest_distance;
use glam::{DQuat, DVec3};
use pliant::deform::{FirstPass, Transform};
use proptest::prelude::*;

/// Longest edge over its length at rest.
fn stretch(scene: &Scene, positions: &[DVec3]) -> f64 {
    let edges = scene
        .shape
        .1
        .iter()
        .flat_map(|t| (0..3).map(|k| (t[k] as usize, t[(k + 1) % 3] as usize)));
    edges
        .map(|(a, b)| positions[a].distance(positions[b]) / scene.shape.0[a].distance(scene.shape.0[b]))
        .fold(0.0, f64::max)
}

#[test]
fn twists_of_several_turns_have_no_tears() {
    let scene = Scene::bar();
    for degrees in [540.0, 1080.0f64] {
        let angle = degrees.to_radians();
        let even: Vec<DVec3> = scene
            .shape
            .0
            .iter()
            .map(|p| DQuat::from_rotation_z(angle * ((p.z - 0.25) / 3.5).clamp(0.0, 1.0)) * *p)
            .collect();
        let bound = 1.5 * stretch(&scene, &even);
        let transforms = [Transform::IDENTITY, turn_about(DVec3::Z * angle, DVec3::ZERO)];
        for first_pass in [FirstPass::Harmonic, FirstPass::Diffusion] {
            let solution = scene.solve(Way::Graph(first_pass), &transforms, 1e-6);
            let seen = stretch(&scene, &solution.positions);
            assert!(
                seen < bound,
                "{degrees}°, {first_pass:?}: an edge has {seen} times its length, {bound} allowed"
            );
            // It is twisted all the way, and not by what is left of the angle without whole turns.
            for (frame, u) in solution.frames.iter().zip(scene.rig.rotation_fields().of(1)) {
                let expected = DQuat::from_rotation_z(angle * f64::from(*u));
                assert!(
                    angle_between(rotation_in(frame), expected) < 1e-3,
                    "{degrees}°, {first_pass:?} at {u}"
                );
            }
        }
    }
}

/// One end of the bar is twisted several times while others bend it: no edge between them is torn.
#[test]
fn twists_of_several_turns_go_with_bends_of_other_handles() {
    let scene = Scene::many();
    for degrees in [540.0, 1080.0f64] {
        let mut transforms = scene.turned(1.0);
        transforms[1].rotation = DVec3::new(0.0, 0.1, 1.0).normalize() * degrees.to_radians();
        let positions = scene
            .solve(Way::Graph(FirstPass::Harmonic), &transforms, 1e-6)
            .positions;
        // Between the last side handle and the end there are 0.6 of 4 for all the turns: an even helix stretches edges to
        // √(1 + (√½ · θ / 0.6)²) of their length.
        let bound = 1.5 * (1.0 + 0.5 * (degrees.to_radians() / 0.6).powi(2)).sqrt();
        let seen = stretch(&scene, &positions);
        assert!(
            seen < bound,
            "{degrees}°: an edge has {seen} times its length, {bound} allowed"
        );
    }
}

fn axis() -> impl Strategy<Value = DVec3> {
    [-1.0..1.0f64, -1.0..1.0, -1.0..1.0]
        .prop_map(DVec3::from_array)
        .prop_filter_map("too short for an axis", |v| {
            (0.1..1.0).contains(&v.length()).then(|| v.normalize())
        })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    /// A handle is dragged from 179.9° to 180.1° (and over a full turn, and one and a half) while four others are turned
    /// any way they like: the result moves a little, too.
    #[test]
    fn a_drag_through_half_a_turn_does_not_jump(
        about in axis(),
        others in [axis(), axis(), axis()],
        angles in [0.0..3.0f64, 0.0..3.0, 0.0..5.0],
        degrees in prop::sample::select(vec![126.0, 134.9, 161.0, 170.9, 179.9, 359.9, 539.9]),
        first_pass in prop::sample::select(vec![FirstPass::Harmonic, FirstPass::Diffusion]),
    ) {
        thread_local! {
            static SCENE: Scene = Scene::many();
        }
        SCENE.with(|scene| {
            let at = |degrees: f64| {
                let mut transforms = scene.turned(1.0);
                transforms[1].rotation = about * degrees.to_radians();
                for k in 0..3 {
                    transforms[k + 2].rotation = others[k] * angles[k];
                }
                scene.solve(Way::Graph(first_pass), &transforms, 1e-7).positions
            };
            let jump = largest_distance(&at(degrees), &at(degrees + 0.2)) / scene.body.diagonal;
            // The handle's own vertices move by 0.0006 of the diagonal.
            prop_assert!(jump < 0.02, "a vertex jumps by {jump} of the diagonal");
            Ok(())
        })?;
    }
}
