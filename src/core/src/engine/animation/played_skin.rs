//! Frames as a GLB with bones: bones that are fitted to the frames, or those of the rig with weights that fit, or with correctives.

use super::bound_model::{bind_model, carrying_joints, influences_of_skin};
use super::played::{FrameSource, PlayedClipFile, PlayedModel, RootPlaces, WrittenError};
use super::prepare::Animation;
use crate::asset::{CarryingJoints, NodePlace, PlayedCorrectives, PlayedJoint, SkinnedClip, WrittenFiles};
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::motion::BoneInfluences;
use crate::motion::correctives::{SkinnedFrames, fit_correctives};
use crate::motion::decomposition::{
    DecompositionError, DecompositionOptions, ShapeSequence, SkinDecomposition, decompose, fit_weights,
};
use crate::motion::rig::{RigError, RigSkeleton, RigidMotion, moved_joints};
use glam::{DQuat, DVec3, Vec3};

/// The most bones that a vertex follows, unless the model's own weights have more.
const INFLUENCES: usize = 4;

/// Writes frames as a GLB whose vertices follow at most four of so many `bones`, and the motion of the root as a node; and what
/// there is to say of it.
///
/// # Errors
/// When a frame cannot be read again, the frames have no such bones, or the model cannot be written as a GLB.
pub(super) fn write_skin_frames<F: FrameSource>(
    played: &PlayedModel<'_>,
    frames: &mut F,
    bones: usize,
    exec: &Exec<'_>,
) -> Result<PlayedClipFile, F::Failure> {
    let sequence = sequence_of(played, frames)?;
    let options = DecompositionOptions {
        bones,
        ..Default::default()
    };
    let skin = decompose(&sequence, &options, exec).map_err(refused)?;
    let off = played.written_error(skin.centres.len(), [skin.rms, skin.max]);
    let joints = resting_joints(&skin);
    let parts = SkinParts {
        frames: skin.motions.iter().map(|m| moved_joints(&joints, m)).collect(),
        joints,
        influences: skin.influences,
    };
    let files = write_parts(played, frames, &parts, None)?;
    Ok(bones_file(files, off))
}

/// Writes frames as a GLB with the bones of the rig, and with `has_twists` three more along each limb, among which its twist is
/// spread; weights are fitted to the frames.
///
/// # Errors
/// When a frame cannot be read again, the rig has too many bones, or the model cannot be written as a GLB.
pub(super) fn write_rig_frames<F: FrameSource>(
    played: &PlayedModel<'_>,
    frames: &mut F,
    has_twists: bool,
    exec: &Exec<'_>,
) -> Result<PlayedClipFile, F::Failure> {
    let animation = played.animation;
    let sequence = sequence_of(played, frames)?;
    let skeleton = RigSkeleton::of_rig(animation.moving_rig(), has_twists);
    let motions = motions_of(animation, &skeleton, frames);
    let skin = fit_weights(&sequence, &motions, INFLUENCES, exec).map_err(refused)?;
    let off = played.written_error(skeleton.joints.len(), [skin.rms, skin.max]);
    let parts = SkinParts {
        frames: motions.iter().map(|m| moved_joints(&skeleton.joints, m)).collect(),
        joints: skeleton.joints,
        influences: skin.influences,
    };
    Ok(bones_file(write_parts(played, frames, &parts, None)?, off))
}

/// Writes frames as a GLB with the bones of the rig, the model's own weights where the clip is its own, and up to `most`
/// correctives.
///
/// # Errors
/// As [`write_rig_frames`].
pub(super) fn write_corrected_frames<F: FrameSource>(
    played: &PlayedModel<'_>,
    frames: &mut F,
    most: usize,
    exec: &Exec<'_>,
) -> Result<PlayedClipFile, F::Failure> {
    let animation = played.animation;
    let model = &animation.model().0;
    let rest: Vec<DVec3> = played.vertices.iter().map(|v| played.rest[*v]).collect();
    let mut wanted: Vec<Vec<Vec3>> = Vec::with_capacity(frames.count());
    for frame in 0..frames.count() {
        let places = frames.positions(frame)?;
        wanted.push(played.vertices.iter().map(|v| places[*v]).collect());
    }
    let rig = animation.moving_rig();
    let all = match animation.own_clip() {
        Some(_) => influences_of_skin(model, rig)?,
        None => bind_model(model, rig, INFLUENCES, exec)?.influences,
    };
    let influences: Vec<BoneInfluences> = played.vertices.iter().map(|v| all[*v]).collect();
    let skeleton = RigSkeleton::of_rig(rig, false);
    let motions = motions_of(animation, &skeleton, frames);
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
    let files = write_parts(played, frames, &parts, Some(correctives))?;
    let before = played.written_error(parts.joints.len(), found.before);
    let mut error = played.written_error(found.frames.len(), found.after);
    let of: Vec<String> = found
        .frames
        .iter()
        .map(|frame| (animation.range().start + frame).to_string())
        .collect();
    error.message = format!(
        "{} bones are off by {:.3} % of the diagonal (root mean square), {:.3} % at worst; with correctives of frames {} by {:.3} % \
         and {:.3} %",
        before.parts,
        before.rms_percent,
        before.max_percent,
        of.join(", "),
        error.rms_percent,
        error.max_percent
    );
    let error = Some(error);
    Ok(PlayedClipFile { files, error })
}

