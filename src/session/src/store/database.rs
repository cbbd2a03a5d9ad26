//! What a store asks of its database. One implementation is SQL (`sql_reading`, `sql_nodes`, `transaction`); the other one is the model of a
//! database in `tests/simulation`, which delays and loses what it is asked.

use super::session_store::{
    Commit, Generation, HeldSession, ListedSession, LoggedKey, NodeIdentity, NodeLoad, StoreError, StoredFacts,
    StoredSession,
};
use super::write_order::{UncertainCommits, WriteOrder};
use crate::answers::Tenant;
use crate::error::OwnerAddress;
use async_trait::async_trait;
use futures::future::BoxFuture;
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::path::Path;

/// What is read.
///
/// # Errors
/// All functions: [`StoreError::Unavailable`] where the database does not answer, [`StoreError::Damaged`] for what is not what was
/// written, [`StoreError::Refused`] for what a later version wrote.
#[async_trait]
pub trait SessionTables: Send + Sync + Debug {
    /// A session with all its commits; `None` when the tenant has none of that id.
    async fn session(&self, tenant: &Tenant, id: &str) -> Result<Option<StoredSession>, StoreError>;
    /// A commit with the bytes of its record.
    async fn commit(&self, session: &str, sequence: u64) -> Result<Option<(Commit, Vec<u8>)>, StoreError>;
    /// Whether the tenant has a session of that id.
    async fn holds(&self, tenant: &Tenant, id: &str) -> Result<bool, StoreError>;
    /// A tenant's sessions by rising number, above `after`, at most `most`; of one that is damaged the number alone.
    async fn list(
        &self,
        tenant: &Tenant,
        after: u64,
        most: usize,
    ) -> Result<Vec<(u64, Option<ListedSession>)>, StoreError>;
    /// The sessions that are expired at `now_ms`, with their tenants; time counts from `since_ms` at the earliest.
    async fn expired(&self, since_ms: u64, now_ms: u64) -> Result<Vec<(Tenant, String)>, StoreError>;
    /// How many sessions a tenant has.
    async fn count_sessions(&self, tenant: &Tenant) -> Result<u64, StoreError>;
    /// How many sessions each tenant has.
    async fn sessions_by_tenant(&self) -> Result<Vec<(Tenant, u64)>, StoreError>;
    /// Bytes that a tenant's sessions hold: their records and the objects that they name, one that several name for each of them.
    async fn stored_bytes(&self, tenant: &Tenant) -> Result<u64, StoreError>;
    /// The highest number of any session; 0 without sessions.
    async fn highest_number(&self) -> Result<u64, StoreError>;
    /// The keys that are kept, oldest first.
    async fn keys(&self) -> Result<Vec<LoggedKey>, StoreError>;
    /// A key that is kept.
    async fn key(&self, tenant: &Tenant, key: &str) -> Result<Option<LoggedKey>, StoreError>;
    /// The sessions of all tenants, in the order of their creation.
    async fn all_sessions(&self) -> Result<Vec<StoredFacts>, StoreError>;
    /// The tenants of whom anything is noted in the audit trail.
    async fn audited_tenants(&self) -> Result<Vec<Tenant>, StoreError>;
    /// Objects whose size an older version did not record.
    async fn unmeasured_objects(&self) -> Result<Vec<String>, StoreError>;
    /// The objects that sessions name.
    async fn used_objects(&self) -> Result<Vec<String>, StoreError>;
    /// Whether a session uses an object; any session where `session` is `None`.
    async fn is_used(&self, object: &str, session: Option<&str>) -> Result<bool, StoreError>;
    /// Compares the database with itself and with the note in its folder, where there is one.
    async fn check_integrity(&self, folder: Option<&Path>) -> Result<(), StoreError>;
    /// Closes the connections.
    async fn close(&self);
}

