//! The errors of calls, and the one table from failures to status codes of every transport; with where a session is when it is
//! at another node.

use std::fmt;

/// The kinds of failure. Closed: a new kind needs a row in the table below.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ErrorCode {
    /// The request cannot be taken as it is.
    InvalidArgument {
        /// True when it cannot be read at all, false when it reads well but a value is not allowed.
        malformed: bool,
    },
    /// No such session, handle or page; also another tenant's.
    NotFound,
    /// It exists already.
    AlreadyExists,
    /// It collides with a call that is under way.
    Aborted,
    /// The caller is unknown.
    Unauthenticated,
    /// The caller may not.
    PermissionDenied,
    /// A quota or the server's capacity is used up; later it may work.
    ResourceExhausted,
    /// One request is larger than the limits allow; later will not help.
    TooLarge,
    /// The session's state does not fit the request.
    FailedPrecondition,
    /// Part of the contract that this server does not do.
    Unimplemented,
    /// It took longer than allowed.
    DeadlineExceeded,
    /// The server is going away.
    Unavailable,
    /// What was stored is damaged.
    DataLoss,
    /// A defect of the server.
    Internal,
    /// The caller gave up.
    Cancelled,
}

impl ErrorCode {
    /// gRPC status number, HTTP status and name. The only place where they are written down.
    const fn row(self) -> (i32, u16, &'static str) {
        match self {
            Self::Cancelled => (1, 499, "CANCELLED"),
            Self::InvalidArgument { malformed: true } => (3, 400, "INVALID_ARGUMENT"),
            Self::InvalidArgument { malformed: false } => (3, 422, "INVALID_ARGUMENT"),
            Self::DeadlineExceeded => (4, 504, "DEADLINE_EXCEEDED"),
            Self::NotFound => (5, 404, "NOT_FOUND"),
            Self::AlreadyExists => (6, 409, "ALREADY_EXISTS"),
            Self::PermissionDenied => (7, 403, "PERMISSION_DENIED"),
            Self::ResourceExhausted => (8, 429, "RESOURCE_EXHAUSTED"),
            Self::TooLarge => (8, 413, "RESOURCE_EXHAUSTED"),
            Self::FailedPrecondition => (9, 409, "FAILED_PRECONDITION"),
            Self::Aborted => (10, 409, "ABORTED"),
            Self::Unimplemented => (12, 501, "UNIMPLEMENTED"),
            Self::Internal => (13, 500, "INTERNAL"),
            Self::Unavailable => (14, 503, "UNAVAILABLE"),
            Self::DataLoss => (15, 500, "DATA_LOSS"),
            Self::Unauthenticated => (16, 401, "UNAUTHENTICATED"),
        }
    }

    /// The gRPC status number.
    pub const fn grpc(self) -> i32 {
        self.row().0
    }

    /// The HTTP status.
    pub const fn http(self) -> u16 {
        self.row().1
    }

    /// The name in capitals, as gRPC spells it.
    pub const fn name(self) -> &'static str {
        self.row().2
    }
}

/// Why a call failed. Nothing has changed when one of these is returned.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Error {
    /// The kind.
    pub code: ErrorCode,
    /// What was seen and what is allowed.
    pub message: String,
    /// Path of the field that is wrong, in JSON names, where there is one.
    pub field: Option<String>,
    /// Seconds after which trying again makes sense.
    pub retry_after_s: Option<u32>,
    /// The node to ask instead, where there is one.
    pub owner: Option<Box<OwnerAddress>>,
}

impl Error {
    /// An error of any kind.
    pub fn new(code: ErrorCode, message: impl Into<String>) -> Self {
        Self {
            code,
            message: message.into(),
            field: None,
            retry_after_s: None,
            owner: None,
        }
    }

    /// A field has a value that is not allowed.
    pub fn invalid(field: impl Into<String>, problem: impl fmt::Display) -> Self {
        let field = field.into();
        let message = format!("{field}: {problem}");
        Self {
            field: Some(field),
            ..Self::new(ErrorCode::InvalidArgument { malformed: false }, message)
        }
    }

