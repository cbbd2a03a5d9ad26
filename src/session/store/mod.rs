//! Sessions kept on disk: the log of their commits in a database, models and shapes as objects.
//!
//! A commit is a row, written and synced before it is acknowledged; large data is an object, named by its content,
//! written and synced before the row that names it. Nothing that the store holds is trusted: rows carry checksums,
//! objects are compared with their names, and what does not fit is reported as damage and never served.
//!
//! | file | what |
//! |---|---|
//! | `session_store`, `store_error` | the trait that sessions use, its values, and its errors |
//! | `ownership` | which of several nodes has a session |
//! | `shared_store`, `node_lease`, `session_owners`, `loose_objects` | the same, in the database |
//! | `database_store`, `opening`, `store_location` | the trait on a database and objects, how they are opened, and where they are |
//! | `data_folder`, `private_files` | the folder: created, locked, read |
//! | `store_health`, `store_watch` | whether the store takes writes |
//! | `connection`, `schema` | the database, SQLite or PostgreSQL, and its tables |
//! | `writer`, `write_order` | one task writes, what comes together in one transaction |
//! | `newest_write` | how far a file was written, so that a lost end is noticed |
//! | `rows`, `reading` | rows with their checksums, read again |
//! | `audit_reading` | who did what, read beside the process that writes it |
//! | `objects` | large data, by content |
//! | `object_folder`, `bucket`, `bucket_client` | where it lies: a local folder, S3 |
//! | `shape_object` | a shape as an object |
//! | `upkeep`, `read_only_store`, `database_to_read` | what operators do with a store: inspect, compare and clean it |
//! | `build_identity` | which build and processor made results |

mod audit_reading;
mod bucket;
mod bucket_client;
mod build_identity;
mod connection;
mod data_folder;
mod database_store;
mod database_to_read;
mod loose_objects;
mod newest_write;
mod node_lease;
mod object_folder;
mod objects;
mod opening;
mod ownership;
mod private_files;
mod read_only_store;
mod reading;
mod rows;
mod schema;
mod session_owners;
pub(super) mod session_store;
pub(super) mod shape_object;
mod shared_store;
mod store_error;
mod store_health;
mod store_location;
mod store_watch;
mod upkeep;
mod write_order;
mod writer;

pub use audit_reading::{AuditFilter, read_audit};
pub use build_identity::build_identity;
pub use database_store::DatabaseStore;
pub use ownership::{Generation, HeldSession, NodeIdentity, NodeLoad, SessionClaim, SessionOwnership};
pub use read_only_store::ReadOnlyStore;
pub use session_store::{
    ListedSession, LoggedKey, NewCommit, NewSession, SessionStore, StoreError, Stored, StoredCommit, StoredFacts,
    StoredSession, StoredSnapshot, UsedSession, calendar_text, now_ms,
};
pub use store_location::StoreLocation;
pub use upkeep::CheckedSession;
