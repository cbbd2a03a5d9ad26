//! Laws of handles that turn by themselves: their place is as the pose says, and what they hang on is bent least.

use crate::support::bench::{largest_distance, obj};
use glam::{DQuat, DVec3};
use pliant::asset::shapes;
use pliant::engine::{
    Deformer, DeformerLimits, Error, Handle, HandleConstrains, HandlePose, OpenOptions, Plane, Region, SolveMode,
    SolveSettings,
};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use std::f64::consts::FRAC_PI_2;

const LENGTH: f64 = 8.0;

/// A bar along z, turned and moved as a whole.
struct Bar {
    turn: DQuat,
    by: DVec3,
}

const UPRIGHT: Bar = Bar {
    turn: DQuat::IDENTITY,
    by: DVec3::ZERO,
};

impl Bar {
    fn place(&self, p: DVec3) -> DVec3 {
        self.turn * p + self.by
    }

    fn end(&self, id: &str, normal: DVec3, offset: f64) -> Handle {
        let normal = self.turn * normal;
        let offset = offset + normal.dot(self.by);
        Handle::new(id, Region::HalfSpace(Plane { normal, offset }))
    }

    fn deformer(&self, pool: &Pool, handles: &[&str]) -> Deformer {
        let (points, faces) = shapes::box_with_cells(DVec3::new(1.0, 1.0, LENGTH), [5, 5, 40]);
        let files = obj(&(points.into_iter().map(|p| self.place(p)).collect(), faces));
        let exec = Exec::new(pool, &Silent);
        let mut deformer = Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), &exec).unwrap();
        let all = [
            self.end("low", -DVec3::Z, -0.5),
            self.end("high", DVec3::Z, LENGTH - 0.5),
        ];
        let set: Vec<Handle> = all.into_iter().filter(|h| handles.contains(&h.id.as_str())).collect();
        deformer.set_handles(set, &exec).unwrap();
        deformer
    }

    /// A pose of the upper end that moves its middle, and leaves its turn open.
    fn dragged(&self, by: DVec3) -> HandlePose {
        HandlePose::translation(self.turn * by).turning_freely()
    }
}

fn commit(deformer: &mut Deformer, pose: HandlePose, pool: &Pool) -> Vec<DVec3> {
    let exec = Exec::new(pool, &Silent);
    let shape = deformer
        .commit([("high", pose)], &SolveSettings::default(), &exec)
        .unwrap();
    shape.positions.to_vec()
}

/// The angle by which the upper end is turned in a shape, radians.
fn angle(deformer: &Deformer, pose: HandlePose, shape: &[DVec3]) -> f64 {
    let poses = deformer
        .change_poses(&deformer.initial_poses(), [("high", pose)])
        .unwrap();
    deformer.transforms_in(shape, &poses).unwrap()[1].rotation.length()
}

#[test]
fn an_end_dragged_aside_bends_the_bar_into_an_arc() {
    let pool = Pool::new(2).unwrap();
    let mut deformer = UPRIGHT.deformer(&pool, &["low", "high"]);
    // The end of an arc of a quarter turn, from the border of the lower handle to that of the upper one.
    let reach = LENGTH - 1.0;
    let radius = reach / FRAC_PI_2;
    let by = DVec3::new(radius, 0.0, radius - reach);
    let pose = UPRIGHT.dragged(by).about([0.5, 0.5, LENGTH - 0.5]);
    let shape = commit(&mut deformer, pose.clone(), &pool);
    let turned = angle(&deformer, pose.clone(), &shape);
    assert!((turned - FRAC_PI_2).abs() < 0.12, "turned by {turned}");
    let quality = deformer.quality(&shape, &pool);
    let unturned = HandlePose::translation(by).about([0.5, 0.5, LENGTH - 0.5]);
    let stiff = commit(&mut deformer, unturned, &pool);
    let worse = deformer.quality(&stiff, &pool);
    assert!(
        quality.edge_rms < 0.7 * worse.edge_rms,
        "{} {}",
        quality.edge_rms,
        worse.edge_rms
    );
    let poses = deformer
        .change_poses(&deformer.initial_poses(), [("high", pose)])
        .unwrap();
    let off = deformer.constraint_error(&shape, &poses).unwrap();
    assert!(off < 1e-12, "the region is rigid and in its place: {off}");
}

