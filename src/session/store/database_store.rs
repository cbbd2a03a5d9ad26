//! The store on a database and a folder of objects.

use super::audit_reading;
use super::build_identity::build_identity;
use super::connection::{DatabaseAddress, WritingConnection};
use super::object_folder::sync_folder;
use super::objects::Objects;
use super::reading;
use super::schema::{Dialect, identity};
use super::session_store::{
    ListedSession, LoggedKey, NewCommit, NewSession, SessionStore, StoreError, Stored, StoredCommit, StoredSession,
    UsedSession,
};
use super::store_location::StoreLocation;
use super::write_order::{StoredObject, WriteOrder};
use super::writer::Writer;
use crate::asset::FileSet;
use crate::session::answers::Tenant;
use crate::session::audit::audit_entry::AuditEntry;
use crate::wire::record::{FileReferences, LoggedCommit};
use bytes::Bytes;
use rustix::fs::{FlockOperation, flock};
use sqlx::AnyPool;
use std::fs::{self, File};
use std::path::Path;

/// Sessions in a database, what is large as objects.
#[derive(Debug)]
pub struct DatabaseStore {
    build: String,
    pub(super) dialect: Dialect,
    pub(super) pool: AnyPool,
    writer: Writer,
    pub(super) objects: Objects,
    /// Held as long as the store: one process writes a folder.
    _lock: Option<File>,
}

impl DatabaseStore {
    /// Opens a store, makes or brings up to date what is missing.
    ///
    /// # Errors
    /// [`StoreError::Refused`] when another process has it or a later version wrote it, [`StoreError::Unavailable`] when folder or
    /// database cannot be had.
    pub async fn open(location: &StoreLocation) -> Result<Self, StoreError> {
        let nowhere =
            || StoreError::Refused("sessions need a data folder, or both a database and a place of objects".into());
        let folder = || location.data_dir.as_deref().ok_or_else(nowhere);
        let lock = location.data_dir.as_deref().map(lock_folder).transpose()?;
        let objects = match &location.objects {
            Some(url) => Objects::in_bucket(url)?,
            None => Objects::in_folder(folder()?)?,
        };
        let address = match &location.database {
            Some(url) => DatabaseAddress::server(url)?,
            None => DatabaseAddress::file(&folder()?.join("sessions.sqlite"))?,
        };
        let mut writing = WritingConnection::open(&address).await?;
        objects.belong_to(&identity(writing.get().await?).await?).await?;
        let store = Self {
            build: location.build.clone().unwrap_or_else(build_identity),
            dialect: address.dialect(),
            pool: address.readers().await?,
            writer: Writer::start(writing),
            objects,
            _lock: lock,
        };
        store.measure_objects().await?;
        Ok(store)
    }

    /// Notes the sizes of objects that a version wrote which did not. One that is missing has none; whoever reads it is told.
    async fn measure_objects(&self) -> Result<(), StoreError> {
        let mut objects = Vec::new();
        for name in reading::unmeasured_objects(&self.pool).await? {
            let bytes = self.objects.size(&name).await.unwrap_or_default();
            objects.push(StoredObject { name, bytes });
        }
        if !objects.is_empty() {
            self.write(WriteOrder::Measure { objects }).await?;
        }
        Ok(())
    }

    /// Writes files; their names, and what is to be counted of them.
    async fn put_files(&self, files: &FileSet) -> Result<(FileReferences, Vec<StoredObject>), StoreError> {
        let mut objects = Vec::new();
        let mut names = FileReferences {
            name: files.name.clone(),
            main: self.objects.put(files.main.clone()).await?,
            companions: Default::default(),
        };
        let counted = |name: &String, bytes: &Bytes| StoredObject {
            name: name.clone(),
            bytes: bytes.len() as u64,
        };
        objects.push(counted(&names.main, &files.main));
        for (uri, bytes) in &files.companions {
            let object = self.objects.put(bytes.clone()).await?;
            objects.push(counted(&object, bytes));
            names.companions.insert(uri.clone(), object);
        }
        Ok((names, objects))
    }

