//! What is read from a database of SQL.

use super::database::SessionTables;
use super::newest_write::find_lost_writes;
use super::schema::{
    COMMIT_COLUMNS, Dialect, Statement, check_format, column, read_commit, signed, unreadable, unsigned,
};
use super::session_store::{
    Commit, ListedSession, LoggedKey, SessionRecord, StoreError, StoredFacts, StoredSession, StoredSnapshot,
};
use super::write_order::session_checksum;
use crate::answers::Tenant;
use async_trait::async_trait;
use pliant_wire::record::RecordedModel;
use sqlx::any::AnyRow;
use sqlx::{AnyPool, AssertSqlSafe};
use std::path::Path;
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

    /// Which session it is; when it was opened its first commit says.
    fn record(&self, label: String, created_ms: u64) -> Result<SessionRecord, StoreError> {
        Ok(SessionRecord {
            id: self.id.clone(),
            tenant: Tenant(Arc::from(self.tenant.as_str())),
            number: unsigned(self.number)?,
            label,
            created_ms,
            ttl: Duration::from_millis(unsigned(self.ttl_ms)?),
        })
    }

    fn model(&self) -> Result<RecordedModel, StoreError> {
        RecordedModel::read(&self.model)
            .map_err(|e| StoreError::Damaged(format!("how the model was opened cannot be read: {e}")))
    }
}

