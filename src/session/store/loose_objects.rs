//! Objects that no session names, where several nodes share a store: the lock of one node does not cover what another
//! names.
//!
//! A node writes a row for an object before it names it, removes the row in the transaction that names it, and writes
//! one when it removes a name. An unused object whose row is older than [`GRACE`] is removed.

use super::objects::Objects;
use super::reading::{is_used_on, unreadable};
use super::rows::column;
use super::schema::DATABASE_NOW;
use super::session_store::StoreError;
use sqlx::{AnyConnection, AnyPool, AssertSqlSafe};
use std::time::Duration;

/// How long an object without a name stays.
pub(super) const GRACE: Duration = Duration::from_secs(3600);
/// How long after it was announced an object may get its name.
pub(super) const NAMED_WITHIN: Duration = Duration::from_secs(1200);
/// Objects of one sweep.
const MOST: i64 = 200;

fn grace_ms() -> i64 {
    i64::try_from(GRACE.as_millis()).unwrap_or(i64::MAX)
}

fn note_statement() -> String {
    format!(
        "INSERT INTO loose_objects (object, since_ms) VALUES ($1, {DATABASE_NOW})
        ON CONFLICT (object) DO UPDATE SET since_ms = {DATABASE_NOW}"
    )
}

/// Announces an object that is about to be written and named. Waits while a node removes it.
pub(super) async fn announce(pool: &AnyPool, object: &str) -> Result<(), StoreError> {
    let done = sqlx::query(AssertSqlSafe(note_statement()))
        .bind(object)
        .execute(pool)
        .await;
    done.map(drop).map_err(unreadable)
}

/// Notes that an object lost a name.
pub(super) async fn note_loose(object: &str, on: &mut AnyConnection) -> Result<(), StoreError> {
    let done = sqlx::query(AssertSqlSafe(note_statement()))
        .bind(object)
        .execute(on)
        .await;
    done.map(drop).map_err(unreadable)
}

/// Removes unused objects with a row older than [`GRACE`].
pub(super) async fn remove_loose(pool: &AnyPool, objects: &Objects) -> Result<(), StoreError> {
    let find =
        format!("SELECT object FROM loose_objects WHERE since_ms < {DATABASE_NOW} - $1 ORDER BY since_ms LIMIT {MOST}");
    let rows = sqlx::query(AssertSqlSafe(find)).bind(grace_ms()).fetch_all(pool).await;
    for row in &rows.map_err(unreadable)? {
        remove_one(pool, objects, &column::<String>(row, 0)?).await?;
    }
    Ok(())
}

async fn remove_one(pool: &AnyPool, objects: &Objects, object: &str) -> Result<(), StoreError> {
    let mut transaction = pool.begin().await.map_err(unreadable)?;
    // Who announces it anew waits until it is gone, and writes it then.
    let lock = format!(
        "SELECT object FROM loose_objects WHERE object = $1 AND since_ms < {DATABASE_NOW} - $2 FOR UPDATE SKIP LOCKED"
    );
    let locked = sqlx::query(AssertSqlSafe(lock)).bind(object).bind(grace_ms());
    if (locked.fetch_optional(&mut *transaction).await.map_err(unreadable)?).is_none() {
        return Ok(());
    }
    if !is_used_on(&mut transaction, object).await? {
        objects.remove(object).await?;
    }
    let delete = sqlx::query("DELETE FROM loose_objects WHERE object = $1").bind(object);
    delete.execute(&mut *transaction).await.map_err(unreadable)?;
    transaction.commit().await.map_err(unreadable)
}
