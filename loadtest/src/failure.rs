//! Why a command of the load test did not end well.

/// Why the load test did not end well.
#[derive(Debug)]
pub(crate) enum LoadtestFailure {
    /// What was asked for makes no sense: exit code 2.
    Usage(String),
    /// The server or the solver failed, or the ledger does not balance: exit code 1.
    Server(String),
}

impl From<tonic::Status> for LoadtestFailure {
    fn from(status: tonic::Status) -> Self {
        Self::Server(format!("the server answered {:?}: {}", status.code(), status.message()))
    }
}
