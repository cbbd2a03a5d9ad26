//! The places where sessions are kept, for tests that hold in all of them.

use super::bucket::TestBucket;
use super::postgres::{PostgresServer, TestDatabase};
use super::program::ServedProgram;
use sqlx::{AnyConnection, AssertSqlSafe, Connection as _, Row as _};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// What `pliant store` said.
pub struct StoreCommandRun {
    pub code: i32,
    pub out: String,
    pub err: String,
}

/// Where a test's sessions are kept.
pub struct StorePlace {
    top: TempDir,
    database: Option<TestDatabase>,
    bucket: Option<TestBucket>,
}

impl StorePlace {
    /// Everything in a folder, sessions in SQLite.
    pub async fn folder() -> Option<Self> {
        Some(Self {
            top: tempfile::tempdir().expect("a folder"),
            database: None,
            bucket: None,
        })
    }

    /// Sessions in PostgreSQL, objects in a folder.
    pub async fn postgres() -> Option<Self> {
        let database = PostgresServer::shared()?.database().await;
        Some(Self::in_database(database).await)
    }

    /// Sessions in a database, objects in a folder.
    pub async fn in_database(database: TestDatabase) -> Self {
        Self {
            top: tempfile::tempdir().expect("a folder"),
            database: Some(database),
            bucket: None,
        }
    }

    /// Sessions in a database, objects in a bucket.
    pub fn in_database_and(database: TestDatabase, bucket: TestBucket) -> Self {
        Self {
            top: tempfile::tempdir().expect("a folder"),
            database: Some(database),
            bucket: Some(bucket),
        }
    }

    /// Sessions in PostgreSQL, objects in a bucket of S3, and no folder at all.
    pub async fn remote() -> Option<Self> {
        Some(Self {
            bucket: Some(TestBucket::serve().await),
            ..Self::postgres().await?
        })
    }

    /// The data folder, where there is one.
    pub fn data(&self) -> PathBuf {
        self.top.path().join("data")
    }

    /// The bucket, where there is one.
    pub fn bucket(&self) -> Option<&TestBucket> {
        self.bucket.as_ref()
    }

    /// The server of databases, where there is one.
    pub fn database(&self) -> Option<&TestDatabase> {
        self.database.as_ref()
    }

    /// The same place, with the database behind another address.
    pub fn location(&self, database: Option<&str>) -> Vec<String> {
        let mut reply = Vec::new();
        let mut say = |flag: &str, value: &str| reply.extend([flag.to_owned(), value.to_owned()]);
        if let Some(url) = database {
            say("--database", url);
        }
        match &self.bucket {
            Some(bucket) => say("--objects", bucket.url()),
            None => say("--data-dir", self.data().to_str().expect("UTF-8")),
        }
        reply
    }

    /// Starts a server on it.
    pub fn start(&self, arguments: &[&str]) -> ServedProgram {
        self.try_start(arguments).expect("the server starts")
    }

    /// As `start`; the log when it does not come up.
    pub fn try_start(&self, arguments: &[&str]) -> Result<ServedProgram, String> {
        self.start_at(self.database.as_ref().map(|d| d.url.as_str()), arguments)
    }

    /// Asserts that no server starts on it, for a reason with these words in the last line of its log.
    #[track_caller]
    pub fn refuses_to_start(&self, arguments: &[&str], words: &[&str]) {
        let log = self.try_start(arguments).err().expect("refused");
        let last = log.lines().last().unwrap_or_default();
        assert!(words.iter().all(|word| last.contains(word)), "{words:?}: {log}");
    }

    /// As `start`, with the database behind another address.
    pub fn start_at(&self, database: Option<&str>, arguments: &[&str]) -> Result<ServedProgram, String> {
        self.start_logged("log", database, arguments)
    }

    /// As `start_at`, with a log of that name.
    pub fn start_logged(&self, log: &str, database: Option<&str>, arguments: &[&str]) -> Result<ServedProgram, String> {
        let reply = self.location(database);
        let arguments: Vec<&str> = reply
            .iter()
            .map(String::as_str)
            .chain(arguments.iter().copied())
            .collect();
        let variables = self.bucket.as_ref().map(TestBucket::variables).unwrap_or_default();
        let variables: Vec<(&str, &str)> = variables.iter().map(|(name, value)| (*name, value.as_str())).collect();
        ServedProgram::start_anywhere(self.top.path().join(log), &arguments, &variables)
    }

    /// The folder above all that the test writes.
    pub fn top(&self) -> &Path {
        self.top.path()
    }

