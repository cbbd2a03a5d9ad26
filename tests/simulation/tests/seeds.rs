//! Seeds: that nothing is found, that a seed gives the same run each time, and that old bugs are found again when they are put back.

use simulation::{OldBug, Outcome, run};

/// Seeds of an ordinary test run. `cargo run -p simulation -- --seeds 10000` runs more.
const SEEDS: u64 = 6;

/// Seeds that found something, with what it was.
const FOUND: [(u64, &str); 1] = [(
    45,
    "a node that started remembered the key of a commit that another node then took back: ALREADY_EXISTS, what it changed is gone",
)];

fn assert_clean(seed: u64, outcome: &Outcome) {
    let found = outcome.violations.join("\n");
    assert!(outcome.violations.is_empty(), "seed {seed}: {found}");
}

#[test]
fn nothing_acknowledged_is_lost_or_doubled_whatever_goes_wrong() {
    let (mut operations, mut faults) = (0, 0);
    for seed in 0..SEEDS {
        let outcome = run(seed, None);
        assert_clean(seed, &outcome);
        operations += outcome.operations;
        faults += outcome.faults;
    }
    println!("{operations} calls, {faults} faults");
    assert!(
        operations > SEEDS * 50 && faults > SEEDS * 5,
        "{operations} calls, {faults} faults"
    );
}

#[test]
fn what_was_found_once_stays_mended() {
    for (seed, what) in FOUND {
        println!("seed {seed}: {what}");
        assert_clean(seed, &run(seed, None));
    }
}

#[test]
fn a_seed_gives_the_same_run_each_time() {
    for seed in [3, 1 << 40] {
        let (first, second) = (run(seed, None), run(seed, None));
        assert!(first.trace.len() > 1000, "something happens");
        assert_eq!(first, second);
    }
}

/// Whether a seed finds a bug that was put back.
fn finds(bug: OldBug, seed: u64) -> bool {
    !run(seed, Some(bug)).violations.is_empty()
}

#[test]
fn old_bugs_are_found_again() {
    for (bug, seed) in [
        (OldBug::NoKeyOfCommit, 14),
        (OldBug::NoFence, 5),
        (OldBug::KeyOfRefusedCommit, 8),
    ] {
        assert!(finds(bug, seed), "{bug:?} is not found by seed {seed}");
        assert_clean(seed, &run(seed, None));
    }
}
