//! Who has a session, in its row.

use super::node_lease::{DATABASE_NOW, NodeLease, has_lease};
use super::ownership::{Generation, HeldSession, SessionClaim};
use super::reading::unreadable;
use super::rows::{column, signed, unsigned};
use super::session_store::StoreError;
use crate::session::owner_address::OwnerAddress;
use sqlx::{AnyPool, AssertSqlSafe};
use std::collections::BTreeMap;

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

/// Takes a session that no node with a lease has, or that this node has already.
pub(super) async fn claim(
    lease: &NodeLease,
    pool: &AnyPool,
    tenant: &str,
    id: &str,
) -> Result<SessionClaim, StoreError> {
    for _ in 0..TRIES {
        let Some(row) = owner_row(pool, tenant, id).await? else {
            return Ok(SessionClaim::Missing);
        };
        if row.has_lease && row.owner != lease.id {
            return Ok(SessionClaim::Elsewhere {
                owner: row.address,
                is_leaving: row.is_leaving,
            });
        }
        if let Some(generation) = take(lease, pool, id, &row).await? {
            return Ok(SessionClaim::Here(Generation(unsigned(generation)?)));
        }
    }
    Err(StoreError::Unavailable("the session keeps moving between nodes".into()))
}

/// Takes a session as it was seen; `None` where it has changed hands since, or its node has come back to life.
async fn take(lease: &NodeLease, pool: &AnyPool, id: &str, seen: &OwnerRow) -> Result<Option<i64>, StoreError> {
    let mut transaction = pool.begin().await.map_err(unreadable)?;
    let is_others = !seen.owner.is_empty() && seen.owner != lease.id;
    if is_others && has_lease(&seen.owner, &mut transaction).await? {
        return Ok(None);
    }
    let update = "UPDATE sessions SET owner = $2, generation = generation + 1 WHERE id = $1 AND generation = $3 RETURNING generation";
    let update = sqlx::query(update).bind(id).bind(&lease.id).bind(seen.generation);
    let row = update.fetch_optional(&mut *transaction).await.map_err(unreadable)?;
    let generation = row.map(|row| column(&row, 0)).transpose()?;
    transaction.commit().await.map_err(unreadable)?;
    Ok(generation)
}

/// Gives a session back.
pub(super) async fn release(pool: &AnyPool, session: &HeldSession, used_ms: u64) -> Result<(), StoreError> {
    let update = "UPDATE sessions SET owner = '', generation = generation + 1, used_ms = GREATEST(used_ms, $3)
        WHERE id = $1 AND generation = $2";
    let update = sqlx::query(update).bind(&session.id).bind(signed(session.generation.0));
    let done = update.bind(signed(used_ms)).execute(pool).await;
    done.map(drop).map_err(unreadable)
}

/// The sessions that a node has.
pub(super) async fn held(lease: &NodeLease, pool: &AnyPool) -> Result<BTreeMap<String, Generation>, StoreError> {
    let find = sqlx::query("SELECT id, generation FROM sessions WHERE owner = $1").bind(&lease.id);
    let rows = find.fetch_all(pool).await.map_err(unreadable)?;
    rows.iter()
        .map(|row| Ok((column(row, 0)?, Generation(unsigned(column(row, 1)?)?))))
        .collect()
}

/// The number of the next session. What a process that had the store for itself has numbered meanwhile is passed over.
pub(super) async fn next_number(pool: &AnyPool) -> Result<u64, StoreError> {
    let next =
        "UPDATE session_numbers SET newest = GREATEST(newest, (SELECT COALESCE(MAX(number), 0) FROM sessions)) + 1
        RETURNING newest";
    let row = sqlx::query(next).fetch_one(pool).await.map_err(unreadable)?;
    unsigned(column(&row, 0)?)
}
