//! Reads who did what.

use super::database_to_read::DatabaseToRead;
use super::reading::{tenant_of, unreadable};
use super::rows::{column, signed, unsigned};
use super::session_store::StoreError;
use super::store_location::StoreLocation;
use crate::session::answers::Tenant;
use crate::session::audit::audit_entry::StoredAuditEntry;
use futures::TryStreamExt as _;
use sqlx::AnyPool;

/// Which entries are wanted.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct AuditFilter {
    /// Of this tenant alone.
    pub tenant: Option<String>,
    /// Of this session alone.
    pub session: Option<String>,
    /// From then on, in milliseconds since 1970.
    pub since_ms: u64,
}

/// Reads the trail of a store, oldest first, and gives each entry to `take` until that returns false. A process may be writing it
/// meanwhile.
///
/// # Errors
/// [`StoreError::Refused`] where there is no database, [`StoreError::Unavailable`] where it cannot be read, [`StoreError::Damaged`] for a row that cannot.
pub async fn read_audit(
    location: &StoreLocation,
    filter: &AuditFilter,
    mut take: impl FnMut(StoredAuditEntry) -> bool,
) -> Result<(), StoreError> {
    let database = DatabaseToRead::open(location).await?;
    let query = "SELECT at_ms, tenant, who, what, session FROM audit
        WHERE at_ms >= $1 AND ($2 = '' OR tenant = $2) AND ($3 = '' OR session = $3) ORDER BY id";
    let query = sqlx::query(query).bind(signed(filter.since_ms));
    let query = query.bind(filter.tenant.as_deref().unwrap_or_default());
    let mut rows = query
        .bind(filter.session.as_deref().unwrap_or_default())
        .fetch(&database.pool);
    while let Some(row) = rows.try_next().await.map_err(unreadable)? {
        let entry = StoredAuditEntry {
            at_ms: unsigned(column(&row, 0)?)?,
            tenant: column(&row, 1)?,
            caller: column(&row, 2)?,
            action: column(&row, 3)?,
            session: column(&row, 4)?,
        };
        if !take(entry) {
            break;
        }
    }
    Ok(())
}

/// The tenants of whom anything is noted.
pub(super) async fn audited_tenants(pool: &AnyPool) -> Result<Vec<Tenant>, StoreError> {
    let query = sqlx::query("SELECT DISTINCT tenant FROM audit ORDER BY tenant");
    let rows = query.fetch_all(pool).await.map_err(unreadable)?;
    rows.iter().map(|row| tenant_of(row, 0)).collect()
}