/// A session's row, as far as who has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SessionOwner {
    /// The id of the node that has it; empty where none has.
    pub node: String,
    /// Which ownership it is.
    pub generation: Generation,
    /// Where that node is.
    pub address: OwnerAddress,
    /// Whether that node is about to stop.
    pub is_leaving: bool,
    /// Whether that node has a lease.
    pub has_lease: bool,
}

/// Nodes, their leases, and what they own. Times are those of the database's clock alone.
///
/// # Errors
/// All functions: as those of [`SessionTables`].
#[async_trait]
pub trait NodeTables: Send + Sync + Debug {
    /// Renews the lease of node `id`, which has run out `known` times as far as it knows; returns how often it has.
    async fn renew(&self, id: &str, node: &NodeIdentity, load: NodeLoad, known: i64) -> Result<i64, StoreError>;
    /// The nodes with a lease that take sessions, by their names.
    async fn nodes(&self) -> Result<Vec<(OwnerAddress, NodeLoad)>, StoreError>;
    /// Gives back everything that node `id` has, and its lease.
    async fn leave(&self, id: &str) -> Result<(), StoreError>;
    /// Who has a session; `None` when the tenant has none of that id.
    async fn owner(&self, tenant: &Tenant, session: &str) -> Result<Option<SessionOwner>, StoreError>;
    /// Gives node `id` a session whose owner is as it was `seen`, unless another node with a lease has it; `None` where it has changed
    /// hands since, or its node has renewed its lease.
    async fn take(&self, id: &str, session: &str, seen: &SessionOwner) -> Result<Option<Generation>, StoreError>;
    /// Whether a session is expired at `now_ms`; time counts from `since_ms` at the earliest.
    async fn is_expired(&self, session: &str, since_ms: u64, now_ms: u64) -> Result<bool, StoreError>;
    /// Gives a session back, last used at `used_ms`, unless another node has it.
    async fn release(&self, session: &HeldSession, used_ms: u64) -> Result<(), StoreError>;
    /// The sessions of node `id`.
    async fn held(&self, id: &str) -> Result<BTreeMap<String, Generation>, StoreError>;
    /// The number of the next session to be created.
    async fn next_number(&self) -> Result<u64, StoreError>;
    /// Notes an object that is about to be written and named. Waits while a node removes it.
    async fn note_loose(&self, object: &str) -> Result<(), StoreError>;
    /// Removes objects that no session has named for a long time, each by `remove`, and forgets nodes that are long gone.
    async fn remove_loose(&self, remove: &RemoveObject<'_>) -> Result<(), StoreError>;
    /// Closes the connection.
    async fn close(&self);
}

/// Removes the object of a name.
pub type RemoveObject<'a> = dyn Fn(String) -> BoxFuture<'a, Result<(), StoreError>> + Send + Sync + 'a;

/// What an order was answered with: objects that may have no name any more.
pub type Written = Result<Vec<String>, StoreError>;

/// Why orders were not carried out.
#[derive(Debug)]
pub enum WriteFailure {
    /// Nothing was begun.
    NoConnection(StoreError),
    /// What was begun may be on disk or not.
    Transaction(StoreError),
}

/// Writes transactions, one after the other.
#[async_trait]
pub trait TransactionWriter: Send + Debug {
    /// Removes what is `uncertain` and carries out orders, all in one transaction. [`StoreError::Moved`] and [`StoreError::Repeated`]
    /// are answers to one order; the others are carried out all the same.
    ///
    /// # Errors
    /// [`WriteFailure`].
    ///
    /// # Cancel safety
    /// When the future is dropped, the transaction may be carried out or not.
    async fn write(
        &mut self,
        uncertain: &UncertainCommits,
        orders: &[&WriteOrder],
    ) -> Result<Vec<Written>, WriteFailure>;
    /// Closes the connection.
    async fn finish(&mut self);
    /// Ends a transaction whose state is not known.
    async fn give_up(&mut self);
}
