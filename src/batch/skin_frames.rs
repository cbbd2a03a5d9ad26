//! Frames as a GLB with a skin of rigid bones, which any engine plays.

use super::kept_frames::{KeptFrames, PlayedModel, RootPlaces, WrittenOff};
use super::skin::carrying_joints;
use crate::asset::{CarryingJoints, NodePlace, PlayedJoint, SkinnedClip, WrittenFiles};
use crate::exec::Exec;
use crate::motion::decomposition::{
    DecompositionError, DecompositionOptions, ShapeSequence, SkinDecomposition, decompose,
};
use crate::wire::Error;
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
    let count = frames.count();
    let own = played.vertices;
    let rest: Vec<DVec3> = own.iter().map(|v| played.rest[*v]).collect();
    let mut sequence = ShapeSequence::new(&rest).map_err(refused)?;
    for frame in 0..count {
        let places = frames.positions(frame)?;
        let places: Vec<DVec3> = own.iter().map(|v| places[*v].as_dvec3()).collect();
        sequence.push(&places).map_err(refused)?;
    }
    let options = DecompositionOptions {
        bones,
        ..Default::default()
    };
    let skin = decompose(&sequence, &options, exec).map_err(refused)?;
    let times: Vec<f64> = (0..count).map(|frame| played.seconds(frame)).collect();
    let roots = RootPlaces::of_frames(frames);
    let mut influences = vec![CarryingJoints::default(); played.rest.len()];
    for (vertex, four) in own.iter().zip(four_influences(&skin)) {
        influences[*vertex] = four;
    }
    let clip = SkinnedClip {
        name: played.clip_name(),
        influences: &influences,
        joints: &resting_joints(&skin),
        times: &times,
        frames: &joint_places(&skin),
        root: roots.keys_of_node(played, &times),
        beside: played.beside(roots.keys_around(played, &times)),
    };
    let written = played.model.write_skinned_clip(&clip).map_err(Error::from)?;
    let off = played.written_error(skin.centres.len(), [skin.rms, skin.max]);
    let told = format!(
        "{} bones play the frames to within {:.3} % of the diagonal (root mean square), {:.3} % at worst",
        off.parts, off.rms_percent, off.max_percent
    );
    Ok((written, (off, told)))
}

fn refused(e: DecompositionError) -> Error {
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
