//! The traits through which sessions use a store, with their values and errors.
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
use bytes::Bytes;
use futures::future::BoxFuture;
use pliant_asset::FileSet;
use pliant_wire::record::{LoggedCommit, RecordedModel};
use std::collections::BTreeMap;
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

/// The answer of a store, to come.
pub type Stored<'a, T> = BoxFuture<'a, Result<T, StoreError>>;

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

/// How a node of several takes sessions.
pub trait SessionOwnership: Send + Sync + std::fmt::Debug {
    /// This node.
    fn node(&self) -> &NodeIdentity;
    /// Renews the lease. False when it had run out before: others may have taken sessions meanwhile.
    fn beat(&self, load: NodeLoad) -> Stored<'_, bool>;
    /// The sessions that are this node's.
    fn held(&self) -> Stored<'_, BTreeMap<String, Generation>>;
    /// Takes a free session, or returns who has it.
    fn claim(&self, tenant: Tenant, id: String) -> Stored<'_, SessionClaim>;
    /// Takes an expired session; `None` where it is not expired, or another node has it.
    fn claim_expired(&self, tenant: Tenant, id: String, since_ms: u64, now_ms: u64) -> Stored<'_, Option<Generation>>;
    /// Gives a session back, last used at `used_ms`.
    fn release(&self, session: HeldSession, used_ms: u64) -> Stored<'_, ()>;
    /// The number of the next session to be created.
    fn next_number(&self) -> Stored<'_, u64>;
    /// The nodes with a lease that take sessions, by their names.
    fn nodes(&self) -> Stored<'_, Vec<(OwnerAddress, NodeLoad)>>;
    /// Removes objects that no session has named for a long time.
    fn remove_loose_objects(&self) -> Stored<'_, ()>;
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

/// A session to be kept, with its first commit.
#[derive(Debug, Clone)]
pub struct NewSession {
    /// Its id.
    pub id: String,
    /// Whose it is.
    pub tenant: Tenant,
    /// Sessions are numbered in the order of their creation.
    pub number: u64,
    /// When it was opened, in milliseconds since 1970.
    pub created_ms: u64,
    /// How long it outlives its last use.
    pub ttl: Duration,
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
    /// As in [`NewSession`].
    pub id: String,
    /// As in [`NewSession`].
    pub tenant: Tenant,
    /// As in [`NewSession`].
    pub number: u64,
    /// As in [`NewSession`].
    pub created_ms: u64,
    /// As in [`NewSession`].
    pub ttl: Duration,
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
    /// As in [`NewSession`].
    pub id: String,
    /// As in [`NewSession`].
    pub created_ms: u64,
    /// As in [`NewSession`].
    pub ttl: Duration,
    /// As in [`StoredSession`].
    pub used_ms: u64,
    /// Its label.
    pub label: String,
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

/// Stored sessions, to be read.
pub trait ReadSessions: Send + Sync + std::fmt::Debug + 'static {
    /// Which build and processor makes results now.
    fn build(&self) -> String;
    /// How nodes that share the store take sessions; `None` where one process has it for itself.
    fn ownership(&self) -> Option<&dyn SessionOwnership> {
        None
    }
    /// Whether the store takes writes: false from a write that failed until one works again.
    fn takes_writes(&self) -> bool {
        false
    }
    /// The same store, to be written.
    ///
    /// # Errors
    /// [`StoreError::Refused`] for a store that is open to be read only.
    fn writable(&self) -> Result<&dyn KeepSessions, StoreError> {
        Err(StoreError::Refused("the store is only looked at".into()))
    }
    /// Reads a session with all its commits; `None` when the tenant has none of that id.
    fn load(&self, tenant: Tenant, id: String) -> Stored<'_, Option<StoredSession>>;
    /// Reads one commit.
    fn commit(&self, session: String, sequence: u64) -> Stored<'_, Option<Commit>>;
    /// Whether the tenant has a session of that id.
    fn holds(&self, tenant: Tenant, id: String) -> Stored<'_, bool>;
    /// Lists a tenant's sessions by rising number, above `after`, at most `most`; of one that is damaged the number alone.
    fn list(&self, tenant: Tenant, after: u64, most: usize) -> Stored<'_, Vec<(u64, Option<ListedSession>)>>;
    /// Reads an object.
    fn object(&self, name: String) -> Stored<'_, Bytes>;
    /// How many sessions each tenant has.
    fn sessions_by_tenant(&self) -> Stored<'_, Vec<(Tenant, u64)>>;
    /// Bytes that a tenant's sessions hold: their records and the objects that they name, one that several name for each of them.
    fn stored_bytes(&self, tenant: Tenant) -> Stored<'_, u64>;
    /// How many sessions a tenant has.
    fn count_sessions(&self, tenant: Tenant) -> Stored<'_, u64>;
    /// The highest number of any session.
    fn highest_number(&self) -> Stored<'_, u64>;
}

/// Stored sessions, to be written too. What returns `Ok` is on disk; what returns an error has changed nothing that is ever read again.
pub trait KeepSessions: ReadSessions {
    /// Keeps a new session, which is this process's then.
    fn create(&self, session: NewSession) -> Stored<'_, Generation>;
    /// Keeps a commit.
    fn append(&self, commit: NewCommit) -> Stored<'_, ()>;
    /// Keeps a shape as the newest of a session.
    fn save_snapshot(&self, session: HeldSession, sequence: u64, shape: Bytes) -> Stored<'_, ()>;
    /// Replaces digests, by the numbers of commits, by those of `build`.
    fn rerecord_digests(&self, session: HeldSession, build: String, digests: Vec<(u64, String)>) -> Stored<'_, ()>;
    /// Deletes a session and what only it used, and notes who did.
    fn delete(&self, audit: AuditEntry, generation: Generation) -> Stored<'_, ()>;
    /// Notes when sessions were used.
    fn note_use(&self, sessions: Vec<UsedSession>) -> Stored<'_, ()>;
    /// The sessions that are expired at `now_ms`, with their tenants.
    fn expired(&self, since_ms: u64, now_ms: u64) -> Stored<'_, Vec<(Tenant, String)>>;
    /// A key that is kept.
    fn key(&self, tenant: Tenant, key: String) -> Stored<'_, Option<LoggedKey>>;
    /// The keys that are kept, oldest first.
    fn keys(&self) -> Stored<'_, Vec<LoggedKey>>;
    /// Forgets keys from before `before_ms`.
    fn forget_keys(&self, before_ms: u64) -> Stored<'_, ()>;
    /// Notes who did what.
    fn audit(&self, entry: AuditEntry) -> Stored<'_, ()>;
    /// The tenants of whom anything is noted.
    fn audited_tenants(&self) -> Stored<'_, Vec<Tenant>>;
    /// Forgets what was noted of a tenant before `before_ms`.
    fn forget_audit_of(&self, tenant: Tenant, before_ms: u64) -> Stored<'_, ()>;
}

/// Milliseconds since 1970.
pub fn now_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
}

/// Milliseconds since 1970 on the calendar (RFC 3339, UTC).
pub fn calendar_text(ms: u64) -> String {
    let at = UNIX_EPOCH.checked_add(Duration::from_millis(ms)).unwrap_or(UNIX_EPOCH);
    humantime::format_rfc3339_millis(at).to_string()
}