    /// Writes an order and removes the objects that have no name after it. That a removal fails is no reason to fail: `prune`
    /// finds them.
    pub(super) async fn write(&self, order: WriteOrder) -> Result<(), StoreError> {
        let unnamed = self.writer.write(order).await?;
        if unnamed.is_empty() {
            return Ok(());
        }
        let _alone = self.objects.naming.write().await;
        for object in unnamed {
            let removed = match reading::is_used(&self.pool, &object).await {
                Ok(true) => continue,
                Ok(false) => self.objects.remove(&object).await,
                Err(error) => Err(error),
            };
            if let Err(error) = removed {
                tracing::warn!("an object that no session uses could not be removed: {error}");
            }
        }
        Ok(())
    }

    async fn create_session(&self, mut session: NewSession) -> Result<(), StoreError> {
        let naming = self.objects.naming.read().await;
        let (names, objects) = self.put_files(&session.files).await?;
        session.model.files = names;
        let model = session.model.write().map_err(|e| StoreError::Refused(e.to_string()))?;
        let session = Box::new(NewSession {
            files: FileSet::default(),
            ..session
        });
        let order = WriteOrder::Create {
            session,
            model,
            objects,
        };
        let written = self.writer.write(order).await;
        drop(naming);
        written.map(drop)
    }

    async fn append_commit(&self, mut commit: NewCommit) -> Result<(), StoreError> {
        let naming = self.objects.naming.read().await;
        let mut objects = Vec::new();
        if let (Some(given), LoggedCommit::Edit { files, .. }) = (commit.files.take(), &mut commit.commit) {
            let (names, merged) = self.put_files(&given).await?;
            objects = merged;
            *files = Some(names);
        }
        let commit = Box::new(commit);
        let written = self.writer.write(WriteOrder::Append { commit, objects }).await;
        drop(naming);
        written.map(drop)
    }

    async fn keep_newest_shape(&self, session: String, sequence: u64, shape: Bytes) -> Result<(), StoreError> {
        let naming = self.objects.naming.read().await;
        let bytes = shape.len() as u64;
        let name = self.objects.put(shape).await?;
        let order = WriteOrder::KeepShape {
            session,
            sequence,
            shape: StoredObject { name, bytes },
        };
        let unnamed = self.writer.write(order).await?;
        drop(naming);
        let _alone = self.objects.naming.write().await;
        for object in unnamed {
            if !reading::is_used(&self.pool, &object).await? {
                self.objects.remove(&object).await?;
            }
        }
        Ok(())
    }

    async fn adopt_digests(
        &self,
        session: String,
        build: String,
        digests: Vec<(u64, String)>,
    ) -> Result<(), StoreError> {
        let gone = || StoreError::Damaged("a commit is gone".into());
        let mut commits = Vec::with_capacity(digests.len());
        for (sequence, digest) in digests {
            let mut row = reading::commit_row(&self.pool, &session, sequence)
                .await?
                .ok_or_else(gone)?;
            row.digest = digest;
            row.build.clone_from(&build);
            commits.push(row);
        }
        self.write(WriteOrder::Adopt { commits }).await
    }
}

/// Takes a folder for this process alone.
fn lock_folder(folder: &Path) -> Result<File, StoreError> {
    let shown = folder.display();
    let unavailable = |e: std::io::Error| StoreError::Unavailable(format!("{shown}: {e}"));
    if !folder.exists() {
        fs::create_dir_all(folder).map_err(unavailable)?;
        // The folder's own name has to be on disk too.
        if let Some(parent) = folder.parent().filter(|p| !p.as_os_str().is_empty()) {
            sync_folder(parent).map_err(unavailable)?;
        }
    }
    let lock = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(folder.join("lock"))
        .map_err(unavailable)?;
    match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(lock),
        Err(error) if error == rustix::io::Errno::WOULDBLOCK => {
            Err(StoreError::Refused(format!("{shown} is in use by another process")))
        }
        Err(error) => Err(unavailable(error.into())),
    }
}

