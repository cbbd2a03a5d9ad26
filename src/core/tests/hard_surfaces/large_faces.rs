//! Faces too large for a bend are told, and divided on request.

use crate::bend::LongSide;
use crate::models::open_shape;
use glam::DVec3;
use pliant_core::asset::shapes;
use pliant_core::engine::{
    Deformer, Edit, EditCommand, EditOutcome, EditedShape, Error, HandlePoses, SolveMode, SolveSettings, SolvedShape,
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
    shape: SolvedShape,
}

fn bend(shape: &shapes::Shape, angle: f64, exec: &Exec<'_>) -> BentBar {
    let mut deformer = open_shape(&shape.0, &shape.1, exec);
    let side = LongSide::of(&shape.0);
    side.hold_ends(&mut deformer, exec).expect("handles");
    let poses = deformer
        .change_poses(&deformer.initial_poses(), [("top", side.turn(angle))])
        .expect("a pose");
    let shape = deformer
        .solve(&poses, &SolveSettings::default(), SolveMode::Commit, exec, &mut |_| {
            true
        })
        .expect("the pose solves");
    BentBar { deformer, poses, shape }
}

fn divide(bar: &mut BentBar, exec: &Exec<'_>) -> EditOutcome {
    let command = EditCommand {
        edit: &Edit::SubdivideForPose { region: None },
        on: EditedShape::Rest,
        shape: &bar.shape.shape(),
        poses: &bar.poses,
        settings: Some(&SolveSettings::default()),
    };
    bar.deformer.edit(&command, exec).expect("the bar is divided")
}

#[test]
fn faces_too_large_for_a_bend_are_told_before_and_after_and_divided_in_one_edit() {
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
