//! Which vertices can be seen from outside. Inner surfaces (the sack of a mouth, the back of an eye) would be pulled to what lies outside
//! of them.

use super::queries::answers;
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::mesh::query::TriangleBvh;
use glam::DVec3;

/// Directions that are looked into from a vertex, and how many of them must lead out.
const DIRECTIONS: usize = 40;
const ENOUGH: usize = 4;

/// For each vertex whether a tenth of the directions on the side of its normal lead out; vertices without a normal are not seen.
///
/// # Errors
/// Those of [`answers`].
pub(super) fn seen_vertices(
    positions: &[DVec3],
    normals: &[DVec3],
    triangles: &[[u32; 3]],
    exec: &Exec<'_>,
) -> Result<Vec<bool>, Error> {
    let tree = TriangleBvh::build(positions, triangles, exec.pool);
    let reach = 2.0 * crate::mesh::BoundingBox::of(positions).diagonal();
    let directions = directions();
    let sees = |vertex: usize| {
        let (from, normal) = (positions[vertex], normals[vertex]);
        let (mut out, mut left) = (0, DIRECTIONS);
        for direction in directions.iter().filter(|d| d.dot(normal) > 0.15) {
            out += usize::from(
                tree.first_hit(from, from + *direction * reach, Some(vertex as u32))
                    .is_none(),
            );
            left -= 1;
            if out == ENOUGH || out + left < ENOUGH {
                break;
            }
        }
        normal != DVec3::ZERO && out == ENOUGH
    };
    answers(&tree, positions.len(), exec, sees)
}

/// Twice as many directions as are looked into, evenly over the sphere (a Fibonacci lattice), those near each other in the list far
/// from each other on the sphere.
fn directions() -> Vec<DVec3> {
    const ALL: usize = 2 * DIRECTIONS;
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let direction = |k: usize| {
        let z = 1.0 - (2 * k + 1) as f64 / ALL as f64;
        let (sin, cos) = libm::sincos(golden * k as f64);
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * cos, r * sin, z)
    };
    (0..ALL).map(|k| direction(k * 37 % ALL)).collect()
}
