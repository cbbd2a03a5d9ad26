//! What is read from the database.

use super::schema::Dialect;
use super::schema::{COMMIT_COLUMNS, CommitRow, check_format, column, signed, unsigned};
use super::session_store::{Commit, ListedSession, LoggedKey, StoreError, StoredFacts, StoredSession, StoredSnapshot};
use super::write_order::session_checksum;
use crate::answers::Tenant;
use pliant_wire::record::RecordedModel;
use sqlx::any::AnyRow;
use sqlx::{AnyConnection, AnyPool, AssertSqlSafe};
use std::sync::Arc;
use std::time::Duration;

/// Sessions read at a time.
const PAGE: usize = 500;

const SESSION_COLUMNS: &str = "id, tenant, number, ttl_ms, used_ms, newest, format, model, checksum";

/// A row of the sessions.
struct SessionRow {
    id: String,
    tenant: String,
    number: i64,
    ttl_ms: i64,
    used_ms: i64,
    newest: i64,
    model: Vec<u8>,
}

impl SessionRow {
    fn read(row: &AnyRow) -> Result<Self, StoreError> {
        let read = Self {
            id: column(row, 0)?,
            tenant: column(row, 1)?,
            number: column(row, 2)?,
            ttl_ms: column(row, 3)?,
            used_ms: column(row, 4)?,
            newest: column(row, 5)?,
            model: column(row, 7)?,
        };
        check_format(column(row, 6)?)?;
        let expected: Vec<u8> = column(row, 8)?;
        if read.checksum() != expected {
            let text = "the session's row does not have the checksum that it was written with";
            return Err(StoreError::Damaged(text.into()));
        }
        Ok(read)
    }

    fn checksum(&self) -> Vec<u8> {
        session_checksum(&self.id, &self.tenant, &self.model, [self.number, self.ttl_ms])
    }

    fn model(&self) -> Result<RecordedModel, StoreError> {
        RecordedModel::read(&self.model)
            .map_err(|e| StoreError::Damaged(format!("how the model was opened cannot be read: {e}")))
    }
}

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

/// The row of a session; `None` when the tenant has none of that id.
async fn session_row(pool: &AnyPool, tenant: &str, id: &str) -> Result<Option<SessionRow>, StoreError> {
    let query = format!("SELECT {SESSION_COLUMNS} FROM sessions WHERE id = $1 AND tenant = $2");
    let found = sqlx::query(AssertSqlSafe(query))
        .bind(id)
        .bind(tenant)
        .fetch_optional(pool)
        .await;
    found.map_err(unreadable)?.as_ref().map(SessionRow::read).transpose()
}

/// Whether the tenant has a session of that id.
pub(super) async fn has_session(pool: &AnyPool, tenant: &str, id: &str) -> Result<bool, StoreError> {
    let query = sqlx::query("SELECT number FROM sessions WHERE id = $1 AND tenant = $2");
    let found = query.bind(id).bind(tenant).fetch_optional(pool).await;
    Ok(found.map_err(unreadable)?.is_some())
}

/// A session with all its commits.
pub(super) async fn whole_session(
    pool: &AnyPool,
    tenant: &Tenant,
    id: &str,
) -> Result<Option<StoredSession>, StoreError> {
    let Some(row) = session_row(pool, &tenant.0, id).await? else {
        return Ok(None);
    };
    let query = format!("SELECT {COMMIT_COLUMNS} FROM commits WHERE session = $1 ORDER BY sequence");
    let rows = sqlx::query(AssertSqlSafe(query))
        .bind(id)
        .fetch_all(pool)
        .await
        .map_err(unreadable)?;
    let commits: Vec<Commit> = (rows.iter())
        .map(|row| CommitRow::read(row)?.into_commit())
        .collect::<Result<_, _>>()?;
    let newest = unsigned(row.newest)?;
    let is_whole = commits.iter().map(|c| c.sequence).eq(0..=newest);
    if !is_whole {
        let text = format!(
            "{} commits are there, {} were written",
            commits.len(),
            newest.saturating_add(1)
        );
        return Err(StoreError::Damaged(text));
    }
    let query = sqlx::query("SELECT sequence, object FROM snapshots WHERE session = $1").bind(id);
    let snapshot = query.fetch_optional(pool).await.map_err(unreadable)?;
    let snapshot = snapshot.map(|row| {
        Ok::<_, StoreError>(StoredSnapshot {
            sequence: unsigned(column(&row, 0)?)?,
            object: column(&row, 1)?,
        })
    });
    Ok(Some(StoredSession {
        id: row.id.clone(),
        tenant: tenant.clone(),
        number: unsigned(row.number)?,
        created_ms: created_ms(pool, id).await?,
        ttl: Duration::from_millis(unsigned(row.ttl_ms)?),
        used_ms: unsigned(row.used_ms)?,
        model: row.model()?,
        commits,
        snapshot: snapshot.transpose()?,
    }))
}

