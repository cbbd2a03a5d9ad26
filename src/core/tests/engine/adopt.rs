//! Shapes that are given: they become the rest pose bit for bit, and what belongs to the model follows.

use glam::DVec3;
use pliant_core::asset::{FileSet, shapes};
use pliant_core::deform::VolumeMode;
use pliant_core::engine::{
    Deformer, DeformerLimits, Edit, EditCommand, EditOutcome, EditedShape, Error, Handle, HandlePose, HandlePoses,
    ModelShape, OpenOptions, Region, SolveMode, SolveSettings, VertexRange, VertexTargets,
};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

/// A closed tube, with a ring around its middle as an object of its own, `far` away from the origin.
fn model(far: f64) -> FileSet {
    let tube = shapes::cylinder(0.5, 4.0, 12, 24, true);
    let ring = shapes::cylinder(0.7, 0.5, 12, 2, false);
    let (mut text, mut first) = (String::new(), 1);
    for (name, (points, triangles), up) in [("tube", tube, 0.0), ("ring", ring, 1.75)] {
        text += &format!("o {name}\n");
        for p in &points {
            text += &format!("v {} {} {}\n", p.x + far, p.y, p.z + up);
        }
        for t in &triangles {
            let [a, b, c] = t.map(|v| v + first);
            text += &format!("f {a} {b} {c}\n");
        }
        first += points.len() as u32;
    }
    FileSet::single("tube.obj", text)
}

fn opened(far: f64, exec: &Exec<'_>) -> Deformer {
    opened_with(VolumeMode::Auto, far, exec)
}

fn opened_with(volume: VolumeMode, far: f64, exec: &Exec<'_>) -> Deformer {
    let mut options = OpenOptions::default();
    options.body.volume = volume;
    let mut deformer = Deformer::open(model(far), &options, &DeformerLimits::default(), exec).expect("a model");
    let low = Handle::new("low", Region::half_space([0.0, 0.0, -1.0], -0.3));
    let high = Handle::new("high", Region::half_space([0.0, 0.0, 1.0], 3.7));
    deformer.set_handles([low, high], exec).expect("right handles");
    deformer
}

fn bent(deformer: &mut Deformer, exec: &Exec<'_>) -> (HandlePoses, ModelShape) {
    let pose = HandlePose::rotation([0.0, 0.9, 0.0]);
    let poses = deformer
        .change_poses(&deformer.initial_poses(), [("high", pose)])
        .expect("poses");
    let settings = SolveSettings::default();
    let shape = deformer.solve(&poses, &settings, SolveMode::Commit, exec, &mut |_| true);
    (poses, shape.expect("solved"))
}

fn adopt(
    deformer: &mut Deformer,
    positions: Vec<[f32; 3]>,
    (on, poses, shape): (EditedShape, &HandlePoses, &ModelShape),
    exec: &Exec<'_>,
) -> Result<EditOutcome, Error> {
    let command = EditCommand {
        edit: &Edit::Adopt { positions },
        on,
        shape,
        poses,
        settings: None,
    };
    deformer.edit(&command, exec)
}

/// What a frame has.
fn in_frame(deformer: &Deformer, positions: &[DVec3]) -> Vec<[f32; 3]> {
    let origin = deformer.facts().origin;
    positions.iter().map(|p| (*p - origin).as_vec3().to_array()).collect()
}

/// Every vertex somewhere else.
fn wavy(frame: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let moved = |p: &[f32; 3]| [p[0] + 0.1 * libm::sinf(3.0 * p[2]), p[1] * 1.07, p[2] - 0.03 * p[0]];
    frame.iter().map(moved).collect()
}

