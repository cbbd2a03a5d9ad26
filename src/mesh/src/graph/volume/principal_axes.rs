//! The axes that a lattice stands along: those of the surface's own moments, so that a moved, turned or scaled mesh has the moved,
//! turned or scaled lattice.
//!
//! The grid is the same seen from either end of an axis and with its axes exchanged, so neither their order nor their signs
//! matter.

use crate::Mesh;
use crate::graph::mesh_graph::MeshGraph;
use glam::{DMat3, DVec3};

/// Moments closer than this to each other, in shares of their sum, are equal. Wider than what single precision does to the moments
/// of a symmetric body.
const EQUAL: f64 = 1e-6;
/// Normals that prefer no direction by more than this share of the area give no axes.
const PREFERENCE: f64 = 1e-4;
/// Products of inertia below this share of the moments are rounding.
const ROUNDING: f64 = 1e-13;
/// Steps to the direction that stands out; a weak preference needs thousands.
const CLIMBS: usize = 20_000;
/// Jacobi's method needs about five rounds.
const ROUNDS: usize = 16;

/// The principal axes of a surface of even density as a rotation, those of the file where it has no others; in no certain order, and
/// either way round.
pub fn principal_axes(mesh: &Mesh) -> DMat3 {
    let axes = PrincipalAxes::of_surface(mesh).axes;
    match axes.determinant() < 0.0 {
        true => DMat3::from_cols(axes.x_axis, axes.y_axis, -axes.z_axis),
        false => axes,
    }
}

/// Three orthogonal directions; those of the file where a surface has no others.
pub(in crate::graph) struct PrincipalAxes {
    axes: DMat3,
}

impl PrincipalAxes {
    /// The principal axes of a surface of even density, whatever its triangles.
    pub(in crate::graph) fn of_surface(mesh: &Mesh) -> Self {
        let corners = |t: &[u32; 3]| t.map(|v| mesh.positions[v as usize]);
        let area = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).length();
        // Sums are taken around a corner of the box, so that places far from the origin lose nothing.
        let low = mesh.bounds().min;
        let (mut whole, mut middle) = (0.0, DVec3::ZERO);
        for t in mesh.triangles.iter().map(corners) {
            let weight = area(t);
            whole += weight;
            middle += ((t[0] - low) + (t[1] - low) + (t[2] - low)) * (weight / 3.0);
        }
        let middle = low + middle / whole;
        let mut moments = [[0.0f64; 3]; 3];
        for t in mesh.triangles.iter().map(corners) {
            let weight = area(t) / 12.0;
            let [a, b, c] = t.map(|p| p - middle);
            for p in [a, b, c, a + b + c].map(|p| p.to_array()) {
                for (i, row) in moments.iter_mut().enumerate() {
                    (0..3).for_each(|j| row[j] += weight * p[i] * p[j]);
                }
            }
        }
        let (axes, moments) = eigenvectors(moments);
        let axes = settle_ties(axes, moments, mesh);
        // The grid is the same with its axes exchanged or reversed, and a mesh that is not turned keeps its bits.
        let of_file = [axes.x_axis, axes.y_axis, axes.z_axis].map(|axis| axis.abs().max_element() > 1.0 - 1e-12);
        Self {
            axes: if of_file == [true; 3] { DMat3::IDENTITY } else { axes },
        }
    }

    /// The mesh in coordinates along the axes; `None` where they are the mesh's own.
    pub(in crate::graph) fn turn_mesh(&self, mesh: &Mesh) -> Option<Mesh> {
        let to_axes = self.axes.transpose();
        (self.axes != DMat3::IDENTITY).then(|| {
            let mut turned = mesh.clone();
            turned.positions.iter_mut().for_each(|p| *p = to_axes * *p);
            turned
        })
    }

    /// A graph of the turned mesh back in the mesh's own coordinates.
    pub(in crate::graph) fn turn_back(&self, mut graph: MeshGraph, mesh: &Mesh) -> MeshGraph {
        if self.axes != DMat3::IDENTITY {
            let (surface, inner) = graph.positions.split_at_mut(mesh.positions.len());
            surface.copy_from_slice(&mesh.positions);
            inner.iter_mut().for_each(|p| *p = self.axes * *p);
        }
        graph
    }
}

