//! Rotations blended without trigonometry, for many poses a second.
//!
//! At each node the quaternions of the few handles with a weight there get the sign of the heaviest one, are weighted,
//! summed and normalised. It costs some multiplications a node, and is as good as the mean on the sphere where handles
//! differ by less than half a turn there; whole turns are lost.

use crate::deform::first_pass::frame::LocalRotation;
use crate::deform::handles::system::HandleSystem;
use crate::deform::transform::Transform;
use crate::mesh::rotation::exp_rotation;
use crate::pool::Pool;
use glam::Quat;
use rayon::prelude::*;

/// The rotations of all nodes for the holds' transforms.
pub(in crate::deform) fn weighted_sums(
    rig: &HandleSystem,
    transforms: &[Transform],
    pool: &Pool,
) -> Vec<LocalRotation> {
    let shares = rig.sparse_shares(pool);
    // The frozen surroundings stand still; they come after the holds.
    let holds: Vec<Quat> = (transforms.iter())
        .map(|t| exp_rotation(t.rotation).as_quat())
        .chain([Quat::IDENTITY])
        .collect();
    let blend = |node: usize| {
        let some = shares.at(node);
        let Some(&(most, _)) = some.first() else {
            return Quat::IDENTITY.to_array();
        };
        let most = holds[most as usize];
        let mut sum = Quat::from_array([0.0; 4]);
        for &(hold, share) in some {
            let hold = holds[hold as usize];
            let share = if hold.dot(most) < 0.0 { -share } else { share };
            sum += hold * share;
        }
        match sum.length_squared() > 1e-12 {
            true => sum.normalize().to_array(),
            false => most.to_array(),
        }
    };
    pool.install(|| {
        (0..shares.nodes())
            .into_par_iter()
            .with_min_len(4096)
            .map(blend)
            .collect()
    })
}
