//! A server under load: clients that drag, and a ledger in which every pose must be accounted for.

mod answer_tally;
mod args;
mod beside;
mod beside_report;
pub(crate) mod client;
pub(crate) mod command;
pub(crate) mod ledger;
pub(crate) mod process;
mod report;
pub(crate) mod server;
mod sessions;
pub(crate) mod soak;
mod times;

pub(crate) use args::StreamArgs;
