//! Commits: undone bit for bit, whole or absent.

use super::fake::*;
use pliant::asset::Format;
use pliant::engine::{HandlePose, digest};
use pliant::session::SessionConfig;
use pliant::wire::HandlePatch;
use proptest::prelude::*;
use std::time::Duration;

#[tokio::test]
async fn undo_and_redo_restore_positions_to_the_bit() {
    // With no bytes for snapshots, every step back is a replay.
    for snapshot_bytes in [1 << 20, 0] {
        let (fixture, _) = Fixture::with(|config| config.snapshot_bytes = snapshot_bytes).await;
        let mut shapes = vec![fixture.positions().await.bytes];
        for (k, x) in [0.1, -0.7, 3.3].into_iter().enumerate() {
            let solved = fixture.solve(solve(&[(["a", "b"][k % 2], x)])).await;
            assert_eq!(solved.revision, 3 + k as u64);
            assert_eq!(digest(&solved.frame.positions), solved.digest);
            let mut client = fixture.client().await;
            client.drag(1, &[("a", 9.0)]);
            client.frame().await;
            shapes.push(fixture.positions().await.bytes);
        }
        fixture.set_handles(handles(&["b", "c", "d"])).await;
        let reply = fixture.history().await;
        let session = fixture.undo().await;
        let ids: Vec<_> = session.handles.iter().map(|h| h.id.as_str()).collect();
        assert_eq!(ids, ["a", "b"]);
        let mut revision = session.revision;
        for back in (0..3).rev() {
            let session = fixture.undo().await;
            assert!(session.revision > revision);
            revision = session.revision;
            assert_eq!(fixture.positions().await.bytes, shapes[back]);
        }
        for shape in &shapes[1..] {
            fixture.redo().await;
            assert_eq!(fixture.positions().await.bytes, *shape);
        }
        fixture.redo().await;
        let redone = fixture.manager.redo(tenant(), &fixture.id, None).await;
        let error = redone.expect_err("nothing is left");
        assert_eq!((error.http_status(), error.code_name()), (409, "FAILED_PRECONDITION"));
        assert_eq!(fixture.history().await, reply);
        let after = fixture.solve(solve(&[("c", 1.0)])).await;
        assert_eq!(after.frame.positions[1].x, 2.0);
    }
}

#[tokio::test]
async fn nothing_to_undo_is_a_precondition() {
    let (manager, _) = manager(small());
    let id = create(&manager, "points 4").await;
    let error = manager.undo(tenant(), &id, None).await.expect_err("only the creation");
    assert_eq!((error.http_status(), error.code_name()), (409, "FAILED_PRECONDITION"));
    let solved = manager.solve(tenant(), &id, solve(&[]), None).await;
    let error = solved.expect_err("no handles");
    assert_eq!((error.http_status(), error.code_name()), (409, "FAILED_PRECONDITION"));
}

#[tokio::test]
async fn handles_leave_the_shape_alone_and_start_at_their_poses() {
    let (fixture, _) = Fixture::fake(small()).await;
    fixture.solve_a(4.0).await;
    let before = fixture.positions().await;
    let mut request = handles(&["a", "b"]);
    request.handles[1].pose = Some(HandlePose::translation([6.0, 0.0, 0.0]));
    let session = fixture.set_handles(request).await;
    assert_eq!((session.revision, session.build_ms.contains_key("fields")), (4, true));
    let after = fixture.positions().await;
    assert_eq!(after.bytes, before.bytes);
    assert_ne!(after.etag, before.etag);
    let solved = fixture.solve(solve(&[])).await;
    assert_eq!(
        (solved.frame.positions[0].x, solved.frame.positions[1].x),
        (0.0, 7.0),
        "a is at rest again"
    );

    let rigid = HandlePatch {
        id: "a".into(),
        rigid: Some(true),
        ..Default::default()
    };
    fixture
        .manager
        .put_handle(tenant(), &fixture.id, rigid, None)
        .await
        .expect("patched");
    let solved = fixture.solve(solve(&[])).await;
    assert_eq!(solved.frame.positions[1].x, 7.0, "a patch moves nothing");
    fixture
        .manager
        .remove_handle(tenant(), &fixture.id, "a", None)
        .await
        .expect("removed");
    let solved = fixture.solve(solve(&[])).await;
    assert_eq!(
        (solved.frame.positions[0].x, solved.frame.positions[1].x),
        (6.0, 7.0),
        "b holds everything now"
    );
    let error = fixture
        .manager
        .remove_handle(tenant(), &fixture.id, "a", None)
        .await
        .expect_err("gone");
    assert_eq!(error.http_status(), 404);
}

