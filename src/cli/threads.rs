//! The thread budget of commands that compute in process.

use super::failure::CliFailure;
use crate::pool::Pool;
use clap::Args;

/// The thread budget of commands that compute in process.
#[derive(Debug, Args)]
pub(super) struct ThreadArgs {
    /// Compute threads; 0 means one per core
    #[arg(long, env = "PLIANT_THREADS", default_value_t = 0)]
    threads: usize,
}

impl ThreadArgs {
    /// Starts the pool that the arguments ask for.
    pub fn start_pool(&self) -> Result<Pool, CliFailure> {
        if self.threads > 1024 {
            return Err(CliFailure::Input(format!(
                "--threads is {}, allowed are 0 to 1024",
                self.threads
            )));
        }
        Pool::new(self.threads).map_err(|e| CliFailure::Internal(e.to_string()))
    }
}
