//! Faces too large for a bend are reported, and divided on request.

use super::models::{LongSide, open_shape};
use glam::DVec3;
use pliant_core::asset::shapes;
use pliant_core::engine::{
    Deformer, Edit, EditCommand, EditOutcome, EditedShape, Error, HandlePoses, ModelShape, QualityReport,
    RemeshCommand, SolveMode, SolveSettings,
};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

/// A bar whose sides have no vertex between its ends.
fn bare_bar() -> shapes::Shape {
    shapes::box_with_cells(DVec3::new(1.0, 1.0, 6.0), [2, 2, 1])
}

fn codes(deformer: &Deformer) -> Vec<String> {
    deformer.facts().warnings.into_iter().map(|w| w.code).collect()
}

struct BentBar {
    deformer: Deformer,
    poses: HandlePoses,
    shape: ModelShape,
}

fn bend(shape: &shapes::Shape, angle: f64, exec: &Exec<'_>) -> BentBar {
    let mut deformer = open_shape(&shape.0, &shape.1, exec);
    let (poses, shape) = hold_and_bend(&mut deformer, angle, exec);
    BentBar { deformer, poses, shape }
}

/// Holds both ends of what is in the rest pose and turns one.
fn hold_and_bend(deformer: &mut Deformer, angle: f64, exec: &Exec<'_>) -> (HandlePoses, ModelShape) {
    let side = LongSide::of(deformer.rest());
    side.hold_ends(deformer, exec).expect("handles");
    let turned = side.turn(angle).about(side.middle_of_top(deformer.rest()));
    let poses = deformer
        .change_poses(&deformer.initial_poses(), [("top", turned)])
        .expect("a pose");
    let settings = SolveSettings::default();
    let shape = deformer.solve(&poses, &settings, SolveMode::Commit, exec, &mut |_| true);
    (poses, shape.expect("the pose solves"))
}

/// The quality of a bend with handles that hold what their regions hold now.
fn quality_of_bend(deformer: &mut Deformer, angle: f64, exec: &Exec<'_>) -> QualityReport {
    let (_, shape) = hold_and_bend(deformer, angle, exec);
    deformer.quality(&shape.positions, exec.pool)
}

fn divide(bar: &mut BentBar, exec: &Exec<'_>) -> EditOutcome {
    edit_at_rest(bar, &Edit::SubdivideForPose { region: None }, exec)
}

fn edit_at_rest(bar: &mut BentBar, edit: &Edit, exec: &Exec<'_>) -> EditOutcome {
    let command = EditCommand {
        edit,
        on: EditedShape::Rest,
        shape: &bar.shape,
        poses: &bar.poses,
        settings: Some(&SolveSettings::default()),
    };
    bar.deformer.edit(&command, exec).expect("the bar is edited")
}

#[test]
fn faces_too_large_for_a_bend_are_reported_before_and_after_and_divided_in_one_edit() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let shape = bare_bar();
    let mut bar = bend(&shape, 0.7, &exec);
    assert!(
        codes(&bar.deformer).contains(&"faces-too-large".to_owned()),
        "{:?}",
        codes(&bar.deformer)
    );
    let before = bar.deformer.quality(&bar.shape.positions, &pool);
    assert!(before.faces_too_large > 0, "{before:?}");

    let outcome = divide(&mut bar, &exec);
    assert!(!codes(&bar.deformer).contains(&"faces-too-large".to_owned()));
    let after = bar.deformer.quality(&outcome.shape.positions, &pool);
    assert_eq!(after.faces_too_large, 0, "{after:?}");
    assert!(
        after.volume_change.abs() < 0.5 * before.volume_change.abs(),
        "{before:?} {after:?}"
    );
    assert!(
        bar.deformer.report().closed,
        "no gap opens between divided faces and others"
    );
    // Old vertices are where they were, new ones on the old faces.
    let old = &outcome.report.kept;
    assert_eq!(old.iter().map(|run| run.count).sum::<u32>() as usize, shape.0.len());
    for run in old {
        for k in 0..run.count {
            assert_eq!(
                bar.deformer.rest()[(run.now + k) as usize],
                shape.0[(run.was + k) as usize]
            );
        }
    }
    let low = shape.0.iter().fold(shape.0[0], |a, b| a.min(*b));
    let high = shape.0.iter().fold(shape.0[0], |a, b| a.max(*b));
    let on_a_face = |p: &DVec3| (0..3).any(|k| p[k] == low[k] || p[k] == high[k]);
    assert!(bar.deformer.rest().iter().all(on_a_face));

    // Fields on finer faces differ a little; what is left to do once more is no more than what was done.
    let first = outcome.report.after.faces;
    bar.shape.id = outcome.shape.id;
    bar.shape.positions = outcome.shape.positions;
    let again = divide(&mut bar, &exec);
    assert!(
        again.report.after.faces < 2 * first,
        "{first} then {}",
        again.report.after.faces
    );
}

