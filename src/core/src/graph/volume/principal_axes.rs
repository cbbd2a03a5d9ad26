//! The axes that a lattice stands along: those of the surface's own moments, so that a moved, turned or scaled mesh has the moved,
//! turned or scaled lattice.
//!
//! The grid is the same seen from either end of an axis and with its axes exchanged, so neither their order nor their signs
//! matter.

use crate::graph::mesh_graph::MeshGraph;
use crate::mesh::Mesh;
use glam::{DMat3, DVec3};

/// Moments closer than this to each other, in shares of their sum, are equal, and their plane keeps the axes that it has. Wider
/// than what single precision does to the moments of a symmetric body.
const EQUAL: f64 = 1e-6;
/// Products of inertia below this share of the moments are rounding.
const ROUNDING: f64 = 1e-13;
/// Jacobi's method needs about five rounds.
const ROUNDS: usize = 16;

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
        Self {
            axes: eigenvectors(moments),
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

/// The eigenvectors of a symmetric matrix, by Jacobi's rotations. Planes with equal moments, and axes that are eigenvectors
/// already, stay as they are.
fn eigenvectors(mut m: [[f64; 3]; 3]) -> DMat3 {
    let mut axes = DMat3::IDENTITY;
    let trace = m[0][0] + m[1][1] + m[2][2];
    if !(trace > 0.0 && trace.is_finite()) {
        return axes;
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
    axes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::shapes::box_with_cells;
    use crate::mesh::Weld;

    fn axes_of(turn: DMat3, cells: [u32; 3]) -> DMat3 {
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
    fn a_cube_keeps_the_axes_of_the_file() {
        let (positions, triangles) = box_with_cells(DVec3::ONE, [3; 3]);
        let turn = DMat3::from_rotation_z(0.4);
        let positions: Vec<DVec3> = positions.iter().map(|p| turn * *p).collect();
        let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a cube");
        assert_eq!(PrincipalAxes::of_surface(&mesh).axes, DMat3::IDENTITY);
    }
}
