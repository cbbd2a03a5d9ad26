//! Which case runs in which shard.

use sha2::{Digest as _, Sha256};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

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
    let mut hash = Sha256::new();
    for text in texts {
        hash.update((text.len() as u64).to_le_bytes());
        hash.update(text);
    }
    let hex: String = hash.finalize().iter().map(|b| format!("{b:02x}")).collect();
    format!("sha256:{hex}")
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let told = |cases: &[(&str, u64)]| {
            let split = split_cases(cases, 5);
            let mut all: Vec<(String, u32)> = cases.iter().zip(split).map(|(c, n)| (c.0.to_owned(), n)).collect();
            all.sort();
            all
        };
        assert_eq!(told(&cases), told(&turned));
        let of = |split: &[(String, u32)]| {
            let split: Vec<(&str, u32)> = split.iter().map(|(name, n)| (name.as_str(), *n)).collect();
            split_digest(&split, 5)
        };
        assert_eq!(of(&told(&cases)), of(&told(&turned)));
    }

    #[test]
    fn cases_that_cost_nothing_are_spread_as_well() {
        let cases: Vec<(&str, u64)> = ["a", "b", "c", "d"].map(|name| (name, 0)).into();
        assert_eq!(split_cases(&cases, 2), [1, 2, 1, 2]);
    }

    #[test]
    fn a_digest_tells_splits_apart() {
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
