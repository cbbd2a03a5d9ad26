//! Sessions: models held open, their commits, and the interactive stream.
//!
//! Owns what lives between two requests: the registry of sessions, the task of each session, memory and compute budgets,
//! idempotency keys, expiry. Knows nothing of transports: `server` translates and calls [`Manager`]. Deforms nothing:
//! that is the job floor's [`Workbench`](crate::engine::Deformer), behind [`Engine`].
//!
//! One task owns each session and is the only one that touches its engine. Work moves the engine to the compute pool and back;
//! everybody else reads a published view. So no lock is held across an await or a parallel section: the locks here
//! guard a few fields each, for the length of a function that neither waits nor computes, and none is taken while another
//! is held, except that a mailbox or a reservation may count something.
//!
//! | file | what |
//! |---|---|
//! | `manager`, `create`, `drain` | the calls of all transports; opening a session; stopping them all |
//! | `actor`, `drag`, `requests` | a session's task: commits, one turn of a stream, what it is asked |
//! | `commits`, `bench` | the ordered commits and their shapes; the engine and what it holds |
//! | `stream`, `mailbox`, `waiting`, `outgoing` | a stream's ends, its books, poses that wait, frames on their way out |
//! | `registry`, `expiry`, `gate` | who is there, for how long, and who is still inside |
//! | `compute`, `budget`, `stop` | compute slots, bytes, giving work up |
//! | `idempotency`, `config`, `error`, `metrics`, `answers` | keys, limits, the status table, counts, answer types |

mod actor;
mod answers;
mod bench;
mod budget;
mod commits;
mod compute;
mod config;
mod create;
mod drag;
mod drain;
mod edits;
mod engine;
mod error;
mod expiry;
mod gate;
mod idempotency;
mod mailbox;
mod manager;
mod metrics;
mod outgoing;
mod registry;
mod requests;
mod stop;
mod stream;
mod waiting;

pub use answers::{Answer, Exported, Positions, SolvedFrames, Tenant};
pub use config::{Config, MIN_TTL};
pub use engine::{Engine, OpenWorkbench, Opener};
pub use error::{Code, Error};
pub use manager::Manager;
pub use metrics::Metrics;
pub use stream::{Stream, StreamInput, StreamOutput};
