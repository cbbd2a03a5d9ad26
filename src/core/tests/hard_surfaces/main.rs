//! Hard-surface and low-poly models: thin faces follow, large ones are reported and divided, density does not decide the bend.

#[expect(dead_code, reason = "other tests read single files")]
#[path = "../../../../tests/support/data.rs"]
mod data;
mod density;
mod large_faces;
mod models;
mod thin_faces;
