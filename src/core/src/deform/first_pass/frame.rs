//! Rotations and frames of nodes as they are stored.

use glam::{DMat3, DQuat};

/// A node's linear map R S, column-major.
pub type LocalFrame = [f32; 9];

/// The identity frame.
pub(in crate::deform) const IDENTITY_FRAME: LocalFrame = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// A rotation per node, as (x, y, z, w) of a unit quaternion.
pub(in crate::deform) type LocalRotation = [f32; 4];

pub(in crate::deform) fn pack_rotation(q: DQuat) -> LocalRotation {
    q.as_quat().to_array()
}

pub(in crate::deform) fn unpack_rotation(turn: LocalRotation) -> DQuat {
    glam::Quat::from_array(turn).as_dquat().normalize()
}

/// R S of a node.
pub(in crate::deform) fn pack_frame(rotation: DQuat, scale: Option<DMat3>) -> LocalFrame {
    let r = DMat3::from_quat(rotation);
    scale.map_or(r, |s| r * s).as_mat3().to_cols_array()
}
