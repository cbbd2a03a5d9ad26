//! The store on a database and a folder of objects.

use super::audit_reading;
use super::build_identity::build_identity;
use super::connection::{DatabaseAddress, WritingConnection};
use super::data_folder::{DATABASE_FILE, FolderHold, existing_database, refuse_objects_alone};
use super::objects::Objects;
use super::private_files::make_private_file;
use super::reading;
use super::schema::{identity, migrate, version};
use super::session_store::{
    ListedSession, LoggedKey, NewCommit, NewSession, SessionStore, StoreError, Stored, StoredCommit, StoredSession,
    UsedSession,
};
use super::store_health::StoreHealth;
use super::store_location::StoreLocation;
use super::store_watch::watch_store;
use super::write_order::{StoredObject, WriteOrder};
use super::writer::Writer;
use crate::asset::FileSet;
use crate::session::answers::Tenant;
use crate::session::audit::audit_entry::AuditEntry;
use crate::wire::record::{FileReferences, LoggedCommit};
use bytes::Bytes;
use sqlx::AnyPool;
use std::path::PathBuf;
use std::sync::Arc;

/// Sessions in a database, what is large as objects.
#[derive(Debug)]
pub struct DatabaseStore {
    build: String,
    pub(super) pool: AnyPool,
    writer: Arc<Writer>,
    pub(super) objects: Arc<Objects>,
    health: Arc<StoreHealth>,
    /// Held as long as the store: one process writes a folder.
    _hold: Option<FolderHold>,
}

impl DatabaseStore {
    /// Opens a store, makes or brings up to date what is missing.
    ///
    /// # Errors
    /// [`StoreError::Refused`] when another process has it, a later version wrote it or objects are there without their database,
    /// [`StoreError::Unavailable`] when folder or database cannot be had.
    pub async fn open(location: &StoreLocation) -> Result<Self, StoreError> {
        let hold = location.data_dir.as_deref().map(FolderHold::alone).transpose()?;
        if let (Some(folder), None) = (&location.data_dir, &location.database) {
            refuse_objects_alone(folder)?;
            let file = folder.join(DATABASE_FILE);
            // The folder of objects is made before anything is written into the file: without it the models would be missing.
            if location.objects.is_none() && file.metadata().is_ok_and(|facts| facts.len() > 0) {
                Objects::in_folder_to_read(folder)?;
            }
            make_private_file(&file).map_err(|e| StoreError::Unavailable(format!("{}: {e}", file.display())))?;
        }
        Self::open_held(location, hold, true).await
    }

    /// Opens a store that is there, to change it. Nothing is made where none is.
    ///
    /// # Errors
    /// As [`DatabaseStore::open`]; [`StoreError::Refused`] where there is no store.
    pub async fn open_existing(location: &StoreLocation) -> Result<Self, StoreError> {
        if let (Some(folder), None) = (&location.data_dir, &location.database) {
            existing_database(folder)?;
        }
        let hold = location.data_dir.as_deref().filter(|folder| folder.is_dir());
        let hold = hold.map(FolderHold::alone).transpose()?;
        Self::open_held(location, hold, false).await
    }

