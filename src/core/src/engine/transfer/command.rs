//! A transfer as a program asks for it, and what it came to.

use crate::asset::{Format, WrittenFiles};
use crate::engine::other_model::OtherModel;
use crate::engine::wrap::{WrapLandmark, WrapReport};

/// What comes from another model.
#[derive(Debug, Clone)]
pub struct TransferCommand {
    /// The other model.
    pub source: OtherModel,
    /// The other model in another shape, with the same vertices and triangles: the model takes on what leads there. `None`: the
    /// other model's blend shapes come to the model.
    pub shape: Option<OtherModel>,
    /// Places that belong together: `own` on the model, `target` on the other one. Not needed where triangles are the same.
    pub landmarks: Vec<WrapLandmark>,
    /// The format of a model in another shape; `None`: its own. Blend shapes come in a GLB.
    pub format: Option<Format>,
}

/// The model with what came from the other one.
#[derive(Debug)]
pub struct Transferred {
    /// Its files.
    pub files: WrittenFiles,
    /// Their format.
    pub format: Format,
    /// What came.
    pub report: TransferReport,
}

/// What came from another model.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TransferReport {
    /// The shapes, in the order of the source; one without a name for a model that took on another shape.
    pub shapes: Vec<ShapeFacts>,
    /// Clips of weights that came with them.
    pub clips: u32,
    /// How well the source lay on the model; `None` where both have the same triangles.
    pub wrap: Option<WrapReport>,
}

/// A shape that came.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShapeFacts {
    /// Its name.
    pub name: String,
    /// Vertices that it moves.
    pub moved_vertices: u32,
    /// By how much it moves one at most, as a share of the model's diagonal.
    pub largest_move: f64,
    /// Triangles that it turns over.
    pub flipped_triangles: u32,
    /// Triangles of the source that it turned over there.
    pub flipped_in_source: u32,
}
