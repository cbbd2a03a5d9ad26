//! What clients of a session can rely on, whatever the transport: the deform stream's promises, commits that can be undone
//! bit for bit, limits, expiry, idempotency, draining. Most tests drive an engine whose cycles they control.

use crate::support::bench;
mod commits;
mod edits;
mod fake;
mod faulty_store;
mod life;
mod limits;
mod real;
mod refused_memory;
mod starts;
mod store_faults;
mod stream;
mod targets;
