//! The parts of a frame, made as they are sent.
//!
//! Most are made in no time, where they are asked for. Those that take long are made on a thread that serves no connections, each
//! while the one before is sent.

use crate::session::{Error, ErrorCode};
use crate::wire::frames::{FramePart, FrameParts, FrameRequest, encode};
use tokio::task::JoinHandle;

/// What is left of a frame that is being sent.
#[derive(Debug)]
pub(super) enum PartsToSend {
    None,
    /// Parts that are made at once when they are sent.
    Quick(Box<FrameParts>),
    /// The next part is being made, elsewhere.
    Slow(JoinHandle<(FrameParts, Option<FramePart>)>),
}

impl PartsToSend {
    /// The parts of a frame.
    pub fn of(frame: FrameRequest) -> Self {
        if frame.is_slow_to_encode() {
            Self::Slow(tokio::task::spawn_blocking(move || {
                let mut parts = encode(frame);
                let part = parts.next_part();
                (parts, part)
            }))
        } else {
            Self::Quick(Box::new(encode(frame)))
        }
    }

    /// The next part, or `None` behind the last.
    ///
    /// # Cancel safety
    /// Dropping the future loses no part.
    ///
    /// # Errors
    /// `INTERNAL` when a part cannot be made.
    pub async fn next(&mut self) -> Result<Option<FramePart>, Error> {
        let part = match self {
            Self::None => None,
            Self::Quick(parts) => parts.next_part(),
            Self::Slow(making) => {
                let made = making.await;
                let (mut parts, part) = made.map_err(|_| {
                    *self = Self::None;
                    Error::new(ErrorCode::Internal, "the frame cannot be encoded")
                })?;
                if parts.has_more() {
                    *self = Self::Slow(tokio::task::spawn_blocking(move || {
                        let part = parts.next_part();
                        (parts, part)
                    }));
                    return Ok(part);
                }
                *self = Self::None;
                part
            }
        };
        if part.is_none() {
            *self = Self::None;
        }
        Ok(part)
    }
}
