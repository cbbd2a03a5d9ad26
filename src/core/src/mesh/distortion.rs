//! How triangles are stretched and turned over by a deformation.

use super::shading::area_gradient;
use super::welded_mesh::Mesh;
use glam::{DMat2, DMat3, DVec2, DVec3};
use rayon::prelude::*;

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
