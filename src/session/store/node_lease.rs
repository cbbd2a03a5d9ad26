//! The lease of a node: its row, which one statement renews. Times are those of the database's clock.

use super::ownership::{NodeIdentity, NodeLoad};
use super::reading::unreadable;
use super::rows::{column, signed, unsigned};
use super::session_store::StoreError;
use crate::session::owner_address::OwnerAddress;
use sqlx::{AnyConnection, AnyPool, AssertSqlSafe};
use std::sync::atomic::{AtomicI64, Ordering::SeqCst};

/// Milliseconds since 1970 by the clock of the database.
pub(super) const DATABASE_NOW: &str = "CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000 AS BIGINT)";
/// Nodes without a lease are forgotten after so long.
const FORGOTTEN_MS: i64 = 24 * 3600 * 1000;

/// The lease of this node.
#[derive(Debug)]
pub(super) struct NodeLease {
    pub node: NodeIdentity,
    /// An id that no other process has had or will have.
    pub id: String,
    /// The connection that renews it is used for nothing else, so that nothing holds it up.
    pool: AnyPool,
    /// How often it is known to have run out.
    lapses: AtomicI64,
}

impl NodeLease {
    pub fn new(node: NodeIdentity, id: String, pool: AnyPool) -> Self {
        Self {
            node,
            id,
            pool,
            lapses: AtomicI64::new(0),
        }
    }

    /// Renews it. False when it had run out since the last time.
    pub async fn renew(&self, load: NodeLoad) -> Result<bool, StoreError> {
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
        let lease_ms = i64::try_from(self.node.lease.as_millis()).unwrap_or(i64::MAX);
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
        let renewed = tokio::time::timeout(self.node.lease, renew.fetch_one(&self.pool)).await;
        let row = renewed.map_err(|_| StoreError::Unavailable("the lease could not be renewed in its time".into()))?;
        let lapses: i64 = column(&row.map_err(unreadable)?, 0)?;
        self.lapses.store(lapses, SeqCst);
        Ok(lapses == known)
    }

    /// The nodes with a lease that go on.
    pub async fn others(&self) -> Result<Vec<(OwnerAddress, NodeLoad)>, StoreError> {
        let find = format!(
            "SELECT name, address, sessions, most_sessions, memory_used, memory_total, work FROM nodes
            WHERE lease_until_ms > {DATABASE_NOW} AND leaving = 0 ORDER BY name, node"
        );
        let rows = sqlx::query(AssertSqlSafe(find))
            .fetch_all(&self.pool)
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

    /// Gives back everything that the node has, and its lease.
    pub async fn give_back(&self) -> Result<(), StoreError> {
        let sessions = "UPDATE sessions SET owner = '', generation = generation + 1 WHERE owner = $1";
        for statement in [sessions, "DELETE FROM nodes WHERE node = $1"] {
            let done = sqlx::query(statement).bind(&self.id).execute(&self.pool).await;
            done.map_err(unreadable)?;
        }
        Ok(())
    }

    /// Forgets nodes that are long gone.
    pub async fn forget_others(&self) -> Result<(), StoreError> {
        let delete = format!("DELETE FROM nodes WHERE lease_until_ms < {DATABASE_NOW} - $1");
        let done = sqlx::query(AssertSqlSafe(delete))
            .bind(FORGOTTEN_MS)
            .execute(&self.pool)
            .await;
        done.map(drop).map_err(unreadable)
    }

    /// Closes its connection.
    pub async fn close(&self) {
        self.pool.close().await;
    }
}

/// Whether a node has a lease. Until the transaction ends none can be renewed or run out unnoticed: what renews it waits.
pub(super) async fn has_lease(node: &str, on: &mut AnyConnection) -> Result<bool, StoreError> {
    let find = format!("SELECT lease_until_ms > {DATABASE_NOW} FROM nodes WHERE node = $1 FOR SHARE");
    let row = sqlx::query(AssertSqlSafe(find)).bind(node).fetch_optional(on).await;
    row.map_err(unreadable)?.map_or(Ok(false), |row| column(&row, 0))
}
