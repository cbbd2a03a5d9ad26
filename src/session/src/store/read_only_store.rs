//! A store that is only read: nothing is created or changed where it lies, whether or not a server writes it.
//! Operators use it to list and compare what is stored, and to read who did what.

use super::build_identity;
use super::connection::{DatabaseAddress, WritingConnection};
use super::database_store::Store;
use super::location::{FolderHold, StoreLocation, existing_database, make_private_file};
use super::objects::Objects;
use super::schema::{
    Dialect, TABLES, column, known_identity, known_version, migrate, signed, unreadable, unsigned, version,
};
use super::session_store::StoreError;
use super::sql_reading::SqlTables;
use crate::answers::Tenant;
use crate::audit::audit_entry::StoredAuditEntry;
use crate::surroundings::RealSurroundings;
use futures::TryStreamExt as _;
use pliant_wire::record::LoggedCommit;
use sqlx::AnyPool;
use std::collections::BTreeSet;
use std::fs::{File, Permissions};
use std::io;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a crash leaves beside a database of SQLite, which belongs to it.
const LOGS: [&str; 2] = ["-wal", "-journal"];

/// A database that is only read.
struct DatabaseToRead {
    pub pool: AnyPool,
    pub dialect: Dialect,
    /// Whether another process may be writing it.
    pub is_written: bool,
    /// Where it is.
    pub address: DatabaseAddress,
    hold: Option<FolderHold>,
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
            hold,
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

impl Store {
    /// Opens a store that is there, to be read alone.
    ///
    /// # Errors
    /// [`StoreError::Refused`] where there is no store, with what is missing; [`StoreError::Unavailable`] where it cannot be read.
    pub async fn open_to_read(location: &StoreLocation) -> Result<Self, StoreError> {
        let database = DatabaseToRead::open(location).await?;
        let objects = match (&location.objects, &location.data_dir) {
            (Some(url), _) => Objects::in_bucket(url)?,
            (None, Some(folder)) => Objects::in_folder_to_read(folder)?,
            (None, None) => return Err(StoreError::Refused("the place of the objects is not named".into())),
        };
        let failed = |e: sqlx::Error| StoreError::Unavailable(format!("{:?}: {e}", database.address));
        let identity = known_identity(&mut *database.pool.acquire().await.map_err(failed)?).await?;
        if let Some(identity) = identity {
            objects.agree_with(&identity).await?;
        }
        Ok(Self {
            build: location.build.clone().unwrap_or_else(build_identity),
            tables: Arc::new(SqlTables {
                pool: database.pool,
                dialect: database.dialect,
            }),
            objects: Arc::new(objects),
            writing: None,
            is_written: database.is_written,
            folder: location.data_dir.clone().filter(|_| location.database.is_none()),
            _hold: database.hold,
            faults: None,
            surroundings: Arc::new(RealSurroundings),
        })
    }

    /// Compares rows and objects of a session with their checksums; `None` where the session has gone meanwhile.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] with the first thing that does not fit. What is written meanwhile may not fit once.
    pub async fn check_session(&self, tenant: &Tenant, id: &str) -> Result<Option<CheckedSession>, StoreError> {
        let Some(session) = self.load(tenant, id).await? else {
            return Ok(None);
        };
        let mut names: BTreeSet<String> = session.model.files.objects().cloned().collect();
        for commit in &session.commits {
            if let LoggedCommit::Edit { files: Some(files), .. } = &commit.record {
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
            if !self.tables.is_used(&name, Some(id)).await? {
                let text = format!("object {name} is the session's, and is not noted as used");
                return Err(StoreError::Damaged(text));
            }
            checked.object_bytes += self.object(&name).await?.len() as u64;
        }
        Ok(Some(checked))
    }

    /// Compares the database with itself, where it can.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] with what it finds.
    pub async fn check_database(&self) -> Result<(), StoreError> {
        self.tables.check_integrity(self.folder.as_deref()).await
    }
}

/// Which entries are wanted.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct AuditFilter {
    /// Of this tenant alone.
    pub tenant: Option<String>,
    /// Of this session alone.
    pub session: Option<String>,
    /// From then on, in milliseconds since 1970.
    pub since_ms: u64,
}

/// Reads the trail of a store, oldest first, and gives each entry to `take` until that returns false. A process may be writing it
/// meanwhile.
///
/// # Errors
/// [`StoreError::Refused`] where there is no database, [`StoreError::Unavailable`] where it cannot be read, [`StoreError::Damaged`] for a row that cannot.
pub async fn read_audit(
    location: &StoreLocation,
    filter: &AuditFilter,
    mut take: impl FnMut(StoredAuditEntry) -> bool,
) -> Result<(), StoreError> {
    let database = DatabaseToRead::open(location).await?;
    let query = "SELECT at_ms, tenant, who, what, session FROM audit
        WHERE at_ms >= $1 AND ($2 = '' OR tenant = $2) AND ($3 = '' OR session = $3) ORDER BY id";
    let query = sqlx::query(query).bind(signed(filter.since_ms));
    let query = query.bind(filter.tenant.as_deref().unwrap_or_default());
    let mut rows = query
        .bind(filter.session.as_deref().unwrap_or_default())
        .fetch(&database.pool);
    while let Some(row) = rows.try_next().await.map_err(unreadable)? {
        let entry = StoredAuditEntry {
            at_ms: unsigned(column(&row, 0)?)?,
            tenant: column(&row, 1)?,
            caller: column(&row, 2)?,
            action: column(&row, 3)?,
            session: column(&row, 4)?,
        };
        if !take(entry) {
            break;
        }
    }
    Ok(())
}
