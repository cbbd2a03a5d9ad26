//! The same promises with the engine that users get.

use super::fake::*;
use pliant::asset::FileSet;
use pliant::engine::{Handle, HandlePose, HandleSet, Region};
use pliant::session::store::StoreLocation;
use pliant::session::{Manager, OpenDeformer, SessionConfig};
use pliant::wire::frames::{FrameOutput, encode};
use pliant::wire::{DeformOptions, PoseCommit, StreamRequest, pb};
use std::path::Path;
use std::sync::Arc;

/// An upright bar of square section, closed, with the handles `base` (held) and `top`.
pub fn bar_files() -> FileSet {
    let mut text = String::new();
    let (rings, corners) = (12, [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]);
    for k in 0..=rings {
        for (x, y) in corners {
            text += &format!("v {x} {y} {}\n", f64::from(k) * 0.25);
        }
    }
    for k in 0..rings {
        for c in 0..4 {
            let at = |k: i32, c: i32| k * 4 + c % 4 + 1;
            text += &format!(
                "f {} {} {} {}\n",
                at(k, c),
                at(k, c + 1),
                at(k + 1, c + 1),
                at(k + 1, c)
            );
        }
    }
    text += &format!(
        "f 4 3 2 1\nf {} {} {} {}\n",
        rings * 4 + 1,
        rings * 4 + 2,
        rings * 4 + 3,
        rings * 4 + 4
    );
    FileSet::single("bar.obj", text.into_bytes())
}

/// A manager of real engines whose sessions are kept in a folder.
pub async fn manager_of(folder: &Path) -> Manager {
    let location = StoreLocation {
        build: Some("one".into()),
        ..StoreLocation::in_folder(folder)
    };
    let store = Arc::new(store_at(&location).await);
    let manager = Manager::with_store(SessionConfig::default(), OpenDeformer, store).await;
    manager.expect("a store")
}

/// A session with a bar and its handles.
pub async fn bent(config: SessionConfig) -> Fixture {
    bent_in(&Manager::new(config).expect("a valid configuration")).await
}

/// As [`bent`], in a manager that there is.
pub async fn bent_in(manager: &Manager) -> Fixture {
    let made = manager.create(tenant(), bar_files(), options(), None).await;
    let (manager, id) = (manager.clone(), made.expect("a bar").value.id);
    let fixture = Fixture { manager, id };
    let handles = HandleSet::from([
        Handle::new("base", Region::half_space([0.0, 0.0, -1.0], -0.3)),
        Handle::new("top", Region::half_space([0.0, 0.0, 1.0], 2.7)),
    ]);
    fixture.set_handles(handles).await;
    fixture
}

/// The top's turn about x; none is in the rest pose.
fn turn(angle: f64) -> Vec<(String, HandlePose)> {
    let pose = match angle {
        0.0 => HandlePose::default(),
        angle => HandlePose::rotation([angle, 0.0, 0.0]),
    };
    vec![("top".into(), pose)]
}

pub fn turned(angle: f64) -> PoseCommit {
    PoseCommit {
        seq: 4,
        changes: turn(angle),
        options: stream_options(),
    }
}

/// The same along a stream.
pub fn turning(seq: u64, angle: f64, commit: bool) -> StreamRequest {
    posed(seq, turn(angle), commit)
}