/// When a session was opened: its first commit was made then, and is kept for as long as the session.
async fn created_ms(pool: &AnyPool, session: &str) -> Result<u64, StoreError> {
    let query = sqlx::query("SELECT at_ms FROM commits WHERE session = $1 AND sequence = 0").bind(session);
    match query.fetch_optional(pool).await.map_err(unreadable)? {
        Some(row) => unsigned(column(&row, 0)?),
        None => Err(StoreError::Damaged("commit 0 is missing".into())),
    }
}

/// The row of a commit.
pub(super) async fn commit_row(pool: &AnyPool, session: &str, sequence: u64) -> Result<Option<CommitRow>, StoreError> {
    let query = format!("SELECT {COMMIT_COLUMNS} FROM commits WHERE session = $1 AND sequence = $2");
    let found = sqlx::query(AssertSqlSafe(query)).bind(session).bind(signed(sequence));
    let found = found.fetch_optional(pool).await.map_err(unreadable)?;
    found.as_ref().map(CommitRow::read).transpose()
}

async fn one_commit(pool: &AnyPool, session: &str, sequence: u64) -> Result<Commit, StoreError> {
    match commit_row(pool, session, sequence).await? {
        Some(row) => row.into_commit(),
        None => Err(StoreError::Damaged(format!("commit {sequence} is missing"))),
    }
}

/// A page of a tenant's sessions. A damaged one has only its number: opening it fails.
pub(super) async fn listed(
    pool: &AnyPool,
    tenant: &str,
    after: u64,
    most: usize,
) -> Result<Vec<(u64, Option<ListedSession>)>, StoreError> {
    let query =
        format!("SELECT {SESSION_COLUMNS} FROM sessions WHERE tenant = $1 AND number > $2 ORDER BY number LIMIT $3");
    let query = sqlx::query(AssertSqlSafe(query)).bind(tenant).bind(signed(after));
    let rows = query
        .bind(signed(most as u64))
        .fetch_all(pool)
        .await
        .map_err(unreadable)?;
    let mut list = Vec::with_capacity(rows.len());
    for row in &rows {
        let number = unsigned(column(row, 2)?)?;
        match listed_session(pool, row).await {
            Ok(session) => list.push((number, Some(session))),
            Err(StoreError::Damaged(problem) | StoreError::Refused(problem)) => {
                list.push((number, None));
                let id: String = column(row, 0).unwrap_or_default();
                tracing::error!(
                    session.id = id,
                    "a stored session is damaged and is not listed: {problem}"
                );
            }
            Err(error) => return Err(error),
        }
    }
    Ok(list)
}

async fn listed_session(pool: &AnyPool, row: &AnyRow) -> Result<ListedSession, StoreError> {
    let row = SessionRow::read(row)?;
    let newest = one_commit(pool, &row.id, unsigned(row.newest)?).await?;
    let facts = one_commit(pool, &row.id, newest.facts_at).await?.record;
    let poses = one_commit(pool, &row.id, newest.poses_at).await?.record;
    Ok(ListedSession {
        created_ms: created_ms(pool, &row.id).await?,
        ttl: Duration::from_millis(unsigned(row.ttl_ms)?),
        used_ms: unsigned(row.used_ms)?,
        label: row.model()?.label,
        id: row.id,
        newest,
        facts,
        poses,
    })
}

/// The expired sessions, with their tenants; time counts from `since_ms` at the earliest.
pub(super) async fn expired(pool: &AnyPool, since_ms: u64, now_ms: u64) -> Result<Vec<(Tenant, String)>, StoreError> {
    let query =
        "SELECT tenant, id FROM sessions WHERE used_ms < $1 - ttl_ms AND ttl_ms < $1 - $2 ORDER BY number LIMIT 1000";
    let query = sqlx::query(query).bind(signed(now_ms)).bind(signed(since_ms));
    let rows = query.fetch_all(pool).await.map_err(unreadable)?;
    rows.iter()
        .map(|row| Ok((tenant_of(row, 0)?, column(row, 1)?)))
        .collect()
}

