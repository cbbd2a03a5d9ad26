//! Nodes after joints and others have moved: new local transforms, from parents to children.
//!
//! Bones that keep their lengths while joints follow the body.
//!
//! A bone is what lies between a joint and the nearest joint above it; nodes that are no joints may stand between. Where one
//! is rigid, the lower joint goes to the place at the old distance from where the joint above is now, on the line to where it
//! would have gone: the direction follows the body, the length does not. Joints are placed from parents to children, so that
//! each corrects what those above it could not reach.

use super::super::document::GltfDocument;
use super::super::placement::{invert, joint_nodes};
use super::super::scene::{PlacedScene, joined_transform, local_transform};
use super::super::schema::GltfNode;
use crate::{BoneLengthRule, Error, NodeMotions};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use pliant_mesh::rotation::fit_rotation;
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
    // The nearest rotation, where a stretched parent leaves none.
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

/// Ends nearer to each other than this share of the bone's length have no direction.
const NO_DIRECTION: f64 = 1e-6;

/// Bones that keep their lengths, by the node of the joint at the lower end.
pub(super) struct RigidBones(BTreeMap<usize, RigidBone>);

/// A bone that keeps its length.
pub(super) struct RigidBone {
    /// The node of the joint at the upper end.
    above: usize,
    /// From the upper end to the lower one in the uploaded rest pose.
    along: DVec3,
}

impl RigidBones {
    /// Those of a scene that a rule makes rigid.
    pub(super) fn find(doc: &GltfDocument<'_>, scene: &PlacedScene, rule: &BoneLengthRule) -> Self {
        let names = match rule {
            BoneLengthRule::Follow => return Self(BTreeMap::new()),
            BoneLengthRule::Keep => None,
            BoneLengthRule::KeepBelow(names) => Some(names),
        };
        let joints = joint_nodes(doc);
        let nodes = &doc.nodes.values;
        let mut bones = BTreeMap::new();
        // With each node the nearest joint above it, and whether the bones below that are rigid.
        let roots = (0..nodes.len()).filter(|&node| scene.parents[node].is_none());
        let mut open: Vec<(usize, Option<usize>, bool)> = roots.map(|node| (node, None, names.is_none())).collect();
        while let Some((node, mut above, mut is_rigid)) = open.pop() {
            if joints.contains(&node) {
                if let Some(above) = above.filter(|_| is_rigid) {
                    let place = |node: usize| scene.world_from_node[node].translation;
                    let along = place(node) - place(above);
                    bones.insert(node, RigidBone { above, along });
                }
                let is_named = |names: &Vec<String>| nodes[node].name.as_ref().is_some_and(|name| names.contains(name));
                is_rigid |= names.is_some_and(is_named);
                above = Some(node);
            }
            open.extend(nodes[node].children.iter().map(|c| (c.index(), above, is_rigid)));
        }
        Self(bones)
    }

    /// The bone above a joint, where it is rigid.
    pub(super) fn above(&self, node: usize) -> Option<&RigidBone> {
        self.0.get(&node)
    }
}

impl RigidBone {
    /// The motion of the joint at the lower end, whose rest place is `rest`. Without the bone it would be `free`.
    /// `world_from_node` has the other nodes.
    pub(super) fn hold(
        &self,
        free: &DAffine3,
        rest: DVec3,
        scene: &PlacedScene,
        world_from_node: &[DAffine3],
    ) -> DAffine3 {
        let length = self.along.length();
        let (before, now) = (&scene.world_from_node[self.above], &world_from_node[self.above]);
        let place = free.transform_point3(rest);
        let mut towards = place - now.translation;
        if towards.length() <= NO_DIRECTION * length {
            let turned = invert(before).map(|back| (*now * back).transform_vector3(self.along));
            towards = turned.unwrap_or(self.along);
        }
        let shift = now.translation + towards.normalize_or_zero() * length - place;
        let mut held = *free;
        if shift.is_finite() {
            held.translation += shift;
        }
        held
    }
}

/// The turn that takes a node's translation to its new one and is nearest to the `turn` of the node: applied to all translations
/// of a clip it changes no length. `None` where old and new are not equally long, as where another node or a stretched parent lies
/// between the joints.
pub(super) fn turn_of_bone(turn: DQuat, from: DVec3, to: DVec3) -> Option<DQuat> {
    let from = turn * from;
    let is_as_long = (from.length() - to.length()).abs() <= NO_DIRECTION * from.length();
    let (a, b) = (from.try_normalize()?, to.try_normalize()?);
    // Twice the half angle's rotation, without a sine: opposite directions have none.
    let arc = DQuat::from_xyzw(
        a.y * b.z - a.z * b.y,
        a.z * b.x - a.x * b.z,
        a.x * b.y - a.y * b.x,
        1.0 + a.dot(b),
    );
    (is_as_long && arc.length() > NO_DIRECTION).then(|| (arc.normalize() * turn).normalize())
}
