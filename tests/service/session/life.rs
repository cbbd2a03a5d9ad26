//! Expiry, deleting, idempotency keys, draining, many sessions at once.

use super::fake::*;
use crate::support::server::retried;
use pliant::session::store::StoreLocation;
use pliant::session::{ErrorCode, Manager, MemoryUse, StreamAnswer};
use pliant::wire::{self, SessionOptions};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use std::time::Duration;

#[tokio::test]
async fn an_unused_session_expires_and_frees_its_memory() {
    let (manager, _) = manager(small());
    let options = || SessionOptions {
        ttl: Some(Duration::from_secs(1)),
        label: "short".into(),
        ..options()
    };
    let make = async || {
        let made = manager.create(tenant(), model("points 4"), options(), None).await;
        made.expect("made").value
    };
    let gone = async |id: &str| manager.get(tenant(), id).await.expect_err("expired").http_status();
    let (idle, streaming) = (make().await, make().await);
    assert_eq!((idle.label.as_str(), idle.expires_at.ends_with('Z')), ("short", true));
    // Times of this form are ordered as texts.
    assert!(idle.created_at.ends_with('Z') && idle.created_at < idle.expires_at);
    let stream = manager.stream(tenant(), &streaming.id).await.expect("a stream");
    until(|| manager.metrics().sessions_expired.get() == 1).await;
    assert_eq!(gone(&idle.id).await, 404);
    // Twice its lease has passed for the other one by the next expiry of a third.
    let third = make().await;
    until(|| manager.metrics().sessions_expired.get() == 2).await;
    assert_eq!(gone(&third.id).await, 404);
    manager
        .get(tenant(), &streaming.id)
        .await
        .expect("an open stream keeps it");
    drop(stream);
    until(|| {
        manager.metrics().sessions_expired.get() == 3 && manager.metrics().held_bytes(MemoryUse::Sessions).get() == 0
    })
    .await;
    assert_eq!(manager.metrics().sessions.get(), 0);
}

#[tokio::test]
async fn deleting_ends_work_and_streams() {
    let (fixture, control, mut client) = Fixture::streamed().await;
    client.drag_held_up(&control).await;
    let solving = fixture.solving(solve(&[]));
    tokio::task::yield_now().await;
    fixture.manager.delete(tenant(), &fixture.id).await.expect("deleted");
    assert_eq!((fixture.metrics().pool_busy.get(), fixture.held_bytes()), (0, 0));
    assert_eq!(solving.await.expect("no panic").expect_err("gone").http_status(), 404);
    let mut last = None;
    while let Some(message) = client.next().await {
        last = Some(message);
    }
    let Some(StreamAnswer::Failure { error, seq }) = last else {
        panic!("an error comes last, not {last:?}")
    };
    assert_eq!((seq, error.grpc_code()), (0, 5));
}

#[tokio::test]
async fn the_same_key_does_a_thing_once() {
    let (manager, control) = manager(small());
    let create = |text: &'static str, key: &'static str| {
        let manager = manager.clone();
        async move {
            manager
                .create(tenant(), model(text), options(), super::fake::key(key, ""))
                .await
        }
    };
    let first = create("points 4", "one").await.expect("made");
    let again = create("points 4", "one").await.expect("the same answer");
    assert!(!first.repeated && again.repeated && first.value == again.value);
    assert_eq!(manager.metrics().sessions.get(), 1);
    let other = create("points 5", "one").await.expect_err("another model");
    assert_eq!((other.http_status(), other.code_name()), (422, "INVALID_ARGUMENT"));
    assert_eq!(
        create("points 4", "no spaces").await.expect_err("no key").http_status(),
        422
    );

    let id = first.value.id;
    manager
        .set_handles(tenant(), &id, handles(&["a", "b"]), key("two", ""))
        .await
        .expect("set");
    manager
        .set_handles(tenant(), &id, handles(&["a", "b"]), key("two", ""))
        .await
        .expect("the same answer");
    let solve = |x: f64| {
        let (manager, id, request) = (manager.clone(), id.clone(), solve(&[("a", x)]));
        let key = key("three", &request);
        async move { manager.solve(tenant(), &id, request, key).await }
    };
    control.hold();
    let running = tokio::spawn(solve(1.0));
    control.held_up().await;
    let meanwhile = solve(1.0).await.expect_err("the first still runs");
    assert_eq!((meanwhile.http_status(), meanwhile.code_name()), (409, "ABORTED"));
    control.release();
    let done = running.await.expect("no panic").expect("solved");
    let again = solve(1.0).await.expect("the same answer");
    assert_eq!(
        (done.revision, &done.frame.header, &done.digest),
        (again.revision, &again.frame.header, &again.digest)
    );
    assert_eq!(solve(2.0).await.expect_err("another pose").http_status(), 422);
    for _ in 0..2 {
        let session = manager.undo(tenant(), &id, Some("four")).await.expect("undone once");
        assert_eq!(session.revision, 4);
    }
    assert_eq!(manager.get(tenant(), &id).await.expect("open").revision, 4);
}