/// For each frame, how joints move points of the rest pose, as positions are kept.
fn motions_of(animation: &Animation, skeleton: &RigSkeleton, frames: &impl FrameSource) -> Vec<Vec<RigidMotion>> {
    let of_frame = |frame: usize| {
        let seconds = animation.times().at(animation.range().start + frame);
        let pose = animation.driver().pose_at(seconds);
        skeleton.motions_in(animation.moving_rig(), &pose, &frames.root(frame))
    };
    (0..frames.count()).map(of_frame).collect()
}

/// Joints, where they are in each frame, and which of them carry each vertex that is played.
struct SkinParts {
    joints: Vec<PlayedJoint>,
    frames: Vec<Vec<NodePlace>>,
    influences: Vec<BoneInfluences>,
}

/// Writes a skin that plays, with correctives where there are some.
fn write_parts(
    played: &PlayedModel<'_>,
    frames: &impl FrameSource,
    parts: &SkinParts,
    correctives: Option<PlayedCorrectives<'_>>,
) -> Result<WrittenFiles, Error> {
    let times: Vec<f64> = (0..frames.count()).map(|frame| played.seconds(frame)).collect();
    let roots = RootPlaces::of_frames(frames);
    let mut influences = vec![CarryingJoints::default(); played.rest.len()];
    for (vertex, own) in played.vertices.iter().zip(&parts.influences) {
        influences[*vertex] = carrying_joints(own);
    }
    let clip = SkinnedClip {
        name: played.clip_name(),
        influences: &influences,
        joints: &parts.joints,
        times: &times,
        frames: &parts.frames,
        correctives,
        root: roots.keys_of_node(played, &times),
        beside: played.beside(roots.keys_around(played, &times)),
    };
    Ok(played.animation.model().0.write_skinned_clip(&clip)?)
}

/// A file of bones, with the line that reports their error.
fn bones_file(files: WrittenFiles, mut error: WrittenError) -> PlayedClipFile {
    error.message = format!(
        "{} bones play the frames to within {:.3} % of the diagonal (root mean square), {:.3} % at worst",
        error.parts, error.rms_percent, error.max_percent
    );
    let error = Some(error);
    PlayedClipFile { files, error }
}

/// The shapes of all frames, of the vertices that are played.
fn sequence_of<F: FrameSource>(played: &PlayedModel<'_>, frames: &mut F) -> Result<ShapeSequence, F::Failure> {
    let own = &played.vertices;
    let rest: Vec<DVec3> = own.iter().map(|v| played.rest[*v]).collect();
    let mut sequence = ShapeSequence::new(&rest).map_err(refused)?;
    for frame in 0..frames.count() {
        let places = frames.positions(frame)?;
        let places: Vec<DVec3> = own.iter().map(|v| places[*v].as_dvec3()).collect();
        sequence.push(&places).map_err(refused)?;
    }
    Ok(sequence)
}

fn refused(e: DecompositionError) -> Error {
    match e {
        DecompositionError::Cancelled(_) => Error::Cancelled,
        _ => RigError::field("as", format!("is skin, but {e}")).into(),
    }
}

/// Each bone as a joint in the middle of what it carries.
fn resting_joints(skin: &SkinDecomposition) -> Vec<PlayedJoint> {
    let joint = |(bone, centre): (usize, &DVec3)| PlayedJoint {
        name: format!("bone {}", bone + 1),
        parent: None,
        rest: NodePlace {
            translation: *centre,
            rotation: DQuat::IDENTITY,
        },
    };
    skin.centres.iter().enumerate().map(joint).collect()
}
