//! Rotations as vectors, as the turning part of a matrix, and fitted to points; sines and cosines come from `libm`.

mod fit;
mod vector;

pub use fit::{fit_rotation, outer_product};
pub use vector::{
    exp_rotation, exp_symmetric, log_rotation, nearest_rotation, nearest_rotation_within, relative_rotation,
};
