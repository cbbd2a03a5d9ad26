//! The laws of the two-pass deformation, on shapes generated here.

use glam::{DMat3, DQuat, DVec3};
use pliant::asset::{FileSet, shapes};
use pliant::deform::{Body, BodyOptions, Hold, Request, Rig, Rigging, Start, State, Transform, exp_rotation, frames};
use pliant::job::{Error, Limits, Mode, Settings, Solved, Workbench, frames::digest, pb};
use pliant::mesh::{Mesh, Weld};
use pliant::pool::Pool;
use pliant::progress::Silent;

type Shape = (Vec<DVec3>, Vec<[u32; 3]>);

fn pool(threads: usize) -> Pool {
    Pool::new(threads).expect("threads start")
}

fn obj((positions, triangles): &Shape) -> FileSet {
    let mut text = String::new();
    positions
        .iter()
        .for_each(|p| text += &format!("v {} {} {}\n", p.x, p.y, p.z));
    triangles
        .iter()
        .for_each(|t| text += &format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1));
    FileSet::single("shape.obj", text)
}

fn bench_with(shape: &Shape, create: &pb::CreateOptions, pool: &Pool) -> Workbench {
    Workbench::open(obj(shape), create, &Limits::default(), pool, &Silent).expect("the shape opens")
}

fn bench(shape: &Shape) -> Workbench {
    bench_with(shape, &pb::CreateOptions::default(), &pool(2))
}

fn below(offset: f64) -> pb::Region {
    half_space([0.0, 0.0, -1.0], -offset)
}

fn above(offset: f64) -> pb::Region {
    half_space([0.0, 0.0, 1.0], offset)
}

fn half_space(normal: [f64; 3], offset: f64) -> pb::Region {
    let half = pb::region::HalfSpace {
        normal: normal.to_vec(),
        offset,
    };
    pb::Region {
        region: Some(pb::region::Region::HalfSpace(half)),
    }
}

fn handle(id: &str, region: pb::Region) -> pb::Handle {
    pb::Handle {
        id: id.into(),
        region: Some(region),
        ..Default::default()
    }
}

fn set(bench: &mut Workbench, handles: Vec<pb::Handle>) {
    let request = pb::SetHandlesRequest {
        handles,
        ..Default::default()
    };
    bench.set_handles(&request, &pool(2), &Silent).expect("the handles fit");
}

fn settings(tolerance: f64) -> Settings {
    Settings::check(
        &pb::Options {
            tolerance,
            ..Default::default()
        },
        "options",
        8,
    )
    .expect("valid options")
}

fn pose(entries: &[(&str, pb::HandlePose)]) -> pb::Pose {
    let entry = |(id, pose): &(&str, pb::HandlePose)| pb::pose::Entry {
        id: (*id).into(),
        pose: Some(pose.clone()),
    };
    pb::Pose {
        handles: entries.iter().map(entry).collect(),
        ..Default::default()
    }
}

fn try_solve(bench: &mut Workbench, pose: &pb::Pose, tolerance: f64, threads: usize) -> Result<Solved, Error> {
    let poses = bench.posed(&bench.initial_poses(), pose)?;
    bench.solve(
        &poses,
        &settings(tolerance),
        Mode::Commit,
        &pool(threads),
        &Silent,
        &mut |_| true,
    )
}

fn solve(bench: &mut Workbench, entries: &[(&str, pb::HandlePose)], tolerance: f64) -> Solved {
    try_solve(bench, &pose(entries), tolerance, 2).expect("the pose solves")
}

fn turn(vector: DVec3, pivot: DVec3) -> pb::HandlePose {
    pb::HandlePose {
        rotation_vector: vector.to_array().to_vec(),
        pivot: pivot.to_array().to_vec(),
        ..Default::default()
    }
}

fn shift(by: DVec3) -> pb::HandlePose {
    pb::HandlePose {
        translation: by.to_array().to_vec(),
        ..Default::default()
    }
}

