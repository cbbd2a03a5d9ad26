//! What sessions need of a store.

use super::ownership::{Generation, HeldSession, SessionOwnership};
pub use super::store_error::{StoreError, Stored};
use crate::asset::FileSet;
use crate::session::answers::Tenant;
use crate::session::audit::audit_entry::AuditEntry;
use crate::wire::record::{LoggedCommit, RecordedModel};
use bytes::Bytes;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

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

/// A commit to be kept.
#[derive(Debug, Clone)]
pub struct NewCommit {
    /// Its session.
    pub session: String,
    /// The current ownership.
    pub generation: Generation,
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
    /// What it was; the store fills in the names of the files.
    pub commit: LoggedCommit,
    /// The files of a merge.
    pub files: Option<FileSet>,
    /// The key of the call, whose answer it is.
    pub key: Option<(Tenant, String, u128)>,
    /// Who made it.
    pub audit: AuditEntry,
}

/// A commit that was kept.
#[derive(Debug, Clone)]
pub struct StoredCommit {
    /// As in [`NewCommit`].
    pub sequence: u64,
    /// As in [`NewCommit`].
    pub revision: u64,
    /// As in [`NewCommit`].
    pub digest: String,
    /// As in [`NewCommit`].
    pub build: String,
    /// As in [`NewCommit`].
    pub facts_at: u64,
    /// As in [`NewCommit`].
    pub poses_at: u64,
    /// What it was.
    pub commit: LoggedCommit,
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
    pub commits: Vec<StoredCommit>,
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
    pub newest: StoredCommit,
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

/// Where sessions are kept. What returns `Ok` is on disk; what returns an error has changed nothing that is ever read again.
pub trait SessionStore: Send + Sync + std::fmt::Debug + 'static {
    /// Which build and processor makes results now.
    fn build(&self) -> String;
    /// How nodes that share it take sessions; `None` where one process has it for itself.
    fn ownership(&self) -> Option<&dyn SessionOwnership> {
        None
    }
    /// Whether what is written is taken: false from a write that failed until one works again.
    fn takes_writes(&self) -> bool;
    /// Keeps a new session, which is this process's then.
    fn create(&self, session: NewSession) -> Stored<'_, Generation>;
    /// Keeps a commit.
    fn append(&self, commit: NewCommit) -> Stored<'_, ()>;
    /// Keeps a shape as the newest of a session.
    fn keep_shape(&self, session: HeldSession, sequence: u64, shape: Bytes) -> Stored<'_, ()>;
    /// Replaces digests, by the numbers of commits, by those of `build`.
    fn adopt(&self, session: HeldSession, build: String, digests: Vec<(u64, String)>) -> Stored<'_, ()>;
    /// Reads a session with all its commits; `None` when the tenant has none of that id.
    fn load(&self, tenant: Tenant, id: String) -> Stored<'_, Option<StoredSession>>;
    /// Reads one commit.
    fn commit(&self, session: String, sequence: u64) -> Stored<'_, Option<StoredCommit>>;
    /// Whether the tenant has a session of that id.
    fn holds(&self, tenant: Tenant, id: String) -> Stored<'_, bool>;
    /// Lists a tenant's sessions by rising number, above `after`, at most `most`; of one that is damaged the number alone.
    fn list(&self, tenant: Tenant, after: u64, most: usize) -> Stored<'_, Vec<(u64, Option<ListedSession>)>>;
    /// Reads an object.
    fn object(&self, name: String) -> Stored<'_, Bytes>;
    /// Deletes a session and what only it used, and notes who did.
    fn delete(&self, audit: AuditEntry, generation: Generation) -> Stored<'_, ()>;
    /// Notes when sessions were used.
    fn note_use(&self, sessions: Vec<UsedSession>) -> Stored<'_, ()>;
    /// The sessions that are expired at `now_ms`, with their tenants.
    fn expired(&self, since_ms: u64, now_ms: u64) -> Stored<'_, Vec<(Tenant, String)>>;
    /// How many sessions each tenant has.
    fn sessions_by_tenant(&self) -> Stored<'_, Vec<(Tenant, u64)>>;
    /// Bytes that a tenant's sessions hold: their records and the objects that they name, one that several name for each of them.
    fn stored_bytes(&self, tenant: Tenant) -> Stored<'_, u64>;
    /// How many sessions a tenant has.
    fn count_sessions(&self, tenant: Tenant) -> Stored<'_, u64>;
    /// A key that is kept.
    fn key(&self, tenant: Tenant, key: String) -> Stored<'_, Option<LoggedKey>>;
    /// The keys that are kept, oldest first.
    fn keys(&self) -> Stored<'_, Vec<LoggedKey>>;
    /// Forgets keys from before `before_ms`.
    fn forget_keys(&self, before_ms: u64) -> Stored<'_, ()>;
    /// The highest number of any session.
    fn highest_number(&self) -> Stored<'_, u64>;
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
