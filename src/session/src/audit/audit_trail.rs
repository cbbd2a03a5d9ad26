//! Records what is not a commit: streams, exports, ends without a store.

use crate::audit::audit_entry::AuditEntry;
use crate::shared::SharedResources;

/// Records an action. When the store does not answer, the call continues and the entry goes to the log as an error.
pub(crate) async fn note(shared: &SharedResources, entry: AuditEntry) {
    let Some(store) = &shared.store else { return entry.log() };
    // A store that is only read records nothing.
    if !store.is_writable() {
        return;
    }
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
