//! Deleting faces and filling holes, and what cuts use of it to close what they open.

mod loop_fill;
mod opening;
mod polygon;

use super::patch::{EditWarning, SurfacePatch};
use super::region_mesh::RegionMesh;
use super::surface::{BitSet, SurfaceView};
use super::topology::{boundary_loops, split_into_loops};
pub(super) use loop_fill::{RefineSize, WHOLE_EDGES, fill_loop, refine_faces, triangulate_loop};
pub(super) use opening::{CapLook, OpeningRim, split_double_edges};
use pliant_exec::progress::{Progress, check};
use pliant_mesh::{Error, sorted_set};
pub(super) use polygon::{double_area, loop_contains, triangulate_polygon};
use std::collections::BTreeSet;

/// Removes the triangles `faces`. With `fill`, the holes that this leaves are closed by new triangles as large as those
/// around, faired; where the hole runs into the boundary of the surface it stays open, with a warning.
///
/// # Errors
/// [`Error::Impossible`] when nothing or everything is named, [`Error::TooLarge`] for a hole with too long a boundary,
/// [`Error::Cancelled`].
pub fn delete_faces(
    surface: &SurfaceView<'_>,
    faces: &[u32],
    fill: bool,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let mut faces = sorted_set(faces.iter().copied());
    faces.retain(|&f| (f as usize) < surface.triangles.len());
    if faces.is_empty() || faces.len() == surface.triangles.len() {
        let problem = format!(
            "the region holds {} of {} faces; name at least one and leave at least one",
            faces.len(),
            surface.triangles.len()
        );
        return Err(Error::impossible(problem, "delete.region"));
    }
    let mut mesh = RegionMesh::with_ring(surface, &faces);
    let doomed: Vec<u32> = (0..mesh.triangles.len() as u32)
        .filter(|&f| faces.binary_search(&mesh.triangles[f as usize]).is_ok())
        .collect();
    for (k, &f) in doomed.iter().enumerate() {
        // Each looks through all faces around its corners.
        if k.is_multiple_of(64) {
            check(progress)?;
        }
        mesh.remove_face(f);
    }
    if fill {
        let (closed, open) = split_into_loops(&edges_left_open(&mesh, &doomed));
        for trail in open {
            let message = format!(
                "the hole runs into the surface's rim over {} edges and is not filled",
                trail.len() - 1
            );
            let place = format!("{}", mesh.position(trail[0]));
            mesh.warnings.push(EditWarning::new("open-rim", message, place));
        }
        for ring in closed.iter().filter(|r| r.len() > 2) {
            fill_loop(&mut mesh, ring, CapLook::default(), progress)?;
        }
    }
    mesh.open_fans(&BTreeSet::new());
    // Triangles without area are not in the mesh.
    Ok(mesh.into_finite_patch(surface, faces)?.0)
}

/// The edges between removed faces and ones that are left, as faces that fill the hole would pass them, sorted.
fn edges_left_open(mesh: &RegionMesh, removed: &[u32]) -> Vec<[u32; 2]> {
    let mut open: BTreeSet<[u32; 2]> = BTreeSet::new();
    for &f in removed {
        let t = mesh.points_of(f);
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            let mut along = mesh.faces_along(a, b);
            if let (Some(g), None) = (along.next(), along.next()) {
                let forward = mesh.faces[g as usize].has_directed_edge(a, b);
                open.insert(if forward { [b, a] } else { [a, b] });
            }
        }
    }
    open.into_iter().collect()
}

/// Fills the holes whose boundary touches a point of the triangles `region`, or all holes. New triangles are as large as
/// those around and faired.
///
/// # Errors
/// [`Error::Impossible`] when there is no such hole, [`Error::TooLarge`] for one with too long a boundary,
/// [`Error::Cancelled`].
pub fn fill_holes(
    surface: &SurfaceView<'_>,
    region: Option<&[u32]>,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let (mut mesh, rings) = gather_holes(surface, region, progress)?;
    for ring in &rings {
        fill_loop(&mut mesh, ring, CapLook::default(), progress)?;
    }
    mesh.open_fans(&BTreeSet::new());
    Ok(mesh.into_finite_patch(surface, Vec::new())?.0)
}

/// The surface around the holes that touch a point of the triangles `region`, or around all, and those holes as points of
/// it, in the direction that faces filling them run.
///
/// # Errors
/// [`Error::Impossible`] when there is no such hole, [`Error::Cancelled`].
pub(super) fn gather_holes(
    surface: &SurfaceView<'_>,
    region: Option<&[u32]>,
    progress: &dyn Progress,
) -> Result<(RegionMesh, Vec<Vec<u32>>), Error> {
    let (mut closed, open) = boundary_loops(surface);
    let total = closed.len();
    let wanted = region.map(|region| surface.points_of_triangles(region));
    let touches = |&p: &u32| wanted.as_ref().is_none_or(|wanted| wanted.contains(p));
    closed.retain(|ring| ring.len() > 2 && ring.iter().any(touches));
    if closed.is_empty() {
        let problem = match (total, open.len()) {
            (0, 0) => "the surface has no hole".to_owned(),
            (0, n) => format!("none of the surface's {n} rims closes to a loop"),
            (n, _) => format!("none of the surface's {n} holes touches the region; widen it up to a rim"),
        };
        return Err(Error::impossible(problem, "fill.region"));
    }
    check(progress)?;
    let mut around = BitSet::new(surface.points as usize);
    closed.iter().flatten().for_each(|&p| around.insert(p));
    let mesh = RegionMesh::around_points(surface, &around);
    let found = |ring: &Vec<u32>| ring.iter().filter_map(|&p| mesh.find_point(p)).collect();
    let rings = closed.iter().map(found).collect();
    Ok((mesh, rings))
}
