//! Other methods, to compare the deformation with. Nothing below the deformer knows them; its solve hands a pose over to them.
//!
//! | module | what |
//! |---|---|
//! | `rotations` | first passes: orientation diffusion (paper equation 2) and linear frames (Lipman et al. 2005) |
//! | `spatial_rbf` | space deformed by radial basis functions (Botsch & Kobbelt 2005) in place of the graph |

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

mod rotations;
mod spatial_rbf;

pub use rotations::{diffuse, linear_frames};
pub use spatial_rbf::SpatialRbf;

/// How a pose is deformed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    /// On the graph, with rotations blended by harmonic fields: the product's method.
    #[default]
    Harmonic,
    /// On the graph, with rotations in the steady state of the paper's orientation diffusion, equation (2), begun at the blend.
    /// Unit quaternions are equal for one full turn and two: where a handle has turned further than that, the blend stays as it is.
    Diffusion,
    /// On the graph, with the linear frames of Lipman et al. 2005, made orthogonal afterwards: they pile turns up half-way
    /// between handles and know none beyond half a circle.
    LinearFrames,
    /// In space, by radial basis functions.
    SpatialRbf,
}
