//! Where sessions are kept, by flags or configuration, and how commands open it.

use super::super::failure::CliFailure;
use crate::server::config::{ConfigKeys, KeyValue, stored_in};
use crate::session::store::{DatabaseStore, ReadOnlyStore, StoreError, StoreLocation};
use crate::session::{self, ErrorCode, Manager, OpenDeformer, SessionConfig};
use clap::Args;
use std::path::PathBuf;
use std::sync::Arc;

/// Where the sessions are kept.
#[derive(Debug, Args)]
pub(super) struct StorePlaceArgs {
    /// Configuration file of the server (TOML)
    #[arg(long, value_name = "FILE", env = "PLIANT_CONFIG")]
    config: Option<PathBuf>,
    /// Folder of the stored sessions
    #[arg(long, value_name = "FOLDER")]
    data_dir: Option<KeyValue<String>>,
    /// Database of the stored sessions, postgres://USER:PASSWORD@HOST/DATABASE
    #[arg(long, value_name = "URL")]
    database: Option<KeyValue<String>>,
    /// Object store of models and shapes, s3://BUCKET/PREFIX
    #[arg(long, value_name = "URL")]
    objects: Option<KeyValue<String>>,
}

impl StorePlaceArgs {
    /// Opens the store read-only; a server may hold it meanwhile.
    pub async fn look(&self) -> Result<ReadOnlyStore, CliFailure> {
        ReadOnlyStore::open(&self.location()?).await.map_err(store_failure)
    }

    /// Opens the store exclusively, to change it. It does not create one.
    pub async fn take(&self) -> Result<DatabaseStore, CliFailure> {
        DatabaseStore::open_existing(&self.location()?)
            .await
            .map_err(store_failure)
    }

    fn location(&self) -> Result<StoreLocation, CliFailure> {
        let keys = ConfigKeys {
            data_dir: self.data_dir.clone(),
            database: self.database.clone(),
            objects: self.objects.clone(),
            ..ConfigKeys::default()
        };
        let location = stored_in(self.config.as_deref(), &keys).map_err(|e| CliFailure::Input(e.to_string()))?;
        location.ok_or_else(|| {
            CliFailure::Input("say where sessions are kept: --data-dir, or --database and --objects".into())
        })
    }
}

/// How a command ends that the store refuses.
pub(super) fn store_failure(error: StoreError) -> CliFailure {
    let text = format!("the store of sessions: {error}");
    match error {
        StoreError::Damaged(_) => CliFailure::Check(text),
        StoreError::Unavailable(_) | StoreError::Refused(_) | StoreError::Moved | StoreError::Repeated => {
            CliFailure::Input(text)
        }
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

/// Sessions of a store that is only looked at.
pub(super) async fn lookers(store: &Arc<ReadOnlyStore>) -> Result<Manager, CliFailure> {
    // What a server let in is looked at, whatever its limits were.
    let config = SessionConfig {
        vertices: u32::MAX.into(),
        triangles: u32::MAX.into(),
        handles: u32::MAX as usize,
        ..SessionConfig::default()
    };
    let store = Arc::clone(store) as Arc<_>;
    let manager = Manager::with_store(config, OpenDeformer, store).await;
    manager.map_err(|e| session_failure(&e))
}
