//! The connections to the database: where it is, and how they are made safe.

use super::schema::Dialect;
use super::session_store::StoreError;
use percent_encoding::{AsciiSet, CONTROLS, utf8_percent_encode};
use sqlx::any::{AnyPoolOptions, install_default_drivers};
use sqlx::{AnyConnection, AnyPool, AssertSqlSafe, Connection as _, Executor as _, Row as _};
use std::path::Path;
use std::time::{Duration, Instant};
use tokio::task::JoinHandle;

/// Connections that read.
const READERS: u32 = 4;
/// How long a call waits for a connection, and a new connection for the end of the one before.
const PATIENCE: Duration = Duration::from_secs(5);
/// A connection that was used so shortly ago is taken as alive.
const FRESH: Duration = Duration::from_millis(500);
/// How long a call waits for the connection that writes: as long as it may take to make one.
const FIRST_WAIT: Duration = Duration::from_secs(10);
/// How long the old one may hold the lock.
const LOCKED: Duration = Duration::from_secs(4);
/// How long a call waits once one call has waited in vain: the connection goes on being made meanwhile.
const IMPATIENCE: Duration = Duration::from_millis(500);
/// Between two tries to take the writer's lock.
const BETWEEN_TRIES: Duration = Duration::from_millis(50);

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

/// Where a database is.
#[derive(Clone)]
pub(super) struct DatabaseAddress {
    url: String,
    dialect: Dialect,
    /// For messages: without a password.
    shown: String,
    /// Which of several nodes connects; `None` where one process has the database for itself.
    shared_by: Option<SharingNode>,
}

/// A node as its connections know it.
#[derive(Debug, Clone, Copy)]
pub(super) struct SharingNode {
    /// A number that no other process has.
    pub key: i64,
    /// How long it may leave a transaction open and idle.
    pub patience: Duration,
}

impl std::fmt::Debug for DatabaseAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.shown)
    }
}

impl DatabaseAddress {
    /// An existing file of SQLite, to be read and written. If it has gone since, it is not created.
    pub fn file(file: &Path) -> Result<Self, StoreError> {
        Self::file_opened(file, "rw")
    }

    /// A file of SQLite that is there, to be read beside the process that writes it.
    pub fn file_to_read(file: &Path) -> Result<Self, StoreError> {
        Self::file_opened(file, "ro")
    }

    /// A file of SQLite that no process writes while it is read: no file is created beside it, and a log beside it is
    /// not read.
    pub fn file_at_rest(file: &Path) -> Result<Self, StoreError> {
        Self::file_opened(file, "ro&immutable=true")
    }

    fn file_opened(file: &Path, mode: &str) -> Result<Self, StoreError> {
        let shown = file.display().to_string();
        let text = file
            .to_str()
            .ok_or_else(|| StoreError::Refused(format!("{shown} is not a UTF-8 path")))?;
        Ok(Self {
            url: format!("sqlite://{}?mode={mode}", utf8_percent_encode(text, PATH)),
            dialect: Dialect::Sqlite,
            shown,
            shared_by: None,
        })
    }

    /// A server of PostgreSQL.
    pub fn server(url: &str) -> Result<Self, StoreError> {
        let is_postgres = ["postgres://", "postgresql://"].iter().any(|s| url.starts_with(s));
        if !is_postgres {
            let text = "the URL of the database is not known; allowed is postgres://USER:PASSWORD@HOST/DATABASE";
            return Err(StoreError::Refused(text.into()));
        }
        let shown = without_password(url);
        Ok(Self {
            url: url.to_owned(),
            dialect: Dialect::Postgres,
            shown,
            shared_by: None,
        })
    }

    /// The same, for one of several nodes.
    pub fn shared_by(mut self, node: SharingNode) -> Self {
        self.shared_by = Some(node);
        self
    }

    /// Which database it is.
    pub fn dialect(&self) -> Dialect {
        self.dialect
    }

    fn unavailable(&self, error: impl std::fmt::Display) -> StoreError {
        StoreError::Unavailable(format!("{}: {error}", self.shown))
    }

    /// Error: it is not a store.
    pub fn no_tables(&self) -> StoreError {
        StoreError::Refused(format!(
            "there is no store of sessions in {}: it has no tables of one",
            self.shown
        ))
    }

    /// Error: the objects belong to another.
    pub fn objects_of_another(&self) -> StoreError {
        StoreError::Refused(format!(
            "{} has no sessions, and the objects there belong to another database; restore that one, or name another place",
            self.shown
        ))
    }

    /// The connections that read. They stay open whatever happens to the one that writes, so that reading goes on.
    pub async fn readers(&self) -> Result<AnyPool, StoreError> {
        install_default_drivers();
        self.pool_of(READERS).await
    }

    /// The connection that renews a node's lease.
    pub async fn heartbeat_pool(&self) -> Result<AnyPool, StoreError> {
        install_default_drivers();
        self.pool_of(1).await
    }

