//! The rest shape in single precision, for sums over edges that need no more.

use crate::deform::body::DeformableBody;
use glam::Vec3A;

/// Rest positions and their Laplacian in single precision, solving coordinates.
#[derive(Debug)]
pub(in crate::deform) struct SingleRest {
    pub(in crate::deform) positions: Vec<Vec3A>,
    pub(in crate::deform) laplacian: Vec<Vec3A>,
}

impl SingleRest {
    pub(in crate::deform) fn of(body: &DeformableBody) -> Self {
        // One thread: whoever waits for the others here could be handed work that waits for this.
        let nodes = 0..body.nodes();
        Self {
            positions: nodes.clone().map(|i| body.rest(i).as_vec3a()).collect(),
            laplacian: nodes.map(|i| body.laplacian(i).as_vec3a()).collect(),
        }
    }

    pub(in crate::deform) fn byte_size(&self) -> usize {
        (self.positions.capacity() + self.laplacian.capacity()) * size_of::<Vec3A>()
    }
}
