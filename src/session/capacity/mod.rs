//! What a server has to give: memory, compute slots and time.

pub(super) mod call_gate;
pub(super) mod call_line;
pub(super) mod compute_slots;
pub(super) mod fair_line;
pub(super) mod lone_threads;
pub(super) mod memory_ledger;
pub(super) mod memory_use;
pub(super) mod session_lease;
pub(super) mod turn_queue;
pub(super) mod work_owner;
pub(super) mod work_span;
pub(super) mod work_watch;
