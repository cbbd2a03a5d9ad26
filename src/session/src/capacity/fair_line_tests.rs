//! Turns in the line, counted: no time passes here.

use super::*;
use crate::answers::Tenant;
use proptest::prelude::*;

const DRAG: TurnClass = TurnClass::Drag;
const OTHER: TurnClass = TurnClass::Other;

fn owner(tenant: &str, session: &str) -> WorkOwner {
    WorkOwner {
        tenant: Tenant(tenant.into()),
        session: session.to_owned(),
    }
}

fn line_of(all: usize, for_drags: usize, most: usize) -> Arc<FairLine> {
    let slots = LineSlots {
        all,
        for_drags,
        one_for_another_tenant: false,
    };
    FairLine::new(slots, most)
}

fn patient() -> Option<Duration> {
    Some(Duration::from_secs(1))
}

fn free(line: &Arc<FairLine>) -> LinePermit {
    free_of(line, OTHER)
}

fn free_of(line: &Arc<FairLine>, class: TurnClass) -> LinePermit {
    match line.enter(class, &owner("held", "held"), patient()) {
        Ok(LinePlace::Free(permit)) => permit,
        other => panic!("{other:?}"),
    }
}

fn wait(line: &Arc<FairLine>, tenant: &str, session: &str) -> WaitingPlace {
    wait_of(line, OTHER, tenant, session)
}

fn wait_of(line: &Arc<FairLine>, class: TurnClass, tenant: &str, session: &str) -> WaitingPlace {
    match line.enter(class, &owner(tenant, session), patient()) {
        Ok(LinePlace::Waiting(place)) => place,
        other => panic!("{other:?}"),
    }
}

/// Passes a permit on and returns the order in which places get it.
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
    let line = line_of(1, 0, 100);
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
    let line = line_of(1, 0, 1000);
    let permit = free(&line);
    let mut waiting: Vec<_> = (0..100).map(|_| ("flood", wait(&line, "flood", "1"))).collect();
    waiting.push(("other", wait(&line, "other", "1")));
    waiting.push(("newcomer", wait(&line, "new", "1")));
    let order = served(permit, waiting);
    assert_eq!(order.iter().position(|who| *who == "newcomer"), Some(2));
}

#[test]
fn a_full_line_makes_way_for_a_tenant_that_has_less_in_it() {
    let line = line_of(1, 0, 4);
    let permit = free(&line);
    let mut flood: Vec<_> = (0..4).map(|k| wait(&line, "flood", ["1", "2"][k % 2])).collect();
    assert!(matches!(
        line.enter(OTHER, &owner("flood", "3"), patient()),
        Err(LineRefusal::Full)
    ));
    let other = [wait(&line, "other", "1"), wait(&line, "other", "1")];
    // The last of each session had to go; now both have two, and none makes way any more.
    let gone: Vec<bool> = flood
        .iter_mut()
        .map(|p| matches!(p.turn.try_recv(), Ok(Err(LineRefusal::Full))))
        .collect();
    assert_eq!(gone, [false, false, true, true]);
    assert!(matches!(
        line.enter(OTHER, &owner("other", "1"), patient()),
        Err(LineRefusal::Full)
    ));
    // A third tenant has none, and gets one from the last of those that have most.
    let third = wait(&line, "third", "1");
    flood.truncate(2);
    let left: Vec<_> = flood.into_iter().chain(other).chain([third]).collect();
    assert_eq!(line.lock().others.waiting.refusable(), 4);
    drop((permit, left));
    drop(free(&line));
}

#[test]
fn frames_wait_for_ever_and_take_nobodys_place() {
    let line = line_of(1, 0, 1);
    let permit = free(&line);
    line.note_service(OTHER, Duration::from_secs(3600));
    let frames: Vec<_> = (0..5).map(|_| line.enter(OTHER, &owner("a", "1"), None)).collect();
    assert!(frames.iter().all(|f| matches!(f, Ok(LinePlace::Waiting(_)))));
    let patience = Some(Duration::from_secs(10 * 3600));
    let one = line.enter(OTHER, &owner("a", "2"), patience);
    assert!(matches!(one, Ok(LinePlace::Waiting(_))));
    assert!(matches!(
        line.enter(OTHER, &owner("a", "2"), patience),
        Err(LineRefusal::Full)
    ));
    drop((permit, frames, one));
    drop(free(&line));
}

