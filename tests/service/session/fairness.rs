//! Who computes next when there is less than everybody wants.

use super::fake::*;
use pliant::session::{SessionConfig, Tenant};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst};
use std::time::Duration;

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
    let (manager, control) = manager(SessionConfig {
        compute_slots: 1,
        ..small()
    });
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
async fn a_line_on_one_session_that_is_too_long_is_told_before_it_was_waited_for() {
    let (fixture, control) = Fixture::fake(SessionConfig {
        compute_wait: Duration::from_millis(500),
        ..small()
    })
    .await;
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
