//! Frames as a GLB with the bones of their rig: with weights that fit them, or with correctives.

use super::kept_frames::{KeptFrames, PlayedModel, WrittenOff};
use super::skin::{bind_model, influences_of_skin};
use super::skin_frames::{SkinParts, refused, said_of_bones, sequence_of, write_parts};
use crate::asset::{PlayedCorrectives, WrittenFiles};
use crate::engine::Animation;
use crate::exec::Exec;
use crate::motion::BoneInfluences;
use crate::motion::correctives::{SkinnedFrames, fit_correctives};
use crate::motion::decomposition::fit_weights;
use crate::motion::rig::{RigSkeleton, RigidMotion, moved_joints};
use crate::wire::Error;
use glam::{DVec3, Vec3};

/// The most bones that a vertex follows, unless the model's own weights have more.
const INFLUENCES: usize = 4;

/// What moved the bones of frames.
#[derive(Clone, Copy)]
pub struct DrivenFrames<'a> {
    /// The animation.
    pub animation: &'a Animation,
    /// The number of the first kept frame.
    pub first: usize,
}

impl DrivenFrames<'_> {
    /// For each frame, how joints move points of the rest pose, as positions are kept.
    fn motions_of(&self, skeleton: &RigSkeleton, frames: &impl KeptFrames) -> Vec<Vec<RigidMotion>> {
        let of_frame = |frame: usize| {
            let seconds = self.animation.times().at(self.first + frame);
            let pose = self.animation.driver().pose_at(seconds);
            skeleton.motions_in(self.animation.moving_rig(), &pose, &frames.root(frame))
        };
        (0..frames.count()).map(of_frame).collect()
    }
}

/// Writes frames as a GLB with the bones of the rig, and with `has_twists` three more along each limb, among which its twist is
/// spread; weights are fitted to the frames.
///
/// # Errors
/// When a frame cannot be read again, the rig has too many bones, or the model cannot be written as a GLB.
pub fn write_rig_frames<F: KeptFrames>(
    played: &PlayedModel<'_>,
    frames: &mut F,
    driven: &DrivenFrames<'_>,
    has_twists: bool,
    exec: &Exec<'_>,
) -> Result<(WrittenFiles, WrittenOff), F::Failure> {
    let sequence = sequence_of(played, frames)?;
    let skeleton = RigSkeleton::of_rig(driven.animation.moving_rig(), has_twists);
    let motions = driven.motions_of(&skeleton, frames);
    let skin = fit_weights(&sequence, &motions, INFLUENCES, exec).map_err(refused)?;
    let off = played.written_error(skeleton.joints.len(), [skin.rms, skin.max]);
    let parts = SkinParts {
        frames: motions.iter().map(|m| moved_joints(&skeleton.joints, m)).collect(),
        joints: skeleton.joints,
        influences: skin.influences,
    };
    Ok((write_parts(played, frames, &parts, None)?, said_of_bones(off)))
}

/// Writes frames as a GLB with the bones of the rig, the model's own weights where the clip is its own, and up to `most`
/// correctives.
///
/// # Errors
/// As [`write_rig_frames`].
pub fn write_corrected_frames<F: KeptFrames>(
    played: &PlayedModel<'_>,
    frames: &mut F,
    driven: &DrivenFrames<'_>,
    most: usize,
    exec: &Exec<'_>,
) -> Result<(WrittenFiles, WrittenOff), F::Failure> {
    let rest: Vec<DVec3> = played.vertices.iter().map(|v| played.rest[*v]).collect();
    let mut wanted: Vec<Vec<Vec3>> = Vec::with_capacity(frames.count());
    for frame in 0..frames.count() {
        let places = frames.positions(frame)?;
        wanted.push(played.vertices.iter().map(|v| places[*v]).collect());
    }
    let rig = driven.animation.moving_rig();
    let all = match played.own {
        Some(_) => influences_of_skin(played.model, rig)?,
        None => bind_model(played.model, rig, INFLUENCES, exec)?.influences,
    };
    let influences: Vec<BoneInfluences> = played.vertices.iter().map(|v| all[*v]).collect();
    let skeleton = RigSkeleton::of_rig(rig, false);
    let motions = driven.motions_of(&skeleton, frames);
    let skinned = SkinnedFrames {
        rest: &rest,
        influences: &influences,
        motions: &motions,
        wanted: &wanted,
    };
    let found = fit_correctives(&skinned, most, exec).map_err(|_| Error::Cancelled)?;
    let still: Vec<Vec3> = played.rest.iter().map(|p| p.as_vec3()).collect();
    let shape = |shifts: &Vec<DVec3>| {
        let mut shape = still.clone();
        for ((vertex, p), shift) in played.vertices.iter().zip(&rest).zip(shifts) {
            shape[*vertex] = (*p + *shift).as_vec3();
        }
        shape
    };
    let shapes: Vec<Vec<Vec3>> = found.shifts.iter().map(shape).collect();
    let parts = SkinParts {
        frames: motions.iter().map(|m| moved_joints(&skeleton.joints, m)).collect(),
        joints: skeleton.joints,
        influences,
    };
    let correctives = PlayedCorrectives {
        shapes: &shapes,
        weights: &found.weights,
    };
    let written = write_parts(played, frames, &parts, Some(correctives))?;
    let before = played.written_error(parts.joints.len(), found.before);
    let after = played.written_error(found.frames.len(), found.after);
    let of: Vec<String> = found
        .frames
        .iter()
        .map(|frame| (driven.first + frame).to_string())
        .collect();
    let told = format!(
        "{} bones are off by {:.3} % of the diagonal (root mean square), {:.3} % at worst; with correctives of frames {} by {:.3} % \
         and {:.3} %",
        before.parts,
        before.rms_percent,
        before.max_percent,
        of.join(", "),
        after.rms_percent,
        after.max_percent
    );
    Ok((written, (after, told)))
}
