//! Frames on their way to a reader: how they begin, how many of them may wait, and what of them is sent as a transport pulls it.

use glam::{DVec3, Vec3};
use pliant_core::engine::{Shading, TopologyId};
use pliant_wire::frames::{Frame, FrameOutput};
use pliant_wire::pb;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// What all frames of one piece of work have in common.
#[derive(Debug, Clone)]
pub(crate) struct FrameContext {
    pub revision: u64,
    /// What edits have made of the model.
    pub topology: Option<TopologyId>,
    pub diagonal: f64,
    /// What positions are relative to as they are sent.
    pub origin: DVec3,
    /// How long the work waited for a compute slot.
    pub queued: Duration,
    /// Bytes that the data of a part may take.
    pub part_bytes: usize,
}

impl FrameContext {
    /// A frame of all vertices, of the pose of number `seq`; its accuracy and the time of its solve are still to be filled in.
    pub fn frame(
        &self,
        seq: u64,
        output: FrameOutput,
        positions: Arc<Vec<DVec3>>,
        shading: Option<Arc<Shading>>,
    ) -> Frame {
        Frame {
            header: pb::Frame {
                seq,
                revision: self.revision,
                queue_ms: ms_of(self.queued),
                ..Default::default()
            },
            topology: self.topology,
            diagonal: self.diagonal,
            origin: self.origin,
            positions,
            shading,
            output,
            part_bytes: self.part_bytes,
            ..Frame::default()
        }
    }
}

/// Milliseconds.
pub(crate) fn ms_of(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

/// Frames that a reader has not acknowledged: at most as many as its window has.
#[derive(Debug, Default)]
pub(crate) struct FrameWindow {
    /// The most frames that may be made and not acknowledged.
    pub size: usize,
    /// Made and not yet taken by the transport.
    pub waiting: VecDeque<Frame>,
    /// Seq of every frame taken by the transport and not acknowledged.
    unacknowledged: VecDeque<u64>,
    /// The newest frame that the reader has acknowledged.
    pub acknowledged: Option<u64>,
    /// No acknowledgement will come any more: only frames that are not taken count.
    pub finished: bool,
}

impl FrameWindow {
    pub fn with_size(size: u32) -> Self {
        Self {
            size: size as usize,
            ..Self::default()
        }
    }

    /// How many frames may still be made.
    pub fn room(&self) -> usize {
        self.size.saturating_sub(self.waiting.len() + self.unacknowledged.len())
    }

    /// The reader has the frames up to this one.
    pub fn acknowledge(&mut self, seq: u64) {
        self.unacknowledged.retain(|&taken| taken > seq);
        self.acknowledged = self.acknowledged.max(Some(seq));
    }

    /// No acknowledgement will come any more.
    pub fn finish(&mut self) {
        self.finished = true;
        self.unacknowledged.clear();
    }

    /// Takes the next frame, for the transport.
    pub fn take(&mut self) -> Option<Frame> {
        let frame = self.waiting.pop_front()?;
        if !self.finished {
            self.unacknowledged.push_back(frame.header.seq);
        }
        Some(frame)
    }
}

/// Packs the frames of one stream. Remembers what the reader holds, for frames that carry changes only.
#[derive(Debug, Default)]
pub(crate) struct FramePacker {
    /// What the positions in the buffers are relative to.
    origin: DVec3,
    /// The buffer that the reader holds after each frame that it was sent and has not acknowledged, with the frame's seq.
    sent: VecDeque<(u64, Vec<Vec3>)>,
    /// The buffer after the newest acknowledged frame.
    acknowledged: Option<Vec<Vec3>>,
    /// A buffer that is out of date, for the next frame.
    spare: Vec<Vec3>,
    /// How many vertices the last frame carried.
    carried: usize,
}

/// Buffers remembered at most; more than any window.
const REMEMBERED: usize = 128;

impl FramePacker {
    /// Chooses the vertices of a frame. `acknowledged` is the newest seq that the reader has acknowledged.
    pub fn pack_frame(&mut self, mut frame: Frame, acknowledged: Option<u64>) -> Frame {
        frame.selected = None;
        let Some(threshold) = frame.output.changed_only else {
            *self = Self::default();
            return frame;
        };
        let positions = frame.positions.as_slice();
        let mut buffers = self.acknowledged.iter().chain(self.sent.iter().map(|s| &s.1));
        if buffers.any(|buffer| buffer.len() != positions.len()) || self.origin != frame.origin {
            // An edit has changed the number of vertices: the reader gets all of them.
            *self = Self::default();
            self.origin = frame.origin;
        }
        let is_read = |seq: u64| acknowledged.is_some_and(|a| seq <= a);
        while self.sent.front().is_some_and(|(seq, _)| is_read(*seq)) {
            let read = self.sent.pop_front().map(|(_, buffer)| buffer);
            self.spare = std::mem::replace(&mut self.acknowledged, read).unwrap_or_default();
        }
        let reader = self.acknowledged.as_ref().map(|acknowledged| ReaderBuffers {
            acknowledged,
            sent: self.sent.back().map(|(_, buffer)| buffer.as_slice()),
        });
        let mut buffer = std::mem::take(&mut self.spare);
        let mut selected = Vec::with_capacity(self.carried.min(positions.len()));
        select_changed(
            &RelativePlaces {
                positions,
                origin: self.origin,
            },
            reader,
            threshold * frame.diagonal,
            &mut selected,
            &mut buffer,
        );
        self.carried = selected.len();
        self.sent.push_back((frame.header.seq, buffer));
        if self.sent.len() > REMEMBERED {
            self.sent.pop_front();
        }
        frame.selected = Some(selected);
        frame
    }
}

/// What a reader holds.
#[derive(Debug, Clone, Copy)]
struct ReaderBuffers<'a> {
    acknowledged: &'a [Vec3],
    /// After the last frame that it was sent, where that is another. Frames arrive in order, so the reader will hold this when the
    /// next one comes, unless it rebuilds what it has acknowledged: a vertex is left out only when both are right.
    sent: Option<&'a [Vec3]>,
}

