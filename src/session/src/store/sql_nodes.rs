//! Nodes, leases and owners in a database of SQL, and objects that no session names.

use super::database::{NodeTables, RemoveObject, SessionOwner};
use super::schema::{DATABASE_NOW, column, signed, unreadable, unsigned};
use super::session_store::{Generation, HeldSession, NodeIdentity, NodeLoad, StoreError, millis};
use crate::answers::Tenant;
use crate::error::OwnerAddress;
use async_trait::async_trait;
use sqlx::{AnyConnection, AnyPool, AssertSqlSafe};
use std::collections::BTreeMap;
use std::time::Duration;

/// Nodes without a lease are forgotten after so long.
const FORGOTTEN_MS: i64 = 24 * 3600 * 1000;

/// The tables of nodes in a database of SQL.
#[derive(Debug)]
pub(super) struct SqlNodes {
    /// The connection that renews the lease is used for nothing else, so that nothing holds it up.
    pub heartbeat: AnyPool,
    pub pool: AnyPool,
}

/// Whether a node has a lease. Until the transaction ends none can be renewed or run out unnoticed: what renews it waits.
async fn has_lease(node: &str, on: &mut AnyConnection) -> Result<bool, StoreError> {
    let find = format!("SELECT lease_until_ms > {DATABASE_NOW} FROM nodes WHERE node = $1 FOR SHARE");
    let row = sqlx::query(AssertSqlSafe(find)).bind(node).fetch_optional(on).await;
    row.map_err(unreadable)?.map_or(Ok(false), |row| column(&row, 0))
}

#[async_trait]
impl NodeTables for SqlNodes {
    async fn renew(&self, id: &str, node: &NodeIdentity, load: NodeLoad, known: i64) -> Result<i64, StoreError> {
        // A row that is not there any more counts as run out.
        let renew = format!(
            "INSERT INTO nodes (node, name, address, leaving, lapses, lease_until_ms, sessions, most_sessions, memory_used, memory_total, work)
            VALUES ($1, $2, $3, $4, $5 + 1, {DATABASE_NOW} + $6, $7, $8, $9, $10, $11)
            ON CONFLICT (node) DO UPDATE SET leaving = excluded.leaving,
            lapses = nodes.lapses + CASE WHEN nodes.lease_until_ms < {DATABASE_NOW} THEN 1 ELSE 0 END,
            lease_until_ms = {DATABASE_NOW} + $6, sessions = excluded.sessions, most_sessions = excluded.most_sessions,
            memory_used = excluded.memory_used, memory_total = excluded.memory_total, work = excluded.work
            RETURNING lapses"
        );
        let lease_ms = signed(millis(node.lease));
        let renew = sqlx::query(AssertSqlSafe(renew))
            .bind(id)
            .bind(&node.name)
            .bind(&node.address)
            .bind(i64::from(load.is_leaving))
            .bind(known)
            .bind(lease_ms)
            .bind(signed(load.sessions))
            .bind(signed(load.most_sessions))
            .bind(signed(load.memory_used))
            .bind(signed(load.memory_total))
            .bind(signed(load.work));
        let row = renew.fetch_one(&self.heartbeat).await.map_err(unreadable)?;
        column(&row, 0)
    }

    async fn nodes(&self) -> Result<Vec<(OwnerAddress, NodeLoad)>, StoreError> {
        let find = format!(
            "SELECT name, address, sessions, most_sessions, memory_used, memory_total, work FROM nodes
            WHERE lease_until_ms > {DATABASE_NOW} AND leaving = 0 ORDER BY name, node"
        );
        let rows = sqlx::query(AssertSqlSafe(find))
            .fetch_all(&self.heartbeat)
            .await
            .map_err(unreadable)?;
        let node = |row: &sqlx::any::AnyRow| {
            let owner = OwnerAddress {
                node: column(row, 0)?,
                address: column(row, 1)?,
            };
            let load = NodeLoad {
                sessions: unsigned(column(row, 2)?)?,
                most_sessions: unsigned(column(row, 3)?)?,
                memory_used: unsigned(column(row, 4)?)?,
                memory_total: unsigned(column(row, 5)?)?,
                work: unsigned(column(row, 6)?)?,
                is_leaving: false,
            };
            Ok((owner, load))
        };
        rows.iter().map(node).collect()
    }

