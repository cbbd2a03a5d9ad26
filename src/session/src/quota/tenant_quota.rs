//! What a tenant may use.
//!
//! An amount a minute, which may also be used at once.

use crate::answers::Tenant;
use crate::capacity::call_queue::MIN_TTL;
use crate::error::Error;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Times that make sense.
const SPANS: RangeInclusive<Duration> = MIN_TTL..=Duration::from_secs(100 * 365 * 24 * 3600);

/// This says what one tenant may use. What is absent is bounded by the server's own limits alone.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TenantQuota {
    /// Sessions held at a time.
    pub sessions: Option<u64>,
    /// Bytes that its sessions together hold in memory.
    pub memory_bytes: Option<u64>,
    /// Bytes that its sessions together hold in the store.
    pub stored_bytes: Option<u64>,
    /// Bytes of models and clips sent in a minute.
    pub upload_bytes_per_minute: Option<u64>,
    /// Seconds of computing in a minute, of all threads as one.
    pub solve_seconds_per_minute: Option<f64>,
    /// Streams open at a time, on all its sessions.
    pub streams: Option<u64>,
    /// How long an unused session of its lives that names no time of its own.
    pub ttl: Option<Duration>,
    /// The longest time that its sessions may name.
    pub max_ttl: Option<Duration>,
    /// How long it is kept who did what.
    pub audit_age: Option<Duration>,
}

impl TenantQuota {
    /// The same, with what is absent taken from `default`.
    #[must_use]
    pub fn over(self, default: &Self) -> Self {
        Self {
            sessions: self.sessions.or(default.sessions),
            memory_bytes: self.memory_bytes.or(default.memory_bytes),
            stored_bytes: self.stored_bytes.or(default.stored_bytes),
            upload_bytes_per_minute: self.upload_bytes_per_minute.or(default.upload_bytes_per_minute),
            solve_seconds_per_minute: self.solve_seconds_per_minute.or(default.solve_seconds_per_minute),
            streams: self.streams.or(default.streams),
            ttl: self.ttl.or(default.ttl),
            max_ttl: self.max_ttl.or(default.max_ttl),
            audit_age: self.audit_age.or(default.audit_age),
        }
    }

    /// Checks that every value makes sense; 0 never means "no limit".
    ///
    /// # Errors
    /// `INVALID_ARGUMENT` with the key and what is allowed.
    pub fn validate(&self) -> Result<(), Error> {
        let counts = [
            ("sessions", self.sessions),
            ("memory_bytes", self.memory_bytes),
            ("stored_bytes", self.stored_bytes),
            ("upload_bytes_per_minute", self.upload_bytes_per_minute),
            ("streams", self.streams),
        ];
        for (key, value) in counts {
            if value == Some(0) {
                return Err(Error::invalid(key, "is 0, at least 1 is allowed"));
            }
        }
        for (key, value) in [
            ("ttl", self.ttl),
            ("max_ttl", self.max_ttl),
            ("audit_age", self.audit_age),
        ] {
            if let Some(span) = value.filter(|span| !SPANS.contains(span)) {
                let [least, most, span] = [*SPANS.start(), *SPANS.end(), span].map(humantime::format_duration);
                return Err(Error::invalid(key, format!("is {span}, {least} to {most} are allowed")));
            }
        }
        match self.solve_seconds_per_minute {
            Some(seconds) if !(seconds > 0.0 && seconds <= 1e6) => Err(Error::invalid(
                "solve_seconds_per_minute",
                format!("is {seconds}, above 0 and at most 1000000 is allowed"),
            )),
            _ => Ok(()),
        }
    }
}

/// The quotas of all tenants.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TenantQuotas {
    /// Of who is not named below.
    pub default: TenantQuota,
    /// By the name of the tenant.
    pub named: BTreeMap<String, TenantQuota>,
}

impl TenantQuotas {
    /// The quota of a tenant.
    pub fn of(&self, tenant: &Tenant) -> TenantQuota {
        let named = self.named.get(&*tenant.0);
        named.map_or_else(|| self.default.clone(), |quota| quota.clone().over(&self.default))
    }
}

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
mod token_bucket_tests {
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
