//! The store on a database and a folder of objects: what is written, and what it does itself. What is read is in `reading`.

use super::database::SessionTables;
use super::location::FolderHold;
use super::objects::{NAMED_WITHIN, Objects};
use super::schema::commit_checksum;
use super::session_store::{Generation, HeldSession, NewCommit, NewSession, StoreError, UsedSession};
use super::shared_store::SharedStore;
use super::write_order::{StoredObject, WriteOrder, first_generation};
use super::writer::{StoreHealth, Writer};
use crate::answers::Tenant;
use crate::audit::audit_entry::AuditEntry;
use crate::surroundings::Surroundings;
use bytes::Bytes;
use futures::future::BoxFuture;
use pliant_asset::FileSet;
use pliant_wire::record::{FileReferences, LoggedCommit};
use std::path::PathBuf;
use std::sync::Arc;
use tokio::time::Instant;

/// Sessions in a database, what is large as objects. What returns `Ok` from a write is on disk; what returns an error has changed nothing
/// that is ever read again.
#[derive(Debug)]
pub struct Store {
    pub(super) build: String,
    pub(super) tables: Arc<dyn SessionTables>,
    pub(super) objects: Arc<Objects>,
    /// How it is written; `None` where it is only read.
    pub(super) writing: Option<StoreWriting>,
    /// Whether another process may be writing it.
    pub(super) is_written: bool,
    /// The folder of a database that is a file.
    pub(super) folder: Option<PathBuf>,
    /// Held as long as the store: one process writes a folder.
    pub(super) _hold: Option<FolderHold>,
    pub(super) faults: Option<Arc<dyn StoreFaults>>,
    pub(super) surroundings: Arc<dyn Surroundings>,
}

/// What writes a store.
#[derive(Debug)]
pub(super) struct StoreWriting {
    pub writer: Arc<Writer>,
    pub health: Arc<StoreHealth>,
    /// What this node knows of it, where several share the store.
    pub shared: Option<SharedStore>,
}

/// Lets tests make a store fail, or wait.
pub trait StoreFaults: Send + Sync + std::fmt::Debug + 'static {
    /// Is asked before each call that a session waits for, sweeps not among them.
    fn pass(&self) -> BoxFuture<'_, Result<(), StoreError>>;
}

impl Store {
    /// The same store, with `faults` before its calls.
    #[must_use]
    pub fn with_faults(self, faults: Arc<dyn StoreFaults>) -> Self {
        Self {
            faults: Some(faults),
            ..self
        }
    }

    /// The machine that it is used on.
    pub(crate) fn surroundings(&self) -> Arc<dyn Surroundings> {
        Arc::clone(&self.surroundings)
    }

    pub(super) async fn pass_faults(&self) -> Result<(), StoreError> {
        match &self.faults {
            Some(faults) => faults.pass().await,
            None => Ok(()),
        }
    }

    /// Which build and processor makes results now.
    pub(crate) fn build(&self) -> String {
        self.build.clone()
    }

    /// Whether it is open to be written. Otherwise every call that writes ends with [`StoreError::Refused`].
    pub(crate) fn is_writable(&self) -> bool {
        self.writing.is_some()
    }

    /// Whether another process may be writing it meanwhile.
    pub fn is_written(&self) -> bool {
        self.is_written
    }

    fn writing(&self) -> Result<&StoreWriting, StoreError> {
        let refused = || StoreError::Refused("the store is only looked at".into());
        self.writing.as_ref().ok_or_else(refused)
    }

    /// How nodes that share the store take sessions; `None` where one process has it for itself.
    pub(crate) fn ownership(&self) -> Option<&SharedStore> {
        self.writing.as_ref()?.shared.as_ref()
    }

    /// Whether the store takes writes: false from a write that failed until one works again.
    pub(crate) fn takes_writes(&self) -> bool {
        // Who asks wants to know it as it is now, and not as of the last look.
        let takes = |health: &StoreHealth| health.note(health.check_places()).is_ok() && health.takes_writes();
        self.writing.as_ref().is_some_and(|writing| takes(&writing.health))
    }

