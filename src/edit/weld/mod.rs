//! Points that lie close together become one.
//!
//! [`weld`] does so everywhere, [`weld_boundaries`] along the rim of a model that was appended. A join is left out, and
//! warned of, where it would give an edge a third face, make two faces touch at a point only, lay two faces on one
//! another, or turn one over.

mod joins;

pub(in crate::edit) use boundary::rim_points;
mod boundary;

use super::{Error, Patch, Surface};
use crate::mesh::{Mesh, NONE, Weld};
use crate::progress::{Progress, check};
use glam::DVec3;
use joins::Joins;

/// Joins points no further apart than `tolerance`: each, in order of number, to the nearest earlier one that joined none.
/// Triangles that lose a corner by it go. Says with `weld-nothing` when there is nothing to join, and with `weld-left`
/// what was left out.
///
/// # Errors
/// [`Error::Invalid`] when the tolerance is negative or not finite; [`Error::Impossible`] when no triangle would be left;
/// [`Error::Cancelled`].
pub fn weld(surface: &Surface, tolerance: f64, progress: &dyn Progress) -> Result<Patch, Error> {
    check_tolerance(tolerance, "weld.tolerance")?;
    let positions = point_positions(surface);
    let corners: Vec<[u32; 3]> = (surface.triangles.iter())
        .map(|t| t.map(|v| surface.point_of[v as usize]))
        .filter(|p| !p.contains(&NONE))
        .collect();
    let classes = Mesh::build(&positions, &corners, Weld::Tolerance(tolerance)).map_err(|e| Error::Impossible {
        problem: format!("welding within {tolerance} leaves nothing: {e}"),
        place: "the whole surface".to_owned(),
    })?;
    check(progress).map_err(|_| Error::Cancelled)?;
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
    join(surface, &positions, pairs, "weld-nothing", progress)
}

/// Joins the rim of an appended model, whose points are those from `first_new_point` on, to rims of the old one: each
/// point to the nearest within `tolerance`, the closest pairs first, one to one. The old points stay where they are.
///
/// # Errors
/// [`Error::Invalid`] when the tolerance is negative or not finite or a part is empty; [`Error::Impossible`] when one of
/// the models has no rim or no two points of both are close enough; [`Error::Cancelled`].
pub fn weld_boundaries(
    surface: &Surface,
    first_new_point: u32,
    tolerance: f64,
    progress: &dyn Progress,
) -> Result<Patch, Error> {
    check_tolerance(tolerance, "merge.tolerance")?;
    let rim = rim_points(surface);
    let (old, new) = rim.split_at(rim.partition_point(|&p| p < first_new_point));
    for (part, name) in [(old, "model"), (new, "appended model")] {
        if part.is_empty() {
            return Err(Error::Impossible {
                problem: format!("the {name} has no boundary to weld; cut it open, or merge without joining"),
                place: format!("the {name}"),
            });
        }
    }
    check(progress).map_err(|_| Error::Cancelled)?;
    let positions = point_positions(surface);
    let at = |p: u32| positions[p as usize];
    let matches = boundary::close_pairs(new, old, tolerance, at);
    if matches.is_empty() {
        let (distance, p, q) = boundary::closest(new, old, at);
        return Err(Error::Impossible {
            problem: format!(
                "no boundary point of the appended model is within {tolerance} of a boundary of the model, the closest is {distance} away; \
                 place it nearer, raise the tolerance or stitch"
            ),
            place: format!("{} and {}", at(p), at(q)),
        });
    }
    let mut patch = join(surface, &positions, matches, "weld-nothing", progress)?;
    let open = new.len()
        - new
            .iter()
            .filter(|p| patch.joined.binary_search_by_key(*p, |j| j.0).is_ok())
            .count();
    if open > 0 {
        patch.warnings.push((
            "weld-open".to_owned(),
            format!(
                "{open} of {} boundary points of the appended model stay unjoined",
                new.len()
            ),
            "the appended model".to_owned(),
        ));
    }
    Ok(patch)
}

fn check_tolerance(tolerance: f64, field: &str) -> Result<(), Error> {
    if tolerance >= 0.0 && tolerance.is_finite() {
        return Ok(());
    }
    Err(Error::Invalid {
        field: field.to_owned(),
        problem: format!("{tolerance} is no distance, it must be finite and at least 0"),
    })
}

/// Where each point is.
fn point_positions(surface: &Surface) -> Vec<DVec3> {
    let mut positions = vec![DVec3::ZERO; surface.points as usize];
    for (&p, &x) in surface.point_of.iter().zip(surface.positions) {
        if p != NONE {
            positions[p as usize] = x;
        }
    }
    positions
}

/// Makes the joins that may be made, the closest first, into a patch.
fn join(
    surface: &Surface,
    positions: &[DVec3],
    mut pairs: Vec<(u32, u32)>,
    nothing: &str,
    progress: &dyn Progress,
) -> Result<Patch, Error> {
    let distance = |&(p, q): &(u32, u32)| positions[p as usize].distance(positions[q as usize]);
    pairs.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b)));
    let mut patch = Patch::default();
    if pairs.is_empty() {
        patch.warnings.push((
            nothing.to_owned(),
            "no two points are within the tolerance".to_owned(),
            "the whole surface".to_owned(),
        ));
        return Ok(patch);
    }
    let mut joins = Joins::new(surface, positions, &pairs);
    for (i, &(p, q)) in pairs.iter().enumerate() {
        if i % 4096 == 0 {
            check(progress).map_err(|_| Error::Cancelled)?;
        }
        joins.join(p, q);
    }
    joins.settle();
    patch.joined = joins.joined();
    patch.removed = joins.collapsed();
    let left: Vec<&(u32, u32)> = (pairs.iter())
        .filter(|pair| patch.joined.binary_search_by_key(&pair.0, |j| j.0).is_err())
        .collect();
    if let Some(first) = left.first() {
        patch.warnings.push((
            "weld-left".to_owned(),
            format!(
                "{} of {} pairs of points were left apart: joined, faces would overlap, turn over or meet at an edge with more than two faces",
                left.len(),
                pairs.len()
            ),
            format!("{}", positions[first.0 as usize]),
        ));
    }
    if patch.removed.len() == surface.triangles.len() {
        return Err(Error::Impossible {
            problem: "the weld would leave no triangle; a smaller tolerance keeps some".to_owned(),
            place: "the whole surface".to_owned(),
        });
    }
    Ok(patch)
}
