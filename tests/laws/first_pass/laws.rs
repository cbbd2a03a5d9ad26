//! What every way of spreading rotations owes: rest stays rest, the scene may be turned, threads change no bit.

use super::scene::*;
use crate::support::bench::largest_distance;
use glam::{DQuat, DVec3};
use pliant::deform::{FirstPass, SolveStart, SolveState, Transform, exp_rotation};

#[test]
fn at_rest_every_way_returns_the_bits_of_the_model() {
    let scene = Scene::many();
    let mut state = SolveState::default();
    for way in WAYS {
        let still = vec![Transform::IDENTITY; 5];
        let solution = scene.solve_in(&mut state, SolveStart::Warm, way, &still, 1e-4);
        assert_eq!(solution.positions, scene.body.graph.positions, "{way:?}");
        scene.solve_in(&mut state, SolveStart::Warm, way, &scene.turned(1.0), 1e-4);
        let back = scene.solve_in(&mut state, SolveStart::Warm, way, &still, 1e-4);
        assert_eq!(back.positions, scene.body.graph.positions, "{way:?}, after a drag");
    }
}

#[test]
fn no_way_depends_on_threads() {
    let solve = |threads: usize| {
        let many = Scene::many_placed(DQuat::IDENTITY, DVec3::ZERO, threads);
        let bar = Scene::bar_on(threads);
        let transforms = [Transform::IDENTITY, turn_about(DVec3::new(0.4, 1.0, 2.0), DVec3::ZERO)];
        WAYS.map(|way| {
            let (a, b) = (
                many.solve(way, &many.turned(1.0), 1e-5),
                bar.solve(way, &transforms, 1e-5),
            );
            (a.positions, a.frames, b.positions, b.frames)
        })
    };
    let one = solve(1);
    for threads in [2, 3] {
        assert!(one == solve(threads), "{threads} threads give other bits than one");
    }
}

#[test]
fn turning_the_scene_turns_every_result() {
    let turn = exp_rotation(DVec3::new(0.5, -1.1, 0.8));
    let shift = DVec3::new(3.0, 1.0, -2.0);
    let place = |p: DVec3| turn * p + shift;
    let (plain, turned) = (Scene::many(), Scene::many_placed(turn, shift, 2));
    for size in [1.0, 3.0] {
        let transforms = plain.turned(size);
        let placed: Vec<Transform> = transforms
            .iter()
            .map(|t| Transform {
                rotation: turn * t.rotation,
                translation: turn * t.translation,
                pivot: place(t.pivot),
                ..*t
            })
            .collect();
        for way in WAYS {
            let expected: Vec<DVec3> = plain
                .solve(way, &transforms, 1e-8)
                .positions
                .iter()
                .map(|p| place(*p))
                .collect();
            let seen = turned.solve(way, &placed, 1e-8).positions;
            let far = largest_distance(&seen, &expected) / plain.body.diagonal;
            assert!(far < 3e-5, "{way:?}, turned by {size} times as much: off by {far:e}");
        }
    }
}

#[test]
fn a_rigid_motion_of_all_handles_moves_everything_rigidly() {
    let scene = Scene::many();
    let motion = Transform {
        translation: DVec3::new(0.3, 2.0, -1.0),
        rotation: DVec3::new(1.4, -0.7, 0.5),
        pivot: DVec3::new(0.2, 0.0, 2.0),
        ..Transform::IDENTITY
    };
    let expected: Vec<DVec3> = scene.shape.0.iter().map(|p| motion.map()(*p)).collect();
    for way in WAYS {
        let seen = scene.solve(way, &[motion; 5], 1e-7).positions;
        let far = largest_distance(&seen, &expected) / scene.body.diagonal;
        assert!(far < 1e-5, "{way:?}: off by {far:e}");
    }
}

/// A drag may change from one way to another; nothing is left of the way before.
#[test]
fn ways_can_be_changed_during_a_drag() {
    let scene = Scene::many();
    let mut state = SolveState::default();
    let transforms = scene.turned(1.0);
    for way in WAYS.into_iter().chain(WAYS) {
        let near = scene.turned(0.97);
        scene.solve_in(&mut state, SolveStart::Warm, way, &near, 1e-7);
        let other = Way::Graph(FirstPass::Harmonic);
        let warm = scene
            .solve_in(&mut state, SolveStart::Warm, other, &transforms, 1e-7)
            .positions;
        let fresh = scene.solve(other, &transforms, 1e-7).positions;
        let far = largest_distance(&warm, &fresh) / scene.body.diagonal;
        assert!(far < 1e-4, "after {way:?}: {far:e}");
    }
}
