//! What a store reads. What was refused and may be written is removed first.

use super::database_store::Store;
use super::session_store::{Commit, ListedSession, LoggedKey, StoreError, StoredFacts, StoredSession};
use crate::answers::Tenant;

impl Store {
    /// Reads a session with all its commits; `None` when the tenant has none of that id.
    pub(crate) async fn load(&self, tenant: &Tenant, id: &str) -> Result<Option<StoredSession>, StoreError> {
        self.settle_before_reading().await?;
        self.explain(self.tables.session(tenant, id).await)
    }

    /// Reads one commit.
    pub(crate) async fn commit(&self, session: &str, sequence: u64) -> Result<Option<Commit>, StoreError> {
        self.settle_before_reading().await?;
        let found = self.explain(self.tables.commit(session, sequence).await)?;
        Ok(found.map(|(commit, _)| commit))
    }

    /// Whether the tenant has a session of that id.
    pub(crate) async fn holds(&self, tenant: &Tenant, id: &str) -> Result<bool, StoreError> {
        self.pass_faults().await?;
        self.tables.holds(tenant, id).await
    }

    /// Lists a tenant's sessions by rising number, above `after`, at most `most`; of one that is damaged the number alone: opening it
    /// fails.
    pub(crate) async fn list(
        &self,
        tenant: &Tenant,
        after: u64,
        most: usize,
    ) -> Result<Vec<(u64, Option<ListedSession>)>, StoreError> {
        self.pass_faults().await?;
        let mut list = self.tables.list(tenant, after, most).await?;
        // One whose creation was refused is removed as soon as the database can be written.
        for (_, listed) in &mut list {
            listed.take_if(|session| self.refused_creation(&session.record.id));
        }
        Ok(list)
    }

    /// The sessions that are expired at `now_ms`, with their tenants; time counts from `since_ms` at the earliest.
    pub(crate) async fn expired(&self, since_ms: u64, now_ms: u64) -> Result<Vec<(Tenant, String)>, StoreError> {
        self.tables.expired(since_ms, now_ms).await
    }

    /// How many sessions a tenant has.
    pub(crate) async fn count_sessions(&self, tenant: &Tenant) -> Result<u64, StoreError> {
        self.tables.count_sessions(tenant).await
    }

    /// How many sessions each tenant has.
    pub(crate) async fn sessions_by_tenant(&self) -> Result<Vec<(Tenant, u64)>, StoreError> {
        self.tables.sessions_by_tenant().await
    }

    /// Bytes that a tenant's sessions hold: their records and the objects that they name, one that several name for each of them.
    pub(crate) async fn stored_bytes(&self, tenant: &Tenant) -> Result<u64, StoreError> {
        self.pass_faults().await?;
        self.tables.stored_bytes(tenant).await
    }

    /// The highest number of any session; 0 without sessions.
    pub(crate) async fn highest_number(&self) -> Result<u64, StoreError> {
        self.explain(self.tables.highest_number().await)
    }

    /// The keys that are kept, oldest first.
    pub(crate) async fn keys(&self) -> Result<Vec<LoggedKey>, StoreError> {
        self.tables.keys().await
    }

    /// A key that is kept. One whose commit was refused goes with it first: no caller may learn that it was carried out.
    pub(crate) async fn key(&self, tenant: &Tenant, key: &str) -> Result<Option<LoggedKey>, StoreError> {
        self.undo_uncertain_commits().await?;
        self.tables.key(tenant, key).await
    }

    /// The objects that no session names, in order; where another process writes the store, those among them that it is just writing.
    ///
    /// # Errors
    /// When database or objects do not answer.
    pub async fn unused_objects(&self) -> Result<Vec<String>, StoreError> {
        self.objects.unused(self.tables.used_objects().await?).await
    }

    /// The sessions of all tenants, in the order of their creation.
    ///
    /// # Errors
    /// [`StoreError::Unavailable`] where the database does not answer, [`StoreError::Damaged`] for what is not what was written.
    pub async fn all_sessions(&self) -> Result<Vec<StoredFacts>, StoreError> {
        self.tables.all_sessions().await
    }

    /// The tenants of whom anything is noted.
    ///
    /// # Errors
    /// As [`Store::all_sessions`].
    pub async fn audited_tenants(&self) -> Result<Vec<Tenant>, StoreError> {
        self.tables.audited_tenants().await
    }
}
