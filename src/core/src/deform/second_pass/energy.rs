//! How far a shape is from moving rigidly piece by piece: the energy that fitting rotations makes smaller.

use crate::deform::body::DeformableBody;
use crate::deform::first_pass::spread::FirstRotations;
use crate::deform::handles::system::HandleSystem;
use crate::deform::second_pass::refine::{Refinement, RotationFit};
use crate::deform::transform::Transform;
use crate::pool::Pool;
use glam::{DVec3, Mat3};

impl HandleSystem {
    /// The as-rigid-as-possible energy of node positions (model space): Σ w |x_i − x_j − M_i (p_i − p_j)|² over all edges, both ways,
    /// relative to Σ w |p_i − p_j|², with the rotations that make it least where no handle says them. Pulls of soft handles have no
    /// part in it.
    pub fn energy(&self, body: &DeformableBody, transforms: &[Transform], positions: &[DVec3], pool: &Pool) -> f64 {
        let moved_parts = self.moved_parts(body, transforms);
        let first = FirstRotations::BLEND;
        let fit = RotationFit::new(body, self, transforms, &moved_parts, &first, Refinement::default());
        let x: Vec<f64> = positions
            .iter()
            .flat_map(|p| body.solving_from_model(*p).to_array())
            .collect();
        let frames = fit.frames(&fit.step(&fit.start(pool), &x, pool), pool);
        let at = |i: usize| DVec3::from_slice(&x[3 * i..3 * i + 3]);
        let rest = |i: usize| body.rest(i);
        let (mut sum, mut size) = (0.0, 0.0);
        for (i, frame) in frames.iter().enumerate() {
            let frame = Mat3::from_cols_array(frame).as_dmat3();
            for (j, w) in body.edges(i) {
                let edge = rest(i) - rest(j);
                sum += w * (at(i) - at(j) - frame * edge).length_squared();
                size += w * edge.length_squared();
            }
        }
        if size > 0.0 { sum / size } else { 0.0 }
    }
}
