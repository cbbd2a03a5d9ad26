//! Chooses what of a frame is sent as a transport pulls it.

use crate::session::stream::outbound_frame::OutboundFrame;
use crate::wire::frames::FrameRequest;
use glam::Vec3;
use std::collections::VecDeque;
use std::sync::Arc;

/// Packs the frames of one stream. Remembers what the reader holds, for frames that carry changes only.
#[derive(Debug)]
pub(in crate::session) struct FramePacker {
    part_bytes: usize,
    /// The buffer that the reader holds after each frame that it was sent and has not acknowledged, with the frame's seq.
    sent: VecDeque<(u64, Arc<Vec<Vec3>>)>,
    /// The buffer after the newest acknowledged frame.
    acknowledged: Option<Arc<Vec<Vec3>>>,
}

/// Buffers remembered at most; more than any window.
const REMEMBERED: usize = 128;

impl FramePacker {
    pub fn new(part_bytes: usize) -> Self {
        Self {
            part_bytes,
            sent: VecDeque::new(),
            acknowledged: None,
        }
    }

    /// Chooses the vertices of a frame. `acknowledged` is the newest seq that the reader has acknowledged.
    pub fn pack_frame(&mut self, frame: OutboundFrame, acknowledged: Option<u64>) -> FrameRequest {
        let (seq, output, positions) = (frame.header.seq, frame.output, Arc::clone(&frame.positions));
        let other = |buffer: &Arc<Vec<Vec3>>| buffer.len() != positions.len();
        if self
            .acknowledged
            .iter()
            .chain(self.sent.iter().map(|s| &s.1))
            .any(other)
        {
            // An edit has changed the number of vertices: the reader gets all of them.
            self.sent.clear();
            self.acknowledged = None;
        }
        let delta = output.changed_only.is_some();
        if delta {
            while self
                .sent
                .front()
                .is_some_and(|(seq, _)| acknowledged.is_some_and(|a| *seq <= a))
            {
                self.acknowledged = self.sent.pop_front().map(|(_, buffer)| buffer);
            }
        } else {
            self.sent.clear();
            self.acknowledged = None;
        }
        let held = self
            .sent
            .back()
            .map(|(_, buffer)| Arc::clone(buffer))
            .or_else(|| self.acknowledged.clone());
        // Frames arrive in order, so the reader will hold `held` when this one comes, unless it rebuilds what it has
        // acknowledged: a vertex is left out only when both are right.
        let baselines = match (&self.acknowledged, &held) {
            (Some(a), Some(h)) if !Arc::ptr_eq(a, h) => vec![Arc::clone(a), Arc::clone(h)],
            (Some(a), _) => vec![Arc::clone(a)],
            (None, _) => Vec::new(),
        };
        let request = frame.into_request(&baselines, self.part_bytes);
        if delta {
            let buffer = match (&request.selected, held) {
                (Some(selected), Some(held)) if held.len() == positions.len() => {
                    let mut buffer = held.as_ref().clone();
                    selected
                        .iter()
                        .for_each(|&v| buffer[v as usize] = positions[v as usize].as_vec3());
                    buffer
                }
                _ => positions.iter().map(|p| p.as_vec3()).collect(),
            };
            self.sent.push_back((seq, Arc::new(buffer)));
            if self.sent.len() > REMEMBERED {
                self.sent.pop_front();
            }
        }
        request
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::frames::{FrameHeader, FrameOutput, encode};
    use glam::DVec3;
    use proptest::prelude::*;

    fn frame(seq: u64, positions: &[DVec3], threshold: f64) -> OutboundFrame {
        OutboundFrame {
            header: FrameHeader {
                seq,
                ..Default::default()
            },
            positions: Arc::new(positions.to_vec()),
            shading: None,
            output: FrameOutput {
                changed_only: Some(threshold),
                ..Default::default()
            },
            diagonal: 1.0,
        }
    }

    proptest! {
        /// A client that applies every change it gets is never further off than the threshold, whenever its
        /// acknowledgements come.
        #[test]
        fn changes_add_up_to_the_shape(
            steps in prop::collection::vec((prop::collection::vec(-3i8..4, 6), any::<bool>()), 1..20),
            threshold in 0.0f64..2.5,
        ) {
            let mut packer = FramePacker::new(1 << 20);
            let mut client = [[f32::NAN; 3]; 6];
            let mut acknowledged = None;
            for (k, (xs, acknowledge)) in steps.iter().enumerate() {
                let shape: Vec<DVec3> = xs.iter().map(|&x| DVec3::new(x.into(), 0.0, 0.0)).collect();
                for part in encode(packer.pack_frame(frame(k as u64 + 1, &shape, threshold), acknowledged)) {
                    for (at, data) in part.indices.iter().zip(part.data.chunks_exact(12)) {
                        let number = |i: usize| f32::from_le_bytes([data[i], data[i + 1], data[i + 2], data[i + 3]]);
                        client[*at as usize] = [number(0), number(4), number(8)];
                    }
                }
                for (seen, p) in client.iter().zip(&shape) {
                    prop_assert!((f64::from(seen[0]) - p.x).abs() <= threshold);
                }
                if *acknowledge {
                    acknowledged = Some(k as u64 + 1);
                }
            }
        }
    }

    #[test]
    fn a_shape_at_rest_is_no_change_once_it_is_acknowledged() {
        let shape = vec![DVec3::new(0.1, 0.2, 0.3); 5];
        let mut packer = FramePacker::new(1 << 20);
        let count = |frame: FrameRequest| frame.selected.map(|s| s.len());
        assert_eq!(count(packer.pack_frame(frame(1, &shape, 0.0), None)), Some(5));
        assert_eq!(
            count(packer.pack_frame(frame(2, &shape, 0.0), None)),
            Some(5),
            "nothing is acknowledged yet"
        );
        assert_eq!(count(packer.pack_frame(frame(3, &shape, 0.0), Some(1))), Some(0));
    }
}
