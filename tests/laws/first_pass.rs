//! How rotations are spread from the handles, and the deformation of space that it is compared with.

mod scene;

use crate::support::bench::largest_distance;
use glam::{DMat3, DQuat, DVec3};
use pliant::asset::shapes;
use pliant::deform::{SolveStart, SolveState, Transform, exp_rotation};
use pliant::engine::Method;
use proptest::prelude::*;
use scene::*;

/// Paper figure 2: a bar between two handles. Harmonic fields and orientation diffusion spread a turn evenly, linear frames
/// pile it up half-way, and space knows nothing of the turn inside.
#[test]
fn on_a_twisted_bar_the_methods_order_as_in_figure_2() {
    let scene = Scene::bar();
    let angle = 135f64.to_radians();
    let ideal: Vec<DVec3> = scene
        .shape
        .0
        .iter()
        .map(|p| DQuat::from_rotation_z(angle * ((p.z - 0.25) / 3.5).clamp(0.0, 1.0)) * *p)
        .collect();
    let transforms = [Transform::IDENTITY, turn_about(DVec3::Z * angle, DVec3::ZERO)];
    let rms = |way| {
        let positions = scene.solve(way, &transforms, 1e-6).positions;
        rms(&positions[..ideal.len()], &ideal) / scene.body.diagonal
    };
    let [harmonic, diffusion, linear, space] = METHODS.map(rms);
    assert!(harmonic < 0.012, "{harmonic}");
    assert!((diffusion - harmonic).abs() < 1e-4, "{diffusion} beside {harmonic}");
    assert!(linear > 2.0 * harmonic, "{linear} beside {harmonic}");
    assert!(space > 2.0 * harmonic, "{space} beside {harmonic}");
}

/// The angle that linear frames reach at u is that of (1 − u) I + u R.
#[test]
fn linear_frames_turn_as_the_sum_of_matrices_does() {
    let scene = Scene::bar();
    let angle = 135f64.to_radians();
    let transforms = [Transform::IDENTITY, turn_about(DVec3::Z * angle, DVec3::ZERO)];
    let frames = scene.solve(Method::LinearFrames, &transforms, 1e-2).frames;
    let field = scene.rig.rotation_fields().of(1);
    for (i, u) in field.iter().enumerate() {
        let u = f64::from(*u);
        let expected = f64::atan2(u * angle.sin(), 1.0 - u + u * angle.cos());
        let turned = rotation_in(&frames[i]) * DVec3::X;
        let seen = f64::atan2(turned.y, turned.x);
        assert!((seen - expected).abs() < 1e-5, "{seen} at {u}, {expected} expected");
    }
}

/// Paper figure 3: one coil of a spring is pulled out. In space its neighbours come along, on the graph they stay.
#[test]
fn on_a_spring_only_space_drags_neighbouring_coils_along() {
    let (scene, neighbours) = Scene::spring();
    let pull = DVec3::X * 1.5;
    let mut transforms = [Transform::IDENTITY; 2];
    transforms[1].translation = pull;
    let follow = |way| {
        let positions = scene.solve(way, &transforms, 1e-6).positions;
        let moved = |i: &usize| (positions[*i] - scene.shape.0[*i]).dot(pull) / pull.length_squared();
        neighbours.iter().map(moved).sum::<f64>() / neighbours.len() as f64
    };
    let (graph, space) = (follow(Method::Harmonic), follow(Method::SpatialRbf));
    assert!(
        graph.abs() < 1e-6,
        "the neighbouring coils follow by {graph} on the graph"
    );
    assert!(space > 0.4, "the neighbouring coils follow by {space} in space");
}

/// Equation (2) in the rest pose: every quaternion is along the sum of its neighbours'.
#[test]
fn diffusion_comes_to_rest_where_the_blend_has_not() {
    let scene = Scene::many();
    let transforms = scene.turned(1.0);
    let worst = |first_pass| {
        let frames = scene.solve(first_pass, &transforms, 1e-2).frames;
        let q: Vec<DQuat> = frames.iter().map(rotation_in).collect();
        let graph = &scene.body.graph;
        let off = |i: usize| {
            let entries = graph.offsets[i] as usize..graph.offsets[i + 1] as usize;
            let weight = |e: usize| f64::from(graph.weights.as_ref().map_or(1.0, |w| w[e]));
            let sum = entries
                .map(|e| (q[graph.neighbours[e] as usize], weight(e)))
                .map(|(r, w)| if r.dot(q[i]) < 0.0 { r * -w } else { r * w })
                .fold(q[i] * 0.0, |s, r| s + r);
            // How far a relaxation by equation (2) would still turn it.
            2.0 * (sum.normalize() - q[i] * sum.normalize().dot(q[i])).length()
        };
        (0..q.len()).filter(|i| !scene.is_held(*i)).map(off).sum::<f64>()
    };
    let (blend, diffused) = (worst(Method::Harmonic), worst(Method::Diffusion));
    assert!(diffused < 0.2 * blend, "{diffused} left, {blend} by harmonic fields");
}

/// Section 2.1: "such an interpolated rotation is a good approximation".
#[test]
fn harmonic_fields_are_close_to_diffusion() {
    let scene = Scene::many();
    let transforms = scene.turned(1.0);
    let frames = |first_pass| scene.solve(first_pass, &transforms, 1e-2).frames;
    let (blend, diffused) = (frames(Method::Harmonic), frames(Method::Diffusion));
    let apart = |(a, b): (&[f32; 9], &[f32; 9])| angle_between(rotation_in(a), rotation_in(b)).to_degrees();
    let worst = blend.iter().zip(&diffused).map(apart).fold(0.0, f64::max);
    assert!(
        (0.05..10.0).contains(&worst),
        "{worst}° apart, with handles turned by up to 90°"
    );
}

