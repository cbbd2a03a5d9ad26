//! Messages and failures over gRPC: messages as `prost` writes and reads them, each into one buffer of its size, and failures as a
//! status with the details of `google.rpc`. Bytes that are no message are a fault of the sender, `INVALID_ARGUMENT`, not
//! `INTERNAL`, which would be a defect of the server.
//!
//! A request with its caller, read from its metadata.

use crate::auth;
use crate::messages::NamesSession;
use crate::redirect::{NODE, OWNER};
use crate::state::ServerState;
use pliant_session::{CallKey, Error, ErrorCode, Manager, Tenant};
use prost::Message;
use std::collections::HashMap;
use std::time::Duration;
use tonic::codec::{BufferSettings, Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::metadata::MetadataMap;
use tonic::{Code, Request, Status, Streaming};
use tonic_prost::ProstCodec;
use tonic_types::{ErrorDetails, StatusExt as _};

/// Encodes `T` and decodes `U`; the generated code names it.
#[derive(Debug)]
pub struct MessageCodec<T, U>(ProstCodec<T, U>);

impl<T, U> Default for MessageCodec<T, U> {
    fn default() -> Self {
        Self(ProstCodec::default())
    }
}

impl<T, U> Codec for MessageCodec<T, U>
where
    T: Message + Send + 'static,
    U: Message + Default + Send + 'static,
{
    type Encode = T;
    type Decode = U;
    type Encoder = MessageEncoder<<ProstCodec<T, U> as Codec>::Encoder>;
    type Decoder = MessageDecoder<<ProstCodec<T, U> as Codec>::Decoder>;

    fn encoder(&mut self) -> Self::Encoder {
        MessageEncoder(self.0.encoder())
    }

    fn decoder(&mut self) -> Self::Decoder {
        MessageDecoder(self.0.decoder())
    }
}

/// Makes room for a message before it is written, so that none is moved while it grows.
#[derive(Debug)]
pub struct MessageEncoder<E>(E);

impl<E: Encoder<Error = Status, Item: Message>> Encoder for MessageEncoder<E> {
    type Item = E::Item;
    type Error = Status;

    fn encode(&mut self, message: E::Item, bytes: &mut EncodeBuf<'_>) -> Result<(), Status> {
        bytes.reserve(message.encoded_len());
        self.0.encode(message, bytes)
    }

    fn buffer_settings(&self) -> BufferSettings {
        self.0.buffer_settings()
    }
}

/// Reports bytes that are no message as a fault of the sender.
#[derive(Debug)]
pub struct MessageDecoder<D>(D);

impl<D: Decoder<Error = Status>> Decoder for MessageDecoder<D> {
    type Item = D::Item;
    type Error = Status;

    fn decode(&mut self, bytes: &mut DecodeBuf<'_>) -> Result<Option<Self::Item>, Status> {
        self.0.decode(bytes).map_err(|broken| {
            status(Error::malformed(format!(
                "the message cannot be read: {}",
                broken.message()
            )))
        })
    }

    fn buffer_settings(&self) -> BufferSettings {
        self.0.buffer_settings()
    }
}

/// Status messages travel as headers, whose size clients bound.
const MESSAGE_CHARS: usize = 1000;

/// The status of a failure: `ErrorInfo` always, `BadRequest` when a field is to blame, `RetryInfo` when waiting helps.
pub(super) fn status(error: impl Into<Error>) -> Status {
    let error: Error = error.into();
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
    let code = Code::from_i32(error.grpc_code());
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

/// A request with its caller.
pub(super) struct Call<T> {
    /// The sessions, with what is done noted as the caller's.
    pub manager: Manager,
    /// The caller's tenant.
    pub tenant: Tenant,
    /// The message, or the stream of messages.
    pub message: T,
    /// The idempotency key of a call that does work.
    pub key: Option<String>,
}

impl<T> Call<T> {
    /// A call by an authenticated caller.
    pub fn read(state: &ServerState, request: Request<T>) -> Result<Self, Status> {
        let principal = auth::principal(request.extensions()).map_err(status)?;
        Ok(Self {
            manager: state.manager.on_behalf_of(&principal.name),
            tenant: principal.tenant.clone(),
            key: None,
            message: request.into_inner(),
        })
    }

    /// A call that does new work. It is rejected while the server shuts down; calls that only read are not.
    pub async fn work(state: &ServerState, request: Request<T>) -> Result<Self, Status> {
        let key = request.metadata().get("idempotency-key").cloned();
        let mut call = Self::read(state, request)?;
        if let Some(key) = key {
            let text = key.to_str();
            let text = text
                .map_err(|_| Error::invalid("idempotency-key", "is not printable ASCII"))
                .map_err(status)?;
            call.key = Some(text.to_owned());
        }
        if state.draining.is_cancelled() {
            return Err(status(state.manager.leaving().await));
        }
        Ok(call)
    }
}

impl<T: NamesSession> Call<T> {
    /// Rejects a call on a session that does not exist, before its other fields are checked.
    pub async fn on_session(self, state: &ServerState) -> Result<Self, Status> {
        state
            .manager
            .get(&self.tenant, self.message.session_id())
            .await
            .map_err(status)?;
        Ok(self)
    }
}

impl<T: Message> Call<T> {
    /// The idempotency key together with the request.
    pub fn call_key(&self) -> Option<CallKey> {
        call_key(self.key.clone(), &self.message)
    }
}

/// An idempotency key together with what identifies the request.
pub(super) fn call_key(key: Option<String>, request: &impl Message) -> Option<CallKey> {
    let request = |key| CallKey {
        key,
        request: request.encode_to_vec(),
    };
    key.map(request)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn details_carry_field_reason_and_delay() {
        let invalid = status(Error::invalid("handles[0].id", "is empty, 1 to 128 bytes are allowed"));
        assert_eq!(invalid.code(), Code::InvalidArgument);
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
