//! What operators do with a store that no server holds: look into it, compare it with its checksums, remove what is left over.

use super::database_store::DatabaseStore;
use super::reading;
use super::session_store::{SessionStore as _, StoreError, StoredFacts};
use super::write_order::WriteOrder;
use crate::session::answers::Tenant;
use crate::wire::record::LoggedCommit;
use std::collections::BTreeSet;

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

impl DatabaseStore {
    /// A page of the sessions of all tenants by rising number, above `after`, at most `most`.
    ///
    /// # Errors
    /// When the database does not answer.
    pub async fn sessions(&self, after: u64, most: usize) -> Result<Vec<StoredFacts>, StoreError> {
        reading::stored_facts(&self.pool, after, most).await
    }

    /// Compares rows and objects of a session with their checksums.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] with the first thing that does not fit.
    pub async fn check_session(&self, tenant: &Tenant, id: &str) -> Result<CheckedSession, StoreError> {
        let gone = || StoreError::Damaged("the session is not there".into());
        let session = self.load(tenant.clone(), id.to_owned()).await?.ok_or_else(gone)?;
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
            if !reading::uses(&self.pool, id, &name).await? {
                let text = format!("object {name} is the session's, and is not noted as used");
                return Err(StoreError::Damaged(text));
            }
            checked.object_bytes += self.object(name).await?.len() as u64;
        }
        Ok(checked)
    }

    /// Compares the database with itself, where it can.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] with what it finds.
    pub async fn check_database(&self) -> Result<(), StoreError> {
        reading::integrity(&self.pool, self.dialect).await
    }

    /// The objects that no session names.
    ///
    /// # Errors
    /// When database or objects do not answer.
    pub async fn unused_objects(&self) -> Result<Vec<String>, StoreError> {
        let mut unused = self.objects.names().await?;
        let used: BTreeSet<String> = reading::used_objects(&self.pool).await?.into_iter().collect();
        unused.retain(|name| !used.contains(name));
        unused.sort();
        Ok(unused)
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
