//! Numbers that follow from a seed (SplitMix64: Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators").

use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// A sequence of numbers. Clones share it.
#[derive(Debug, Clone)]
pub struct Random(Arc<Mutex<u64>>);

impl Random {
    /// The sequence of a seed.
    pub fn of(seed: u64) -> Self {
        Self(Arc::new(Mutex::new(seed)))
    }

    /// A sequence of its own, which follows from the next number of this one.
    #[must_use]
    pub fn split(&self) -> Self {
        Self::of(self.number())
    }

    /// The next number.
    pub fn number(&self) -> u64 {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// A number of a range, which must not be empty.
    pub fn below(&self, range: Range<u64>) -> u64 {
        range.start + self.number() % (range.end - range.start)
    }

    /// True so many times of a thousand.
    pub fn happens(&self, per_mille: u64) -> bool {
        self.below(0..1000) < per_mille
    }

    /// A time of so many milliseconds.
    pub fn span(&self, range: Range<u64>) -> Duration {
        Duration::from_millis(self.below(range))
    }
}
