//! How many joints followed, and which of them farthest.

use super::super::document::GltfDocument;
use super::super::skin::joint_nodes;
use super::FollowedRig;
use crate::asset::{FollowedCounts, JointTravel};

impl FollowedRig {
    /// Adds the joints that moved to what is told of a file.
    pub(in super::super) fn count_into(&self, doc: &GltfDocument<'_>, counts: &mut FollowedCounts) {
        let joints = joint_nodes(doc);
        let moved = joints.into_iter().filter(|&joint| self.nodes.is_elsewhere[joint]);
        let travel = |joint: usize| JointTravel {
            node: u32::try_from(joint).unwrap_or(u32::MAX),
            name: doc.nodes.values[joint].name.clone().unwrap_or_default(),
            distance: (self.nodes.world_from_node[joint].translation).distance(self.world_from_node[joint].translation),
        };
        let travels: Vec<JointTravel> = moved.map(travel).collect();
        counts.moved_joints = u32::try_from(travels.len()).unwrap_or(u32::MAX);
        counts.tell_farthest(travels);
    }
}