    /// Runs `pliant store` on it: a command and its arguments.
    pub fn store(&self, arguments: &[&str]) -> StoreCommandRun {
        let variables = self.bucket.as_ref().map(TestBucket::variables).unwrap_or_default();
        let temporary = self.top().join("temporary");
        fs::create_dir_all(&temporary).expect("a folder");
        let run = Command::new(env!("CARGO_BIN_EXE_pliant"))
            .arg("store")
            .args(arguments)
            .args(self.location(self.database.as_ref().map(|d| d.url.as_str())))
            .envs(variables)
            .env_remove("PLIANT_CONFIG")
            .env("TMPDIR", &temporary)
            .output()
            .expect("the program runs");
        let left: Vec<_> = fs::read_dir(&temporary).expect("a folder").flatten().collect();
        assert!(left.is_empty(), "{arguments:?} left {left:?}");
        StoreCommandRun {
            code: run.status.code().expect("it ends by itself"),
            out: String::from_utf8(run.stdout).expect("UTF-8"),
            err: String::from_utf8(run.stderr).expect("UTF-8"),
        }
    }

    /// Changes the database of a server that is not running.
    pub async fn tamper(&self, statement: &str) {
        tamper_at(&self.database_url(), statement).await;
    }

    /// Sends the database a statement that changes no rows.
    pub async fn ask(&self, statement: &str) {
        sqlx::any::install_default_drivers();
        let mut connection = AnyConnection::connect(&self.database_url()).await.expect("a database");
        let done = sqlx::query(AssertSqlSafe(statement)).execute(&mut connection).await;
        done.expect("a statement");
        connection.close().await.expect("closed");
    }

    /// How many rows a table has.
    pub async fn count(&self, table: &str) -> i64 {
        self.number(&format!("SELECT COUNT(*) FROM {table}")).await
    }

    /// A number that a query asks for.
    pub async fn number(&self, query: &str) -> i64 {
        sqlx::any::install_default_drivers();
        let mut connection = AnyConnection::connect(&self.database_url()).await.expect("a database");
        let row = sqlx::query(AssertSqlSafe(query))
            .fetch_one(&mut connection)
            .await
            .expect("a count");
        connection.close().await.expect("closed");
        row.get(0)
    }

    fn database_url(&self) -> String {
        match &self.database {
            Some(database) => database.url.clone(),
            None => sqlite_url(&self.data()),
        }
    }

    /// The files of the objects.
    pub fn objects(&self) -> Vec<PathBuf> {
        let top = self
            .bucket
            .as_ref()
            .map_or_else(|| self.data().join("objects"), TestBucket::files);
        let mut found = Vec::new();
        for shelf in fs::read_dir(top).into_iter().flatten().flatten() {
            let files = fs::read_dir(shelf.path()).into_iter().flatten().flatten();
            found.extend(files.map(|f| f.path()));
        }
        found.retain(|f| f.file_name().is_some_and(|name| name.len() == 64));
        found
    }
}

/// Changes a database of SQLite.
pub async fn tamper(folder: &Path, statement: &str) {
    tamper_at(&sqlite_url(folder), statement).await;
}

fn sqlite_url(folder: &Path) -> String {
    format!("sqlite://{}", folder.join("sessions.sqlite").display())
}

async fn tamper_at(url: &str, statement: &str) {
    sqlx::any::install_default_drivers();
    let mut connection = AnyConnection::connect(url).await.expect("a database");
    let done = sqlx::query(AssertSqlSafe(statement))
        .execute(&mut connection)
        .await
        .expect("a statement");
    let changes_rows = !statement.starts_with("VACUUM");
    assert!(done.rows_affected() > 0 || !changes_rows, "{statement}");
    connection.close().await.expect("closed");
}

/// One test for each place where sessions are kept.
macro_rules! in_every_store {
    ($($law:ident),+ $(,)?) => {$(
        mod $law {
            use crate::support::place::StorePlace;

            #[tokio::test(flavor = "multi_thread")]
            async fn sqlite() {
                if let Some(place) = StorePlace::folder().await {
                    super::$law(place).await;
                }
            }

            #[tokio::test(flavor = "multi_thread")]
            async fn postgres() {
                if let Some(place) = StorePlace::postgres().await {
                    super::$law(place).await;
                }
            }

            #[tokio::test(flavor = "multi_thread")]
            async fn postgres_and_s3() {
                if let Some(place) = StorePlace::remote().await {
                    super::$law(place).await;
                }
            }
        }
    )+};
}
pub(crate) use in_every_store;
