//! Nodes follow the body: joints move and turn with their vertices, other nodes by given motions. Clips play on the new
//! rest pose.
//!
//! When the rest shape of a skinned model changes, each joint gets the rigid motion of its vertices ([`motions`]). Nodes get new local transforms, from parents to children ([`nodes`]), and skins new inverse
//! bind matrices, so that joint times inverse bind matrix does not change: the rest pose draws every vertex in its new
//! place, and the bind shape is the new one. Clips are rewritten relative to the new rest pose ([`rewrite`]): where a
//! clip equals the old rest pose it equals the new one, and it turns joints about their own new axes. [`rewrite`]
//! changes files that were written as if no node had moved, by patches or after an edit.
//!
//! Bones may keep their lengths; the matrices then compensate for joints that the body would put elsewhere.
//! What followed is counted for reports. Nodes that are not joints move only by the motions in
//! [`ShapeFollowers`]. Children of a moved node move rigidly with it, except meshes that are part of the shape: their
//! vertices are drawn where the shape has them. Joints that are to stay do so even under a node that moves.
//!
//! A joint that moves no further than rounding keeps every byte: its node, its matrix, its clips.

pub(super) mod avatar;
mod motions;
mod nodes;
pub(super) mod rewrite;

pub(super) use motions::{JointHeldVertices, SkinnedShape};

use super::document::GltfDocument;
use super::placement::{Placement, SkinPose, VertexInfluences, affine_of, invert, joint_nodes};
use super::read::GltfNotes;
use super::scene::{PlacedScene, place_meshes};
use crate::{BoneLengthRule, Error, FollowedCounts, Geometry, JointTravel, RigRule, ShapeFollowers};
use avatar::AvatarLengths;
use glam::{DAffine3, DVec3};
use motions::joint_motions;
use nodes::{MovedNodes, RigidBones, move_nodes};
use pliant_mesh::BoundingBox;
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// How far rounding of matrices to 32 bits may move an unmoved vertex, relative to the model's diagonal, before it is
/// rewritten.
const ROUNDING: f64 = 5e-7;

/// New inverse bind matrices by the number of the joint in its skin.
type BindChanges = BTreeMap<usize, [f32; 16]>;

/// The nodes of a document after some have followed the body.
pub(super) struct FollowedNodeTree {
    nodes: MovedNodes,
    /// By skin.
    binds: BTreeMap<usize, BindChanges>,
    /// Rest poses of skins, before and after.
    poses: BTreeMap<usize, [Arc<SkinPose>; 2]>,
    world_from_node: Vec<DAffine3>,
    size: f64,
    avatar: AvatarLengths,
    /// The positions that have to be written as if nothing but vertices had moved, so that the moved nodes and joints draw
    /// the shape.
    pub(super) to_write: Vec<DVec3>,
}

/// Whether a shape may move nodes at all: joints of primitives, or nodes with motions of their own.
fn may_move_nodes(notes: &GltfNotes, followers: &ShapeFollowers<'_>) -> bool {
    let has_rig = || notes.rows.iter().any(|row| row.follows_joints);
    !followers.nodes.is_empty() || (followers.rules.rig != RigRule::Keep && has_rig())
}

/// The vertices of a model as its file has them, and their joints.
pub(super) fn shape_of_rows<'a>(
    doc: &GltfDocument<'_>,
    notes: &GltfNotes,
    rest: &'a Geometry,
    positions: &'a [DVec3],
) -> Result<SkinnedShape<'a>, Error> {
    let mut shape = SkinnedShape {
        before: Cow::Borrowed(&rest.positions),
        now: positions,
        held: Vec::new(),
        fixed: Vec::new(),
    };
    for row in &notes.rows {
        match row.skin {
            None => shape.fixed.push((row.node, row.vertices.clone())),
            Some(skin) if row.follows_joints => {
                let primitive = &doc.meshes.values[row.mesh].primitives[row.primitive];
                let influences = VertexInfluences::read(doc, primitive, joint_count(doc, skin));
                shape.held.push(JointHeldVertices {
                    skin,
                    first: row.vertices.start,
                    influences: influences.map_err(|problem| doc.fault.unwritable(problem))?,
                    placement: row.placement.clone(),
                });
            }
            Some(_) => {}
        }
    }
    Ok(shape)
}

