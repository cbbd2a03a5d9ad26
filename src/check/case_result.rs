//! What running a case came to, and what golden keeps of it.

use super::metric::{Metric, format_point};
use super::named::Named as _;
use crate::wire::pb;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use xxhash_rust::xxh3::Xxh3;

/// A case result is the shape that a case's job produced, with the engine's numbers.
#[derive(Debug, Clone, Default)]
pub struct CaseResult {
    /// One per render vertex, model space.
    pub positions: Vec<DVec3>,
    /// Triangles over them.
    pub triangles: Vec<[u32; 3]>,
    /// Digest of the positions before any rounding.
    pub digest: String,
    /// Of an animation, digests of all frames; `positions` and `digest` are then those of the last one.
    pub frames: Vec<String>,
    /// Whether `positions` are rounded to 32 bits, as they come from a server.
    pub rounded: bool,
    /// Numbers of the engine. A server omits some; an open surface has no volume.
    pub numbers: BTreeMap<Metric, f64>,
    /// Whether the surface is open, so that it encloses no volume that could change.
    pub open_surface: bool,
    /// Expectations of the job that need no golden and do not hold.
    pub unmet: Vec<String>,
    /// The shape before, as the model's file has it.
    pub before: (Vec<DVec3>, Vec<[u32; 3]>),
}

/// Topology digests count a shape's vertices and triangles, and digest the triangles.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TopologyDigests {
    /// Render vertices.
    pub vertices: usize,
    /// Triangles.
    pub triangles: usize,
    /// Digest of the triangles in their order, corner by corner.
    pub digest: String,
    /// The same of the triangles without their winding: each one's corners in rising order.
    pub unwound: String,
}

impl TopologyDigests {
    /// Digests the triangles of a result.
    pub fn from_triangles(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let digest = |corners: fn([u32; 3]) -> [u32; 3]| {
            let mut hash = Xxh3::new();
            for t in triangles {
                corners(*t).iter().for_each(|v| hash.update(&v.to_le_bytes()));
            }
            format!("xxh3:{:016x}", hash.digest())
        };
        Self {
            vertices,
            triangles: triangles.len(),
            digest: digest(|t| t),
            unwound: digest(|mut t| {
                t.sort_unstable();
                t
            }),
        }
    }
}

impl CaseResult {
    /// Takes the numbers of a report's quality, except constraint errors, which are in model units.
    pub fn take_quality(&mut self, quality: &pb::Quality) {
        self.open_surface = quality.open_surface;
        self.numbers.extend([
            (Metric::EdgeRms, quality.edge_rms),
            (Metric::MaxStretch, quality.max_stretch),
            (Metric::AreaChange, quality.area_change),
            (Metric::FoldedTriangles, f64::from(quality.flipped_triangles)),
        ]);
        if self.has_metric(Metric::VolumeChange) {
            self.numbers.insert(Metric::VolumeChange, quality.volume_change);
        }
        let crossing = quality.new_self_intersections.map(f64::from);
        (self.numbers).extend(crossing.map(|pairs| (Metric::NewSelfIntersections, pairs)));
    }

    /// Whether the metric applies to this shape, known or not.
    pub fn has_metric(&self, metric: Metric) -> bool {
        match metric {
            Metric::VolumeChange => !self.open_surface,
            Metric::NewSelfIntersections => self.numbers.contains_key(&metric),
            _ => true,
        }
    }

    /// Describes what is not finite; `None` when all is finite.
    pub fn describe_not_finite(&self) -> Option<String> {
        let bad: Vec<usize> = (0..self.positions.len())
            .filter(|&v| !self.positions[v].is_finite())
            .collect();
        if let Some(&first) = bad.first() {
            let count = bad.len();
            let of = self.positions.len();
            return Some(format!(
                "{count} of {of} positions are not finite, the first is vertex {first} at {}",
                format_point(self.positions[first])
            ));
        }
        let (metric, value) = self.numbers.iter().find(|(_, value)| !value.is_finite())?;
        Some(format!("{} is {value}", metric.name()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topology_distinguishes_winding_from_the_rest() {
        let one = TopologyDigests::from_triangles(4, &[[0, 1, 2], [2, 1, 3]]);
        assert_eq!(one, TopologyDigests::from_triangles(4, &[[0, 1, 2], [2, 1, 3]]));
        let wound = TopologyDigests::from_triangles(4, &[[0, 1, 2], [2, 3, 1]]);
        assert_ne!(one.digest, wound.digest);
        assert_eq!(one.unwound, wound.unwound);
        let other = TopologyDigests::from_triangles(4, &[[0, 1, 2], [0, 1, 3]]);
        assert_ne!(one.unwound, other.unwound);
    }

    #[test]
    fn an_open_surface_has_no_volume_and_a_closed_one_has() {
        let taken = |open_surface| {
            let mut found = CaseResult::default();
            found.take_quality(&pb::Quality {
                open_surface,
                area_change: 0.5,
                ..Default::default()
            });
            found.numbers
        };
        assert_eq!(taken(false)[&Metric::VolumeChange], 0.0);
        let open = taken(true);
        assert_eq!(
            (open.get(&Metric::VolumeChange), open[&Metric::AreaChange]),
            (None, 0.5)
        );
    }

    #[test]
    fn what_is_not_finite_is_named() {
        let mut found = CaseResult {
            positions: vec![DVec3::ZERO, DVec3::new(0.0, f64::NAN, 0.0)],
            ..Default::default()
        };
        assert!(found.describe_not_finite().expect("NaN").contains("vertex 1"));
        found.positions.pop();
        assert_eq!(found.describe_not_finite(), None);
        found.numbers.insert(Metric::EdgeRms, f64::INFINITY);
        assert!(found.describe_not_finite().expect("infinite").contains("edgeRms"));
    }
}
