//! Turns in the line, counted: no time passes here.

use super::*;
use proptest::prelude::*;

fn owner(tenant: &str, session: &str) -> WorkOwner {
    WorkOwner {
        tenant: Tenant(tenant.into()),
        session: session.to_owned(),
    }
}

fn patient() -> Option<Duration> {
    Some(Duration::from_secs(1))
}

fn free(line: &Arc<FairLine>) -> LinePermit {
    match line.enter(&owner("held", "held"), patient()) {
        Ok(LinePlace::Free(permit)) => permit,
        other => panic!("{other:?}"),
    }
}

fn wait(line: &Arc<FairLine>, tenant: &str, session: &str) -> WaitingPlace {
    match line.enter(&owner(tenant, session), patient()) {
        Ok(LinePlace::Waiting(place)) => place,
        other => panic!("{other:?}"),
    }
}

/// Passes a permit on, and says in which order those who wait get it.
fn served<T: Copy>(permit: LinePermit, waiting: Vec<(T, WaitingPlace)>) -> Vec<T> {
    let mut order = Vec::new();
    let mut waiting: Vec<_> = waiting.into_iter().map(Some).collect();
    drop(permit);
    while order.len() < waiting.len() {
        let turns = waiting.iter_mut().filter_map(|place| {
            let (_, waits) = place.as_mut()?;
            let permit = waits.turn.try_recv().ok()?.ok()?;
            Some((place.take()?.0, permit))
        });
        let mut turns: Vec<_> = turns.collect();
        assert_eq!(turns.len(), 1, "one slot, one turn");
        let (name, permit) = turns.remove(0);
        order.push(name);
        drop(permit);
    }
    order
}

#[test]
fn tenants_take_turns_and_in_them_sessions() {
    let line = FairLine::new(1, 100);
    let permit = free(&line);
    let asked = [
        ("a", "1"),
        ("a", "1"),
        ("a", "1"),
        ("a", "1"),
        ("a", "2"),
        ("b", "1"),
        ("b", "1"),
        ("a", "2"),
        ("c", "1"),
    ];
    let waiting = asked.map(|(tenant, session)| ((tenant, session), wait(&line, tenant, session)));
    let order = served(permit, waiting.into_iter().collect());
    let expected = [
        ("a", "1"),
        ("b", "1"),
        ("c", "1"),
        ("a", "2"),
        ("b", "1"),
        ("a", "1"),
        ("a", "2"),
        ("a", "1"),
        ("a", "1"),
    ];
    assert_eq!(order, expected);
    drop(free(&line));
}

#[test]
fn a_newcomer_waits_for_one_piece_of_work_of_each_tenant_however_much_they_want() {
    let line = FairLine::new(1, 1000);
    let permit = free(&line);
    let mut waiting: Vec<_> = (0..100).map(|_| ("flood", wait(&line, "flood", "1"))).collect();
    waiting.push(("other", wait(&line, "other", "1")));
    waiting.push(("newcomer", wait(&line, "new", "1")));
    let order = served(permit, waiting);
    assert_eq!(order.iter().position(|who| *who == "newcomer"), Some(2));
}

#[test]
fn a_full_line_makes_way_for_a_tenant_that_has_less_in_it() {
    let line = FairLine::new(1, 4);
    let permit = free(&line);
    let mut flood: Vec<_> = (0..4).map(|k| wait(&line, "flood", ["1", "2"][k % 2])).collect();
    assert!(matches!(
        line.enter(&owner("flood", "3"), patient()),
        Err(LineRefusal::Full)
    ));
    let other = [wait(&line, "other", "1"), wait(&line, "other", "1")];
    // The last of each session had to go; now both have two, and nobody makes way any more.
    let gone: Vec<bool> = flood
        .iter_mut()
        .map(|p| matches!(p.turn.try_recv(), Ok(Err(LineRefusal::Full))))
        .collect();
    assert_eq!(gone, [false, false, true, true]);
    assert!(matches!(
        line.enter(&owner("other", "1"), patient()),
        Err(LineRefusal::Full)
    ));
    // A third tenant has none, and gets one from the last of those that have most.
    let third = wait(&line, "third", "1");
    flood.truncate(2);
    let left: Vec<_> = flood.into_iter().chain(other).chain([third]).collect();
    assert_eq!(line.lock().refusable(), 4);
    drop((permit, left));
    drop(free(&line));
}

#[test]
fn frames_wait_for_ever_and_take_nobodys_place() {
    let line = FairLine::new(1, 1);
    let permit = free(&line);
    line.note_service(Duration::from_secs(3600));
    let frames: Vec<_> = (0..5).map(|_| line.enter(&owner("a", "1"), None)).collect();
    assert!(frames.iter().all(|f| matches!(f, Ok(LinePlace::Waiting(_)))));
    let patience = Some(Duration::from_secs(10 * 3600));
    let one = line.enter(&owner("a", "2"), patience);
    assert!(matches!(one, Ok(LinePlace::Waiting(_))));
    assert!(matches!(line.enter(&owner("a", "2"), patience), Err(LineRefusal::Full)));
    drop((permit, frames, one));
    drop(free(&line));
}

#[test]
fn what_is_expected_counts_turns_and_slots() {
    let line = FairLine::new(2, 100);
    let permits = [free(&line), free(&line)];
    line.note_service(Duration::from_secs(8));
    let _waiting: Vec<_> = (0..3)
        .map(|_| line.enter(&owner("a", "1"), Some(Duration::from_secs(100))))
        .collect();
    let asked = |tenant: &str, session: &str| match line.enter(&owner(tenant, session), patient()) {
        Err(LineRefusal::TooLong(expected)) => expected.as_secs(),
        other => panic!("{other:?}"),
    };
    // Three wait before another of that session, one before another session or tenant.
    assert_eq!((asked("a", "1"), asked("a", "2"), asked("b", "1")), (16, 8, 8));
    drop(permits);
}

#[test]
fn who_gives_up_leaves_no_trace() {
    let line = FairLine::new(1, 100);
    let permit = free(&line);
    let (first, second) = (wait(&line, "a", "1"), wait(&line, "b", "1"));
    drop(first);
    drop(permit);
    // It is the second one's turn, and that one goes without taking it.
    drop(second);
    drop(free(&line));
    assert!(line.lock().tenants.is_empty());
}

proptest! {
    /// What is told of a place in the line is how many are served before it.
    #[test]
    fn the_rank_is_how_many_come_before(asked in prop::collection::vec((0usize..4, 0usize..3), 0..30), served_first in 0usize..10) {
        let names = ["a", "b", "c", "d"];
        let line = FairLine::new(1, 1000);
        let mut permit = free(&line);
        let mut waiting: Vec<_> = asked.iter().map(|(t, s)| Some(wait(&line, names[*t], names[*s]))).collect();
        // Some are served, so that turns are anywhere.
        for _ in 0..served_first.min(waiting.len()) {
            drop(permit);
            let turn = waiting.iter_mut().find_map(|place| {
                let got = place.as_mut()?.turn.try_recv().ok()?.ok()?;
                *place = None;
                Some(got)
            });
            permit = turn.expect("somebody's turn");
        }
        let newcomer = owner(names[asked.first().map_or(0, |a| a.0)], "b");
        let rank = line.lock().rank(&newcomer);
        let mut left: Vec<_> = waiting.into_iter().flatten().map(|place| (false, place)).collect();
        left.push((true, wait(&line, &newcomer.tenant.0, &newcomer.session)));
        let order = served(permit, left);
        prop_assert_eq!(order.iter().position(|is_newcomer| *is_newcomer), Some(rank));
    }
}