#[tokio::test]
async fn a_call_that_fails_changes_nothing() {
    let (fixture, _) = Fixture::fake(small()).await;
    fixture.solve_a(4.0).await;
    let before = (
        fixture.facts().await,
        fixture.manager.history(tenant(), &fixture.id).await,
    );
    let mut nowhere = handles(&["x", "y"]);
    nowhere.handles[1].region = NOWHERE;
    let error = fixture
        .manager
        .set_handles(tenant(), &fixture.id, nowhere, None)
        .await
        .expect_err("a region that is nowhere");
    assert_eq!(
        (error.http_status(), error.field.as_deref()),
        (422, Some("handles[1].region"))
    );
    let error = fixture.refuses(solve(&[("x", 1.0)])).await;
    assert_eq!(
        (error.http_status(), error.field.as_deref()),
        (422, Some("pose.handles[0].id"))
    );
    let error = fixture
        .manager
        .export(tenant(), &fixture.id, Some(Format::STL))
        .await
        .expect_err("cannot be written");
    assert_eq!(error.http_status(), 422);
    let mut after = (
        fixture.facts().await,
        fixture.manager.history(tenant(), &fixture.id).await,
    );
    after.0.expires_at.clone_from(&before.0.expires_at);
    assert_eq!(after, before);
    let solved = fixture.solve(solve(&[])).await;
    assert_eq!(solved.frame.positions[0].x, 4.0);
}

#[tokio::test]
async fn a_caller_that_goes_leaves_the_old_state() {
    let (fixture, control) = Fixture::fake(small()).await;
    control.hold();
    let solving = tokio::time::timeout(
        Duration::from_millis(20),
        fixture.manager.solve(tenant(), &fixture.id, solve(&[("a", 1.0)]), None),
    );
    assert!(solving.await.is_err(), "it is held up");
    until(|| fixture.metrics().pool_busy.get() == 0).await;
    let more = handles(&["a", "b", "c"]);
    let setting = tokio::time::timeout(
        Duration::from_millis(20),
        fixture.manager.set_handles(tenant(), &fixture.id, more, None),
    );
    assert!(setting.await.is_err(), "it is held up");
    until(|| fixture.metrics().pool_busy.get() == 0).await;
    control.release();
    let session = fixture.facts().await;
    assert_eq!((session.revision, session.handles.len()), (2, 2));
    let solved = fixture.solve(solve(&[("b", 1.0)])).await;
    assert_eq!((solved.frame.positions[0].x, solved.revision), (0.0, 3));
}

#[tokio::test]
async fn a_solve_that_takes_too_long_is_given_up() {
    let (fixture, control) = Fixture::with(|config| config.solve = Duration::from_millis(10)).await;
    control.hold();
    let error = fixture.refuses(solve(&[("a", 1.0)])).await;
    assert_eq!((error.http_status(), error.code_name()), (504, "DEADLINE_EXCEEDED"));
    let mut client = fixture.client().await;
    client.commit(1, &[("a", 1.0)]);
    assert_eq!(client.error().await.1.grpc_code(), 4);
    assert_eq!(fixture.facts().await.revision, 2);
}

