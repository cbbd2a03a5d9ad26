//! What moves in a scene: nodes, clips, and which nodes hold which vertices; and clips that play solved frames.

use glam::{DAffine3, DQuat, DVec3, Vec3};
use std::ops::Range;

/// How a channel runs from key to key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChannelInterpolation {
    /// The value of the key before.
    Step,
    /// Straight, or along the shorter great circle for rotations.
    Linear,
    /// By a cubic Hermite spline; each key has the tangent that leads to it, its value and the tangent that leads away.
    CubicSpline,
}

/// What a channel moves of a node.
#[derive(Debug, Clone, PartialEq)]
pub enum ChannelValues {
    /// Relative to the node above.
    Translation(Vec<DVec3>),
    /// Relative to the node above; as stored, of about unit length where they are no tangents.
    Rotation(Vec<DQuat>),
    /// Along the node's own axes.
    Scale(Vec<DVec3>),
    /// How much each morph target of the node's mesh counts, target by target: a list of values for each.
    Weights(Vec<Vec<f64>>),
}

/// A channel of a clip: one value per time, three for a spline.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneChannel {
    /// The node that it moves.
    pub node: usize,
    /// Seconds, rising.
    pub times: Vec<f64>,
    /// The values.
    pub values: ChannelValues,
    /// How it runs from key to key.
    pub interpolation: ChannelInterpolation,
}

/// A clip of a scene.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SceneClip {
    /// What it is called; may be empty.
    pub name: String,
    /// What it moves of nodes and of their morph targets. What else it moves is left out.
    pub channels: Vec<SceneChannel>,
}

/// A node of a scene: scaled, then turned, then moved, relative to the node above.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneNode {
    /// What it is called; may be empty.
    pub name: String,
    /// The node above, by number.
    pub parent: Option<usize>,
    /// Rest translation.
    pub translation: DVec3,
    /// Rest rotation, of unit length.
    pub rotation: DQuat,
    /// Rest scale. For a matrix that shears, the rotation is the nearest one, and the scale is the lengths of its
    /// columns.
    pub scale: DVec3,
    /// The rest transform in the file, where that is a matrix.
    pub matrix: Option<DAffine3>,
}

/// A primitive of a model, and the node that draws it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ScenePrimitive {
    /// The node.
    pub node: usize,
    /// Its render vertices.
    pub vertices: Range<usize>,
    /// Whether the node has a skin, so that joints place it and the node itself does not.
    pub has_skin: bool,
}

/// Where the vertices of a primitive are stored, and what its morph targets do to them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PrimitiveShapes {
    /// One per vertex, in the space of its node; none for a primitive with a skin.
    pub positions: Vec<Vec3>,
    /// For each morph target by how much it moves each vertex; none for one that moves no positions. In the space of
    /// the node, and with a skin in that of the rest model.
    pub targets: Vec<Vec<Vec3>>,
}

/// The vertices of a model that follow joints.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointInfluences {
    /// For each render vertex where its entries begin; one more than there are vertices.
    pub starts: Vec<u32>,
    /// Nodes that are joints, with weights above 0 that sum to 1 for each vertex that has any.
    pub entries: Vec<(u32, f32)>,
}

impl JointInfluences {
    /// The joints of a vertex with their weights; none for a vertex that the file does not have.
    pub fn of(&self, vertex: usize) -> &[(u32, f32)] {
        let range = self.starts.get(vertex).zip(self.starts.get(vertex + 1));
        range
            .and_then(|(&first, &end)| self.entries.get(first as usize..end as usize))
            .unwrap_or(&[])
    }
}

/// What moves in a scene.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MovingScene {
    /// All nodes of the file, by number.
    pub nodes: Vec<SceneNode>,
    /// For each node whether it is a joint that places vertices of the model.
    pub is_joint: Vec<bool>,
    /// What draws the model's primitives, in their order.
    pub primitives: Vec<ScenePrimitive>,
    /// Which joints hold which render vertices.
    pub influences: JointInfluences,
    /// The names of all clips, in order; may be empty.
    pub clip_names: Vec<String>,
}

/// Where a node is: it takes x to rotation · x + translation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodePlace {
    /// Model units.
    pub translation: DVec3,
    /// Of unit length.
    pub rotation: DQuat,
}

impl NodePlace {
    /// Where nothing is moved.
    pub const IDENTITY: Self = Self {
        translation: DVec3::ZERO,
        rotation: DQuat::IDENTITY,
    };
}

