//! How many joints followed, and which of them farthest.

use super::super::document::GltfDocument;
use super::super::skin::joint_nodes;
use super::{FollowedNodeTree, ROUNDING};
use crate::asset::{FollowedCounts, JointTravel};

impl FollowedNodeTree {
    /// Adds the joints that moved to the counts of a file.
    pub(in super::super) fn count_into(&self, doc: &GltfDocument<'_>, counts: &mut FollowedCounts) {
        let joints = joint_nodes(doc);
        let moved = joints.into_iter().filter(|&joint| self.has_moved(joint));
        let travel = |joint: usize| JointTravel {
            node: u32::try_from(joint).unwrap_or(u32::MAX),
            name: doc.nodes.values[joint].name.clone().unwrap_or_default(),
            distance: (self.nodes.world_from_node[joint].translation).distance(self.world_from_node[joint].translation),
        };
        let travels: Vec<JointTravel> = moved.map(travel).collect();
        counts.moved_joints = u32::try_from(travels.len()).unwrap_or(u32::MAX);
        counts.tell_farthest(travels);
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
