//! A server under load: clients that drag, and a ledger in which every pose must be accounted for.

mod args;
pub(crate) mod client;
pub(crate) mod command;
pub(crate) mod ledger;
mod report;
pub(crate) mod server;

pub(crate) use args::StreamArgs;
