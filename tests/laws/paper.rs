//! The laws of the two-pass deformation, on shapes generated here.

use crate::support::bench;
use crate::support::messages::DeformerMessages;

use bench::*;
use glam::{DMat3, DQuat, DVec3};
use pliant::asset::shapes;
use pliant::deform::{
    BodyOptions, DeformableBody, HandleConstraint, HandleSetup, HandleSystem, PoseRequest, Quality, SolveState,
    Transform, exp_rotation, frames,
};
use pliant::engine::{SolveMode, digest};
use pliant::exec::Exec;
use pliant::mesh::{Mesh, Weld};
use pliant::progress::Silent;
use pliant::wire::pb;

/// Equation (8) recomputed in f64 from the graph, the frames and the positions alone.
#[test]
fn solutions_satisfy_equation_8_to_the_residual_asked_for() {
    let pool = pool(2);
    for (name, shape) in [
        ("bar", bar()),
        ("torus", shapes::torus(1.0, 0.35, 64, 24)),
        ("sheet", shapes::grid(1.0, 1.0, [24, 24])),
    ] {
        let mesh = Mesh::build(&shape.0, &shape.1, Weld::Exact).expect("a mesh");
        let body = DeformableBody::build(&mesh, &BodyOptions::default(), &Exec::new(&pool, &Silent)).expect("a body");
        let bounds = mesh.bounds();
        let reach = bounds.max.x - 0.15 * (bounds.max.x - bounds.min.x);
        let low = bounds.min.x + 0.15 * (bounds.max.x - bounds.min.x);
        let hold = |keep: &dyn Fn(DVec3) -> bool| HandleConstraint {
            nodes: (0u32..)
                .zip(&body.graph.positions)
                .filter(|(_, p)| keep(**p))
                .map(|(n, _)| n)
                .collect(),
            position: true,
            rotation: true,
            scale: true,
            ..Default::default()
        };
        let setup = HandleSetup {
            handles: vec![hold(&|p| p.x <= low), hold(&|p| p.x >= reach)],
            ..Default::default()
        };
        let exec = Exec::new(&pool, &Silent);
        let rig = HandleSystem::build(&body, setup, &exec).expect("a rig");
        let moved = Transform {
            translation: DVec3::new(0.1, 0.3, -0.2),
            rotation: DVec3::new(0.4, -0.3, 0.9),
            log_scale: DMat3::from_diagonal(DVec3::splat(0.2)),
            pivot: bounds.max,
        };
        let transforms = [Transform::IDENTITY, moved];
        for tolerance in [1e-3, 1e-5, 1e-8] {
            let quality = Quality {
                tolerance: Some(tolerance),
                ..Quality::default()
            };
            let request = PoseRequest::new(&transforms, quality);
            let solution = rig
                .solve(&body, &request, &mut SolveState::default(), &exec, &mut |_| true)
                .expect("solved");
            let frames = frames(&body, &rig, &transforms, &pool);
            let residual = equation_8_residual(&body, &rig, &frames, &solution.positions);
            assert!(
                residual <= tolerance * 1.05,
                "{name}: asked for {tolerance:e}, equation (8) holds to {residual:e}"
            );
        }
    }
}

/// ‖b − A x‖ / ‖b‖, the largest over coordinates, with given values moved into b around their mean.
fn equation_8_residual(body: &DeformableBody, rig: &HandleSystem, frames: &[[f32; 9]], x: &[DVec3]) -> f64 {
    let graph = &body.graph;
    let matrix = |i: usize| glam::Mat3::from_cols_array(&frames[i]).as_dmat3();
    let given: Vec<DVec3> = x
        .iter()
        .zip(rig.given())
        .filter(|(_, g)| **g)
        .map(|(x, _)| *x)
        .collect();
    let mean = given.iter().sum::<DVec3>() / given.len() as f64;
    let (mut squares, mut size) = (DVec3::ZERO, DVec3::ZERO);
    for i in (0..graph.positions.len()).filter(|i| !rig.given()[*i]) {
        let (mut left, mut right) = (DVec3::ZERO, DVec3::ZERO);
        for e in graph.offsets[i] as usize..graph.offsets[i + 1] as usize {
            let j = graph.neighbours[e] as usize;
            let w = graph.weights.as_ref().map_or(1.0, |w| f64::from(w[e]));
            let d = (matrix(i) + matrix(j)) * (graph.positions[i] - graph.positions[j]) * 0.5;
            left += w * (x[i] - x[j] - d);
            right += w * d + if rig.given()[j] { w * (x[j] - mean) } else { DVec3::ZERO };
        }
        squares += left * left;
        size += right * right;
    }
    (0..3)
        .map(|k| (squares[k] / size[k].max(f64::MIN_POSITIVE)).sqrt())
        .fold(0.0, f64::max)
}

