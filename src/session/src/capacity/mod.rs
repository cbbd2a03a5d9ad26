//! What a server has to give: memory, compute slots and time.

pub(super) mod call_queue;
pub(super) mod compute_slots;
pub(super) mod fair_line;
pub(super) mod memory_ledger;
pub(super) mod memory_use;
pub(super) mod work_watch;