#[tokio::test]
async fn exports_and_positions_are_of_the_committed_shape() {
    let (fixture, _) = Fixture::fake(small()).await;
    fixture.solve_a(2.0).await;
    let positions = fixture.positions().await;
    assert_eq!(positions.bytes.len(), 4 * 12);
    assert_eq!(
        f32::from_le_bytes(positions.bytes[..4].try_into().expect("four bytes")),
        2.0
    );
    let own = fixture.export(None).await;
    assert!(own.format == Format::OBJ && own.written.main.starts_with(b"obj [DVec3(2.0"));
    let other = fixture.export(Some(Format::PLY)).await;
    assert!(own.etag != other.etag && own.etag.starts_with('"') && own.etag.ends_with('"'));
    let etag = async || {
        let etag = fixture
            .manager
            .export_etag(tenant(), &fixture.id, Some(Format::PLY))
            .await;
        etag.expect("open")
    };
    assert_eq!(etag().await, other.etag);
    fixture.solve_a(3.0).await;
    assert_ne!(etag().await, other.etag);
}

#[derive(Debug, Clone)]
enum Command {
    Solve(usize, i8),
    Drag(usize, i8),
    Handles(usize),
    Undo,
    Redo,
    GiveUp,
}

fn command() -> impl Strategy<Value = Command> {
    prop_oneof![
        (0usize..2, -9i8..9).prop_map(|(h, x)| Command::Solve(h, x)),
        (0usize..2, -9i8..9).prop_map(|(h, x)| Command::Drag(h, x)),
        (1usize..3).prop_map(Command::Handles),
        Just(Command::Undo),
        Just(Command::Redo),
        Just(Command::GiveUp),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Whatever a client does, the revision grows with every change and only then, the digest is that of the positions, and a
    /// commit reached again by undo or redo has the bits that it had.
    #[test]
    fn any_order_of_calls_keeps_the_books(commands in prop::collection::vec(command(), 1..25), keep in any::<bool>()) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        runtime.block_on(async move {
            let snapshot_bytes = if keep { 1 << 20 } else { 0 };
            let (fixture, control) = Fixture::fake(SessionConfig { snapshot_bytes, history: 5, ..small() }).await;
            let mut client = fixture.client().await;
            let mut seq = 0;
            let mut last = fixture.facts().await.revision;
            let mut shapes = std::collections::BTreeMap::new();
            for command in commands {
                let changed = match command {
                    Command::Solve(h, x) => {
                        let name = ["a", "b"][h];
                        fixture.manager.solve(tenant(), &fixture.id, solve(&[(name, x.into())]), None).await.is_ok()
                    }
                    Command::Handles(n) => {
                        fixture.set_handles(handles(&["a", "b"][..n])).await;
                        true
                    }
                    Command::Undo => fixture.manager.undo(tenant(), &fixture.id, None).await.is_ok(),
                    Command::Redo => fixture.manager.redo(tenant(), &fixture.id, None).await.is_ok(),
                    Command::Drag(h, x) => {
                        seq += 1;
                        client.drag(seq, &[(["a", "b"][h], x.into())]);
                        // A frame, or an error where there is no handle b.
                        client.next().await.expect("open");
                        client.ack(seq);
                        false
                    }
                    Command::GiveUp => {
                        control.hold();
                        let request = solve(&[("a", 100.0)]);
                        let limit = Duration::from_millis(2);
                        let _ = tokio::time::timeout(limit, fixture.manager.solve(tenant(), &fixture.id, request, None)).await;
                        until(|| fixture.metrics().pool_busy.get() == 0).await;
                        control.release();
                        false
                    }
                };
                let session = fixture.facts().await;
                let history = fixture.history().await;
                assert_eq!(session.revision, last + u64::from(changed), "{command:?}");
                last = session.revision;
                assert!(history.commits.len() <= 6 && history.commits.is_sorted_by_key(|c| c.revision));
                let current = history.commits.iter().find(|c| c.revision == history.current).expect("listed");
                let bytes = fixture.positions().await.bytes;
                let known = shapes.entry(current.revision).or_insert_with(|| (current.digest.clone(), bytes.clone()));
                assert_eq!(*known, (current.digest.clone(), bytes), "{command:?}");
            }
        });
    }
}
