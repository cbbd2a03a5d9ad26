//! Poses: where handles are.

use crate::deform::{Transform, log_rotation};
use glam::{DMat3, DQuat, DVec3};
use std::sync::Arc;

/// Where a handle is: scaled, then rotated about the pivot, then translated. `None` leaves it as in the rest pose.
///
/// ```
/// use pliant_core::engine::HandlePose;
/// let pose = HandlePose::translation([0.0, 1.0, 0.0]).rotated([0.0, 0.0, 1.57]);
/// assert!(pose.moves() && !HandlePose::default().moves());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct HandlePose {
    /// The way that the handle has moved, in model units.
    pub translation: Option<DVec3>,
    /// How the handle is turned.
    pub rotation: Option<HandleRotation>,
    /// How the handle is scaled.
    pub scale: Option<HandleScale>,
    /// The point that it is turned and scaled about; `None`: the rest centroid of the region's solver vertices.
    pub pivot: Option<DVec3>,
}

/// How a handle is turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HandleRotation {
    /// A quaternion of about unit length.
    Quaternion(DQuat),
    /// Axis times angle in radians; any number of turns counts.
    Vector(DVec3),
}

/// How a handle is scaled; factors are above 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HandleScale {
    /// By one factor in all directions.
    Uniform(f64),
    /// By a factor along each axis.
    PerAxis(DVec3),
}

/// The pose of every handle in force, in the order of the handles. Cheap to clone.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HandlePoses(pub Arc<Vec<HandlePose>>);

impl HandlePose {
    /// Makes the pose of a handle that has moved, and is neither turned nor scaled.
    pub fn translation(by: impl Into<DVec3>) -> Self {
        Self {
            translation: Some(by.into()),
            ..Self::default()
        }
    }

    /// Makes the pose of a handle that is turned by axis times angle in radians about its centroid.
    pub fn rotation(vector: impl Into<DVec3>) -> Self {
        Self::default().rotated(vector)
    }

    /// Adds a rotation by axis times angle in radians.
    #[must_use]
    pub fn rotated(self, vector: impl Into<DVec3>) -> Self {
        Self {
            rotation: Some(HandleRotation::Vector(vector.into())),
            ..self
        }
    }

    /// Adds the point that the handle is turned and scaled about.
    #[must_use]
    pub fn about(self, pivot: impl Into<DVec3>) -> Self {
        Self {
            pivot: Some(pivot.into()),
            ..self
        }
    }

    /// Returns whether the pose may move anything. A pivot alone does not.
    pub fn moves(&self) -> bool {
        self.translation.is_some() || self.rotation.is_some() || self.scale.is_some()
    }

    /// Returns the pose as a transform; `centroid` is the pivot when the pose names none.
    pub(super) fn to_transform(self, centroid: DVec3) -> Transform {
        let rotation = match self.rotation {
            Some(HandleRotation::Quaternion(q)) => log_rotation(q.normalize()),
            Some(HandleRotation::Vector(v)) => v,
            None => DVec3::ZERO,
        };
        let log_scale = match self.scale {
            None => DMat3::ZERO,
            Some(HandleScale::Uniform(s)) => log_diagonal([s; 3]),
            Some(HandleScale::PerAxis(s)) => log_diagonal(s.to_array()),
        };
        Transform {
            translation: self.translation.unwrap_or(DVec3::ZERO),
            rotation,
            log_scale,
            pivot: self.pivot.unwrap_or(centroid),
        }
    }
}

fn log_diagonal(factors: [f64; 3]) -> DMat3 {
    DMat3::from_diagonal(DVec3::from_array(factors.map(libm::log)))
}
