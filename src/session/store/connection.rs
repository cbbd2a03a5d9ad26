//! The connection to the database: where it is, and how it is made safe.

use super::schema::{Dialect, migrate};
use super::session_store::StoreError;
use percent_encoding::{AsciiSet, CONTROLS, utf8_percent_encode};
use sqlx::any::{AnyPoolOptions, install_default_drivers};
use sqlx::{AnyPool, Executor as _};
use std::path::Path;
use std::time::Duration;

/// Connections that read.
const READERS: u32 = 4;
/// How long a call waits for a connection.
const PATIENCE: Duration = Duration::from_secs(5);

/// What a path must not have in a URL.
const PATH: &AsciiSet = &CONTROLS
    .add(b' ')
    .add(b'%')
    .add(b'?')
    .add(b'#')
    .add(b'&')
    .add(b'"')
    .add(b'<')
    .add(b'>');

/// The connections to one database. Those that read stay open whatever happens to the one that writes, so that reading goes on.
#[derive(Debug, Clone)]
pub(super) struct Connections {
    pub read: AnyPool,
    pub write: AnyPool,
}

/// Opens the database of a folder, made if it is missing.
pub(super) async fn open_sqlite(file: &Path) -> Result<Connections, StoreError> {
    let shown = file.display();
    let text = file
        .to_str()
        .ok_or_else(|| StoreError::Refused(format!("{shown} is no UTF-8 path")))?;
    let url = format!("sqlite://{}?mode=rwc", utf8_percent_encode(text, PATH));
    open(&url, Dialect::Sqlite).await.map_err(|error| match error {
        StoreError::Unavailable(problem) => StoreError::Unavailable(format!("{shown}: {problem}")),
        other => other,
    })
}

async fn open(url: &str, dialect: Dialect) -> Result<Connections, StoreError> {
    install_default_drivers();
    let failed = |e: sqlx::Error| StoreError::Unavailable(e.to_string());
    let write = connect(url, dialect, 1).await.map_err(failed)?;
    let mut connection = write.acquire().await.map_err(failed)?;
    migrate(&mut connection, dialect).await?;
    drop(connection);
    let read = connect(url, dialect, READERS).await.map_err(failed)?;
    Ok(Connections { read, write })
}

async fn connect(url: &str, dialect: Dialect, most: u32) -> Result<AnyPool, sqlx::Error> {
    AnyPoolOptions::new()
        .max_connections(most)
        .min_connections(1)
        .idle_timeout(None)
        .max_lifetime(None)
        .acquire_timeout(PATIENCE)
        .after_connect(move |connection, _| {
            Box::pin(async move {
                if dialect == Dialect::Sqlite {
                    // A commit is on disk when it returns: the log is synced with every transaction.
                    for pragma in [
                        "PRAGMA busy_timeout = 5000",
                        "PRAGMA journal_mode = WAL",
                        "PRAGMA synchronous = FULL",
                    ] {
                        connection.execute(pragma).await?;
                    }
                }
                Ok(())
            })
        })
        .connect(url)
        .await
}
