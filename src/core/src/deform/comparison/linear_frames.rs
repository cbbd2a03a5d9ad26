//! Linear frames (Lipman et al. 2005), for comparison with the paper's first pass (its figure 2).
//!
//! The frames B_i change along every edge as the rest frames do: they minimise Σ w ‖B_j − (I + Γ_ij) B_i‖² with the
//! handles' frames given. Written as B_i = M_i B_i⁰ this is Σ w ‖M_j − M_i‖², so each of the nine entries of M is
//! harmonic between the handles' rotations. The bounded fields u_k span the harmonic functions between the same
//! handles, hence M_i = Σ_k u_k(i) R_k, without a solve. M is not a rotation: half-way through a turn by θ it shrinks
//! to cos(θ/2) across the axis. The nearest rotation replaces it.

use crate::deform::first_pass::blend::PoseBlend;
use crate::deform::first_pass::frame::{LocalRotation, pack_rotation};
use crate::mesh::rotation::fit_rotation;
use crate::pool::Pool;
use glam::DQuat;
use rayon::prelude::*;

/// The rotations of all nodes.
pub(in crate::deform) fn linear_frames(blend: &PoseBlend<'_>, nodes: usize, pool: &Pool) -> Vec<LocalRotation> {
    pool.install(|| {
        (0..nodes)
            .into_par_iter()
            .with_min_len(1024)
            .map(|i| pack_rotation(blend.matrix(i).map_or(DQuat::IDENTITY, fit_rotation)))
            .collect()
    })
}
