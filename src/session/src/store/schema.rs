//! The tables, and how an older database becomes a newer one.
//!
//! Rows with their checksums.

use super::session_store::{Commit, StoreError};
use pliant_wire::record::LoggedCommit;
use sqlx::any::{AnyArguments, AnyRow};
use sqlx::query::Query;
use sqlx::{AnyConnection, AssertSqlSafe, Row as _};
use xxhash_rust::xxh3::Xxh3;

/// The supported databases.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dialect {
    Sqlite,
    Postgres,
}

/// Steps from each version of the tables to the next. What was released is never changed, only followed by a further step.
/// `{bytes}` and `{serial}` are what the database calls bytes and numbers that count by themselves.
const STEPS: [&[&str]; 5] = [FIRST, MEASURED, IDENTIFIED, AUDITED, SHARED];

const FIRST: &[&str] = &[
    "CREATE TABLE tenants (tenant TEXT PRIMARY KEY, created_ms BIGINT NOT NULL)",
    "CREATE TABLE sessions (
        id TEXT PRIMARY KEY,
        tenant TEXT NOT NULL,
        number BIGINT NOT NULL UNIQUE,
        ttl_ms BIGINT NOT NULL,
        used_ms BIGINT NOT NULL,
        newest BIGINT NOT NULL,
        format BIGINT NOT NULL,
        model {bytes} NOT NULL,
        checksum {bytes} NOT NULL
    )",
    "CREATE INDEX sessions_of_tenant ON sessions (tenant, number)",
    "CREATE TABLE commits (
        session TEXT NOT NULL,
        sequence BIGINT NOT NULL,
        revision BIGINT NOT NULL,
        kind TEXT NOT NULL,
        digest TEXT NOT NULL,
        build TEXT NOT NULL,
        facts_at BIGINT NOT NULL,
        poses_at BIGINT NOT NULL,
        at_ms BIGINT NOT NULL,
        format BIGINT NOT NULL,
        payload {bytes} NOT NULL,
        checksum {bytes} NOT NULL,
        PRIMARY KEY (session, sequence)
    )",
    "CREATE TABLE snapshots (session TEXT PRIMARY KEY, sequence BIGINT NOT NULL, object TEXT NOT NULL)",
    "CREATE TABLE call_keys (
        tenant TEXT NOT NULL,
        call_key TEXT NOT NULL,
        fingerprint {bytes} NOT NULL,
        session TEXT NOT NULL,
        sequence BIGINT NOT NULL,
        at_ms BIGINT NOT NULL,
        PRIMARY KEY (tenant, call_key)
    )",
    "CREATE INDEX call_keys_of_session ON call_keys (session)",
    "CREATE TABLE object_uses (
        session TEXT NOT NULL,
        object TEXT NOT NULL,
        PRIMARY KEY (session, object)
    )",
    "CREATE INDEX uses_of_object ON object_uses (object)",
    "CREATE TABLE audit (
        id {serial},
        tenant TEXT NOT NULL,
        at_ms BIGINT NOT NULL,
        who TEXT NOT NULL,
        what TEXT NOT NULL,
        session TEXT NOT NULL
    )",
];

/// Counts the bytes of sessions. Objects of unknown size have -1 until the store is opened.
const MEASURED: &[&str] = &[
    "ALTER TABLE sessions ADD COLUMN record_bytes BIGINT NOT NULL DEFAULT 0",
    "UPDATE sessions SET record_bytes = LENGTH(model)
        + (SELECT COALESCE(SUM(LENGTH(payload)), 0) FROM commits WHERE session = sessions.id)",
    "CREATE INDEX record_bytes_of_tenant ON sessions (tenant, record_bytes)",
    "ALTER TABLE object_uses ADD COLUMN bytes BIGINT NOT NULL DEFAULT -1",
];

/// The identity of this database.
const IDENTIFIED: &[&str] = &["CREATE TABLE store_identity (id TEXT PRIMARY KEY)"];

/// An audit entry has the number of its commit, or -1, so that a refused commit removes its entry.
const AUDITED: &[&str] = &[
    "ALTER TABLE audit ADD COLUMN sequence BIGINT NOT NULL DEFAULT -1",
    "CREATE INDEX audit_of_tenant ON audit (tenant, at_ms)",
    "CREATE INDEX audit_of_session ON audit (session)",
];

/// Several nodes may share the store: who has a session, the nodes and their leases, numbers for new sessions, and objects without a name.
const SHARED: &[&str] = &[
    "ALTER TABLE sessions ADD COLUMN owner TEXT NOT NULL DEFAULT ''",
    "ALTER TABLE sessions ADD COLUMN generation BIGINT NOT NULL DEFAULT 0",
    "CREATE INDEX sessions_of_owner ON sessions (owner) WHERE owner <> ''",
    "CREATE TABLE nodes (
        node TEXT PRIMARY KEY,
        name TEXT NOT NULL,
        address TEXT NOT NULL,
        leaving BIGINT NOT NULL,
        lapses BIGINT NOT NULL,
        lease_until_ms BIGINT NOT NULL,
        sessions BIGINT NOT NULL,
        most_sessions BIGINT NOT NULL,
        memory_used BIGINT NOT NULL,
        memory_total BIGINT NOT NULL,
        work BIGINT NOT NULL
    )",
    "CREATE TABLE session_numbers (newest BIGINT NOT NULL)",
    "INSERT INTO session_numbers (newest) VALUES (0)",
    "CREATE TABLE loose_objects (object TEXT PRIMARY KEY, since_ms BIGINT NOT NULL)",
];

