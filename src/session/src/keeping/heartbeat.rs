//! A node of several renews its lease and finds sessions that it lost.
//!
//! A node that was stopped for longer than its lease does not know what happened meanwhile. It checks its own clock
//! before it serves a call: when its last renewal may be older than its lease, it renews first, and closes sessions
//! that others have taken.

use crate::error::Error;
use crate::shared::SharedResources;
use crate::store::{NodeLoad, SharedStore, StoreError};
use std::sync::atomic::Ordering::SeqCst;
use std::sync::{Arc, Weak};
use std::time::Duration;
use tokio::time::Instant;

/// How long a call waits for the database where the lease may have run out. After that the sessions in memory continue.
const PATIENCE: Duration = Duration::from_millis(500);

/// Renews the lease of this node until `shared` is dropped.
pub(crate) async fn beat_for_ever(shared: Weak<SharedResources>) {
    let mut was_away = false;
    loop {
        let Some(pause) = shared.upgrade().and_then(|shared| {
            let store = shared.store.clone()?;
            Some(store.ownership()?.node().heartbeat)
        }) else {
            return;
        };
        tokio::time::sleep(pause).await;
        let Some(shared) = shared.upgrade() else { return };
        let beaten = beat(&shared).await;
        if let (Err(error), false) = (&beaten, was_away) {
            tracing::warn!("the lease of this node cannot be renewed; the sessions in memory continue: {error}");
        }
        was_away = beaten.is_err();
    }
}

/// Renews the lease once, and closes sessions that others have taken.
pub(crate) async fn beat(shared: &SharedResources) -> Result<(), StoreError> {
    let Some(store) = shared.store.clone() else {
        return Ok(());
    };
    let Some(ownership) = store.ownership() else {
        return Ok(());
    };
    let _speaking = shared.lease_watch.speaking.lock().await;
    let begun = Instant::now();
    let reported = ownership.beat(load_of(shared)).await;
    let settled = match reported {
        Ok(true) => Ok(()),
        Ok(false) => let_go_of_lost(shared, ownership).await,
        Err(error) => Err(error),
    };
    shared.lease_watch.note(begun, settled.is_ok());
    settled
}

/// The load of this node.
pub(crate) fn load_of(shared: &SharedResources) -> NodeLoad {
    NodeLoad {
        sessions: shared.registry.all().len() as u64,
        most_sessions: shared.config.sessions as u64,
        memory_used: shared.ledger.used(),
        memory_total: shared.ledger.total(),
        work: u64::try_from(
            shared
                .metrics
                .pool_busy
                .get()
                .saturating_add(shared.metrics.pool_waiting.get()),
        )
        .unwrap_or_default(),
        is_leaving: shared.draining.load(SeqCst),
    }
}

/// Ends sessions here that other nodes have by now.
async fn let_go_of_lost(shared: &SharedResources, ownership: &SharedStore) -> Result<(), StoreError> {
    // Those in memory first: what is opened meanwhile is this node's.
    let here = shared.registry.all();
    let held = ownership.held().await?;
    for session in here {
        if held.get(&session.id) != Some(&session.held.generation) {
            shared.drop_ownership(&session);
        }
    }
    Ok(())
}

fn is_recent(at: Option<Instant>, span: Duration) -> bool {
    at.is_some_and(|at| at.elapsed() < span)
}

/// Refuses a change while the lease may have run out: another node may have the session and have changed it, so that what is in memory
/// here says nothing about what is allowed.
///
/// # Errors
/// `UNAVAILABLE`.
pub(crate) fn refuse_stale_state(shared: &SharedResources) -> Result<(), Error> {
    let ownership = shared.store.as_ref().and_then(|store| store.ownership());
    let has_lease = |of: &SharedStore| is_recent(shared.lease_watch.times().heard, of.node().lease);
    match ownership.is_none_or(has_lease) {
        true => Ok(()),
        false => Err(StoreError::Unavailable("the lease of this node may have run out".into()).into()),
    }
}

/// Renews the lease before a call when others may have taken sessions of this node. Without the database, sessions in
/// memory are served as they are; nothing can be written then.
pub(crate) async fn be_sure_of_lease(shared: &Arc<SharedResources>) {
    let Some(store) = shared.store.clone() else { return };
    let Some(node) = store.ownership().map(|ownership| ownership.node().clone()) else {
        return;
    };
    let times = shared.lease_watch.times();
    // No call waits again for a database that was away a moment ago.
    if is_recent(times.heard, node.lease) || is_recent(times.tried, node.heartbeat) {
        return;
    }
    let spoken = tokio::time::timeout(PATIENCE, beat(shared)).await;
    if spoken.is_err() {
        shared.lease_watch.note(Instant::now(), false);
    }
}