/// The eigenvectors of a symmetric matrix, by Jacobi's rotations, and the eigenvalues in shares of their sum. Planes with equal
/// moments, and axes that are eigenvectors already, stay as they are.
fn eigenvectors(mut m: [[f64; 3]; 3]) -> (DMat3, [f64; 3]) {
    let mut axes = DMat3::IDENTITY;
    let trace = m[0][0] + m[1][1] + m[2][2];
    if !(trace > 0.0 && trace.is_finite()) {
        return (axes, [0.0, 1.0, 2.0]);
    }
    for _ in 0..ROUNDS {
        let mut turned = false;
        for [p, q] in [[0, 1], [0, 2], [1, 2]] {
            let (product, gap) = (m[p][q], m[q][q] - m[p][p]);
            if product.abs() <= ROUNDING * trace || product.abs().max(gap.abs()) <= EQUAL * trace {
                continue;
            }
            turned = true;
            let slope = gap / (2.0 * product);
            let sign = if slope < 0.0 { -1.0 } else { 1.0 };
            let tangent = sign / (slope.abs() + (slope * slope + 1.0).sqrt());
            let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
            let sine = tangent * cosine;
            let mixed = |a: f64, b: f64| (cosine * a - sine * b, sine * a + cosine * b);
            for row in &mut m {
                (row[p], row[q]) = mixed(row[p], row[q]);
            }
            for k in 0..3 {
                (m[p][k], m[q][k]) = mixed(m[p][k], m[q][k]);
            }
            let (a, b) = (axes.col(p), axes.col(q));
            *axes.col_mut(p) = a * cosine - b * sine;
            *axes.col_mut(q) = a * sine + b * cosine;
        }
        if !turned {
            break;
        }
    }
    (axes, [0, 1, 2].map(|k| m[k][k] / trace))
}

/// Turns axes of equal moments to where the normals of the surface lie: those of a box to its sides, those of a prism to its faces.
/// They stay where normals prefer no direction, as those of a ball or of a round bar.
fn settle_ties(axes: DMat3, moments: [f64; 3], mesh: &Mesh) -> DMat3 {
    let is_tied = |a: usize, b: usize| (moments[a] - moments[b]).abs() <= EQUAL;
    let single = match [is_tied(1, 2), is_tied(0, 2), is_tied(0, 1)] {
        [false, false, false] => return axes,
        [true, true, _] | [true, _, true] | [_, true, true] => None,
        [true, ..] => Some(0),
        [_, true, _] => Some(1),
        [.., true] => Some(2),
    };
    let normal = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        (b - a).cross(c - a)
    };
    let normals: Vec<DVec3> = mesh.triangles.iter().map(normal).collect();
    let axis = match single {
        Some(k) => Some(axes.col(k)),
        None => outstanding_direction(&normals),
    };
    axis.and_then(|axis| around_axis(axis, &normals)).unwrap_or(axes)
}

/// The direction that the surface's normals prefer or avoid most, by the sum of A (n·d)⁴; `None` where none stands out.
fn outstanding_direction(normals: &[DVec3]) -> Option<DVec3> {
    // The sum is a form of degree 4 in d; its 15 coefficients are summed once.
    let powers = |d: DVec3| {
        let (x, y, z) = (d.x, d.y, d.z);
        let (xx, yy, zz) = (x * x, y * y, z * z);
        [
            xx * xx,
            yy * yy,
            zz * zz,
            xx * x * y,
            xx * x * z,
            yy * y * x,
            yy * y * z,
            zz * z * x,
            zz * z * y,
            xx * yy,
            xx * zz,
            yy * zz,
            xx * y * z,
            yy * x * z,
            zz * x * y,
        ]
    };
    const TIMES: [f64; 15] = [1., 1., 1., 4., 4., 4., 4., 4., 4., 6., 6., 6., 12., 12., 12.];
    let mut form = [0.0f64; 15];
    let mut area = 0.0;
    for n in normals {
        let own = n.length();
        area += own;
        let each = powers(n.normalize_or_zero());
        form.iter_mut().zip(each).for_each(|(sum, p)| *sum += own * p);
    }
    let value = |d: DVec3| -> f64 {
        let terms = powers(d).into_iter().zip(TIMES).zip(&form);
        terms.map(|((p, times), sum)| p * times * sum).sum()
    };
    // Of directions without preference the mean is a fifth. A body with the symmetry of a cube differs most from it along the cube's
    // axes, be it above or below.
    let mean = 0.2 * area;
    let mut best = (0.0f64, None);
    for d in normals.iter().filter_map(|n| n.try_normalize()) {
        let own = value(d) - mean;
        if own.abs() > best.0.abs() {
            best = (own, Some(d));
        }
    }
    let mut axis = best.1.filter(|_| best.0.abs() > PREFERENCE * area)?;
    // The best normal of a round body lies beside the direction that stands out. The gradient of a convex form leads there: the
    // form is one, and so are 3 A |d|⁴ less the form.
    for _ in 0..CLIMBS {
        let along = gradient(&form, axis);
        let next = if best.0 > 0.0 {
            along
        } else {
            axis * (3.0 * area) - along
        };
        let next = next.normalize();
        let moved = next.distance(axis);
        axis = next;
        if moved < 1e-15 {
            break;
        }
    }
    Some(axis)
}

