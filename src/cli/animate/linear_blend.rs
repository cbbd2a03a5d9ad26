//! What linear blend skinning makes of the bones that move a frame, to be drawn beside it.

use super::taken_frames::PlayedAnimation;
use crate::cli::failure::CliFailure;
use crate::engine::{AnimatedFrame, bind_model, influences_of_skin};
use crate::motion::BoneInfluences;
use crate::motion::rig::{RigSkeleton, RigidMotion};
use glam::DVec3;
use rayon::prelude::*;

/// Bones that a vertex follows at most where the model says nothing of it.
const INFLUENCES: usize = 4;

/// What the bones of the rig do in a frame, in the space that its positions are in.
pub(super) fn bone_motions(played: &PlayedAnimation<'_>, frame: &AnimatedFrame) -> Vec<RigidMotion> {
    let animation = played.animation;
    let rig = animation.moving_rig();
    let pose = animation.driver().pose_at(frame.seconds);
    RigSkeleton::of_rig(rig, false).motions_in(rig, &pose, &frame.root)
}

/// Bones and weights.
pub(super) struct LinearBlendSkin(Vec<BoneInfluences>);

impl LinearBlendSkin {
    /// The model's own where its own clip is played, else those of `pliant skin`.
    pub(super) fn of_played(played: &PlayedAnimation<'_>) -> Result<Self, CliFailure> {
        let (model, rig) = (played.deformer.model(), played.animation.moving_rig());
        Ok(Self(match played.animation.own_clip() {
            Some(_) => influences_of_skin(model, rig)?,
            None => bind_model(model, rig, INFLUENCES, &played.exec)?.influences,
        }))
    }

    /// Poses the vertices whose rest is `rest`.
    pub(super) fn place_vertices(&self, rest: &[DVec3], motions: &[RigidMotion]) -> Vec<DVec3> {
        let place = |(p, own): (&DVec3, &BoneInfluences)| own.blend(|bone| motions[bone].place(*p));
        rest.par_iter().zip(&self.0).map(place).collect()
    }
}
