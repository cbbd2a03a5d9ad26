//! The rest shape in single precision, for sums over edges that need no more.

use glam::{DVec3, Vec3A};

/// Rest positions and their Laplacian in single precision, solving coordinates.
#[derive(Debug)]
pub(in crate::deform) struct SingleRest {
    pub(in crate::deform) positions: Vec<Vec3A>,
    pub(in crate::deform) laplacian: Vec<Vec3A>,
}

impl SingleRest {
    /// `position` and `laplacian` return those of a node.
    pub(in crate::deform) fn of(
        nodes: usize,
        position: impl Fn(usize) -> DVec3,
        laplacian: impl Fn(usize) -> DVec3,
    ) -> Self {
        // One thread: whoever waits for the others here could be handed work that waits for this.
        Self {
            positions: (0..nodes).map(|i| position(i).as_vec3a()).collect(),
            laplacian: (0..nodes).map(|i| laplacian(i).as_vec3a()).collect(),
        }
    }

    pub(in crate::deform) fn byte_size(&self) -> usize {
        (self.positions.capacity() + self.laplacian.capacity()) * size_of::<Vec3A>()
    }
}
