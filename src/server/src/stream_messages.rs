//! Deform streams and animations as messages, for every transport that carries them.
//!
//! A request is read and checked here and goes into the session as values. A frame is encoded part by part as the transport asks
//! for it, so a reader that stops costs no encoded bytes. Its numbers are written once, into the bytes of the message.

use pliant_session::{
    AnimationAnswer, AnimationReader, Error, ErrorCode, Manager, StreamAnswer, StreamInput, StreamOutput, Tenant,
};
use pliant_wire::frames::{Frame, FrameParts, OutgoingResponse, SentSteps, encode_next};
use pliant_wire::pb::deform_response::Message;
use pliant_wire::{StreamLimits, pb, stage_frame, stream_request, summary_frame};
use tokio::task::JoinHandle;

/// Takes the request messages of a stream.
#[derive(Debug)]
pub(super) struct RequestSender {
    input: StreamInput,
    limits: StreamLimits,
}

/// Gives the response messages of a stream.
#[derive(Debug)]
pub(super) struct ResponseReceiver {
    output: StreamOutput,
    /// The frame being sent, and the reference for differences of the next one.
    parts: PartsToSend,
    /// A frame could not be encoded: nothing follows that.
    is_broken: bool,
}

/// The two directions of a stream of a session, which begins with this.
///
/// # Errors
/// Those of [`Manager::stream`].
pub(super) async fn open_stream(
    manager: &Manager,
    tenant: &Tenant,
    id: &str,
) -> Result<(RequestSender, ResponseReceiver), Error> {
    let (input, output) = manager.stream(tenant, id).await?;
    let limits = manager.config().stream_limits();
    let responses = ResponseReceiver {
        output,
        parts: PartsToSend::default(),
        is_broken: false,
    };
    Ok((RequestSender { input, limits }, responses))
}

impl RequestSender {
    /// Takes a request; the transport checks the session that it names.
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

impl ResponseReceiver {
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
                    return Some(part);
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
        Some(message.into())
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

/// Gives the messages of an animation.
#[derive(Debug)]
pub(super) struct AnimationFrames {
    output: AnimationReader,
    /// The frame being sent, and the reference for differences of the next one.
    parts: PartsToSend,
    last_seq: u64,
}

impl AnimationFrames {
    /// The messages of an animation.
    pub fn of_output(output: AnimationReader) -> Self {
        Self {
            output,
            parts: PartsToSend::default(),
            last_seq: 0,
        }
    }

