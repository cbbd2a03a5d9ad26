//! Topology operations: each makes the smallest patch of a surface that does what the caller asked for.
//!
//! An operation never changes the session's arrays. It reads a [`SurfaceView`] and returns a [`SurfacePatch`]: removed
//! triangles, added vertices and triangles, and what the new vertices are made of. [`apply_patch`] turns surface and
//! patch into the next surface with the maps between both, so that attributes, handles, graph and hierarchy can follow.
//! What is far from the edit keeps its order and its bits. Formats, requests, handles and the solver are unknown here.
//!
//! Topology is that of *points* (welded vertices): a seam in texture coordinates is not a gap. A cut that keeps both
//! sides leaves two points at one place, so a number identifies a point, never its position.
//!
//! | module | what it does |
//! |---|---|
//! | `patch` | the patch, and applying it |
//! | `region_mesh` | the one structure that operations change faces in |
//! | `cut` | planes, curves along the surface, caps over what a cut opens |
//! | `fill`, `flat_fill` | deleting faces, filling holes |
//! | `remesh`, `decimate`, `subdivide` | other triangles for the same shape |
//! | `smooth` | the same triangles for a smoother shape |
//! | `stitch`, `weld` | joining boundaries and points |
//!
//! Other modules: what stays sharp in a subdivision (`creases`), the surface that is read (`surface`), its counts (`topology`) and measures of a triangle (`triangle`).

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

mod creases;
mod cut;
mod decimate;
mod fill;
mod flat_fill;
mod patch;
mod region_mesh;
mod remesh;
mod smooth;
mod smooth_closed;
mod smooth_volume;
mod stitch;
mod subdivide;
mod surface;
mod topology;
mod triangle;
mod weld;

pub use creases::CreaseOptions;
pub use cut::{CutOptions, CutPlane, KeptSide, MOST_POINTS, SurfaceCurve, cut_along_curve, cut_by_plane, insert_curve};
pub use decimate::decimate_region;
pub use fill::{delete_faces, fill_holes};
pub use flat_fill::fill_holes_flat;
pub use patch::{BlendedVertex, EditWarning, NewTriangle, NewVertex, PatchedSurface, SurfacePatch, apply_patch};
pub use pliant_mesh::Error;
pub use remesh::{
    ASPECT, DEVIATION, LENGTH_DEVIATION, MENDED, MOST_TRIANGLES, RemeshOptions, RemeshTarget, SHARP_DEGREES, STRETCH,
    expected_triangles, relax_region, remesh_region,
};
pub use smooth::{MOST_SMOOTHINGS, SMOOTH_STRENGTH, SMOOTHINGS, SmoothOptions, smooth_region};
pub use stitch::{LoopPair, stitch_boundaries};
pub use subdivide::{EvennessTarget, FieldSample, SubdivisionScheme, subdivide_region, subdivide_until_even};
pub use surface::{MOST_FACE_PAIRS, SurfaceView, check_faces_at_points};
pub use topology::{SurfaceTopology, verify_surface};
pub use weld::{NOTHING_TO_WELD, weld_boundaries, weld_points};
