//! A store that fails or waits at any of its calls: what would change something is refused and changes nothing, the rest goes on.

use super::fake::*;
use super::faulty_store::Faults;
use pliant::session::store::StoreLocation;
use pliant::session::{Error, ErrorCode, Manager};
use pliant::wire::{self, SessionPage};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;

async fn opened(folder: &Path) -> (Manager, Arc<Faults>) {
    let location = StoreLocation::in_folder(folder);
    let faults = Arc::new(Faults::default());
    let store = store_at(&location).await.with_faults(Arc::clone(&faults) as Arc<_>);
    let control = Arc::new(Control::default());
    let manager = Manager::with_store(small(), OpenFake(control), Arc::new(store)).await;
    (manager.expect("a store"), faults)
}

fn page() -> SessionPage {
    SessionPage { size: 10, after: 0 }
}

/// A step of a session's life.
#[derive(Debug, Clone, Copy)]
enum LifeStep {
    Handles,
    Solve(u32),
    Undo,
    Redo,
}

async fn step(manager: &Manager, id: &str, step: LifeStep) -> Result<(), Error> {
    let me = tenant();
    match step {
        LifeStep::Handles => manager.set_handles(me, id, handles(&["a", "b"]), None).await.map(drop),
        LifeStep::Solve(k) => manager
            .solve(me, id, solve(&[("a", f64::from(k))]), None)
            .await
            .map(drop),
        LifeStep::Undo => manager.undo(me, id, None).await.map(drop),
        LifeStep::Redo => manager.redo(me, id, None).await.map(drop),
    }
}

/// Carries out a step, once more where the store refused it; whether it did.
async fn stubborn(manager: &Manager, id: &str, what: LifeStep) -> bool {
    let before = manager.history(tenant(), id).await.expect("reading goes on");
    let Err(error) = step(manager, id, what).await else {
        return false;
    };
    assert_eq!(error.code, ErrorCode::Unavailable, "{what:?}: {error}");
    let after = manager.history(tenant(), id).await.expect("reading goes on");
    assert_eq!(after, before, "{what:?} was refused");
    step(manager, id, what).await.expect("the store is back");
    true
}

/// The life of a session on a store whose call number `fails_at` fails: whether any did, and the history at its end.
async fn life(folder: &Path, fails_at: u64) -> (bool, String, wire::pb::HistoryResponse) {
    let (manager, store) = opened(folder).await;
    store.fails_at.store(fails_at, SeqCst);
    let made = manager.create(tenant(), model("points 4"), options(), None).await;
    let mut refused = made.is_err();
    let id = match made {
        Ok(made) => made.value.id,
        Err(error) => {
            assert_eq!(error.code, ErrorCode::Unavailable, "{error}");
            create(&manager, "points 4").await
        }
    };
    refused |= stubborn(&manager, &id, LifeStep::Handles).await;
    // So many that a shape is kept.
    for k in 1..=17 {
        refused |= stubborn(&manager, &id, LifeStep::Solve(k)).await;
    }
    for what in [LifeStep::Undo, LifeStep::Undo, LifeStep::Redo, LifeStep::Solve(40)] {
        refused |= stubborn(&manager, &id, what).await;
    }
    if manager.list(tenant(), page()).await.is_err() {
        refused = true;
        let listed = manager.list(tenant(), page()).await.expect("the store is back");
        assert_eq!(listed.sessions.len(), 1);
    }
    let history = manager.history(tenant(), &id).await.expect("served");
    refused |= store.calls.load(SeqCst) >= fails_at;
    close(manager).await;
    (refused, id, history)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_fails_at_any_call_loses_nothing_and_invents_nothing() {
    let mut fails_at = 0;
    loop {
        fails_at += 1;
        let folder = tempfile::tempdir().expect("a folder");
        let (was_reached, id, history) = life(folder.path(), fails_at).await;
        let (manager, _) = opened(folder.path()).await;
        let again = manager.history(tenant(), &id).await.expect("served");
        assert_eq!(again, history, "call {fails_at}");
        let listed = manager.list(tenant(), page()).await.expect("listed");
        assert_eq!(
            listed.sessions.len(),
            1,
            "call {fails_at}: what was refused is not there"
        );
        close(manager).await;
        if !was_reached {
            break;
        }
    }
    println!("{} calls of the store failed, one by one", fails_at - 1);
    assert!(fails_at > 24, "{fails_at}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_is_away_refuses_changes_and_lets_reads_and_drags_go_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let (manager, store) = opened(folder.path()).await;
    let id = open(&manager).await;
    let mut stream = StreamClient::open(&manager, &id).await;
    for round in 1..=3 {
        step(&manager, &id, LifeStep::Solve(round)).await.expect("solved");
        let before = manager.history(tenant(), &id).await.expect("served");
        store.is_away.store(true, SeqCst);
        for what in [LifeStep::Handles, LifeStep::Solve(9), LifeStep::Undo] {
            let error = step(&manager, &id, what).await.expect_err("refused");
            assert_eq!(error.code, ErrorCode::Unavailable, "{error}");
            assert!(error.retry_after_s.is_some(), "{error}");
        }
        stream.drag(u64::from(round), &[("a", 3.0)]);
        stream.frame().await;
        stream.ack(u64::from(round));
        assert_eq!(manager.history(tenant(), &id).await.expect("served"), before);
        store.is_away.store(false, SeqCst);
    }
    close(manager).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn while_a_commit_waits_for_the_store_it_has_not_happened_and_no_one_else_waits() {
    let folder = tempfile::tempdir().expect("a folder");
    let (manager, store) = opened(folder.path()).await;
    let (id, other) = (open(&manager).await, open(&manager).await);
    let before = manager.history(tenant(), &id).await.expect("served");
    let mut stream = StreamClient::open(&manager, &other).await;
    let calls = store.calls.load(SeqCst);
    store.held.send_replace(true);
    let committing = tokio::spawn({
        let (manager, id) = (manager.clone(), id.clone());
        async move { step(&manager, &id, LifeStep::Solve(5)).await }
    });
    until(|| store.calls.load(SeqCst) > calls).await;
    assert_eq!(manager.history(tenant(), &id).await.expect("reading goes on"), before);
    manager.positions(tenant(), &id).await.expect("reading goes on");
    stream.drag(1, &[("a", 3.0)]);
    stream.frame().await;
    assert!(!committing.is_finished(), "nothing is acknowledged before it is kept");
    store.held.send_replace(false);
    committing.await.expect("no panic").expect("kept");
    let after = manager.history(tenant(), &id).await.expect("served");
    assert_eq!(after.commits.len(), before.commits.len() + 1);
    close(manager).await;
}
