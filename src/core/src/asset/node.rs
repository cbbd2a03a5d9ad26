//! Nodes of a model's file, and what follows one shape into a file.

use super::Following;
use glam::DAffine3;
use std::collections::BTreeMap;

/// A node of the tree that places the meshes of a glTF: a mesh, a camera, a light, a joint, or an empty that marks a place.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelNode {
    /// Its name; empty without one.
    pub name: String,
    /// The transform from its space to the world's, as the file has it.
    pub world_from_node: DAffine3,
    /// Whether it is a joint of a skin.
    pub is_joint: bool,
}

/// How nodes move in world space, by their index in the file; `None` for one that stays where it is, whatever its parent does.
pub type NodeMotions = BTreeMap<usize, Option<DAffine3>>;

/// No node moves.
static NO_MOTIONS: NodeMotions = NodeMotions::new();

/// What follows one shape of a model into its file: by rule, and nodes by motions of their own. Formats without nodes
/// ignore them.
///
/// ```
/// use pliant_core::asset::{Following, ShapeFollowers};
/// let followers = ShapeFollowers::from(Following::default());
/// assert!(followers.nodes.is_empty());
/// ```
#[derive(Debug, Clone)]
pub struct ShapeFollowers<'a> {
    /// What becomes of morph targets and skeletons.
    pub rules: Following,
    /// Rigid motions of nodes of the first base's file, none of them a joint. Their children move with them.
    pub nodes: &'a NodeMotions,
}

impl From<Following> for ShapeFollowers<'_> {
    fn from(rules: Following) -> Self {
        Self {
            rules,
            nodes: &NO_MOTIONS,
        }
    }
}