#[test]
fn what_is_expected_counts_turns_and_slots() {
    let line = line_of(2, 0, 100);
    let permits = [free(&line), free(&line)];
    line.note_service(OTHER, Duration::from_secs(8));
    let _waiting: Vec<_> = (0..3)
        .map(|_| line.enter(OTHER, &owner("a", "1"), Some(Duration::from_secs(100))))
        .collect();
    let asked = |tenant: &str, session: &str| match line.enter(OTHER, &owner(tenant, session), patient()) {
        Err(LineRefusal::TooLong(expected)) => expected.as_secs(),
        other => panic!("{other:?}"),
    };
    // Three wait before another of that session, one before another session or tenant.
    assert_eq!((asked("a", "1"), asked("a", "2"), asked("b", "1")), (16, 8, 8));
    drop(permits);
}

#[test]
fn who_gives_up_leaves_no_trace() {
    let line = line_of(1, 0, 100);
    let permit = free(&line);
    let (first, second) = (wait(&line, "a", "1"), wait(&line, "b", "1"));
    drop(first);
    drop(permit);
    // It is the second one's turn, and that one goes without taking it.
    drop(second);
    drop(free(&line));
    assert!(line.lock().others.waiting.is_empty());
}

/// Serves that many turns while drags and the rest ask again after each turn; returns their classes.
fn turns_of_asking_again(line: &Arc<FairLine>, mut permit: LinePermit, turns: usize) -> Vec<TurnClass> {
    let mut waiting: Vec<_> = [DRAG, OTHER]
        .into_iter()
        .flat_map(|class| ["1", "2"].map(|session| (class, session, wait_of(line, class, "a", session))))
        .collect();
    let mut order = Vec::new();
    for _ in 0..turns {
        drop(permit);
        let mut got = None;
        for (class, session, place) in &mut waiting {
            if let Ok(turn) = place.turn.try_recv() {
                got = Some((*class, turn.expect("a turn")));
                *place = wait_of(line, *class, "a", session);
            }
        }
        let (class, next) = got.expect("somebody's turn");
        order.push(class);
        permit = next;
    }
    order
}

#[test]
fn drags_come_first_and_the_rest_gets_every_fourth_turn() {
    let line = line_of(1, 0, 100);
    let permit = free(&line);
    let order = turns_of_asking_again(&line, permit, 12);
    assert_eq!(order, [DRAG, DRAG, DRAG, OTHER].repeat(3));
}

#[test]
fn drags_get_three_times_the_time_of_the_rest_in_bounded_many_turns() {
    for (drag, other, between) in [(10, 10, 3), (30, 10, 3), (10, 50, 15), (1, 1000, 32)] {
        let line = line_of(1, 0, 100);
        let permit = free(&line);
        line.note_service(DRAG, Duration::from_micros(drag));
        line.note_service(OTHER, Duration::from_micros(other));
        let order = turns_of_asking_again(&line, permit, 3 * (between + 1));
        let expected = [vec![DRAG; between], vec![OTHER]].concat().repeat(3);
        assert_eq!(order, expected, "drags take {drag}, the rest {other}");
    }
}

