//! What of a file followed its model's shape, in numbers.

use super::NodeMotions;

/// How many joints are listed by name.
const MOST_TOLD: usize = 8;

/// What there is in a written file that can follow its model's shape, and how much of it did. All zeros for files that hold
/// nothing of the kind.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FollowedCounts {
    /// Nodes that are joints of any skin.
    pub joints: u32,
    /// Those of them that stand or are turned differently.
    pub moved_joints: u32,
    /// Those that moved farthest, at most 8: the farthest first, among equals in the order of their nodes. Joints that only
    /// turned are not among them.
    pub farthest: Vec<JointTravel>,
    /// Clips that move or turn nodes; those of morph weights alone have nothing that could follow.
    pub clips: u32,
    /// Those of them of which values have changed.
    pub rewritten_clips: u32,
    /// Morph targets, once for each node that draws them.
    pub morph_targets: u32,
    /// Those of them of which displacements have changed.
    pub carried_morph_targets: u32,
    /// Primitives that ride along.
    pub passengers: u32,
    /// Those of them of which vertices have moved.
    pub moved_passengers: u32,
    /// Nodes that ride along by themselves.
    pub passenger_nodes: u32,
    /// Those of them that have moved.
    pub moved_passenger_nodes: u32,
}

/// How far a joint has moved.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointTravel {
    /// Its node in the uploaded file.
    pub node: u32,
    /// The name of that node; empty where the file gives none.
    pub name: String,
    /// From where it was in the uploaded file, in model units.
    pub distance: f64,
}

impl FollowedCounts {
    /// Whether there is nothing that could follow.
    pub fn is_none(&self) -> bool {
        [
            self.joints,
            self.clips,
            self.morph_targets,
            self.passengers,
            self.passenger_nodes,
        ] == [0; 5]
    }

    /// Counts a primitive that rides along.
    pub(super) fn count_passenger(&mut self, has_moved: bool) {
        self.passengers += 1;
        self.moved_passengers += u32::from(has_moved);
    }

    /// Counts the nodes that ride along.
    pub(super) fn count_nodes(&mut self, nodes: &NodeMotions) {
        let number = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        self.passenger_nodes = number(nodes.len());
        self.moved_passenger_nodes = number(nodes.values().flatten().count());
    }

    /// Keeps those that moved farthest of joints in the order of their nodes.
    pub(super) fn tell_farthest(&mut self, mut travels: Vec<JointTravel>) {
        travels.retain(|travel| travel.distance > 0.0);
        travels.sort_by(|a, b| b.distance.total_cmp(&a.distance));
        travels.truncate(MOST_TOLD);
        self.farthest = travels;
    }
}

/// In one line, such as "19 of 22 joints, 2 of 2 clips"; what the file has none of is left out.
impl std::fmt::Display for FollowedCounts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let parts = [
            (self.moved_joints, self.joints, "joint"),
            (self.rewritten_clips, self.clips, "clip"),
            (self.carried_morph_targets, self.morph_targets, "morph target"),
            (self.moved_passengers, self.passengers, "passenger primitive"),
            (self.moved_passenger_nodes, self.passenger_nodes, "passenger node"),
        ];
        let present = parts.into_iter().filter(|(_, all, _)| *all > 0);
        for (k, (followed, all, what)) in present.enumerate() {
            let (comma, plural) = (if k > 0 { ", " } else { "" }, if all == 1 { "" } else { "s" });
            write!(f, "{comma}{followed} of {all} {what}{plural}")?;
        }
        Ok(())
    }
}
