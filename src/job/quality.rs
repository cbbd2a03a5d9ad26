//! How far a shape is from the rest shape, in numbers.

use super::pb;
use crate::mesh::{Mesh, signed_volume, surface_area};
use glam::{DMat2, DVec2, DVec3};

/// Compares a shape of the welded mesh with its rest shape.
///
/// A triangle counts as flipped when its normal opposes the rest normal turned by the mean rotation around it, which is
/// taken from its neighbours' normals: a fold shows, a part that was turned over as a whole does not.
pub(super) fn quality(mesh: &Mesh, closed: bool, deformed: &[DVec3]) -> pb::Quality {
    let rest = &mesh.positions;
    let mut squares = 0.0;
    let mut edges = 0u64;
    let mut max_stretch = 0.0f64;
    for t in &mesh.triangles {
        let p = t.map(|v| rest[v as usize]);
        let q = t.map(|v| deformed[v as usize]);
        for k in 0..3 {
            // An inner edge is met twice and a rim edge once; each pair of a closed mesh is counted from one side.
            let (a, b) = (k, (k + 1) % 3);
            let length = p[a].distance(p[b]);
            if length > 0.0 && (t[a] < t[b] || !closed) {
                let change = q[a].distance(q[b]) / length - 1.0;
                squares += change * change;
                edges += 1;
            }
        }
        if let Some(stretch) = largest_stretch(p, q) {
            max_stretch = max_stretch.max(stretch);
        }
    }
    let area = surface_area(rest, &mesh.triangles);
    let volume = if closed {
        signed_volume(rest, &mesh.triangles)
    } else {
        0.0
    };
    let change = |now: f64, before: f64| if before != 0.0 { now / before - 1.0 } else { 0.0 };
    pb::Quality {
        edge_rms: (squares / edges.max(1) as f64).sqrt(),
        volume_change: if volume == 0.0 {
            0.0
        } else {
            change(signed_volume(deformed, &mesh.triangles), volume)
        },
        area_change: change(surface_area(deformed, &mesh.triangles), area),
        flipped_triangles: flipped(mesh, deformed),
        max_stretch,
    }
}

/// The larger singular value of the map between two triangles; `None` for one without area at rest.
fn largest_stretch(p: [DVec3; 3], q: [DVec3; 3]) -> Option<f64> {
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

fn flipped(mesh: &Mesh, deformed: &[DVec3]) -> u32 {
    let normal = |positions: &[DVec3], t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        (b - a).cross(c - a)
    };
    // A rotation per vertex from the triangles around it, by their area-weighted gradients.
    let gradients = crate::mesh::shading::gradients(
        &mesh.positions,
        deformed,
        &mesh.triangles,
        &mesh.triangles,
        mesh.positions.len(),
    );
    mesh.triangles
        .iter()
        .filter(|t| {
            let (n, m) = (normal(&mesh.positions, t), normal(deformed, t));
            let Some(n) = n.try_normalize() else { return false };
            let carried: DVec3 = t
                .iter()
                .map(|v| match &gradients[*v as usize] {
                    Some(g) => crate::mesh::shading::carry_normal(g, n.as_vec3()).as_dvec3(),
                    None => n,
                })
                .sum();
            carried.dot(m) < 0.0
        })
        .count() as u32
}
