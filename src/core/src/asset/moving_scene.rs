//! What moves in a scene: nodes, clips, and which nodes hold which vertices.

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