#[tokio::test]
async fn commits_undo_and_replay_to_the_bit() {
    for snapshot_bytes in [1 << 24, 0] {
        let fixture = bent(limits(|config| config.snapshot_bytes = snapshot_bytes)).await;
        let session = fixture.facts().await;
        assert_eq!((session.handles.len(), session.primitives.len()), (2, 1));
        assert!(
            ["read", "mesh", "hierarchy", "fields"]
                .iter()
                .all(|s| session.build_ms.contains_key(*s)),
            "{session:?}"
        );
        let rest = fixture.export(None).await.written.main;
        assert_eq!(rest, bar_files().main, "an undeformed model is written byte for byte");
        let first = fixture.solve(turned(1.0)).await;
        assert_ne!(fixture.export(None).await.written.main, rest);
        let second = fixture.solve(turned(-0.5)).await;
        let mut client = fixture.client().await;
        for (seq, angle) in [(1, 0.2), (2, 0.9)] {
            client.push(turning(seq, angle, false));
            let frame = client.frame().await.header;
            assert!(frame.r#final && frame.residual <= 1e-4 && frame.max_error.is_finite());
            client.ack(seq);
        }
        drop(client);
        fixture.undo().await;
        let view = fixture.history().await;
        assert_eq!(fixture.digest().await, first.digest);
        let again = fixture.solve(turned(-0.5)).await;
        assert_eq!(
            again.digest, second.digest,
            "the same handles, poses and settings give the same bits"
        );
        let home = fixture.solve(turned(0.0)).await;
        assert_eq!(home.digest, view.commits[0].digest, "at rest nothing moves");
        assert_eq!(fixture.export(None).await.written.main, rest);
    }
}

#[tokio::test]
async fn a_set_that_is_sent_again_turns_nothing_that_it_does_not_name() {
    let fixture = bent(SessionConfig::default()).await;
    fixture.solve(turned(0.8)).await;
    let top = |pose: HandlePose| Handle {
        pose: Some(pose),
        ..Handle::new("top", Region::half_space([0.0, 0.0, 1.0], 2.7))
    };
    let base = || Handle::new("base", Region::half_space([0.0, 0.0, -1.0], -0.3));
    let ring = || Handle::new("ring", Region::vertices(28..32));
    let turn = HandlePose::rotation([0.8, 0.0, 0.0]);
    let still = PoseCommit {
        changes: vec![],
        ..turned(0.0)
    };
    let before = fixture.positions().await;
    // The ring lies where the top has turned about: the joint moves up. Then it is taken away, and the joint moves back.
    for set in [vec![base(), top(turn.clone()), ring()], vec![base(), top(turn)]] {
        fixture.set_handles(HandleSet::from(set)).await;
        fixture.solve(still.clone()).await;
        assert_eq!(
            fixture.positions().await.bytes[44 * 12..],
            before.bytes[44 * 12..],
            "the top stays where it is"
        );
    }
    let further = HandlePose::rotation([0.9, 0.0, 0.0]);
    fixture
        .set_handles(HandleSet::from([base(), ring(), top(further)]))
        .await;
    let told = fixture.facts().await;
    assert!(told.handles[2].pose.as_ref().is_some_and(|pose| pose.pivot.is_empty()));
}

#[tokio::test]
async fn a_turn_that_was_found_is_told_and_a_commit_goes_on_from_that_of_the_drag() {
    let fixture = bent(SessionConfig::default()).await;
    let aside = HandlePose::translation([1.2, 0.0, -0.3]).turning_freely();
    let mut client = fixture.client().await;
    let mut dragged = Vec::new();
    for seq in 1..=8 {
        client.push(posed(seq, vec![("top".into(), aside.clone())], false));
        dragged = client.frame().await.header.found_turns;
        client.ack(seq);
    }
    assert_eq!((dragged.len(), dragged[0].id.as_str()), (1, "top"));
    drop(client);
    let turn = |found: &pb::FoundTurn| glam::DVec3::from_slice(&found.rotation_vector);
    assert!(
        turn(&dragged[0]).length() > 0.2,
        "dragged aside, the top turns: {dragged:?}"
    );
    // Said as where the search begins, it is what the commit finds, but for its finer steps.
    let rest = fixture.positions().await;
    let commit = PoseCommit {
        changes: vec![("top".into(), aside.rotated(turn(&dragged[0])))],
        ..turned(0.0)
    };
    let solved = fixture.solve(commit.clone()).await;
    let found = turn(&solved.frame.header.found_turns[0]);
    assert!(found.distance(turn(&dragged[0])) < 0.02, "{found} after {dragged:?}");
    let facts = fixture.facts().await;
    assert_eq!(facts.handles[1].found_turn, found.to_array());
    assert!(facts.handles[0].found_turn.is_empty());
    // It is how the region lies: turned by that about its middle.
    let read = |bytes: &[u8]| -> Vec<glam::DVec3> {
        let numbers = bytes
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]).into());
        let numbers: Vec<f64> = numbers.collect();
        numbers.chunks_exact(3).map(glam::DVec3::from_slice).collect()
    };
    let now = read(&fixture.positions().await.bytes);
    let rotation = glam::DQuat::from_scaled_axis(found);
    let [at_rest, lies] = [read(&rest.bytes), now].map(|shape| shape[51] - shape[48]);
    assert!((rotation * at_rest).distance(lies) < 1e-5, "{lies}");
    // The same pose recorded again is the same bits; undone, nothing is turned.
    assert_eq!(fixture.undo().await.handles[1].found_turn, Vec::<f64>::new());
    assert_eq!(fixture.solve(commit).await.digest, solved.digest);
}

#[tokio::test]
async fn frames_carry_normals_that_turn_with_the_shape() {
    let fixture = bent(small()).await;
    let mut request = turned(1.0);
    request.options.output.normals = true;
    request.options.output.tangents = true;
    request.options.progressive = true;
    let solved = fixture.solve(request).await;
    let frames: Vec<_> = encode(solved.frame).collect();
    let attributes: Vec<i32> = frames.iter().map(|f| f.attribute).collect();
    assert_eq!(attributes, [0, 1, 2]);
    assert!(frames.iter().all(|f| f.seq == 4 && f.r#final && f.vertex_count == 52));
    let numbers = frames[1]
        .data
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let numbers: Vec<f32> = numbers.collect();
    for normal in numbers.chunks_exact(3) {
        let length = normal.iter().map(|x| x * x).sum::<f32>();
        assert!((length - 1.0).abs() < 1e-3, "{normal:?}");
    }
    let repeat = fixture.solve(turned(1.0)).await;
    assert_eq!(
        repeat.digest, solved.digest,
        "what frames carry does not change the shape"
    );
}

#[tokio::test]
async fn every_commit_is_measured_and_crossings_are_counted_when_asked() {
    let fixture = bent(small()).await;
    let options = |self_intersections: bool| DeformOptions {
        output: FrameOutput {
            self_intersections,
            ..Default::default()
        },
        ..stream_options()
    };
    let solve = async |angle: f64, count: bool| {
        let request = PoseCommit {
            options: options(count),
            ..turned(angle)
        };
        let solved = fixture.solve(request).await;
        solved.frame.header.quality.expect("a commit is measured")
    };
    let home = solve(0.0, true).await;
    assert_eq!(
        (home.edge_rms, home.volume_change, home.self_intersections),
        (0.0, 0.0, Some(0))
    );
    let plain = solve(1.0, false).await;
    assert!(plain.edge_rms > 0.0 && plain.max_stretch > 1.0 && plain.self_intersections.is_none());
    let counted = solve(1.0, true).await;
    assert_eq!(
        counted,
        pb::Quality {
            self_intersections: Some(0),
            new_self_intersections: Some(0),
            ..plain
        }
    );

    // On a stream commits are measured, and drags are not.
    let mut client = fixture.client().await;
    client.options(|asked| *asked = options(true));
    for (seq, commit) in [(1, false), (2, true)] {
        client.push(turning(seq, 1.0, commit));
        let frame = client.frame().await.header;
        assert_eq!(frame.quality, commit.then_some(counted), "pose {seq}");
        client.ack(seq);
    }
}