/// The expression for milliseconds since 1970 by the clock of PostgreSQL.
pub(super) const DATABASE_NOW: &str = "CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000 AS BIGINT)";

/// The version of the tables that this program writes.
pub(super) const TABLES: usize = STEPS.len();

/// The version of the tables of a database; `None` where there are none. Nothing is made.
pub(super) async fn version(connection: &mut AnyConnection, dialect: Dialect) -> Result<Option<i64>, StoreError> {
    let failed = |e: sqlx::Error| StoreError::Unavailable(format!("the tables cannot be read: {e}"));
    let find = match dialect {
        Dialect::Sqlite => "SELECT COUNT(*) FROM sqlite_master WHERE name = 'pliant_schema'",
        Dialect::Postgres => {
            "SELECT COUNT(*) FROM pg_tables WHERE tablename = 'pliant_schema' AND schemaname = current_schema()"
        }
    };
    let found = sqlx::query(find).fetch_one(&mut *connection).await.map_err(failed)?;
    if found.try_get::<i64, _>(0).map_err(failed)? == 0 {
        return Ok(None);
    }
    let row = sqlx::query("SELECT version FROM pliant_schema")
        .fetch_optional(connection)
        .await;
    let version = row.map_err(failed)?.map(|row| row.try_get(0));
    version.transpose().map_err(failed)
}

/// Refuses tables of a later version.
pub(super) fn known_version(version: i64) -> Result<usize, StoreError> {
    usize::try_from(version).ok().filter(|n| *n <= TABLES).ok_or_else(|| {
        StoreError::Refused(format!(
            "the database has tables of version {version}, this program knows versions up to {TABLES}; use the program that wrote it"
        ))
    })
}

/// Brings the tables to the version of this program.
pub(super) async fn migrate(connection: &mut AnyConnection, dialect: Dialect) -> Result<(), StoreError> {
    let failed = |e: sqlx::Error| StoreError::Unavailable(format!("the tables cannot be made: {e}"));
    let make = "CREATE TABLE IF NOT EXISTS pliant_schema (version BIGINT NOT NULL)";
    sqlx::query(make).execute(&mut *connection).await.map_err(failed)?;
    let row = sqlx::query("SELECT version FROM pliant_schema")
        .fetch_optional(&mut *connection)
        .await
        .map_err(failed)?;
    let version = match &row {
        Some(row) => row.try_get::<i64, _>(0).map_err(failed)?,
        None => 0,
    };
    let done = known_version(version)?;
    if done == STEPS.len() {
        return Ok(());
    }
    let mut steps = sqlx::Connection::begin(connection).await.map_err(failed)?;
    for statement in STEPS[done..].iter().copied().flatten() {
        let (bytes, serial) = match dialect {
            Dialect::Sqlite => ("BLOB", "INTEGER PRIMARY KEY"),
            Dialect::Postgres => ("BYTEA", "BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY"),
        };
        let statement = statement.replace("{bytes}", bytes).replace("{serial}", serial);
        sqlx::query(AssertSqlSafe(statement))
            .execute(&mut *steps)
            .await
            .map_err(failed)?;
    }
    let note = match row {
        Some(_) => "UPDATE pliant_schema SET version = $1",
        None => "INSERT INTO pliant_schema (version) VALUES ($1)",
    };
    let note = sqlx::query(note).bind(STEPS.len() as i64);
    note.execute(&mut *steps).await.map_err(failed)?;
    steps.commit().await.map_err(failed)
}

/// The identity of this database, if it has one yet.
pub(super) async fn known_identity(connection: &mut AnyConnection) -> Result<Option<String>, StoreError> {
    let failed = |e: sqlx::Error| StoreError::Unavailable(e.to_string());
    let row = sqlx::query("SELECT id FROM store_identity")
        .fetch_optional(connection)
        .await;
    row.map_err(failed)?
        .map(|row| row.try_get(0))
        .transpose()
        .map_err(failed)
}

/// An object that a session uses; `None` where no session uses any.
pub(super) async fn any_object(connection: &mut AnyConnection) -> Result<Option<String>, StoreError> {
    let failed = |e: sqlx::Error| StoreError::Unavailable(e.to_string());
    let row = sqlx::query("SELECT object FROM object_uses LIMIT 1")
        .fetch_optional(connection)
        .await;
    row.map_err(failed)?
        .map(|row| row.try_get(0))
        .transpose()
        .map_err(failed)
}