impl SessionStore for DatabaseStore {
    fn build(&self) -> String {
        self.build.clone()
    }

    fn create(&self, session: NewSession) -> Stored<'_, ()> {
        Box::pin(self.create_session(session))
    }

    fn append(&self, commit: NewCommit) -> Stored<'_, ()> {
        Box::pin(self.append_commit(commit))
    }

    fn keep_shape(&self, session: String, sequence: u64, shape: Bytes) -> Stored<'_, ()> {
        Box::pin(self.keep_newest_shape(session, sequence, shape))
    }

    fn adopt(&self, session: String, build: String, digests: Vec<(u64, String)>) -> Stored<'_, ()> {
        Box::pin(self.adopt_digests(session, build, digests))
    }

    fn load(&self, tenant: Tenant, id: String) -> Stored<'_, Option<StoredSession>> {
        Box::pin(async move {
            self.writer.settle().await?;
            reading::whole_session(&self.pool, &tenant, &id).await
        })
    }

    fn commit(&self, session: String, sequence: u64) -> Stored<'_, Option<StoredCommit>> {
        Box::pin(async move {
            self.writer.settle().await?;
            let row = reading::commit_row(&self.pool, &session, sequence).await?;
            row.map(|row| row.into_commit()).transpose()
        })
    }

    fn holds(&self, tenant: Tenant, id: String) -> Stored<'_, bool> {
        Box::pin(async move { reading::has_session(&self.pool, &tenant.0, &id).await })
    }

    fn list(&self, tenant: Tenant, after: u64, most: usize) -> Stored<'_, Vec<(u64, Option<ListedSession>)>> {
        Box::pin(async move {
            let mut list = reading::listed(&self.pool, &tenant.0, after, most).await?;
            // One whose creation was refused is removed as soon as the database can be written.
            let refused = |id: &str| self.writer.refused_creation(id);
            for (_, listed) in &mut list {
                *listed = listed.take().filter(|session| !refused(&session.id));
            }
            Ok(list)
        })
    }

    fn object(&self, name: String) -> Stored<'_, Bytes> {
        Box::pin(self.objects.get(name))
    }

    fn delete(&self, audit: AuditEntry) -> Stored<'_, ()> {
        Box::pin(self.write(WriteOrder::Delete { audit }))
    }

    fn note_use(&self, sessions: Vec<UsedSession>) -> Stored<'_, ()> {
        Box::pin(self.write(WriteOrder::NoteUse { sessions }))
    }

    fn expired(&self, now_ms: u64) -> Stored<'_, Vec<(Tenant, String)>> {
        Box::pin(reading::expired(&self.pool, now_ms))
    }

    fn sessions_by_tenant(&self) -> Stored<'_, Vec<(Tenant, u64)>> {
        Box::pin(reading::sessions_by_tenant(&self.pool))
    }

    fn stored_bytes(&self, tenant: Tenant) -> Stored<'_, u64> {
        Box::pin(async move { reading::stored_bytes(&self.pool, &tenant.0).await })
    }

    fn keys(&self) -> Stored<'_, Vec<LoggedKey>> {
        Box::pin(reading::keys(&self.pool))
    }

    fn forget_keys(&self, before_ms: u64) -> Stored<'_, ()> {
        Box::pin(self.write(WriteOrder::ForgetKeys { before_ms }))
    }

    fn highest_number(&self) -> Stored<'_, u64> {
        Box::pin(reading::highest_number(&self.pool))
    }

    fn audit(&self, entry: AuditEntry) -> Stored<'_, ()> {
        Box::pin(self.write(WriteOrder::Audit { entry }))
    }

    fn audited_tenants(&self) -> Stored<'_, Vec<Tenant>> {
        Box::pin(audit_reading::audited_tenants(&self.pool))
    }

    fn forget_audit_of(&self, tenant: Tenant, before_ms: u64) -> Stored<'_, ()> {
        let tenant = Some(tenant);
        Box::pin(self.write(WriteOrder::ForgetAudit { tenant, before_ms }))
    }
}