/// Where a node is at times, in between by straight lines and shortest turns.
#[derive(Debug, Clone, Copy)]
pub struct NodeKeys<'a> {
    /// Seconds, rising.
    pub times: &'a [f64],
    /// One for each time.
    pub places: &'a [NodePlace],
}

/// A clip of the file itself that goes on beside what is played: nodes that no skin places are not played then, but move as it
/// moves them.
#[derive(Debug, Clone, Copy)]
pub struct ClipBeside<'a> {
    /// Its number in the file. What is played takes its place.
    pub clip: usize,
    /// When in it what is played begins and ends, in seconds.
    pub seconds: [f64; 2],
    /// What all that goes on does on top, where there is such a thing.
    pub around: Option<NodeKeys<'a>>,
}

/// A clip of shapes: each is a morph target, and between its time and the next the two are blended.
#[derive(Debug, Clone, Copy)]
pub struct MorphClip<'a> {
    /// Its name.
    pub name: &'a str,
    /// Seconds of the shapes, rising.
    pub times: &'a [f64],
    /// For each time where the render vertices are, in model space, the root's motion apart.
    pub shapes: &'a [Vec<Vec3>],
    /// What everything that is played does on top of that, where there is such a thing.
    pub root: Option<NodeKeys<'a>>,
    /// What goes on beside it.
    pub beside: Option<ClipBeside<'a>>,
}

/// A joint of a [`SkinnedClip`].
#[derive(Debug, Clone, PartialEq)]
pub struct PlayedJoint {
    /// Its name.
    pub name: String,
    /// Number of its parent, which is lower than its own; `None`: the root of all is its parent.
    pub parent: Option<usize>,
    /// Its rest place, in model space.
    pub rest: NodePlace,
}

/// The joints that carry a vertex and how much; those with a weight of 0 do not.
pub type CarryingJoints = [(u32, f32); 8];

/// Rest shapes that correct the result of the joints, by their weights in a frame.
#[derive(Debug, Clone, Copy)]
pub struct PlayedCorrectives<'a> {
    /// For each the rest positions of render vertices, in model space.
    pub shapes: &'a [Vec<Vec3>],
    /// For each frame the weight of each.
    pub weights: &'a [Vec<f64>],
}

/// A clip of joints that hang on each other below one root.
#[derive(Debug, Clone, Copy)]
pub struct SkinnedClip<'a> {
    /// Its name.
    pub name: &'a str,
    /// For each render vertex the joints that carry it. Where none has more than four, that many are stored.
    pub influences: &'a [CarryingJoints],
    /// The joints.
    pub joints: &'a [PlayedJoint],
    /// Seconds of the frames, rising; none for a skin without a clip.
    pub times: &'a [f64],
    /// For each frame where each joint is, in model space, the root's motion apart.
    pub frames: &'a [Vec<NodePlace>],
    /// What corrects it, as morph targets, where something does.
    pub correctives: Option<PlayedCorrectives<'a>>,
    /// What the root does, where it does something.
    pub root: Option<NodeKeys<'a>>,
    /// What goes on beside it.
    pub beside: Option<ClipBeside<'a>>,
}

/// A shape that a model can be blended towards.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BlendShape {
    /// Its name; `shape` and a number for one that the file does not name.
    pub name: String,
    /// How far it moves each render vertex, in model space.
    pub moves: Vec<Vec3>,
    /// How much of it the model shows without a clip.
    pub weight: f32,
}

/// A clip of the weights of blend shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct BlendClip {
    /// Its name; may be empty.
    pub name: String,
    /// Seconds, rising.
    pub times: Vec<f64>,
    /// How weights run from key to key.
    pub interpolation: ChannelInterpolation,
    /// Shapes with their weights, one for each time; three for a spline.
    pub weights: Vec<(usize, Vec<f64>)>,
}

/// The blend shapes of a model.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BlendShapes {
    /// The shapes. One name on several meshes of a model is one shape.
    pub shapes: Vec<BlendShape>,
    /// The clips that play them.
    pub clips: Vec<BlendClip>,
    /// Whether shapes turn normals, too.
    pub has_normals: bool,
    /// Whether shapes turn tangents, too.
    pub has_tangents: bool,
}

/// One of these.
#[derive(Debug, Clone, Copy)]
pub(super) enum PlayedClip<'a> {
    /// Shapes.
    Morphs(MorphClip<'a>),
    /// Joints.
    Joints(SkinnedClip<'a>),
    /// Blend shapes with their clips.
    Shapes(&'a BlendShapes),
}
