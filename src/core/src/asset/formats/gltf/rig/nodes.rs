//! Nodes after joints and others have moved: new local transforms, from parents to children.

use super::super::document::GltfDocument;
use super::super::placement::invert;
use super::super::scene::{PlacedScene, joined_transform, local_transform};
use super::super::schema::GltfNode;
use super::bones::{RigidBones, turn_of_bone};
use crate::asset::{Error, NodeMotions};
use crate::mesh::rotation::fit_rotation;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use std::collections::BTreeMap;

/// A local transform that changes by less than this is left as it is written: in radians, and for translations relative to
/// the size of the model.
const SAME: f64 = 1e-7;

/// A node whose local transform has changed.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MovedNode {
    /// What is written; `None` for what stays as it is.
    pub(super) translation: Option<[f32; 3]>,
    pub(super) rotation: Option<[f32; 4]>,
    pub(super) matrix: Option<[f32; 16]>,
    /// By what its rotation was turned, in its parent's frame: the new one is this times the old one.
    pub(super) turn: DQuat,
    /// By what translations of clips are turned, where that is something else.
    pub(super) bone_turn: Option<DQuat>,
    /// Its translation before and after.
    pub(super) from: DVec3,
    pub(super) to: DVec3,
}

/// All nodes after some have moved.
#[derive(Debug)]
pub(super) struct MovedNodes {
    /// Those whose local transforms have changed.
    pub(super) moved: BTreeMap<usize, MovedNode>,
    /// Where every node is now; bit-identical for those that did not move.
    pub(super) world_from_node: Vec<DAffine3>,
    /// Whether a node is somewhere else.
    pub(super) is_elsewhere: Vec<bool>,
}

/// Gives nodes local transforms so that those with a motion move as they should, joints as far as rigid bones let them. Other
/// nodes keep theirs and so ride with their parents.
/// `size`: that of the model.
pub(super) fn move_nodes(
    doc: &GltfDocument<'_>,
    scene: &PlacedScene,
    motions: &NodeMotions,
    bones: &RigidBones,
    size: f64,
) -> Result<MovedNodes, Error> {
    let nodes = &doc.nodes.values;
    let mut all = MovedNodes {
        moved: BTreeMap::new(),
        world_from_node: scene.world_from_node.clone(),
        is_elsewhere: vec![false; nodes.len()],
    };
    let mut open: Vec<usize> = (0..nodes.len()).filter(|&n| scene.parents[n].is_none()).collect();
    while let Some(index) = open.pop() {
        let node = &nodes[index];
        open.extend(node.children.iter().map(|c| c.index()));
        let parent = scene.parents[index];
        let (old_parent, new_parent) = parent.map_or((DAffine3::IDENTITY, DAffine3::IDENTITY), |p| {
            (scene.world_from_node[p], all.world_from_node[p])
        });
        let rides = parent.is_some_and(|p| all.is_elsewhere[p]);
        let mut motion = motions.get(&index).copied();
        let bone = bones.above(index).filter(|_| rides || motion.flatten().is_some());
        if let Some(bone) = bone {
            let ridden = || invert(&old_parent).map_or(DAffine3::IDENTITY, |back| new_parent * back);
            let free = motion.map_or_else(ridden, Option::unwrap_or_default);
            let rest = scene.world_from_node[index].translation;
            motion = Some(Some(bone.hold(&free, rest, scene, &all.world_from_node)));
        }
        // One that stays has to be held back when its parent moves.
        let change = match motion {
            Some(motion) if rides || motion.is_some() => invert(&new_parent)
                .map(|back| back * motion.unwrap_or(DAffine3::IDENTITY) * old_parent)
                .and_then(|parent_from_parent| changed_node(node, &parent_from_parent, &new_parent, size)),
            _ => None,
        };
        if let Some((mut change, local)) = change {
            change.bone_turn = bone.and_then(|_| turn_of_bone(change.turn, change.from, change.to));
            all.world_from_node[index] = new_parent * local;
            all.is_elsewhere[index] = true;
            all.moved.insert(index, change);
        } else if rides {
            all.world_from_node[index] = new_parent * local_transform(doc, index, node)?;
            all.is_elsewhere[index] = true;
        }
    }
    Ok(all)
}

fn scale_of(node: &GltfNode) -> DVec3 {
    DVec3::from_array(node.scale.unwrap_or([1.0; 3]))
}

/// The local transform that `parent_from_parent` takes a node's to, in the kind that it has; `None` when it stays.
fn changed_node(
    node: &GltfNode,
    parent_from_parent: &DAffine3,
    world_from_parent: &DAffine3,
    size: f64,
) -> Option<(MovedNode, DAffine3)> {
    // Of what is no rotation under a stretched parent, the nearest.
    let mut turn = fit_rotation(parent_from_parent.matrix3);
    if turn.xyz().length() <= 0.5 * SAME {
        turn = DQuat::IDENTITY;
    }
    let from = match node.matrix {
        Some(m) => DVec3::new(m[12], m[13], m[14]),
        None => DVec3::from_array(node.translation.unwrap_or_default()),
    };
    let mut to = parent_from_parent.transform_point3(from);
    let is_there = world_from_parent.transform_vector3(to - from).length() <= SAME * size;
    if is_there {
        to = from;
    }
    if !to.is_finite() || (is_there && turn == DQuat::IDENTITY) {
        return None;
    }
    let mut change = MovedNode {
        translation: None,
        rotation: None,
        matrix: None,
        turn,
        bone_turn: None,
        from,
        to,
    };
    if let Some(m) = node.matrix {
        let axes =
            [[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]].map(|axis| turn * DVec3::from_array(axis));
        let rounded: Vec<[f32; 3]> = axes.iter().chain([&to]).map(|v| v.as_vec3().to_array()).collect();
        let mut matrix = [0.0; 16];
        for (c, column) in rounded.iter().enumerate() {
            matrix[4 * c..4 * c + 3].copy_from_slice(column);
        }
        matrix[15] = 1.0;
        change.matrix = Some(matrix);
        let column = |c: usize| DVec3::from_array(rounded[c].map(f64::from));
        let local = DAffine3 {
            matrix3: DMat3::from_cols(column(0), column(1), column(2)),
            translation: column(3),
        };
        return Some((change, local));
    }
    let old = node.rotation.map_or(DQuat::IDENTITY, DQuat::from_array).normalize();
    let mut rotation = old;
    if turn != DQuat::IDENTITY {
        let written = (turn * old).normalize().as_quat();
        change.rotation = Some(written.to_array());
        rotation = written.as_dquat().normalize();
        change.turn = (rotation * old.inverse()).normalize();
    }
    if !is_there {
        let written = to.as_vec3();
        change.translation = Some(written.to_array());
        change.to = written.as_dvec3();
    }
    let local = joined_transform(change.to, rotation, scale_of(node));
    local.is_finite().then_some((change, local))
}