    /// The next message, or `None` when the animation has ended.
    ///
    /// # Cancel safety
    /// Dropping the future loses no message.
    ///
    /// # Errors
    /// Why the animation ends before its last frame; then it is over.
    pub async fn next_message(&mut self) -> Option<Result<pb::Frame, Error>> {
        loop {
            match self.parts.next().await {
                Ok(Some(part)) => {
                    self.output.count_part_bytes(part.data_bytes());
                    return part.into_frame().map(Ok);
                }
                Ok(None) => {}
                Err(error) => return Some(Err(error)),
            }
            match self.output.next_answer().await? {
                Ok(AnimationAnswer::Stage { stage, fraction }) => return Some(Ok(stage_frame(stage, fraction.into()))),
                Ok(AnimationAnswer::Frame(frame)) => {
                    self.last_seq = frame.header.seq;
                    self.output.hold_bytes(frame.kept_bytes());
                    self.parts.begin(*frame);
                }
                Ok(AnimationAnswer::Summary(summary)) => return Some(Ok(summary_frame(&summary, self.last_seq))),
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

/// The frames of one stream, one after the other, each in parts.
///
/// Most parts are encoded when they are asked for. Those that take long are encoded on a blocking thread, each while the one
/// before is sent.
#[derive(Debug, Default)]
struct PartsToSend {
    pending: PendingParts,
    /// What the reader has. While a frame is encoded, its parts hold this.
    sent: SentSteps,
}

/// The rest of a frame that is being sent.
#[derive(Debug, Default)]
enum PendingParts {
    #[default]
    None,
    /// Each part is encoded when it is sent.
    Quick(Box<FrameParts>),
    /// The next part is being encoded on a blocking thread.
    Slow(JoinHandle<(FrameParts, Option<OutgoingResponse>)>),
}

impl PartsToSend {
    /// Begins a frame; all parts of the one before have been taken.
    pub fn begin(&mut self, frame: Frame) {
        let sent = std::mem::take(&mut self.sent);
        self.pending = if frame.is_slow_to_encode() {
            PendingParts::Slow(tokio::task::spawn_blocking(move || {
                let mut parts = encode_next(frame, sent);
                let part = parts.next_part();
                (parts, part)
            }))
        } else {
            PendingParts::Quick(Box::new(encode_next(frame, sent)))
        };
    }

    /// The next part, or `None` behind the last.
    ///
    /// # Cancel safety
    /// Dropping the future loses no part.
    ///
    /// # Errors
    /// `INTERNAL` when a part cannot be made; what the reader holds is then not known.
    pub async fn next(&mut self) -> Result<Option<OutgoingResponse>, Error> {
        let (parts, part) = match &mut self.pending {
            PendingParts::None => return Ok(None),
            PendingParts::Quick(parts) => {
                let part = parts.next_part();
                if parts.has_more() {
                    return Ok(part);
                }
                match std::mem::take(&mut self.pending) {
                    PendingParts::Quick(parts) => (*parts, part),
                    _ => return Ok(part),
                }
            }
            PendingParts::Slow(making) => {
                let made = making.await;
                self.pending = PendingParts::None;
                let (mut parts, part) =
                    made.map_err(|_| Error::new(ErrorCode::Internal, "the frame cannot be encoded"))?;
                if parts.has_more() {
                    self.pending = PendingParts::Slow(tokio::task::spawn_blocking(move || {
                        let part = parts.next_part();
                        (parts, part)
                    }));
                    return Ok(part);
                }
                (parts, part)
            }
        };
        self.sent = parts.into_sent();
        Ok(part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use pliant_wire::frames::{FrameEncoding, FrameOutput};
    use prost::Message as _;
    use std::sync::Arc;

    fn frame(vertices: usize, phase: f64) -> Frame {
        let place = |v: usize| DVec3::new(v as f64 * 1e-3, libm::sin(v as f64 * 0.01 + phase), phase);
        Frame {
            positions: Arc::new((0..vertices).map(place).collect()),
            output: FrameOutput {
                encoding: FrameEncoding::Delta,
                ..FrameOutput::default()
            },
            part_bytes: 9000,
            ..Frame::default()
        }
    }

    /// Each wait for a part is given up many times, as connections do whose other end says something meanwhile.
    #[tokio::test]
    async fn waits_that_are_given_up_lose_neither_parts_nor_what_the_reader_holds() {
        for vertices in [300, 5000] {
            let mut sent = SentSteps::default();
            let mut sender = PartsToSend::default();
            for k in 0..4 {
                let frame = frame(vertices, f64::from(k) * 0.01);
                assert_eq!(frame.is_slow_to_encode(), vertices == 5000);
                let mut wanted = encode_next(frame.clone(), sent);
                sender.begin(frame);
                while let Some(wanted) = wanted.next_part() {
                    let part = loop {
                        tokio::select! {
                            biased;
                            part = sender.next() => break part.expect("is made").expect("a part"),
                            () = tokio::task::yield_now() => {}
                        }
                    };
                    assert!(
                        part.encode_to_vec() == wanted.encode_to_vec(),
                        "frame {k} of {vertices} vertices"
                    );
                }
                sent = wanted.into_sent();
                assert!(sender.next().await.expect("no failure").is_none());
                assert_eq!(sender.sent.byte_size(), vertices as u64 * 8);
            }
        }
    }
}