    /// The request cannot be read.
    pub fn malformed(message: impl Into<String>) -> Self {
        Self::new(ErrorCode::InvalidArgument { malformed: true }, message)
    }

    /// No such session, or one of another tenant.
    pub fn no_session(id: &str) -> Self {
        // An id comes from outside and may be of any length.
        let shown: String = id.chars().take(64).collect();
        Self::new(
            ErrorCode::NotFound,
            format!("no session \"{shown}\"; it may have expired or been deleted"),
        )
    }

    /// A capacity is used up; `retry_after_s` says when to try again.
    pub fn exhausted(message: impl Into<String>, retry_after_s: u32) -> Self {
        Self {
            retry_after_s: Some(retry_after_s),
            ..Self::new(ErrorCode::ResourceExhausted, message)
        }
    }

    /// The server is going away.
    pub fn draining() -> Self {
        let text = "the server is shutting down; try again, another instance will answer";
        Self {
            retry_after_s: Some(1),
            ..Self::new(ErrorCode::Unavailable, text)
        }
    }

    /// The session is at another node.
    pub fn elsewhere(owner: OwnerAddress) -> Self {
        let text = format!("the session is at another node; ask {}", owner.address);
        Self {
            retry_after_s: Some(1),
            owner: Some(Box::new(owner)),
            ..Self::new(ErrorCode::Unavailable, text)
        }
    }

    /// Another node has more room for a new session.
    pub fn placed(owner: OwnerAddress) -> Self {
        let text = format!("another node has more room for a new session; ask {}", owner.address);
        Self {
            retry_after_s: Some(1),
            owner: Some(Box::new(owner)),
            ..Self::new(ErrorCode::Unavailable, text)
        }
    }

    /// Another node has taken the session.
    pub fn moved() -> Self {
        let text =
            "another node has taken the session; nothing has changed; repeat the call, and the answer names that node";
        Self {
            retry_after_s: Some(1),
            ..Self::new(ErrorCode::Unavailable, text)
        }
    }

    /// The gRPC status number.
    pub fn grpc_code(&self) -> i32 {
        self.code.grpc()
    }

    /// The HTTP status.
    pub fn http_status(&self) -> u16 {
        self.code.http()
    }

    /// The name in capitals, such as `INVALID_ARGUMENT`.
    pub fn code_name(&self) -> &'static str {
        self.code.name()
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Error {}

impl From<pliant_wire::Error> for Error {
    fn from(error: pliant_wire::Error) -> Self {
        let message = error.to_string();
        match error {
            pliant_wire::Error::Asset(error) => error.into(),
            pliant_wire::Error::Clip(pliant_motion::Error::TooMany { .. }) => Self::new(ErrorCode::TooLarge, message),
            pliant_wire::Error::Clip(_) => Self {
                field: Some("clip".into()),
                ..Self::malformed(message)
            },
            pliant_wire::Error::Malformed { field, .. } => Self {
                field: Some(field),
                ..Self::malformed(message)
            },
            pliant_wire::Error::Invalid { field, .. } => Self {
                field: Some(field),
                ..Self::new(ErrorCode::InvalidArgument { malformed: false }, message)
            },
            pliant_wire::Error::NoSuchFrames { .. } => Self {
                field: Some("first".into()),
                ..Self::new(ErrorCode::InvalidArgument { malformed: false }, message)
            },
            pliant_wire::Error::Precondition(_) => Self::new(ErrorCode::FailedPrecondition, message),
            pliant_wire::Error::Unimplemented(_) => Self::new(ErrorCode::Unimplemented, message),
            pliant_wire::Error::TooLarge { .. } => Self::new(ErrorCode::TooLarge, message),
            pliant_wire::Error::Cancelled => Self::new(ErrorCode::Cancelled, message),
            pliant_wire::Error::Internal(_) => Self::new(ErrorCode::Internal, message),
        }
    }
}

impl From<pliant_asset::Error> for Error {
    fn from(error: pliant_asset::Error) -> Self {
        let code = match &error {
            pliant_asset::Error::UnknownFormat { .. } | pliant_asset::Error::Malformed { .. } => {
                ErrorCode::InvalidArgument { malformed: true }
            }
            pliant_asset::Error::TooLarge { .. } => ErrorCode::TooLarge,
            pliant_asset::Error::NotStarted(_) => ErrorCode::Unavailable,
            _ => ErrorCode::InvalidArgument { malformed: false },
        };
        Self::new(code, error.to_string())
    }
}

/// The node that has a session, for its callers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OwnerAddress {
    /// The address that clients call, such as `https://10.0.0.5:7411`.
    pub address: String,
    /// Its name, by which a proxy selects a node.
    pub node: String,
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_asset::Format;

