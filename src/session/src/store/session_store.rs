//! What sessions write to a store and read from it, and the errors of a store.
//!
//! Several nodes may share a store. A session's row names the node that has it, and the number of that ownership: its
//! generation, which grows each time that another node takes the session. A write of a session succeeds only while the
//! row has the generation of the writer, so a node that has lost the session cannot write. A node has its sessions for
//! as long as its lease: one row for the whole node, renewed by one statement, with times of the database's clock
//! alone. When a node has no lease any more, or has given a session back, the next node that gets a call for the
//! session takes it.

use crate::answers::Tenant;
use crate::audit::audit_entry::AuditEntry;
use crate::error::OwnerAddress;
use crate::error::{Error, ErrorCode};
use pliant_asset::FileSet;
use pliant_wire::record::{LoggedCommit, RecordedModel};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Why a store did not do what was asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    /// It cannot be reached or written: a full disk, a lost permission, a database that is down. Later it may work.
    #[error("{0}")]
    Unavailable(String),
    /// What it holds is not what was written.
    #[error("{0}")]
    Damaged(String),
    /// It cannot be used as it is: written by a later version, or used by another process.
    #[error("{0}")]
    Refused(String),
    /// Another node has the session now. Nothing was written.
    #[error("another node has the session now")]
    Moved,
    /// Another call with the same idempotency key was faster, at another node. Nothing was written.
    #[error("another call with this idempotency key was carried out meanwhile")]
    Repeated,
}

impl From<StoreError> for Error {
    fn from(error: StoreError) -> Self {
        match error {
            // Paths and what a database says are the operator's alone.
            StoreError::Unavailable(problem) => {
                tracing::warn!("the store of sessions: {problem}");
                let text =
                    "the store of sessions cannot be read or written at present; nothing has changed, try again later";
                Self {
                    retry_after_s: Some(1),
                    ..Self::new(ErrorCode::Unavailable, text)
                }
            }
            StoreError::Damaged(problem) => {
                tracing::error!("what is stored of a session is damaged: {problem}");
                let text = format!("what is stored of the session is damaged and is not served: {problem}");
                Self::new(ErrorCode::DataLoss, text)
            }
            StoreError::Refused(problem) => Self::new(ErrorCode::FailedPrecondition, problem),
            StoreError::Moved => Self::moved(),
            StoreError::Repeated => Self {
                retry_after_s: Some(1),
                ..Self::new(ErrorCode::Aborted, StoreError::Repeated.to_string())
            },
        }
    }
}

/// The number of an ownership. 0 where one process has the store for itself: nothing is compared then.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Generation(pub u64);

/// A session that this node has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeldSession {
    /// Its id.
    pub id: String,
    /// The ownership.
    pub generation: Generation,
}

/// One of several nodes that share a store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeIdentity {
    /// Its name, by which a proxy selects it.
    pub name: String,
    /// The address that clients call.
    pub address: String,
    /// How long it has its sessions without a heartbeat.
    pub lease: Duration,
    /// How often it sends one.
    pub heartbeat: Duration,
}

/// The load that a node sends in each heartbeat.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct NodeLoad {
    /// Sessions in memory.
    pub sessions: u64,
    /// How many it may have.
    pub most_sessions: u64,
    /// Bytes that it holds.
    pub memory_used: u64,
    /// Bytes that it may hold.
    pub memory_total: u64,
    /// Pieces of work that run or wait.
    pub work: u64,
    /// Whether it is about to stop and gives its sessions back.
    pub is_leaving: bool,
}

/// Whose a session is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SessionClaim {
    /// This node's, from now on.
    Here(Generation),
    /// Another node's; with `is_leaving` it is about to be given back.
    Elsewhere {
        /// That node.
        owner: OwnerAddress,
        /// Whether that node is about to stop.
        is_leaving: bool,
    },
    /// The tenant has none of that id.
    Missing,
}

/// An idempotency key whose answer is a commit's.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LoggedKey {
    /// Whose key it is.
    pub tenant: Tenant,
    /// The key.
    pub key: String,
    /// The hash of the request.
    pub fingerprint: u128,
    /// The session that answered.
    pub session: String,
    /// The commit that was the answer.
    pub sequence: u64,
    /// When, in milliseconds since 1970.
    pub at_ms: u64,
}

