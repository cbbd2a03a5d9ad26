//! A quick look for faces that may have turned over or be stretched too far.
//!
//! What a shape does to a face is found in single precision. A face passes where its normal is far from the turn, its stretch far from the limit and its surroundings are
//! such that neither number can be wrong by that much. All others are to be looked at exactly, so that what is found in the
//! end is what a look at each face finds.

use glam::{DMat3, DVec3, Mat3, Vec3};
use pliant_exec::pool::Pool;
use pliant_mesh::Mesh;
use rayon::prelude::*;

/// Twice the area of a face, in squares of its longer side, below which it is not judged: single precision knows what is done to it only
/// by its inverse times 1e-7.
const LEAST_AREA: f64 = 1e-2;
/// The same after the pose, against the product of the sides.
const LEAST_AREA_NOW: f32 = 1e-2;
/// Faces that the sum of squares of their gradient takes beyond this are not judged; 64 is a stretch of 8.
const MOST_SQUARES: f32 = 60.0;
/// Where what is around a vertex has less than this part of its area left, its faces are not judged.
const LEAST_COFACTOR: f32 = 0.05;
/// The least cosine between a face's normal and what its surroundings make of it.
const LEAST_COSINE: f32 = 0.2;
/// Faces that one piece of work handles at least.
const PIECE: usize = 4096;
/// Faces whose gradients are held at a time.
const BLOCK: usize = 1 << 16;

/// A face in the rest pose; `area` is 0 where it is not judged.
#[derive(Debug, Clone, Copy)]
struct RestFace {
    /// The inverse of two sides, in units of the longer one, and the unit normal, which is its last row.
    inverse: Mat3,
    per_size: f64,
    /// Twice the area, in squares of the mesh's diagonal.
    area: f32,
}

impl RestFace {
    fn of([a, b, c]: [DVec3; 3], per_diagonal: f64) -> Self {
        let (e, f) = (b - a, c - a);
        let per_size = 1.0 / e.abs().max(f.abs()).max_element();
        let (e, f) = (e * per_size, f * per_size);
        let normal = e.cross(f);
        let length = normal.length();
        let side = per_diagonal / per_size;
        let area = (length * side * side) as f32;
        let inverse = DMat3::from_cols(e, f, normal / length).inverse().as_mat3();
        let is_judged = length >= LEAST_AREA && area >= f32::MIN_POSITIVE && area.is_finite() && inverse.is_finite();
        Self {
            inverse,
            per_size,
            area: if is_judged { area } else { 0.0 },
        }
    }

    /// The gradient of a face that is now there and its normal, in units of its longer side in the rest pose; `None` where it is not
    /// judged.
    fn gradient(&self, [a, b, c]: [DVec3; 3]) -> Option<(Mat3, Vec3)> {
        let side = |from: DVec3, to: DVec3| ((to - from) * self.per_size).as_vec3();
        let (e, f) = (side(a, b), side(a, c));
        let normal = e.cross(f);
        let length = normal.length_squared();
        let least = LEAST_AREA_NOW * LEAST_AREA_NOW * e.length_squared() * f.length_squared();
        let gradient = Mat3::from_cols(e, f, normal * (1.0 / length.sqrt())) * self.inverse;
        let [x, y, z] = [gradient.x_axis, gradient.y_axis, gradient.z_axis].map(|c| c.length_squared());
        // The normal's part of the sum is 1. Comparisons with NaN are false.
        (self.area > 0.0 && length > least && x + y + z - 1.0 < MOST_SQUARES).then_some((gradient, normal))
    }
}

/// A vertex of a shape: the cofactors of the mean gradient around it, where its faces can be judged.
type Cofactors = Option<Mat3>;

