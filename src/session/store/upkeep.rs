//! What operators do with a store: look into it, compare it with its checksums, remove what is left over.

use super::database_store::DatabaseStore;
use super::newest_write::find_lost_writes;
use super::objects::Objects;
use super::read_only_store::ReadOnlyStore;
use super::reading;
use super::session_store::{SessionStore as _, StoreError, StoredFacts};
use super::write_order::WriteOrder;
use crate::session::answers::Tenant;
use crate::wire::record::LoggedCommit;
use sqlx::AnyPool;
use std::collections::BTreeSet;

/// Sessions read at a time.
const PAGE: usize = 500;

/// What the comparison of a session with its checksums found in order.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CheckedSession {
    /// Commits that were read.
    pub commits: u64,
    /// Objects that were read.
    pub objects: u64,
    /// Their bytes.
    pub object_bytes: u64,
}

async fn facts_of_all(pool: &AnyPool) -> Result<Vec<StoredFacts>, StoreError> {
    let mut all: Vec<StoredFacts> = Vec::new();
    loop {
        let after = all.last().map_or(0, |s| s.number);
        let page = reading::stored_facts(pool, after, PAGE).await?;
        if page.is_empty() {
            return Ok(all);
        }
        all.extend(page);
    }
}

async fn objects_without_session(pool: &AnyPool, objects: &Objects) -> Result<Vec<String>, StoreError> {
    let mut unused = objects.names().await?;
    let used: BTreeSet<String> = reading::used_objects(pool).await?.into_iter().collect();
    unused.retain(|name| !used.contains(name));
    unused.sort();
    Ok(unused)
}

impl ReadOnlyStore {
    /// The sessions of all tenants, in the order of their creation.
    ///
    /// # Errors
    /// When the database does not answer.
    pub async fn all_sessions(&self) -> Result<Vec<StoredFacts>, StoreError> {
        facts_of_all(&self.database.pool).await
    }

    /// Compares rows and objects of a session with their checksums; `None` where the session has gone meanwhile.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] with the first thing that does not fit. What is written meanwhile may not fit once.
    pub async fn check_session(&self, tenant: &Tenant, id: &str) -> Result<Option<CheckedSession>, StoreError> {
        let Some(session) = self.load(tenant.clone(), id.to_owned()).await? else {
            return Ok(None);
        };
        let mut names: BTreeSet<String> = session.model.files.objects().cloned().collect();
        for commit in &session.commits {
            if let LoggedCommit::Edit { files: Some(files), .. } = &commit.commit {
                names.extend(files.objects().cloned());
            }
        }
        names.extend(session.snapshot.into_iter().map(|s| s.object));
        let mut checked = CheckedSession {
            commits: session.commits.len() as u64,
            objects: names.len() as u64,
            object_bytes: 0,
        };
        for name in names {
            if !reading::uses(&self.database.pool, id, &name).await? {
                let text = format!("object {name} is the session's, and is not noted as used");
                return Err(StoreError::Damaged(text));
            }
            checked.object_bytes += self.object(name).await?.len() as u64;
        }
        Ok(Some(checked))
    }

    /// Compares the database with itself, where it can.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] with what it finds.
    pub async fn check_database(&self) -> Result<(), StoreError> {
        reading::integrity(&self.database.pool, self.database.dialect).await?;
        let Some(folder) = &self.folder else { return Ok(()) };
        let failed = |e: sqlx::Error| StoreError::Unavailable(e.to_string());
        let mut connection = self.database.pool.acquire().await.map_err(failed)?;
        match find_lost_writes(folder, &mut connection).await? {
            Some(lost) => Err(StoreError::Damaged(lost)),
            None => Ok(()),
        }
    }

    /// The objects that no session names; where a server holds the store, those among them that it is just writing.
    ///
    /// # Errors
    /// When database or objects do not answer.
    pub async fn unused_objects(&self) -> Result<Vec<String>, StoreError> {
        objects_without_session(&self.database.pool, &self.objects).await
    }
}

impl DatabaseStore {
    /// The sessions of all tenants, in the order of their creation.
    ///
    /// # Errors
    /// When the database does not answer.
    pub async fn all_sessions(&self) -> Result<Vec<StoredFacts>, StoreError> {
        facts_of_all(&self.pool).await
    }

    /// The objects that no session names.
    ///
    /// # Errors
    /// When database or objects do not answer.
    pub async fn unused_objects(&self) -> Result<Vec<String>, StoreError> {
        objects_without_session(&self.pool, &self.objects).await
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
}