/// A rod of 24 sides that go from end to end.
fn bare_rod() -> shapes::Shape {
    shapes::cylinder(0.5, 6.0, 24, 1, true)
}

#[test]
fn long_faces_lose_no_more_volume_in_a_bend_than_a_remesh_does() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    for shape in [bare_rod(), shapes::box_with_cells(DVec3::new(1.0, 1.0, 6.0), [1, 1, 1])] {
        let mut bar = bend(&shape, 0.8, &exec);
        let before = bar.deformer.quality(&bar.shape.positions, &pool);
        divide(&mut bar, &exec);
        let divided = quality_of_bend(&mut bar.deformer, 0.8, &exec);
        assert_eq!(divided.faces_too_large, 0, "{divided:?}");

        let mut bar = bend(&shape, 0.8, &exec);
        let even = RemeshCommand {
            edge_length: Some(0.2),
            ..RemeshCommand::default()
        };
        edit_at_rest(&mut bar, &Edit::Remesh(even), &exec);
        let remeshed = quality_of_bend(&mut bar.deformer, 0.8, &exec);
        let [divided, remeshed] = [divided, remeshed].map(|q| q.volume_change);
        assert!(
            divided.abs() < remeshed.abs() + 0.01 && divided.abs() < 0.5 * before.volume_change.abs(),
            "{divided} divided, {remeshed} remeshed, {} before",
            before.volume_change
        );
    }
}

#[test]
fn a_larger_turn_asks_for_smaller_faces_and_no_handles_for_none() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let faces = [0.2, 1.2, 3.0].map(|angle| {
        let mut bar = bend(&bare_bar(), angle, &exec);
        divide(&mut bar, &exec).report.after.faces
    });
    assert!(faces[0] < faces[1] && faces[1] < faces[2], "{faces:?}");

    let mut bar = bend(&bare_bar(), 1.0, &exec);
    bar.deformer.set_handles(Vec::new(), &exec).expect("no handles");
    let command = EditCommand {
        edit: &Edit::SubdivideForPose { region: None },
        on: EditedShape::Rest,
        shape: &bar.deformer.rest_shape(),
        poses: &bar.deformer.initial_poses(),
        settings: None,
    };
    let refused = bar
        .deformer
        .edit(&command, &exec)
        .expect_err("nothing says what is large");
    assert!(matches!(refused, Error::Precondition(_)), "{refused}");
}

#[test]
fn a_fine_mesh_has_no_large_faces() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let bar = bend(
        &shapes::box_with_cells(DVec3::new(1.0, 1.0, 6.0), [5, 5, 30]),
        0.5,
        &exec,
    );
    assert!(!codes(&bar.deformer).contains(&"faces-too-large".to_owned()));
    assert_eq!(bar.deformer.quality(&bar.shape.positions, &pool).faces_too_large, 0);
}
