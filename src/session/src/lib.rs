//! Sessions: models held open, their commits, and the interactive stream.
//!
//! Owns what lives between two requests: the registry of sessions, the task of each session, memory and compute budgets,
//! idempotency keys, expiry. Knows nothing of transports: `server` has `wire` read a request and calls [`Manager`] with values of the
//! engine. Facts of a session, reports of edits and headers of frames are the schema's messages. Deforms nothing: that is the engine's
//! [`Deformer`](pliant_core::engine::Deformer), behind [`Engine`].
//!
//! One task owns each session and is the only one that touches its engine. Work moves the engine to the compute pool and back;
//! everybody else reads a published view. So no lock is held across an await or a parallel section: the locks here
//! guard a few fields each, for the length of a function that neither waits nor computes, and none is taken while another
//! is held, except that a mailbox or a reservation may count something.
//!
//! | module | what |
//! |---|---|
//! | `calls` | the calls of all transports, their idempotency keys, opening sessions and stopping them all |
//! | `task` | a session's task: commits, edits, one turn of a stream |
//! | `history` | the ordered commits and their shapes; the engine and what it holds |
//! | `stream` | a stream's ends, its state, poses that wait, frames on their way out |
//! | `animation` | an animation's task, its frames on their way out, its ends |
//! | `audit` | who opened, changed and took away what |
//! | `quota` | what each tenant may use, and what it uses |
//! | `capacity` | compute slots, bytes, leases, who is still inside, giving work up |
//! | `registry`, `shared` | the sessions that are open, and what they share |
//! | `engine` | what a session needs of the thing that deforms its model |
//! | `surroundings` | what it needs of the machine: the calendar, random bits |
//! | `keeping` | sessions with a store: commits kept, idle sessions out of memory and back |
//! | `store` | sessions kept on disk: a database, and objects by content |
//! | `config`, `error`, `metrics`, `answers` | limits, the status table and where a session is when it is at another node, counts, answer types |

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

mod animation;
mod answers;
mod audit;
mod calls;
mod capacity;
mod config;
mod engine;
mod error;
mod history;
mod keeping;
mod metrics;
mod quota;
mod registry;
mod shared;
pub mod store;
mod stream;
mod surroundings;
mod task;

pub use animation::frame_outbox::{AnimationControl, AnimationReader};
pub use answers::{
    AnimatedModel, AnimationAnswer, CallKey, CommittedPose, ExportedModel, KeyedAnswer, PositionBuffer, SessionList,
    StreamAnswer, Tenant, TransferredModel,
};
pub use audit::audit_entry::{AuditEntry, AuditedAction, StoredAuditEntry};
pub use calls::manager::Manager;
pub use capacity::call_queue::MIN_TTL;
pub use capacity::compute_slots::SLOTS_FOR_ANOTHER_TENANT;
pub use capacity::memory_ledger::{MemoryLedger, MemoryReservation, MemoryShortage};
pub use capacity::memory_use::MemoryUse;
pub use capacity::work_watch::{SPANS, WorkKind};
pub use config::SessionConfig;
pub use engine::{Engine, EngineOpener, OpenDeformer};
pub use error::OwnerAddress;
pub use error::{Error, ErrorCode};
pub use metrics::Metrics;
pub use quota::tenant_account::MOST_TENANTS;
pub use quota::tenant_account::TenantAccount;
pub use quota::tenant_quota::{TenantQuota, TenantQuotas};
pub use stream::ends::{StreamInput, StreamOutput};
pub use surroundings::{RealSurroundings, Surroundings};
