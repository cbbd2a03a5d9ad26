//! Why a server could not run.

/// Why a server could not run.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The services could not be put together.
    #[error("the services cannot start: {0}")]
    Start(String),
}
