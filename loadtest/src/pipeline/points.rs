//! Many point handles on a model, all of which move.

use crate::models::longest_axis;
use glam::DVec3;
use pliant::mesh::BoundingBox;
use pliant::wire::pb;
use std::f64::consts::TAU;

/// Largest rise of a point, as a part of the model's longest side.
const RISE: f64 = 0.05;
/// Largest turn of a point, radians.
const TURN: f64 = 0.5;
/// Poses of one wave.
const WAVE: f64 = 120.0;

/// Points on a model, at most one handle each.
pub(crate) struct PointScene {
    /// Render vertices, and how far along the longest side each is, 0 to 1.
    points: Vec<(u32, f64)>,
    axis: usize,
    length: f64,
}

impl PointScene {
    /// Spreads `count` points over a model with these vertices: every so many along a curve through space (Morton 1966).
    pub(crate) fn spread(positions: &[DVec3], count: usize) -> Self {
        let bounds = BoundingBox::of(positions);
        let axis = longest_axis(&bounds);
        let length = bounds.size()[axis];
        let cell = |p: &DVec3| {
            ((*p - bounds.min) / length * f64::from(1 << 20))
                .to_array()
                .map(|c| c as u64)
        };
        let mut order: Vec<(u64, u32)> = (0u32..)
            .zip(positions)
            .map(|(vertex, p)| (interleaved(cell(p)), vertex))
            .collect();
        order.sort_unstable();
        let count = count.min(order.len());
        let points = (0..count).map(|k| {
            let vertex = order[(2 * k + 1) * order.len() / (2 * count)].1;
            (vertex, (positions[vertex as usize] - bounds.min)[axis] / length)
        });
        Self {
            points: points.collect(),
            axis,
            length,
        }
    }

    /// A job with a handle for each point.
    pub(crate) fn job(&self) -> pb::Job {
        let handle = |(k, (vertex, _)): (usize, &(u32, f64))| {
            let region = pb::region::Region::Vertices(pb::region::Vertices {
                indices: vec![*vertex],
                ..Default::default()
            });
            pb::Handle {
                id: k.to_string(),
                region: Some(pb::Region { region: Some(region) }),
                ..Default::default()
            }
        };
        pb::Job {
            handles: self.points.iter().enumerate().map(handle).collect(),
            ..Default::default()
        }
    }

    /// The pose number `seq`: a wave runs along the model and turns each point about two axes.
    pub(crate) fn pose_number(&self, seq: u64) -> pb::Pose {
        let axis = self.axis;
        let swing = (TAU * seq as f64 / WAVE).sin();
        let entry = |(k, (_, along)): (usize, &(u32, f64))| {
            let (mut turn, mut rise) = (vec![0.0; 3], vec![0.0; 3]);
            rise[(axis + 1) % 3] = RISE * self.length * swing * (TAU * along).sin();
            turn[(axis + 2) % 3] = TURN * swing * (TAU * along).cos();
            turn[axis] = TURN * swing * along;
            pb::pose::Entry {
                id: k.to_string(),
                pose: Some(pb::HandlePose {
                    rotation_vector: turn,
                    translation: rise,
                    ..Default::default()
                }),
            }
        };
        pb::Pose {
            seq,
            handles: self.points.iter().enumerate().map(entry).collect(),
            commit: false,
            ..pb::Pose::default()
        }
    }
}

/// The bits of three numbers below 2²¹ in turn.
fn interleaved(cell: [u64; 3]) -> u64 {
    let bits = |k: u32| {
        (0..3)
            .map(move |c| (cell[c as usize] >> k & 1) << (3 * k + c))
            .sum::<u64>()
    };
    (0..21).map(bits).sum()
}
