//! What is done for stored sessions from time to time: uses are noted, expired sessions and old keys are removed, and idle sessions
//! leave memory before a new one is refused.

use crate::answers::Tenant;
use crate::audit::audit_entry::{AuditEntry, AuditedAction};
use crate::registry::DepartingSessions;
use crate::registry::OpenSession;
use crate::shared::SharedResources;
use crate::store::{Generation, HeldSession, Store, StoreError, UsedSession};
use futures::StreamExt as _;
use futures::stream::FuturesUnordered;
use std::collections::BTreeMap;
use std::sync::atomic::Ordering::SeqCst;
use std::sync::{Arc, Weak};
use std::time::Duration;

/// Between two sweeps.
const PERIOD: Duration = Duration::from_secs(1);
/// Uses are noted so often at most: a crash may cost a session that much of its time.
const NOTED_EVERY: u32 = 5;
/// How long entries of the audit trail are kept unless a tenant's quota says otherwise.
const AUDIT_AGE: Duration = Duration::from_secs(400 * 24 * 3600);
/// Sweeps between two looks for sessions whose time is over, where several nodes look.
const SHARED_EVERY: u32 = 10;
/// Sweeps between two looks at the keys and the trail.
const KEYS_EVERY: u32 = 60;

/// Sweeps as long as there are sessions.
pub(crate) async fn sweep_for_ever(shared: Weak<SharedResources>) {
    let mut noted: BTreeMap<String, u64> = BTreeMap::new();
    let mut round = 0u32;
    loop {
        tokio::time::sleep(PERIOD).await;
        let Some(shared) = shared.upgrade() else { return };
        let Some(store) = shared.store.as_ref().filter(|store| store.is_writable()) else {
            return;
        };
        if shared.aborted.is_cancelled() {
            return;
        }
        round = round.wrapping_add(1);
        if let Err(error) = sweep(&shared, store, &mut noted, round).await {
            // Logged once a minute at most: calls report it too.
            if round.is_multiple_of(KEYS_EVERY) {
                tracing::warn!("the store of sessions does not answer: {error}");
            }
        }
    }
}

async fn sweep(
    shared: &SharedResources,
    store: &Store,
    noted: &mut BTreeMap<String, u64>,
    round: u32,
) -> Result<(), StoreError> {
    if round.is_multiple_of(NOTED_EVERY) {
        note_uses(shared, store, noted).await?;
    }
    let (since_ms, until_ms) = (shared.started_ms, shared.surroundings.now_ms());
    let others = store.ownership();
    let is_turn = others.is_none() || round.is_multiple_of(SHARED_EVERY);
    let expired = if is_turn {
        store.expired(since_ms, until_ms).await?
    } else {
        Vec::new()
    };
    for (tenant, id) in expired {
        let _lock = shared.locks.lock(&id).await;
        // One in memory knows its last use better.
        if shared.registry.holds(&id) {
            continue;
        }
        let generation = match others {
            None => Generation::default(),
            Some(others) => match others.claim_expired(&tenant, &id, since_ms, until_ms).await? {
                Some(generation) => generation,
                None => continue,
            },
        };
        let expired = AuditEntry::by_itself(&tenant, AuditedAction::Expire, &id);
        store.delete(expired, generation).await?;
        if let Ok(account) = shared.accounts.of(&tenant) {
            account.uncount_session();
        }
        shared.metrics.sessions_expired.inc();
        tracing::info!(session.id = %id, "stored session expired");
    }
    if round.is_multiple_of(KEYS_EVERY) {
        store
            .forget_keys(shared.surroundings.ms_ago(shared.config.idempotency_age))
            .await?;
        forget_audit(shared, store).await?;
    }
    if let Some(others) = others.filter(|_| is_turn) {
        others.remove_loose_objects().await?;
    }
    Ok(())
}

/// Forgets what was noted of tenants longer ago than is kept of them.
async fn forget_audit(shared: &SharedResources, store: &Store) -> Result<(), StoreError> {
    for tenant in store.audited_tenants().await? {
        let kept = shared.config.quotas.of(&tenant).audit_age.unwrap_or(AUDIT_AGE);
        let kept_ms = u64::try_from(kept.as_millis()).unwrap_or(u64::MAX);
        store
            .forget_audit(Some(tenant), shared.surroundings.now_ms().saturating_sub(kept_ms))
            .await?;
    }
    Ok(())
}

/// Notes when the sessions in memory were used last, where that has changed.
pub(crate) async fn note_uses(
    shared: &SharedResources,
    store: &Store,
    noted: &mut BTreeMap<String, u64>,
) -> Result<(), StoreError> {
    let sessions = shared.registry.all().into_iter();
    let uses = sessions.map(|session| {
        (
            session.held.clone(),
            shared.surroundings.ms_ago(session.lease.last_use().elapsed()),
        )
    });
    let held: Vec<(HeldSession, u64)> = uses.collect();
    let uses: BTreeMap<String, u64> = held.iter().map(|(held, at)| (held.id.clone(), *at)).collect();
    let changed = |(held, at): &(HeldSession, u64)| noted.get(&held.id).is_none_or(|before| *at > before + 500);
    let sessions: Vec<UsedSession> = (held.into_iter())
        .filter(changed)
        .map(|(session, used_ms)| UsedSession { session, used_ms })
        .collect();
    if !sessions.is_empty() {
        store.note_use(sessions).await?;
    }
    *noted = uses;
    Ok(())
}

/// How long an idle session may take to leave.
const PATIENCE: Duration = Duration::from_secs(5);

/// Asks the session that was idle for the longest time to leave memory, and waits for it; of one tenant's sessions where it is named.
/// Sessions that are on their way out anyway come first, and need no asking. False when none can leave.
pub(crate) async fn evict_idle(shared: &SharedResources, tenant: Option<&Tenant>) -> bool {
    if has_departed(&shared.registry.departing, tenant).await {
        return true;
    }
    if shared.store.is_none() {
        return false;
    }
    let is_idle = |s: &Arc<OpenSession>| {
        !s.closing.is_cancelled() && s.streams.all().is_empty() && !s.animations.is_any() && !s.busy.load(SeqCst)
    };
    let mut idle = shared.registry.all();
    idle.retain(|s| tenant.is_none_or(|tenant| s.tenant == *tenant) && is_idle(s));
    idle.sort_by_key(|s| s.lease.last_use());
    for session in idle {
        session.leave.store(true, SeqCst);
        session.wake.notify_one();
        let left = tokio::time::timeout(PATIENCE, session.ended.cancelled()).await;
        if left.is_ok() {
            return true;
        }
        session.leave.store(false, SeqCst);
    }
    // Meanwhile one may have gone on its own.
    has_departed(&shared.registry.departing, tenant).await
}

/// Whether a session that was going has gone, which is waited for.
async fn has_departed(departing: &DepartingSessions, tenant: Option<&Tenant>) -> bool {
    if departing.take_ended() {
        return true;
    }
    let ends = departing.under_way(tenant);
    let mut ends: FuturesUnordered<_> = ends.iter().map(|ended| ended.cancelled()).collect();
    !ends.is_empty() && tokio::time::timeout(PATIENCE, ends.next()).await.is_ok()
}