#[tokio::test(flavor = "multi_thread")]
async fn work_under_way_is_told_and_ends_with_the_call_that_is_given_up() {
    let (manager, control) = manager(small());
    let id = open(&manager).await;
    let work = async || manager.get(tenant(), &id).await.expect("open").work;
    assert_eq!(work().await, None);
    control.hold();
    let running = tokio::spawn({
        let (manager, id) = (manager.clone(), id.clone());
        async move { manager.set_handles(tenant(), &id, handles(&["a", "b"]), None).await }
    });
    control.held_up().await;
    let seen = work().await.expect("handles are set");
    assert_eq!(
        (seen.kind.as_str(), seen.stage.as_str(), seen.fraction),
        ("handles", "fields", 0.0)
    );
    assert!(seen.elapsed_ms >= 0.0);
    running.abort();
    until(|| manager.metrics().cancelled.get() == 1).await;
    control.release();
    assert_eq!(manager.get(tenant(), &id).await.expect("open").revision, 2);
    let set = manager.set_handles(tenant(), &id, handles(&["a"]), None).await;
    assert_eq!(set.expect("set").work, None, "answers of changes tell of no work");
    assert_eq!(work().await, None);
}

#[tokio::test]
async fn a_call_that_failed_or_was_given_up_frees_its_key() {
    let (fixture, control) = Fixture::fake(small()).await;
    let wrong = fixture
        .manager
        .solve(tenant(), &fixture.id, solve(&[("x", 1.0)]), key("key", "wrong"))
        .await
        .expect_err("unknown handle");
    assert_eq!(wrong.http_status(), 422);
    control.hold();
    let request = solve(&[("a", 1.0)]);
    let solving = fixture
        .manager
        .solve(tenant(), &fixture.id, request.clone(), key("key", &request));
    assert!(tokio::time::timeout(Duration::from_millis(20), solving).await.is_err());
    until(|| fixture.metrics().pool_busy.get() == 0).await;
    control.release();
    // The session's task may not have heard of the end yet.
    let solved = retried("a free key", Duration::from_millis(1), async || {
        let solving = fixture
            .manager
            .solve(tenant(), &fixture.id, request.clone(), key("key", &request));
        match solving.await {
            Err(error) if error.code == ErrorCode::Aborted => None,
            other => Some(other.expect("done at last")),
        }
    })
    .await;
    assert_eq!(solved.revision, 3);
}

