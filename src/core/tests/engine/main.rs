//! Laws of the engine: what a user of the crate sees of sessions, edits, handles, clips and skins. Counts of allocations are in a
//! program of their own, because they replace the allocator.

mod adopt;
mod animation;
mod carry;
mod contact;
#[expect(dead_code, reason = "other tests read single files")]
#[path = "../../../../tests/support/data.rs"]
mod data;
mod fit;
mod guides;
mod hard_surfaces;
mod layers;
mod lines;
mod moving_contact;
mod parts;
mod passengers;
mod skinning;
mod splat_models;
mod splats;
mod starts;
mod surface_files;
mod surface_points;
mod transfer;
mod unintersect;
mod vertex_targets;
mod wrap;
