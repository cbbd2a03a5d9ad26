//! What clients of a session can rely on, whatever the transport: the deform stream's promises, commits that can be undone
//! to the bit, limits, expiry, idempotency, draining. Most tests drive an engine whose cycles they control.

#[path = "paper/bench.rs"]
mod bench;
#[path = "session/commits.rs"]
mod commits;
#[path = "session/edits.rs"]
mod edits;
#[path = "session/fake.rs"]
mod fake;
#[path = "session/following.rs"]
mod following;
#[path = "session/life.rs"]
mod life;
#[path = "session/limits.rs"]
mod limits;
#[path = "session/real.rs"]
mod real;
#[path = "session/stream.rs"]
mod stream;
