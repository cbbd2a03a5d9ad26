//! Edits in sessions: one commit each, undone and redone to the bit, refused whole.

use super::fake::*;
use super::real::{bent, turned, turning};
use pliant::session::{ErrorCode, Manager, SessionConfig};
use pliant::wire::frames::FrameOutput;
use pliant::wire::{DeformOptions, SessionEdit, json, session_edit};

/// An edit, as a request in JSON asks for it.
pub fn edit_of(request: &str) -> SessionEdit {
    session_edit(&json::from_json(request.as_bytes()).expect(request)).expect(request)
}

fn cut(height: f64, keep: &str) -> SessionEdit {
    edit_of(&format!(
        r#"{{"cut": {{"plane": {{"normal": [0, 0, 1], "offset": {height:?}}}, "keep": "{keep}", "fill": true}}}}"#
    ))
}

/// Puts another session's model `by` beside this one.
fn merge(other: &str, by: f64) -> SessionEdit {
    edit_of(&format!(
        r#"{{"merge": {{"session": "{other}", "how": "LOOSE", "transform": [1,0,0,0, 0,1,0,0, 0,0,1,0, {by:?},0,0,1]}}}}"#
    ))
}

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
        let bent = manager.solve(tenant(), &id, turned(0.6), None).await.expect("solved");
        digests.push(bent.digest);
        for height in [0.75, 1.4] {
            let result = manager
                .edit(tenant(), &id, cut(height, "ABOVE"), None)
                .await
                .expect("cut");
            assert!(result.report.after.vertices != result.report.before.vertices);
            assert_eq!(
                result.revision,
                manager.history(tenant(), &id).await.expect("open").current
            );
            said.push(result.report.after.vertices);
            digests.push(result.report.digest);
            let moved = manager.solve(tenant(), &id, turned(0.3), None).await;
            // The base was cut off with the first edit, and what is left is held by the top alone.
            digests.push(moved.expect("solved").digest);
        }
        for digest in digests.iter().rev().skip(1) {
            manager.undo(tenant(), &id, None).await.expect("undone");
            assert_eq!(digest_now(&manager, &id).await, *digest);
        }
        let described = manager.get(tenant(), &id).await.expect("open");
        assert_eq!(described.deformer.model.counts.vertices, 52);
        for digest in &digests[1..] {
            manager.redo(tenant(), &id, None).await.expect("redone");
            assert_eq!(digest_now(&manager, &id).await, *digest);
        }
        let described = manager.get(tenant(), &id).await.expect("open");
        assert_eq!(described.deformer.model.counts.vertices, said[1]);
        let again = manager.solve(tenant(), &id, turned(0.3), None).await.expect("solved");
        assert_eq!(
            again.digest,
            *digests.last().expect("some"),
            "the same pose gives the same bits"
        );
        let kinds: Vec<&str> = (manager.history(tenant(), &id).await.expect("open").commits.into_iter())
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
        .edit(tenant(), &id, cut(99.0, "BOTH"), None)
        .await
        .expect_err("misses");
    assert_eq!(missed.code, ErrorCode::FailedPrecondition);
    let unknown = manager
        .edit(tenant(), &id, merge("nobody", 0.0), None)
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
    let request = cut(1.4, "BELOW");
    let first = manager
        .edit(tenant(), &id, request.clone(), key("k", ""))
        .await
        .expect("cut");
    let second = manager
        .edit(tenant(), &id, request, key("k", ""))
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
    let result = manager
        .edit(tenant(), &id, merge(&other, 3.0), None)
        .await
        .expect("merged");
    assert_eq!(result.report.after.vertices, 104);
    let session = manager.get(tenant(), &id).await.expect("open");
    assert_eq!(
        (session.deformer.solver.components, session.deformer.primitives.len()),
        (2, 2)
    );
    assert_eq!(result.report.handles_kept, ["base", "top"]);
}

#[tokio::test]
async fn a_stream_goes_on_across_an_edit() {
    let manager = Manager::new(small()).expect("valid");
    let (id, _) = bent(&manager).await;
    let mut client = Client::open(&manager, &id).await;
    client.options(DeformOptions {
        output: FrameOutput {
            changed_only: Some(1e-6),
            ..Default::default()
        },
        ..stream_options()
    });
    let mut sizes = Vec::new();
    for (seq, angle) in [(1, 0.2), (2, 0.3), (3, 0.4)] {
        client.push(turning(seq, angle, false));
        let frame = client.frame().await;
        assert!(frame.header.is_final);
        sizes.push(frame.selected.expect("changes only").len() as u32);
        client.ack(seq);
        if seq == 2 {
            manager.edit(tenant(), &id, cut(1.4, "ABOVE"), None).await.expect("cut");
        }
    }
    let left = manager
        .get(tenant(), &id)
        .await
        .expect("open")
        .deformer
        .model
        .counts
        .vertices;
    assert_eq!(sizes[2], left, "all vertices of the new shape: {sizes:?}");
}