#[test]
fn a_given_shape_is_the_rest_pose_to_the_bit_and_poses_go_on_from_it() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    for far in [0.0, 3.0e6] {
        let mut deformer = opened(far, &exec);
        let before = deformer.topology_state();
        let (poses, shape) = bent(&mut deformer, &exec);
        let given = wavy(&in_frame(&deformer, &shape.positions));
        let on = (EditedShape::Current, &poses, &shape);
        let done = adopt(&mut deformer, given.clone(), on, &exec).expect("adopted");
        let (count, faces) = (given.len() as u32, done.report.after.faces);
        assert_eq!((done.report.after.vertices, done.report.before.faces), (count, faces));
        assert_eq!(done.report.handles_kept, ["low", "high"]);
        let now = in_frame(&deformer, &done.shape.positions);
        let off = now
            .iter()
            .flatten()
            .zip(given.iter().flatten())
            .map(|(a, b)| (a - b).abs());
        let allowed = if far == 0.0 { 0.0 } else { 1e-9 };
        assert!(
            off.fold(0.0, f32::max) <= allowed,
            "exact, but for what 64 bits lose far away"
        );
        let (_, posed) = bent(&mut deformer, &exec);
        let low = |shape: &[DVec3]| shape[..12].to_vec();
        assert_eq!(low(&posed), low(deformer.rest()), "what is held stays where it was put");
        deformer.restore_topology(&before, &exec).expect("back");
        assert_ne!(in_frame(&deformer, deformer.rest()), given);
        // Again, without the memory of what was solved: the same bits.
        let mut other = opened(far, &exec);
        let on = (
            EditedShape::Current,
            &poses,
            &ModelShape::from_positions(shape.positions.clone()),
        );
        let again = adopt(&mut other, given, on, &exec).expect("adopted");
        assert_eq!(again.report.digest, done.report.digest);
        assert_eq!(bent(&mut other, &exec).1.positions, posed.positions);
    }
}

#[test]
fn the_current_shape_becomes_the_rest_pose_as_it_is() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = opened_with(VolumeMode::Off, 0.0, &exec);
    let (poses, shape) = bent(&mut deformer, &exec);
    let on = (EditedShape::Current, &poses, &shape);
    let done = adopt(&mut deformer, Vec::new(), on, &exec).expect("adopted");
    assert!(done.shape.positions == shape.positions);
    assert!(done.report.repaired, "graph and hierarchy follow");
    assert!(done.poses.0.iter().all(|pose| !pose.moves()));
    let poses = done.poses.clone();
    let nothing = adopt(
        &mut deformer,
        Vec::new(),
        (EditedShape::Current, &poses, &done.shape),
        &exec,
    );
    let warnings = nothing.expect("adopted").report.warnings;
    assert_eq!(warnings.iter().map(|w| &*w.code).collect::<Vec<_>>(), ["adopt-nothing"]);
}

#[test]
fn poses_stay_on_a_given_rest_pose_and_what_does_not_fit_is_refused() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = opened(0.0, &exec);
    let (poses, shape) = bent(&mut deformer, &exec);
    let given = wavy(&in_frame(&deformer, deformer.rest()));
    let rest = deformer.rest().clone();
    for positions in [given[1..].to_vec(), Vec::new()] {
        match adopt(&mut deformer, positions, (EditedShape::Rest, &poses, &shape), &exec) {
            Err(Error::Invalid { field, .. }) => assert_eq!(field, "adopt.positions"),
            other => panic!("{:?}", other.map(|done| done.report)),
        }
        assert_eq!(*deformer.rest(), rest);
    }
    let done = adopt(&mut deformer, given.clone(), (EditedShape::Rest, &poses, &shape), &exec).expect("adopted");
    assert_eq!(in_frame(&deformer, deformer.rest()), given);
    assert!(done.poses.0[1].moves());
    assert_ne!(in_frame(&deformer, &done.shape.positions), given, "the pose is on top");
}