#[test]
fn drags_have_slots_that_nothing_else_gets() {
    let line = line_of(2, 1, 100);
    let others = [free(&line), free(&line)];
    let mut solve = wait(&line, "a", "1");
    let drag = free_of(&line, DRAG);
    let mut next_drag = wait_of(&line, DRAG, "a", "2");
    assert_eq!(line.busy(), 3);
    // Two solves go on: the third waits, whatever else may begin.
    drop(drag);
    let drag = next_drag.turn.try_recv().expect("its turn").expect("a permit");
    assert!(solve.turn.try_recv().is_err());
    drop(drag);
    assert!(solve.turn.try_recv().is_err());
    assert_eq!(line.busy(), 2);
    drop(others);
    let solve = solve.turn.try_recv().expect("its turn").expect("a permit");
    // Drags may take all there are.
    let drags = [free_of(&line, DRAG), free_of(&line, DRAG)];
    let waits = wait(&line, "a", "1");
    assert_eq!(line.busy(), 3);
    drop((solve, drags, waits));
    assert_eq!(line.busy(), 0);
}

#[test]
fn a_flood_of_solves_takes_no_place_of_a_drag() {
    let line = line_of(1, 0, 2);
    let permit = free(&line);
    let flood = [wait(&line, "a", "1"), wait(&line, "a", "2")];
    assert!(matches!(
        line.enter(OTHER, &owner("a", "3"), patient()),
        Err(LineRefusal::Full)
    ));
    let mut drag = wait_of(&line, DRAG, "a", "4");
    drop(permit);
    drop(drag.turn.try_recv().expect("its turn, before the flood's"));
    drop(flood);
}

#[test]
fn tenants_and_their_sessions_take_turns_among_drags_too() {
    let line = line_of(1, 0, 100);
    let permit = free(&line);
    let asked = [("a", "1"), ("a", "1"), ("a", "2"), ("b", "1"), ("b", "1")];
    let waiting = asked.map(|(t, s)| ((t, s), wait_of(&line, DRAG, t, s)));
    let order = served(permit, waiting.into_iter().collect());
    assert_eq!(order, [("a", "1"), ("b", "1"), ("a", "2"), ("b", "1"), ("a", "1")]);
}

#[test]
fn what_is_expected_counts_the_drags_between_solves() {
    let seconds = Duration::from_secs;
    let line = line_of(1, 0, 1000);
    let mut permit = free(&line);
    let expected = |class: TurnClass| match line.enter(class, &owner("c", "1"), Some(Duration::ZERO)) {
        Err(LineRefusal::TooLong(expected)) => expected.as_secs_f64(),
        other => panic!("{other:?}"),
    };
    line.note_service(OTHER, seconds(8));
    line.note_service(DRAG, seconds(1));
    assert_eq!((expected(OTHER), expected(DRAG)), (8.0, 1.0));
    let solve = line.enter(OTHER, &owner("a", "1"), Some(seconds(1000)));
    // A solve may come before it.
    assert_eq!((expected(OTHER), expected(DRAG)), (16.0, 9.0));
    drop(solve);
    // After a while of both, a solve waits for the drags before it as well: 24 of a second each.
    for _ in 0..100 {
        permit = turns_until_a_solve(&line, permit);
    }
    let both = expected(OTHER);
    assert!((both - 32.0).abs() < 0.01, "{both}");
    drop(permit);
}

/// Repeats drags until a solve has had its turn.
fn turns_until_a_solve(line: &Arc<FairLine>, mut permit: LinePermit) -> LinePermit {
    let waits = |class| match line.enter(class, &owner("a", "1"), None) {
        Ok(LinePlace::Waiting(place)) => place,
        other => panic!("{other:?}"),
    };
    let (mut drag, mut solve) = (waits(DRAG), waits(OTHER));
    loop {
        drop(permit);
        if let Ok(turn) = solve.turn.try_recv() {
            return turn.expect("a turn");
        }
        permit = drag.turn.try_recv().expect("its turn").expect("a permit");
        drag = waits(DRAG);
    }
}

proptest! {
    /// The rank of a place in the line is how many are served before it.
    #[test]
    fn the_rank_is_how_many_come_before(asked in prop::collection::vec((0usize..4, 0usize..3), 0..30), served_first in 0usize..10) {
        let names = ["a", "b", "c", "d"];
        let line = line_of(1, 0, 1000);
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
        let rank = line.lock().others.waiting.rank(&newcomer);
        let mut left: Vec<_> = waiting.into_iter().flatten().map(|place| (false, place)).collect();
        left.push((true, wait(&line, &newcomer.tenant.0, &newcomer.session)));
        let order = served(permit, left);
        prop_assert_eq!(order.iter().position(|is_newcomer| *is_newcomer), Some(rank));
    }
}

