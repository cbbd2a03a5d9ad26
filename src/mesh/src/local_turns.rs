//! How the surface around each vertex has turned and grown between two shapes, and how triangles are stretched and turned
//! over.
//!
//! What an artist has said relative to a place of the surface (a displacement of a morph target) is carried by the turn and
//! the growth of that place. Normals follow the whole gradient instead, see [`shading`](super::shading).

use crate::shading::area_gradient;
use crate::welded_mesh::Mesh;
use glam::{DMat2, DMat3, DVec2, DVec3};
use rayon::prelude::*;

/// The similarity that is nearest to what the surface around a vertex did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalTurn {
    /// The rotation.
    pub turn: DMat3,
    /// The factor by which lengths along the surface have grown: the root of the ratio of areas.
    pub growth: f64,
}

impl LocalTurn {
    /// Rotation times growth.
    pub fn similarity(&self) -> DMat3 {
        self.turn * self.growth
    }

    /// Whether it changes nothing but the last bits of what it is applied to.
    fn is_still(&self) -> bool {
        let off = self.similarity() - DMat3::IDENTITY;
        largest_entry(off) <= 1e-7
    }
}

/// The turns of all vertices between two shapes of the same triangles; `None` where nothing around a vertex turned or
/// grew, and where a vertex is in no triangle.
///
/// Vertices that lie in one place in both shapes share their turn, so that the sides of a seam stay together. A vertex
/// in nothing but triangles without area takes the turn of those that its triangles lead to.
///
/// # Panics
/// When an index is out of range or the shapes differ in length; readers guarantee neither happens.
pub fn local_turns(rest: &[DVec3], now: &[DVec3], triangles: &[[u32; 3]]) -> Vec<Option<LocalTurn>> {
    let places = shared_places(rest, now);
    let mut gradient = vec![DMat3::ZERO; rest.len()];
    let mut areas = vec![(0.0, 0.0); rest.len()];
    let mut is_moved = vec![false; rest.len()];
    for triangle in triangles {
        let (p, q) = (triangle.map(|v| rest[v as usize]), triangle.map(|v| now[v as usize]));
        let own = triangle.map(|v| places[v as usize] as usize);
        let before = (p[1] - p[0]).cross(p[2] - p[0]).length();
        let after = (q[1] - q[0]).cross(q[2] - q[0]).length();
        let change = area_gradient(p, q);
        for place in own {
            is_moved[place] |= p != q;
            if let Some(change) = change {
                gradient[place] += change;
                areas[place].0 += before;
                areas[place].1 += after;
            }
        }
    }
    let mut turns: Vec<Option<LocalTurn>> = (0..rest.len())
        .map(|v| {
            let growth = (areas[v].1 / areas[v].0).sqrt();
            let turn = nearest_rotation(&gradient[v])?;
            (growth.is_finite() && growth > 0.0).then_some(LocalTurn { turn, growth })
        })
        .collect();
    fill_from_neighbours(&mut turns, &is_moved, triangles, &places);
    (0..rest.len())
        .map(|v| turns[places[v] as usize].filter(|turn| is_moved[places[v] as usize] && !turn.is_still()))
        .collect()
}

/// For each vertex the first one that lies where it lies, in both shapes.
fn shared_places(rest: &[DVec3], now: &[DVec3]) -> Vec<u32> {
    // Adding zero turns -0 into 0.
    let bits = |p: DVec3| (p + DVec3::ZERO).to_array().map(f64::to_bits);
    let key = |v: u32| (bits(rest[v as usize]), bits(now[v as usize]));
    let mut order: Vec<u32> = (0..rest.len() as u32).collect();
    order.sort_by_cached_key(|&v| (key(v), v));
    let mut first = vec![0; rest.len()];
    for run in order.chunk_by(|&a, &b| key(a) == key(b)) {
        for &v in run {
            first[v as usize] = run[0];
        }
    }
    first
}

/// How far turns are handed on to vertices that have none of their own, in triangles.
const FURTHEST: usize = 64;