    async fn open_held(location: &StoreLocation, hold: Option<FolderHold>, makes: bool) -> Result<Self, StoreError> {
        let nowhere =
            || StoreError::Refused("sessions need a data folder, or both a database and a place of objects".into());
        let folder = || location.data_dir.as_deref().ok_or_else(nowhere);
        let address = match &location.database {
            Some(url) => DatabaseAddress::server(url)?,
            None => DatabaseAddress::file(&folder()?.join(DATABASE_FILE))?,
        };
        let objects = match &location.objects {
            Some(url) => Objects::in_bucket(url)?,
            None if makes => Objects::in_folder(folder()?)?,
            None => Objects::in_folder_to_read(folder()?).and_then(|_| Objects::in_folder(folder()?))?,
        };
        let mut writing = WritingConnection::open(&address).await?;
        let connection = writing.get().await?;
        if version(connection, address.dialect()).await?.is_none() {
            if !makes {
                return Err(address.no_tables());
            }
            if objects.are_in_use().await? {
                return Err(StoreError::Refused(format!(
                    "{address:?} has no sessions, and the objects there belong to another database; restore that one, or name another place"
                )));
            }
        }
        migrate(connection, address.dialect()).await?;
        objects.belong_to(&identity(connection).await?).await?;
        let health = Arc::new(StoreHealth::of_places(places(location))?);
        let store = Self {
            build: location.build.clone().unwrap_or_else(build_identity),
            pool: address.readers().await?,
            writer: Arc::new(Writer::start(writing, Arc::clone(&health))),
            objects: Arc::new(objects),
            health,
            _hold: hold,
        };
        let (writer, objects) = (Arc::downgrade(&store.writer), Arc::downgrade(&store.objects));
        tokio::spawn(watch_store(Arc::clone(&store.health), writer, objects));
        store.measure_objects().await?;
        Ok(store)
    }

    /// Writes what waits and closes the database, so that its file is whole without the log beside it. Nothing can be read or written
    /// afterwards.
    pub async fn close(&self) {
        self.pool.close().await;
        self.writer.finish().await;
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

    async fn put_object(&self, bytes: Bytes) -> Result<String, StoreError> {
        self.health.note(self.health.check_places())?;
        self.health.note(self.objects.put(bytes).await)
    }

    async fn get_object(&self, name: String) -> Result<Bytes, StoreError> {
        self.objects.get(name).await.map_err(|error| match error {
            // Where everything is gone, it is not the one object that is damaged.
            StoreError::Damaged(_) => self.health.note(self.health.check_places()).err().unwrap_or(error),
            error => error,
        })
    }

    /// Writes files; their names, and what is to be counted of them.
    async fn put_files(&self, files: &FileSet) -> Result<(FileReferences, Vec<StoredObject>), StoreError> {
        let mut objects = Vec::new();
        let mut names = FileReferences {
            name: files.name.clone(),
            main: self.put_object(files.main.clone()).await?,
            companions: Default::default(),
        };
        let counted = |name: &String, bytes: &Bytes| StoredObject {
            name: name.clone(),
            bytes: bytes.len() as u64,
        };
        objects.push(counted(&names.main, &files.main));
        for (uri, bytes) in &files.companions {
            let object = self.put_object(bytes.clone()).await?;
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
        let name = self.put_object(shape).await?;
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

/// The files and folders of a store, all of which have to stay where they are.
fn places(location: &StoreLocation) -> Vec<PathBuf> {
    let Some(folder) = &location.data_dir else {
        return Vec::new();
    };
    let database = location.database.is_none().then(|| folder.join(DATABASE_FILE));
    let objects = location.objects.is_none().then(|| folder.join("objects"));
    [Some(folder.clone()), database, objects]
        .into_iter()
        .flatten()
        .collect()
}

impl SessionStore for DatabaseStore {
    fn build(&self) -> String {
        self.build.clone()
    }

    fn takes_writes(&self) -> bool {
        // Who asks wants to know it as it is now, and not as of the last look.
        self.health.note(self.health.check_places()).is_ok() && self.health.takes_writes()
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
        Box::pin(self.get_object(name))
    }

    fn delete(&self, audit: AuditEntry) -> Stored<'_, ()> {
        Box::pin(self.write(WriteOrder::Delete { audit }))
    }

    fn note_use(&self, sessions: Vec<UsedSession>) -> Stored<'_, ()> {
        Box::pin(self.write(WriteOrder::NoteUse { sessions }))
    }

    fn expired(&self, since_ms: u64, now_ms: u64) -> Stored<'_, Vec<(Tenant, String)>> {
        Box::pin(reading::expired(&self.pool, since_ms, now_ms))
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
