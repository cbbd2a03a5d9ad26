//! Many times in little memory.

use hdrhistogram::Histogram;
use std::time::Duration;

/// The longest time, in microseconds; longer ones count as this one.
const LONGEST: u64 = 3_600_000_000;

/// Times by how often they occurred, to three digits.
#[derive(Debug, Clone)]
pub(crate) struct Times(Histogram<u64>);

impl Default for Times {
    fn default() -> Self {
        #[allow(clippy::expect_used)]
        Self(Histogram::new_with_bounds(1, LONGEST, 3).expect("the bounds fit each other"))
    }
}

impl Times {
    /// Enters a time.
    pub fn enter(&mut self, time: Duration) {
        let micros = u64::try_from(time.as_micros()).unwrap_or(LONGEST);
        self.0.saturating_record(micros.max(1));
    }

    /// Enters a time in milliseconds; an invalid one counts as 0.
    pub fn enter_ms(&mut self, ms: f64) {
        self.enter(Duration::try_from_secs_f64(ms / 1e3).unwrap_or_default());
    }

    /// Enters all times of another.
    pub fn add(&mut self, other: &Self) {
        // Both have the same bounds.
        let _ = self.0.add(&other.0);
    }

    /// How many there are.
    pub fn count(&self) -> u64 {
        self.0.len()
    }

    /// Milliseconds that the share `q` (0 to 1) of all does not exceed; `None` where there is none.
    pub fn share_ms(&self, q: f64) -> Option<f64> {
        (self.count() > 0).then(|| self.0.value_at_quantile(q) as f64 / 1e3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_known_to_three_digits() {
        let mut times = Times::default();
        assert_eq!(times.share_ms(0.5), None);
        (1..=100).for_each(|ms| times.enter_ms(f64::from(ms)));
        for (q, wanted) in [(0.5, 50.0), (0.99, 99.0), (1.0, 100.0)] {
            let ms = times.share_ms(q).expect("there are times");
            assert!((ms / wanted - 1.0).abs() < 2e-3, "{q}: {ms}");
        }
        let mut both = times.clone();
        both.add(&times);
        both.enter(Duration::from_secs(100_000));
        assert_eq!(both.count(), 201);
        assert!(both.share_ms(1.0).is_some_and(|ms| ms >= 3.5e6));
    }
}
