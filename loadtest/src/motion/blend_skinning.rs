//! Linear blend skinning, which everything is compared with.

use crate::failure::LoadtestFailure;
use crate::motion::stage::{MotionStage, failed};
use glam::DVec3;
use pliant::engine::bind_model;
use pliant::exec::Exec;
use pliant::motion::BoneInfluences;
use pliant::motion::rig::RigidMotion;
use pliant::pool::Pool;
use pliant::progress::Silent;

/// Bones that a vertex follows.
const INFLUENCES: usize = 4;

/// Weights for a stage's model and rig.
pub(super) fn bind(stage: &MotionStage, pool: &Pool) -> Result<Vec<BoneInfluences>, LoadtestFailure> {
    let exec = Exec::new(pool, &Silent);
    let bound = bind_model(stage.deformer.model(), &stage.rig, INFLUENCES, &exec);
    Ok(bound.map_err(failed)?.influences)
}

/// Where vertices are when each follows its bones.
pub(super) fn skinned(rest: &[DVec3], influences: &[BoneInfluences], bones: &[RigidMotion]) -> Vec<DVec3> {
    let pairs = rest.iter().zip(influences);
    pairs.map(|(p, own)| own.blend(|bone| bones[bone].place(*p))).collect()
}
