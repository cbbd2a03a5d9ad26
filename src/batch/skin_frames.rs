//! Frames as a GLB with a skin of rigid bones, which any engine plays.

use super::kept_frames::{KeptFrames, PlayedModel, RootPlaces, WrittenOff};
use super::skin::carrying_joints;
use crate::asset::{CarryingJoints, NodePlace, PlayedCorrectives, PlayedJoint, SkinnedClip, WrittenFiles};
use crate::exec::Exec;
use crate::motion::BoneInfluences;
use crate::motion::decomposition::{
    DecompositionError, DecompositionOptions, ShapeSequence, SkinDecomposition, decompose,
};
use crate::motion::rig::moved_joints;
use crate::wire::Error;
use crate::wire::pb::animation_report::WrittenError;
use glam::{DQuat, DVec3};

/// Writes frames as a GLB whose vertices follow at most four of so many `bones`, and the motion of the root as a node; and what
/// there is to say of it.
///
/// # Errors
/// When a frame cannot be read again, the frames have no such bones, or the model cannot be written as a GLB.
pub fn write_skin_frames<F: KeptFrames>(
    played: &PlayedModel<'_>,
    frames: &mut F,
    bones: usize,
    exec: &Exec<'_>,
) -> Result<(WrittenFiles, WrittenOff), F::Failure> {
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
    let written = write_parts(played, frames, &parts, None)?;
    Ok((written, said_of_bones(off)))
}

/// Joints, where they are in each frame, and which of them carry each vertex that is played.
pub(super) struct SkinParts {
    pub(super) joints: Vec<PlayedJoint>,
    pub(super) frames: Vec<Vec<NodePlace>>,
    pub(super) influences: Vec<BoneInfluences>,
}

/// Writes a skin that plays, with correctives where there are some.
pub(super) fn write_parts(
    played: &PlayedModel<'_>,
    frames: &impl KeptFrames,
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
    Ok(played.model.write_skinned_clip(&clip)?)
}

/// What is to be said of bones that are so far off.
pub(super) fn said_of_bones(off: WrittenError) -> WrittenOff {
    let told = format!(
        "{} bones play the frames to within {:.3} % of the diagonal (root mean square), {:.3} % at worst",
        off.parts, off.rms_percent, off.max_percent
    );
    (off, told)
}

/// The shapes of all frames, of the vertices that are played.
pub(super) fn sequence_of<F: KeptFrames>(
    played: &PlayedModel<'_>,
    frames: &mut F,
) -> Result<ShapeSequence, F::Failure> {
    let own = played.vertices;
    let rest: Vec<DVec3> = own.iter().map(|v| played.rest[*v]).collect();
    let mut sequence = ShapeSequence::new(&rest).map_err(refused)?;
    for frame in 0..frames.count() {
        let places = frames.positions(frame)?;
        let places: Vec<DVec3> = own.iter().map(|v| places[*v].as_dvec3()).collect();
        sequence.push(&places).map_err(refused)?;
    }
    Ok(sequence)
}

pub(super) fn refused(e: DecompositionError) -> Error {
    match e {
        DecompositionError::Cancelled(_) => Error::Cancelled,
        _ => Error::invalid("as", format!("is skin, but {e}")),
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