/// Which session it is, whose, and for how long.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SessionRecord {
    /// Its id.
    pub id: String,
    /// Whose it is.
    pub tenant: Tenant,
    /// Sessions are numbered in the order of their creation.
    pub number: u64,
    /// What its owner calls it.
    pub label: String,
    /// When it was opened, in milliseconds since 1970.
    pub created_ms: u64,
    /// How long it outlives its last use.
    pub ttl: Duration,
}

/// A session to be kept, with its first commit.
#[derive(Debug, Clone)]
pub struct NewSession {
    /// Which session it is.
    pub record: SessionRecord,
    /// How its model was opened; the store fills in the names of the files.
    pub model: RecordedModel,
    /// The files.
    pub files: FileSet,
    /// The first commit.
    pub first: NewCommit,
}

/// A commit of a session.
#[derive(Debug, Clone)]
pub struct Commit {
    /// Commits of a session are numbered from 0, undo and redo among them.
    pub sequence: u64,
    /// The session's revision after it.
    pub revision: u64,
    /// Digest of the positions after it.
    pub digest: String,
    /// Build and processor that made them.
    pub build: String,
    /// The commit whose facts hold after it.
    pub facts_at: u64,
    /// The commit whose poses hold after it.
    pub poses_at: u64,
    /// What it was.
    pub record: LoggedCommit,
}

/// A commit to be stored.
#[derive(Debug, Clone)]
pub struct NewCommit {
    /// Its session, with the current ownership.
    pub session: HeldSession,
    /// The commit; the store fills in the names of the files.
    pub commit: Commit,
    /// The files of a merge.
    pub files: Option<FileSet>,
    /// The key of the call, whose answer it is.
    pub key: Option<(Tenant, String, u128)>,
    /// Who made it.
    pub audit: AuditEntry,
}

/// The newest shape that is kept of a session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredSnapshot {
    /// The shape is the one after this commit.
    pub sequence: u64,
    /// The object that holds it.
    pub object: String,
}

/// A session that was kept.
#[derive(Debug, Clone)]
pub struct StoredSession {
    /// Which session it is.
    pub record: SessionRecord,
    /// Its last use, in milliseconds since 1970.
    pub used_ms: u64,
    /// As in [`NewSession`].
    pub model: RecordedModel,
    /// Its commits, in order.
    pub commits: Vec<Commit>,
    /// Its newest shape.
    pub snapshot: Option<StoredSnapshot>,
}

/// A session as a list shows it.
#[derive(Debug, Clone)]
pub struct ListedSession {
    /// Which session it is.
    pub record: SessionRecord,
    /// As in [`StoredSession`].
    pub used_ms: u64,
    /// Its newest commit.
    pub newest: Commit,
    /// The commit whose facts hold.
    pub facts: LoggedCommit,
    /// The commit whose poses hold.
    pub poses: LoggedCommit,
}

/// A stored session as operators see it.
#[derive(Debug, Clone)]
pub struct StoredFacts {
    /// Sessions are numbered in the order of their creation.
    pub number: u64,
    /// Its id.
    pub id: String,
    /// Whose it is.
    pub tenant: Tenant,
    /// Its last use, in milliseconds since 1970.
    pub used_ms: u64,
    /// How long it outlives its last use, in milliseconds.
    pub ttl_ms: u64,
    /// Its commits, undo and redo among them.
    pub commits: u64,
}

/// When a session was used last.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsedSession {
    /// The session.
    pub session: HeldSession,
    /// In milliseconds since 1970.
    pub used_ms: u64,
}

/// Milliseconds since 1970.
pub fn now_ms() -> u64 {
    millis(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default())
}

/// The whole milliseconds of a time.
pub(crate) fn millis(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

/// Milliseconds since 1970 on the calendar (RFC 3339, UTC).
pub fn calendar_text(ms: u64) -> String {
    let at = UNIX_EPOCH.checked_add(Duration::from_millis(ms)).unwrap_or(UNIX_EPOCH);
    humantime::format_rfc3339_millis(at).to_string()
}