fn largest_distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

/// A bar along z, 4 long and 1 wide.
fn bar() -> Shape {
    let (positions, triangles) = shapes::box_with_cells(DVec3::new(1.0, 1.0, 4.0), [8, 8, 32]);
    (
        positions.iter().map(|p| *p - DVec3::new(0.5, 0.5, 0.0)).collect(),
        triangles,
    )
}

fn bent_bar() -> Workbench {
    let mut bench = bench(&bar());
    set(
        &mut bench,
        vec![handle("base", below(0.25)), handle("top", above(3.75))],
    );
    bench
}

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
        let body = Body::build(&mesh, &BodyOptions::default(), &pool, &Silent).expect("a body");
        let bounds = mesh.bounds();
        let reach = bounds.max.x - 0.15 * (bounds.max.x - bounds.min.x);
        let region = |keep: &dyn Fn(DVec3) -> bool| {
            (0u32..)
                .zip(&body.graph.positions)
                .filter(|(_, p)| keep(**p))
                .map(|(n, _)| n)
                .collect::<Vec<_>>()
        };
        let hold = |nodes| Hold {
            nodes,
            position: true,
            rotation: true,
            scale: true,
            ..Default::default()
        };
        let low = bounds.min.x + 0.15 * (bounds.max.x - bounds.min.x);
        let holds = vec![hold(region(&|p| p.x <= low)), hold(region(&|p| p.x >= reach))];
        let rig = Rig::build(
            &body,
            Rigging {
                holds,
                ..Default::default()
            },
            &pool,
            &Silent,
        )
        .expect("a rig");
        let moved = Transform {
            translation: DVec3::new(0.1, 0.3, -0.2),
            rotation: DVec3::new(0.4, -0.3, 0.9),
            log_scale: DMat3::from_diagonal(DVec3::splat(0.2)),
            pivot: bounds.max,
        };
        let transforms = [Transform::IDENTITY, moved];
        for tolerance in [1e-3, 1e-5, 1e-8] {
            let request = Request {
                transforms: &transforms,
                tolerance: Some(tolerance),
                max_error: None,
                start: Start::Fresh,
            };
            let solution = rig
                .solve(&body, &request, &mut State::default(), &pool, &Silent, &mut |_| true)
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
fn equation_8_residual(body: &Body, rig: &Rig, frames: &[[f32; 9]], x: &[DVec3]) -> f64 {
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
        let quality = bench.quality(&solved.positions);
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
    let change = |mode: pb::create_options::volume_graph::Mode| {
        let volume_graph = Some(pb::create_options::VolumeGraph {
            mode: mode as i32,
            ..Default::default()
        });
        let mut bench = bench_with(
            &bar(),
            &pb::CreateOptions {
                volume_graph,
                ..Default::default()
            },
            &pool(2),
        );
        set(
            &mut bench,
            vec![handle("base", below(0.25)), handle("top", above(3.75))],
        );
        let solved = solve(&mut bench, &[("top", turn(DVec3::Z * 2.4, DVec3::ZERO))], 1e-5);
        bench.quality(&solved.positions).volume_change
    };
    let (with, without) = (
        change(pb::create_options::volume_graph::Mode::Auto),
        change(pb::create_options::volume_graph::Mode::Off),
    );
    assert!(with.abs() < 0.6 * without.abs(), "{with} with, {without} without");
}

#[test]
fn fields_are_bounded_and_sum_to_one() {
    let mut bench = bench(&bar());
    let middle = pb::region::Sphere {
        center: vec![0.5, 0.0, 2.0],
        radius: 0.2,
    };
    let middle = pb::Region {
        region: Some(pb::region::Region::Sphere(middle)),
    };
    let soft = pb::Handle {
        stiffness: Some(2.0),
        ..handle("side", middle)
    };
    set(
        &mut bench,
        vec![handle("base", below(0.25)), handle("top", above(3.75)), soft],
    );
    let fields = bench.rig().expect("a rig").rotation_fields();
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
        let list = pb::region::Vertices {
            indices,
            ranges: Vec::new(),
        };
        pb::Region {
            region: Some(pb::region::Region::Vertices(list)),
        }
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
    // Without inside nodes, whose lattice does not turn with the scene.
    let off = pb::create_options::VolumeGraph {
        mode: pb::create_options::volume_graph::Mode::Off as i32,
        ..Default::default()
    };
    let create = pb::CreateOptions {
        volume_graph: Some(off),
        ..Default::default()
    };
    let run = |shape: &Shape, q: DQuat, pivot: DVec3| {
        let mut bench = bench_with(shape, &create, &pool(1));
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
            handles: vec![handle("base", below(0.25)), handle("top", above(3.75))],
            ..Default::default()
        };
        bench
            .set_handles(&request, &pool(threads), &Silent)
            .expect("the handles fit");
        if threads == 3 {
            let dragged = bench
                .posed(&bench.initial_poses(), &pose(&[("top", shift(DVec3::X))]))
                .expect("a pose");
            bench
                .solve(&dragged, &settings(1e-4), Mode::Drag, &pool(3), &Silent, &mut |_| true)
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

/// A bar and, beside it, a ball that no handle holds.
fn bar_and_ball() -> (Shape, usize) {
    let (mut positions, mut triangles) = bar();
    let first = positions.len();
    let (ball, faces) = shapes::icosphere(0.3, 2);
    positions.extend(ball.iter().map(|p| *p + DVec3::new(1.2, 0.0, 3.9)));
    triangles.extend(faces.iter().map(|t| t.map(|v| v + first as u32)));
    ((positions, triangles), first)
}

#[test]
fn a_part_without_a_handle_follows_holds_or_is_refused() {
    use pb::create_options::Components;
    let (shape, first) = bar_and_ball();
    let bend = [("top", turn(DVec3::Y * 1.0, DVec3::new(0.0, 0.0, 2.0)))];
    let run = |policy: Components| {
        let create = pb::CreateOptions {
            components: policy as i32,
            ..Default::default()
        };
        let mut bench = bench_with(&shape, &create, &pool(2));
        // A box, so that the ball beside it stays loose.
        let top = pb::region::Box {
            min: vec![-1.0, -1.0, 3.75],
            max: vec![0.6, 1.0, 5.0],
        };
        let top = pb::Region {
            region: Some(pb::region::Region::Box(top)),
        };
        let handles = vec![handle("base", below(0.25)), handle("top", top)];
        let request = pb::SetHandlesRequest {
            handles,
            ..Default::default()
        };
        bench.set_handles(&request, &pool(2), &Silent)?;
        try_solve(&mut bench, &pose(&bend), 1e-5, 2)
    };
    let follow = run(Components::Follow).expect("solved").positions;
    let expected: Vec<_> = shape.0[first..]
        .iter()
        .map(|p| exp_rotation(DVec3::Y) * (*p - DVec3::new(0.0, 0.0, 2.0)) + DVec3::new(0.0, 0.0, 2.0))
        .collect();
    let error = largest_distance(&follow[first..], &expected);
    assert!(error < 0.05, "the ball moves with the bar's end, off by {error}");
    let size = |p: &[DVec3]| p[first].distance(p[first + 7]);
    assert!((size(&follow) - size(&shape.0)).abs() < 1e-9, "and rigidly");
    let hold = run(Components::Hold).expect("solved").positions;
    assert_eq!(hold[first..], shape.0[first..]);
    assert_eq!(hold[..first], follow[..first], "the policy changes nothing else");
    match run(Components::Free) {
        Err(Error::Precondition(text)) => assert!(text.contains("part 1"), "{text}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn outside_the_region_of_interest_no_bit_changes() {
    let shape = bar();
    let mut bench = bench(&shape);
    let request = pb::SetHandlesRequest {
        handles: vec![handle("top", above(3.75))],
        region_of_interest: Some(above(2.0)),
        ..Default::default()
    };
    bench.set_handles(&request, &pool(2), &Silent).expect("the handles fit");
    let solved = solve(&mut bench, &[("top", shift(DVec3::new(1.0, 0.0, 0.3)))], 1e-5);
    let mut moved = 0;
    for (now, rest) in solved.positions.iter().zip(&shape.0) {
        if rest.z < 2.0 {
            assert_eq!(now.to_array().map(f64::to_bits), rest.to_array().map(f64::to_bits));
        } else {
            moved += usize::from(now != rest);
        }
    }
    assert!(moved > 100);
}

#[test]
fn a_symmetry_plane_does_what_mirrored_handles_would() {
    let shape = shapes::torus(1.0, 0.3, 48, 16);
    let front = || handle("front", half_space([0.0, -1.0, 0.0], 1.1));
    let side = || handle("side", half_space([1.0, 0.0, 0.0], 1.1));
    let moved = pb::HandlePose {
        translation: vec![0.4, 0.1, 0.3],
        ..turn(DVec3::new(0.2, 0.5, 0.3), DVec3::X)
    };
    let image = pb::HandlePose {
        translation: vec![-0.4, 0.1, 0.3],
        ..turn(DVec3::new(0.2, -0.5, -0.3), -DVec3::X)
    };

    let mut by_plane = bench(&shape);
    let request = pb::SetHandlesRequest {
        handles: vec![front(), side()],
        symmetry_plane: Some(pb::Plane {
            normal: vec![2.0, 0.0, 0.0],
            offset: 0.0,
        }),
        ..Default::default()
    };
    by_plane
        .set_handles(&request, &pool(2), &Silent)
        .expect("the handles fit");
    let mirrored = solve(&mut by_plane, &[("side", moved.clone())], 1e-8);

    let mut by_hand = bench(&shape);
    set(
        &mut by_hand,
        vec![front(), side(), handle("other", half_space([-1.0, 0.0, 0.0], 1.1))],
    );
    let explicit = solve(&mut by_hand, &[("side", moved), ("other", image)], 1e-8);
    let error = largest_distance(&mirrored.positions, &explicit.positions);
    assert!(error < 1e-6, "off by {error}");
    assert!(largest_distance(&mirrored.positions, &shape.0) > 0.3);
}

#[test]
fn soft_handles_give_way_and_stiffer_ones_less() {
    let missing = |stiffness: f64| {
        let mut bench = bench(&bar());
        let top = pb::Handle {
            stiffness: Some(stiffness),
            ..handle("top", above(3.75))
        };
        set(&mut bench, vec![handle("base", below(0.25)), top]);
        let by = DVec3::new(0.0, 0.0, 1.0);
        let solved = solve(&mut bench, &[("top", shift(by))], 1e-7);
        let rest = bar().0;
        let held = || rest.iter().zip(solved.positions.iter()).filter(|(p, _)| p.z >= 3.75);
        held().map(|(p, x)| x.distance(*p + by)).sum::<f64>() / held().count() as f64
    };
    let (soft, stiff, hard) = (missing(0.01), missing(1.0), missing(1000.0));
    assert!(
        soft > 2.0 * stiff && stiff > 10.0 * hard && hard < 1e-3,
        "{soft} {stiff} {hard}"
    );
}

#[test]
fn a_falloff_pulls_its_surroundings_and_fades() {
    let run = |falloff: Option<pb::Falloff>| {
        let mut bench = bench(&shapes::grid(2.0, 2.0, [40, 40]));
        let center = pb::region::Sphere {
            center: vec![1.0, 0.0, 1.0],
            radius: 0.15,
        };
        let region = pb::Region {
            region: Some(pb::region::Region::Sphere(center)),
        };
        let soft = pb::Handle {
            stiffness: Some(5.0),
            falloff,
            ..handle("pull", region)
        };
        set(
            &mut bench,
            vec![handle("rim", half_space([0.0, 0.0, -1.0], -0.1)), soft],
        );
        let solved = solve(&mut bench, &[("pull", shift(DVec3::Y * 0.5))], 1e-7);
        let rest = bench.rest().clone();
        let ring = rest
            .iter()
            .zip(solved.positions.iter())
            .filter(|(p, _)| (0.3..0.4).contains(&p.distance(DVec3::new(1.0, 0.0, 1.0))));
        let (sum, count) = ring.fold((0.0, 0), |(s, n), (_, x)| (s + x.y, n + 1));
        sum / f64::from(count)
    };
    let smooth = pb::Falloff {
        radius: 0.6,
        kind: pb::falloff::Kind::Smooth as i32,
    };
    let (without, with) = (run(None), run(Some(smooth)));
    assert!(with > without + 0.05, "{with} with, {without} without");
}

#[test]
fn a_rigid_region_keeps_its_shape_when_others_move_it() {
    let mut bench = bench(&bar());
    let middle = pb::region::Box {
        min: vec![-1.0, -1.0, 1.6],
        max: vec![1.0, 1.0, 2.4],
    };
    let region = pb::Region {
        region: Some(pb::region::Region::Box(middle)),
    };
    let rotation = pb::handle::Constrains::Rotation as i32;
    let rigid = pb::Handle {
        rigid: true,
        constrains: vec![rotation],
        stiffness: Some(1e-6),
        ..handle("middle", region)
    };
    set(
        &mut bench,
        vec![handle("base", below(0.25)), handle("top", above(3.75)), rigid],
    );
    let solved = solve(
        &mut bench,
        &[("top", turn(DVec3::new(0.0, 1.3, 0.8), DVec3::ZERO))],
        1e-6,
    );
    let inside: Vec<usize> = (0..bench.rest().len())
        .filter(|k| (1.6..=2.4).contains(&bench.rest()[*k].z))
        .collect();
    let worst = inside
        .windows(9)
        .map(|w| {
            let at = |p: &[DVec3]| p[w[0]].distance(p[w[8]]);
            (at(&solved.positions) - at(bench.rest())).abs()
        })
        .fold(0.0, f64::max);
    assert!(worst < 1e-6, "distances inside change by {worst}");
}

#[test]
fn position_and_rotation_may_be_held_by_different_handles() {
    let mut bench = bench(&bar());
    let only = |id: &str, region, kind: pb::handle::Constrains| pb::Handle {
        constrains: vec![kind as i32],
        ..handle(id, region)
    };
    set(
        &mut bench,
        vec![
            handle("base", below(0.25)),
            only("place", above(3.9), pb::handle::Constrains::Position),
            only("turned", above(3.0), pb::handle::Constrains::Rotation),
        ],
    );
    let angle = 0.8;
    let solved = solve(&mut bench, &[("turned", turn(DVec3::Z * angle, DVec3::ZERO))], 1e-7);
    // Nothing moves the ends, yet the part between them is asked to turn.
    let rest = bench.rest();
    let middle = rest
        .iter()
        .zip(solved.positions.iter())
        .filter(|(p, _)| (3.1..3.5).contains(&p.z));
    let turned = middle
        .map(|(p, x)| p.truncate().angle_to(x.truncate()))
        .fold(0.0, f64::max);
    assert!(turned > 0.1 * angle, "turned by {turned}");
    let held = rest.iter().zip(solved.positions.iter()).filter(|(p, _)| p.z >= 3.9);
    assert!(held.into_iter().all(|(p, x)| p == x));
}

#[test]
fn requests_that_make_no_sense_are_refused_with_their_place_and_change_nothing() {
    let mut bench = bent_bar();
    let refused = |bench: &mut Workbench, handles: Vec<pb::Handle>, place: &str| {
        let request = pb::SetHandlesRequest {
            handles,
            ..Default::default()
        };
        match bench.set_handles(&request, &pool(1), &Silent) {
            Err(Error::Invalid { field, problem }) => assert_eq!(field, place, "{problem}"),
            other => panic!("{place}: {other:?}"),
        }
        assert_eq!(bench.handles().handles.len(), 2);
    };
    refused(&mut bench, vec![handle("", below(0.0))], "handles[0].id");
    refused(
        &mut bench,
        vec![handle("a", below(0.5)), handle("a", above(3.0))],
        "handles[1].id",
    );
    refused(&mut bench, vec![handle("a", above(99.0))], "handles[0].region");
    refused(
        &mut bench,
        vec![pb::Handle {
            id: "a".into(),
            ..Default::default()
        }],
        "handles[0].region",
    );
    refused(
        &mut bench,
        vec![handle("a", half_space([0.0; 3], 1.0))],
        "handles[0].region.halfSpace.normal",
    );
    refused(
        &mut bench,
        vec![handle("a", half_space([f64::NAN, 0.0, 1.0], 1.0))],
        "handles[0].region.halfSpace.normal[0]",
    );
    let far = pb::region::Vertices {
        indices: vec![1, 1 << 30],
        ranges: Vec::new(),
    };
    let far = pb::Region {
        region: Some(pb::region::Region::Vertices(far)),
    };
    refused(
        &mut bench,
        vec![handle("a", far)],
        "handles[0].region.vertices.indices[1]",
    );
    let wide = pb::region::Range {
        first: u32::MAX,
        count: u32::MAX,
    };
    let wide = pb::region::Vertices {
        indices: Vec::new(),
        ranges: vec![wide],
    };
    let wide = pb::Region {
        region: Some(pb::region::Region::Vertices(wide)),
    };
    refused(
        &mut bench,
        vec![handle("a", wide)],
        "handles[0].region.vertices.ranges[0]",
    );
    let fading = pb::Handle {
        falloff: Some(pb::Falloff { radius: 1.0, kind: 1 }),
        ..handle("a", below(0.5))
    };
    refused(&mut bench, vec![fading], "handles[0].falloff");
    let only_turned = pb::Handle {
        constrains: vec![pb::handle::Constrains::Rotation as i32],
        ..handle("a", below(0.5))
    };
    let request = pb::SetHandlesRequest {
        handles: vec![only_turned],
        ..Default::default()
    };
    assert!(matches!(
        bench.set_handles(&request, &pool(1), &Silent),
        Err(Error::Precondition(_))
    ));
    let nobody = pose(&[("nobody", pb::HandlePose::default())]);
    match bench.posed(&bench.initial_poses(), &nobody) {
        Err(Error::Invalid { field, problem }) => {
            assert_eq!(field, "pose.handles[0].id");
            assert!(problem.contains("\"base\""), "{problem}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn cancelled_work_leaves_the_bench_usable() {
    use pliant::progress::CancelFlag;
    let mut bench = bent_bar();
    let flag = CancelFlag::default();
    flag.cancel();
    let poses = bench
        .posed(&bench.initial_poses(), &pose(&[("top", shift(DVec3::X))]))
        .expect("a pose");
    let cancelled = bench.solve(&poses, &settings(1e-6), Mode::Drag, &pool(2), &flag, &mut |_| true);
    assert!(matches!(cancelled, Err(Error::Cancelled)));
    let after = bench
        .solve(&poses, &settings(1e-6), Mode::Drag, &pool(2), &Silent, &mut |_| true)
        .expect("solved");
    let fresh = bench
        .solve(&poses, &settings(1e-6), Mode::Commit, &pool(2), &Silent, &mut |_| true)
        .expect("solved");
    assert!(largest_distance(&after.positions, &fresh.positions) < 1e-3);
}
