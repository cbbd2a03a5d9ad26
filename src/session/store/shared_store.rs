//! A store that several nodes share, as one of them uses it.

use super::loose_objects::remove_loose;
use super::node_lease::NodeLease;
use super::objects::Objects;
use super::ownership::{Generation, HeldSession, NodeIdentity, NodeLoad, SessionClaim, SessionOwnership};
use super::reading;
use super::session_owners;
use super::session_store::{StoreError, Stored};
use super::store_health::StoreHealth;
use super::writer::Writer;
use crate::session::answers::Tenant;
use crate::session::owner_address::OwnerAddress;
use sqlx::AnyPool;
use std::collections::BTreeMap;
use std::sync::Arc;

/// What one of several nodes knows of the store that they share.
#[derive(Debug)]
pub(super) struct SharedStore {
    pub lease: NodeLease,
    pub pool: AnyPool,
    pub writer: Arc<Writer>,
    pub objects: Arc<Objects>,
    pub health: Arc<StoreHealth>,
}

impl SharedStore {
    async fn take(&self, tenant: &Tenant, id: &str) -> Result<SessionClaim, StoreError> {
        // What was refused here and may be written all the same can be taken back under the present ownership alone.
        self.writer.settle().await?;
        session_owners::claim(&self.lease, &self.pool, &tenant.0, id).await
    }

    /// Gives back everything that this node has.
    pub async fn close(&self) {
        if let Err(error) = self.lease.give_back().await {
            tracing::warn!("the sessions of this node are free only when its lease has run out: {error}");
        }
        self.lease.close().await;
    }
}

impl SessionOwnership for SharedStore {
    fn node(&self) -> &NodeIdentity {
        &self.lease.node
    }

    fn beat(&self, load: NodeLoad) -> Stored<'_, bool> {
        Box::pin(async move { self.health.note(self.lease.renew(load).await) })
    }

    fn held(&self) -> Stored<'_, BTreeMap<String, Generation>> {
        Box::pin(session_owners::held(&self.lease, &self.pool))
    }

    fn claim(&self, tenant: Tenant, id: String) -> Stored<'_, SessionClaim> {
        Box::pin(async move { self.take(&tenant, &id).await })
    }

    fn claim_expired(&self, tenant: Tenant, id: String, times: (u64, u64)) -> Stored<'_, Option<Generation>> {
        Box::pin(async move {
            let SessionClaim::Here(generation) = self.take(&tenant, &id).await? else {
                return Ok(None);
            };
            // Another node may have used it since it was found.
            let is_over = reading::is_expired(&self.pool, &id, times).await?;
            if !is_over {
                let session = HeldSession { id, generation };
                session_owners::release(&self.pool, &session, 0).await?;
            }
            Ok(is_over.then_some(generation))
        })
    }

    fn release(&self, session: HeldSession, used_ms: u64) -> Stored<'_, ()> {
        Box::pin(async move { session_owners::release(&self.pool, &session, used_ms).await })
    }

    fn next_number(&self) -> Stored<'_, u64> {
        Box::pin(session_owners::next_number(&self.pool))
    }

    fn nodes(&self) -> Stored<'_, Vec<(OwnerAddress, NodeLoad)>> {
        Box::pin(self.lease.others())
    }

    fn remove_loose_objects(&self) -> Stored<'_, ()> {
        Box::pin(async move {
            self.lease.forget_others().await?;
            remove_loose(&self.pool, &self.objects).await
        })
    }
}
