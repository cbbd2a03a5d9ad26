//! Colours that stand for numbers, and for what crosses what.

use crate::exec::Exec;
use crate::mesh::{Crossing, Mesh, Weld, crossing_triangles};
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
pub(in crate::cli) fn crossings_of(
    positions: &[DVec3],
    rest: Option<&[DVec3]>,
    triangles: &[[u32; 3]],
    pool: &Pool,
) -> Result<Vec<Crossing>, Error> {
    // Seams are closed as the deformer closes them: in the rest pose.
    let mesh = Mesh::build(rest.unwrap_or(positions), triangles, Weld::Exact)?;
    let place = |positions: &[DVec3]| -> Vec<DVec3> {
        let first = |s: u32| mesh.render_vertices_of(s).first().map(|&v| positions[v as usize]);
        let count = mesh.positions.len() as u32;
        (0..count).map(|s| first(s).unwrap_or_default()).collect()
    };
    let exec = Exec::new(pool, &Silent);
    let (now, before) = (place(positions), rest.map(place));
    let found = crossing_triangles(&now, before.as_deref(), &mesh.triangles, &exec).unwrap_or_default();
    let mut of_input = vec![Crossing::None; triangles.len()];
    for (&source, crossing) in mesh.source_triangle.iter().zip(found) {
        of_input[source as usize] = crossing;
    }
    Ok(of_input)
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