/// How many joints a skin has; 0 for one that cannot be read.
pub(super) fn joint_count(doc: &GltfDocument<'_>, skin: usize) -> usize {
    doc.read_skin(skin).map_or(0, |skin| skin.joints.len())
}

impl FollowedNodeTree {
    /// Lets the nodes of a document follow a shape, which is found where any may move; `None` when none of them does.
    pub(super) fn fit<'s>(
        doc: &GltfDocument<'_>,
        notes: &GltfNotes,
        followers: &ShapeFollowers<'_>,
        shape: impl FnOnce() -> Result<SkinnedShape<'s>, Error>,
    ) -> Result<Option<Self>, Error> {
        if !may_move_nodes(notes, followers) {
            return Ok(None);
        }
        let shape = &shape()?;
        let scene = place_meshes(doc, &mut Vec::new())?;
        let size = BoundingBox::of(&shape.before).diagonal();
        let mut known = BTreeMap::new();
        for skin in 0..doc.skins.len() {
            if let Ok(pose) = SkinPose::read(doc, skin, &scene.world_from_node) {
                known.insert(skin, Arc::new(pose));
            }
        }
        let of_rows = |follows: bool| -> BTreeSet<usize> {
            let rows = notes.rows.iter().filter(|row| row.follows_joints == follows);
            rows.filter_map(|row| row.skin).collect()
        };
        let (drawn, broken) = (of_rows(true), of_rows(false));
        let followed = known.iter().filter(|(skin, _)| drawn.contains(*skin));
        let followed: BTreeMap<usize, Arc<SkinPose>> = followed.map(|(skin, pose)| (*skin, Arc::clone(pose))).collect();
        let still = |pose: &Arc<SkinPose>| -> Vec<_> { pose.joints.iter().map(|&joint| (joint, None)).collect() };
        let rig = followers.rules.rig;
        let bones = avatar::bones(doc);
        let mut motions = match rig {
            RigRule::Follow => joint_motions(shape, &followed, &bones, &scene, !avatar::is_vrm0(doc)),
            RigRule::Move => joint_motions(shape, &followed, &bones, &scene, false),
            // They stay where they are, even under a node that goes.
            RigRule::Keep => followed.values().flat_map(still).collect(),
        };
        // What a broken skin draws is not known, so its joints stay.
        motions.extend(broken.iter().filter_map(|skin| known.get(skin)).flat_map(still));
        motions.extend(followers.nodes.iter().filter(|(node, _)| **node < doc.nodes.len()));
        let is_avatar = rig != RigRule::Keep && avatar::is_measured(doc);
        if !is_avatar && motions.values().all(Option::is_none) {
            return Ok(None);
        }
        // Where joints stay, so do the lengths of bones.
        let bone_lengths = match rig {
            RigRule::Follow | RigRule::Move => &followers.rules.bone_lengths,
            RigRule::Keep => &BoneLengthRule::Follow,
        };
        let bones = RigidBones::find(doc, &scene, bone_lengths);
        let nodes = move_nodes(doc, &scene, &motions, &bones, size)?;
        let avatar = match is_avatar {
            true => AvatarLengths::fit(doc, shape, &followed, &scene, &nodes),
            false => AvatarLengths::default(),
        };
        if nodes.moved.is_empty() && avatar.is_empty() {
            return Ok(None);
        }
        let PlacedScene { world_from_node, .. } = scene;
        let mut tree = Self {
            binds: BTreeMap::new(),
            poses: BTreeMap::new(),
            world_from_node,
            nodes,
            size,
            avatar,
            to_write: Vec::new(),
        };
        for (skin, pose) in known {
            tree.fit_binds(skin, pose);
        }
        tree.to_write = tree.positions_to_write(shape);
        Ok(Some(tree))
    }

    /// Finds the inverse bind matrices that keep what a skin draws.
    fn fit_binds(&mut self, skin: usize, pose: Arc<SkinPose>) {
        let mut changes = BindChanges::new();
        let mut after = SkinPose::clone(&pose);
        for (number, (&node, place)) in pose.joints.iter().zip(&mut after.world_from_bind).enumerate() {
            if !self.nodes.is_elsewhere[node] {
                continue;
            }
            let world = &self.nodes.world_from_node[node];
            if let Some(bind) = invert(world).map(|back| back * *place).filter(DAffine3::is_finite) {
                let rounded = rounded_matrix(&bind);
                if let Some(read) = affine_of(&rounded) {
                    *place = *world * read;
                    changes.insert(number, rounded);
                }
            }
        }
        if !changes.is_empty() {
            self.binds.insert(skin, changes);
            self.poses.insert(skin, [pose, Arc::new(after)]);
        }
    }

    /// A vertex that has not moved keeps its bits where rounding alone would change them.
    fn positions_to_write(&self, shape: &SkinnedShape<'_>) -> Vec<DVec3> {
        let mut positions = shape.now.to_vec();
        for (node, range) in &shape.fixed {
            if self.nodes.is_elsewhere[*node]
                && let Some(back) = invert(&self.nodes.world_from_node[*node])
            {
                let back = self.world_from_node[*node] * back;
                for vertex in range.clone() {
                    let place = back.transform_point3(shape.now[vertex]);
                    self.write_back(&mut positions[vertex], place, shape.before[vertex]);
                }
            }
        }
        for held in &shape.held {
            let Some([before, after]) = self.poses.get(&held.skin) else {
                continue;
            };
            let changes = self.binds.get(&held.skin);
            let is_changed = |joint: &u32| changes.is_some_and(|all| all.contains_key(&(*joint as usize)));
            if !held.influences.joints_in_use().iter().any(is_changed) {
                continue;
            }
            for i in 0..held.influences.len() {
                let old = match &held.placement {
                    Placement::Whole(one) => *one,
                    Placement::Blended(_) => held.influences.blend(i, &before.world_from_bind),
                };
                let new = held.influences.blend(i, &after.world_from_bind);
                let vertex = held.first + i;
                if let Some(back) = invert(&new) {
                    let place = (old * back).transform_point3(shape.now[vertex]);
                    self.write_back(&mut positions[vertex], place, shape.before[vertex]);
                }
            }
        }
        positions
    }

    /// Replaces a vertex by what has to be written for it.
    fn write_back(&self, now: &mut DVec3, place: DVec3, rest: DVec3) {
        let is_still = *now == rest && (place - rest).length() <= ROUNDING * self.size;
        if place.is_finite() && !is_still {
            *now = place;
        }
    }
}