/// The faces, rising, that may have turned over or be stretched more than 7.8 times in a shape: among them all that have.
pub(crate) fn find_suspects(mesh: &Mesh, now: &[DVec3], pool: &Pool) -> Vec<u32> {
    let per_diagonal = 1.0 / mesh.bounds().diagonal();
    let corners = |shape: &[DVec3], t: &[u32; 3]| t.map(|v| shape[v as usize]);
    pool.install(|| {
        // By face the normals before and now, and by vertex the sum of the gradients by area and of the areas: NaN where a face is
        // not judged.
        let mut normals = vec![[Vec3::NAN; 2]; mesh.triangles.len()];
        let mut sums = vec![(Mat3::ZERO, 0.0f32); now.len()];
        let mut judged = Vec::new();
        for (triangles, normals) in mesh.triangles.chunks(BLOCK).zip(normals.chunks_mut(BLOCK)) {
            let faces = triangles.par_iter().with_min_len(PIECE).map(|t| {
                let rest = RestFace::of(corners(&mesh.positions, t), per_diagonal);
                let (gradient, normal) = rest.gradient(corners(now, t))?;
                Some((gradient * rest.area, rest.area, [rest.inverse.row(2), normal]))
            });
            faces.collect_into_vec(&mut judged);
            for ((t, own), face) in triangles.iter().zip(normals).zip(&judged) {
                let (gradient, area) = match face {
                    Some((gradient, area, normals)) => {
                        *own = *normals;
                        (*gradient, *area)
                    }
                    None => (Mat3::ZERO, f32::NAN),
                };
                for &v in t {
                    let sum = &mut sums[v as usize];
                    *sum = (sum.0 + gradient, sum.1 + area);
                }
            }
        }
        let cofactors: Vec<Cofactors> = sums.par_iter().with_min_len(PIECE).map(cofactors).collect();
        drop(sums);
        let passes = |t: usize| {
            let [Some(a), Some(b), Some(c)] = mesh.triangles[t].map(|v| cofactors[v as usize]) else {
                return false;
            };
            let [rest, normal] = normals[t];
            // Comparisons with NaN are false.
            let looks_along = |cofactors: Mat3| {
                let carried = cofactors * rest;
                let (along, size) = (carried.dot(normal), carried.length_squared());
                let least = LEAST_COSINE * LEAST_COSINE * normal.length_squared();
                along > 0.0 && size > LEAST_COFACTOR * LEAST_COFACTOR && along * along > least * size
            };
            [a, b, c].into_iter().all(looks_along)
        };
        let all = (0..mesh.triangles.len()).into_par_iter().with_min_len(PIECE);
        all.filter(|&t| !passes(t)).map(|t| t as u32).collect()
    })
}

fn cofactors((sum, area): &(Mat3, f32)) -> Cofactors {
    let mean = *sum * (1.0 / area);
    let [x, y, z] = [mean.x_axis, mean.y_axis, mean.z_axis];
    (*area > 0.0).then(|| Mat3::from_cols(y.cross(z), z.cross(x), x.cross(y)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_asset::shapes;
    use pliant_mesh::Weld;
    use pliant_mesh::local_turns::{is_turned_over, largest_stretch, vertex_gradients};
    use pliant_mesh::shading;

    #[test]
    fn no_face_that_an_exact_look_finds_is_passed_and_few_others_are_not() {
        let pool = Pool::new(2).expect("threads");
        let (positions, triangles) = shapes::grid(1.0, 1.0, [60, 60]);
        for (scale, sliver) in [(1.0, 1.0), (1e-9, 1.0), (1e9, 1.0), (1.0, 1e-5)] {
            let shape: Vec<DVec3> = positions
                .iter()
                .map(|p| *p * DVec3::new(1.0, sliver, 1.0) * scale)
                .collect();
            let sheet = Mesh::build(&shape, &triangles, Weld::Exact).expect("a sheet");
            // Waves that grow until they fold and stretch the sheet everywhere.
            for (wave, few) in [(0.0, true), (0.001, true), (0.01, true), (0.03, false), (0.2, false)] {
                let moved = |p: &DVec3| {
                    let q = *p / scale / DVec3::new(1.0, sliver, 1.0);
                    let sine = libm::sin(60.0 * q.x + 35.0 * q.y);
                    *p + DVec3::new(sine, sliver * libm::sin(47.0 * q.x), libm::cos(55.0 * q.y)) * (wave * scale)
                };
                let now: Vec<DVec3> = sheet.positions.iter().map(moved).collect();
                let suspects = find_suspects(&sheet, &now, &pool);
                let of: Vec<DMat3> = vertex_gradients(&sheet, &now).iter().map(shading::cofactor).collect();
                let mut bad = 0;
                for (t, corners) in (0u32..).zip(&sheet.triangles) {
                    let [p, q] = [&sheet.positions, &now].map(|shape| corners.map(|v| shape[v as usize]));
                    let own = corners.map(|v| &of[v as usize]);
                    let is_bad = is_turned_over(p, q, own) || largest_stretch(p, q).unwrap_or(0.0) > 7.8;
                    bad += usize::from(is_bad);
                    assert!(
                        !is_bad || suspects.binary_search(&t).is_ok(),
                        "face {t}, waves of {wave}"
                    );
                }
                assert!(few || bad > 0 || sliver < 1.0, "{wave}");
                assert!(
                    !few || sliver < 1.0 || suspects.len() < sheet.triangles.len() / 50,
                    "{} at {wave}",
                    suspects.len()
                );
            }
        }
    }
}
