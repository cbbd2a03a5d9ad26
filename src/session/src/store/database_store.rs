//! The store on a database and a folder of objects.

use super::location::FolderHold;
use super::objects::Objects;
use super::objects::{NAMED_WITHIN, announce};
use super::reading;
use super::session_store::{
    Commit, Generation, HeldSession, KeepSessions, ListedSession, LoggedKey, NewCommit, NewSession, ReadSessions,
    SessionOwnership, StoreError, Stored, StoredFacts, StoredSession, UsedSession,
};
use super::shared_store::SharedStore;
use super::write_order::{StoredObject, WriteOrder, first_generation};
use super::writer::{StoreHealth, Writer};
use crate::answers::Tenant;
use crate::audit::audit_entry::AuditEntry;
use bytes::Bytes;
use pliant_asset::FileSet;
use pliant_wire::record::{FileReferences, LoggedCommit};
use sqlx::AnyPool;
use std::sync::Arc;
use std::time::Instant;

/// Sessions in a database, what is large as objects.
#[derive(Debug)]
pub struct DatabaseStore {
    pub(super) build: String,
    pub(super) pool: AnyPool,
    pub(super) writer: Arc<Writer>,
    pub(super) objects: Arc<Objects>,
    pub(super) health: Arc<StoreHealth>,
    /// What this node knows of it, where several share the store.
    pub(super) shared: Option<SharedStore>,
    /// Held as long as the store: one process writes a folder.
    pub(super) _hold: Option<FolderHold>,
}

impl DatabaseStore {
    /// Writes what waits and closes the database, so that its file is whole without the log beside it. Nothing can be read or written
    /// afterwards.
    pub async fn close(&self) {
        self.pool.close().await;
        self.writer.finish().await;
        if let Some(shared) = &self.shared {
            shared.close().await;
        }
    }

    /// Records the sizes of objects that an older version wrote. A missing object has size 0; reading it is an error.
    pub(super) async fn measure_objects(&self) -> Result<(), StoreError> {
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

    /// The sessions of all tenants, in the order of their creation.
    ///
    /// # Errors
    /// When the database does not answer.
    pub async fn all_sessions(&self) -> Result<Vec<StoredFacts>, StoreError> {
        reading::all_sessions(&self.pool).await
    }

    /// The objects that no session names.
    ///
    /// # Errors
    /// When database or objects do not answer.
    pub async fn unused_objects(&self) -> Result<Vec<String>, StoreError> {
        self.objects.unused(reading::used_objects(&self.pool).await?).await
    }

    /// Removes objects that no session names.
    ///
    /// # Errors
    /// When database or objects do not answer.
    pub async fn remove_unused(&self, names: &[String]) -> Result<(), StoreError> {
        let _alone = self.objects.naming.write().await;
        for name in names {
            if !reading::is_used(&self.pool, name).await? {
                self.objects.remove(name).await?;
            }
        }
        Ok(())
    }

    /// Forgets what the audit trail says of before `before_ms`.
    ///
    /// # Errors
    /// When the database does not answer.
    pub async fn forget_audit(&self, before_ms: u64) -> Result<(), StoreError> {
        self.write(WriteOrder::ForgetAudit {
            tenant: None,
            before_ms,
        })
        .await
    }

    async fn put_object(&self, bytes: Bytes) -> Result<String, StoreError> {
        self.health.note(self.health.check_places())?;
        if self.shared.is_some() {
            let name = self.objects.name(bytes.clone()).await?;
            self.health.note(announce(&self.pool, &name).await)?;
        }
        self.health.note(self.objects.put(bytes).await)
    }

    /// The node that has what is created here; empty for a single node.
    fn owner(&self) -> String {
        self.shared
            .as_ref()
            .map(|shared| shared.lease.id.clone())
            .unwrap_or_default()
    }

    /// Refuses to name objects that were announced too long ago: they may be gone again.
    fn refuse_late_names(&self, begun: Instant) -> Result<(), StoreError> {
        if self.shared.is_some() && begun.elapsed() > NAMED_WITHIN {
            return Err(StoreError::Unavailable(format!(
                "writing the objects took longer than {NAMED_WITHIN:?}"
            )));
        }
        Ok(())
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

    /// Writes an order and removes the objects that have no name after it. A failed removal is not an error: `prune`
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

    async fn create_session(&self, mut session: NewSession) -> Result<Generation, StoreError> {
        let (begun, owner) = (Instant::now(), self.owner());
        let generation = first_generation(&owner);
        session.first.session.generation = generation;
        let naming = self.objects.naming.read().await;
        let (names, objects) = self.put_files(&session.files).await?;
        session.model.files = names;
        let model = session.model.write();
        let session = Box::new(NewSession {
            files: FileSet::default(),
            ..session
        });
        let order = WriteOrder::Create {
            session,
            model,
            objects,
            owner,
        };
        self.refuse_late_names(begun)?;
        let written = self.writer.write(order).await;
        drop(naming);
        written.map(|_| generation)
    }

    async fn append_commit(&self, mut commit: NewCommit) -> Result<(), StoreError> {
        let begun = Instant::now();
        let naming = self.objects.naming.read().await;
        let mut objects = Vec::new();
        if let (Some(given), LoggedCommit::Edit { files, .. }) = (commit.files.take(), &mut commit.commit.record) {
            let (names, merged) = self.put_files(&given).await?;
            objects = merged;
            *files = Some(names);
        }
        self.refuse_late_names(begun)?;
        let commit = Box::new(commit);
        let written = self.writer.write(WriteOrder::Append { commit, objects }).await;
        drop(naming);
        written.map(drop)
    }

    async fn write_snapshot(&self, session: HeldSession, sequence: u64, shape: Bytes) -> Result<(), StoreError> {
        let begun = Instant::now();
        let naming = self.objects.naming.read().await;
        let bytes = shape.len() as u64;
        let name = self.put_object(shape).await?;
        let order = WriteOrder::SaveSnapshot {
            session,
            sequence,
            shape: StoredObject { name, bytes },
        };
        self.refuse_late_names(begun)?;
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

    async fn write_digests(
        &self,
        session: HeldSession,
        build: String,
        digests: Vec<(u64, String)>,
    ) -> Result<(), StoreError> {
        let gone = || StoreError::Damaged("a commit is gone".into());
        let mut commits = Vec::with_capacity(digests.len());
        for (sequence, digest) in digests {
            let mut row = reading::commit_row(&self.pool, &session.id, sequence)
                .await?
                .ok_or_else(gone)?;
            row.digest = digest;
            row.build.clone_from(&build);
            commits.push(row);
        }
        self.write(WriteOrder::RerecordDigests { session, commits }).await
    }
}

impl ReadSessions for DatabaseStore {
    fn build(&self) -> String {
        self.build.clone()
    }

    fn ownership(&self) -> Option<&dyn SessionOwnership> {
        self.shared.as_ref().map(|shared| shared as _)
    }

    fn takes_writes(&self) -> bool {
        // Who asks wants to know it as it is now, and not as of the last look.
        self.health.note(self.health.check_places()).is_ok() && self.health.takes_writes()
    }

    fn writable(&self) -> Result<&dyn KeepSessions, StoreError> {
        Ok(self)
    }

    fn load(&self, tenant: Tenant, id: String) -> Stored<'_, Option<StoredSession>> {
        Box::pin(async move {
            self.writer.undo_uncertain_commits().await?;
            reading::whole_session(&self.pool, &tenant, &id).await
        })
    }

    fn commit(&self, session: String, sequence: u64) -> Stored<'_, Option<Commit>> {
        Box::pin(async move {
            self.writer.undo_uncertain_commits().await?;
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

    fn sessions_by_tenant(&self) -> Stored<'_, Vec<(Tenant, u64)>> {
        Box::pin(reading::sessions_by_tenant(&self.pool))
    }

    fn stored_bytes(&self, tenant: Tenant) -> Stored<'_, u64> {
        Box::pin(async move { reading::stored_bytes(&self.pool, &tenant.0).await })
    }

    fn count_sessions(&self, tenant: Tenant) -> Stored<'_, u64> {
        Box::pin(async move { reading::count_sessions(&self.pool, &tenant.0).await })
    }

    fn highest_number(&self) -> Stored<'_, u64> {
        Box::pin(reading::highest_number(&self.pool))
    }
}

