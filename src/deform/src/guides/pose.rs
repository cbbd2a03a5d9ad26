//! Shapes of guides in poses, and what is wrong with guides or shapes.

use glam::DVec3;

/// Points of a curve at most.
pub(super) const MOST_POINTS: usize = 1024;
/// Control points of a lattice at most.
pub(super) const MOST_CONTROL_POINTS: usize = 1 << 16;
/// The new shape of a guide.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GuidePose {
    /// Of a curve, its points, at least 2; of a lattice or a cage, the new places of all its control points.
    pub positions: Vec<DVec3>,
    /// Of a curve, the angle in radians that it is twisted by at each point, linear between them. Empty: none.
    pub twists: Vec<f64>,
    /// Of a curve, the scale across it at each point, above 0, linear between them. Empty: 1.
    pub scales: Vec<f64>,
}

impl GuidePose {
    /// Bytes held.
    pub fn byte_size(&self) -> usize {
        size_of::<Self>()
            + size_of_val(&self.positions[..])
            + size_of_val(&self.twists[..])
            + size_of_val(&self.scales[..])
    }
}

/// What is wrong with a guide or a pose of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GuideProblem {
    /// The field below the guide or the pose.
    pub field: String,
    /// What is wrong with it, in words that follow the field.
    pub problem: String,
}

impl GuideProblem {
    pub(super) fn new(field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self {
            field: field.into(),
            problem: problem.into(),
        }
    }
}

pub(super) fn finite(places: &[DVec3], field: &str) -> Result<(), GuideProblem> {
    match places.iter().position(|p| !p.is_finite()) {
        Some(k) => Err(GuideProblem::new(format!("{field}[{k}]"), "is not finite")),
        None => Ok(()),
    }
}