    /// The table of the contract, written a second time by hand: a changed row is a changed contract.
    #[test]
    fn status_table_is_the_contract() {
        let table = [
            (
                ErrorCode::InvalidArgument { malformed: true },
                3,
                400,
                "INVALID_ARGUMENT",
            ),
            (
                ErrorCode::InvalidArgument { malformed: false },
                3,
                422,
                "INVALID_ARGUMENT",
            ),
            (ErrorCode::NotFound, 5, 404, "NOT_FOUND"),
            (ErrorCode::AlreadyExists, 6, 409, "ALREADY_EXISTS"),
            (ErrorCode::Aborted, 10, 409, "ABORTED"),
            (ErrorCode::Unauthenticated, 16, 401, "UNAUTHENTICATED"),
            (ErrorCode::PermissionDenied, 7, 403, "PERMISSION_DENIED"),
            (ErrorCode::ResourceExhausted, 8, 429, "RESOURCE_EXHAUSTED"),
            (ErrorCode::TooLarge, 8, 413, "RESOURCE_EXHAUSTED"),
            (ErrorCode::FailedPrecondition, 9, 409, "FAILED_PRECONDITION"),
            (ErrorCode::Unimplemented, 12, 501, "UNIMPLEMENTED"),
            (ErrorCode::DeadlineExceeded, 4, 504, "DEADLINE_EXCEEDED"),
            (ErrorCode::Unavailable, 14, 503, "UNAVAILABLE"),
            (ErrorCode::DataLoss, 15, 500, "DATA_LOSS"),
            (ErrorCode::Internal, 13, 500, "INTERNAL"),
            (ErrorCode::Cancelled, 1, 499, "CANCELLED"),
        ];
        for (code, grpc, http, name) in table {
            let error = Error::new(code, "x");
            assert_eq!(
                (error.grpc_code(), error.http_status(), error.code_name()),
                (grpc, http, name)
            );
        }
    }

    #[test]
    fn failures_of_the_lower_floors_keep_their_text_and_field() {
        let text = |place: &str| place.to_owned();
        let cases = [
            (
                pliant_wire::Error::invalid("handles[1].id", "empty"),
                422,
                Some("handles[1].id"),
            ),
            (
                pliant_wire::Error::Malformed {
                    field: text("body.x"),
                    problem: text("unknown field"),
                },
                400,
                Some("body.x"),
            ),
            (pliant_wire::Error::Precondition(text("no handles are set")), 409, None),
            (
                pliant_wire::Error::TooLarge {
                    what: "vertices",
                    seen: 9,
                    limit: 3,
                },
                413,
                None,
            ),
            (pliant_wire::Error::Unimplemented(text("method SPATIAL_RBF")), 501, None),
            (pliant_wire::Error::Cancelled, 499, None),
            (pliant_wire::Error::Internal(text("a defect")), 500, None),
            (
                pliant_asset::Error::UnknownFormat {
                    place: text("a.txt"),
                    allowed: text("glb"),
                }
                .into(),
                400,
                None,
            ),
            (
                pliant_asset::Error::TooLarge {
                    what: "triangles",
                    seen: 9,
                    limit: 3,
                }
                .into(),
                413,
                None,
            ),
            (
                pliant_asset::Error::NoMesh {
                    format: Format::OBJ,
                    problem: text("only points"),
                }
                .into(),
                422,
                None,
            ),
        ];
        for (cause, http, field) in cases {
            let said = cause.to_string();
            let error = Error::from(cause);
            assert_eq!((error.http_status(), error.field.as_deref()), (http, field), "{said}");
            assert_eq!(error.message, said);
        }
    }
}
