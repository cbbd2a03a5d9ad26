//! The client's two ends of an interactive deform stream.

use crate::answers::StreamAnswer;
use crate::capacity::call_queue::CallGuard;
use crate::capacity::memory_ledger::MemoryReservation;
use crate::error::Error;
use crate::metrics::Metrics;
use crate::quota::tenant_account::TenantStream;
use crate::registry::OpenSession;
use crate::stream::frame_window::FramePacker;
use crate::stream::mailbox::Mailbox;
use pliant_wire::StreamRequest;
use std::sync::Arc;
use std::task::Poll;

/// Where requests go in. Dropping it means [`StreamInput::finish`].
#[derive(Debug)]
pub struct StreamInput {
    mailbox: Arc<Mailbox>,
}

/// Where responses come out. Dropping it stops the stream's solve; what was dragged and not committed is lost.
#[derive(Debug)]
pub struct StreamOutput {
    mailbox: Arc<Mailbox>,
    session: Arc<OpenSession>,
    packer: FramePacker,
    ended: bool,
    metrics: Arc<Metrics>,
    held: MemoryReservation,
    _inside: CallGuard,
    _place: TenantStream,
}

/// The two ends of a stream of a session.
pub(crate) fn stream_ends(
    mailbox: Arc<Mailbox>,
    session: Arc<OpenSession>,
    metrics: Arc<Metrics>,
    held: MemoryReservation,
    inside: CallGuard,
    place: TenantStream,
) -> (StreamInput, StreamOutput) {
    metrics.streams.inc();
    let input = StreamInput {
        mailbox: Arc::clone(&mailbox),
    };
    let output = StreamOutput {
        mailbox,
        session,
        packer: FramePacker::default(),
        ended: false,
        metrics,
        held,
        _inside: inside,
        _place: place,
    };
    (input, output)
}

impl StreamInput {
    /// Takes a request. Never waits and never queues without bound: newer poses replace waiting ones. The output
    /// reports errors of a request.
    ///
    /// # Errors
    /// `CANCELLED` when the stream has ended; the output says why.
    pub fn push(&self, request: StreamRequest) -> Result<(), Error> {
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
    /// The next answer, or `None` when the stream has ended. What of a frame is sent is chosen only here, and its parts
    /// are encoded when they are sent, so a transport that does not read delays nothing.
    ///
    /// # Cancel safety
    /// Dropping the future loses no answer.
    pub async fn next(&mut self) -> Option<StreamAnswer> {
        loop {
            if self.ended {
                return None;
            }
            match self.mailbox.next_answer() {
                Poll::Ready(Some(StreamAnswer::Frame(frame))) => {
                    self.metrics.frames_sent.inc();
                    let packed = self.packer.pack_frame(*frame, self.mailbox.acknowledged());
                    return Some(StreamAnswer::Frame(Box::new(packed)));
                }
                Poll::Ready(Some(answer)) => return Some(answer),
                Poll::Ready(None) => self.ended = true,
                Poll::Pending => self.mailbox.wait_for_change().await,
            }
        }
    }

    /// Sets how many bytes the sender of frames holds for the differences of the next one. They count even beyond the
    /// memory limit: they are few beside those of the session, and what is sent depends on no other session.
    pub fn hold_bytes(&self, bytes: u64) {
        let _ = self.held.resize(bytes);
    }

    /// Counts the bytes of a part that goes out.
    pub fn count_part_bytes(&self, bytes: usize) {
        self.metrics.frame_bytes.inc_by(bytes as u64);
    }
}

impl Drop for StreamOutput {
    fn drop(&mut self) {
        self.mailbox.abandon();
        self.session.streams.remove(&self.mailbox);
        self.session.lease.renew();
        // It may be free to leave now.
        self.session.wake.notify_one();
        self.metrics.streams.dec();
    }
}
