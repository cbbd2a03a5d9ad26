//! Colours that stand for numbers, and for what crosses what.

use crate::exec::Exec;
use crate::mesh::{Crossing, Mesh, Weld};
use crate::pool::Pool;
use crate::progress::Silent;
use crate::render::{ColourRamp, Error};
use glam::{DVec3, Vec3};

/// The colours of numbers; `unit` is the one at the end of the ramp.
pub(in crate::cli) fn heat_colours(values: &[f64], ramp: ColourRamp, unit: f64) -> Vec<Vec3> {
    values.iter().map(|x| ramp.linear_colour(x / unit)).collect()
}

/// For each of the triangles what it crosses, by the test of `output.selfIntersections`. With positions in the rest pose, pairs that
/// cross there too are not new.
pub(in crate::cli) fn crossings_by_triangle(
    positions: &[DVec3],
    rest: Option<&[DVec3]>,
    triangles: &[[u32; 3]],
    pool: &Pool,
) -> Result<Vec<Crossing>, Error> {
    // Seams are closed as the deformer closes them: in the rest pose.
    let mesh = Mesh::build(rest.unwrap_or(positions), triangles, Weld::Exact)?;
    let found = mesh.crossing_triangles(positions, rest, triangles.len(), &Exec::new(pool, &Silent));
    Ok(found.unwrap_or_else(|_| vec![Crossing::None; triangles.len()]))
}

/// Says how many triangles cross others.
pub(in crate::cli) fn crossing_words(crossings: &[Crossing], has_rest: bool) -> String {
    let count = |kind: Crossing| crossings.iter().filter(|c| **c == kind).count();
    let new = count(Crossing::New);
    match has_rest {
        true => format!("{new} cross, {} crossed before", count(Crossing::AtRest)),
        false => format!("{new} triangles cross"),
    }
}
