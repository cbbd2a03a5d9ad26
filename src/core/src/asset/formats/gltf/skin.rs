//! Skins in the rest pose: where each joint puts the space in which a mesh was bound.

use super::accessors::{AccessorLayout, ComponentType, read_values};
use super::buffers::BufferBytes;
use super::document::GltfDocument;
use super::schema::GltfSkin;
use glam::{DAffine3, DMat3, DVec3};
use std::collections::BTreeSet;

/// One skin with its joints where the nodes of the file put them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SkinPose {
    /// The nodes that are its joints.
    pub(super) joints: Vec<usize>,
    /// For each joint the transform from the space of the mesh, as it was bound, to the world: the joint's world transform
    /// times its inverse bind matrix.
    pub(super) world_from_bind: Vec<DAffine3>,
}

impl SkinPose {
    /// Reads a skin of which the nodes stand at `world_from_node`; or says, for a warning, why its rest pose is not known.
    pub(super) fn read(
        doc: &GltfDocument<'_>,
        buffers: &mut BufferBytes,
        skin: usize,
        world_from_node: &[DAffine3],
    ) -> Result<Self, String> {
        let text = doc.skins.get(skin).ok_or("the skin does not exist")?;
        let skin: GltfSkin = serde_json::from_str(text).map_err(|e| format!("the skin cannot be read ({e})"))?;
        let joints: Vec<usize> = skin.joints.iter().map(|j| j.index()).collect();
        if joints.is_empty() {
            return Err("the skin has no joints".into());
        }
        let nodes = world_from_node.len();
        if let Some(joint) = joints.iter().find(|&&j| j >= nodes) {
            return Err(format!(
                "the skin names node {joint} as a joint, there are {nodes} nodes"
            ));
        }
        let bind = match skin.inverse_bind_matrices {
            None => vec![DAffine3::IDENTITY; joints.len()],
            Some(accessor) => inverse_bind_matrices(doc, buffers, accessor.index(), joints.len())?,
        };
        let place = |(&joint, bind): (&usize, &DAffine3)| world_from_node[joint] * *bind;
        let world_from_bind: Vec<DAffine3> = joints.iter().zip(&bind).map(place).collect();
        Ok(Self {
            joints,
            world_from_bind,
        })
    }
}

/// The nodes that are joints of any skin that can be read.
pub(super) fn joint_nodes(doc: &GltfDocument<'_>) -> BTreeSet<usize> {
    let skins = doc.skins.iter().filter_map(|text| serde_json::from_str(text).ok());
    let joints = skins.flat_map(|skin: GltfSkin| skin.joints);
    joints
        .map(|joint| joint.index())
        .filter(|&joint| joint < doc.nodes.len())
        .collect()
}

/// The inverse bind matrices of so many joints.
pub(super) fn inverse_bind_matrices(
    doc: &GltfDocument<'_>,
    buffers: &mut BufferBytes,
    accessor: usize,
    joints: usize,
) -> Result<Vec<DAffine3>, String> {
    let described = doc.accessors.get(accessor);
    let described =
        described.ok_or_else(|| format!("the inverse bind matrices name accessor {accessor}, which does not exist"))?;
    let layout = AccessorLayout::of(described, doc.views.values)
        .filter(|l| l.component == ComponentType::F32 && described.shape == "MAT4")
        .ok_or("the inverse bind matrices are not a MAT4 of floats")?;
    let count = described.count.index();
    if count < joints {
        return Err(format!(
            "there are {joints} joints and only {count} inverse bind matrices"
        ));
    }
    buffers
        .decode_for(doc, &BTreeSet::from([accessor]))
        .and_then(|()| read_values(doc, buffers, accessor, layout))
        .map_err(|e| e.to_string())?
        .as_chunks::<16>()
        .0
        .iter()
        .take(joints)
        .enumerate()
        .map(|(i, m)| {
            affine_of(m).ok_or_else(|| format!("inverse bind matrix {i} is {m:?}, which is not an affine transform"))
        })
        .collect()
}

/// An affine transform from a matrix in columns; `None` when it is not finite or its last row is not 0 0 0 1.
pub(super) fn affine_of(m: &[f32; 16]) -> Option<DAffine3> {
    let last = [m[3], m[7], m[11], m[15] - 1.0];
    if !m.iter().all(|v| v.is_finite()) || last.iter().any(|v| v.abs() > 1e-5) {
        return None;
    }
    let column = |c: usize| DVec3::new(m[4 * c].into(), m[4 * c + 1].into(), m[4 * c + 2].into());
    Some(DAffine3 {
        matrix3: DMat3::from_cols(column(0), column(1), column(2)),
        translation: column(3),
    })
}
