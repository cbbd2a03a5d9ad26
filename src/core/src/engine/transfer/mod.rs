//! Blend shapes of one model on another, or a pose: the other model keeps its vertices, texture coordinates, rig and materials.
//!
//! `run` wraps the source onto the model, unless both have the same triangles; there the source's shapes are carried to its wrapped
//! surface by the gradients of its triangles ([`SurfaceTransfer`](crate::deform::SurfaceTransfer)), and from there to the model's vertices
//! by their `places` on it.

mod command;
mod places;
mod run;

pub use command::{ShapeFacts, TransferCommand, TransferReport, Transferred};
