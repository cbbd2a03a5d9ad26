//! A deform stream in messages, for every transport that carries it.
//!
//! A request is read and checked here and goes into the session as values. A frame is encoded part by part as the transport
//! asks for it, so a reader that stops costs no encoded bytes. Its numbers are written once, into the bytes of the message.

use super::parts_to_send::PartsToSend;
use crate::session::{DeformStream, Error, StreamAnswer, StreamInput, StreamOutput};
use crate::wire::frames::OutgoingResponse;
use crate::wire::pb::{self, deform_response::Message};
use crate::wire::{StreamLimits, stream_request};

/// Where request messages go in.
#[derive(Debug)]
pub(super) struct RequestEnd {
    input: StreamInput,
    limits: StreamLimits,
}

/// Where response messages come out.
#[derive(Debug)]
pub(super) struct ResponseEnd {
    output: StreamOutput,
    /// The frame being sent, and the reference for differences of the next one.
    parts: PartsToSend,
    /// A frame could not be encoded: nothing follows that.
    is_broken: bool,
}

/// The two ends of a stream.
pub(super) fn message_ends(stream: DeformStream, limits: StreamLimits) -> (RequestEnd, ResponseEnd) {
    let (input, output) = stream.split();
    let response_end = ResponseEnd {
        output,
        parts: PartsToSend::default(),
        is_broken: false,
    };
    (RequestEnd { input, limits }, response_end)
}

impl RequestEnd {
    /// Takes a request; the session that it names is the transport's to check.
    ///
    /// # Errors
    /// Those of [`StreamInput::push`].
    pub fn push(&self, request: &pb::DeformRequest) -> Result<(), Error> {
        match stream_request(request, self.limits) {
            Some(request) => self.input.push(request),
            None => Ok(()),
        }
    }

    /// The client will send no more.
    pub fn finish(&self) {
        self.input.finish();
    }
}

impl ResponseEnd {
    /// The next response, or `None` when the stream has ended.
    ///
    /// # Cancel safety
    /// Dropping the future loses no response.
    pub async fn next(&mut self) -> Option<OutgoingResponse> {
        if self.is_broken {
            return None;
        }
        let message = loop {
            match self.parts.next().await {
                Ok(Some(part)) => {
                    self.output.count_part_bytes(part.data_bytes());
                    return Some(OutgoingResponse::Part(Box::new(part)));
                }
                Ok(None) => {}
                Err(error) => {
                    self.is_broken = true;
                    break Message::Error(failure_message(&error, 0));
                }
            }
            match self.output.next().await? {
                StreamAnswer::Frame(frame) => {
                    self.output.hold_bytes(frame.kept_bytes());
                    self.parts.begin(*frame);
                }
                StreamAnswer::Failure { error, seq } => break Message::Error(failure_message(&error, seq)),
                StreamAnswer::Notice { code, message, session } => {
                    break Message::Notice(pb::Notice {
                        code: code.into(),
                        message: message.into(),
                        resume_token: session,
                    });
                }
                StreamAnswer::Pong(nonce) => break Message::Pong(pb::Ping { nonce }),
            }
        };
        Some(OutgoingResponse::of(message))
    }
}

/// Writes an error for a stream; 0 as the pose's number means that the stream ends.
pub(super) fn failure_message(error: &Error, seq: u64) -> pb::Error {
    pb::Error {
        code: u32::try_from(error.grpc_code()).unwrap_or(2),
        message: error.message.clone(),
        seq,
    }
}
