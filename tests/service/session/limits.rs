//! What is refused, with which code, and that it costs nobody else anything.

use super::fake::*;
use pliant::session::MemoryUse;
use pliant::session::{Error, Manager, SessionConfig, Tenant};
use pliant::wire::{SessionOptions, SessionPage};
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use std::time::Duration;

async fn refused(manager: &Manager, text: &str, options: SessionOptions) -> Error {
    manager
        .create(tenant(), model(text), options, None)
        .await
        .expect_err("refused")
}

#[tokio::test]
async fn creation_checks_sizes() {
    let (manager, _) = manager(SessionConfig {
        upload_bytes: 20,
        memory_bytes: 4 << 20,
        ..small()
    });
    let large = refused(&manager, "points 4 and then some", options()).await;
    assert_eq!((large.http_status(), large.code_name()), (413, "RESOURCE_EXHAUSTED"));
    assert_eq!(refused(&manager, "nonsense", options()).await.http_status(), 400);
    let never = refused(&manager, "large 9999999", options()).await;
    assert_eq!((never.http_status(), never.retry_after_s), (413, None));
    assert_eq!(refused(&manager, "panic", options()).await.http_status(), 500);
    assert_eq!(
        (
            manager.metrics().sessions.get(),
            manager.metrics().held_bytes(MemoryUse::Sessions).get()
        ),
        (0, 0)
    );
    let id = create(&manager, "points 4").await;
    assert!(id.len() == 32 && id.bytes().all(|b| b.is_ascii_hexdigit()));
}

#[tokio::test]
async fn memory_that_is_taken_is_asked_for_again_later() {
    let (manager, _) = manager(SessionConfig {
        memory_bytes: 4 << 20,
        high_water: 0.5,
        ..small()
    });
    assert!(manager.admits());
    let id = create(&manager, "points 30000").await;
    assert!(manager.metrics().held_bytes(MemoryUse::Sessions).get() >= 3_000_000 && !manager.admits());
    let later = refused(&manager, "large 3000000", options()).await;
    assert_eq!(
        (later.http_status(), later.retry_after_s.is_some()),
        (429, true),
        "{later}"
    );
    let wrong = refused(&manager, "points 30000", options()).await;
    assert_eq!(
        wrong.http_status(),
        429,
        "an estimate that was too low is caught when the truth is known"
    );
    manager.delete(tenant(), &id).await.expect("deleted");
    assert_eq!(
        (
            manager.metrics().held_bytes(MemoryUse::Sessions).get(),
            manager.admits()
        ),
        (0, true)
    );
    create(&manager, "points 30000").await;
}

#[tokio::test]
async fn there_are_only_so_many_sessions() {
    let (manager, _) = manager(SessionConfig { sessions: 2, ..small() });
    let first = create(&manager, "points 4").await;
    create(&manager, "points 4").await;
    let error = refused(&manager, "points 4", options()).await;
    assert_eq!((error.http_status(), error.retry_after_s.is_some()), (429, true));
    manager.delete(tenant(), &first).await.expect("deleted");
    create(&manager, "points 4").await;
    assert_eq!(
        manager.delete(tenant(), &first).await.expect_err("gone").http_status(),
        404
    );
}

#[tokio::test]
async fn a_session_that_is_busy_takes_only_so_many_calls() {
    let (fixture, control) = Fixture::fake(SessionConfig {
        session_queue: 1,
        ..small()
    })
    .await;
    control.hold();
    let call = || fixture.solving(solve(&[]));
    let first = call();
    control.held_up().await;
    let second = call();
    let third = call();
    let (mut done, mut refused) = (0, 0);
    until(|| second.is_finished() || third.is_finished()).await;
    control.release();
    for call in [first, second, third] {
        match call.await.expect("no panic") {
            Ok(_) => done += 1,
            Err(error) => {
                assert_eq!((error.http_status(), error.retry_after_s), (429, Some(1)));
                refused += 1;
            }
        }
    }
    assert_eq!((done, refused), (2, 1));
}

#[tokio::test]
async fn calls_that_wait_grow_old_together() {
    let (fixture, control) = Fixture::fake(SessionConfig {
        solve: Duration::from_millis(200),
        ..small()
    })
    .await;
    control.hold();
    let call = || fixture.solving(solve(&[("a", 1.0)]));
    let calls: Vec<_> = (0..20).map(|_| call()).collect();
    for call in calls {
        let error = call.await.expect("no panic").expect_err("its time was over");
        assert_eq!(error.http_status(), 504, "{error}");
    }
    assert_eq!(
        control.solves.load(SeqCst),
        1,
        "those behind the first were never begun"
    );
    control.release();
    fixture.solve(solve(&[("a", 1.0)])).await;
}

