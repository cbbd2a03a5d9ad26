//! An amount a minute, which may also be used at once.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Holds as much as a minute brings, and is full at first.
#[derive(Debug)]
pub(super) struct TokenBucket {
    a_minute: f64,
    level: Mutex<Level>,
}

#[derive(Debug)]
struct Level {
    /// Below zero where more was used than there was.
    left: f64,
    at: Instant,
}

impl TokenBucket {
    /// A full one.
    pub fn new(a_minute: f64, now: Instant) -> Self {
        Self {
            a_minute,
            level: Mutex::new(Level {
                left: a_minute,
                at: now,
            }),
        }
    }

    /// What a minute brings.
    pub fn a_minute(&self) -> f64 {
        self.a_minute
    }

    /// What is left now; below zero where more was used than there was.
    pub fn left(&self, now: Instant) -> f64 {
        self.change(now, |_| {})
    }

    /// Takes an amount that is already used.
    pub fn charge(&self, amount: f64, now: Instant) {
        self.change(now, |left| *left -= amount);
    }

    /// Takes an amount if it is there.
    ///
    /// # Errors
    /// How long it takes until it will be, if nothing else is taken.
    pub fn take(&self, amount: f64, now: Instant) -> Result<(), Duration> {
        let mut short = 0.0;
        self.change(now, |left| {
            if amount <= *left {
                *left -= amount;
            } else {
                short = amount - *left;
            }
        });
        if short > 0.0 { Err(self.time_for(short)) } else { Ok(()) }
    }

    /// Asks whether anything is left.
    ///
    /// # Errors
    /// How long it takes until something is.
    pub fn check(&self, now: Instant) -> Result<(), Duration> {
        let left = self.left(now);
        if left > 0.0 { Ok(()) } else { Err(self.time_for(-left)) }
    }

    fn time_for(&self, amount: f64) -> Duration {
        // Within what a duration can be, whatever the amount.
        Duration::from_secs_f64((amount / self.a_minute * 60.0).clamp(0.0, 1e6))
    }

    fn change(&self, now: Instant, change: impl FnOnce(&mut f64)) -> f64 {
        let mut level = self.level.lock().unwrap_or_else(PoisonError::into_inner);
        let passed = now.saturating_duration_since(level.at).as_secs_f64();
        level.left = (level.left + passed / 60.0 * self.a_minute).min(self.a_minute);
        level.at = level.at.max(now);
        change(&mut level.left);
        level.left
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_fills_with_time_up_to_a_minutes_worth() {
        let start = Instant::now();
        let after = |seconds| start + Duration::from_secs(seconds);
        let bucket = TokenBucket::new(120.0, start);
        assert_eq!(bucket.take(100.0, start), Ok(()));
        assert_eq!(
            bucket.take(100.0, start),
            Err(Duration::from_secs(40)),
            "80 are missing, 2 a second come"
        );
        assert_eq!(
            bucket.take(100.0, after(40)),
            Ok(()),
            "the wait that it named is enough"
        );
        assert_eq!(bucket.left(after(4000)), 120.0);
    }

    #[test]
    fn what_was_used_and_not_there_is_worked_off() {
        let start = Instant::now();
        let bucket = TokenBucket::new(60.0, start);
        bucket.charge(90.0, start);
        assert_eq!(bucket.check(start), Err(Duration::from_secs(30)));
        assert_eq!(bucket.check(start + Duration::from_secs(31)), Ok(()));
        // Time that goes backwards brings nothing.
        assert!((bucket.left(start) - 1.0).abs() < 1e-9, "{}", bucket.left(start));
    }
}