    async fn leave(&self, id: &str) -> Result<(), StoreError> {
        let sessions = "UPDATE sessions SET owner = '', generation = generation + 1 WHERE owner = $1";
        for statement in [sessions, "DELETE FROM nodes WHERE node = $1"] {
            let done = sqlx::query(statement).bind(id).execute(&self.heartbeat).await;
            done.map_err(unreadable)?;
        }
        Ok(())
    }

    async fn owner(&self, tenant: &Tenant, session: &str) -> Result<Option<SessionOwner>, StoreError> {
        let find = format!(
            "SELECT owner, generation, COALESCE(address, ''), COALESCE(name, ''), COALESCE(leaving, 0), COALESCE(lease_until_ms, 0) > {DATABASE_NOW}
            FROM sessions LEFT JOIN nodes ON node = owner WHERE id = $1 AND tenant = $2"
        );
        let row = sqlx::query(AssertSqlSafe(find))
            .bind(session)
            .bind(&*tenant.0)
            .fetch_optional(&self.pool)
            .await;
        let Some(row) = row.map_err(unreadable)? else {
            return Ok(None);
        };
        Ok(Some(SessionOwner {
            node: column(&row, 0)?,
            generation: Generation(unsigned(column(&row, 1)?)?),
            address: OwnerAddress {
                address: column(&row, 2)?,
                node: column(&row, 3)?,
            },
            is_leaving: column::<i64>(&row, 4)? != 0,
            has_lease: column(&row, 5)?,
        }))
    }

    async fn take(&self, id: &str, session: &str, seen: &SessionOwner) -> Result<Option<Generation>, StoreError> {
        let mut transaction = self.pool.begin().await.map_err(unreadable)?;
        let is_others = !seen.node.is_empty() && seen.node != id;
        if is_others && has_lease(&seen.node, &mut transaction).await? {
            return Ok(None);
        }
        let update = "UPDATE sessions SET owner = $2, generation = generation + 1 WHERE id = $1 AND generation = $3 RETURNING generation";
        let update = sqlx::query(update)
            .bind(session)
            .bind(id)
            .bind(signed(seen.generation.0));
        let row = update.fetch_optional(&mut *transaction).await.map_err(unreadable)?;
        let generation = row.map(|row| unsigned(column(&row, 0)?)).transpose()?;
        transaction.commit().await.map_err(unreadable)?;
        Ok(generation.map(Generation))
    }

    async fn is_expired(&self, session: &str, since_ms: u64, now_ms: u64) -> Result<bool, StoreError> {
        let query = "SELECT id FROM sessions WHERE id = $3 AND used_ms < $1 - ttl_ms AND ttl_ms < $1 - $2";
        let query = sqlx::query(query).bind(signed(now_ms)).bind(signed(since_ms));
        let found = query.bind(session).fetch_optional(&self.pool).await;
        Ok(found.map_err(unreadable)?.is_some())
    }

    async fn release(&self, session: &HeldSession, used_ms: u64) -> Result<(), StoreError> {
        let update = "UPDATE sessions SET owner = '', generation = generation + 1, used_ms = GREATEST(used_ms, $3)
            WHERE id = $1 AND generation = $2";
        let update = sqlx::query(update).bind(&session.id).bind(signed(session.generation.0));
        let done = update.bind(signed(used_ms)).execute(&self.pool).await;
        done.map(drop).map_err(unreadable)
    }

    async fn held(&self, id: &str) -> Result<BTreeMap<String, Generation>, StoreError> {
        let find = sqlx::query("SELECT id, generation FROM sessions WHERE owner = $1").bind(id);
        let rows = find.fetch_all(&self.pool).await.map_err(unreadable)?;
        rows.iter()
            .map(|row| Ok((column(row, 0)?, Generation(unsigned(column(row, 1)?)?))))
            .collect()
    }