fn tenant_of(row: &AnyRow, index: usize) -> Result<Tenant, StoreError> {
    let tenant: String = column(row, index)?;
    Ok(Tenant(Arc::from(tenant)))
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

/// A database of SQL.
#[derive(Debug)]
pub(super) struct SqlTables {
    pub pool: AnyPool,
    pub dialect: Dialect,
}

impl SqlTables {
    async fn rows(&self, query: Statement<'_>) -> Result<Vec<AnyRow>, StoreError> {
        query.fetch_all(&self.pool).await.map_err(unreadable)
    }

    async fn row(&self, query: Statement<'_>) -> Result<Option<AnyRow>, StoreError> {
        query.fetch_optional(&self.pool).await.map_err(unreadable)
    }

    /// When a session was opened: its first commit was made then, and is kept for as long as the session.
    async fn created_ms(&self, session: &str) -> Result<u64, StoreError> {
        let query = sqlx::query("SELECT at_ms FROM commits WHERE session = $1 AND sequence = 0").bind(session);
        match self.row(query).await? {
            Some(row) => unsigned(column(&row, 0)?),
            None => Err(StoreError::Damaged("commit 0 is missing".into())),
        }
    }

    async fn one_commit(&self, session: &str, sequence: u64) -> Result<Commit, StoreError> {
        let missing = || StoreError::Damaged(format!("commit {sequence} is missing"));
        let found = self.commit(session, sequence).await?;
        found.map(|(commit, _)| commit).ok_or_else(missing)
    }

    /// The number in the one row of a query; 0 without a row.
    async fn number(&self, query: Statement<'_>) -> Result<u64, StoreError> {
        let row = self.row(query).await?;
        row.map_or(Ok(0), |row| unsigned(column(&row, 0)?))
    }

    async fn listed_session(&self, row: &AnyRow) -> Result<ListedSession, StoreError> {
        let row = SessionRow::read(row)?;
        let newest = self.one_commit(&row.id, unsigned(row.newest)?).await?;
        let facts = self.one_commit(&row.id, newest.facts_at).await?.record;
        let poses = self.one_commit(&row.id, newest.poses_at).await?.record;
        Ok(ListedSession {
            record: row.record(row.model()?.label, self.created_ms(&row.id).await?)?,
            used_ms: unsigned(row.used_ms)?,
            newest,
            facts,
            poses,
        })
    }
}

#[async_trait]
impl SessionTables for SqlTables {
    async fn session(&self, tenant: &Tenant, id: &str) -> Result<Option<StoredSession>, StoreError> {
        let query = format!("SELECT {SESSION_COLUMNS} FROM sessions WHERE id = $1 AND tenant = $2");
        let query = sqlx::query(AssertSqlSafe(query)).bind(id).bind(&*tenant.0);
        let Some(row) = self.row(query).await? else {
            return Ok(None);
        };
        let row = SessionRow::read(&row)?;
        let query = format!("SELECT {COMMIT_COLUMNS} FROM commits WHERE session = $1 ORDER BY sequence");
        let rows = self.rows(sqlx::query(AssertSqlSafe(query)).bind(id)).await?;
        let commits: Vec<Commit> = (rows.iter())
            .map(|row| read_commit(row).map(|(commit, _)| commit))
            .collect::<Result<_, _>>()?;
        let newest = unsigned(row.newest)?;
        if !commits.iter().map(|c| c.sequence).eq(0..=newest) {
            let text = format!(
                "{} commits are there, {} were written",
                commits.len(),
                newest.saturating_add(1)
            );
            return Err(StoreError::Damaged(text));
        }
        let query = sqlx::query("SELECT sequence, object FROM snapshots WHERE session = $1").bind(id);
        let snapshot = self.row(query).await?.map(|row| {
            Ok::<_, StoreError>(StoredSnapshot {
                sequence: unsigned(column(&row, 0)?)?,
                object: column(&row, 1)?,
            })
        });
        let model = row.model()?;
        Ok(Some(StoredSession {
            record: row.record(model.label.clone(), self.created_ms(id).await?)?,
            used_ms: unsigned(row.used_ms)?,
            model,
            commits,
            snapshot: snapshot.transpose()?,
        }))
    }

    async fn commit(&self, session: &str, sequence: u64) -> Result<Option<(Commit, Vec<u8>)>, StoreError> {
        let query = format!("SELECT {COMMIT_COLUMNS} FROM commits WHERE session = $1 AND sequence = $2");
        let query = sqlx::query(AssertSqlSafe(query)).bind(session).bind(signed(sequence));
        self.row(query).await?.as_ref().map(read_commit).transpose()
    }

    async fn holds(&self, tenant: &Tenant, id: &str) -> Result<bool, StoreError> {
        let query = sqlx::query("SELECT number FROM sessions WHERE id = $1 AND tenant = $2");
        Ok(self.row(query.bind(id).bind(&*tenant.0)).await?.is_some())
    }

    async fn list(
        &self,
        tenant: &Tenant,
        after: u64,
        most: usize,
    ) -> Result<Vec<(u64, Option<ListedSession>)>, StoreError> {
        let query = format!(
            "SELECT {SESSION_COLUMNS} FROM sessions WHERE tenant = $1 AND number > $2 ORDER BY number LIMIT $3"
        );
        let query = sqlx::query(AssertSqlSafe(query)).bind(&*tenant.0).bind(signed(after));
        let rows = self.rows(query.bind(signed(most as u64))).await?;
        let mut list = Vec::with_capacity(rows.len());
        for row in &rows {
            let number = unsigned(column(row, 2)?)?;
            let listed = match self.listed_session(row).await {
                Ok(session) => Some(session),
                Err(StoreError::Damaged(problem) | StoreError::Refused(problem)) => {
                    let id: String = column(row, 0).unwrap_or_default();
                    tracing::error!(
                        session.id = id,
                        "a stored session is damaged and is not listed: {problem}"
                    );
                    None
                }
                Err(error) => return Err(error),
            };
            list.push((number, listed));
        }
        Ok(list)
    }

    async fn expired(&self, since_ms: u64, now_ms: u64) -> Result<Vec<(Tenant, String)>, StoreError> {
        let query = "SELECT tenant, id FROM sessions WHERE used_ms < $1 - ttl_ms AND ttl_ms < $1 - $2 ORDER BY number LIMIT 1000";
        let query = sqlx::query(query).bind(signed(now_ms)).bind(signed(since_ms));
        let rows = self.rows(query).await?;
        rows.iter()
            .map(|row| Ok((tenant_of(row, 0)?, column(row, 1)?)))
            .collect()
    }

    async fn count_sessions(&self, tenant: &Tenant) -> Result<u64, StoreError> {
        let query = sqlx::query("SELECT COUNT(*) FROM sessions WHERE tenant = $1").bind(&*tenant.0);
        self.number(query).await
    }

    async fn sessions_by_tenant(&self) -> Result<Vec<(Tenant, u64)>, StoreError> {
        let query = sqlx::query("SELECT tenant, COUNT(*) FROM sessions GROUP BY tenant ORDER BY tenant");
        let rows = self.rows(query).await?;
        rows.iter()
            .map(|row| Ok((tenant_of(row, 0)?, unsigned(column(row, 1)?)?)))
            .collect()
    }

    async fn stored_bytes(&self, tenant: &Tenant) -> Result<u64, StoreError> {
        let mut sum = 0u64;
        for query in [
            "SELECT CAST(COALESCE(SUM(record_bytes), 0) AS BIGINT) FROM sessions WHERE tenant = $1",
            "SELECT CAST(COALESCE(SUM(bytes), 0) AS BIGINT) FROM object_uses JOIN sessions ON id = session WHERE tenant = $1",
        ] {
            sum = sum.saturating_add(self.number(sqlx::query(query).bind(&*tenant.0)).await?);
        }
        Ok(sum)
    }

    async fn highest_number(&self) -> Result<u64, StoreError> {
        let query = sqlx::query("SELECT number FROM sessions ORDER BY number DESC LIMIT 1");
        self.number(query).await
    }

    async fn keys(&self) -> Result<Vec<LoggedKey>, StoreError> {
        let query = format!("SELECT {KEY_COLUMNS} FROM call_keys ORDER BY at_ms");
        let rows = self.rows(sqlx::query(AssertSqlSafe(query))).await?;
        rows.iter().map(key_from_row).collect()
    }

    async fn key(&self, tenant: &Tenant, key: &str) -> Result<Option<LoggedKey>, StoreError> {
        let query = format!("SELECT {KEY_COLUMNS} FROM call_keys WHERE tenant = $1 AND call_key = $2");
        let query = sqlx::query(AssertSqlSafe(query)).bind(&*tenant.0).bind(key);
        self.row(query).await?.as_ref().map(key_from_row).transpose()
    }

    async fn all_sessions(&self) -> Result<Vec<StoredFacts>, StoreError> {
        let query =
            "SELECT number, id, tenant, used_ms, ttl_ms, (SELECT COUNT(*) FROM commits WHERE session = sessions.id)
            FROM sessions WHERE number > $1 ORDER BY number LIMIT $2";
        let facts = |row: &AnyRow| {
            Ok::<_, StoreError>(StoredFacts {
                number: unsigned(column(row, 0)?)?,
                id: column(row, 1)?,
                tenant: tenant_of(row, 2)?,
                used_ms: unsigned(column(row, 3)?)?,
                ttl_ms: unsigned(column(row, 4)?)?,
                commits: unsigned(column(row, 5)?)?,
            })
        };
        let mut all: Vec<StoredFacts> = Vec::new();
        loop {
            let after = all.last().map_or(0, |s| s.number);
            let page = self.rows(sqlx::query(query).bind(signed(after)).bind(signed(PAGE as u64)));
            let page = page.await?;
            if page.is_empty() {
                return Ok(all);
            }
            for row in &page {
                all.push(facts(row)?);
            }
        }
    }

    async fn audited_tenants(&self) -> Result<Vec<Tenant>, StoreError> {
        let query = sqlx::query("SELECT DISTINCT tenant FROM audit ORDER BY tenant");
        self.rows(query).await?.iter().map(|row| tenant_of(row, 0)).collect()
    }

    async fn unmeasured_objects(&self) -> Result<Vec<String>, StoreError> {
        let query = sqlx::query("SELECT DISTINCT object FROM object_uses WHERE bytes < 0");
        self.rows(query).await?.iter().map(|row| column(row, 0)).collect()
    }

    async fn used_objects(&self) -> Result<Vec<String>, StoreError> {
        let query = sqlx::query("SELECT DISTINCT object FROM object_uses");
        self.rows(query).await?.iter().map(|row| column(row, 0)).collect()
    }

    async fn is_used(&self, object: &str, session: Option<&str>) -> Result<bool, StoreError> {
        let query = "SELECT object FROM object_uses WHERE object = $1 AND ($2 = '' OR session = $2) LIMIT 1";
        let query = sqlx::query(query).bind(object).bind(session.unwrap_or_default());
        Ok(self.row(query).await?.is_some())
    }

    async fn check_integrity(&self, folder: Option<&Path>) -> Result<(), StoreError> {
        if self.dialect == Dialect::Sqlite {
            let row = sqlx::query("PRAGMA integrity_check(1)").fetch_one(&self.pool).await;
            let reported: String = column(&row.map_err(unreadable)?, 0)?;
            if reported != "ok" {
                return Err(StoreError::Damaged(reported));
            }
        }
        let Some(folder) = folder else { return Ok(()) };
        let failed = |e: sqlx::Error| StoreError::Unavailable(e.to_string());
        let mut connection = self.pool.acquire().await.map_err(failed)?;
        match find_lost_writes(folder, &mut connection).await? {
            Some(lost) => Err(StoreError::Damaged(lost)),
            None => Ok(()),
        }
    }

    async fn close(&self) {
        self.pool.close().await;
    }
}
