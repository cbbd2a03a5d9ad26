//! Bones that keep their lengths while joints follow the body.
//!
//! A bone is what lies between a joint and the nearest joint above it; nodes that are no joints may stand between. Where one
//! is rigid, the lower joint goes to the place at the old distance from where the joint above is now, on the line to where it
//! would have gone: the direction follows the body, the length does not. Joints are placed from parents to children, so that
//! each corrects what those above it could not reach.

use super::super::document::GltfDocument;
use super::super::placement::invert;
use super::super::scene::PlacedScene;
use super::super::skin::joint_nodes;
use crate::asset::BoneLengthRule;
use glam::{DAffine3, DQuat, DVec3};
use std::collections::BTreeMap;

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
/// of a clip it changes no length. `None` where old and new are not equally long, as where another node or a stretch lies
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