#[test]
fn the_whole_set_up_turns_with_the_scene() {
    let pool = Pool::new(2).unwrap();
    let there = Bar {
        turn: DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 1.1),
        by: DVec3::new(3.0, -1.0, 7.0),
    };
    let by = DVec3::new(2.5, 1.0, -1.0);
    let here = commit(
        &mut UPRIGHT.deformer(&pool, &["low", "high"]),
        UPRIGHT.dragged(by),
        &pool,
    );
    let turned = commit(&mut there.deformer(&pool, &["low", "high"]), there.dragged(by), &pool);
    let wanted: Vec<DVec3> = here.iter().map(|p| there.place(*p)).collect();
    // Lattices inside lie otherwise in a model that is turned.
    let far = largest_distance(&turned, &wanted) / LENGTH;
    assert!(far < 0.01, "{far}");
}

#[test]
fn nothing_dragged_is_the_rest_pose_and_one_handle_alone_takes_all_along() {
    let pool = Pool::new(2).unwrap();
    let mut deformer = UPRIGHT.deformer(&pool, &["low", "high"]);
    let shape = commit(&mut deformer, HandlePose::default().turning_freely(), &pool);
    assert_eq!(shape, **deformer.rest());
    let mut alone = UPRIGHT.deformer(&pool, &["high"]);
    let by = DVec3::new(1.0, 2.0, -0.5);
    let shape = commit(&mut alone, UPRIGHT.dragged(by), &pool);
    let wanted: Vec<DVec3> = alone.rest().iter().map(|p| *p + by).collect();
    assert!(largest_distance(&shape, &wanted) < 1e-6 * LENGTH);
}

#[test]
fn a_drag_comes_to_what_a_commit_finds_and_a_commit_depends_on_no_drag() {
    let pool = Pool::new(2).unwrap();
    let mut deformer = UPRIGHT.deformer(&pool, &["low", "high"]);
    let by = DVec3::new(3.0, 0.5, -0.8);
    let first = commit(&mut deformer, UPRIGHT.dragged(by), &pool);
    let exec = Exec::new(&pool, &Silent);
    let mut shown = Vec::new();
    for k in 1..=24 {
        let pose = UPRIGHT.dragged(by * (f64::from(k.min(16)) / 16.0));
        let poses = deformer
            .change_poses(&deformer.initial_poses(), [("high", pose)])
            .unwrap();
        let settings = SolveSettings::default();
        let shape = deformer
            .solve(&poses, &settings, SolveMode::Drag, &exec, &mut |_| true)
            .unwrap();
        shown = shape.positions.to_vec();
    }
    let [dragged, committed] = [&shown, &first].map(|shape| angle(&deformer, UPRIGHT.dragged(by), shape));
    assert!((dragged - committed).abs() < 0.03, "{dragged} {committed}");
    assert!(
        commit(&mut deformer, UPRIGHT.dragged(by), &pool) == first,
        "the same bits after a drag"
    );
    let one = Pool::new(1).unwrap();
    assert!(
        commit(&mut deformer, UPRIGHT.dragged(by), &one) == first,
        "the same bits on one thread"
    );
}

#[test]
fn what_cannot_turn_is_refused() {
    let pool = Pool::new(1).unwrap();
    let mut deformer = UPRIGHT.deformer(&pool, &["low", "high"]);
    let exec = Exec::new(&pool, &Silent);
    let constrains = HandleConstrains {
        rotation: false,
        ..HandleConstrains::ALL
    };
    let [low, high] = ["low", "high"].map(|id| UPRIGHT.end(id, if id == "low" { -DVec3::Z } else { DVec3::Z }, -0.5));
    let handles = vec![low, Handle { constrains, ..high }];
    deformer.set_handles(handles, &exec).unwrap();
    let refused = deformer.change_poses(&deformer.initial_poses(), [("high", UPRIGHT.dragged(DVec3::X))]);
    assert!(matches!(refused, Err(Error::Invalid { field, .. }) if field == "pose.handles[0].pose.freeRotation"));
}
