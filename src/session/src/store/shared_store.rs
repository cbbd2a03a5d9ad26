//! A store that several nodes share, as one of them uses it: the lease of the node, and the owner in each session's row.
//! Times are those of the database's clock.

use super::database::NodeTables;
use super::objects::Objects;
use super::session_store::{Generation, HeldSession, NodeIdentity, NodeLoad, SessionClaim, StoreError};
use super::writer::{StoreHealth, Writer};
use crate::answers::Tenant;
use crate::error::OwnerAddress;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicI64;
use std::sync::atomic::Ordering::SeqCst;

/// How a node of several takes sessions, and the lease of this node.
#[derive(Debug)]
pub(crate) struct SharedStore {
    pub(super) node: NodeIdentity,
    /// An id that no other process has had or will have.
    pub(super) id: String,
    pub(super) tables: Arc<dyn NodeTables>,
    /// How often the lease is known to have run out.
    pub(super) lapses: AtomicI64,
    pub(super) writer: Arc<Writer>,
    pub(super) objects: Arc<Objects>,
    pub(super) health: Arc<StoreHealth>,
}

/// How often a session is asked for that changes hands meanwhile.
const TRIES: u32 = 5;

impl SharedStore {
    /// This node.
    pub(crate) fn node(&self) -> &NodeIdentity {
        &self.node
    }

    /// Renews the lease. False when it had run out before: others may have taken sessions meanwhile.
    pub(crate) async fn beat(&self, load: NodeLoad) -> Result<bool, StoreError> {
        self.health.note(self.renew(load).await)
    }

    async fn renew(&self, load: NodeLoad) -> Result<bool, StoreError> {
        let known = self.lapses.load(SeqCst);
        let renew = self.tables.renew(&self.id, &self.node, load, known);
        let renewed = tokio::time::timeout(self.node.lease, renew).await;
        let lapses =
            renewed.map_err(|_| StoreError::Unavailable("the lease could not be renewed in its time".into()))??;
        self.lapses.store(lapses, SeqCst);
        Ok(lapses == known)
    }

    /// The nodes with a lease that take sessions, by their names.
    pub(crate) async fn nodes(&self) -> Result<Vec<(OwnerAddress, NodeLoad)>, StoreError> {
        self.tables.nodes().await
    }

    /// Gives back everything that this node has, and its lease.
    pub(super) async fn close(&self) {
        if let Err(error) = self.tables.leave(&self.id).await {
            tracing::warn!("the sessions of this node are free only when its lease has run out: {error}");
        }
        self.tables.close().await;
    }

    /// Takes a session that no node with a lease has, or that this node has already; or says who has it.
    pub(crate) async fn claim(&self, tenant: &Tenant, id: &str) -> Result<SessionClaim, StoreError> {
        // What was refused here and may be written all the same can be taken back under the present ownership alone.
        self.writer.undo_uncertain_commits().await?;
        for _ in 0..TRIES {
            let Some(seen) = self.tables.owner(tenant, id).await? else {
                return Ok(SessionClaim::Missing);
            };
            if seen.has_lease && seen.node != self.id {
                return Ok(SessionClaim::Elsewhere {
                    owner: seen.address,
                    is_leaving: seen.is_leaving,
                });
            }
            if let Some(generation) = self.tables.take(&self.id, id, &seen).await? {
                return Ok(SessionClaim::Here(generation));
            }
        }
        Err(StoreError::Unavailable("the session keeps moving between nodes".into()))
    }

    /// Takes an expired session; `None` where it is not expired, or another node has it.
    pub(crate) async fn claim_expired(
        &self,
        tenant: &Tenant,
        id: &str,
        since_ms: u64,
        now_ms: u64,
    ) -> Result<Option<Generation>, StoreError> {
        let SessionClaim::Here(generation) = self.claim(tenant, id).await? else {
            return Ok(None);
        };
        // Another node may have used it since it was found.
        let is_expired = self.tables.is_expired(id, since_ms, now_ms).await?;
        if !is_expired {
            let id = id.to_owned();
            self.release(&HeldSession { id, generation }, 0).await?;
        }
        Ok(is_expired.then_some(generation))
    }

    /// Gives a session back, last used at `used_ms`.
    pub(crate) async fn release(&self, session: &HeldSession, used_ms: u64) -> Result<(), StoreError> {
        self.tables.release(session, used_ms).await
    }

    /// The sessions that are this node's.
    pub(crate) async fn held(&self) -> Result<BTreeMap<String, Generation>, StoreError> {
        self.tables.held(&self.id).await
    }

    /// The number of the next session to be created. What a process that had the store for itself has numbered meanwhile is passed over.
    pub(crate) async fn next_number(&self) -> Result<u64, StoreError> {
        self.tables.next_number().await
    }

    /// Removes objects that no session has named for a long time, and forgets nodes that are long gone.
    pub(crate) async fn remove_loose_objects(&self) -> Result<(), StoreError> {
        let objects = &self.objects;
        self.tables
            .remove_loose(&|object| Box::pin(async move { objects.remove(&object).await }))
            .await
    }
}