#[test]
fn poses_solved_anew_do_not_depend_on_those_before_them() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = opened(0.0, &exec);
    let mut settings = SolveSettings::default();
    settings.quality.refine = Some(3);
    let mut solve = |degrees: f64, mode: SolveMode| {
        let pose = HandlePose::rotation([0.0, degrees.to_radians(), 0.0]);
        let poses = deformer
            .change_poses(&deformer.initial_poses(), [("high", pose)])
            .expect("poses");
        deformer
            .solve(&poses, &settings, mode, &exec, &mut |_| true)
            .expect("solved")
            .positions
    };
    let committed = solve(80.0, SolveMode::Commit);
    for degrees in [20.0, 140.0] {
        solve(degrees, SolveMode::Drag);
        assert_eq!(solve(80.0, SolveMode::Anew), committed);
        solve(degrees, SolveMode::Anew);
        assert_eq!(solve(80.0, SolveMode::Anew), committed);
    }
    assert_ne!(solve(80.0, SolveMode::Drag), committed);
}

#[test]
fn targets_far_from_the_origin_are_as_exact_as_near_it() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = opened(5.0e6, &exec);
    let count = deformer.rest().len() as u32;
    let region = Region::Vertices {
        indices: Vec::new(),
        ranges: vec![VertexRange { first: 0, count }],
    };
    let scan = Handle::with_targets("scan", region, 1e4);
    deformer.set_handles([scan], &exec).expect("right handles");
    let wanted = wavy(&in_frame(&deformer, deformer.rest()));
    // One weight is for all.
    let pose = HandlePose::targets(VertexTargets::of(wanted.iter().copied()).weighted([1.0]));
    let shape = deformer
        .commit([("scan", pose)], &SolveSettings::default(), &exec)
        .expect("solved");
    let now = in_frame(&deformer, &shape.positions);
    let off = now
        .iter()
        .flatten()
        .zip(wanted.iter().flatten())
        .map(|(a, b)| (a - b).abs());
    let off = off.fold(0.0, f32::max);
    assert!(off < 1e-3, "{off}");
}

#[test]
fn a_shape_far_from_the_origin_of_its_session_is_warned_of() {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let codes = |aside: f32| -> Vec<String> {
        let mut deformer = opened(0.0, &exec);
        let (poses, shape) = (deformer.initial_poses(), deformer.rest_shape());
        let places = deformer.rest().iter().map(|p| p.as_vec3().to_array());
        let positions = places.map(|[x, y, z]| [x + aside, y, 1.01 * z]).collect();
        let outcome = adopt(&mut deformer, positions, (EditedShape::Current, &poses, &shape), &exec);
        let warnings = outcome.expect("adopted").report.warnings;
        warnings.iter().map(|w| w.code.to_string()).collect()
    };
    assert!(!codes(10.0).contains(&"places-rounded".to_owned()));
    assert!(codes(5e6).contains(&"places-rounded".to_owned()));
}

#[test]
fn a_shape_with_flat_triangles_is_adopted_and_told() {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = opened(0.0, &exec);
    let (poses, rest) = (deformer.initial_poses(), deformer.rest_shape());
    let mut given = in_frame(&deformer, &rest.positions);
    let told = |done: &EditOutcome| {
        let flat = done.report.warnings.iter().filter(|w| w.code == "triangles-flat");
        flat.map(|w| w.message.clone()).collect::<Vec<_>>()
    };
    let bent = adopt(
        &mut deformer,
        wavy(&given),
        (EditedShape::Current, &poses, &rest),
        &exec,
    )
    .expect("adopted");
    assert!(told(&bent).is_empty());
    let (poses, shape) = (deformer.initial_poses(), bent.shape);
    // Everything above the middle on one line.
    given
        .iter_mut()
        .filter(|p| p[2] > 2.0)
        .for_each(|p| (p[0], p[1]) = (0.0, 0.0));
    let flat = adopt(&mut deformer, given, (EditedShape::Current, &poses, &shape), &exec).expect("adopted");
    assert_eq!(told(&flat).len(), 1, "{:?}", flat.report.warnings);
}
