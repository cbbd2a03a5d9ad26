//! The rest shape in single precision, for sums over edges that need no more.

use glam::{DVec3, Vec3A};

/// Rest positions and their Laplacian in single precision, solving coordinates.
#[derive(Debug)]
pub(in crate::deform) struct SingleRest {
    pub(in crate::deform) positions: Vec<Vec3A>,
    pub(in crate::deform) laplacian: Vec<Vec3A>,
}

impl SingleRest {
    pub(in crate::deform) fn of(rest: &[[f64; 3]], laplacian: &[[f64; 3]]) -> Self {
        let single = |all: &[[f64; 3]]| all.iter().map(|p| DVec3::from_array(*p).as_vec3a()).collect();
        Self {
            positions: single(rest),
            laplacian: single(laplacian),
        }
    }

    pub(in crate::deform) fn byte_size(&self) -> usize {
        (self.positions.capacity() + self.laplacian.capacity()) * size_of::<Vec3A>()
    }
}
