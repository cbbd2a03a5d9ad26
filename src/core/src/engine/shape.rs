//! Shapes by name, so that a deformer knows again what it has made.

use super::topology_id::TopologyId;
use glam::DVec3;
use std::sync::Arc;

/// Names a shape of one deformer. Two shapes that it made and that have one name have the same positions; all others share a
/// name that no deformer remembers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ShapeId {
    topology: TopologyId,
    /// Solutions are counted from 1; 0 is the rest shape.
    solution: u64,
}

/// A shape of a deformer's model. Cheap to clone.
#[derive(Debug, Clone)]
pub struct ModelShape {
    /// Its name.
    pub id: ShapeId,
    /// Where the render vertices are, model space.
    pub positions: Arc<Vec<DVec3>>,
}

impl ModelShape {
    /// Makes a shape that no deformer remembers.
    pub fn from_positions(positions: Arc<Vec<DVec3>>) -> Self {
        Self {
            id: ShapeId::solution(TopologyId::default(), u64::MAX),
            positions,
        }
    }
}

impl std::ops::Deref for ModelShape {
    type Target = [DVec3];

    fn deref(&self) -> &[DVec3] {
        &self.positions
    }
}

impl ShapeId {
    /// Names the rest shape of a topology.
    pub(super) fn rest(topology: TopologyId) -> Self {
        Self { topology, solution: 0 }
    }

    /// Names a solution on a topology; `solution` is above 0 and never given twice.
    pub(super) fn solution(topology: TopologyId, solution: u64) -> Self {
        Self { topology, solution }
    }
}
