//! Why a store did not do what was asked.

use crate::session::error::{Error, ErrorCode};
use futures::future::BoxFuture;

/// Why a store did not do what was asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    /// It cannot be reached or written: a full disk, a lost permission, a database that is down. Later it may work.
    #[error("{0}")]
    Unavailable(String),
    /// What it holds is not what was written.
    #[error("{0}")]
    Damaged(String),
    /// It cannot be used as it is: written by a later version, or used by another process.
    #[error("{0}")]
    Refused(String),
    /// Another node has the session now. Nothing was written.
    #[error("another node has the session now")]
    Moved,
    /// Another call with the same idempotency key was faster, at another node. Nothing was written.
    #[error("another call with this idempotency key was carried out meanwhile")]
    Repeated,
}

impl From<StoreError> for Error {
    fn from(error: StoreError) -> Self {
        match error {
            // Paths and what a database says are the operator's alone.
            StoreError::Unavailable(problem) => {
                tracing::warn!("the store of sessions: {problem}");
                let text =
                    "the store of sessions cannot be read or written at present; nothing has changed, try again later";
                Self {
                    retry_after_s: Some(1),
                    ..Self::new(ErrorCode::Unavailable, text)
                }
            }
            StoreError::Damaged(problem) => {
                tracing::error!("what is stored of a session is damaged: {problem}");
                let text = format!("what is stored of the session is damaged and is not served: {problem}");
                Self::new(ErrorCode::DataLoss, text)
            }
            StoreError::Refused(problem) => Self::new(ErrorCode::FailedPrecondition, problem),
            StoreError::Moved => Self::moved(),
            StoreError::Repeated => Self {
                retry_after_s: Some(1),
                ..Self::new(ErrorCode::Aborted, StoreError::Repeated.to_string())
            },
        }
    }
}

/// The answer of a store, to come.
pub type Stored<'a, T> = BoxFuture<'a, Result<T, StoreError>>;