/// A quarter of the gradient of a form of degree 4, whose coefficients are those of the powers in [`outstanding_direction`].
fn gradient(form: &[f64; 15], d: DVec3) -> DVec3 {
    let (x, y, z) = (d.x, d.y, d.z);
    let [
        x4,
        y4,
        z4,
        x3y,
        x3z,
        y3x,
        y3z,
        z3x,
        z3y,
        xxyy,
        xxzz,
        yyzz,
        xxyz,
        yyxz,
        zzxy,
    ] = *form;
    let along_x = x4 * x * x * x
        + 3.0 * x * x * (x3y * y + x3z * z)
        + y3x * y * y * y
        + z3x * z * z * z
        + 3.0 * x * (xxyy * y * y + xxzz * z * z)
        + 6.0 * x * xxyz * y * z
        + 3.0 * y * z * (yyxz * y + zzxy * z);
    let along_y = y4 * y * y * y
        + 3.0 * y * y * (y3x * x + y3z * z)
        + x3y * x * x * x
        + z3y * z * z * z
        + 3.0 * y * (xxyy * x * x + yyzz * z * z)
        + 6.0 * y * yyxz * x * z
        + 3.0 * x * z * (xxyz * x + zzxy * z);
    let along_z = z4 * z * z * z
        + 3.0 * z * z * (z3x * x + z3y * y)
        + x3z * x * x * x
        + y3z * y * y * y
        + 3.0 * z * (xxzz * x * x + yyzz * y * y)
        + 6.0 * z * zzxy * x * y
        + 3.0 * x * y * (xxyz * x + yyxz * y);
    DVec3::new(along_x, along_y, along_z)
}

/// Axes with the given one among them, the others along or across normals: by the phase of the sum of A (n·(u + i v))^m, of
/// the first m for which there is one, 4 for boxes, 3 for three-sided prisms.
fn around_axis(axis: DVec3, normals: &[DVec3]) -> Option<DMat3> {
    let (u, v) = axis.any_orthonormal_pair();
    let area: f64 = normals.iter().map(|n| n.length()).sum();
    let phase = |m: i32| {
        let (mut real, mut imaginary) = (0.0, 0.0);
        for n in normals {
            let own = n.length();
            let [x, y] = [n.dot(u), n.dot(v)].map(|part| if own > 0.0 { part / own } else { 0.0 });
            let (mut power, mut other) = (1.0, 0.0);
            for _ in 0..m {
                (power, other) = (power * x - other * y, power * y + other * x);
            }
            real += own * power;
            imaginary += own * other;
        }
        let stands_out = libm::hypot(real, imaginary) > PREFERENCE * area;
        stands_out.then(|| libm::atan2(imaginary, real) / f64::from(m))
    };
    let angle = [4, 3, 5].into_iter().find_map(phase)?;
    let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
    Some(DMat3::from_cols(axis, u * cosine + v * sine, v * cosine - u * sine))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Weld;
    use pliant_asset::shapes::box_with_cells;

    fn axes_of(turn: DMat3, cells: [usize; 3]) -> DMat3 {
        let (positions, triangles) = box_with_cells(DVec3::new(1.0, 2.0, 5.0), cells);
        let positions: Vec<DVec3> = positions.iter().map(|p| turn * *p).collect();
        let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a box");
        PrincipalAxes::of_surface(&mesh).axes
    }

    #[test]
    fn axes_turn_with_the_surface_and_are_those_of_the_file_where_it_stands_along_them() {
        assert_eq!(axes_of(DMat3::IDENTITY, [3, 4, 5]), DMat3::IDENTITY);
        let turn = DMat3::from_rotation_z(0.4) * DMat3::from_rotation_x(0.7);
        for cells in [[3, 4, 5], [1, 7, 2]] {
            let axes = axes_of(turn, cells);
            // Each axis is one of the box's, whichever and from either end.
            let along = turn.transpose() * axes;
            for axis in [along.x_axis, along.y_axis, along.z_axis] {
                assert!((axis.abs().max_element() - 1.0).abs() < 1e-9, "{along}");
            }
        }
    }

    #[test]
    fn where_moments_are_equal_axes_are_those_of_the_sides() {
        let turn = DMat3::from_rotation_z(0.4) * DMat3::from_rotation_x(0.7);
        for size in [DVec3::ONE, DVec3::new(1.0, 1.0, 4.0)] {
            let (positions, triangles) = box_with_cells(size, [3, 4, 5]);
            let positions: Vec<DVec3> = positions.iter().map(|p| turn * *p).collect();
            let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a box");
            let along = turn.transpose() * PrincipalAxes::of_surface(&mesh).axes;
            for axis in [along.x_axis, along.y_axis, along.z_axis] {
                assert!((axis.abs().max_element() - 1.0).abs() < 1e-9, "{along}");
            }
        }
    }
}
