//! Sessions, stores and nodes under one seed.
//!
//! The code under test is that of the product: managers, sessions, idempotency keys, leases, the store with its writer and its objects.
//! Network and clock are turmoil's. Models are the database (`tables`), the bucket and the engine of half the clients; they delay,
//! lose answers, tear objects and refuse memory. Work is computed while its caller waits, so a seed gives the same run each time.
//!
//! | file | what |
//! |---|---|
//! | `run` | a run: hosts, faults, what must hold at the end |
//! | `client`, `calls` | who makes calls, and what must hold after each |
//! | `node`, `engine` | a node and its engine |
//! | `tables`, `connection`, `bucket` | what is stored, and how nodes reach it |
//! | `post`, `faults`, `random`, `time`, `report` | questions across the network, what goes wrong, seeds, time, what was seen |

mod bucket;
mod calls;
mod client;
mod connection;
mod engine;
mod faults;
mod node;
mod post;
mod random;
mod report;
mod run;
mod tables;
mod time;

pub use report::Outcome;
pub use run::run;
pub use tables::OldBug;