#[test]
fn a_rigid_motion_of_all_handles_moves_the_whole_mesh_rigidly() {
    let (vector, pivot, by) = (
        DVec3::new(0.7, -1.1, 0.4),
        DVec3::new(0.3, 0.2, 1.0),
        DVec3::new(5.0, -3.0, 2.0),
    );
    for shape in [
        bar(),
        shapes::torus(1.0, 0.3, 48, 16),
        shapes::cylinder(0.5, 4.0, 24, 24, false),
    ] {
        let mut bench = bench(&shape);
        let bounds = bench.report().bounds;
        let cut = |t: f64| bounds.min.z + t * (bounds.max.z - bounds.min.z);
        set(
            &mut bench,
            vec![handle("base", below(cut(0.1))), handle("top", above(cut(0.9)))],
        );
        let both = pb::HandlePose {
            translation: by.to_array().to_vec(),
            ..turn(vector, pivot)
        };
        let solved = solve(&mut bench, &[("base", both.clone()), ("top", both)], 1e-6);
        let expected: Vec<_> = shape
            .0
            .iter()
            .map(|&p| exp_rotation(vector) * (p - pivot) + pivot + by)
            .collect();
        let error = largest_distance(&solved.positions, &expected) / bench.diagonal();
        assert!(error < 1e-5, "off by {error:e} of the diagonal");
    }
}

#[test]
fn the_same_scale_on_all_handles_scales_the_whole_mesh() {
    let mut bench = bent_bar();
    let grown = pb::HandlePose {
        scale: vec![1.7],
        pivot: vec![0.0, 0.0, 0.0],
        ..Default::default()
    };
    let solved = solve(&mut bench, &[("base", grown.clone()), ("top", grown)], 1e-7);
    let expected: Vec<_> = bar().0.iter().map(|p| *p * 1.7).collect();
    assert!(largest_distance(&solved.positions, &expected) < 1e-4);
}

#[test]
fn a_pose_at_rest_returns_the_bits_of_the_model() {
    let mut bench = bent_bar();
    let solved = solve(&mut bench, &[("top", shift(DVec3::ZERO))], 1e-4);
    assert_eq!(digest(&solved.positions), digest(&bar().0));
    solve(&mut bench, &[("top", shift(DVec3::X))], 1e-4);
    let back = solve(&mut bench, &[("top", pb::HandlePose::default())], 1e-4);
    assert_eq!(
        digest(&back.positions),
        digest(&bar().0),
        "also after something else was solved"
    );
}

#[test]
fn a_twist_is_spread_evenly_and_keeps_most_of_the_volume() {
    for (degrees, largest, volume) in [(135.0, 0.012, 0.10), (360.0, 0.05, 0.42)] {
        let mut bench = bent_bar();
        let angle = f64::to_radians(degrees);
        let solved = solve(&mut bench, &[("top", turn(DVec3::Z * angle, DVec3::ZERO))], 1e-6);
        let ideal: Vec<_> = bar()
            .0
            .iter()
            .map(|p| DQuat::from_rotation_z(angle * ((p.z - 0.25) / 3.5).clamp(0.0, 1.0)) * *p)
            .collect();
        let squares: f64 = solved
            .positions
            .iter()
            .zip(&ideal)
            .map(|(a, b)| a.distance_squared(*b))
            .sum();
        let rms = (squares / ideal.len() as f64).sqrt() / bench.diagonal();
        assert!(
            rms < largest,
            "{degrees} degrees: {rms} of the diagonal from the even twist"
        );
        let quality = bench.quality(&solved.positions, &pool(2));
        assert!(
            quality.volume_change.abs() < volume,
            "{degrees} degrees: volume {}",
            quality.volume_change
        );
        assert_eq!(quality.flipped_triangles, 0);
    }
}

#[test]
fn the_volume_graph_keeps_volume_that_the_surface_alone_loses() {
    let [with, without] = [pb::CreateOptions::default(), surface_alone()].map(|create| {
        let mut bench = bench_with(&bar(), &create, &pool(2));
        set(&mut bench, ends());
        let solved = solve(&mut bench, &[("top", turn(DVec3::Z * 2.4, DVec3::ZERO))], 1e-5);
        bench.quality(&solved.positions, &pool(2)).volume_change
    });
    assert!(with.abs() < 0.6 * without.abs(), "{with} with, {without} without");
}

#[test]
fn fields_are_bounded_and_sum_to_one() {
    let mut bench = bench(&bar());
    let mut handles = ends();
    handles.push(soft("side", ball([0.5, 0.0, 2.0], 0.2), 2.0));
    set(&mut bench, handles);
    let fields = bench.handle_system().expect("a rig").rotation_fields();
    let nodes = bench.body().nodes();
    let mut inner = 0;
    for i in 0..nodes {
        let values: Vec<f32> = (0..3).map(|k| fields.of(k)[i]).collect();
        assert!(values.iter().all(|u| (0.0..=1.0).contains(u)), "node {i}: {values:?}");
        let sum: f32 = values.iter().sum();
        assert!((sum - 1.0).abs() < 1e-5, "node {i} sums to {sum}");
        inner += usize::from(values.iter().all(|u| *u > 0.01));
    }
    assert!(inner > nodes / 10, "the soft handle has its say too");
}

