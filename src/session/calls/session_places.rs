//! What a session takes before it is opened: a seat among all sessions, memory, and a place among those of its tenant.

use crate::session::answers::Tenant;
use crate::session::capacity::memory_ledger::{MemoryReservation, MemoryShortage};
use crate::session::capacity::memory_use::MemoryUse;
use crate::session::error::{Error, ErrorCode};
use crate::session::keeping::made_room::make_room;
use crate::session::quota::tenant_account::{BytesToStore, TenantAccount, TenantSession};
use crate::session::shared::SharedResources;
use std::sync::Arc;
use tokio::sync::OwnedSemaphorePermit;

/// Bytes that a build is expected to need for each uploaded byte, until its real size is known.
const BYTES_PER_UPLOADED_BYTE: u64 = 32;
/// Bytes below which no build is tried.
const LEAST_BYTES: u64 = 1 << 20;

/// Why a model is not open.
pub(in crate::session) enum OpeningRefusal {
    /// The tenant's sessions hold what it would take.
    TenantMemory(Error),
    /// All sessions hold what it would take.
    ServerMemory(Error),
    Other(Error),
}

impl From<Error> for OpeningRefusal {
    fn from(error: Error) -> Self {
        Self::Other(error)
    }
}

/// What a session has taken. Given back when dropped.
pub(in crate::session) struct SessionPlaces {
    pub seat: OwnedSemaphorePermit,
    pub memory: Arc<MemoryReservation>,
    /// The place among the sessions of the tenant.
    pub of_tenant: TenantSession,
}

impl SessionPlaces {
    /// Takes a place among the sessions of the tenant, a seat, and the memory that a model of `upload` bytes is likely to need. Idle
    /// sessions that are kept make room for it.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED`.
    pub async fn reserve(shared: &SharedResources, of_tenant: TenantSession, upload: u64) -> Result<Self, Error> {
        loop {
            match take_place(shared, of_tenant.account(), upload) {
                Err((error, shortage)) => {
                    let whose = matches!(shortage, Some(MemoryShortage::Tenant { .. })).then(|| of_tenant.tenant());
                    if !make_room(shared, whose).await {
                        return Err(count_refusal(shared, error));
                    }
                }
                Ok((seat, memory)) => {
                    return Ok(Self {
                        seat,
                        memory,
                        of_tenant,
                    });
                }
            }
        }
    }

    /// Counts what an opened model holds.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` where that is more than the server or the tenant may hold.
    pub fn admit(&self, shared: &SharedResources, held: u64) -> Result<(), OpeningRefusal> {
        let Err(shortage) = self.memory.grow_to(held) else {
            let _ = self.memory.resize(held);
            return Ok(());
        };
        let text = format!("the session would need {held} bytes of memory, and {shortage}");
        Err(match shortage {
            MemoryShortage::Server { .. } => OpeningRefusal::ServerMemory(no_place(text)),
            MemoryShortage::Tenant { .. } => {
                OpeningRefusal::TenantMemory(no_place_until(shared, text, self.of_tenant.tenant()))
            }
        })
    }
}

/// Says why a session finds no place; it may find one yet, when idle sessions make room.
pub(in crate::session) fn no_place(text: String) -> Error {
    Error::exhausted(text, 5)
}

/// Counts a call that ends because there is no place.
pub(in crate::session) fn count_refusal(shared: &SharedResources, error: Error) -> Error {
    shared.metrics.refused.inc();
    error
}

/// The same for what one of the tenant's own sessions would make room for: the first of them that may end.
pub(in crate::session) fn no_place_until(shared: &SharedResources, text: String, tenant: &Tenant) -> Error {
    let wait = shared.registry.soonest_end(tenant).as_secs().saturating_add(1);
    Error {
        retry_after_s: u32::try_from(wait).ok(),
        ..no_place(text)
    }
}

/// Takes a place for one more session of the tenant, whose model has `upload` bytes.
///
/// # Errors
/// `RESOURCE_EXHAUSTED` where the tenant has as many as it may have, or as many bytes in the store; `UNAVAILABLE` when the store does not
/// answer.
pub(in crate::session) async fn place_of_tenant(
    shared: &SharedResources,
    tenant: &Tenant,
    upload: u64,
) -> Result<TenantSession, Error> {
    let account = shared.accounts.of(tenant)?;
    let counted = |_: &Error| {
        shared.metrics.refused.inc();
    };
    let storing = announce_stored(shared, &account, upload).await.inspect_err(counted)?;
    if let (Some(store), Some(_)) = (&shared.store, account.quota().sessions)
        && store.ownership().is_some()
    {
        // Other nodes open and delete them too.
        account.recount(store.count_sessions(tenant.clone()).await?);
    }
    let place = account.take_session(|| shared.registry.soonest_end(tenant));
    Ok(place.inspect_err(counted)?.with_stored(storing))
}

/// Takes `more` bytes of what a tenant may store, until what this returns is dropped: after they were written. `None` where it may
/// store as much as it likes.
///
/// # Errors
/// `RESOURCE_EXHAUSTED`; too large where it never may; `UNAVAILABLE` when the store does not answer.
pub(in crate::session) async fn announce_stored(
    shared: &SharedResources,
    account: &Arc<TenantAccount>,
    more: u64,
) -> Result<Option<BytesToStore>, Error> {
    let (Some(store), Some(most)) = (&shared.store, account.stored_quota()) else {
        return Ok(None);
    };
    if more > most {
        let text = format!("{more} bytes are to be stored, your quota allows {most}");
        return Err(Error::new(ErrorCode::TooLarge, text));
    }
    let settled = account.settled_bytes();
    let used = store.stored_bytes(account.tenant().clone()).await?;
    let announced = account.announce_stored(more, used, settled);
    announced.map(Some).ok_or_else(|| {
        let text = format!(
            "your sessions hold {used} bytes in the store, {more} more are to be stored and your quota allows {most}; delete a session"
        );
        Error::exhausted(text, 60)
    })
}

fn take_place(
    shared: &SharedResources,
    account: &Arc<TenantAccount>,
    upload: u64,
) -> Result<(OwnedSemaphorePermit, Arc<MemoryReservation>), (Error, Option<MemoryShortage>)> {
    let seat = Arc::clone(&shared.seats).try_acquire_owned().map_err(|_| {
        let text = format!(
            "{} sessions are open, no more are allowed; delete one or wait for one to expire",
            shared.config.sessions
        );
        (no_place(text), None)
    })?;
    let likely = upload
        .saturating_mul(BYTES_PER_UPLOADED_BYTE)
        .saturating_add(LEAST_BYTES);
    let of_quota = account.memory_quota().unwrap_or(LEAST_BYTES);
    let least = LEAST_BYTES.min(of_quota).max(upload);
    let memory = (shared.ledger).reserve(MemoryUse::Sessions, Some(account), least, likely);
    let memory = memory.map_err(|shortage| {
        let text = format!("the session would need {least} bytes of memory, and {shortage}");
        (no_place(text), Some(shortage))
    })?;
    Ok((seat, Arc::new(memory)))
}