/// An affine motion of all handles moves space affinely: the linear part takes it all.
#[test]
fn space_moves_affinely_with_its_handles() {
    for scene in [Scene::bar(), Scene::many(), Scene::sheet()] {
        let motion = Transform {
            translation: DVec3::new(1.0, -2.0, 0.5),
            rotation: DVec3::new(0.4, 2.0, -0.7),
            log_scale: DMat3::from_diagonal(DVec3::splat(0.3)),
            pivot: DVec3::ONE,
        };
        let solution = scene.solve(Method::SpatialRbf, &vec![motion; scene.rig.handle_count()], 1e-4);
        let expected: Vec<DVec3> = scene.shape.0.iter().map(|p| motion.map()(*p)).collect();
        let worst = largest_distance(&solution.positions[..expected.len()], &expected) / scene.body.diagonal;
        // A flat sheet says nothing about what leaves it, but its own vertices do not.
        assert!(worst < 1e-8, "{worst}");
        assert!(solution.stats.max_error < 1e-8, "{}", solution.stats.max_error);
    }
}

#[test]
fn space_is_deformed_by_few_points_and_by_soft_ones() {
    // One vertex, two, three, four: as much of a linear function as they determine.
    for count in 1..=4usize {
        let scene = Scene::of_vertices(&[0, 40, 900, 1100][..count], None);
        let mut transforms = vec![Transform::IDENTITY; count];
        transforms[count - 1].translation = DVec3::Y;
        let solution = scene.solve(Method::SpatialRbf, &transforms, 1e-4);
        let held = [0usize, 40, 900, 1100][count - 1];
        assert!((solution.positions[held] - scene.shape.0[held] - DVec3::Y).length() < 1e-12);
        assert!(solution.positions.iter().all(|p| p.is_finite()));
        if count == 1 {
            assert!((solution.positions[7] - scene.shape.0[7] - DVec3::Y).length() < 1e-9);
        }
    }
    let follow = |stiffness: f64| {
        let scene = Scene::of_vertices(&[0, 40, 900, 1100, 1000, 300], Some(stiffness));
        let mut transforms = vec![Transform::IDENTITY; 6];
        transforms[5].translation = DVec3::Y;
        let solution = scene.solve(Method::SpatialRbf, &transforms, 1e-4);
        (solution.positions[300] - scene.shape.0[300]).y
    };
    let (loose, tight, stiff) = (follow(1e-3), follow(1.0), follow(1e9));
    assert!(loose < tight && tight < stiff, "{loose}, {tight}, {stiff}");
    assert!((stiff - 1.0).abs() < 1e-3, "{stiff}");
}

#[test]
fn every_way_turns_and_moves_the_handles_themselves_exactly() {
    let scene = Scene::many();
    let transforms = scene.turned(1.6);
    for way in METHODS {
        let solution = scene.solve(way, &transforms, 1e-4);
        for (k, transform) in transforms.iter().enumerate() {
            for &n in &scene.rig.setup().handles[k].nodes {
                let (rest, now) = (scene.body.graph.positions[n as usize], solution.positions[n as usize]);
                assert_eq!(now, transform.map()(rest), "{way:?}, handle {k}");
                if way != Method::SpatialRbf {
                    let far = angle_between(
                        rotation_in(&solution.frames[n as usize]),
                        exp_rotation(transform.rotation),
                    );
                    assert!(far < 1e-3, "{way:?}, handle {k}: {far}");
                }
            }
        }
    }
}

#[test]
fn shapes_are_what_they_are_taken_for() {
    assert_eq!(
        Scene::bar().shape.0.len(),
        shapes::box_with_cells(DVec3::ONE, [8, 8, 32]).0.len()
    );
    assert!(!Scene::spring().1.is_empty());
}

#[test]
fn at_rest_every_way_returns_the_bits_of_the_model() {
    let scene = Scene::many();
    let mut state = SolveState::default();
    for way in METHODS {
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
        METHODS.map(|way| {
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
        for way in METHODS {
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
    for way in METHODS {
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
    for way in METHODS.into_iter().chain(METHODS) {
        let near = scene.turned(0.97);
        scene.solve_in(&mut state, SolveStart::Warm, way, &near, 1e-7);
        let other = Method::Harmonic;
        let warm = scene
            .solve_in(&mut state, SolveStart::Warm, other, &transforms, 1e-7)
            .positions;
        let fresh = scene.solve(other, &transforms, 1e-7).positions;
        let far = largest_distance(&warm, &fresh) / scene.body.diagonal;
        assert!(far < 1e-4, "after {way:?}: {far:e}");
    }
}

/// Longest edge over its length in the rest pose.
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
        for first_pass in [Method::Harmonic, Method::Diffusion] {
            let solution = scene.solve(first_pass, &transforms, 1e-6);
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
        let positions = scene.solve(Method::Harmonic, &transforms, 1e-6).positions;
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
        first_pass in prop::sample::select(vec![Method::Harmonic, Method::Diffusion]),
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
                scene.solve(first_pass, &transforms, 1e-7).positions
            };
            let jump = largest_distance(&at(degrees), &at(degrees + 0.2)) / scene.body.diagonal;
            // The handle's own vertices move by 0.0006 of the diagonal.
            prop_assert!(jump < 0.02, "a vertex jumps by {jump} of the diagonal");
            Ok(())
        })?;
    }
}
