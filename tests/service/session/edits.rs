//! Edits in sessions: one commit each, undone and redone to the bit, refused whole.

use super::fake::*;
use super::real::{bent, bent_in, turned, turning};
use pliant::session::{ErrorCode, SessionConfig};
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

#[tokio::test]
async fn edits_are_undone_and_redone_to_the_bit_and_go_on_alike() {
    for snapshot_bytes in [1 << 24, 0] {
        let fixture = bent(SessionConfig {
            snapshot_bytes,
            ..small()
        })
        .await;
        let mut digests = vec![fixture.digest().await];
        let mut said = Vec::new();
        digests.push(fixture.solve(turned(0.6)).await.digest);
        for height in [0.75, 1.4] {
            let result = fixture.edit(cut(height, "ABOVE")).await;
            assert!(result.after.expect("counts").vertices != result.before.expect("counts").vertices);
            assert_eq!(result.revision, fixture.history().await.current);
            said.push(result.after.expect("counts").vertices);
            digests.push(result.digest);
            // The base was cut off with the first edit, and what is left is held by the top alone.
            digests.push(fixture.solve(turned(0.3)).await.digest);
        }
        for digest in digests.iter().rev().skip(1) {
            fixture.undo().await;
            assert_eq!(fixture.digest().await, *digest);
        }
        let described = fixture.facts().await;
        assert_eq!(described.model.expect("model facts").vertices, 52);
        for digest in &digests[1..] {
            fixture.redo().await;
            assert_eq!(fixture.digest().await, *digest);
        }
        let described = fixture.facts().await;
        assert_eq!(described.model.expect("model facts").vertices, said[1]);
        let again = fixture.solve(turned(0.3)).await;
        assert_eq!(
            again.digest,
            *digests.last().expect("some"),
            "the same pose gives the same bits"
        );
        let kinds: Vec<&str> = (fixture.history().await.commits.into_iter()).map(|c| c.kind).collect();
        assert_eq!(kinds[2..5], ["pose", "edit", "pose"]);
    }
}

#[tokio::test]
async fn a_refused_edit_changes_nothing() {
    let fixture = bent(small()).await;
    let before = (fixture.facts().await.revision, fixture.digest().await);
    let missed = fixture
        .manager
        .edit(tenant(), &fixture.id, cut(99.0, "BOTH"), None)
        .await
        .expect_err("misses");
    assert_eq!(missed.code, ErrorCode::FailedPrecondition);
    let unknown = fixture
        .manager
        .edit(tenant(), &fixture.id, merge("nobody", 0.0), None)
        .await
        .expect_err("no such session");
    assert_eq!(unknown.code, ErrorCode::NotFound);
    let after = (fixture.facts().await.revision, fixture.digest().await);
    assert_eq!(before, after);
}

#[tokio::test]
async fn an_edit_repeated_under_its_key_is_done_once() {
    let fixture = bent(small()).await;
    let request = cut(1.4, "BELOW");
    let first = fixture
        .manager
        .edit(tenant(), &fixture.id, request.clone(), key("k", ""))
        .await
        .expect("cut");
    let second = fixture
        .manager
        .edit(tenant(), &fixture.id, request, key("k", ""))
        .await
        .expect("the kept answer");
    assert_eq!(first, second);
    assert_eq!(fixture.facts().await.revision, first.revision);
}

#[tokio::test]
async fn a_session_can_be_merged_with_another_of_its_tenant() {
    let fixture = bent(small()).await;
    let other = bent_in(&fixture.manager).await;
    let result = fixture.edit(merge(&other.id, 3.0)).await;
    assert_eq!(result.after.expect("counts").vertices, 104);
    let session = fixture.facts().await;
    assert_eq!(
        (
            session.solver.as_ref().map_or(0, |s| s.components),
            session.primitives.len()
        ),
        (2, 2)
    );
    assert_eq!(result.handles_kept, ["base", "top"]);
}

#[tokio::test]
async fn a_stream_goes_on_across_an_edit() {
    let fixture = bent(small()).await;
    let mut client = fixture.client().await;
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
        assert!(frame.header.r#final);
        sizes.push(frame.selected.expect("changes only").len() as u32);
        client.ack(seq);
        if seq == 2 {
            fixture.edit(cut(1.4, "ABOVE")).await;
        }
    }
    let left = fixture.facts().await.model.expect("model facts").vertices;
    assert_eq!(sizes[2], left, "all vertices of the new shape: {sizes:?}");
}
