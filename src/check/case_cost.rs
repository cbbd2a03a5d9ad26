//! What a case costs to run, so that a suite can be split evenly.
//!
//! Costs are whole numbers and follow from files alone, so that every machine comes to the same ones.

use super::golden::Golden;
use super::metric::Metric;
use std::collections::BTreeMap;

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

#[cfg(test)]
mod tests {
    use super::super::case_result::CaseResult;
    use super::super::golden::InputHashes;
    use super::*;
    use glam::DVec3;

    fn golden(vertices: usize, cycles: Option<f64>, frames: usize) -> Golden {
        let found = CaseResult {
            positions: vec![DVec3::ONE; vertices],
            numbers: cycles.map(|c| (Metric::Cycles, c)).into_iter().collect(),
            frames: vec!["xxh3:1".into(); frames],
            ..Default::default()
        };
        let inputs = InputHashes {
            model: String::new(),
            job: String::new(),
        };
        Golden::from_result(&found, inputs)
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
}