impl KeepSessions for DatabaseStore {
    fn create(&self, session: NewSession) -> Stored<'_, Generation> {
        Box::pin(self.create_session(session))
    }

    fn append(&self, commit: NewCommit) -> Stored<'_, ()> {
        Box::pin(self.append_commit(commit))
    }

    fn save_snapshot(&self, session: HeldSession, sequence: u64, shape: Bytes) -> Stored<'_, ()> {
        Box::pin(self.write_snapshot(session, sequence, shape))
    }

    fn rerecord_digests(&self, session: HeldSession, build: String, digests: Vec<(u64, String)>) -> Stored<'_, ()> {
        Box::pin(self.write_digests(session, build, digests))
    }

    fn delete(&self, audit: AuditEntry, generation: Generation) -> Stored<'_, ()> {
        Box::pin(self.write(WriteOrder::Delete { audit, generation }))
    }

    fn note_use(&self, sessions: Vec<UsedSession>) -> Stored<'_, ()> {
        Box::pin(self.write(WriteOrder::NoteUse { sessions }))
    }

    fn expired(&self, since_ms: u64, now_ms: u64) -> Stored<'_, Vec<(Tenant, String)>> {
        Box::pin(reading::expired(&self.pool, since_ms, now_ms))
    }

    fn key(&self, tenant: Tenant, key: String) -> Stored<'_, Option<LoggedKey>> {
        Box::pin(async move {
            // One whose commit was refused goes with it: no caller may learn that it was carried out.
            self.writer.undo_uncertain_commits().await?;
            reading::one_key(&self.pool, &tenant.0, &key).await
        })
    }

    fn keys(&self) -> Stored<'_, Vec<LoggedKey>> {
        Box::pin(reading::keys(&self.pool))
    }

    fn forget_keys(&self, before_ms: u64) -> Stored<'_, ()> {
        Box::pin(self.write(WriteOrder::ForgetKeys { before_ms }))
    }

    fn audit(&self, entry: AuditEntry) -> Stored<'_, ()> {
        Box::pin(self.write(WriteOrder::Audit { entry }))
    }

    fn audited_tenants(&self) -> Stored<'_, Vec<Tenant>> {
        Box::pin(reading::audited_tenants(&self.pool))
    }

    fn forget_audit_of(&self, tenant: Tenant, before_ms: u64) -> Stored<'_, ()> {
        let tenant = Some(tenant);
        Box::pin(self.write(WriteOrder::ForgetAudit { tenant, before_ms }))
    }
}
