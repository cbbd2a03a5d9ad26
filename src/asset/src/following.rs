//! What else of a file follows when the shape of its model changes: by rule, by motions of nodes, and how much did, in numbers.

use glam::{DAffine3, DVec3};
use pliant_exec::Exec;
use pliant_mesh::carry::{CarriedPoints, SurfaceCarrier};
use std::collections::BTreeMap;

/// What becomes of morph targets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MorphTargetRule {
    /// Displacements turn and grow with the surface around their vertices.
    #[default]
    Follow,
    /// They stay as they are stored.
    Keep,
}

/// What becomes of skeletons.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RigRule {
    /// Joints move and turn with what they hold; inverse bind matrices and clips are made to fit. In a VRM 0.x file, of which the
    /// joints must not be turned, as [`RigRule::Move`].
    #[default]
    Follow,
    /// As [`RigRule::Follow`], but joints keep their turns and move alone.
    Move,
    /// They stay as they are stored.
    Keep,
}

/// What becomes of the lengths of bones: of the distances between joints and the nearest joints above them, in the rest pose.
///
/// A joint whose bone keeps its length is put in the direction in which it would have gone, seen from the new place of
/// the joint above, and turned as it would have been. Joints with none above are free. Translations of its clips turn
/// with the bone: at every time the bone is as long as before, unless a non-joint node or a stretched parent lies
/// between. Lengths stay within the rounding of 32-bit numbers: a millionth of themselves and of the model's diagonal.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum BoneLengthRule {
    /// They follow the body.
    #[default]
    Follow,
    /// All stay as they are.
    Keep,
    /// Those stay that are below joints of these names, however far below.
    KeepBelow(Vec<String>),
}

/// What becomes of Gaussian splats that are larger than the bend around them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LargeSplatRule {
    /// They are divided along their longest axis into three, which may be divided again.
    #[default]
    Divide,
    /// They turn and stretch as a whole, and their ends stand off.
    Keep,
}

/// What follows the shape of a model into its file. The default is that everything does; formats that hold nothing of the
/// kind are not concerned.
///
/// ```
/// use pliant_asset::{Following, MorphTargetRule, RigRule};
/// assert_eq!(Following::default().rig, RigRule::Follow);
/// assert_eq!(Following::default().morph_targets, MorphTargetRule::Follow);
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Following {
    /// Morph targets (blend shapes) of glTF.
    pub morph_targets: MorphTargetRule,
    /// The joints of skinned glTF.
    pub rig: RigRule,
    /// The lengths of bones, where joints follow.
    pub bone_lengths: BoneLengthRule,
    /// Gaussian splats that are larger than the bend around them.
    pub large_splats: LargeSplatRule,
}

/// How many joints are listed by name.
const MOST_LISTED_JOINTS: usize = 8;

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
    pub(super) fn list_farthest(&mut self, mut travels: Vec<JointTravel>) {
        travels.retain(|travel| travel.distance > 0.0);
        travels.sort_by(|a, b| b.distance.total_cmp(&a.distance));
        travels.truncate(MOST_LISTED_JOINTS);
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
/// use pliant_asset::{Following, ShapeFollowers};
/// let followers = ShapeFollowers::from(Following::default());
/// assert!(followers.nodes.is_empty());
/// ```
#[derive(Clone)]
pub struct ShapeFollowers<'a> {
    /// What becomes of morph targets and skeletons.
    pub rules: Following,
    /// Rigid motions of nodes of the first base's file, none of them a joint. Their children move with them.
    pub nodes: &'a NodeMotions,
    /// Where splats are carried along, on a thread of its own without it; and who can cancel the decompression of views.
    pub exec: Option<Exec<'a>>,
    /// What the splats of a model of their own follow, where that is known; found again without it, which takes longer.
    pub splats: Option<BoundSplats<'a>>,
    /// Where the vertices of an edited model were before it was posed, in the world of its files; what they are blended from says it
    /// where it is not known.
    pub rest: Option<&'a [DVec3]>,
}

/// What the splats of a model that no edit has changed follow, all of them in their order, and where it has gone.
#[derive(Clone, Copy)]
pub struct BoundSplats<'a> {
    /// How the surface has moved.
    pub carrier: &'a SurfaceCarrier,
    /// Their centres, bound to that surface.
    pub points: &'a CarriedPoints,
}

impl From<Following> for ShapeFollowers<'_> {
    fn from(rules: Following) -> Self {
        Self {
            rules,
            nodes: &NO_MOTIONS,
            exec: None,
            splats: None,
            rest: None,
        }
    }
}