pub(super) fn rounded_matrix(transform: &DAffine3) -> [f32; 16] {
    let mut matrix = [0.0; 16];
    let m = &transform.matrix3;
    for (c, column) in [m.x_axis, m.y_axis, m.z_axis, transform.translation].iter().enumerate() {
        matrix[4 * c..4 * c + 3].copy_from_slice(&column.as_vec3().to_array());
    }
    matrix[15] = 1.0;
    matrix
}

impl FollowedNodeTree {
    /// Where every node is.
    pub(super) fn world_from_node(&self) -> &[DAffine3] {
        &self.nodes.world_from_node
    }

    /// Adds the joints that moved to the counts of a file.
    pub(super) fn count_into(&self, doc: &GltfDocument<'_>, counts: &mut FollowedCounts) {
        let joints = joint_nodes(doc);
        let moved = joints.into_iter().filter(|&joint| self.has_moved(joint));
        let travel = |joint: usize| JointTravel {
            node: u32::try_from(joint).unwrap_or(u32::MAX),
            name: doc.nodes.values[joint].name.clone().unwrap_or_default(),
            distance: (self.nodes.world_from_node[joint].translation).distance(self.world_from_node[joint].translation),
        };
        let travels: Vec<JointTravel> = moved.map(travel).collect();
        counts.moved_joints = u32::try_from(travels.len()).unwrap_or(u32::MAX);
        counts.list_farthest(travels);
    }

    /// Whether a node stands or is turned differently; one that was held back under a parent that goes does not.
    fn has_moved(&self, node: usize) -> bool {
        let (before, after) = (&self.world_from_node[node], &self.nodes.world_from_node[node]);
        let lengths = before.matrix3.x_axis.length() + before.matrix3.y_axis.length() + before.matrix3.z_axis.length();
        let is_still = before.translation.distance(after.translation) <= ROUNDING * self.size
            && (0..3).all(|k| before.matrix3.col(k).distance(after.matrix3.col(k)) <= ROUNDING * lengths);
        self.nodes.is_elsewhere[node] && !is_still
    }
}