/// A line of two slots, and one more while a single tenant has both.
fn line_with_reserve() -> Arc<FairLine> {
    let slots = LineSlots {
        all: 2,
        for_drags: 0,
        one_for_another_tenant: true,
    };
    FairLine::new(slots, 100)
}

fn begin(line: &Arc<FairLine>, tenant: &str) -> Option<LinePermit> {
    match line.enter(OTHER, &owner(tenant, "1"), None) {
        Ok(LinePlace::Free(permit)) => Some(permit),
        _ => None,
    }
}

#[test]
fn a_tenant_that_has_all_slots_leaves_one_for_another() {
    let line = line_with_reserve();
    let long = [begin(&line, "a"), begin(&line, "a")].map(|permit| permit.expect("a free slot"));
    assert!(begin(&line, "a").is_none(), "it has all that it gets");
    let other = begin(&line, "b").expect("the slot for another tenant");
    assert!(other.is_reserve() && line.busy() == 3);
    assert!(
        begin(&line, "b").is_none() && begin(&line, "c").is_none(),
        "there is one such slot"
    );
    drop(other);
    assert!(begin(&line, "a").is_none(), "it is for others");
    assert!(begin(&line, "c").is_some_and(|permit| permit.is_reserve()));
    drop(long);
    assert_eq!(line.busy(), 0);
}

#[test]
fn who_waits_gets_the_slot_when_one_tenant_comes_to_have_all() {
    let line = line_with_reserve();
    let [first, second] = [begin(&line, "a"), begin(&line, "b")].map(|permit| permit.expect("a free slot"));
    let mut waiting = [wait(&line, "a", "1"), wait(&line, "c", "1")];
    drop(second);
    let got = waiting
        .each_mut()
        .map(|place| place.turn.try_recv().ok().and_then(Result::ok));
    let reserve = got.each_ref().map(|permit| permit.as_ref().map(LinePermit::is_reserve));
    assert_eq!(reserve, [Some(false), Some(true)]);
    drop((first, got));
    assert_eq!(line.busy(), 0);
}

proptest! {
    /// However tenants come and go, one that has nothing waits for its first turn only while two others have something.
    #[test]
    fn one_tenant_never_keeps_another_out(events in prop::collection::vec((0usize..4, any::<bool>()), 1..80)) {
        let line = line_with_reserve();
        let mut held: [Vec<LinePermit>; 4] = Default::default();
        let mut waiting: Vec<(usize, WaitingPlace)> = Vec::new();
        for (tenant, comes) in events {
            if !comes {
                held[tenant].pop();
            } else {
                match line.enter(OTHER, &owner(&tenant.to_string(), "1"), None) {
                    Ok(LinePlace::Free(permit)) => held[tenant].push(permit),
                    Ok(LinePlace::Waiting(place)) => waiting.push((tenant, place)),
                    Err(why) => prop_assert!(false, "{why:?}"),
                }
            }
            let mut left = Vec::new();
            for (tenant, mut place) in waiting {
                match place.turn.try_recv() {
                    Ok(Ok(permit)) => held[tenant].push(permit),
                    _ => left.push((tenant, place)),
                }
            }
            waiting = left;
            let busy = held.iter().map(Vec::len).sum::<usize>();
            prop_assert!(busy <= 3 && busy == line.busy());
            let active = held.iter().filter(|permits| !permits.is_empty()).count();
            for (tenant, _) in &waiting {
                let others = active - usize::from(!held[*tenant].is_empty());
                prop_assert!(!held[*tenant].is_empty() || others >= 2, "tenant {tenant} waits for {held:?}");
            }
        }
        drop(waiting);
    }
}
