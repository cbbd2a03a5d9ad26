//! An animation in messages, for every transport that carries it. Frames are encoded part by part as the transport asks for
//! them, so a reader that stops costs no encoded bytes.

use super::parts_to_send::PartsToSend;
use crate::session::{AnimationAnswer, AnimationReader, Error};
use crate::wire::{pb, stage_frame, summary_frame};

/// Where the messages of an animation come out.
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
                    return Some(Ok(part.into_message()));
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
