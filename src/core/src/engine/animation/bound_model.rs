//! Which bones of a rig carry the vertices of a model.

use crate::asset::{CarryingJoints, Model, PlayedJoint};
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::motion::rig::{MotionRig, rig_joints, skin_bones};
use crate::motion::skin_weights::{SkinWeightOptions, skin_weights};
use crate::motion::{BoneInfluences, NodeOrder, clip_of_scene};

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

/// Which bones of a rig that was made of a model's skin carry each of its vertices: what the skin says, each joint's share with
/// the bone of its name, or the nearest above it.
///
/// # Errors
/// What reading the model's scene fails with.
pub fn influences_of_skin(model: &Model, rig: &MotionRig) -> Result<Vec<BoneInfluences>, Error> {
    let Some(scene) = model.moving_scene()? else {
        return Ok(vec![BoneInfluences::one(0); model.positions.len()]);
    };
    let order = NodeOrder::of(&scene);
    let skeleton = clip_of_scene(&scene, &order, None).skeleton;
    let mut bones: Vec<u16> = Vec::with_capacity(skeleton.joints.len());
    for joint in &skeleton.joints {
        let own = rig.bones.iter().position(|bone| bone.joint == joint.name);
        let above = joint.parent.map_or(0, |parent| bones[parent]);
        bones.push(own.map_or(above, |bone| bone as u16));
    }
    let of_vertex = |vertex: usize| {
        let mut pairs: Vec<(u16, f64)> = Vec::new();
        for (node, weight) in scene.influences.of(vertex) {
            let bone = bones[order.joints[*node as usize]];
            match pairs.iter_mut().find(|pair| pair.0 == bone) {
                Some(pair) => pair.1 += f64::from(*weight),
                None => pairs.push((bone, f64::from(*weight))),
            }
        }
        BoneInfluences::from_pairs(&mut pairs).unwrap_or_else(|| BoneInfluences::one(0))
    };
    Ok((0..model.positions.len()).map(of_vertex).collect())
}

/// The joints of a vertex, as a file lists them.
pub fn carrying_joints(own: &BoneInfluences) -> CarryingJoints {
    let mut carrying = CarryingJoints::default();
    for (slot, (bone, weight)) in carrying.iter_mut().zip(own.iter()) {
        *slot = (bone as u32, weight as f32);
    }
    carrying
}