    async fn pool_of(&self, connections: u32) -> Result<AnyPool, StoreError> {
        let (dialect, shared_by) = (self.dialect, self.shared_by);
        AnyPoolOptions::new()
            .max_connections(connections)
            .min_connections(1)
            .idle_timeout(None)
            .max_lifetime(None)
            .acquire_timeout(PATIENCE)
            .after_connect(move |connection, _| Box::pin(prepare(connection, dialect, shared_by)))
            .connect(&self.url)
            .await
            .map_err(|e| self.unavailable(e))
    }

    /// One connection that reads, beside another process.
    pub async fn reader(&self) -> Result<AnyPool, StoreError> {
        install_default_drivers();
        let options = AnyPoolOptions::new().max_connections(1).acquire_timeout(PATIENCE);
        // A copy that is read has no name any more.
        let options = options.min_connections(1).idle_timeout(None).max_lifetime(None);
        options.connect(&self.url).await.map_err(|e| self.unavailable(e))
    }

    /// Waits until no other node opens the store, and keeps others out until the connection is closed.
    pub async fn open_lock(&self) -> Result<AnyConnection, StoreError> {
        let mut connection = self.connect().await?;
        let wait = sqlx::query("SELECT pg_advisory_lock(1886153058, hashtext(current_schema()))");
        wait.execute(&mut connection).await.map_err(|e| self.unavailable(e))?;
        Ok(connection)
    }

    async fn connect(&self) -> Result<AnyConnection, StoreError> {
        install_default_drivers();
        let connected = async {
            let mut connection = AnyConnection::connect(&self.url).await?;
            prepare(&mut connection, self.dialect, self.shared_by).await?;
            Ok::<_, sqlx::Error>(connection)
        };
        match tokio::time::timeout(PATIENCE, connected).await {
            Ok(connected) => connected.map_err(|e| self.unavailable(e)),
            Err(_) => Err(self.unavailable(format!("no connection within {PATIENCE:?}"))),
        }
    }
}

/// A URL without its password.
fn without_password(url: &str) -> String {
    let (scheme, rest) = url.split_once("://").unwrap_or(("", url));
    let place = rest.split(['?', '#']).next().unwrap_or_default();
    let place = place.rsplit_once('@').map_or(place, |(_, host)| host);
    format!("{scheme}://{place}")
}

/// Makes a connection safe: what is committed through it is on disk when the commit returns.
async fn prepare(
    connection: &mut AnyConnection,
    dialect: Dialect,
    shared_by: Option<SharingNode>,
) -> Result<(), sqlx::Error> {
    let statements: &[&str] = match dialect {
        // The log is synced with every transaction.
        Dialect::Sqlite => &[
            "PRAGMA busy_timeout = 5000",
            "PRAGMA journal_mode = WAL",
            "PRAGMA synchronous = FULL",
        ],
        // A server may be set to acknowledge before it syncs, and to hold what a lost client left open.
        Dialect::Postgres => &[
            "SELECT set_config('synchronous_commit', 'on', false) WHERE current_setting('synchronous_commit') = 'off'",
            "SET statement_timeout = '10s'",
            "SET idle_in_transaction_session_timeout = '15s'",
        ],
    };
    for statement in statements {
        connection.execute(*statement).await?;
    }
    if let Some(node) = shared_by {
        // A node that is stopped in the middle of a transaction holds up who takes its sessions over for no longer.
        let patience = format!(
            "SET idle_in_transaction_session_timeout = {}",
            node.patience.as_millis().max(1)
        );
        connection.execute(AssertSqlSafe(patience)).await?;
    }
    Ok(())
}

/// The one connection that writes. It is made again when it was lost.
///
/// In a database of a server it holds a lock for as long as it lives, so that one process writes, and so that what a lost connection
/// had begun has ended before the next one begins.
#[derive(Debug)]
pub(super) struct WritingConnection {
    address: DatabaseAddress,
    open: Option<AnyConnection>,
    /// The next one, being made beside the calls.
    coming: Option<JoinHandle<Result<AnyConnection, LockedOut>>>,
    /// Whether the last call waited in vain.
    is_away: bool,
    used: Instant,
}

impl WritingConnection {
    /// Connects.
    pub async fn open(address: &DatabaseAddress) -> Result<Self, StoreError> {
        let mut made = Self {
            address: address.clone(),
            open: None,
            coming: None,
            is_away: false,
            used: Instant::now(),
        };
        match made.get().await {
            Ok(_) => Ok(made),
            Err(LockedOut::HeldByOther) => {
                Err(StoreError::Refused(format!("{address:?} is in use by another process")))
            }
            Err(LockedOut::Error(error)) => Err(error),
        }
    }

    /// Whether other nodes write the database too.
    pub fn is_shared(&self) -> bool {
        self.address.shared_by.is_some()
    }

    /// The connection, made again if it was lost.
    pub async fn get(&mut self) -> Result<&mut AnyConnection, LockedOut> {
        if self.used.elapsed() > FRESH
            && let Some(open) = &mut self.open
        {
            let answers = tokio::time::timeout(PATIENCE, open.ping()).await;
            if !matches!(answers, Ok(Ok(()))) {
                self.open = None;
            }
        }
        let connection = match self.open.take() {
            Some(open) => open,
            None => {
                let made = self.wait_for_next().await;
                self.is_away = made.is_err();
                made?
            }
        };
        self.used = Instant::now();
        Ok(self.open.insert(connection))
    }

