//! The calendar of a run.

use std::time::Duration;

/// When every run begins: 2026-01-01, in milliseconds since 1970.
const BEGIN_MS: u64 = 1_767_225_600_000;

/// Simulated time since the run began; zero outside of a run.
pub fn elapsed() -> Duration {
    turmoil::sim_elapsed().unwrap_or_default()
}

/// Milliseconds since 1970.
pub fn now_ms() -> u64 {
    BEGIN_MS + u64::try_from(elapsed().as_millis()).unwrap_or(u64::MAX)
}
