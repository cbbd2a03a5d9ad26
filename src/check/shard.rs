//! Shards of a suite: which cases are in which, by what each costs.

use super::case::sha256_hex;
use super::golden::Golden;
use super::metric::Metric;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};
use std::fmt;
use std::str::FromStr;

/// Most shards that a suite is split into.
const MOST: u32 = 10_000;

/// A shard is one of the parts that a suite is split into, so that several machines run it together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Shard {
    number: u32,
    of: u32,
}

impl Shard {
    /// Makes a shard of its number, which begins at 1.
    ///
    /// # Errors
    /// What is allowed, where there is no such shard.
    pub fn new(number: u32, of: u32) -> Result<Self, String> {
        if of == 0 || of > MOST {
            return Err(format!("a suite has 1 to {MOST} shards, not {of}"));
        }
        if number == 0 || number > of {
            return Err(format!(
                "there is no shard {number} of {of}, allowed are 1/{of} to {of}/{of}"
            ));
        }
        Ok(Self { number, of })
    }

    /// Its number, from 1 on.
    pub fn number(self) -> u32 {
        self.number
    }

    /// How many there are.
    pub fn of(self) -> u32 {
        self.of
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl FromStr for Shard {
    type Err = String;

    /// Reads `3/8`, or `2+1/8` of a counter that begins at 0.
    ///
    /// ```
    /// use pliant::check::Shard;
    ///
    /// let shard: Shard = "2+1/8".parse()?;
    /// assert_eq!((shard.number(), shard.of(), shard), (3, 8, "3/8".parse()?));
    /// # Ok::<(), String>(())
    /// ```
    fn from_str(text: &str) -> Result<Self, String> {
        let form = || "K/N is needed, such as 3/8, or K+1/N where K begins at 0".to_owned();
        let number = |text: &str| match text.bytes().all(|b| b.is_ascii_digit()) {
            true => text.parse::<u32>().map_err(|_| form()),
            false => Err(form()),
        };
        let (which, of) = text.split_once('/').ok_or_else(form)?;
        let (which, more) = match which.strip_suffix("+1") {
            Some(index) => (index, 1),
            None => (which, 0),
        };
        Self::new(number(which)?.saturating_add(more), number(of)?)
    }
}

/// Assumed cost of opening a model, in solver cycles: reading, welding, graph, hierarchy and fields.
const OPENING: u64 = 30;
/// Assumed cycles of a step or a frame without a count.
const ROUND: u64 = 10;
/// Assumed frames of an animation without a count.
const FRAMES: u64 = 100;
/// Assumed bytes of a model's file per vertex, between binary and text.
const VERTEX_BYTES: u64 = 40;
/// Assumed vertices of a model that has no golden and is not in the suite.
const VERTICES: u64 = 50_000;

/// Case work is what is known of a case before it is run.
#[derive(Debug, Clone, Copy)]
pub struct CaseWork<'a> {
    /// Its golden, which holds what was measured when it was stored.
    pub golden: Option<&'a Golden>,
    /// Bytes of its model's file in the suite; `None` for other files, which some machines lack.
    pub model_bytes: Option<u64>,
    /// Steps of its job, or frames of its animation; `None` where the clip says how many.
    pub rounds: Option<usize>,
}

impl CaseWork<'_> {
    /// Estimates what it costs, in vertices times cycles: of its golden's counts, or, without one, of the model's size and the steps.
    pub fn estimate_cost(&self) -> u64 {
        let count = |n: usize| u64::try_from(n).unwrap_or(u64::MAX);
        let from_file = self.model_bytes.map(|bytes| bytes / VERTEX_BYTES);
        let vertices = match self.golden {
            Some(golden) => count(golden.topology.vertices),
            None => from_file.unwrap_or(VERTICES),
        };
        let frames = self.golden.map(|g| count(g.frames.len())).filter(|n| *n > 0);
        let rounds = frames.or(self.rounds.map(count)).unwrap_or(FRAMES);
        let counted = self.golden.and_then(|g| g.numbers.get(&Metric::Cycles).copied());
        // What a golden holds is finite; a cast of what is negative is 0.
        let cycles = counted.map_or(rounds.saturating_mul(ROUND), |c| c as u64);
        vertices.max(1).saturating_mul(cycles.saturating_add(OPENING))
    }
}

/// Takes the times of a former run, in microseconds, in place of estimates. A case that was not timed has its estimate, brought to
/// microseconds by what the others came to.
///
/// `None` when none of the cases was timed.
pub fn measured_costs(estimates: &[(&str, u64)], timed: &BTreeMap<String, u64>) -> Option<Vec<u64>> {
    let known = |name: &str| timed.get(name).map(|t| (*t).max(1));
    let (mut time, mut estimated) = (0_u128, 0_u128);
    for (name, estimate) in estimates {
        if let Some(took) = known(name) {
            time += u128::from(took);
            estimated += u128::from(*estimate);
        }
    }
    if time == 0 {
        return None;
    }
    // Both sums are at most 2^64 times the number of cases: of a product that is too large the quotient comes first.
    let scaled = |estimate: u64| {
        let estimate = u128::from(estimate);
        let exact = estimate.checked_mul(time).map(|product| product / estimated.max(1));
        exact.unwrap_or_else(|| (estimate / estimated.max(1)).saturating_mul(time))
    };
    let cost = |(name, estimate): &(&str, u64)| {
        known(name).unwrap_or_else(|| u64::try_from(scaled(*estimate)).unwrap_or(u64::MAX).max(1))
    };
    Some(estimates.iter().map(cost).collect())
}

