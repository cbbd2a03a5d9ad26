//! Who opened, changed and took away what. With a store it is a row, on disk with the change that it tells of; without one a line of the log.

pub(in crate::session) mod audit_entry;
pub(in crate::session) mod audit_trail;
