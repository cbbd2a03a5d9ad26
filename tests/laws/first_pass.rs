//! How rotations are spread from the handles, and the deformation of space that it is compared with.

mod laws;
mod scene;
mod turns;

use crate::support::bench::largest_distance;
use glam::{DMat3, DQuat, DVec3};
use pliant::asset::shapes;
use pliant::deform::{FirstPass, Transform, exp_rotation};
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
    let [harmonic, diffusion, linear, space] = WAYS.map(rms);
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
    let frames = scene
        .solve(Way::Graph(FirstPass::LinearFrames), &transforms, 1e-2)
        .frames;
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
    let (graph, space) = (follow(Way::Graph(FirstPass::Harmonic)), follow(Way::Space));
    assert!(
        graph.abs() < 1e-6,
        "the neighbouring coils follow by {graph} on the graph"
    );
    assert!(space > 0.4, "the neighbouring coils follow by {space} in space");
}

/// Equation (2) at rest: every quaternion is along the sum of its neighbours'.
#[test]
fn diffusion_comes_to_rest_where_the_blend_has_not() {
    let scene = Scene::many();
    let transforms = scene.turned(1.0);
    let worst = |first_pass| {
        let frames = scene.solve(Way::Graph(first_pass), &transforms, 1e-2).frames;
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
    let (blend, diffused) = (worst(FirstPass::Harmonic), worst(FirstPass::Diffusion));
    assert!(diffused < 0.2 * blend, "{diffused} left, {blend} by harmonic fields");
}

/// Section 2.1: "such an interpolated rotation is a good approximation".
#[test]
fn harmonic_fields_are_close_to_diffusion() {
    let scene = Scene::many();
    let transforms = scene.turned(1.0);
    let frames = |first_pass| scene.solve(Way::Graph(first_pass), &transforms, 1e-2).frames;
    let (blend, diffused) = (frames(FirstPass::Harmonic), frames(FirstPass::Diffusion));
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
        let solution = scene.solve(Way::Space, &vec![motion; scene.rig.handle_count()], 1e-4);
        let expected: Vec<DVec3> = scene.shape.0.iter().map(|p| motion.map()(*p)).collect();
        let worst = largest_distance(&solution.positions[..expected.len()], &expected) / scene.body.diagonal;
        // A flat sheet says nothing about what leaves it, but its own vertices do not.
        assert!(worst < 1e-8, "{worst}");
        assert!(solution.max_error < 1e-8, "{}", solution.max_error);
    }
}

#[test]
fn space_is_deformed_by_few_points_and_by_soft_ones() {
    // One vertex, two, three, four: as much of a linear function as they tell apart.
    for count in 1..=4usize {
        let scene = Scene::of_vertices(&[0, 40, 900, 1100][..count], None);
        let mut transforms = vec![Transform::IDENTITY; count];
        transforms[count - 1].translation = DVec3::Y;
        let solution = scene.solve(Way::Space, &transforms, 1e-4);
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
        let solution = scene.solve(Way::Space, &transforms, 1e-4);
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
    for way in WAYS {
        let solution = scene.solve(way, &transforms, 1e-4);
        for (k, transform) in transforms.iter().enumerate() {
            for &n in &scene.rig.setup().handles[k].nodes {
                let (rest, now) = (scene.body.graph.positions[n as usize], solution.positions[n as usize]);
                assert_eq!(now, transform.map()(rest), "{way:?}, handle {k}");
                if way != Way::Space {
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