#[tokio::test]
async fn a_pose_never_waits_behind_builds() {
    let (fixture, control) = Fixture::fake(SessionConfig {
        compute_slots: 1,
        ..small()
    })
    .await;
    control.hold();
    let slow = fixture.manager.clone();
    let build = tokio::spawn(async move { slow.create(tenant(), model("slow 4"), options(), None).await });
    control.held_up().await;
    let (quick, posed) = (fixture.manager.clone(), fixture.id.clone());
    let pose = tokio::spawn(async move { quick.solve(tenant(), &posed, solve(&[("a", 1.0)]), None).await });
    until(|| control.solves.load(SeqCst) == 1).await;
    assert!(!build.is_finished());
    control.release();
    pose.await.expect("no panic").expect("solved");
    build.await.expect("no panic").expect("built");
}

#[tokio::test]
async fn a_build_that_nobody_waits_for_stops() {
    let (manager, control) = manager(small());
    control.hold();
    let create = tokio::time::timeout(
        Duration::from_millis(20),
        manager.create(tenant(), model("slow 4"), options(), None),
    );
    assert!(create.await.is_err());
    until(|| manager.metrics().pool_busy.get() == 0 && manager.metrics().held_bytes(MemoryUse::Sessions).get() == 0)
        .await;
    assert_eq!(manager.metrics().sessions.get(), 0);
}

#[tokio::test]
async fn a_panic_costs_its_own_session_only() {
    let (manager, _) = manager(small());
    let other = open(&manager).await;
    let id = create(&manager, "points 4").await;
    manager
        .set_handles(tenant(), &id, handles(&["panic"]), None)
        .await
        .expect("set");
    let mut client = Client::open(&manager, &id).await;
    let error = manager
        .solve(tenant(), &id, solve(&[("panic", 1.0)]), None)
        .await
        .expect_err("it panics");
    assert_eq!((error.http_status(), error.code_name()), (500, "INTERNAL"));
    let (seq, told) = client.error().await;
    assert_eq!((seq, told.grpc_code()), (0, 13));
    assert!(client.next().await.is_none());
    until(|| manager.metrics().sessions.get() == 1).await;
    assert_eq!(manager.get(tenant(), &id).await.expect_err("gone").http_status(), 404);
    manager
        .solve(tenant(), &other, solve(&[("a", 1.0)]), None)
        .await
        .expect("the other session works");
}

#[tokio::test]
async fn a_tenant_sees_its_own_sessions_only() {
    let (fixture, _) = Fixture::fake(small()).await;
    let stranger = Tenant(Arc::from("stranger"));
    assert_eq!(
        fixture
            .manager
            .get(&stranger, &fixture.id)
            .await
            .expect_err("not theirs")
            .http_status(),
        404
    );
    assert_eq!(
        fixture
            .manager
            .delete(&stranger, &fixture.id)
            .await
            .expect_err("not theirs")
            .http_status(),
        404
    );
    assert_eq!(
        fixture
            .manager
            .stream(&stranger, &fixture.id)
            .await
            .expect_err("not theirs")
            .http_status(),
        404
    );
    assert_eq!(
        fixture
            .manager
            .solve(&stranger, &fixture.id, solve(&[]), None)
            .await
            .expect_err("not theirs")
            .http_status(),
        404
    );
    let listed = fixture
        .manager
        .list(&stranger, SessionPage { size: 100, after: 0 })
        .await
        .expect("a list");
    assert!(listed.sessions.is_empty());
}

#[tokio::test]
async fn lists_come_in_pages_oldest_first() {
    let (manager, _) = manager(small());
    let mut made = Vec::new();
    for _ in 0..5 {
        made.push(create(&manager, "points 1").await);
    }
    let (mut seen, mut after) = (Vec::new(), Some(0));
    while let Some(last) = after {
        let page = manager
            .list(tenant(), SessionPage { size: 2, after: last })
            .await
            .expect("a list");
        assert!(page.sessions.len() <= 2);
        seen.extend(page.sessions.into_iter().map(|s| s.id));
        after = page.next_after;
    }
    assert_eq!(seen, made);
}