    /// Waits for a new connection. One that is late goes on being made, for the calls that come after.
    async fn wait_for_next(&mut self) -> Result<AnyConnection, LockedOut> {
        let address = self.address.clone();
        let mut coming = (self.coming.take()).unwrap_or_else(|| tokio::spawn(connect_to_write(address)));
        let patience = if self.is_away { IMPATIENCE } else { FIRST_WAIT };
        match tokio::time::timeout(patience, &mut coming).await {
            Ok(Ok(made)) => made,
            Ok(Err(ended)) => Err(self.address.unavailable(ended).into()),
            Err(_) => {
                self.coming = Some(coming);
                Err(self.address.unavailable("it does not answer").into())
            }
        }
    }

    /// Puts what a file's log holds into the file and closes the connection. The last one to be closed removes the log.
    pub async fn finish(&mut self) {
        let Some(mut open) = self.open.take() else { return };
        let ended = async {
            if self.address.dialect == Dialect::Sqlite {
                open.execute("PRAGMA wal_checkpoint(TRUNCATE)").await?;
            }
            open.close().await
        };
        if let Ok(Err(error)) = tokio::time::timeout(PATIENCE, ended).await {
            tracing::warn!("the store of sessions was not closed as it should be: {error}");
        }
    }

    /// Gives the connection up: what state it is in is not known.
    pub async fn give_up(&mut self) {
        if let Some(lost) = self.open.take() {
            let _ = tokio::time::timeout(PATIENCE, lost.close_hard()).await;
        }
    }
}

/// Makes a connection that writes.
async fn connect_to_write(address: DatabaseAddress) -> Result<AnyConnection, LockedOut> {
    let mut connection = address.connect().await?;
    if address.dialect == Dialect::Postgres {
        lock(&address, &mut connection).await?;
    }
    Ok(connection)
}

/// Takes the lock of the writer once it is free.
async fn lock(address: &DatabaseAddress, connection: &mut AnyConnection) -> Result<(), LockedOut> {
    let until = Instant::now() + LOCKED;
    loop {
        // One lock for each schema of a database. Nodes share it, so that no process has the database for itself at the same time, and each
        // has one more for itself.
        let ask = match address.shared_by {
            None => sqlx::query("SELECT pg_try_advisory_lock(1886153057, hashtext(current_schema()))"),
            Some(node) => sqlx::query(
                "SELECT pg_try_advisory_lock_shared(1886153057, hashtext(current_schema())) AND pg_try_advisory_lock($1)",
            )
            .bind(node.key),
        };
        let row = ask.fetch_one(&mut *connection).await;
        let is_ours = row.and_then(|row| row.try_get::<bool, _>(0));
        if is_ours.map_err(|e| address.unavailable(e))? {
            return Ok(());
        }
        if Instant::now() > until {
            return Err(LockedOut::HeldByOther);
        }
        tokio::time::sleep(BETWEEN_TRIES).await;
    }
}

/// Whether no other node has the database open; none can open it then until [`release_exclusive`].
pub(super) async fn take_exclusive(connection: &mut AnyConnection) -> Result<bool, StoreError> {
    let ask = "SELECT pg_try_advisory_lock(1886153057, hashtext(current_schema()))";
    let row = sqlx::query(ask).fetch_one(connection).await;
    let is_alone = row.and_then(|row| row.try_get(0));
    is_alone.map_err(|e| StoreError::Unavailable(e.to_string()))
}

/// Ends what [`take_exclusive`] began.
pub(super) async fn release_exclusive(connection: &mut AnyConnection) -> Result<(), StoreError> {
    let unlock = "SELECT pg_advisory_unlock(1886153057, hashtext(current_schema()))";
    let done = sqlx::query(unlock).execute(connection).await;
    done.map(drop).map_err(|e| StoreError::Unavailable(e.to_string()))
}

/// Why there is no connection that writes.
#[derive(Debug, Clone)]
pub(super) enum LockedOut {
    /// Another process, or what is left of a lost connection, holds the lock.
    HeldByOther,
    Error(StoreError),
}

impl From<StoreError> for LockedOut {
    fn from(error: StoreError) -> Self {
        Self::Error(error)
    }
}

impl From<LockedOut> for StoreError {
    fn from(reason: LockedOut) -> Self {
        match reason {
            LockedOut::HeldByOther => Self::Unavailable("another process writes to the database".into()),
            LockedOut::Error(error) => error,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_password_is_shown_to_no_one() {
        for url in [
            "postgres://me:se/cret@db.example:5432/pliant",
            "postgresql://me:s@cret@db.example:5432/pliant?password=secret",
        ] {
            let shown = format!("{:?}", DatabaseAddress::server(url).expect("a URL"));
            assert!(!shown.contains("cret"), "{shown}");
            assert!(shown.ends_with("db.example:5432/pliant"), "{shown}");
        }
        assert!(DatabaseAddress::server("mysql://me:secret@db/pliant").is_err());
    }
}
