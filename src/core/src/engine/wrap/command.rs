//! A wrap as a program asks for it.

use crate::engine::other_model::OtherModel;
use crate::engine::region::Region;
use glam::DVec3;

/// A wrap of the model onto another one.
#[derive(Debug, Clone)]
pub struct WrapCommand {
    /// What it is wrapped onto.
    pub target: OtherModel,
    /// Places that belong together. Three that are not on a line say how the target is placed and sized, too; with fewer that is
    /// found by the shapes.
    pub landmarks: Vec<WrapLandmark>,
    /// What of the model the target does not pull, beside what is hidden.
    pub mask: Option<Region>,
    /// Whether the result stays in the place and of the size of the model. Else it is where the target is.
    pub in_place: bool,
}

/// A place of the model and one of the target.
#[derive(Debug, Clone, PartialEq)]
pub struct WrapLandmark {
    /// On the model.
    pub own: LandmarkPlace,
    /// On the target.
    pub target: LandmarkPlace,
}

/// Where a landmark is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LandmarkPlace {
    /// At a vertex, by its number in the model's file.
    Vertex(u32),
    /// At the point of the surface that is closest to a place.
    Point(DVec3),
}
