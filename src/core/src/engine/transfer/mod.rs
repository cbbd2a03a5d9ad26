//! Blend shapes of one model on another, or a pose: the other model keeps its vertices, texture coordinates, rig and materials.
//!
//! `run` wraps the source onto the model, unless both have the same triangles; there the source's shapes are carried to its wrapped
//! surface by the gradients of its triangles ([`SurfaceTransfer`](crate::deform::SurfaceTransfer)), and from there to the model's vertices
//! by their `places` on it. An `outfit` follows a body that is wrapped onto another one, and is put outside of it.

mod command;
mod outfit;
mod places;
mod run;

pub use command::{FitFacts, OutfitFit, ShapeFacts, TransferCommand, TransferReport, Transferred};
