//! Skins of joined bases.
//!
//! A joint of a joined base is the joint of the first one that has its name, so that what it holds moves with that skeleton.
//! Joints without a counterpart come along: below the nearest joint above them, else beside the skeleton that the others are
//! part of, else below the node of their base. Vertices are written as they stand in the world, so that an inverse bind matrix is
//! the inverse of where its joint is: nothing moves in the rest pose, wherever the two skeletons stand.

use super::super::builder::{AccessorKind, BufferBuilder};
use super::super::document::GltfDocument;
use super::super::placement::{invert, joint_nodes};
use super::super::rig::{FollowedNodeTree, rounded_matrix};
use super::super::scene::{PlacedScene, place_meshes};
use super::super::text::{json_array, json_object, value_of, with_member};
use super::looks::JoinedBases;
use crate::{Error, WrittenWarning};
use glam::DAffine3;
use std::collections::{BTreeMap, BTreeSet};

/// The joints of the first base, where the written file has them.
pub(super) struct FrameSkeleton {
    /// By name; `None` for a name that several have.
    by_name: BTreeMap<String, Option<usize>>,
    parents: Vec<Option<usize>>,
    world_from_node: Vec<DAffine3>,
}

impl FrameSkeleton {
    /// `tree`: the nodes that follow the shape.
    pub(super) fn new(doc: &GltfDocument<'_>, tree: Option<&FollowedNodeTree>) -> Result<Self, Error> {
        let scene = place_meshes(doc, &mut Vec::new())?;
        let mut by_name: BTreeMap<String, Option<usize>> = BTreeMap::new();
        for joint in joint_nodes(doc) {
            if let Some(name) = &doc.nodes.values[joint].name {
                let only = |one: &mut Option<usize>| *one = None;
                by_name.entry(name.clone()).and_modify(only).or_insert(Some(joint));
            }
        }
        Ok(Self {
            by_name,
            parents: scene.parents,
            world_from_node: tree.map_or(scene.world_from_node, |tree| tree.world_from_node().to_vec()),
        })
    }

    fn root_of(&self, mut node: usize) -> usize {
        while let Some(parent) = self.parents[node] {
            node = parent;
        }
        node
    }
}

/// A node of the written file and where it is.
#[derive(Clone, Copy)]
pub(super) struct WrittenNode {
    pub(super) number: usize,
    pub(super) world: DAffine3,
}

/// Joins the skins of one base.
pub(super) struct SkeletonJoiner<'s, 'a> {
    frame: &'s FrameSkeleton,
    doc: &'s GltfDocument<'a>,
    scene: &'s PlacedScene,
    /// Where the base was put.
    placing: DAffine3,
    joints: BTreeSet<usize>,
    /// The written nodes of joints.
    known: BTreeMap<usize, WrittenNode>,
    /// Joints of the first base that have a counterpart.
    taken: BTreeSet<usize>,
    /// Written skins.
    skins: BTreeMap<usize, usize>,
    /// The names of joints without a counterpart.
    added: Vec<String>,
}

impl<'s, 'a> SkeletonJoiner<'s, 'a> {
    pub(super) fn new(
        frame: &'s FrameSkeleton,
        doc: &'s GltfDocument<'a>,
        scene: &'s PlacedScene,
        placing: DAffine3,
    ) -> Self {
        let mut joiner = Self {
            frame,
            doc,
            scene,
            placing,
            joints: joint_nodes(doc),
            known: BTreeMap::new(),
            taken: BTreeSet::new(),
            skins: BTreeMap::new(),
            added: Vec::new(),
        };
        for joint in joiner.joints.clone() {
            let name = doc.nodes.values[joint].name.as_ref();
            let same = name.and_then(|name| frame.by_name.get(name).copied().flatten());
            if let Some(number) = same.filter(|number| joiner.taken.insert(*number)) {
                let world = frame.world_from_node[number];
                joiner.known.insert(joint, WrittenNode { number, world });
            }
        }
        joiner
    }

    /// Whether all joints of a skin have a counterpart.
    pub(super) fn has_all(&self, skin: usize) -> bool {
        let joints = self.doc.read_skin(skin).map_or(Vec::new(), |skin| skin.joints);
        joints.iter().all(|joint| self.known.contains_key(&joint.index()))
    }

