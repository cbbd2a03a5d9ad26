//! The nodes of a model as the rest of the house sees them.

use super::read::GltfNotes;
use super::scene::place_meshes;
use super::skin::joint_nodes;
use crate::asset::{Error, Model, ModelNode};

/// All nodes of the document of a model, by their index.
pub(super) fn model_nodes(model: &Model, notes: &GltfNotes) -> Result<Vec<ModelNode>, Error> {
    let doc = notes.document(model)?;
    let scene = place_meshes(&doc, &mut Vec::new())?;
    let joints = joint_nodes(&doc);
    let nodes = doc.nodes.values.iter().zip(scene.world_from_node).enumerate();
    let of_node = |(index, (node, world_from_node)): (usize, (&super::schema::GltfNode, _))| ModelNode {
        name: node.name.clone().unwrap_or_default(),
        world_from_node,
        is_joint: joints.contains(&index),
    };
    Ok(nodes.map(of_node).collect())
}
