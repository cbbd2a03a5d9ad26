//! Lengths, areas and volumes. Sums run in the order of the input.
//!
//! How triangles are stretched and turned over by a deformation.

use super::shading::area_gradient;
use super::welded_mesh::Mesh;
use crate::mesh::adjacency::MeshEdge;
use glam::{DMat2, DMat3, DVec2, DVec3};
use rayon::prelude::*;

/// An axis-aligned box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundingBox {
    /// The corner with the smallest coordinates.
    pub min: DVec3,
    /// The corner with the largest coordinates.
    pub max: DVec3,
}

impl BoundingBox {
    /// The smallest box around `points`; the origin when there are none.
    pub fn of(points: &[DVec3]) -> Self {
        let Some(&first) = points.first() else {
            return Self {
                min: DVec3::ZERO,
                max: DVec3::ZERO,
            };
        };
        points.iter().fold(Self { min: first, max: first }, |b, &p| Self {
            min: b.min.min(p),
            max: b.max.max(p),
        })
    }

    /// Its middle.
    pub fn center(&self) -> DVec3 {
        self.min * 0.5 + self.max * 0.5
    }

    /// Its side lengths.
    pub fn size(&self) -> DVec3 {
        self.max - self.min
    }

    /// Length of its diagonal.
    pub fn diagonal(&self) -> f64 {
        self.size().length()
    }

    /// Whether it overlaps or touches another box.
    pub fn overlaps(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }
}

/// Area of all faces.
///
/// # Panics
/// When a triangle names a position that does not exist.
pub fn surface_area(positions: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
    triangles.iter().map(|&t| triangle_area(positions, t)).sum()
}

/// Area of one face.
pub(super) fn triangle_area(positions: &[DVec3], triangle: [u32; 3]) -> f64 {
    let [a, b, c] = triangle.map(|v| positions[v as usize]);
    0.5 * (b - a).cross(c - a).length()
}

/// Volume enclosed by a closed surface whose faces are wound counter-clockwise seen from outside; negative when they
/// are wound the other way. For a surface with holes it is the volume of the cones from the centre of its box.
///
/// # Panics
/// When a triangle names a position that does not exist.
pub fn signed_volume(positions: &[DVec3], triangles: &[[u32; 3]]) -> f64 {
    let origin = BoundingBox::of(positions).center();
    triangles.iter().map(|&t| cone_volume(positions, t, origin)).sum()
}

/// Signed volume of the tetrahedron between `origin` and one face.
pub(super) fn cone_volume(positions: &[DVec3], triangle: [u32; 3], origin: DVec3) -> f64 {
    let [a, b, c] = triangle.map(|v| positions[v as usize] - origin);
    a.dot(b.cross(c)) / 6.0
}

/// Mean length of `edges`, each counted once; 0 without edges.
///
/// # Panics
/// When an edge names a position that does not exist.
pub fn mean_edge_length(positions: &[DVec3], edges: &[MeshEdge]) -> f64 {
    let length = |e: &MeshEdge| positions[e.vertices[0] as usize].distance(positions[e.vertices[1] as usize]);
    let total: f64 = edges.iter().map(length).sum();
    if edges.is_empty() {
        0.0
    } else {
        total / edges.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::adjacency::Adjacency;

    #[test]
    fn a_corner_tetrahedron_has_the_textbook_measures_wherever_it_lies() {
        let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        for shift in [DVec3::ZERO, DVec3::new(1e6, -3e5, 2.0)] {
            let p: Vec<DVec3> = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z]
                .iter()
                .map(|&p| p + shift)
                .collect();
            assert!((signed_volume(&p, &faces) - 1.0 / 6.0).abs() < 1e-9);
            assert!((surface_area(&p, &faces) - (1.5 + 0.75f64.sqrt())).abs() < 1e-9);
            let inside_out = faces.map(|[a, b, c]| [a, c, b]);
            assert!((signed_volume(&p, &inside_out) + 1.0 / 6.0).abs() < 1e-9);
            let mean = mean_edge_length(&p, &Adjacency::build(4, &faces).edges);
            assert!((mean - (3.0 + 3.0 * 2f64.sqrt()) / 6.0).abs() < 1e-9);
            assert_eq!(BoundingBox::of(&p).size(), DVec3::ONE);
        }
    }

    #[test]
    fn nothing_has_no_size() {
        assert_eq!(
            (
                BoundingBox::of(&[]).diagonal(),
                mean_edge_length(&[], &[]),
                surface_area(&[], &[])
            ),
            (0.0, 0.0, 0.0)
        );
    }
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