/// Whether a session is expired, as in [`expired`].
pub(super) async fn is_expired(pool: &AnyPool, id: &str, since_ms: u64, now_ms: u64) -> Result<bool, StoreError> {
    let query = "SELECT id FROM sessions WHERE id = $3 AND used_ms < $1 - ttl_ms AND ttl_ms < $1 - $2";
    let query = sqlx::query(query).bind(signed(now_ms)).bind(signed(since_ms));
    let found = query.bind(id).fetch_optional(pool).await.map_err(unreadable)?;
    Ok(found.is_some())
}

/// How many sessions a tenant has.
pub(super) async fn count_sessions(pool: &AnyPool, tenant: &str) -> Result<u64, StoreError> {
    let query = sqlx::query("SELECT COUNT(*) FROM sessions WHERE tenant = $1").bind(tenant);
    unsigned(column(&query.fetch_one(pool).await.map_err(unreadable)?, 0)?)
}

/// How many sessions each tenant has.
pub(super) async fn sessions_by_tenant(pool: &AnyPool) -> Result<Vec<(Tenant, u64)>, StoreError> {
    let query = sqlx::query("SELECT tenant, COUNT(*) FROM sessions GROUP BY tenant ORDER BY tenant");
    let rows = query.fetch_all(pool).await.map_err(unreadable)?;
    rows.iter()
        .map(|row| Ok((tenant_of(row, 0)?, unsigned(column(row, 1)?)?)))
        .collect()
}

/// Bytes of a tenant's records and objects.
pub(super) async fn stored_bytes(pool: &AnyPool, tenant: &str) -> Result<u64, StoreError> {
    let mut sum = 0u64;
    for query in [
        "SELECT CAST(COALESCE(SUM(record_bytes), 0) AS BIGINT) FROM sessions WHERE tenant = $1",
        "SELECT CAST(COALESCE(SUM(bytes), 0) AS BIGINT) FROM object_uses JOIN sessions ON id = session WHERE tenant = $1",
    ] {
        let row = sqlx::query(query)
            .bind(tenant)
            .fetch_one(pool)
            .await
            .map_err(unreadable)?;
        sum = sum.saturating_add(unsigned(column(&row, 0)?)?);
    }
    Ok(sum)
}

pub(super) fn tenant_of(row: &AnyRow, index: usize) -> Result<Tenant, StoreError> {
    let tenant: String = column(row, index)?;
    Ok(Tenant(Arc::from(tenant)))
}

/// Objects whose size an older version did not record.
pub(super) async fn unmeasured_objects(pool: &AnyPool) -> Result<Vec<String>, StoreError> {
    let query = sqlx::query("SELECT DISTINCT object FROM object_uses WHERE bytes < 0");
    let rows = query.fetch_all(pool).await.map_err(unreadable)?;
    rows.iter().map(|row| column(row, 0)).collect()
}

const KEY_COLUMNS: &str = "tenant, call_key, fingerprint, session, sequence, at_ms";

fn key_from_row(row: &AnyRow) -> Result<LoggedKey, StoreError> {
    let fingerprint: Vec<u8> = column(row, 2)?;
    let fingerprint = <[u8; 16]>::try_from(fingerprint.as_slice())
        .map_err(|_| StoreError::Damaged("an idempotency key has no fingerprint".into()))?;
    Ok(LoggedKey {
        tenant: tenant_of(row, 0)?,
        key: column(row, 1)?,
        fingerprint: u128::from_le_bytes(fingerprint),
        session: column(row, 3)?,
        sequence: unsigned(column(row, 4)?)?,
        at_ms: unsigned(column(row, 5)?)?,
    })
}

/// The keys that are kept.
pub(super) async fn keys(pool: &AnyPool) -> Result<Vec<LoggedKey>, StoreError> {
    let query = format!("SELECT {KEY_COLUMNS} FROM call_keys ORDER BY at_ms");
    let rows = sqlx::query(AssertSqlSafe(query))
        .fetch_all(pool)
        .await
        .map_err(unreadable)?;
    rows.iter().map(key_from_row).collect()
}

/// A key that is kept.
pub(super) async fn one_key(pool: &AnyPool, tenant: &str, key: &str) -> Result<Option<LoggedKey>, StoreError> {
    let query = format!("SELECT {KEY_COLUMNS} FROM call_keys WHERE tenant = $1 AND call_key = $2");
    let row = sqlx::query(AssertSqlSafe(query))
        .bind(tenant)
        .bind(key)
        .fetch_optional(pool)
        .await;
    row.map_err(unreadable)?.as_ref().map(key_from_row).transpose()
}

