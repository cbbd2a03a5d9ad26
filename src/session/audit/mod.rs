//! The audit trail: who opened, changed and exported what. With a store an entry is a row, written with its change;
//! without one, a log line.

pub(in crate::session) mod audit_entry;
pub(in crate::session) mod audit_trail;
