//! Why a command of the load test did not end well.

use std::fmt::Display;

/// Why the load test did not end well.
#[derive(Debug)]
pub(crate) enum LoadtestFailure {
    /// What was asked for makes no sense: exit code 2.
    Usage(String),
    /// The server or the solver failed, or the ledger does not balance: exit code 1.
    Server(String),
}

impl LoadtestFailure {
    /// A request that makes no sense.
    pub fn usage(problem: impl Display) -> Self {
        Self::Usage(problem.to_string())
    }

    /// A failure of what was measured.
    pub fn server(problem: impl Display) -> Self {
        Self::Server(problem.to_string())
    }

    /// Fails with all of these problems; succeeds where there are none.
    pub fn of_problems(problems: &[String]) -> Result<(), Self> {
        match problems {
            [] => Ok(()),
            problems => Err(Self::Server(problems.join("; "))),
        }
    }
}

impl From<tonic::Status> for LoadtestFailure {
    fn from(status: tonic::Status) -> Self {
        Self::Server(format!("the server answered {:?}: {}", status.code(), status.message()))
    }
}

/// Runs a command that waits for a server to its end.
pub(crate) fn block_on(command: impl Future<Output = Result<(), LoadtestFailure>>) -> Result<(), LoadtestFailure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.map_err(|e| LoadtestFailure::Server(format!("cannot start threads: {e}")))?;
    runtime.block_on(command)
}
