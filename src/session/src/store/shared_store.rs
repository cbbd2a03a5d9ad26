//! A store that several nodes share, as one of them uses it: the lease of the node, and the owner in each session's row.
//! Times are those of the database's clock.

use super::objects::{Objects, remove_loose};
use super::schema::{DATABASE_NOW, column, signed, unreadable, unsigned};
use super::session_store::{Generation, HeldSession, NodeIdentity, NodeLoad, SessionClaim, StoreError, millis};
use super::writer::{StoreHealth, Writer};
use crate::answers::Tenant;
use crate::error::OwnerAddress;
use sqlx::{AnyConnection, AnyPool, AssertSqlSafe};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicI64;
use std::sync::atomic::Ordering::SeqCst;

/// Nodes without a lease are forgotten after so long.
const FORGOTTEN_MS: i64 = 24 * 3600 * 1000;

/// How a node of several takes sessions, and the lease of this node.
#[derive(Debug)]
pub(crate) struct SharedStore {
    pub(super) node: NodeIdentity,
    /// An id that no other process has had or will have.
    pub(super) id: String,
    /// The connection that renews the lease is used for nothing else, so that nothing holds it up.
    pub(super) heartbeat: AnyPool,
    /// How often the lease is known to have run out.
    pub(super) lapses: AtomicI64,
    pub(super) pool: AnyPool,
    pub(super) writer: Arc<Writer>,
    pub(super) objects: Arc<Objects>,
    pub(super) health: Arc<StoreHealth>,
}

/// Whether a node has a lease. Until the transaction ends none can be renewed or run out unnoticed: what renews it waits.
async fn has_lease(node: &str, on: &mut AnyConnection) -> Result<bool, StoreError> {
    let find = format!("SELECT lease_until_ms > {DATABASE_NOW} FROM nodes WHERE node = $1 FOR SHARE");
    let row = sqlx::query(AssertSqlSafe(find)).bind(node).fetch_optional(on).await;
    row.map_err(unreadable)?.map_or(Ok(false), |row| column(&row, 0))
}

/// How often a session is asked for that changes hands meanwhile.
const TRIES: u32 = 5;

/// A session's row, as far as who has it.
struct OwnerRow {
    owner: String,
    generation: i64,
    address: OwnerAddress,
    is_leaving: bool,
    has_lease: bool,
}

async fn owner_row(pool: &AnyPool, tenant: &str, id: &str) -> Result<Option<OwnerRow>, StoreError> {
    let find = format!(
        "SELECT owner, generation, COALESCE(address, ''), COALESCE(name, ''), COALESCE(leaving, 0), COALESCE(lease_until_ms, 0) > {DATABASE_NOW}
        FROM sessions LEFT JOIN nodes ON node = owner WHERE id = $1 AND tenant = $2"
    );
    let row = sqlx::query(AssertSqlSafe(find))
        .bind(id)
        .bind(tenant)
        .fetch_optional(pool)
        .await;
    let Some(row) = row.map_err(unreadable)? else {
        return Ok(None);
    };
    Ok(Some(OwnerRow {
        owner: column(&row, 0)?,
        generation: column(&row, 1)?,
        address: OwnerAddress {
            address: column(&row, 2)?,
            node: column(&row, 3)?,
        },
        is_leaving: column::<i64>(&row, 4)? != 0,
        has_lease: column(&row, 5)?,
    }))
}

impl SharedStore {
    /// This node.
    pub(crate) fn node(&self) -> &NodeIdentity {
        &self.node
    }

    /// Renews the lease. False when it had run out before: others may have taken sessions meanwhile.
    pub(crate) async fn beat(&self, load: NodeLoad) -> Result<bool, StoreError> {
        self.health.note(self.renew(load).await)
    }

    async fn renew(&self, load: NodeLoad) -> Result<bool, StoreError> {
        let known = self.lapses.load(SeqCst);
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
        let lease_ms = signed(millis(self.node.lease));
        let renew = sqlx::query(AssertSqlSafe(renew))
            .bind(&self.id)
            .bind(&self.node.name)
            .bind(&self.node.address)
            .bind(i64::from(load.is_leaving))
            .bind(known)
            .bind(lease_ms)
            .bind(signed(load.sessions))
            .bind(signed(load.most_sessions))
            .bind(signed(load.memory_used))
            .bind(signed(load.memory_total))
            .bind(signed(load.work));
        let renewed = tokio::time::timeout(self.node.lease, renew.fetch_one(&self.heartbeat)).await;
        let row = renewed.map_err(|_| StoreError::Unavailable("the lease could not be renewed in its time".into()))?;
        let lapses: i64 = column(&row.map_err(unreadable)?, 0)?;
        self.lapses.store(lapses, SeqCst);
        Ok(lapses == known)
    }

