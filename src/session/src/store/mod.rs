//! Stored sessions: the log of their commits in a database, models and shapes as objects.
//!
//! A commit is a row, written and synced before it is acknowledged. Large data is an object, named by its content,
//! written and synced before the row that names it. The store trusts nothing that it reads: rows carry checksums,
//! objects are compared with their names, and what does not fit is reported as damage and never served.
//!
//! | file | what |
//! |---|---|
//! | `session_store` | what sessions write and read, and the errors |
//! | `location` | where a store is; the data folder: created, locked, read |
//! | `database_store`, `reading` | the store: what it writes, what it reads |
//! | `opening` | how a store is opened |
//! | `database` | what the store asks of its database |
//! | `sql_reading`, `sql_nodes`, `transaction` | a database of SQL: what is read, who has a session, what is written |
//! | `simulated_store` | a store of a simulation |
//! | `shared_store` | which of several nodes has a session |
//! | `read_only_store` | a store that operators inspect and compare, also while a server writes it |
//! | `connection`, `schema` | the database, SQLite or PostgreSQL, its tables and their rows |
//! | `writer`, `write_order` | one task writes, several orders in one transaction; whether the store takes writes |
//! | `newest_write` | how far a file was written, so that a lost end is noticed |
//! | `objects`, `bucket` | large data, by content, in a local folder or in S3 |

mod bucket;
mod connection;
mod database;
mod database_store;
mod location;
mod newest_write;
mod objects;
mod opening;
mod read_only_store;
mod reading;
mod schema;
mod session_store;
mod shared_store;
mod simulated_store;
mod sql_nodes;
mod sql_reading;
mod transaction;
mod write_order;
mod writer;

pub use database::{NodeTables, RemoveObject, SessionOwner, SessionTables, TransactionWriter, WriteFailure, Written};
pub use database_store::{Store, StoreFaults};
pub use location::StoreLocation;
pub(crate) use objects::{read_shape, write_shape};
pub use read_only_store::{AuditFilter, CheckedSession, read_audit};
pub use session_store::{
    Commit, Generation, HeldSession, ListedSession, LoggedKey, NewCommit, NewSession, NodeIdentity, NodeLoad,
    SessionRecord, StoreError, StoredFacts, StoredSession, StoredSnapshot, UsedSession, calendar_text, now_ms,
};
pub(crate) use session_store::{SessionClaim, millis};
pub(crate) use shared_store::SharedStore;
pub use simulated_store::SimulatedDatabase;
pub use write_order::{StoredObject, UncertainCommit, UncertainCommits, WriteOrder};

/// Names the build and processor that make a result: the sources of what computes and the compiler as a digest, and the
/// processor. Within one, the same inputs give the same bits; another may differ in late digits.
pub fn build_identity() -> String {
    format!("{}-{}", env!("COMPUTING_SOURCES"), std::env::consts::ARCH)
}