/// Splits cases, given with their costs, into so many shards, as evenly as can be had at once: the dearest first, each to the shard
/// that has least to do. Answers the number of each case's shard, from 1 on.
///
/// Cases of one cost are taken by their names, shards with as much to do by how few cases they have and then by their numbers, so that
/// the order in which the cases are given means nothing. The dearest shard has at most 4/3 - 1/(3n) of what the best split would give it
/// (R. L. Graham, Bounds on multiprocessing timing anomalies, SIAM Journal on Applied Mathematics 17, 1969, theorem 2).
///
/// ```
/// use pliant::check::split_cases;
///
/// let cases = [("a", 5), ("b", 4), ("c", 3), ("d", 2)];
/// assert_eq!(split_cases(&cases, 2), [1, 2, 2, 1]);
/// ```
pub fn split_cases(cases: &[(&str, u64)], shards: u32) -> Vec<u32> {
    let mut order: Vec<usize> = (0..cases.len()).collect();
    order.sort_by_key(|&k| (Reverse(cases[k].1), cases[k].0));
    let mut waiting: BinaryHeap<Reverse<(u128, usize, u32)>> =
        (1..=shards).map(|number| Reverse((0, 0, number))).collect();
    let mut assigned = vec![1; cases.len()];
    for k in order {
        let Some(Reverse((load, count, number))) = waiting.pop() else {
            break;
        };
        assigned[k] = number;
        // Nothing is free, or all such cases would come to one shard.
        waiting.push(Reverse((load + u128::from(cases[k].1.max(1)), count + 1, number)));
    }
    assigned
}

/// Computes the digest of a split: of every case's name with the number of its shard, and of how many shards there are.
pub fn split_digest(cases: &[(&str, u32)], shards: u32) -> String {
    let mut cases = cases.to_vec();
    cases.sort_unstable();
    let mut parts = vec![shards.to_string()];
    for (name, number) in cases {
        parts.extend([name.to_owned(), number.to_string()]);
    }
    digest_texts(parts.iter().map(String::as_bytes))
}

/// Computes the SHA-256 of texts, each with its length, so that no two lists are alike.
pub fn digest_texts<'a>(texts: impl Iterator<Item = &'a [u8]>) -> String {
    format!("sha256:{}", sha256_hex(b"", texts))
}

#[cfg(test)]
mod tests {
    use super::super::case_result::CaseResult;
    use super::super::golden::InputHashes;
    use super::*;
    use glam::DVec3;

    #[test]
    fn a_shard_is_one_of_those_that_there_are() {
        for (text, shard) in [("1/1", (1, 1)), ("8/8", (8, 8)), ("0+1/8", (1, 8)), ("03/8", (3, 8))] {
            assert_eq!(
                text.parse(),
                Ok(Shard {
                    number: shard.0,
                    of: shard.1
                }),
                "{text}"
            );
        }
        for (text, words) in [
            ("0/8", "no shard 0 of 8, allowed are 1/8 to 8/8"),
            ("9/8", "no shard 9 of 8"),
            ("8+1/8", "no shard 9 of 8"),
            ("1/0", "1 to 10000 shards, not 0"),
            ("1/10001", "not 10001"),
            ("4294967295+1/4294967295", "1 to 10000 shards"),
            ("a/b", "K/N is needed, such as 3/8"),
            ("3", "K/N"),
            ("3/8/9", "K/N"),
            ("-1/8", "K/N"),
            ("+1/8", "K/N"),
            ("3/+8", "K/N"),
            ("1+2/8", "K/N"),
            ("/8", "K/N"),
            ("99999999999/8", "K/N"),
            ("", "K/N"),
        ] {
            let reported = text.parse::<Shard>().expect_err(text);
            assert!(reported.contains(words), "{text}: {reported}");
        }
    }

    fn golden(vertices: usize, cycles: Option<f64>, frames: usize) -> Golden {
        let found = CaseResult {
            positions: vec![DVec3::ONE; vertices],
            numbers: cycles.map(|c| (Metric::Cycles, c)).into_iter().collect(),
            frames: vec!["xxh3:1".into(); frames],
            ..Default::default()
        };
        Golden::from_result(&found, InputHashes::default())
    }

