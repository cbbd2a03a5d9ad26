//! Edits in sessions: one commit each, undone and redone to the bit, refused whole.

use super::fake::*;
use super::real::{bent, turned};
use pliant::session::{ErrorCode, Manager, SessionConfig};
use pliant::wire::pb;

fn cut(id: &str, height: f64, keep: pb::edit_request::cut::Keep) -> pb::EditRequest {
    let cut = pb::edit_request::Cut {
        plane: Some(pb::Plane {
            normal: vec![0.0, 0.0, 1.0],
            offset: height,
        }),
        keep: keep.into(),
        fill: true,
        ..Default::default()
    };
    pb::EditRequest {
        session_id: id.into(),
        operation: Some(pb::edit_request::Operation::Cut(cut)),
        ..Default::default()
    }
}

use pb::edit_request::cut::Keep;

async fn digest_now(manager: &Manager, id: &str) -> String {
    let view = manager.history(tenant(), id).await.expect("open");
    let at = view.commits.iter().find(|c| c.revision == view.current);
    at.expect("listed").digest.clone()
}

#[tokio::test]
async fn edits_are_undone_and_redone_to_the_bit_and_go_on_alike() {
    for snapshot_bytes in [1 << 24, 0] {
        let config = SessionConfig {
            snapshot_bytes,
            ..small()
        };
        let manager = Manager::new(config).expect("valid");
        let (id, _) = bent(&manager).await;
        let mut digests = vec![digest_now(&manager, &id).await];
        let mut said = Vec::new();
        let bent = manager.solve(tenant(), turned(&id, 0.6), None).await.expect("solved");
        digests.push(bent.digest);
        for height in [0.75, 1.4] {
            let result = manager
                .edit(tenant(), cut(&id, height, Keep::Above), None)
                .await
                .expect("cut");
            assert!(result.after.expect("counts").vertices != result.before.expect("counts").vertices);
            assert_eq!(
                result.revision,
                manager.history(tenant(), &id).await.expect("open").current
            );
            said.push(result.after.expect("counts").vertices);
            digests.push(result.digest);
            let moved = manager.solve(tenant(), turned(&id, 0.3), None).await;
            // The base was cut off with the first edit, and what is left is held by the top alone.
            digests.push(moved.expect("solved").digest);
        }
        for digest in digests.iter().rev().skip(1) {
            manager.undo(tenant(), &id, None).await.expect("undone");
            assert_eq!(digest_now(&manager, &id).await, *digest);
        }
        let described = manager.get(tenant(), &id).await.expect("open");
        assert_eq!(described.model.expect("facts").vertices, 52);
        for digest in &digests[1..] {
            manager.redo(tenant(), &id, None).await.expect("redone");
            assert_eq!(digest_now(&manager, &id).await, *digest);
        }
        let described = manager.get(tenant(), &id).await.expect("open");
        assert_eq!(described.model.expect("facts").vertices, said[1]);
        let again = manager.solve(tenant(), turned(&id, 0.3), None).await.expect("solved");
        assert_eq!(
            again.digest,
            *digests.last().expect("some"),
            "the same pose gives the same bits"
        );
        let kinds: Vec<String> = (manager.history(tenant(), &id).await.expect("open").commits.into_iter())
            .map(|c| c.kind)
            .collect();
        assert_eq!(kinds[2..5], ["pose", "edit", "pose"]);
    }
}

#[tokio::test]
async fn a_refused_edit_changes_nothing() {
    let manager = Manager::new(small()).expect("valid");
    let (id, _) = bent(&manager).await;
    let before = (
        manager.get(tenant(), &id).await.expect("open").revision,
        digest_now(&manager, &id).await,
    );
    let missed = manager
        .edit(tenant(), cut(&id, 99.0, Keep::Both), None)
        .await
        .expect_err("misses");
    assert_eq!(missed.code, ErrorCode::FailedPrecondition);
    let merge = pb::edit_request::Merge {
        source: Some(pb::edit_request::merge::Source::Session("nobody".into())),
        ..Default::default()
    };
    let request = pb::EditRequest {
        session_id: id.clone(),
        operation: Some(pb::edit_request::Operation::Merge(merge)),
        ..Default::default()
    };
    let unknown = manager
        .edit(tenant(), request, None)
        .await
        .expect_err("no such session");
    assert_eq!(unknown.code, ErrorCode::NotFound);
    let after = (
        manager.get(tenant(), &id).await.expect("open").revision,
        digest_now(&manager, &id).await,
    );
    assert_eq!(before, after);
}

#[tokio::test]
async fn an_edit_repeated_under_its_key_is_done_once() {
    let manager = Manager::new(small()).expect("valid");
    let (id, _) = bent(&manager).await;
    let request = cut(&id, 1.4, Keep::Below);
    let first = manager.edit(tenant(), request.clone(), Some("k")).await.expect("cut");
    let second = manager
        .edit(tenant(), request, Some("k"))
        .await
        .expect("the kept answer");
    assert_eq!(first, second);
    assert_eq!(manager.get(tenant(), &id).await.expect("open").revision, first.revision);
}

#[tokio::test]
async fn a_session_can_be_merged_with_another_of_its_tenant() {
    let manager = Manager::new(small()).expect("valid");
    let (id, _) = bent(&manager).await;
    let (other, _) = bent(&manager).await;
    let merge = pb::edit_request::Merge {
        source: Some(pb::edit_request::merge::Source::Session(other)),
        how: pb::edit_request::merge::How::Loose.into(),
        transform: vec![1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 3., 0., 0., 1.],
        ..Default::default()
    };
    let request = pb::EditRequest {
        session_id: id.clone(),
        operation: Some(pb::edit_request::Operation::Merge(merge)),
        ..Default::default()
    };
    let result = manager.edit(tenant(), request, None).await.expect("merged");
    assert_eq!(result.after.expect("counts").vertices, 104);
    let session = manager.get(tenant(), &id).await.expect("open");
    assert_eq!(
        (session.solver.expect("facts").components, session.primitives.len()),
        (2, 2)
    );
    assert_eq!(result.handles_kept, ["base", "top"]);
}

#[tokio::test]
async fn a_stream_goes_on_across_an_edit() {
    let manager = Manager::new(small()).expect("valid");
    let (id, _) = bent(&manager).await;
    let mut client = Client::open(&manager, &id).await;
    let changed = pb::Options {
        output: Some(pb::Output {
            changed_only: Some(1e-6),
            ..Default::default()
        }),
        ..Default::default()
    };
    let push = |client: &Client, message| client.input.push(ask(message)).expect("open");
    push(&client, pb::deform_request::Message::Options(changed));
    let mut sizes = Vec::new();
    for (seq, angle) in [(1, 0.2), (2, 0.3), (3, 0.4)] {
        let pose = pb::Pose {
            seq,
            commit: false,
            ..turned(&id, angle).pose.expect("a pose")
        };
        push(&client, pb::deform_request::Message::Pose(pose));
        let frame = client.frame().await.header;
        assert!(frame.r#final);
        sizes.push(frame.vertex_count);
        client.ack(seq);
        if seq == 2 {
            manager
                .edit(tenant(), cut(&id, 1.4, Keep::Above), None)
                .await
                .expect("cut");
        }
    }
    let left = manager
        .get(tenant(), &id)
        .await
        .expect("open")
        .model
        .expect("facts")
        .vertices;
    assert_eq!(sizes[2], left, "all vertices of the new shape: {sizes:?}");
}