/// Where vertices are, as a frame holds them.
struct RelativePlaces<'a> {
    positions: &'a [DVec3],
    origin: DVec3,
}

impl RelativePlaces<'_> {
    fn all(&self) -> impl ExactSizeIterator<Item = Vec3> {
        self.positions.iter().map(|p| (*p - self.origin).as_vec3())
    }
}

/// Selects the vertices that lie further than `distance` from their place in any of the reader's buffers, ascending, and writes what
/// it holds after it was sent them. Without buffers all are selected.
fn select_changed(
    places: &RelativePlaces<'_>,
    reader: Option<ReaderBuffers<'_>>,
    distance: f64,
    selected: &mut Vec<u32>,
    after: &mut Vec<Vec3>,
) {
    after.clear();
    after.reserve_exact(places.positions.len());
    let Some(ReaderBuffers { acknowledged, sent }) = reader else {
        after.extend(places.all());
        selected.extend((0..after.len()).map(|v| v as u32));
        return;
    };
    // Both sides are rounded alike, so that a vertex that rests has moved by exactly nothing.
    for (v, p) in places.all().enumerate() {
        let is_far = |from: Vec3| (p.as_dvec3() - from.as_dvec3()).length() > distance;
        if is_far(acknowledged[v]) || sent.is_some_and(|sent| is_far(sent[v])) {
            selected.push(v as u32);
            after.push(p);
        } else {
            after.push(sent.unwrap_or(acknowledged)[v]);
        }
    }
}

#[cfg(test)]
mod frame_packer_tests {
    use super::*;
    use pliant_wire::frames::{FrameOutput, encode};
    use pliant_wire::pb;
    use proptest::prelude::*;
    use std::sync::Arc;

    fn frame(seq: u64, positions: &[DVec3], threshold: f64) -> Frame {
        Frame {
            header: pb::Frame {
                seq,
                ..Default::default()
            },
            diagonal: 1.0,
            positions: Arc::new(positions.to_vec()),
            output: FrameOutput {
                changed_only: Some(threshold),
                ..Default::default()
            },
            part_bytes: 1 << 20,
            ..Frame::default()
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
            let mut packer = FramePacker::default();
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
        let mut packer = FramePacker::default();
        let count = |frame: Frame| frame.selected.map(|s| s.len());
        assert_eq!(count(packer.pack_frame(frame(1, &shape, 0.0), None)), Some(5));
        assert_eq!(
            count(packer.pack_frame(frame(2, &shape, 0.0), None)),
            Some(5),
            "nothing is acknowledged yet"
        );
        assert_eq!(count(packer.pack_frame(frame(3, &shape, 0.0), Some(1))), Some(0));
    }

    #[test]
    fn only_vertices_that_left_some_buffer_are_selected() {
        let mut positions: Vec<DVec3> = (0..100)
            .map(|i| DVec3::new(f64::from(i) * 0.37 - 4.0, 0.1, 2.5))
            .collect();
        let rest: Vec<Vec3> = positions.iter().map(|p| p.as_vec3()).collect();
        let mut later = rest.clone();
        later[3].x += 1.0;
        positions[8].z += 0.5;
        positions[9].z += 0.05;
        let select = |reader, distance| {
            let (mut selected, mut after) = (Vec::new(), vec![Vec3::NAN; 3]);
            let places = RelativePlaces {
                positions: &positions,
                origin: DVec3::ZERO,
            };
            select_changed(&places, reader, distance, &mut selected, &mut after);
            (selected, after)
        };
        let reader = ReaderBuffers {
            acknowledged: &rest,
            sent: Some(&later),
        };
        let (selected, after) = select(Some(reader), 0.1);
        assert_eq!(selected, [3, 8]);
        let mut expected = later.clone();
        for v in [3, 8] {
            expected[v] = positions[v].as_vec3();
        }
        assert_eq!(after, expected, "what was not sent stays where it was");
        let (selected, after) = select(Some(reader), 2.0);
        assert!(selected.is_empty() && after == later);
        let all: Vec<u32> = (0..100).collect();
        let (selected, after) = select(None, 2.0);
        assert_eq!(selected, all, "a reader that holds nothing gets everything");
        let expected: Vec<Vec3> = positions.iter().map(|p| p.as_vec3()).collect();
        assert_eq!(after, expected);
    }
}