    #[test]
    fn what_was_measured_counts_before_what_is_guessed() {
        let work = |golden, model_bytes, rounds| {
            CaseWork {
                golden,
                model_bytes,
                rounds,
            }
            .estimate_cost()
        };
        let stored = golden(1000, Some(20.0), 0);
        assert_eq!(work(Some(&stored), Some(1), Some(99)), 1000 * (20 + OPENING));
        let played = golden(1000, None, 7);
        assert_eq!(work(Some(&played), None, None), 1000 * (7 * ROUND + OPENING));
        assert_eq!(work(None, Some(40_000), Some(3)), 1000 * (3 * ROUND + OPENING));
        assert_eq!(work(None, None, Some(1)), VERTICES * (ROUND + OPENING));
        assert!(work(None, None, None) > work(None, None, Some(1)));
        // Nothing costs nothing, and no number is too large.
        assert!(work(None, Some(0), Some(0)) > 0);
        assert_eq!(work(None, Some(u64::MAX), Some(usize::MAX)), u64::MAX);
        assert_eq!(work(Some(&golden(1, Some(-5.0), 0)), None, None), OPENING);
    }

    #[test]
    fn times_are_taken_and_the_rest_follows_them() {
        let estimates = [("a", 10), ("b", 30), ("c", 40)];
        let timed = |list: &[(&str, u64)]| list.iter().map(|(n, t)| ((*n).to_owned(), *t)).collect();
        assert_eq!(
            measured_costs(&estimates, &timed(&[("a", 500), ("b", 300), ("other", 7)])),
            Some(vec![500, 300, 40 * 800 / 40])
        );
        assert_eq!(measured_costs(&estimates, &timed(&[("other", 7)])), None);
        // A case that took no time is one all the same.
        assert_eq!(measured_costs(&[("a", 10)], &timed(&[("a", 0)])), Some(vec![1]));
        let huge = [("a", u64::MAX), ("b", u64::MAX)];
        assert_eq!(
            measured_costs(&huge, &timed(&[("a", u64::MAX)])),
            Some(vec![u64::MAX, u64::MAX])
        );
    }

    /// Numbers that look like chance, the same in every run.
    fn drawn(seed: u64, count: usize) -> Vec<(String, u64)> {
        let mut state = seed;
        let mut next = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            state >> 33
        };
        (0..count).map(|k| (format!("case-{k}"), next() % 1000)).collect()
    }

    fn named(cases: &[(String, u64)]) -> Vec<(&str, u64)> {
        cases.iter().map(|(name, cost)| (name.as_str(), *cost)).collect()
    }

    #[test]
    fn a_split_is_a_partition_and_even() {
        for (count, shards) in [(0, 3), (1, 1), (5, 8), (97, 8), (400, 7)] {
            let drawn = drawn(7 + count as u64, count);
            let cases = named(&drawn);
            let split = split_cases(&cases, shards);
            assert_eq!(split.len(), count);
            assert!(split.iter().all(|n| (1..=shards).contains(n)));
            let load = |shard: u32| -> u64 {
                let inside = cases.iter().zip(&split).filter(|(_, n)| **n == shard);
                inside.map(|((_, cost), _)| (*cost).max(1)).sum()
            };
            let loads: Vec<u64> = (1..=shards).map(load).collect();
            let total: u64 = loads.iter().sum();
            let dearest = cases.iter().map(|(_, cost)| (*cost).max(1)).max().unwrap_or_default();
            let least = dearest.max(total.div_ceil(u64::from(shards)));
            let most = loads.iter().copied().max().unwrap_or_default();
            assert!(3 * most <= 4 * least, "{count} in {shards}: {loads:?}");
            let used = loads.iter().filter(|l| **l > 0).count();
            assert_eq!(
                used,
                count.min(shards as usize),
                "no shard is empty while another has two"
            );
        }
    }

    #[test]
    fn the_order_of_the_cases_means_nothing() {
        let drawn = drawn(3, 60);
        let cases = named(&drawn);
        let mut turned = cases.clone();
        turned.reverse();
        turned.rotate_left(17);
        let reported = |cases: &[(&str, u64)]| {
            let split = split_cases(cases, 5);
            let mut all: Vec<(String, u32)> = cases.iter().zip(split).map(|(c, n)| (c.0.to_owned(), n)).collect();
            all.sort();
            all
        };
        assert_eq!(reported(&cases), reported(&turned));
        let of = |split: &[(String, u32)]| {
            let split: Vec<(&str, u32)> = split.iter().map(|(name, n)| (name.as_str(), *n)).collect();
            split_digest(&split, 5)
        };
        assert_eq!(of(&reported(&cases)), of(&reported(&turned)));
    }

    #[test]
    fn cases_that_cost_nothing_are_spread_as_well() {
        let cases: Vec<(&str, u64)> = ["a", "b", "c", "d"].map(|name| (name, 0)).into();
        assert_eq!(split_cases(&cases, 2), [1, 2, 1, 2]);
    }

    #[test]
    fn a_digest_distinguishes_splits() {
        let one = split_digest(&[("a", 1), ("b", 2)], 2);
        assert_eq!(one, split_digest(&[("b", 2), ("a", 1)], 2));
        for other in [
            split_digest(&[("a", 2), ("b", 1)], 2),
            split_digest(&[("a", 1), ("b", 2)], 3),
            split_digest(&[("a", 1), ("b", 2), ("c", 2)], 2),
            split_digest(&[("a1", 1), ("b", 2)], 2),
        ] {
            assert_ne!(one, other);
        }
    }
}
