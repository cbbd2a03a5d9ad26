//! The client's two ends of an interactive deform stream.

use crate::session::capacity::call_gate::CallGuard;
use crate::session::error::Error;
use crate::session::metrics::Metrics;
use crate::session::registry::OpenSession;
use crate::session::stream::frame_packer::FramePacker;
use crate::session::stream::mailbox::Mailbox;
use crate::session::stream::outbound_frame::OutboundItem;
use crate::wire::frames::FrameParts;
use crate::wire::pb;
use std::sync::Arc;

/// One interactive deform stream. Dropping it stops its solve within one cycle and frees its place.
#[derive(Debug)]
pub struct DeformStream {
    input: StreamInput,
    output: StreamOutput,
}

/// Where requests go in. Dropping it means [`StreamInput::finish`].
#[derive(Debug)]
pub struct StreamInput {
    mailbox: Arc<Mailbox>,
}

/// Where responses come out. Dropping it means that nobody listens any more: the stream's solve stops, and what was
/// dragged and not committed is gone.
#[derive(Debug)]
pub struct StreamOutput {
    mailbox: Arc<Mailbox>,
    session: Arc<OpenSession>,
    packer: FramePacker,
    parts: Option<FrameParts>,
    ended: bool,
    metrics: Arc<Metrics>,
    _inside: CallGuard,
}

impl DeformStream {
    pub(in crate::session) fn new(
        mailbox: Arc<Mailbox>,
        session: Arc<OpenSession>,
        part_bytes: usize,
        metrics: Arc<Metrics>,
        inside: CallGuard,
    ) -> Self {
        metrics.streams.inc();
        Self {
            input: StreamInput {
                mailbox: Arc::clone(&mailbox),
            },
            output: StreamOutput {
                mailbox,
                session,
                packer: FramePacker::new(part_bytes),
                parts: None,
                ended: false,
                metrics,
                _inside: inside,
            },
        }
    }

    /// The two ends, for a transport that reads and writes in different places.
    pub fn split(self) -> (StreamInput, StreamOutput) {
        (self.input, self.output)
    }
}

impl StreamInput {
    /// Takes a request. Never waits and never queues without bound: newer poses replace waiting ones. What is wrong
    /// with a request is told on the output.
    ///
    /// # Errors
    /// `CANCELLED` when the stream has ended; the output says why.
    pub fn push(&self, request: pb::DeformRequest) -> Result<(), Error> {
        self.mailbox.push(request)
    }

    /// The client will send no more. What waits is still answered, then the output ends.
    pub fn finish(&self) {
        self.mailbox.finish();
    }
}

impl Drop for StreamInput {
    fn drop(&mut self) {
        self.mailbox.finish();
    }
}

impl StreamOutput {
    /// The next response, or `None` when the stream has ended. A part of a frame is packed only here, so a transport
    /// that does not ask holds up nothing and nobody.
    ///
    /// # Cancel safety
    /// Dropping the future loses no response.
    pub async fn next(&mut self) -> Option<pb::DeformResponse> {
        loop {
            if let Some(frame) = self.parts.as_mut().and_then(Iterator::next) {
                if frame.part == 0 {
                    self.metrics.frames_sent.inc();
                }
                self.metrics.frame_bytes.inc_by(frame.data.len() as u64);
                return Some(response_with(pb::deform_response::Message::Frame(frame)));
            }
            self.parts = None;
            if self.ended {
                return None;
            }
            match self.mailbox.next_item() {
                Some(OutboundItem::Message(message)) => return Some(response_with(message)),
                Some(OutboundItem::Frame(frame)) => {
                    self.parts = Some(self.packer.pack_frame(*frame, self.mailbox.acknowledged()))
                }
                Some(OutboundItem::End) => self.ended = true,
                None => self.mailbox.wait_for_change().await,
            }
        }
    }
}

impl Drop for StreamOutput {
    fn drop(&mut self) {
        self.mailbox.abandon();
        self.session.streams.remove(&self.mailbox);
        self.session.lease.renew();
        self.metrics.streams.dec();
    }
}

fn response_with(message: pb::deform_response::Message) -> pb::DeformResponse {
    pb::DeformResponse { message: Some(message) }
}