    /// Removes what was refused and may have been written; to be called before commits are read.
    pub(super) async fn undo_uncertain_commits(&self) -> Result<(), StoreError> {
        match &self.writing {
            Some(writing) => writing.writer.undo_uncertain_commits().await,
            None => Ok(()),
        }
    }

    /// What comes before the reading of commits.
    pub(super) async fn settle_before_reading(&self) -> Result<(), StoreError> {
        self.pass_faults().await?;
        self.undo_uncertain_commits().await
    }

    /// Whether the creation of a session was refused and may have been written.
    pub(super) fn refused_creation(&self, session: &str) -> bool {
        let writing = self.writing.as_ref();
        writing.is_some_and(|writing| writing.writer.refused_creation(session))
    }

    /// Passes on what was read. Who only reads a store is an operator, and learns why it cannot be read, which a server hides from clients.
    pub(super) fn explain<T>(&self, read: Result<T, StoreError>) -> Result<T, StoreError> {
        match (read, &self.writing) {
            (Err(StoreError::Unavailable(problem)), None) => Err(StoreError::Refused(problem)),
            (read, _) => read,
        }
    }

    /// Writes what waits and closes the database, so that its file is whole without the log beside it. Nothing can be read or written
    /// afterwards.
    pub async fn close(&self) {
        self.tables.close().await;
        if let Some(writing) = &self.writing {
            writing.writer.finish().await;
            if let Some(shared) = &writing.shared {
                shared.close().await;
            }
        }
    }

    /// Records the sizes of objects that an older version wrote. A missing object has size 0; reading it is an error.
    pub(super) async fn measure_objects(&self) -> Result<(), StoreError> {
        let mut objects = Vec::new();
        for name in self.tables.unmeasured_objects().await? {
            let bytes = self.objects.size(&name).await.unwrap_or_default();
            objects.push(StoredObject { name, bytes });
        }
        if !objects.is_empty() {
            self.write(WriteOrder::Measure { objects }).await?;
        }
        Ok(())
    }

    /// Removes objects that no session names.
    ///
    /// # Errors
    /// When database or objects do not answer.
    pub async fn remove_unused(&self, names: &[String]) -> Result<(), StoreError> {
        let _alone = self.objects.naming.write().await;
        for name in names {
            if !self.tables.is_used(name, None).await? {
                self.objects.remove(name).await?;
            }
        }
        Ok(())
    }

    async fn put_object(&self, bytes: Bytes) -> Result<String, StoreError> {
        let StoreWriting { health, shared, .. } = self.writing()?;
        health.note(health.check_places())?;
        if let Some(shared) = shared {
            let name = self.objects.name(bytes.clone()).await?;
            health.note(shared.tables.note_loose(&name).await)?;
        }
        health.note(self.objects.put(bytes).await)
    }

    /// Refuses to name objects that were announced too long ago: they may be gone again.
    fn refuse_late_names(&self, begun: Instant) -> Result<(), StoreError> {
        if self.ownership().is_some() && begun.elapsed() > NAMED_WITHIN {
            return Err(StoreError::Unavailable(format!(
                "writing the objects took longer than {NAMED_WITHIN:?}"
            )));
        }
        Ok(())
    }

    /// Reads an object.
    pub(crate) async fn object(&self, name: &str) -> Result<Bytes, StoreError> {
        self.pass_faults().await?;
        let read = self
            .objects
            .get(name.to_owned())
            .await
            .map_err(|error| match (error, &self.writing) {
                // Where everything is gone, it is not the one object that is damaged.
                (error @ StoreError::Damaged(_), Some(StoreWriting { health, .. })) => {
                    health.note(health.check_places()).err().unwrap_or(error)
                }
                (error, _) => error,
            });
        self.explain(read)
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
        let unnamed = self.writing()?.writer.write(order).await?;
        for object in unnamed {
            if let Err(error) = self.remove_unused(&[object]).await {
                tracing::warn!("an object that no session uses could not be removed: {error}");
            }
        }
        Ok(())
    }

