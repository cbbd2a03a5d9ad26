//! Handles with targets: in parts along a stream, committed, undone, and kept in a store.

use super::fake::*;
use super::real::{bar_files, bent_in, manager_of};
use pliant::engine::{Anchor, AnchorCorners, EditedShape, Handle, HandlePose, HandleSet, Region, VertexTargets};
use pliant::session::Manager;
use pliant::wire::{PoseCommit, SessionEdit, StreamRequest, pb, session_edit};

/// Vertices of the bar.
const COUNT: usize = 52;

async fn scanned(manager: &Manager) -> Fixture {
    let fixture = bent_in(manager).await;
    let base = Handle::new("base", Region::half_space([0.0, 0.0, -1.0], -0.3));
    let scan = Handle::with_targets("scan", Region::vertices(0..COUNT as u32), 0.5);
    let told = fixture.set_handles(HandleSet::from([base, scan])).await;
    assert_eq!(told.handles[1].vertices as usize, COUNT);
    fixture
}

/// The bar leant to one side.
fn leaning() -> Vec<[f32; 3]> {
    let text = String::from_utf8(bar_files().main.to_vec()).expect("text");
    let lines = text.lines().filter_map(|line| line.strip_prefix("v "));
    let read = |line: &str| -> Vec<f32> { line.split(' ').map(|v| v.parse().expect("a number")).collect() };
    lines
        .map(read)
        .map(|p| [p[0] + 0.2 * p[2] * p[2], p[1], p[2]])
        .collect()
}

fn targets(positions: &[[f32; 3]], first: Option<u32>) -> HandlePose {
    HandlePose::targets(VertexTargets {
        first,
        ..VertexTargets::of(positions.iter().copied())
    })
}