/// The highest number of any session; 0 without sessions.
pub(super) async fn highest_number(pool: &AnyPool) -> Result<u64, StoreError> {
    let query = sqlx::query("SELECT number FROM sessions ORDER BY number DESC LIMIT 1");
    let row = query.fetch_optional(pool).await.map_err(unreadable)?;
    row.map_or(Ok(0), |row| unsigned(column(&row, 0)?))
}

/// Whether any session uses an object.
pub(super) async fn is_used(pool: &AnyPool, object: &str) -> Result<bool, StoreError> {
    let mut connection = pool.acquire().await.map_err(unreadable)?;
    is_used_on(&mut connection, object).await
}

/// As [`is_used`], within a transaction.
pub(super) async fn is_used_on(connection: &mut AnyConnection, object: &str) -> Result<bool, StoreError> {
    let query = sqlx::query("SELECT session FROM object_uses WHERE object = $1 LIMIT 1");
    let found = query.bind(object).fetch_optional(connection).await;
    Ok(found.map_err(unreadable)?.is_some())
}

/// A page of the sessions of all tenants.
pub(super) async fn stored_facts(pool: &AnyPool, after: u64, most: usize) -> Result<Vec<StoredFacts>, StoreError> {
    let query = "SELECT number, id, tenant, used_ms, ttl_ms, (SELECT COUNT(*) FROM commits WHERE session = sessions.id)
        FROM sessions WHERE number > $1 ORDER BY number LIMIT $2";
    let query = sqlx::query(query).bind(signed(after)).bind(signed(most as u64));
    let rows = query.fetch_all(pool).await.map_err(unreadable)?;
    let facts = |row: &AnyRow| {
        Ok(StoredFacts {
            number: unsigned(column(row, 0)?)?,
            id: column(row, 1)?,
            tenant: tenant_of(row, 2)?,
            used_ms: unsigned(column(row, 3)?)?,
            ttl_ms: unsigned(column(row, 4)?)?,
            commits: unsigned(column(row, 5)?)?,
        })
    };
    rows.iter().map(facts).collect()
}

/// Whether a session uses an object.
pub(super) async fn uses(pool: &AnyPool, session: &str, object: &str) -> Result<bool, StoreError> {
    let query = sqlx::query("SELECT object FROM object_uses WHERE session = $1 AND object = $2");
    let found = query.bind(session).bind(object).fetch_optional(pool).await;
    Ok(found.map_err(unreadable)?.is_some())
}

/// All objects that sessions use.
pub(super) async fn used_objects(pool: &AnyPool) -> Result<Vec<String>, StoreError> {
    let query = sqlx::query("SELECT DISTINCT object FROM object_uses");
    let rows = query.fetch_all(pool).await.map_err(unreadable)?;
    rows.iter().map(|row| column(row, 0)).collect()
}

/// Compares a database with itself, where it can.
pub(super) async fn integrity(pool: &AnyPool, dialect: Dialect) -> Result<(), StoreError> {
    if dialect != Dialect::Sqlite {
        return Ok(());
    }
    let row = sqlx::query("PRAGMA integrity_check(1)").fetch_one(pool).await;
    let reported: String = column(&row.map_err(unreadable)?, 0)?;
    match reported == "ok" {
        true => Ok(()),
        false => Err(StoreError::Damaged(reported)),
    }
}

/// The sessions of all tenants, in the order of their creation.
pub(super) async fn all_sessions(pool: &AnyPool) -> Result<Vec<StoredFacts>, StoreError> {
    let mut all: Vec<StoredFacts> = Vec::new();
    loop {
        let after = all.last().map_or(0, |s| s.number);
        let page = stored_facts(pool, after, PAGE).await?;
        if page.is_empty() {
            return Ok(all);
        }
        all.extend(page);
    }
}

/// The tenants of whom anything is noted.
pub(super) async fn audited_tenants(pool: &AnyPool) -> Result<Vec<Tenant>, StoreError> {
    let query = sqlx::query("SELECT DISTINCT tenant FROM audit ORDER BY tenant");
    let rows = query.fetch_all(pool).await.map_err(unreadable)?;
    rows.iter().map(|row| tenant_of(row, 0)).collect()
}
