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

    /// Fails with all of these problems; succeeds where there are none.
    pub fn of_problems(problems: &[String]) -> Result<(), Self> {
        match problems {
            [] => Ok(()),
            problems => Err(Self::Server(problems.join("; "))),
        }
    }
}

/// Errors without a place of their own are failures of what was measured.
impl<E: std::error::Error + 'static> From<E> for LoadtestFailure {
    fn from(error: E) -> Self {
        let status = (&error as &dyn std::any::Any).downcast_ref::<tonic::Status>();
        Self::Server(status.map_or_else(
            || error.to_string(),
            |status| format!("the server answered {:?}: {}", status.code(), status.message()),
        ))
    }
}

/// Runs a command that waits for a server to its end.
pub(crate) fn block_on(command: impl Future<Output = Result<(), LoadtestFailure>>) -> Result<(), LoadtestFailure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(command)
}
