//! Which of the nodes that share a store has a session.
//!
//! A session's row names the node that has it, and the number of that ownership: its generation, which grows each time
//! that another node takes it. A write of a session succeeds only while the row has the generation of the writer, so a
//! node that has lost the session cannot write. A node has its sessions for as long as its lease: one row for the whole
//! node, renewed by one statement, with times of the database's clock alone. When a node has no lease any more, or has
//! given a session back, the next node that gets a call for the session takes it.

use super::store_error::Stored;
use crate::session::answers::Tenant;
use crate::session::owner_address::OwnerAddress;
use std::collections::BTreeMap;
use std::time::Duration;

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
    fn claim_expired(&self, tenant: Tenant, id: String, times: (u64, u64)) -> Stored<'_, Option<Generation>>;
    /// Gives a session back, last used at `used_ms`.
    fn release(&self, session: HeldSession, used_ms: u64) -> Stored<'_, ()>;
    /// The number of the next session to be created.
    fn next_number(&self) -> Stored<'_, u64>;
    /// The nodes with a lease that take sessions, by their names.
    fn nodes(&self) -> Stored<'_, Vec<(OwnerAddress, NodeLoad)>>;
    /// Removes objects that no session has named for a long time.
    fn remove_loose_objects(&self) -> Stored<'_, ()>;
}