fn part(seq: u64, pose: HandlePose) -> StreamRequest {
    match posed(seq, vec![("scan".into(), pose)], false) {
        StreamRequest::Pose {
            seq,
            commit,
            key,
            entries,
            ..
        } => StreamRequest::Pose {
            more: true,
            seq,
            commit,
            key,
            entries,
        },
        other => other,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn parts_are_solved_once_and_commits_of_targets_undo_and_reopen_to_the_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let manager = manager_of(folder.path()).await;
    let fixture = scanned(&manager).await;
    let (rest, all) = (fixture.digest().await, leaning());
    let whole = fixture
        .solve(PoseCommit {
            seq: 1,
            changes: vec![("scan".into(), targets(&all, None))],
            options: stream_options(),
        })
        .await;
    assert_ne!(whole.digest, rest);
    fixture.undo().await;
    assert_eq!(fixture.digest().await, rest);

    // In parts, and with a part that does not fit: what it belongs to is refused with it.
    let mut client = fixture.client().await;
    client.push(part(1, targets(&all[..20], Some(40))));
    client.push(posed(2, vec![], true));
    assert_eq!(client.error().await.0, 1);
    assert_eq!(client.error().await.0, 2);
    client.push(part(3, targets(&all[..20], Some(0))));
    client.silent().await;
    client.push(posed(4, vec![("scan".into(), targets(&all[20..], Some(20)))], true));
    assert_eq!(client.frame().await.header.seq, 4);
    client.ack(4);
    drop(client);
    assert_eq!(
        fixture.digest().await,
        whole.digest,
        "the same targets give the same bits"
    );
    fixture.undo().await;
    fixture.redo().await;
    assert_eq!(fixture.digest().await, whole.digest);
    let id = fixture.id.clone();
    drop(fixture);
    close(manager).await;

    let manager = manager_of(folder.path()).await;
    let fixture = Fixture {
        manager: manager.clone(),
        id,
    };
    assert_eq!(fixture.digest().await, whole.digest, "as it was stored");
    fixture.undo().await;
    assert_eq!(fixture.digest().await, rest);
    fixture.redo().await;
    assert_eq!(fixture.digest().await, whole.digest);
    close(manager).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn anchors_and_planes_reopen_to_the_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let manager = manager_of(folder.path()).await;
    let fixture = scanned(&manager).await;
    let anchor = |face: u32| Anchor {
        corners: AnchorCorners::Face(face),
        weights: [0.2, 0.3, 0.5],
    };
    let marks = Region::Anchors((0..90).step_by(7).map(anchor).collect());
    let plane = Handle {
        tangential: 0.75,
        ..Handle::with_targets("plane", Region::vertices(0..COUNT as u32), 0.5)
    };
    let marks = Handle::with_targets("marks", marks, 3.0);
    let told = fixture.set_handles(HandleSet::from([marks, plane])).await;
    assert_eq!(told.handles[0].vertices, 13);
    let all = leaning();
    let places: Vec<[f32; 3]> = all[..13].to_vec();
    let across = VertexTargets::of(all).across(std::iter::repeat_n([0.1, 1.0, 0.2], COUNT));
    let solved = fixture
        .solve(PoseCommit {
            seq: 1,
            changes: vec![
                ("marks".into(), targets(&places, None)),
                ("plane".into(), HandlePose::targets(across)),
            ],
            options: stream_options(),
        })
        .await;
    let (id, digest) = (fixture.id.clone(), solved.digest.clone());
    drop(fixture);
    close(manager).await;
    let manager = manager_of(folder.path()).await;
    let fixture = Fixture {
        manager: manager.clone(),
        id,
    };
    assert_eq!(fixture.digest().await, digest, "as it was stored");
    fixture.undo().await;
    assert_ne!(fixture.digest().await, digest);
    fixture.redo().await;
    assert_eq!(fixture.digest().await, digest);
    close(manager).await;
}

/// An edit that adopts positions, or a part of them.
fn adopted(positions: &[[f32; 3]], first: u32, more: bool) -> SessionEdit {
    session_edit(&part_of("mine", positions, first, more)).expect("an edit")
}

fn part_of(shape: &str, positions: &[[f32; 3]], first: u32, more: bool) -> pb::EditRequest {
    let bytes: Vec<u8> = positions.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    let adopt = pb::edit_request::Adopt {
        positions: bytes.into(),
        first,
        more,
        shape: shape.into(),
    };
    pb::EditRequest {
        operation: Some(pb::edit_request::Operation::Adopt(adopt)),
        ..Default::default()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shape_in_parts_is_adopted_once_whole_and_undoes_and_reopens_to_the_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let manager = manager_of(folder.path()).await;
    let fixture = scanned(&manager).await;
    let (rest, all) = (fixture.digest().await, leaning());
    let edit = async |edit: SessionEdit| manager.edit(tenant(), &fixture.id, edit, None).await;
    edit(adopted(&all[..30], 0, true)).await.expect("kept");
    assert_eq!(fixture.digest().await, rest, "nothing changes before the last part");
    let field = |refused: Result<pb::EditResult, pliant::session::Error>| refused.expect_err("refused").field;
    assert_eq!(
        field(edit(adopted(&all[31..], 31, false)).await).as_deref(),
        Some("adopt.first")
    );
    // What was kept is gone with it, and with any other change.
    assert_eq!(
        field(edit(adopted(&all[30..], 30, false)).await).as_deref(),
        Some("adopt.first")
    );
    edit(adopted(&all[..30], 0, true)).await.expect("kept");
    fixture.undo().await;
    fixture.redo().await;
    fixture
        .solve(PoseCommit {
            seq: 1,
            changes: Vec::new(),
            options: stream_options(),
        })
        .await;
    assert_eq!(
        field(edit(adopted(&all[30..], 30, false)).await).as_deref(),
        Some("adopt.first")
    );
    fixture.undo().await;
    let many = [&all[..], &all[..]].concat();
    assert_eq!(
        field(edit(adopted(&many, 0, true)).await).as_deref(),
        Some("adopt.positions")
    );

    // Parts of two callers do not mix: those of the later shape stay.
    let theirs = |positions, first, more| session_edit(&part_of("theirs", positions, first, more)).expect("an edit");
    edit(theirs(&all[..20], 0, true)).await.expect("kept");
    edit(adopted(&all[..30], 0, true)).await.expect("kept");
    assert_eq!(
        field(edit(theirs(&all[20..], 20, false)).await).as_deref(),
        Some("adopt.first")
    );
    let unnamed = session_edit(&part_of("", &all[..30], 0, true)).expect_err("refused");
    assert!(unnamed.to_string().starts_with("adopt.shape: "), "{unnamed}");
    let mut on_rest = adopted(&all[30..], 30, false);
    on_rest.on = EditedShape::Rest;
    assert_eq!(field(edit(on_rest).await).as_deref(), Some("on"));
    edit(adopted(&all[..30], 0, true)).await.expect("kept");
    edit(adopted(&all[30..40], 30, true)).await.expect("kept");
    let done = edit(adopted(&all[40..], 40, false)).await.expect("adopted");
    let whole = fixture.digest().await;
    assert_ne!(whole, rest);
    fixture.undo().await;
    let at_once = edit(adopted(&all, 0, false)).await.expect("adopted");
    assert_eq!((at_once.digest, &whole), (done.digest, &fixture.digest().await));
    let id = fixture.id.clone();
    drop(fixture);
    close(manager).await;

    let manager = manager_of(folder.path()).await;
    let fixture = Fixture {
        manager: manager.clone(),
        id,
    };
    assert_eq!(fixture.digest().await, whole, "as it was stored");
    fixture.undo().await;
    assert_eq!(fixture.digest().await, rest);
    fixture.redo().await;
    assert_eq!(fixture.digest().await, whole);
    close(manager).await;
}