#[tokio::test]
async fn draining_notifies_streams_and_waits_for_them() {
    let (fixture, control, mut client) = Fixture::streamed().await;
    fixture.manager.start_drain();
    assert!(!fixture.manager.admits());
    let Some(StreamAnswer::Notice { code, session, .. }) = client.next().await else {
        panic!("a notice was expected")
    };
    assert_eq!((code, &session), ("going-away", &fixture.id));
    let error = fixture
        .manager
        .stream(tenant(), &fixture.id)
        .await
        .expect_err("no new streams");
    assert_eq!((error.http_status(), error.retry_after_s.is_some()), (503, true));
    let made = fixture
        .manager
        .create(tenant(), model("points 4"), options(), None)
        .await;
    assert_eq!(made.expect_err("no new sessions").http_status(), 503);
    client.commit(1, &[("a", 1.0)]);
    assert_eq!(client.frame().await.header.seq, 1, "what is open still works");
    let draining = fixture.manager.drained();
    tokio::pin!(draining);
    assert!(futures::poll!(draining.as_mut()).is_pending());
    drop(client);
    draining.await;

    control.hold();
    let solving = fixture.solving(solve(&[]));
    control.held_up().await;
    fixture.manager.abort();
    assert_eq!(
        solving.await.expect("no panic").expect_err("aborted").http_status(),
        503
    );
    fixture.manager.drained().await;
    until(|| fixture.metrics().sessions.get() == 0 && fixture.metrics().pool_busy.get() == 0).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn many_sessions_share_few_slots() {
    let (manager, _) = manager(limits(|config| config.compute_slots = 1));
    let work = (0..8).map(|k| {
        let manager = manager.clone();
        tokio::spawn(async move {
            let id = open(&manager).await;
            let mut client = StreamClient::open(&manager, &id).await;
            for seq in 1..=20 {
                client.drag(seq, &[("a", f64::from(k))]);
                assert_eq!(client.frame().await.x[0], f64::from(k));
                client.ack(seq);
            }
            client.commit(21, &[]);
            assert_eq!(client.frame().await.header.revision, 3);
            drop(client);
            manager.delete(tenant(), &id).await.expect("deleted");
        })
    });
    for done in futures::future::join_all(work).await {
        done.expect("no panic");
    }
    let metrics = manager.metrics();
    assert_eq!(
        (
            metrics.sessions.get(),
            metrics.streams.get(),
            metrics.held_bytes(MemoryUse::Sessions).get()
        ),
        (0, 0, 0)
    );
    assert_eq!((metrics.poses_solved.get(), metrics.commits.get()), (8 * 21, 8 * 2));
}

/// Sessions of a folder, opened by a build whose results are so many billionths off.
async fn opened_by(folder: &Path, build: &str, late_digits: u64) -> Manager {
    let location = StoreLocation {
        build: Some(build.into()),
        ..StoreLocation::in_folder(folder)
    };
    let store = store_at(&location).await;
    let control = Arc::new(Control::default());
    control.late_digits.store(late_digits, SeqCst);
    let opened = Manager::with_store(small(), OpenFake(control), Arc::new(store)).await;
    opened.expect("a store")
}

async fn history(manager: &Manager, id: &str) -> wire::pb::HistoryResponse {
    manager.history(tenant(), id).await.expect("served")
}

/// A session with so many poses, made by the build "one".
async fn made(folder: &Path, poses: u32) -> (String, wire::pb::HistoryResponse) {
    let manager = opened_by(folder, "one", 0).await;
    let id = open(&manager).await;
    for k in 1..=poses {
        let pose = solve(&[("a", f64::from(k))]);
        manager.solve(tenant(), &id, pose, None).await.expect("solved");
    }
    let made = history(&manager, &id).await;
    close(manager).await;
    (id, made)
}

#[tokio::test(flavor = "multi_thread")]
async fn other_bits_of_the_same_build_are_damage() {
    let folder = tempfile::tempdir().expect("a folder");
    let (id, _) = made(folder.path(), 3).await;
    let manager = opened_by(folder.path(), "one", 1).await;
    let error = manager.get(tenant(), &id).await.expect_err("not served");
    assert_eq!(error.code, ErrorCode::DataLoss, "{error}");
    close(manager).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn late_digits_of_another_build_are_recorded_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let (id, by_one) = made(folder.path(), 3).await;
    let manager = opened_by(folder.path(), "two", 1).await;
    let by_two = history(&manager, &id).await;
    let revisions =
        |h: &wire::pb::HistoryResponse| -> Vec<_> { h.commits.iter().map(|c| (c.revision, c.kind.clone())).collect() };
    assert_eq!(revisions(&by_two), revisions(&by_one));
    for (one, two) in by_one.commits.iter().zip(&by_two.commits) {
        assert_eq!(one.digest == two.digest, one.kind != "pose", "{one:?} {two:?}");
    }
    close(manager).await;
    // From now on it is the build "two" that has to make the same bits.
    let manager = opened_by(folder.path(), "two", 1).await;
    assert_eq!(history(&manager, &id).await, by_two);
    manager.undo(tenant(), &id, None).await.expect("undone");
    close(manager).await;
    let manager = opened_by(folder.path(), "two", 2).await;
    let error = manager.get(tenant(), &id).await.expect_err("not served");
    assert_eq!(error.code, ErrorCode::DataLoss, "{error}");
    close(manager).await;
    let manager = opened_by(folder.path(), "three", 500_000_000).await;
    let error = manager.get(tenant(), &id).await.expect_err("another shape");
    assert_eq!(error.code, ErrorCode::FailedPrecondition, "{error}");
    assert!(error.message.contains("another build (two)"), "{error}");
    close(manager).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kept_shape_is_trusted_and_older_ones_are_made_again_when_they_are_gone_to() {
    let folder = tempfile::tempdir().expect("a folder");
    let (id, by_one) = made(folder.path(), 16).await;
    let manager = opened_by(folder.path(), "one", 0).await;
    // Idle for no time at all: its shape is kept on the way out.
    manager.get(tenant(), &id).await.expect("served");
    close(manager).await;
    let manager = opened_by(folder.path(), "two", 1).await;
    assert_eq!(history(&manager, &id).await, by_one, "nothing is solved again");
    let undone = manager.undo(tenant(), &id, None).await.expect("undone");
    assert_eq!(undone.revision, by_one.current + 1);
    let now = history(&manager, &id).await;
    let before = by_one.commits.len() - 2;
    assert_ne!(now.commits[before].digest, by_one.commits[before].digest);
    manager.redo(tenant(), &id, None).await.expect("redone");
    close(manager).await;
    let manager = opened_by(folder.path(), "two", 1).await;
    let again = history(&manager, &id).await;
    assert_eq!(again.commits[before].digest, now.commits[before].digest);
    close(manager).await;
}
