//! What is refused, with which code, and that it costs no one else anything.

use super::fake::*;
use pliant::session::{Error, Manager, MemoryUse, SessionConfig, Tenant};
use pliant::wire::{SessionOptions, SessionPage};
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use std::sync::atomic::{AtomicBool, AtomicUsize};
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
    let (manager, _) = manager(limits(|config| config.sessions = 2));
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
    let (fixture, control) = Fixture::with(|config| config.session_queue = 1).await;
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
    let (fixture, control) = Fixture::with(|config| config.solve = Duration::from_millis(200)).await;
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
    fixture.solve_a(1.0).await;
}

#[tokio::test]
async fn a_pose_never_waits_behind_builds() {
    let (fixture, control) = Fixture::with(|config| config.compute_slots = 1).await;
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
async fn a_build_that_no_one_waits_for_stops() {
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
    let mut client = StreamClient::open(&manager, &id).await;
    let error = manager
        .solve(tenant(), &id, solve(&[("panic", 1.0)]), None)
        .await
        .expect_err("it panics");
    assert_eq!((error.http_status(), error.code_name()), (500, "INTERNAL"));
    let (seq, reply) = client.error().await;
    assert_eq!((seq, reply.grpc_code()), (0, 13));
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
    let (manager, id) = (&fixture.manager, &fixture.id);
    for refused in [
        manager.get(&stranger, id).await.err(),
        manager.delete(&stranger, id).await.err(),
        manager.stream(&stranger, id).await.err(),
        manager.solve(&stranger, id, solve(&[]), None).await.err(),
    ] {
        assert_eq!(refused.expect("not theirs").http_status(), 404);
    }
    let listed = manager
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

/// Cycles of one solve of the fake.
const CYCLES: u64 = 4;

/// A solve that takes long, so that the next one is expected to.
async fn takes_long(fixture: &Fixture, control: &Control) {
    let long = fixture.solving(solve(&[("a", 1.0)]));
    control.held_up().await;
    tokio::time::sleep(Duration::from_millis(400)).await;
    control.step(CYCLES);
    long.await.expect("no panic").expect("solved");
}

#[tokio::test]
async fn a_tenant_with_much_work_holds_up_another_by_one_piece_of_it() {
    let (manager, control) = manager(limits(|config| config.compute_slots = 1));
    let (many, few) = (Tenant("many".into()), Tenant("few".into()));
    let mut sessions = Vec::new();
    for k in 0..13 {
        let owner = if k < 12 { &many } else { &few };
        let created = manager.create(owner, model("points 4"), options(), None).await;
        let id = created.expect("created").value.id;
        let set = manager.set_handles(owner, &id, handles(&["a"]), None).await;
        set.expect("set");
        sessions.push((owner.clone(), id));
    }
    control.hold();
    let (done, few_done) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicBool::new(false)));
    for (k, (owner, id)) in sessions.into_iter().enumerate() {
        let (manager, done, few_done) = (manager.clone(), Arc::clone(&done), Arc::clone(&few_done));
        let own_manager = manager.clone();
        tokio::spawn(async move {
            own_manager
                .solve(&owner, &id, solve(&[("a", 1.0)]), None)
                .await
                .expect("solved");
            few_done.fetch_or(&*owner.0 == "few", SeqCst);
            done.fetch_add(1, SeqCst);
        });
        // One computes, and the others wait in the order in which they came.
        until(|| manager.metrics().pool_waiting.get() == k as i64).await;
    }
    for round in 1..=13 {
        control.held_up().await;
        control.step(CYCLES);
        until(|| done.load(SeqCst) == round).await;
        // After the one that computed, and one of the other tenant's eleven that came before.
        assert_eq!(few_done.load(SeqCst), round >= 3, "after {round}");
    }
}

#[tokio::test]
async fn a_line_on_one_session_that_is_too_long_is_reported_before_it_was_waited_for() {
    let (fixture, control) = Fixture::with(|config| config.compute_wait = Duration::from_millis(500)).await;
    control.hold();
    let begin = || fixture.solving(solve(&[("a", 1.0)]));
    takes_long(&fixture, &control).await;
    let held = begin();
    control.held_up().await;
    // The one that is served takes 400 ms again, and two such are more than may be waited for; one may be waited for.
    let waits = begin();
    let refused = loop {
        let tried = fixture.manager.solve(tenant(), &fixture.id, solve(&[("a", 1.0)]), None);
        match tokio::time::timeout(Duration::from_millis(20), tried).await {
            Ok(answer) => break answer.expect_err("too long"),
            // The others had not joined the line yet.
            Err(_) => continue,
        }
    };
    assert_eq!(refused.http_status(), 429);
    assert!(
        refused
            .message
            .contains("calls wait on this session already, which take about 1 s"),
        "{refused}"
    );
    control.release();
    held.await.expect("no panic").expect("solved");
    // It may have waited too long meanwhile; whatever it hears, it hears.
    let _ = waits.await.expect("no panic");
}

#[tokio::test]
async fn what_cannot_begin_in_time_is_refused_and_nothing_is_held_for_it() {
    let (manager, control) = manager(SessionConfig {
        compute_slots: 1,
        compute_wait: Duration::from_millis(10),
        ..small()
    });
    let (first, second) = (Fixture::of(&manager).await, Fixture::of(&manager).await);
    control.hold();
    takes_long(&first, &control).await;
    let held = first.solving(solve(&[("a", 1.0)]));
    control.held_up().await;
    let refused = second.refuses(solve(&[("a", 1.0)])).await;
    assert_eq!((refused.http_status(), refused.retry_after_s), (429, Some(1)));
    assert!(refused.message.contains("is expected to take"), "{refused}");
    assert_eq!(manager.metrics().pool_waiting.get(), 0);
    control.step(CYCLES);
    held.await.expect("no panic").expect("solved");
    control.release();
    // A slot that is free is given whatever was expected.
    second.solve(solve(&[("a", 1.0)])).await;
}

#[tokio::test]
async fn a_tenant_that_builds_on_all_slots_leaves_one_for_another() {
    let (manager, control) = manager(small());
    let (many, few) = (Tenant("many".into()), Tenant("few".into()));
    control.hold();
    let build = |owner: &Tenant| {
        let (manager, owner) = (manager.clone(), owner.clone());
        tokio::spawn(async move { manager.create(&owner, model("slow 4"), options(), None).await })
    };
    let mut long = vec![build(&many), build(&many)];
    until(|| manager.metrics().pool_busy.get() == 2).await;
    long.push(build(&many));
    until(|| manager.metrics().pool_waiting.get() == 1).await;
    let created = manager.create(&few, model("points 4"), options(), None).await;
    created.expect("a slot is left");
    let busy = (manager.metrics().pool_busy.get(), manager.metrics().pool_waiting.get());
    assert_eq!(busy, (2, 1), "the others still build and wait");
    control.release();
    for build in long {
        build.await.expect("no panic").expect("created");
    }
}
