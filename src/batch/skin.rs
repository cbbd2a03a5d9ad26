//! A model bound to the bones of a rig, in process.

use crate::asset::{CarryingJoints, Model, PlayedJoint};
use crate::exec::Exec;
use crate::motion::BoneInfluences;
use crate::motion::rig::{MotionRig, rig_joints, skin_bones};
use crate::motion::skin_weights::{SkinWeightError, SkinWeightOptions, skin_weights};
use crate::wire::Error;

/// Joints, and which of them carry each vertex.
#[derive(Debug, Clone, PartialEq)]
pub struct BoundModel {
    /// One for each bone of the rig.
    pub joints: Vec<PlayedJoint>,
    /// By render vertex.
    pub influences: Vec<BoneInfluences>,
}

/// Binds a model to the bones of a rig, each vertex to at most so many.
///
/// # Errors
/// [`Error::Invalid`] for a number of influences out of range or a model without vertices.
pub fn bind_model(model: &Model, rig: &MotionRig, influences: usize, exec: &Exec<'_>) -> Result<BoundModel, Error> {
    let options = SkinWeightOptions {
        influences,
        ..SkinWeightOptions::default()
    };
    let found = skin_weights(&model.positions, &model.triangles, &skin_bones(rig), &options, exec);
    Ok(BoundModel {
        joints: rig_joints(rig),
        influences: found?,
    })
}

/// What a vertex follows, as a file is told.
pub fn carrying_joints(own: &BoneInfluences) -> CarryingJoints {
    let mut carrying = CarryingJoints::default();
    for (slot, (bone, weight)) in carrying.iter_mut().zip(own.iter()) {
        *slot = (bone as u32, weight as f32);
    }
    carrying
}

impl From<SkinWeightError> for Error {
    fn from(e: SkinWeightError) -> Self {
        match e {
            SkinWeightError::Invalid { what, problem } => Self::invalid(what, problem),
            SkinWeightError::Cancelled(_) => Self::Cancelled,
            SkinWeightError::Solver(e) => Self::Internal(e.to_string()),
        }
    }
}
