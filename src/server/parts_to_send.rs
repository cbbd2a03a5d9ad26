//! The parts of a frame, made as they are sent.
//!
//! Most are made in no time, where they are asked for. Those that take long are made on a thread that serves no connections, each
//! while the one before is sent.

use crate::session::{Error, ErrorCode};
use crate::wire::frames::{Frame, FramePart, FrameParts, SentSteps, encode_next};
use tokio::task::JoinHandle;

/// The frames of one stream, one after the other, each in parts.
#[derive(Debug, Default)]
pub(super) struct PartsToSend {
    making: PartsInTheMaking,
    /// What the reader holds. While a frame is made this is with its parts.
    sent: SentSteps,
}

/// What is left of a frame that is being sent.
#[derive(Debug, Default)]
enum PartsInTheMaking {
    #[default]
    None,
    /// Parts that are made at once when they are sent.
    Quick(Box<FrameParts>),
    /// The next part is being made, elsewhere.
    Slow(JoinHandle<(FrameParts, Option<FramePart>)>),
}

impl PartsToSend {
    /// Begins a frame; all parts of the one before have been taken.
    pub fn begin(&mut self, frame: Frame) {
        let sent = std::mem::take(&mut self.sent);
        self.making = if frame.is_slow_to_encode() {
            PartsInTheMaking::Slow(tokio::task::spawn_blocking(move || {
                let mut parts = encode_next(frame, sent);
                let part = parts.next_part();
                (parts, part)
            }))
        } else {
            PartsInTheMaking::Quick(Box::new(encode_next(frame, sent)))
        };
    }

    /// The next part, or `None` behind the last.
    ///
    /// # Cancel safety
    /// Dropping the future loses no part.
    ///
    /// # Errors
    /// `INTERNAL` when a part cannot be made; what the reader holds is then not known.
    pub async fn next(&mut self) -> Result<Option<FramePart>, Error> {
        let (parts, part) = match &mut self.making {
            PartsInTheMaking::None => return Ok(None),
            PartsInTheMaking::Quick(parts) => {
                let part = parts.next_part();
                if parts.has_more() {
                    return Ok(part);
                }
                match std::mem::take(&mut self.making) {
                    PartsInTheMaking::Quick(parts) => (*parts, part),
                    _ => return Ok(part),
                }
            }
            PartsInTheMaking::Slow(making) => {
                let made = making.await;
                self.making = PartsInTheMaking::None;
                let (mut parts, part) =
                    made.map_err(|_| Error::new(ErrorCode::Internal, "the frame cannot be encoded"))?;
                if parts.has_more() {
                    self.making = PartsInTheMaking::Slow(tokio::task::spawn_blocking(move || {
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
    use crate::wire::frames::{FrameEncoding, FrameHeader, FrameOutput, OutgoingResponse};
    use glam::DVec3;
    use prost::Message as _;
    use std::sync::Arc;

    fn frame(vertices: usize, phase: f64) -> Frame {
        let place = |v: usize| DVec3::new(v as f64 * 1e-3, libm::sin(v as f64 * 0.01 + phase), phase);
        Frame {
            header: FrameHeader::default(),
            positions: Arc::new((0..vertices).map(place).collect()),
            shading: None,
            output: FrameOutput {
                encoding: FrameEncoding::Delta,
                ..FrameOutput::default()
            },
            selected: None,
            part_bytes: 9000,
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
                    let bytes = |part| OutgoingResponse::Part(Box::new(part)).encode_to_vec();
                    assert!(bytes(part) == bytes(wanted), "frame {k} of {vertices} vertices");
                }
                sent = wanted.into_sent();
                assert!(sender.next().await.expect("no failure").is_none());
                assert_eq!(sender.sent.byte_size(), vertices as u64 * 8);
            }
        }
    }
}
