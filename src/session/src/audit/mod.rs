//! The audit trail: who opened, changed and exported what. With a store an entry is a row, written with its change;
//! without one, a log line.

pub(crate) mod audit_entry;
pub(crate) mod audit_trail;