    /// The nodes with a lease that take sessions, by their names.
    pub(crate) async fn nodes(&self) -> Result<Vec<(OwnerAddress, NodeLoad)>, StoreError> {
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

    /// Gives back everything that this node has, and its lease.
    pub(super) async fn close(&self) {
        let sessions = "UPDATE sessions SET owner = '', generation = generation + 1 WHERE owner = $1";
        for statement in [sessions, "DELETE FROM nodes WHERE node = $1"] {
            let done = sqlx::query(statement).bind(&self.id).execute(&self.heartbeat).await;
            if let Err(error) = done.map_err(unreadable) {
                tracing::warn!("the sessions of this node are free only when its lease has run out: {error}");
                break;
            }
        }
        self.heartbeat.close().await;
    }

    /// Takes a session that no node with a lease has, or that this node has already; or says who has it.
    pub(crate) async fn claim(&self, tenant: &Tenant, id: &str) -> Result<SessionClaim, StoreError> {
        // What was refused here and may be written all the same can be taken back under the present ownership alone.
        self.writer.undo_uncertain_commits().await?;
        for _ in 0..TRIES {
            let Some(row) = owner_row(&self.pool, &tenant.0, id).await? else {
                return Ok(SessionClaim::Missing);
            };
            if row.has_lease && row.owner != self.id {
                return Ok(SessionClaim::Elsewhere {
                    owner: row.address,
                    is_leaving: row.is_leaving,
                });
            }
            if let Some(generation) = self.take(id, &row).await? {
                return Ok(SessionClaim::Here(Generation(unsigned(generation)?)));
            }
        }
        Err(StoreError::Unavailable("the session keeps moving between nodes".into()))
    }

    /// Takes a session as it was seen; `None` where it has changed hands since, or its node has come back to life.
    async fn take(&self, id: &str, seen: &OwnerRow) -> Result<Option<i64>, StoreError> {
        let mut transaction = self.pool.begin().await.map_err(unreadable)?;
        let is_others = !seen.owner.is_empty() && seen.owner != self.id;
        if is_others && has_lease(&seen.owner, &mut transaction).await? {
            return Ok(None);
        }
        let update = "UPDATE sessions SET owner = $2, generation = generation + 1 WHERE id = $1 AND generation = $3 RETURNING generation";
        let update = sqlx::query(update).bind(id).bind(&self.id).bind(seen.generation);
        let row = update.fetch_optional(&mut *transaction).await.map_err(unreadable)?;
        let generation = row.map(|row| column(&row, 0)).transpose()?;
        transaction.commit().await.map_err(unreadable)?;
        Ok(generation)
    }

    /// Takes an expired session; `None` where it is not expired, or another node has it.
    pub(crate) async fn claim_expired(
        &self,
        tenant: &Tenant,
        id: &str,
        since_ms: u64,
        now_ms: u64,
    ) -> Result<Option<Generation>, StoreError> {
        let SessionClaim::Here(generation) = self.claim(tenant, id).await? else {
            return Ok(None);
        };
        // Another node may have used it since it was found.
        let query = "SELECT id FROM sessions WHERE id = $3 AND used_ms < $1 - ttl_ms AND ttl_ms < $1 - $2";
        let query = sqlx::query(query).bind(signed(now_ms)).bind(signed(since_ms));
        let found = query.bind(id).fetch_optional(&self.pool).await.map_err(unreadable)?;
        if found.is_none() {
            let id = id.to_owned();
            self.release(&HeldSession { id, generation }, 0).await?;
        }
        Ok(found.map(|_| generation))
    }

    /// Gives a session back, last used at `used_ms`.
    pub(crate) async fn release(&self, session: &HeldSession, used_ms: u64) -> Result<(), StoreError> {
        let update = "UPDATE sessions SET owner = '', generation = generation + 1, used_ms = GREATEST(used_ms, $3)
            WHERE id = $1 AND generation = $2";
        let update = sqlx::query(update).bind(&session.id).bind(signed(session.generation.0));
        let done = update.bind(signed(used_ms)).execute(&self.pool).await;
        done.map(drop).map_err(unreadable)
    }

    /// The sessions that are this node's.
    pub(crate) async fn held(&self) -> Result<BTreeMap<String, Generation>, StoreError> {
        let find = sqlx::query("SELECT id, generation FROM sessions WHERE owner = $1").bind(&self.id);
        let rows = find.fetch_all(&self.pool).await.map_err(unreadable)?;
        rows.iter()
            .map(|row| Ok((column(row, 0)?, Generation(unsigned(column(row, 1)?)?))))
            .collect()
    }

    /// The number of the next session to be created. What a process that had the store for itself has numbered meanwhile is passed over.
    pub(crate) async fn next_number(&self) -> Result<u64, StoreError> {
        let next =
            "UPDATE session_numbers SET newest = GREATEST(newest, (SELECT COALESCE(MAX(number), 0) FROM sessions)) + 1
            RETURNING newest";
        let row = sqlx::query(next).fetch_one(&self.pool).await.map_err(unreadable)?;
        unsigned(column(&row, 0)?)
    }

    /// Removes objects that no session has named for a long time, and forgets nodes that are long gone.
    pub(crate) async fn remove_loose_objects(&self) -> Result<(), StoreError> {
        let delete = format!("DELETE FROM nodes WHERE lease_until_ms < {DATABASE_NOW} - $1");
        let delete = sqlx::query(AssertSqlSafe(delete)).bind(FORGOTTEN_MS);
        delete.execute(&self.heartbeat).await.map_err(unreadable)?;
        remove_loose(&self.pool, &self.objects).await
    }
}
