//! Idle sessions that are kept leave memory before a new one is refused.

use crate::session::answers::Tenant;
use crate::session::departing_sessions::DepartingSessions;
use crate::session::registry::OpenSession;
use crate::session::shared::SharedResources;
use futures::StreamExt as _;
use futures::stream::FuturesUnordered;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use std::time::Duration;

/// How long an idle session may take to leave.
const PATIENCE: Duration = Duration::from_secs(5);

/// Asks the session that was idle for the longest time to leave memory, and waits for it; of one tenant's sessions where it is named.
/// Sessions that are on their way out anyway come first, and need no asking. False when none can leave.
pub(in crate::session) async fn make_room(shared: &SharedResources, tenant: Option<&Tenant>) -> bool {
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
    // Meanwhile one may have gone by itself.
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
