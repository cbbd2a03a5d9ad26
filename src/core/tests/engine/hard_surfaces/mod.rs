//! Hard-surface and low-poly models: thin faces follow, large ones are reported and divided, density does not decide the bend.

mod density;
mod large_faces;
mod models;
mod thin_faces;
