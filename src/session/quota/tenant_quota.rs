//! What a tenant may use.

use crate::session::answers::Tenant;
use crate::session::capacity::session_lease::MIN_TTL;
use crate::session::error::Error;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::time::Duration;

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
