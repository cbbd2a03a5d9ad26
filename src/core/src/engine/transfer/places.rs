//! Where points are on a surface: each on a triangle, with the weights of its corners.

use crate::engine::error::Error;
use crate::engine::wrap::{LEAST_COSINE, OrientedPoint, answers, barycentric};
use crate::exec::Exec;
use crate::mesh::BoundingBox;
use crate::mesh::query::TriangleBvh;
use glam::DVec3;
use rayon::prelude::*;

/// The closest triangle that faces as the point does counts up to so many times as far away as the closest of all, and this share of
/// the diagonal.
const FARTHER: f64 = 4.0;
const FARTHER_BY: f64 = 0.01;

/// A place on a surface: vertices with weights.
pub(super) type SurfacePlace = [(u32, f64); 3];

/// Where points are closest to a surface, on a side that faces the same way where there is one: so the lips of a mouth that is
/// closed follow each their own.
///
/// # Errors
/// Those of [`answers`].
pub(super) fn places_on(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    points: &[OrientedPoint],
    exec: &Exec<'_>,
) -> Result<Vec<SurfacePlace>, Error> {
    let tree = TriangleBvh::build(positions, triangles, exec.pool);
    let diagonal = BoundingBox::of(positions).diagonal();
    let normal_of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    };
    let normals: Vec<DVec3> = (exec.pool).install(|| triangles.par_iter().map(normal_of).collect());
    let place = |point: &OrientedPoint| {
        let closest = tree.closest_point(point.point)?;
        let within = FARTHER * closest.distance + FARTHER_BY * diagonal;
        let faces = |triangle: u32| normals[triangle as usize].dot(point.normal) >= LEAST_COSINE;
        let found = match point.normal == DVec3::ZERO || faces(closest.triangle) {
            true => closest,
            false => tree.closest_point_where(point.point, within, &faces).unwrap_or(closest),
        };
        let corners = triangles[found.triangle as usize];
        let weights = barycentric(found.point, corners.map(|v| positions[v as usize]));
        Some([0, 1, 2].map(|k| (corners[k], weights[k])))
    };
    let found = answers(&tree, points.len(), exec, |k| place(&points[k]))?;
    Ok(found.into_iter().map(|place| place.unwrap_or([(0, 0.0); 3])).collect())
}
