//! Models whose triangles cross in the rest pose are freed of that, by little.

use crate::surface_files::file_of_parts;
use glam::DVec3;
use pliant_core::asset::{FileSet, shapes};
use pliant_core::engine::{
    Deformer, DeformerLimits, Edit, EditCommand, EditOutcome, EditedShape, Error, OpenOptions, Region,
    UnintersectCommand,
};
use pliant_core::exec::Exec;
use pliant_core::mesh::BoundingBox;
use pliant_core::pool::Pool;
use pliant_core::progress::{Progress, Silent};

/// Two balls pushed into each other by so much of their diameter.
fn balls(depth: f64) -> FileSet {
    let ball = shapes::icosphere(0.5, 4);
    file_of_parts(&[(&ball, DVec3::ZERO), (&ball, DVec3::new(1.0 - depth, 0.02, 0.01))])
}

/// An arm and a sleeve around it that is rough: it pokes through the arm in many places.
fn arm_in_rough_sleeve() -> FileSet {
    let arm = shapes::cylinder(0.2, 2.0, 40, 80, true);
    let (mut points, triangles) = shapes::cylinder(0.21, 1.0, 40, 40, false);
    for p in &mut points {
        let wave = libm::sin(11.0 * p.x + 3.0 * p.z) * libm::cos(17.0 * p.y - 13.0 * p.z);
        (p.x, p.y) = (p.x * (1.0 + 0.08 * wave), p.y * (1.0 + 0.08 * wave));
    }
    file_of_parts(&[(&arm, DVec3::ZERO), (&(points, triangles), DVec3::Z * 0.5)])
}

fn opened(files: FileSet, exec: &Exec<'_>) -> Deformer {
    Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), exec).expect("a model")
}

fn unintersect(deformer: &mut Deformer, command: UnintersectCommand, exec: &Exec<'_>) -> Result<EditOutcome, Error> {
    let (shape, poses) = (deformer.rest_shape(), deformer.initial_poses());
    let command = EditCommand {
        edit: &Edit::Unintersect(command),
        on: EditedShape::Current,
        shape: &shape,
        poses: &poses,
        settings: None,
    };
    deformer.edit(&command, exec)
}

/// Pairs that cross in the rest pose.
fn pairs(deformer: &Deformer, exec: &Exec<'_>) -> u64 {
    let found = deformer.crossing_pairs(deformer.rest(), 0, exec);
    found.expect("no cancel").at_rest
}

fn codes(done: &EditOutcome) -> Vec<&str> {
    done.report.warnings.iter().map(|w| &*w.code).collect()
}

#[test]
fn what_crosses_at_rest_is_parted_and_sizes_are_kept() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    for (name, files) in [
        ("touching balls", balls(0.05)),
        ("deep balls", balls(0.2)),
        ("sleeve", arm_in_rough_sleeve()),
    ] {
        let before = opened(files.clone(), &exec);
        let mut deformer = opened(files, &exec);
        let done = unintersect(&mut deformer, UnintersectCommand::default(), &exec).expect("an edit");
        let report = done.report.unintersect.expect("a report");
        assert_eq!(report.crossings_before, pairs(&before, &exec), "{name}");
        assert!(report.crossings_before > 50, "{name}: {report:?}");
        assert_eq!((report.crossings, pairs(&deformer, &exec)), (0, 0), "{name}");
        assert_eq!(codes(&done), Vec::<&str>::new(), "{name}");
        assert_eq!(
            done.report.before, done.report.after,
            "{name}: vertices and triangles stay"
        );
        let largest = (before.rest().iter().zip(deformer.rest().iter()))
            .map(|(was, now)| was.distance(*now))
            .fold(0.0, f64::max);
        let reported = report.largest_move * BoundingBox::of(before.rest()).diagonal();
        assert!((reported - largest).abs() < 1e-9, "{name}: {reported} {largest}");
        let quality = before.measure(deformer.rest(), false, &exec).expect("no cancel");
        assert!(
            quality.edge_rms < 0.06 && quality.volume_change.abs() < 0.04 && quality.flipped_triangles == 0,
            "{name}: {quality:?}"
        );
    }
}

#[test]
fn a_sleeve_goes_to_the_side_on_which_most_of_it_is_while_the_arm_is_fixed() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = opened(arm_in_rough_sleeve(), &exec);
    let arm = shapes::cylinder(0.2, 2.0, 40, 80, true).0.len();
    let rest = std::sync::Arc::clone(deformer.rest());
    let command = UnintersectCommand {
        fixed: Some(Region::vertices(0..arm as u32)),
        clearance: Some(0.004),
    };
    let done = unintersect(&mut deformer, command, &exec).expect("an edit");
    assert_eq!(done.report.unintersect.expect("a report").crossings, 0);
    assert_eq!(deformer.rest()[..arm], rest[..arm], "what is fixed keeps its bits");
    // The arm has flat faces between its corners.
    let inside = deformer.rest()[arm..].iter().filter(|p| p.x.hypot(p.y) < 0.199);
    assert_eq!(inside.count(), 0, "all of the sleeve is outside of the arm");
}

#[test]
fn what_crosses_nowhere_keeps_its_bits_and_what_cannot_be_parted_is_named() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut apart = opened(balls(-0.1), &exec);
    let rest = std::sync::Arc::clone(apart.rest());
    let done = unintersect(&mut apart, UnintersectCommand::default(), &exec).expect("an edit");
    assert_eq!(codes(&done), ["unintersect-nothing"]);
    assert_eq!(apart.rest(), &rest);

    let mut held = opened(balls(0.1), &exec);
    let rest = std::sync::Arc::clone(held.rest());
    let before = pairs(&held, &exec);
    let command = UnintersectCommand {
        fixed: Some(Region::half_space([0.0, 0.0, 1.0], -10.0)),
        clearance: None,
    };
    let done = unintersect(&mut held, command, &exec).expect("an edit");
    assert_eq!(codes(&done), ["contact-left"]);
    assert!(
        done.report.warnings[0]
            .message
            .contains(&format!("{before} of {before}"))
    );
    assert_eq!(held.rest(), &rest, "all of it is fixed");
}

#[test]
fn threads_do_not_change_the_result_and_a_caller_may_stop_it() {
    let bits = |threads: usize| {
        let pool = Pool::new(threads).expect("threads");
        let exec = Exec::new(&pool, &Silent);
        let mut deformer = opened(arm_in_rough_sleeve(), &exec);
        let done = unintersect(&mut deformer, UnintersectCommand::default(), &exec).expect("an edit");
        done.report.digest
    };
    assert_eq!(bits(1), bits(3));

    /// Wants no more once surfaces are parted.
    #[derive(Default)]
    struct UntilContact(std::sync::atomic::AtomicBool);
    impl Progress for UntilContact {
        fn report(&self, stage: &'static str, _: f32) {
            self.0
                .fetch_or(stage == "contact", std::sync::atomic::Ordering::Relaxed);
        }
        fn cancelled(&self) -> bool {
            self.0.load(std::sync::atomic::Ordering::Relaxed)
        }
    }
    let pool = Pool::new(1).expect("a thread");
    let mut deformer = opened(arm_in_rough_sleeve(), &Exec::new(&pool, &Silent));
    let rest = std::sync::Arc::clone(deformer.rest());
    let watcher = UntilContact::default();
    let stopped = unintersect(
        &mut deformer,
        UnintersectCommand::default(),
        &Exec::new(&pool, &watcher),
    );
    assert!(matches!(stopped, Err(Error::Cancelled)), "{stopped:?}");
    assert_eq!(deformer.rest(), &rest);
}