/// The identity of this database, created on first use.
pub(super) async fn identity(connection: &mut AnyConnection) -> Result<String, StoreError> {
    let failed = |e: sqlx::Error| StoreError::Unavailable(e.to_string());
    if let Some(known) = known_identity(connection).await? {
        return Ok(known);
    }
    let mut random = [0u8; 16];
    getrandom::fill(&mut random).map_err(|e| StoreError::Unavailable(format!("no random numbers: {e}")))?;
    let id = random.map(|byte| format!("{byte:02x}")).concat();
    let insert = sqlx::query("INSERT INTO store_identity (id) VALUES ($1)").bind(&id);
    insert.execute(connection).await.map_err(failed)?;
    Ok(id)
}

/// The version of the records that this program writes; it reads this one and all before.
pub(super) const RECORD_FORMAT: i64 = 1;

/// The columns of a commit, as [`read_commit`] expects them.
pub(super) const COMMIT_COLUMNS: &str =
    "session, sequence, revision, kind, digest, build, facts_at, poses_at, format, payload, checksum";

/// The checksum of a commit's row, whose record is `payload`.
pub(super) fn commit_checksum(session: &str, kind: &str, commit: &Commit, payload: &[u8]) -> Vec<u8> {
    let Commit { digest, build, .. } = commit;
    let [session, kind, digest, build] = [session, kind, digest, build].map(str::as_bytes);
    let numbers = [commit.sequence, commit.revision, commit.facts_at, commit.poses_at].map(signed);
    let [sequence, revision, facts_at, poses_at] = numbers;
    checksum(
        &[session, kind, digest, build, payload],
        &[sequence, revision, facts_at, poses_at, RECORD_FORMAT],
    )
}

/// Reads a commit from the columns of [`COMMIT_COLUMNS`]; with the bytes of its record.
pub(super) fn read_commit(row: &AnyRow) -> Result<(Commit, Vec<u8>), StoreError> {
    check_format(column(row, 8)?)?;
    let (session, kind): (String, String) = (column(row, 0)?, column(row, 3)?);
    let payload: Vec<u8> = column(row, 9)?;
    let number = |index| unsigned(column(row, index)?);
    let mut commit = Commit {
        sequence: number(1)?,
        revision: number(2)?,
        digest: column(row, 4)?,
        build: column(row, 5)?,
        facts_at: number(6)?,
        poses_at: number(7)?,
        record: LoggedCommit::default(),
    };
    let sequence = commit.sequence;
    if commit_checksum(&session, &kind, &commit, &payload) != column::<Vec<u8>>(row, 10)? {
        let text = format!("commit {sequence} does not have the checksum that it was written with");
        return Err(StoreError::Damaged(text));
    }
    let unread = |e| StoreError::Damaged(format!("commit {sequence} cannot be read: {e}"));
    commit.record = LoggedCommit::read(&payload).map_err(unread)?;
    Ok((commit, payload))
}

/// Refuses records of a later version.
pub(super) fn check_format(format: i64) -> Result<(), StoreError> {
    if (1..=RECORD_FORMAT).contains(&format) {
        return Ok(());
    }
    Err(StoreError::Refused(format!(
        "the session was written in format {format}, this program reads formats up to {RECORD_FORMAT}"
    )))
}

/// The checksum of a row.
pub(super) fn checksum(parts: &[&[u8]], numbers: &[i64]) -> Vec<u8> {
    let mut hasher = Xxh3::new();
    for part in parts {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    numbers.iter().for_each(|n| hasher.update(&n.to_le_bytes()));
    hasher.digest128().to_le_bytes().to_vec()
}

/// A column's value; another type than was written is damage.
pub(super) fn column<'r, T>(row: &'r AnyRow, index: usize) -> Result<T, StoreError>
where
    T: sqlx::Decode<'r, sqlx::Any> + sqlx::Type<sqlx::Any>,
{
    row.try_get(index)
        .map_err(|e| StoreError::Damaged(format!("a row cannot be read: {e}")))
}

/// A query of the database.
pub(super) type Statement<'q> = Query<'q, sqlx::Any, AnyArguments>;

/// Why the database could not be read.
pub(super) fn unreadable(error: sqlx::Error) -> StoreError {
    match error {
        // What the database says of it is the operator's alone.
        sqlx::Error::ColumnDecode { .. } | sqlx::Error::Decode(_) => {
            tracing::error!("the store of sessions: {error}");
            StoreError::Damaged("a row cannot be read".into())
        }
        error if error.to_string().contains("malformed") => {
            tracing::error!("the store of sessions: {error}");
            StoreError::Damaged("the database file is damaged".into())
        }
        error => StoreError::Unavailable(error.to_string()),
    }
}

/// A number as databases hold it. Those of sessions never come near the limit.
pub(super) fn signed(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

/// A number that a database held.
pub(super) fn unsigned(number: i64) -> Result<u64, StoreError> {
    u64::try_from(number).map_err(|_| StoreError::Damaged(format!("a row holds the number {number}")))
}
