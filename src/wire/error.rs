//! What can be wrong with a request.

use crate::asset;

/// Why a request was refused or could not be carried out. Nothing has changed when one of these is returned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The model cannot be read or written.
    #[error(transparent)]
    Asset(#[from] asset::Error),
    /// A text is not the JSON of the message that was expected.
    #[error("{place}: {problem}")]
    Json {
        /// Path of the field, such as `handles[1].region`, or a line and column.
        place: String,
        /// What was seen and what is allowed.
        problem: String,
    },
    /// A field has a value that is not allowed.
    #[error("{field}: {problem}")]
    Invalid {
        /// Path of the field in JSON names, such as `handles[1].pose.scale`.
        field: String,
        /// What was seen and what is allowed.
        problem: String,
    },
    /// The request does not fit the session's present state.
    #[error("{0}")]
    Precondition(String),
    /// Part of the contract that this server does not do.
    #[error("{0} is not implemented by this version")]
    Unimplemented(String),
    /// More than the limits allow.
    #[error("{what} is {seen}, at most {limit} is allowed")]
    TooLarge {
        /// What is too large.
        what: &'static str,
        /// The size seen.
        seen: u64,
        /// The size allowed.
        limit: u64,
    },
    /// Nobody wants the result any more.
    #[error("cancelled")]
    Cancelled,
    /// A defect of the server.
    #[error("internal: {0}")]
    Internal(String),
}

impl Error {
    /// A field has a value that is not allowed.
    pub fn invalid(field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Invalid {
            field: field.into(),
            problem: problem.into(),
        }
    }
}

impl From<crate::progress::Cancelled> for Error {
    fn from(_: crate::progress::Cancelled) -> Self {
        Self::Cancelled
    }
}
