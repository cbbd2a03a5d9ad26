//! What rides along, packed for frames: where it goes, and how space around every render vertex has turned and stretched.

use super::riding::RidingVertices;
use crate::mesh::carry::{CarrySurface, LocalGradients, PackedMotion, PackedPoints};
use crate::mesh::{Mesh, NONE};
use crate::pool::Pool;
use glam::DVec3;
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes that a solved vertex takes.
const BYTES_OF_SOLVED: usize = 64;
/// Bytes of the gradient at a render vertex.
const BYTES_OF_GRADIENT: usize = 40;

/// What gradients of frames are made of; built for the first one.
#[derive(Debug)]
pub(super) struct PackedRiders {
    riders: PackedPoints,
    /// The render vertices that are solved.
    solved: PackedPoints,
    vertices: usize,
    /// The gradients of the last frame. Once they are held only here the next frame is written over them, because fresh memory costs
    /// more than what is written to it.
    last: Mutex<Option<Arc<LocalGradients>>>,
}

impl PackedRiders {
    /// Packs the vertices of a model.
    pub fn pack(surface: &CarrySurface, mesh: &Mesh, riders: Option<&RidingVertices>, pool: &Pool) -> Self {
        let of_render = (0u32..).zip(&mesh.solver_from_render);
        let solved: Vec<(u32, u32)> = of_render.filter(|(_, s)| **s != NONE).map(|(v, s)| (v, *s)).collect();
        Self {
            riders: riders.map_or_else(PackedPoints::default, |riders| riders.packed(surface, pool)),
            solved: PackedPoints::at_vertices(&solved, surface, pool),
            vertices: mesh.solver_from_render.len(),
            last: Mutex::default(),
        }
    }

    /// Bytes that packing takes at most.
    pub fn estimate(mesh: &Mesh, riders: Option<&RidingVertices>) -> u64 {
        let solved = mesh.solver_from_render.len() * (BYTES_OF_SOLVED + BYTES_OF_GRADIENT);
        (riders.map_or(0, RidingVertices::byte_size) + solved) as u64
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.riders.byte_size() + self.solved.byte_size() + self.vertices * BYTES_OF_GRADIENT
    }

    /// The gradients of the last frame, or of rest.
    fn take_last(&self, pool: &Pool) -> LocalGradients {
        let last = self.last.lock().unwrap_or_else(PoisonError::into_inner).take();
        let only_here = last.and_then(|last| Arc::try_unwrap(last).ok());
        only_here.unwrap_or_else(|| LocalGradients::resting(self.vertices, pool))
    }

    fn keep_last(&self, last: LocalGradients) -> Arc<LocalGradients> {
        let last = Arc::new(last);
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&last));
        last
    }
}

/// Packed riders on their surface.
#[derive(Clone, Copy)]
pub(super) struct RidingFrames<'a> {
    pub surface: &'a CarrySurface,
    pub packed: &'a PackedRiders,
    pub riders: Option<&'a RidingVertices>,
}

impl RidingFrames<'_> {
    /// Carries what rides along when the surface is at `current`: places it in `positions`, which have its rest pose, where they are
    /// given, and answers how space around each render vertex has turned and stretched.
    pub fn place(&self, current: &[DVec3], positions: Option<&mut [DVec3]>, pool: &Pool) -> Arc<LocalGradients> {
        let motion = PackedMotion::between(self.surface, current, pool);
        // Each vertex that is carried or copied is written in every frame; the others rest.
        let mut gradients = self.packed.take_last(pool);
        self.packed.solved.carry(&motion, None, &mut gradients, pool);
        let mut positions = positions;
        (self.packed.riders).carry(&motion, positions.as_deref_mut(), &mut gradients, pool);
        for &(vertex, like) in self.riders.map_or(&[][..], RidingVertices::on_vertices) {
            gradients.copy(vertex as usize, like as usize);
            if let Some(positions) = &mut positions {
                positions[vertex as usize] = positions[like as usize];
            }
        }
        self.packed.keep_last(gradients)
    }
}
