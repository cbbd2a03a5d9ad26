//! Shapes brought from the graph's nodes back to render vertices.

use super::riding::RidingVertices;
use crate::deform::{DeformableBody, Transform};
use crate::mesh::carry::CarrySurface;
use crate::mesh::{Mesh, NONE};
use crate::pool::Pool;
use glam::{DVec3, Mat3};
use rayon::prelude::*;

/// Vertices that one piece of work handles at least.
const PIECE: usize = 4096;

/// From graph nodes back to render vertices.
pub(super) struct ShapeTransfer<'a> {
    pub body: &'a DeformableBody,
    pub mesh: &'a Mesh,
    pub rest: &'a [DVec3],
    /// Render vertices in no face that a hard handle holds, with its hold.
    pub strays: &'a [(u32, u32)],
    pub riders: Option<(&'a CarrySurface, &'a RidingVertices)>,
    pub pool: &'a Pool,
}

impl ShapeTransfer<'_> {
    /// One position per render vertex for those of the nodes, their frames and the handles' transforms.
    pub fn render(&self, nodes: &[DVec3], frames: &[[f32; 9]], transforms: &[Transform]) -> Vec<DVec3> {
        let at_rest = &self.body.graph.positions;
        let place = |(&rest, &solver): (&DVec3, &u32)| {
            let s = solver as usize;
            // Bits, not values: -0 and 0 are different bytes of the model.
            if solver == NONE || nodes[s] == at_rest[s] {
                return rest;
            }
            // Welding by tolerance leaves render vertices a little beside their solver vertex.
            let beside = rest - at_rest[s];
            let frame = frames.get(s).map_or(Mat3::IDENTITY, Mat3::from_cols_array);
            if beside == DVec3::ZERO {
                nodes[s]
            } else {
                nodes[s] + frame.as_dmat3() * beside
            }
        };
        let mut positions: Vec<DVec3> = self.pool.install(|| {
            let vertices = self.rest.par_iter().zip(&self.mesh.solver_from_render);
            vertices.with_min_len(PIECE).map(place).collect()
        });
        for &(vertex, hold) in self.strays {
            if let Some(t) = transforms.get(hold as usize) {
                positions[vertex as usize] = t.map()(positions[vertex as usize]);
            }
        }
        if let Some((surface, riders)) = self.riders {
            // As elsewhere: what has not moved keeps the bits of the rest shape.
            let current = &nodes[..self.mesh.positions.len()];
            riders.place(surface, current, &mut positions, self.pool);
        }
        positions
    }
}
