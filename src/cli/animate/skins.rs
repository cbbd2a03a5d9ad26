//! Frames as a GLB with a skin of rigid bones, which any engine plays.

use super::frames_file::FramesFile;
use super::morphs::{back_from, node_place, written_error};
use super::taken_frames::PlayedAnimation;
use crate::asset::{CarryingJoints, NodeKeys, NodePlace, PlayedJoint, SkinnedClip};
use crate::batch::carrying_joints;
use crate::cli::failure::CliFailure;
use crate::motion::decomposition::{
    DecompositionError, DecompositionOptions, ShapeSequence, SkinDecomposition, decompose,
};
use crate::wire::{Error, pb};
use glam::{DQuat, DVec3};
use std::path::Path;

/// Writes frames as a GLB whose vertices follow at most four of so many `bones`, and the motion of the root as a node where
/// `has_root`; tells how far it is off.
pub(super) fn write_skin(
    path: &Path,
    played: &PlayedAnimation<'_>,
    frames: &mut FramesFile,
    (bones, has_root): (usize, bool),
    report: &mut pb::AnimationReport,
) -> Result<(), CliFailure> {
    let count = played.range.len();
    let own = played.played_vertices();
    let rest: Vec<DVec3> = own.iter().map(|v| played.deformer.rest()[*v]).collect();
    let mut sequence = ShapeSequence::new(&rest).map_err(refused)?;
    let unreadable = |e: std::io::Error| CliFailure::Internal(format!("the partial file cannot be read again: {e}"));
    for frame in 0..count {
        let places = frames.positions(frame).map_err(unreadable)?;
        let places: Vec<DVec3> = own.iter().map(|v| places[*v].as_dvec3()).collect();
        sequence.push(&places).map_err(refused)?;
    }
    let options = DecompositionOptions {
        bones,
        ..Default::default()
    };
    let skin = decompose(&sequence, &options, &played.exec).map_err(refused)?;
    let first = played.range.start;
    let times: Vec<f64> = (0..count).map(|frame| played.seconds(first + frame)).collect();
    let roots = frames.frames.iter().take(count);
    let roots: Vec<NodePlace> = roots.map(|frame| node_place(&frame.root)).collect();
    let moves = roots.iter().any(|place| *place != NodePlace::IDENTITY);
    let back: Vec<NodePlace> = roots.iter().map(back_from).collect();
    let [root, around] = [(&roots, has_root), (&back, !has_root)]
        .map(|(places, is_wanted)| (moves && is_wanted).then_some(NodeKeys { times: &times, places }));
    let mut influences = vec![CarryingJoints::default(); played.deformer.rest().len()];
    for (vertex, four) in own.iter().zip(four_influences(&skin)) {
        influences[*vertex] = four;
    }
    let clip = SkinnedClip {
        name: if played.clip.is_empty() { "clip" } else { played.clip },
        influences: &influences,
        joints: &resting_joints(&skin),
        times: &times,
        frames: &joint_places(&skin),
        root,
        beside: played.beside(around),
    };
    let written = played.deformer.model().write_skinned_clip(&clip).map_err(Error::from)?;
    played
        .permission
        .write_model(path, &written, played.model, played.files)?;
    let off = written_error(played, skin.centres.len(), [skin.rms, skin.max]);
    report.warnings.push(format!(
        "{} bones play the frames to within {:.3} % of the diagonal (root mean square), {:.3} % at worst",
        off.parts, off.rms_percent, off.max_percent
    ));
    report.written_error = Some(off);
    Ok(())
}

fn refused(e: DecompositionError) -> CliFailure {
    match e {
        DecompositionError::Cancelled(_) => CliFailure::Internal(e.to_string()),
        _ => CliFailure::Input(format!("--as skin: {e}")),
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

/// Where the joints are in each frame.
fn joint_places(skin: &SkinDecomposition) -> Vec<Vec<NodePlace>> {
    let of_frame = |motions: &Vec<_>| {
        let places = motions.iter().zip(&skin.centres);
        places
            .map(|(motion, centre): (&crate::motion::rig::RigidMotion, _)| NodePlace {
                translation: motion.place(*centre),
                rotation: motion.rotation,
            })
            .collect()
    };
    skin.motions.iter().map(of_frame).collect()
}

fn four_influences(skin: &SkinDecomposition) -> Vec<CarryingJoints> {
    skin.influences.iter().map(carrying_joints).collect()
}
