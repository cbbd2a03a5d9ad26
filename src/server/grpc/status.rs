//! Failures over gRPC: a status with the details of `google.rpc`.

use crate::server::redirect::{NODE, OWNER};
use crate::session::{Error, ErrorCode};
use std::collections::HashMap;
use std::time::Duration;
use tonic::metadata::MetadataMap;
use tonic::{Code, Status, Streaming};
use tonic_types::{ErrorDetails, StatusExt as _};

/// Status messages travel as headers, whose size clients bound.
const MESSAGE_CHARS: usize = 1000;

/// The status of a failure: `ErrorInfo` always, `BadRequest` when a field is to blame, `RetryInfo` when waiting helps.
pub(super) fn status(error: Error) -> Status {
    let reason = match error.code {
        ErrorCode::TooLarge => "TOO_LARGE",
        ErrorCode::InvalidArgument { malformed: true } => "MALFORMED",
        _ => error.code_name(),
    };
    let mut details = ErrorDetails::new();
    details.set_error_info(reason, "pliant.v1", HashMap::new());
    let message: String = error.message.chars().take(MESSAGE_CHARS).collect();
    if let Some(field) = &error.field {
        let field: String = field.chars().take(200).collect();
        let problem = message.strip_prefix(&format!("{field}: ")).unwrap_or(&message);
        details.add_bad_request_violation(field.clone(), problem);
    }
    let mut metadata = MetadataMap::new();
    let waits = matches!(error.code, ErrorCode::ResourceExhausted | ErrorCode::Unavailable);
    if let Some(seconds) = error.retry_after_s.or(waits.then_some(1)) {
        let seconds = seconds.max(1);
        details.set_retry_info(Some(Duration::from_secs(seconds.into())));
        metadata.insert("retry-after", seconds.into());
    }
    if let Some(owner) = &error.owner {
        for (name, value) in [(OWNER, &owner.address), (NODE, &owner.node)] {
            if let Ok(value) = value.parse() {
                metadata.insert(name, value);
            }
        }
    }
    let code = tonic::Code::from_i32(error.grpc_code());
    Status::with_error_details_and_metadata(code, message, details, metadata)
}

/// The next message of a client. An invalid gRPC frame is the sender's fault, and a too large one exhausts a limit; the
/// library calls them INTERNAL and OUT_OF_RANGE.
///
/// # Cancel safety
/// As [`Streaming::message`].
pub(super) async fn inbound_message<T>(inbound: &mut Streaming<T>) -> Result<Option<T>, Status> {
    inbound.message().await.map_err(|broken| match broken.code() {
        Code::Internal => status(Error::malformed(format!(
            "the frame cannot be read: {}",
            broken.message()
        ))),
        Code::OutOfRange => status(Error::new(ErrorCode::TooLarge, broken.message())),
        _ => broken,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn details_carry_field_reason_and_delay() {
        let invalid = status(Error::invalid("handles[0].id", "is empty, 1 to 128 bytes are allowed"));
        assert_eq!(invalid.code(), tonic::Code::InvalidArgument);
        let details = invalid.get_error_details();
        let violation = &details.bad_request().unwrap().field_violations[0];
        assert_eq!(
            (violation.field.as_str(), violation.description.as_str()),
            ("handles[0].id", "is empty, 1 to 128 bytes are allowed")
        );
        assert_eq!(details.error_info().unwrap().reason, "INVALID_ARGUMENT");
        assert!(details.retry_info().is_none());

        let full = status(Error::exhausted("no slot", 3));
        assert_eq!(
            full.get_error_details().retry_info().unwrap().retry_delay,
            Some(Duration::from_secs(3))
        );
        assert_eq!(
            status(Error::new(ErrorCode::TooLarge, "x"))
                .get_error_details()
                .error_info()
                .unwrap()
                .reason,
            "TOO_LARGE"
        );
    }

    #[test]
    fn a_long_message_is_cut_so_that_headers_stay_small() {
        let long = status(Error::new(ErrorCode::Internal, "x".repeat(1 << 20)));
        assert!(long.message().len() <= MESSAGE_CHARS);
    }
}
