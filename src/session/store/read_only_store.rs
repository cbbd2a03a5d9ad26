//! A store that is only read: nothing is created, noted or changed, whether or not a server holds it.

use super::build_identity::build_identity;
use super::database_to_read::DatabaseToRead;
use super::objects::Objects;
use super::ownership::{Generation, HeldSession};
use super::reading;
use super::schema::known_identity;
use super::session_store::{
    ListedSession, LoggedKey, NewCommit, NewSession, SessionStore, StoreError, Stored, StoredCommit, StoredSession,
    UsedSession,
};
use super::store_location::StoreLocation;
use crate::session::answers::Tenant;
use crate::session::audit::audit_entry::AuditEntry;
use bytes::Bytes;
use std::path::PathBuf;

/// A store that is only read.
#[derive(Debug)]
pub struct ReadOnlyStore {
    pub(super) database: DatabaseToRead,
    pub(super) objects: Objects,
    /// The folder of a database that is a file.
    pub(super) folder: Option<PathBuf>,
    build: String,
}

impl ReadOnlyStore {
    /// Opens a store that is there.
    ///
    /// # Errors
    /// [`StoreError::Refused`] where there is no store, with what is missing; [`StoreError::Unavailable`] where it cannot be read.
    pub async fn open(location: &StoreLocation) -> Result<Self, StoreError> {
        let database = DatabaseToRead::open(location).await?;
        let objects = match (&location.objects, &location.data_dir) {
            (Some(url), _) => Objects::in_bucket(url)?,
            (None, Some(folder)) => Objects::in_folder_to_read(folder)?,
            (None, None) => return Err(StoreError::Refused("the place of the objects is not named".into())),
        };
        let failed = |e: sqlx::Error| StoreError::Unavailable(format!("{:?}: {e}", database.address));
        let identity = known_identity(&mut *database.pool.acquire().await.map_err(failed)?).await?;
        if let Some(identity) = identity {
            objects.agree_with(&identity).await?;
        }
        Ok(Self {
            database,
            objects,
            folder: location.data_dir.clone().filter(|_| location.database.is_none()),
            build: location.build.clone().unwrap_or_else(build_identity),
        })
    }

    /// Whether another process may be writing it meanwhile.
    pub fn is_written(&self) -> bool {
        self.database.is_written
    }
}

fn refused<'a, T: Send + 'a>() -> Stored<'a, T> {
    Box::pin(async { Err(StoreError::Refused("the store is only looked at".into())) })
}

fn not_noted<'a>() -> Stored<'a, ()> {
    Box::pin(async { Ok(()) })
}

/// Shows why the store cannot be read, which a server hides from clients.
fn told<T>(error: Result<T, StoreError>) -> Result<T, StoreError> {
    error.map_err(|error| match error {
        StoreError::Unavailable(problem) => StoreError::Refused(problem),
        error => error,
    })
}

impl SessionStore for ReadOnlyStore {
    fn build(&self) -> String {
        self.build.clone()
    }

    fn takes_writes(&self) -> bool {
        false
    }

    fn create(&self, _: NewSession) -> Stored<'_, Generation> {
        refused()
    }

    fn append(&self, _: NewCommit) -> Stored<'_, ()> {
        refused()
    }

    fn keep_shape(&self, _: HeldSession, _: u64, _: Bytes) -> Stored<'_, ()> {
        not_noted()
    }

    fn adopt(&self, _: HeldSession, _: String, _: Vec<(u64, String)>) -> Stored<'_, ()> {
        not_noted()
    }

    fn load(&self, tenant: Tenant, id: String) -> Stored<'_, Option<StoredSession>> {
        Box::pin(async move { told(reading::whole_session(&self.database.pool, &tenant, &id).await) })
    }

    fn commit(&self, session: String, sequence: u64) -> Stored<'_, Option<StoredCommit>> {
        Box::pin(async move {
            let row = told(reading::commit_row(&self.database.pool, &session, sequence).await)?;
            row.map(|row| row.into_commit()).transpose()
        })
    }

    fn holds(&self, tenant: Tenant, id: String) -> Stored<'_, bool> {
        Box::pin(async move { reading::has_session(&self.database.pool, &tenant.0, &id).await })
    }

    fn list(&self, tenant: Tenant, after: u64, most: usize) -> Stored<'_, Vec<(u64, Option<ListedSession>)>> {
        Box::pin(async move { reading::listed(&self.database.pool, &tenant.0, after, most).await })
    }

    fn object(&self, name: String) -> Stored<'_, Bytes> {
        Box::pin(async move { told(self.objects.get(name).await) })
    }

    fn delete(&self, _: AuditEntry, _: Generation) -> Stored<'_, ()> {
        refused()
    }

    fn note_use(&self, _: Vec<UsedSession>) -> Stored<'_, ()> {
        not_noted()
    }

    fn expired(&self, _: u64, _: u64) -> Stored<'_, Vec<(Tenant, String)>> {
        // What is looked at does not go.
        Box::pin(async { Ok(Vec::new()) })
    }

    fn sessions_by_tenant(&self) -> Stored<'_, Vec<(Tenant, u64)>> {
        Box::pin(reading::sessions_by_tenant(&self.database.pool))
    }

    fn stored_bytes(&self, tenant: Tenant) -> Stored<'_, u64> {
        Box::pin(async move { reading::stored_bytes(&self.database.pool, &tenant.0).await })
    }

    fn count_sessions(&self, tenant: Tenant) -> Stored<'_, u64> {
        Box::pin(async move { reading::count_sessions(&self.database.pool, &tenant.0).await })
    }

    fn key(&self, _: Tenant, _: String) -> Stored<'_, Option<LoggedKey>> {
        Box::pin(async { Ok(None) })
    }

    fn keys(&self) -> Stored<'_, Vec<LoggedKey>> {
        Box::pin(async { Ok(Vec::new()) })
    }

    fn forget_keys(&self, _: u64) -> Stored<'_, ()> {
        not_noted()
    }

    fn highest_number(&self) -> Stored<'_, u64> {
        Box::pin(async { told(reading::highest_number(&self.database.pool).await) })
    }

    fn audit(&self, _: AuditEntry) -> Stored<'_, ()> {
        not_noted()
    }

    fn audited_tenants(&self) -> Stored<'_, Vec<Tenant>> {
        Box::pin(async { Ok(Vec::new()) })
    }

    fn forget_audit_of(&self, _: Tenant, _: u64) -> Stored<'_, ()> {
        not_noted()
    }
}