    /// Keeps a new session, which is this process's then.
    pub(crate) async fn create(&self, mut session: NewSession) -> Result<Generation, StoreError> {
        self.pass_faults().await?;
        let begun = Instant::now();
        let owner = self.ownership().map(|shared| shared.id.clone()).unwrap_or_default();
        let generation = first_generation(&owner);
        session.first.session.generation = generation;
        let naming = self.objects.naming.read().await;
        let (names, objects) = self.put_files(&session.files).await?;
        session.model.files = names;
        session.files = FileSet::default();
        let order = WriteOrder::Create {
            model: session.model.write(),
            session: Box::new(session),
            objects,
            owner,
        };
        self.refuse_late_names(begun)?;
        let written = self.writing()?.writer.write(order).await;
        drop(naming);
        written.map(|_| generation)
    }

    /// Keeps a commit.
    pub(crate) async fn append(&self, mut commit: NewCommit) -> Result<(), StoreError> {
        self.pass_faults().await?;
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
        let written = self
            .writing()?
            .writer
            .write(WriteOrder::Append { commit, objects })
            .await;
        drop(naming);
        written.map(drop)
    }

    /// Keeps a shape as the newest of a session.
    pub(crate) async fn save_snapshot(
        &self,
        session: HeldSession,
        sequence: u64,
        shape: Bytes,
    ) -> Result<(), StoreError> {
        self.pass_faults().await?;
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
        let unnamed = self.writing()?.writer.write(order).await?;
        drop(naming);
        self.remove_unused(&unnamed).await
    }

    /// Replaces digests, by the numbers of commits, by those of `build`.
    pub(crate) async fn rerecord_digests(
        &self,
        session: HeldSession,
        build: &str,
        digests: Vec<(u64, String)>,
    ) -> Result<(), StoreError> {
        self.pass_faults().await?;
        let gone = || StoreError::Damaged("a commit is gone".into());
        let mut commits = Vec::with_capacity(digests.len());
        for (sequence, digest) in digests {
            let found = self.tables.commit(&session.id, sequence).await?;
            let (mut commit, payload) = found.ok_or_else(gone)?;
            commit.digest = digest;
            build.clone_into(&mut commit.build);
            let checksum = commit_checksum(&session.id, commit.record.kind(), &commit, &payload);
            commits.push((commit, checksum));
        }
        self.write(WriteOrder::RerecordDigests { session, commits }).await
    }

    /// Deletes a session and what only it used, and notes who did.
    ///
    /// # Errors
    /// [`StoreError::Unavailable`] where it cannot be written, [`StoreError::Moved`] where another node has the session,
    /// [`StoreError::Refused`] where it is open to be read only.
    pub async fn delete(&self, audit: AuditEntry, generation: Generation) -> Result<(), StoreError> {
        self.pass_faults().await?;
        self.write(WriteOrder::Delete { audit, generation }).await
    }

    /// Notes when sessions were used.
    pub(crate) async fn note_use(&self, sessions: Vec<UsedSession>) -> Result<(), StoreError> {
        self.write(WriteOrder::NoteUse { sessions }).await
    }

    /// Forgets keys from before `before_ms`.
    pub(crate) async fn forget_keys(&self, before_ms: u64) -> Result<(), StoreError> {
        self.write(WriteOrder::ForgetKeys { before_ms }).await
    }

    /// Notes who did what.
    ///
    /// # Errors
    /// As [`Store::delete`].
    pub async fn audit(&self, entry: AuditEntry) -> Result<(), StoreError> {
        self.write(WriteOrder::Audit { entry }).await
    }

    /// Forgets what was noted before `before_ms`, of one tenant where it is named.
    ///
    /// # Errors
    /// As [`Store::delete`].
    pub async fn forget_audit(&self, tenant: Option<Tenant>, before_ms: u64) -> Result<(), StoreError> {
        self.write(WriteOrder::ForgetAudit { tenant, before_ms }).await
    }
}
