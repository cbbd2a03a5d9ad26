//! What a run has seen: lines that are the same each time, and what must not be.

use crate::time::elapsed;
use std::fmt::Write as _;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// What a run has seen so far. Clones share it.
#[derive(Debug, Clone, Default)]
pub struct Report(Arc<Mutex<Seen>>);

#[derive(Debug, Default)]
struct Seen {
    trace: String,
    violations: Vec<String>,
    operations: u64,
    starts: u64,
}

/// What a run has seen.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Outcome {
    /// What happened, a line each.
    pub trace: String,
    /// What must not be.
    pub violations: Vec<String>,
    /// Operations that clients got an answer to.
    pub operations: u64,
    /// How often a node started.
    pub starts: u64,
    /// Faults that were injected.
    pub faults: u64,
    /// Simulated milliseconds.
    pub milliseconds: u64,
    /// Transactions of the database.
    pub transactions: u64,
}

impl Report {
    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes what happened.
    pub fn line(&self, what: impl std::fmt::Display) {
        self.line_at(elapsed(), what);
    }

    /// Notes what happened at that time.
    pub fn line_at(&self, at: Duration, what: impl std::fmt::Display) {
        let _ = writeln!(self.seen().trace, "{:7} {what}", at.as_millis());
    }

    /// Notes what must not be.
    pub fn violation(&self, what: impl Into<String>) {
        let what = what.into();
        self.line(format_args!("VIOLATION {what}"));
        self.seen().violations.push(what);
    }

    /// Counts an operation.
    pub fn count_operation(&self) {
        self.seen().operations += 1;
    }

    /// Counts the start of a node.
    pub fn count_start(&self) {
        self.seen().starts += 1;
    }

    /// Whether anything was seen that must not be.
    pub fn is_violated(&self) -> bool {
        !self.seen().violations.is_empty()
    }

    /// All of it; counts of the run are the caller's.
    pub fn outcome(&self) -> Outcome {
        let seen = self.seen();
        Outcome {
            trace: seen.trace.clone(),
            violations: seen.violations.clone(),
            operations: seen.operations,
            starts: seen.starts,
            ..Outcome::default()
        }
    }
}
