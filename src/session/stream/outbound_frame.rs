//! A frame on its way out: what is known of it before its numbers are encoded.

use crate::engine::Shading;
use crate::session::answers::StreamAnswer;
use crate::session::history::loaded_deformer::CommitSolution;
use crate::wire::DeformOptions;
use crate::wire::frames::{FrameHeader, FrameOutput, FrameRequest};
use glam::{DVec3, Vec3};
use std::sync::Arc;
use std::time::Duration;

/// A frame of which it is not known yet what the reader holds.
#[derive(Debug, Clone)]
pub(in crate::session) struct OutboundFrame {
    pub header: FrameHeader,
    pub positions: Arc<Vec<DVec3>>,
    pub shading: Option<Arc<Shading>>,
    pub output: FrameOutput,
    pub diagonal: f64,
}

impl OutboundFrame {
    /// The frame for a reader that may hold `baselines`. Where it wants changes only, a vertex is sent when it moved away from
    /// its place in any of them; without any, or with one of another length, all are sent.
    pub fn into_request(self, baselines: &[Arc<Vec<Vec3>>], part_bytes: usize) -> FrameRequest {
        let selected = (self.output.changed_only)
            .map(|threshold| changed_vertices(&self.positions, baselines, threshold * self.diagonal));
        FrameRequest {
            header: self.header,
            positions: self.positions,
            shading: self.shading,
            output: self.output,
            selected,
            part_bytes,
        }
    }
}

/// Vertices that lie further than `distance` from their place in any of the baselines, ascending.
fn changed_vertices(positions: &[DVec3], baselines: &[Arc<Vec<Vec3>>], distance: f64) -> Vec<u32> {
    let all = baselines.is_empty() || baselines.iter().any(|b| b.len() != positions.len());
    // Both sides are rounded alike, so that a vertex that rests has moved by exactly nothing.
    let moved = |v: usize, p: Vec3| {
        baselines
            .iter()
            .any(|b| (p.as_dvec3() - b[v].as_dvec3()).length() > distance)
    };
    let indices = positions
        .iter()
        .enumerate()
        .filter(|&(v, p)| all || moved(v, p.as_vec3()));
    indices.map(|(v, _)| v as u32).collect()
}

/// What all frames of one piece of work have in common.
#[derive(Debug, Clone)]
pub(in crate::session) struct FrameContext {
    pub revision: u64,
    pub diagonal: f64,
    /// How long the work waited for a compute slot.
    pub queued: Duration,
}

/// A shape to be sent, and how good it is.
#[derive(Debug)]
pub(in crate::session) struct FrameShape {
    pub positions: Arc<Vec<DVec3>>,
    pub shading: Option<Arc<Shading>>,
    /// Relative residual reached.
    pub residual: f64,
    /// Estimated largest missing displacement.
    pub max_error: f64,
}

impl FrameContext {
    /// A frame that tells `shape`, `solve_time` after the solve began.
    pub fn build_frame(&self, seq: u64, output: FrameOutput, shape: FrameShape, solve_time: Duration) -> OutboundFrame {
        let header = FrameHeader {
            seq,
            revision: self.revision,
            residual: shape.residual,
            max_error: shape.max_error,
            solve_ms: solve_time.as_secs_f64() * 1e3,
            queue_ms: self.queued.as_secs_f64() * 1e3,
            ..FrameHeader::default()
        };
        OutboundFrame {
            header,
            positions: shape.positions,
            shading: shape.shading,
            output,
            diagonal: self.diagonal,
        }
    }

    /// The frame that ends the work on a pose.
    pub fn final_frame(&self, seq: u64, settings: &DeformOptions, solution: &CommitSolution) -> OutboundFrame {
        let shape = FrameShape {
            positions: Arc::clone(&solution.solved.positions),
            shading: solution.shading.clone(),
            residual: solution.solved.residual,
            max_error: solution.solved.max_error,
        };
        let mut frame = self.build_frame(seq, settings.output, shape, solution.solve_time);
        frame.header.is_final = true;
        frame.header.quality = solution.quality;
        frame
    }
}

/// Something for the transport.
#[derive(Debug)]
pub(in crate::session) enum OutboundItem {
    /// Words, ready to be sent.
    Words(StreamAnswer),
    Frame(Box<OutboundFrame>),
    End,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_vertices_that_left_some_baseline_are_selected() {
        let mut positions: Vec<DVec3> = (0..100)
            .map(|i| DVec3::new(f64::from(i) * 0.37 - 4.0, 0.1, 2.5))
            .collect();
        let rest: Vec<Vec3> = positions.iter().map(|p| p.as_vec3()).collect();
        let mut later = rest.clone();
        later[3].x += 1.0;
        positions[8].z += 0.5;
        positions[9].z += 0.05;
        let baselines = [Arc::new(rest), Arc::new(later)];
        assert_eq!(changed_vertices(&positions, &baselines, 0.1), [3, 8]);
        assert!(changed_vertices(&positions, &baselines, 2.0).is_empty());
        let all: Vec<u32> = (0..100).collect();
        assert_eq!(
            changed_vertices(&positions, &[], 2.0),
            all,
            "a reader that holds nothing gets everything"
        );
    }
}
