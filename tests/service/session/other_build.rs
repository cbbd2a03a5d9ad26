//! Stored sessions and the build and processor that open them: within one the bits are the same or the session is not served; another
//! one's results may differ in late digits, and are recorded anew.

use super::fake::*;
use pliant::session::store::StoreLocation;
use pliant::session::{ErrorCode, HistoryFacts, Manager};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;

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

async fn history(manager: &Manager, id: &str) -> HistoryFacts {
    manager.history(tenant(), id).await.expect("served")
}

/// A session with so many poses, made by the build "one".
async fn made(folder: &Path, poses: u32) -> (String, HistoryFacts) {
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
async fn late_digits_of_another_build_are_recorded_anew() {
    let folder = tempfile::tempdir().expect("a folder");
    let (id, by_one) = made(folder.path(), 3).await;
    let manager = opened_by(folder.path(), "two", 1).await;
    let by_two = history(&manager, &id).await;
    let revisions = |h: &HistoryFacts| -> Vec<_> { h.commits.iter().map(|c| (c.revision, c.kind)).collect() };
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
