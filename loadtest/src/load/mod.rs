//! A server under load: clients that drag, and a ledger in which every pose must be accounted for.

mod args;
mod client;
pub(crate) mod command;
mod ledger;
mod report;
mod server;

pub(crate) use args::StreamArgs;