#[test]
fn turning_the_scene_turns_the_result() {
    let scene = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 0.9);
    let place = |p: DVec3| scene * p + DVec3::new(3.0, 1.0, -2.0);
    let shape = bar();
    let turned: Shape = (shape.0.iter().map(|p| place(*p)).collect(), shape.1.clone());
    let list = |keep: &dyn Fn(DVec3) -> bool| {
        let indices = (0u32..)
            .zip(&shape.0)
            .filter(|(_, p)| keep(**p))
            .map(|(k, _)| k)
            .collect();
        region(pb::region::Region::Vertices(pb::region::Vertices {
            indices,
            ranges: Vec::new(),
        }))
    };
    let handles = || {
        let side = |p: DVec3| (1.5..2.5).contains(&p.z) && p.x > 0.4;
        vec![
            handle("base", list(&|p| p.z <= 0.25)),
            handle("top", list(&|p| p.z >= 3.75)),
            handle("side", list(&side)),
        ]
    };
    let poses = [
        ("top", DVec3::new(0.0, 1.2, 0.3), DVec3::new(0.8, 0.0, -0.5)),
        ("side", DVec3::new(0.5, 0.0, 0.0), DVec3::X * 0.3),
    ];
    let entry = |(id, vector, by): &(&'static str, DVec3, DVec3), turn_by: DQuat, pivot: DVec3| {
        let pose = turn(turn_by * *vector, pivot);
        (
            *id,
            pb::HandlePose {
                translation: (turn_by * *by).to_array().to_vec(),
                ..pose
            },
        )
    };
    let pivot = DVec3::new(0.0, 0.0, 2.0);
    let run = |shape: &Shape, q: DQuat, pivot: DVec3| {
        // Without inside nodes, whose lattice does not turn with the scene.
        let mut bench = bench_with(shape, &surface_alone(), &pool(1));
        set(&mut bench, handles());
        let entries: Vec<_> = poses.iter().map(|p| entry(p, q, pivot)).collect();
        solve(&mut bench, &entries, 1e-8)
    };
    let plain = run(&shape, DQuat::IDENTITY, pivot);
    let after = run(&turned, scene, place(pivot));
    let expected: Vec<_> = plain.positions.iter().map(|p| place(*p)).collect();
    let error = largest_distance(&after.positions, &expected);
    assert!(error < 1e-4, "off by {error}");
}

#[test]
fn the_bits_do_not_depend_on_threads_or_on_what_was_dragged_before() {
    let mut digests = Vec::new();
    for threads in [1, 2, 3] {
        let mut bench = bench_with(&bar(), &pb::CreateOptions::default(), &pool(threads));
        let request = pb::SetHandlesRequest {
            handles: ends(),
            ..Default::default()
        };
        bench
            .set_handles_message(&request, &Exec::new(&pool(threads), &Silent))
            .expect("the handles fit");
        if threads == 3 {
            let dragged = bench
                .change_poses_message(&bench.initial_poses(), &pose(&[("top", shift(DVec3::X))]))
                .expect("a pose");
            bench
                .solve(
                    &dragged,
                    &settings(1e-4),
                    SolveMode::Drag,
                    &Exec::new(&pool(3), &Silent),
                    &mut |_| true,
                )
                .expect("solved");
        }
        let bent = pose(&[("top", turn(DVec3::new(0.0, 1.4, 0.6), DVec3::ZERO))]);
        digests.push(digest(
            &try_solve(&mut bench, &bent, 1e-5, threads).expect("solved").positions,
        ));
    }
    assert_eq!(digests[0], digests[1]);
    assert_eq!(digests[0], digests[2]);
}

#[test]
fn cancelled_work_leaves_the_bench_usable() {
    use pliant::progress::CancelFlag;
    let mut bench = bent_bar();
    let flag = CancelFlag::default();
    flag.cancel();
    let poses = bench
        .change_poses_message(&bench.initial_poses(), &pose(&[("top", shift(DVec3::X))]))
        .expect("a pose");
    let mut solve = |mode, exec: &Exec<'_>| bench.solve(&poses, &settings(1e-6), mode, exec, &mut |_| true);
    let pool = pool(2);
    let cancelled = solve(SolveMode::Drag, &Exec::new(&pool, &flag));
    assert!(matches!(cancelled, Err(pliant::engine::Error::Cancelled)));
    let after = solve(SolveMode::Drag, &Exec::new(&pool, &Silent)).expect("solved");
    let fresh = solve(SolveMode::Commit, &Exec::new(&pool, &Silent)).expect("solved");
    assert!(largest_distance(&after.positions, &fresh.positions) < 1e-3);
}