fn fill_from_neighbours(turns: &mut [Option<LocalTurn>], is_moved: &[bool], triangles: &[[u32; 3]], places: &[u32]) {
    let lacks = |turns: &[Option<LocalTurn>], v: usize| turns[v].is_none() && is_moved[v];
    let around: Vec<[usize; 3]> = triangles
        .iter()
        .map(|t| t.map(|v| places[v as usize] as usize))
        .collect();
    let mut open: Vec<[usize; 3]> = around
        .into_iter()
        .filter(|t| t.iter().any(|&v| lacks(turns, v)))
        .collect();
    for _ in 0..FURTHEST {
        let mut found = Vec::new();
        for t in &open {
            if let Some(turn) = t.iter().find_map(|&v| turns[v]) {
                found.extend(t.iter().filter(|&&v| lacks(turns, v)).map(|&v| (v, turn)));
            }
        }
        if found.is_empty() {
            return;
        }
        // Of several the first, in the order of the triangles.
        for (v, turn) in found {
            turns[v].get_or_insert(turn);
        }
        open.retain(|t| t.iter().any(|&v| lacks(turns, v)));
    }
}

/// The rotation nearest to a matrix (the polar factor); `None` for one that is singular, mirrors, or is not finite.
///
/// Higham's iteration, "Computing the polar decomposition—with applications" (1986), section 3, scaled by determinants.
pub fn nearest_rotation(matrix: &DMat3) -> Option<DMat3> {
    let mut turn = *matrix;
    for _ in 0..64 {
        let volume = turn.determinant();
        if !(volume > 0.0 && volume.is_finite()) {
            return None;
        }
        let scale = 1.0 / libm::cbrt(volume);
        let scaled = turn * scale;
        let next = (scaled + scaled.inverse().transpose()) * 0.5;
        let step = next - turn;
        turn = next;
        if largest_entry(step) < 1e-15 {
            break;
        }
    }
    // Within rounding of a rotation, or it has not converged: a matrix that is all but singular.
    let off = turn * turn.transpose() - DMat3::IDENTITY;
    (largest_entry(off) < 1e-9).then_some(turn)
}

/// The largest absolute value of an entry.
fn largest_entry(m: DMat3) -> f64 {
    m.x_axis.abs().max(m.y_axis.abs()).max(m.z_axis.abs()).max_element()
}

/// Triangles whose gradients are held at a time.
const RUN: usize = 1 << 16;

/// A gradient for each vertex from the triangles around it, in proportion to their areas: a sum, not a mean. Runs on the pool
/// of the caller; the number of threads changes no bit.
pub fn vertex_gradients(mesh: &Mesh, deformed: &[DVec3]) -> Vec<DMat3> {
    let corners = |shape: &[DVec3], t: &[u32; 3]| t.map(|v| shape[v as usize]);
    let mut gradients = vec![DMat3::ZERO; mesh.positions.len()];
    for run in mesh.triangles.chunks(RUN) {
        let of_triangles: Vec<DMat3> = run
            .par_iter()
            .map(|t| area_gradient(corners(&mesh.positions, t), corners(deformed, t)).unwrap_or(DMat3::ZERO))
            .collect();
        // In the order of the triangles, so that the sums are the same for any number of threads.
        for (t, gradient) in run.iter().zip(&of_triangles) {
            t.iter().for_each(|&v| gradients[v as usize] += *gradient);
        }
    }
    gradients
}

/// Whether the normal of a triangle that went from `p` to `q` opposes what the shape around did to it: what the cofactors of the
/// gradients at its corners make of it, on average. A fold is turned over, a part that was turned as a whole is not.
pub fn is_turned_over(p: [DVec3; 3], q: [DVec3; 3], cofactors: [&DMat3; 3]) -> bool {
    let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
    let Some(rest) = normal(p).try_normalize() else {
        return false;
    };
    let carried: DVec3 = cofactors
        .iter()
        .map(|&cofactor| (*cofactor * rest).try_normalize().unwrap_or(rest))
        .sum();
    carried.dot(normal(q)) < 0.0
}

