//! The commits of a session compared with a plain list of what happened to it.

use super::*;
use glam::DVec3;
use proptest::prelude::*;

fn history(limit: usize, snapshot_bytes: u64) -> CommitHistory {
    let rest = ModelShape::from_positions(Arc::new(vec![DVec3::ZERO; 10]));
    CommitHistory::new(
        EditedState {
            topology: None,
            diagonal: 1.0,
            handles: HandleSet::default(),
            poses: HandlePoses::default(),
            facts: Box::default(),
            digest: "rest".into(),
            solved_with: None,
        },
        rest,
        limit,
        snapshot_bytes,
    )
}

fn pose(history: &mut CommitHistory, x: f64) {
    let shape = ModelShape::from_positions(Arc::new(vec![DVec3::splat(x); 10]));
    history.commit_pose(PosedState {
        chain: PoseChain::default(),
        warnings: Vec::new(),
        found_turns: Vec::new(),
        shape: Some(shape),
        digest: format!("{x}"),
    });
}

#[test]
fn handles_keep_the_shape_and_undone_commits_go_when_a_new_one_comes() {
    let mut history = history(10, 1 << 20);
    pose(&mut history, 1.0);
    history.commit_handles(HandleSet::default(), HandlePoses::default(), Box::default());
    assert_eq!(history.current().digest, "1");
    let back = history.undo_target().expect("two commits");
    let shape = history
        .shape(history.state(back).expect("kept").shape)
        .expect("snapshot");
    history.go_to_commit(back, shape);
    assert_eq!(history.redo_target(), Some(2));
    pose(&mut history, 2.0);
    let said = history.show();
    let kinds: Vec<&str> = said.list.iter().map(|c| c.kind.as_str()).collect();
    assert_eq!((kinds, said.current), (vec!["create", "pose", "pose"], 5));
    assert!(history.redo_target().is_none());
}

#[test]
fn old_snapshots_give_way_to_their_recipes_but_not_the_current_one() {
    let mut history = history(10, 500);
    (1..=4).for_each(|x| pose(&mut history, f64::from(x)));
    assert!(history.byte_size() <= 500);
    let shape = |index: usize| history.shape(history.state(index).expect("kept").shape);
    assert!(matches!(shape(1), Err(ShapeRecipe::Solved { .. })));
    assert_eq!(shape(4).expect("current")[0], DVec3::splat(4.0));
    assert_eq!(shape(0).expect("the rest shape costs nothing")[0], DVec3::ZERO);
}

#[test]
fn the_oldest_commits_are_folded() {
    let mut history = history(2, 1 << 20);
    (1..=5).for_each(|x| pose(&mut history, f64::from(x)));
    let digests: Vec<String> = history.show().list.iter().map(|c| c.digest.clone()).collect();
    assert_eq!(digests, ["3", "4", "5"]);
    assert_eq!(history.shapes.len(), 3);
}

/// Bytes of handles and poses, recounted.
fn counted_log_bytes(history: &CommitHistory) -> u64 {
    let mut last = None;
    let each = history.records.iter().map(|record| {
        let handles = record.state.handles.as_ref();
        let is_new = last.replace(handles.id) != Some(handles.id);
        let set = if is_new { handle_bytes(&record.state) } else { 0 };
        set + record.state.poses.0.len() as u64 * POSE_BYTES
    });
    each.sum()
}

proptest! {
    /// Against a plain list of everything that happened: the current digest, the order of the commits and the revision
    /// are what they should be, whatever the order of commands.
    #[test]
    fn any_order_of_commands_keeps_the_books(commands in prop::collection::vec(0u8..4, 0..60), limit in 1usize..6) {
        let mut history = history(limit, 600);
        let (mut model, mut at, mut revision) = (vec![("rest".to_owned(), 1u64)], 0usize, 1u64);
        for (k, command) in commands.into_iter().enumerate() {
            let step = match command {
                0 => {
                    pose(&mut history, k as f64);
                    Some(format!("{}", k as f64))
                }
                1 => {
                    history.commit_handles(HandleSet::default(), HandlePoses::default(), Box::default());
                    Some(model[at].0.clone())
                }
                2 => {
                    prop_assert_eq!(history.undo_target().is_some(), at > 0);
                    if let Some(back) = history.undo_target() {
                        let shape = history.shape(history.state(back).expect("kept").shape).unwrap_or_else(|_| ModelShape::from_positions(Arc::default()));
                        history.go_to_commit(back, shape);
                        at -= 1;
                        revision += 1;
                    }
                    None
                }
                _ => {
                    prop_assert_eq!(history.redo_target().is_some(), at + 1 < model.len());
                    if let Some(next) = history.redo_target() {
                        let shape = history.shape(history.state(next).expect("kept").shape).unwrap_or_else(|_| ModelShape::from_positions(Arc::default()));
                        history.go_to_commit(next, shape);
                        at += 1;
                        revision += 1;
                    }
                    None
                }
            };
            if let Some(digest) = step {
                revision += 1;
                model.truncate(at + 1);
                model.push((digest, revision));
                at += 1;
                if model.len() > limit + 1 {
                    model.remove(0);
                    at -= 1;
                }
            }
            let said = history.show();
            prop_assert_eq!(said.current, model[at].1);
            prop_assert_eq!(history.revision(), revision);
            prop_assert_eq!(&history.current().digest, &model[at].0);
            let commits: Vec<_> = said.list.iter().map(|c| (c.digest.clone(), c.revision)).collect();
            prop_assert_eq!(&commits, &model);
            prop_assert!(history.shape(history.current().shape).is_ok(), "the current shape is at hand");
            prop_assert_eq!(history.held_log_bytes, counted_log_bytes(&history));
            let snapshots: u64 = history.shapes.values().map(RecordedShape::snapshot_bytes).sum();
            prop_assert_eq!(history.held_snapshot_bytes, snapshots);
            let uses: usize = history.shapes.values().map(|shape| shape.uses).sum();
            prop_assert_eq!(uses, history.records.len());
        }
    }
}
