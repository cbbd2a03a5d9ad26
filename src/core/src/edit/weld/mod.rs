//! Points that lie close together become one.
//!
//! [`weld_points`] does so everywhere, [`weld_boundaries`] along the rim of a model that was appended. A join is left out, and
//! warned of, where it would give an edge a third face, make two faces touch at a point only, lay two faces on one
//! another, or turn one over.

mod joins;

use super::error::{EditSubject, Error};
use super::patch::{EditWarning, SurfacePatch};
use super::surface::SurfaceView;
use super::topology::boundary_points;
use crate::mesh::{Mesh, NONE, Weld};
use crate::progress::{Progress, check};
use glam::DVec3;
use joins::PointJoins;

/// The code of the warning that no two points are close enough.
pub const NOTHING_TO_WELD: &str = "weld-nothing";

/// Joins points no further apart than `tolerance`: each, in order of number, to the nearest earlier one that joined none.
/// Triangles that lose a corner by it go. Says with `weld-nothing` when there is nothing to join, and with `weld-left`
/// what was left out.
///
/// # Errors
/// [`Error::Invalid`] when the tolerance is negative or not finite; [`Error::Impossible`] when no triangle would be left;
/// [`Error::Cancelled`].
pub fn weld_points(surface: &SurfaceView, tolerance: f64, progress: &dyn Progress) -> Result<SurfacePatch, Error> {
    check_tolerance(tolerance, EditSubject::WeldTolerance)?;
    let positions = point_positions(surface);
    let corners: Vec<[u32; 3]> = (surface.triangles.iter())
        .map(|t| t.map(|v| surface.point_of[v as usize]))
        .filter(|p| !p.contains(&NONE))
        .collect();
    let classes = Mesh::build(&positions, &corners, Weld::Tolerance(tolerance)).map_err(|e| {
        let problem = format!("welding within {tolerance} leaves nothing: {e}");
        Error::impossible(problem, "the whole surface")
    })?;
    check(progress)?;
    let mut pairs = Vec::new();
    for (p, &class) in classes.solver_from_render.iter().enumerate() {
        if class == NONE {
            continue;
        }
        let first = classes.render_vertices_of(class)[0];
        if first as usize != p {
            pairs.push((p as u32, first));
        }
    }
    join_pairs(surface, &positions, pairs, progress)
}

/// Joins the rim of an appended model, whose points are those from `first_new_point` on, to rims of the old one: each
/// point to the nearest within `tolerance`, the closest pairs first, one to one. The old points stay where they are.
///
/// # Errors
/// [`Error::Invalid`] when the tolerance is negative or not finite or a part is empty; [`Error::Impossible`] when one of
/// the models has no rim or no two points of both are close enough; [`Error::Cancelled`].
pub fn weld_boundaries(
    surface: &SurfaceView,
    first_new_point: u32,
    tolerance: f64,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    check_tolerance(tolerance, EditSubject::BoundaryWeldTolerance)?;
    let rim = boundary_points(surface);
    let (old, new) = rim.split_at(rim.partition_point(|&p| p < first_new_point));
    for (part, name) in [(old, "model"), (new, "appended model")] {
        if part.is_empty() {
            return Err(Error::impossible(
                format!("the {name} has no boundary to weld; cut it open, or merge without joining"),
                format!("the {name}"),
            ));
        }
    }
    check(progress)?;
    let positions = point_positions(surface);
    let at = |p: u32| positions[p as usize];
    let matches = joins::find_close_pairs(new, old, tolerance, at, progress)?;
    if matches.is_empty() {
        let (distance, p, q) = joins::find_closest(new, old, at);
        return Err(Error::impossible(
            format!(
                "no boundary point of the appended model is within {tolerance} of a boundary of the model, the closest is {distance} away; \
                 place it nearer, raise the tolerance or stitch"
            ),
            format!("{} and {}", at(p), at(q)),
        ));
    }
    let mut patch = join_pairs(surface, &positions, matches, progress)?;
    let open = new.len()
        - new
            .iter()
            .filter(|p| patch.joined.binary_search_by_key(*p, |j| j.0).is_ok())
            .count();
    if open > 0 {
        patch.warnings.push(EditWarning::new(
            "weld-open",
            format!(
                "{open} of {} boundary points of the appended model stay unjoined",
                new.len()
            ),
            "the appended model",
        ));
    }
    Ok(patch)
}

fn check_tolerance(tolerance: f64, subject: EditSubject) -> Result<(), Error> {
    if tolerance >= 0.0 && tolerance.is_finite() {
        return Ok(());
    }
    let problem = format!("{tolerance} is not a distance, it must be finite and at least 0");
    Err(Error::invalid(subject, problem))
}

/// Where each point is.
fn point_positions(surface: &SurfaceView) -> Vec<DVec3> {
    let mut positions = vec![DVec3::ZERO; surface.points as usize];
    for (&p, &x) in surface.point_of.iter().zip(surface.positions) {
        if p != NONE {
            positions[p as usize] = x;
        }
    }
    positions
}

/// Makes the joins that may be made, the closest first, into a patch.
fn join_pairs(
    surface: &SurfaceView,
    positions: &[DVec3],
    mut pairs: Vec<(u32, u32)>,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let distance = |&(p, q): &(u32, u32)| positions[p as usize].distance(positions[q as usize]);
    pairs.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b)));
    let mut patch = SurfacePatch::default();
    if pairs.is_empty() {
        let message = "no two points are within the tolerance";
        patch
            .warnings
            .push(EditWarning::new(NOTHING_TO_WELD, message, "the whole surface"));
        return Ok(patch);
    }
    let mut joins = PointJoins::gather_faces(surface, positions, &pairs);
    for (i, &(p, q)) in pairs.iter().enumerate() {
        if i % 4096 == 0 {
            check(progress)?;
        }
        joins.join_points(p, q);
    }
    joins.undo_pinching_joins();
    patch.joined = joins.joined_pairs();
    patch.removed = joins.collapsed_triangles();
    let left: Vec<&(u32, u32)> = (pairs.iter())
        .filter(|pair| patch.joined.binary_search_by_key(&pair.0, |j| j.0).is_err())
        .collect();
    if let Some(first) = left.first() {
        patch.warnings.push(EditWarning::new(
            "weld-left",
            format!(
                "{} of {} pairs of points were left apart: joined, faces would overlap, turn over or meet at an edge with more than two faces",
                left.len(),
                pairs.len()
            ),
            format!("{}", positions[first.0 as usize]),
        ));
    }
    if patch.removed.len() == surface.triangles.len() {
        return Err(Error::impossible(
            "the weld would leave no triangle; a smaller tolerance keeps some",
            "the whole surface",
        ));
    }
    Ok(patch)
}
