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
    /// other model's blend shapes come to the model. With `fit` it is another body, of any triangles.
    pub shape: Option<OtherModel>,
    /// The model is an outfit of the other one, a body, and is to fit the body that `shape` is.
    pub fit: Option<OutfitFit>,
    /// Places that belong together: `own` on the model, `target` on the other one. Not needed where triangles are the same. With `fit`,
    /// `own` on the first body, `target` on the second.
    pub landmarks: Vec<WrapLandmark>,
    /// The format of a model in another shape; `None`: its own. Blend shapes come in a GLB.
    pub format: Option<Format>,
}

/// How an outfit is to fit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct OutfitFit {
    /// What it keeps from the second body at most, model units of that one; up to there as far as from the first, in proportion to
    /// the sizes of the bodies. `None`: 0.005 of the second body's diagonal.
    pub clearance: Option<f64>,
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
    /// How well the source lay on the model, or the first body on the second; `None` where both have the same triangles.
    pub wrap: Option<WrapReport>,
    /// How an outfit fits.
    pub fit: Option<FitFacts>,
}

/// How an outfit fits another body.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FitFacts {
    /// Vertices of its surface, welded.
    pub vertices: u32,
    /// Those inside of the first body, which may be inside of the second.
    pub inside_at_rest: u32,
    /// Others that were inside of the second one as the outfit was carried there.
    pub inside_carried: u32,
    /// Those that are inside of it now.
    pub inside: u32,
    /// Pairs of triangles, at least one of the outfit, that cross and did not on the first body, as it was carried.
    pub crossings_carried: u64,
    /// Those that cross now.
    pub crossings: u64,
    /// How unevenly edges have grown, as [`WrapReport::edge_distortion`].
    pub edge_distortion: f64,
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