    /// The number of a skin in the written file. `root`: the node of the base; `frame`: the document that it joins.
    pub(super) fn join(
        &mut self,
        skin: usize,
        root: WrittenNode,
        frame: &GltfDocument<'_>,
        fresh: &mut BufferBuilder,
        joined: &mut JoinedBases,
    ) -> usize {
        if let Some(number) = self.skins.get(&skin) {
            return *number;
        }
        let read = self.doc.read_skin(skin).map_or(Vec::new(), |skin| skin.joints);
        let joints: Vec<usize> = read.iter().map(|joint| joint.index()).collect();
        // What has no joint above it hangs where it shares a root with the others.
        let matched = joints.iter().filter_map(|joint| self.known.get(joint));
        let matched = matched
            .map(|node| node.number)
            .find(|number| *number < frame.nodes.len());
        let top = matched.map_or(root, |number| {
            let number = self.frame.root_of(number);
            let world = self.frame.world_from_node[number];
            WrittenNode { number, world }
        });
        let nodes: Vec<WrittenNode> = joints
            .iter()
            .map(|joint| self.add_joint(*joint, top, frame, joined))
            .collect();
        let binds = nodes
            .iter()
            .map(|node| invert(&node.world).unwrap_or(DAffine3::IDENTITY));
        let binds: Vec<f32> = binds.flat_map(|bind| rounded_matrix(&bind)).collect();
        let binds = fresh.add_floats(&binds, "MAT4", AccessorKind::Numbers);
        let numbers = json_array(nodes.iter().map(|node| node.number));
        let mut text = json_object([("joints", numbers), ("inverseBindMatrices", binds.to_string())]);
        if let Some(name) = value_of(self.doc.item(&self.doc.skins, skin), "name") {
            text = with_member(&text, "name", name);
        }
        joined.skins.push(text);
        let number = frame.skins.len() + joined.skins.len() - 1;
        self.skins.insert(skin, number);
        number
    }

    /// The written node of a joint, which is made, with those joints above it that are not there either, where it has none.
    fn add_joint(
        &mut self,
        joint: usize,
        top: WrittenNode,
        frame: &GltfDocument<'_>,
        joined: &mut JoinedBases,
    ) -> WrittenNode {
        let mut missing = Vec::new();
        let mut at = Some(joint);
        let mut parent = top;
        while let Some(node) = at {
            if let Some(known) = self.known.get(&node) {
                parent = *known;
                break;
            }
            if self.joints.contains(&node) {
                missing.push(node);
            }
            at = self.scene.parents[node];
        }
        for node in missing.into_iter().rev() {
            let name = value_of(self.doc.item(&self.doc.nodes, node), "name");
            let mut text = name.map_or("{}".to_owned(), |name| json_object([("name", name)]));
            let world = self.placing * self.scene.world_from_node[node];
            let local = invert(&parent.world).map(|back| back * world);
            // A node cannot shear; the inverse bind matrix makes up for it.
            let local = local.and_then(|local| NodeTransform::nearest(&local));
            if let Some(local) = &local {
                text = local.write_into_node(text);
            }
            let number = frame.nodes.len() + joined.nodes.len();
            joined.nodes.push((text, None));
            joined.children.entry(parent.number).or_default().push(number);
            let world = local.map_or(parent.world, |local| parent.world * local.transform);
            parent = WrittenNode { number, world };
            self.known.insert(node, parent);
            self.added
                .push(self.doc.nodes.values[node].name.clone().unwrap_or_default());
        }
        parent
    }

    /// What is said of joints that came along although the first base has a skeleton. `model`: the name of the base.
    pub(super) fn warning(&self, model: &str) -> Option<WrittenWarning> {
        const MOST_NAMED: usize = 8;
        let (added, all) = (self.added.len(), self.known.len());
        if added == 0 || self.frame.by_name.is_empty() {
            return None;
        }
        let mut names = self.added[..added.min(MOST_NAMED)].join(", ");
        if added > MOST_NAMED {
            names.push_str(", …");
        }
        let message = format!(
            "{added} of {all} joints of {model} have no joint of the same name to become, and came along as their own: {names}"
        );
        Some(WrittenWarning::new("joints-added", message, "nodes"))
    }
}

/// A transform as a node can have it, a product of translation, rotation and scale, and what is then exactly that.
pub(super) struct NodeTransform {
    pub(super) transform: DAffine3,
    /// The members of the node.
    text: [(&'static str, String); 3],
}

impl NodeTransform {
    /// `None` for a transform that shears or flattens.
    pub(super) fn from_affine(transform: &DAffine3) -> Option<Self> {
        let m = &transform.matrix3;
        let [x, y, z] = [
            m.x_axis.try_normalize()?,
            m.y_axis.try_normalize()?,
            m.z_axis.try_normalize()?,
        ];
        if x.dot(y).abs().max(y.dot(z).abs()).max(z.dot(x).abs()) > 1e-6 {
            return None;
        }
        Self::nearest(transform)
    }

    /// That without the shear of a transform; `None` for one that flattens.
    fn nearest(transform: &DAffine3) -> Option<Self> {
        if transform.matrix3.determinant() == 0.0 {
            return None;
        }
        let (scale, rotation, translation) = transform.to_scale_rotation_translation();
        let rotation = rotation.normalize();
        let transform = DAffine3::from_scale_rotation_translation(scale, rotation, translation);
        let list = |numbers: &[f64]| json_array(numbers.iter().map(|v| format!("{v:?}")));
        let text = [
            ("translation", list(&translation.to_array())),
            ("rotation", list(&rotation.to_array())),
            ("scale", list(&scale.to_array())),
        ];
        transform.is_finite().then_some(Self { transform, text })
    }

    pub(super) fn write_into_node(&self, node: String) -> String {
        if self.transform == DAffine3::IDENTITY {
            return node;
        }
        self.text
            .iter()
            .fold(node, |node, (key, value)| with_member(&node, key, value))
    }
}
