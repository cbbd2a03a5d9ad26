//! Notes what is no commit: streams, exports, what goes away without a store.

use crate::session::audit::audit_entry::AuditEntry;
use crate::session::shared::SharedResources;

/// Notes what somebody did. A store that does not answer stops nobody who reads: the entry goes to the log as an error then.
pub(in crate::session) async fn note(shared: &SharedResources, entry: AuditEntry) {
    let Some(store) = &shared.store else { return entry.log() };
    if let Err(error) = store.audit(entry.clone()).await {
        shared.metrics.store_failures.inc();
        let AuditEntry {
            tenant,
            who,
            what,
            session,
        } = entry;
        tracing::error!(
            target: "pliant::audit",
            tenant = &*tenant.0,
            caller = &*who,
            action = what.name(),
            session.id = %session,
            "{what} by {who} could not be noted in the store: {error}"
        );
    }
}