/// The larger singular value of the map between two triangles; `None` for one without rest area.
pub fn largest_stretch(p: [DVec3; 3], q: [DVec3; 3]) -> Option<f64> {
    let (e, f) = (p[1] - p[0], p[2] - p[0]);
    let x = e.try_normalize()?;
    let y = (f - x * x.dot(f)).try_normalize()?;
    let rest = DMat2::from_cols(DVec2::new(e.length(), 0.0), DVec2::new(f.dot(x), f.dot(y)));
    let inverse = rest.inverse();
    let (g, h) = (q[1] - q[0], q[2] - q[0]);
    // Columns of the 3×2 Jacobian.
    let a = g * inverse.x_axis.x + h * inverse.x_axis.y;
    let b = g * inverse.y_axis.x + h * inverse.y_axis.y;
    let (aa, bb, ab) = (a.length_squared(), b.length_squared(), a.dot(b));
    let root = ((aa - bb) * (aa - bb) + 4.0 * ab * ab).sqrt();
    let stretch = (0.5 * (aa + bb + root)).sqrt();
    stretch.is_finite().then_some(stretch)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// A bent strip of six triangles, and a sliver on its end.
    fn strip() -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut points: Vec<DVec3> = (0..8)
            .map(|i| DVec3::new(f64::from(i / 2), f64::from(i % 2), f64::from(i * i) * 0.02))
            .collect();
        points.push(points[7]);
        let mut triangles: Vec<[u32; 3]> = (0..6).map(|i| [i, i + 1 + i % 2, i + 2 - i % 2]).collect();
        triangles.push([6, 7, 8]);
        (points, triangles)
    }

    #[test]
    fn a_similarity_is_found_everywhere() {
        let (rest, triangles) = strip();
        let turn = DQuat::from_axis_angle(DVec3::new(2., -1., 3.).normalize(), 2.5);
        let now: Vec<DVec3> = rest.iter().map(|&p| turn * p * 1.75 + DVec3::splat(9.0)).collect();
        for (v, found) in local_turns(&rest, &now, &triangles).into_iter().enumerate() {
            let found = found.expect("turned");
            assert!((found.growth - 1.75).abs() < 1e-12, "{v}: {}", found.growth);
            assert!(
                (found.turn - DMat3::from_quat(turn))
                    .to_cols_array()
                    .iter()
                    .all(|v| v.abs() < 1e-12),
                "{v}"
            );
        }
    }

    #[test]
    fn what_was_only_shifted_has_not_turned() {
        let (rest, triangles) = strip();
        let now: Vec<DVec3> = rest.iter().map(|&p| p + DVec3::new(0.1, 3.7, -2.3)).collect();
        assert!(local_turns(&rest, &now, &triangles).iter().all(Option::is_none));
        assert!(local_turns(&rest, &rest, &triangles).iter().all(Option::is_none));
    }

    #[test]
    fn the_sides_of_a_seam_turn_alike_until_they_part() {
        let rest = [
            [0., 0., 0.],
            [1., 0., 0.],
            [0., 1., 0.],
            [1., 0., 0.],
            [0., 1., 0.],
            [1., 1., 0.],
        ]
        .map(DVec3::from_array);
        let triangles = [[0, 1, 2], [3, 5, 4]];
        let mut now = rest;
        now[5].z = 0.5;
        let turns = local_turns(&rest, &now, &triangles);
        assert_eq!((turns[1], turns[2]), (turns[3], turns[4]));
        assert!(turns[1].is_some() && turns[0].is_none());
        now[3].z = 0.01;
        assert!(
            local_turns(&rest, &now, &triangles)[1].is_none(),
            "a vertex that has parted says nothing"
        );
    }

    #[test]
    fn the_nearest_rotation_of_what_flattens_or_mirrors_is_none() {
        let flat = DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.0));
        let mirror = DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0));
        for matrix in [
            flat,
            mirror,
            DMat3::ZERO,
            DMat3::IDENTITY * f64::NAN,
            DMat3::IDENTITY * f64::INFINITY,
        ] {
            assert_eq!(nearest_rotation(&matrix), None);
        }
        let turn = DMat3::from_quat(DQuat::from_axis_angle(DVec3::Z, 1.0));
        let stretched = turn * DMat3::from_diagonal(DVec3::new(1e3, 1.0, 1e-3));
        let found = nearest_rotation(&stretched).expect("it turns");
        assert!((found - turn).to_cols_array().iter().all(|v| v.abs() < 1e-12));
    }
}
