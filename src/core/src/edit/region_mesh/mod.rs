//! The region mesh: a part of a surface while an operation changes it. All operations that change faces one by one work
//! on this one structure and answer with the [`SurfacePatch`](crate::edit::patch::SurfacePatch) that it becomes.
//!
//! Topology is that of points. Each face corner also has a *wedge*: what the attributes there are blended from. Two faces
//! that share a render vertex share its wedge, so an operation makes one new wedge where both sides of an edge agree and
//! one for each side along a seam, without knowing what a seam is.
//!
//! `gather` fills the mesh from a surface, `emit` writes the patch. In between there are two ways to change faces,
//! and an operation uses one of them throughout:
//!
//! - `split` *replaces* faces: the old one dies, its pieces are appended. Cuts and fills need that, because they look up the
//!   face that a piece comes from, treat edges with many faces, and part points afterwards (`open`).
//! - `turn` and `collapse` change faces *in place*. Remeshing and decimation need that, because they change every
//!   face many times and dead faces would pile up. Edges with more than two faces are left alone there.
//!
//! The order of the faces decides the order of the triangles of the patch, and with it the bits of every later result;
//! so the two ways cannot be expressed by one another.

mod gather;
mod mesh;
mod split;

pub(super) use mesh::{CAP, EdgeFaces, RegionMesh, Wedge, edge_key};
pub(super) use split::EdgeCollapse;
