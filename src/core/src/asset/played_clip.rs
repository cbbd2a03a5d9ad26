//! Clips that play solved frames: shapes to blend, or joints that carry vertices.

use glam::{DQuat, DVec3, Vec3};

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

/// One of both.
#[derive(Debug, Clone, Copy)]
pub(super) enum PlayedClip<'a> {
    /// Shapes.
    Morphs(MorphClip<'a>),
    /// Joints.
    Joints(SkinnedClip<'a>),
}