    async fn next_number(&self) -> Result<u64, StoreError> {
        let next =
            "UPDATE session_numbers SET newest = GREATEST(newest, (SELECT COALESCE(MAX(number), 0) FROM sessions)) + 1
            RETURNING newest";
        let row = sqlx::query(next).fetch_one(&self.pool).await.map_err(unreadable)?;
        unsigned(column(&row, 0)?)
    }

    async fn note_loose(&self, object: &str) -> Result<(), StoreError> {
        note_loose(object, &self.pool).await
    }

    async fn remove_loose(&self, remove: &RemoveObject<'_>) -> Result<(), StoreError> {
        let delete = format!("DELETE FROM nodes WHERE lease_until_ms < {DATABASE_NOW} - $1");
        let delete = sqlx::query(AssertSqlSafe(delete)).bind(FORGOTTEN_MS);
        delete.execute(&self.heartbeat).await.map_err(unreadable)?;
        remove_unnamed(&self.pool, remove).await
    }

    async fn close(&self) {
        self.heartbeat.close().await;
    }
}

/// How long an object without a name stays.
const GRACE: Duration = Duration::from_secs(3600);
/// Objects of one sweep.
const MOST: i64 = 200;

/// Notes an object that is about to be written and named, or that lost a name. Waits while a node removes it.
pub(super) async fn note_loose(object: &str, on: impl sqlx::AnyExecutor<'_>) -> Result<(), StoreError> {
    let note = format!(
        "INSERT INTO loose_objects (object, since_ms) VALUES ($1, {DATABASE_NOW})
        ON CONFLICT (object) DO UPDATE SET since_ms = {DATABASE_NOW}"
    );
    let done = sqlx::query(AssertSqlSafe(note)).bind(object).execute(on).await;
    done.map(drop).map_err(unreadable)
}

/// Removes unused objects with a row older than [`GRACE`].
async fn remove_unnamed(pool: &AnyPool, remove: &RemoveObject<'_>) -> Result<(), StoreError> {
    let find =
        format!("SELECT object FROM loose_objects WHERE since_ms < {DATABASE_NOW} - $1 ORDER BY since_ms LIMIT {MOST}");
    let rows = sqlx::query(AssertSqlSafe(find))
        .bind(signed(millis(GRACE)))
        .fetch_all(pool)
        .await;
    for row in &rows.map_err(unreadable)? {
        remove_one(pool, remove, column(row, 0)?).await?;
    }
    Ok(())
}

/// Whether any session uses an object.
async fn is_used(object: &str, on: impl sqlx::AnyExecutor<'_>) -> Result<bool, StoreError> {
    let query = sqlx::query("SELECT session FROM object_uses WHERE object = $1 LIMIT 1");
    let found = query.bind(object).fetch_optional(on).await;
    Ok(found.map_err(unreadable)?.is_some())
}

async fn remove_one(pool: &AnyPool, remove: &RemoveObject<'_>, object: String) -> Result<(), StoreError> {
    let mut transaction = pool.begin().await.map_err(unreadable)?;
    // A call that announces it again waits until it is gone, and writes it then.
    let lock = format!(
        "SELECT object FROM loose_objects WHERE object = $1 AND since_ms < {DATABASE_NOW} - $2 FOR UPDATE SKIP LOCKED"
    );
    let locked = sqlx::query(AssertSqlSafe(lock))
        .bind(&object)
        .bind(signed(millis(GRACE)));
    if (locked.fetch_optional(&mut *transaction).await.map_err(unreadable)?).is_none() {
        return Ok(());
    }
    if !is_used(&object, &mut *transaction).await? {
        remove(object.clone()).await?;
    }
    let delete = sqlx::query("DELETE FROM loose_objects WHERE object = $1").bind(&object);
    delete.execute(&mut *transaction).await.map_err(unreadable)?;
    transaction.commit().await.map_err(unreadable)
}
