//! A server under load: clients that drag, and a ledger in which every pose must be accounted for.

mod beside;
pub(crate) mod client;
mod ledger;
pub(crate) mod server;
mod sessions;
pub(crate) mod soak;
pub(crate) mod stream;

use clap::Parser as _;
use pliant::wire::pb::frame;
use std::path::PathBuf;
use std::time::Duration;

/// Arguments of `loadtest stream`.
#[derive(Debug, Clone, clap::Parser)]
pub(crate) struct StreamArgs {
    /// URL of the server to load, loopback only, such as http://127.0.0.1:7411 [default: a server in this process]
    #[arg(long, value_name = "URL")]
    pub server: Option<String>,
    /// Model file of every session [default: the built-in creature]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Poses of every client
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub poses: u32,
    /// Poses per second of every client
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub hz: u32,
    /// Clients, each with a session of its own
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub clients: u32,
    /// Numbers of sessions, one table row each, such as 1,4,16,64,256, instead of one report. The server is then a
    /// separate process, whose memory the table lists
    #[arg(long, value_name = "N,N", value_delimiter = ',', num_args = 1..=8, conflicts_with_all = ["clients", "server"],
        value_parser = clap::value_parser!(u32).range(1..=256))]
    pub sessions: Vec<u32>,
    /// Number of clients that solve without pause beside a second drag. The server is then a separate process
    #[arg(long, value_name = "N", conflicts_with_all = ["sessions", "server"],
        value_parser = clap::value_parser!(u32).range(1..=192))]
    pub beside: Option<u32>,
    /// Length of the compute queue of the server of `--beside` [default: the server's]
    #[arg(long, value_name = "N", requires = "beside", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub queue: Option<u32>,
    /// Maximum seconds of sending, even if poses are left
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=600))]
    pub seconds: u32,
    /// Unacknowledged frames in flight
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub window: u32,
    /// Relative residual to reach
    #[arg(long, default_value_t = 1e-4)]
    pub tolerance: f64,
    /// Request progressive frames
    #[arg(long)]
    pub progressive: bool,
    /// Encoding of frames
    #[arg(long, value_enum, default_value_t = EncodingChoice::F32)]
    pub encoding: EncodingChoice,
    /// Print one JSON document on stdout
    #[arg(long)]
    pub json: bool,
}

/// How frames are packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum EncodingChoice {
    F32,
    U16,
    Meshopt,
    Delta,
}

impl From<EncodingChoice> for frame::Encoding {
    fn from(choice: EncodingChoice) -> Self {
        match choice {
            EncodingChoice::F32 => Self::F32,
            EncodingChoice::U16 => Self::U16,
            EncodingChoice::Meshopt => Self::Meshopt,
            EncodingChoice::Delta => Self::Delta,
        }
    }
}

impl StreamArgs {
    /// A few poses in quick succession.
    pub fn short() -> Self {
        Self::parse_from(["stream", "--poses", "4", "--hz", "500", "--tolerance", "1e-3"])
    }

    /// The time from the start at which the pose after `sent` others is due.
    pub fn pose_due_at(&self, sent: u64) -> Duration {
        Duration::from_secs_f64(sent as f64 / f64::from(self.hz))
    }
}
