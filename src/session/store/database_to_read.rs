//! A database that is only read: nothing is created or changed where it lies, whether or not a server writes it.

use super::connection::{DatabaseAddress, WritingConnection};
use super::data_folder::{FolderHold, existing_database};
use super::private_files::make_private_file;
use super::schema::{Dialect, TABLES, known_version, migrate, version};
use super::session_store::StoreError;
use super::store_location::StoreLocation;
use sqlx::AnyPool;
use std::fs::{File, Permissions};
use std::io;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

/// What a crash leaves beside a database of SQLite, which belongs to it.
const LOGS: [&str; 2] = ["-wal", "-journal"];

/// A database that is only read.
#[derive(Debug)]
pub(super) struct DatabaseToRead {
    pub pool: AnyPool,
    pub dialect: Dialect,
    /// Whether another process may be writing it.
    pub is_written: bool,
    /// Where it is.
    pub address: DatabaseAddress,
    _hold: Option<FolderHold>,
}

impl DatabaseToRead {
    /// Opens a database.
    ///
    /// # Errors
    /// [`StoreError::Refused`] where there is none or its tables are not of this program's version, [`StoreError::Unavailable`] where
    /// it cannot be read.
    pub async fn open(location: &StoreLocation) -> Result<Self, StoreError> {
        match (&location.database, &location.data_dir) {
            (Some(url), _) => Self::written(DatabaseAddress::server(url)?).await,
            (None, Some(folder)) => Self::in_folder(folder).await,
            (None, None) => Err(StoreError::Refused(
                "neither a data folder nor a database is named".into(),
            )),
        }
    }

    async fn in_folder(folder: &Path) -> Result<Self, StoreError> {
        let file = existing_database(folder)?;
        let Some(hold) = FolderHold::with_others(folder)? else {
            return Self::written(DatabaseAddress::file_to_read(&file)?).await;
        };
        let has_log = |log: &str| log_of(&file, log).metadata().is_ok_and(|facts| facts.len() > 0);
        let found = Self::of(DatabaseAddress::file_at_rest(&file)?, Some(hold)).await?;
        // What is in a log counts, and reading it makes files beside it; tables of an older version are brought up to date: in a copy.
        if !LOGS.into_iter().any(has_log) && found.tables().await? == TABLES {
            return Ok(found);
        }
        found.copied(file).await
    }

    /// Opens one that another process may be writing.
    async fn written(address: DatabaseAddress) -> Result<Self, StoreError> {
        let found = Self {
            is_written: true,
            ..Self::of(address, None).await?
        };
        let version = found.tables().await?;
        match version == TABLES {
            true => Ok(found),
            false => Err(StoreError::Refused(format!(
                "{:?} has tables of version {version}, this program reads those of version {TABLES}; a server of this version brings them up to date",
                found.address
            ))),
        }
    }

    async fn of(address: DatabaseAddress, hold: Option<FolderHold>) -> Result<Self, StoreError> {
        Ok(Self {
            pool: address.reader().await?,
            dialect: address.dialect(),
            is_written: false,
            address,
            _hold: hold,
        })
    }

    async fn tables(&self) -> Result<usize, StoreError> {
        let failed = |e: sqlx::Error| StoreError::Unavailable(format!("{:?}: {e}", self.address));
        let mut connection = self.pool.acquire().await.map_err(failed)?;
        let found = version(&mut connection, self.dialect).await?;
        known_version(found.ok_or_else(|| self.address.no_tables())?)
    }

    /// The same, read from a copy in the folder for temporary files, which only its owner can read and whose name is taken away as
    /// soon as it is open.
    async fn copied(self, file: PathBuf) -> Result<Self, StoreError> {
        let owner_alone = Permissions::from_mode(0o700);
        let place = tempfile::Builder::new()
            .prefix("pliant-store-")
            .permissions(owner_alone)
            .tempdir();
        let failed = |e: io::Error| {
            StoreError::Unavailable(format!(
                "{:?} cannot be copied to {} to be read there: {e}",
                self.address,
                std::env::temp_dir().display()
            ))
        };
        let place = place.map_err(failed)?;
        let copy = place.path().join("copy");
        let (from, to) = (file, copy.clone());
        let done = tokio::task::spawn_blocking(move || copy_database(&from, &to));
        done.await
            .unwrap_or_else(|e| Err(io::Error::other(e)))
            .map_err(failed)?;
        let address = DatabaseAddress::file(&copy)?;
        let mut writing = WritingConnection::open(&address).await?;
        let connection = writing.get().await?;
        if version(connection, Dialect::Sqlite).await?.is_none() {
            return Err(self.address.no_tables());
        }
        migrate(connection, Dialect::Sqlite).await?;
        writing.finish().await;
        let pool = DatabaseAddress::file_at_rest(&copy)?.reader().await?;
        place.close().map_err(failed)?;
        Ok(Self { pool, ..self })
    }
}

fn log_of(file: &Path, log: &str) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(log);
    PathBuf::from(name)
}

fn copy_database(from: &Path, to: &Path) -> io::Result<()> {
    for log in ["", LOGS[0], LOGS[1]] {
        let mut source = match File::open(log_of(from, log)) {
            Ok(source) => source,
            Err(error) if error.kind() == io::ErrorKind::NotFound && !log.is_empty() => continue,
            Err(error) => return Err(error),
        };
        io::copy(&mut source, &mut make_private_file(&log_of(to, log))?)?;
    }
    Ok(())
}
