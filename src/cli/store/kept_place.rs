//! Where sessions are kept, as the commands are told, and what all of them do with it.

use super::super::failure::CliFailure;
use crate::server::config::{ConfigKeys, KeyValue, stored_in};
use crate::session::store::{DatabaseStore, ReadOnlyStore, StoreError, StoredFacts};
use crate::session::{self, ErrorCode, Manager, OpenDeformer, SessionConfig};
use clap::Args;
use std::path::PathBuf;
use std::sync::Arc;

/// Sessions read at a time.
const PAGE: usize = 500;

/// Where the sessions are kept.
#[derive(Debug, Args)]
pub(super) struct StorePlaceArgs {
    /// Configuration file of the server (TOML)
    #[arg(long, value_name = "FILE", env = "PLIANT_CONFIG")]
    config: Option<PathBuf>,
    /// Folder where sessions are kept
    #[arg(long, value_name = "FOLDER")]
    data_dir: Option<KeyValue<String>>,
    /// Database of the sessions, postgres://USER:PASSWORD@HOST/DATABASE
    #[arg(long, value_name = "URL")]
    database: Option<KeyValue<String>>,
    /// Place of models and shapes, s3://BUCKET/PREFIX
    #[arg(long, value_name = "URL")]
    objects: Option<KeyValue<String>>,
}

impl StorePlaceArgs {
    /// Opens the store. One that is not there is not made.
    pub async fn open(&self) -> Result<DatabaseStore, CliFailure> {
        let keys = ConfigKeys {
            data_dir: self.data_dir.clone(),
            database: self.database.clone(),
            objects: self.objects.clone(),
            ..ConfigKeys::default()
        };
        let location = stored_in(self.config.as_deref(), &keys).map_err(|e| CliFailure::Input(e.to_string()))?;
        let location = location.ok_or_else(|| {
            CliFailure::Input("say where sessions are kept: --data-dir, or --database and --objects".into())
        })?;
        if let Some(folder) = &location.data_dir
            && !folder.is_dir()
        {
            return Err(CliFailure::Input(format!("{} is no folder", folder.display())));
        }
        DatabaseStore::open(&location).await.map_err(store_failure)
    }
}

/// How a command ends that the store refuses.
pub(super) fn store_failure(error: StoreError) -> CliFailure {
    let text = format!("the store of sessions: {error}");
    match error {
        StoreError::Damaged(_) => CliFailure::Check(text),
        StoreError::Unavailable(_) | StoreError::Refused(_) => CliFailure::Input(text),
    }
}

/// How a command ends that a session refuses.
pub(super) fn session_failure(error: &session::Error) -> CliFailure {
    match error.code {
        ErrorCode::DataLoss => CliFailure::Check(error.to_string()),
        ErrorCode::Internal => CliFailure::Internal(error.to_string()),
        _ => CliFailure::Input(error.to_string()),
    }
}

/// All sessions, in the order of their creation.
pub(super) async fn all_sessions(store: &DatabaseStore) -> Result<Vec<StoredFacts>, CliFailure> {
    let mut all: Vec<StoredFacts> = Vec::new();
    loop {
        let after = all.last().map_or(0, |s| s.number);
        let page = store.sessions(after, PAGE).await.map_err(store_failure)?;
        if page.is_empty() {
            return Ok(all);
        }
        all.extend(page);
    }
}

/// Sessions of a store that is only looked at.
pub(super) async fn lookers(store: &Arc<DatabaseStore>) -> Result<Manager, CliFailure> {
    let config = SessionConfig::default();
    let looked_at = ReadOnlyStore(Arc::clone(store) as Arc<_>);
    let manager = Manager::with_store(config, OpenDeformer, Arc::new(looked_at)).await;
    manager.map_err(|e| session_failure(&e))
}
