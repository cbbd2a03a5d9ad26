//! The numbers that a picture shows as colours, one for each vertex.

use super::error::Error;
use crate::mesh::{Mesh, Weld};
use glam::DVec3;

/// The factor by which an edge is longer (or shorter) where [`edge_stretch`] is 1 (or -1).
pub const STRETCH_RANGE: f64 = 1.5;

/// Computes how much longer the edges around each vertex have become: the mean of the logarithms of length over rest length, to
/// the base [`STRETCH_RANGE`], each edge counting by its rest length. 0 = rest length, 1 = half as long again, -1 = two
/// thirds. 0 too for a vertex without edges.
///
/// # Errors
/// [`Error::Empty`] or [`Error::Surface`] when rest shape and triangles are not a surface, [`Error::Count`] when there
/// are more or fewer deformed positions than rest positions.
pub fn edge_stretch(rest: &[DVec3], deformed: &[DVec3], triangles: &[[u32; 3]]) -> Result<Vec<f64>, Error> {
    same_count(rest, deformed)?;
    // Seams are closed, so that both sides of one get the same number.
    let mesh = Mesh::build(rest, triangles, Weld::Exact)?;
    let now = |s: u32| mesh.render_vertices_of(s).first().map(|&v| deformed[v as usize]);
    let mut sums = vec![[0.0f64; 2]; mesh.positions.len()];
    let base = libm::log(STRETCH_RANGE);
    for t in &mesh.triangles {
        for k in 0..3 {
            let [a, b] = [t[k], t[(k + 1) % 3]];
            let length = mesh.positions[a as usize].distance(mesh.positions[b as usize]);
            let (Some(p), Some(q)) = (now(a), now(b)) else { continue };
            let factor = p.distance(q) / length;
            if !(length > 0.0 && factor.is_finite()) {
                continue;
            }
            // An edge that has vanished is far below any colour's end, and must not drown its neighbours.
            let log = libm::log(factor.clamp(1e-3, 1e3)) / base;
            for v in [a, b] {
                let [sum, weight] = &mut sums[v as usize];
                *sum += log * length;
                *weight += length;
            }
        }
    }
    let value = |s: u32| match sums.get(s as usize) {
        Some(&[sum, weight]) if weight > 0.0 => sum / weight,
        _ => 0.0,
    };
    Ok(mesh.solver_from_render.iter().map(|&s| value(s)).collect())
}

/// Computes how far each vertex has moved.
///
/// ```
/// use glam::DVec3;
/// use pliant_core::render::vertex_displacements;
///
/// let moved = vertex_displacements(&[DVec3::ZERO, DVec3::X], &[DVec3::ZERO, DVec3::X * 3.0])?;
/// assert_eq!(moved, [0.0, 2.0]);
/// # Ok::<(), pliant_core::render::Error>(())
/// ```
///
/// # Errors
/// [`Error::Count`] when the shapes have different numbers of vertices.
pub fn vertex_displacements(before: &[DVec3], after: &[DVec3]) -> Result<Vec<f64>, Error> {
    same_count(before, after)?;
    Ok(before.iter().zip(after).map(|(p, q)| p.distance(*q)).collect())
}

fn same_count(before: &[DVec3], after: &[DVec3]) -> Result<(), Error> {
    if before.len() == after.len() {
        return Ok(());
    }
    Err(Error::Count {
        what: "positions before",
        seen: before.len(),
        vertices: after.len(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretch_is_a_logarithm_and_seams_agree() {
        // A strip of two squares; the right one is twice as long afterwards. Vertices 1 and 4, 2 and 7 are seams.
        let p = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let rest = [
            p(0., 0.),
            p(1., 0.),
            p(1., 1.),
            p(0., 1.),
            p(1., 0.),
            p(2., 0.),
            p(2., 1.),
            p(1., 1.),
        ];
        let triangles = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let moved = rest.map(|q| if q.x > 1.0 { q + DVec3::X } else { q });
        let values = edge_stretch(&rest, &moved, &triangles).expect("a surface");
        assert_eq!(values[3], 0.0, "nothing around it has changed");
        assert!(values[5] > 0.5 && values[1] > 0.1 && values[1] < values[5]);
        assert_eq!((values[1], values[2]), (values[4], values[7]));
        let grown = rest.map(|q| q * STRETCH_RANGE);
        for value in edge_stretch(&rest, &grown, &triangles).expect("a surface") {
            assert!((value - 1.0).abs() < 1e-12);
        }
        let shrunk = rest.map(|q| q / STRETCH_RANGE);
        for value in edge_stretch(&rest, &shrunk, &triangles).expect("a surface") {
            assert!((value + 1.0).abs() < 1e-12);
        }
        let gone = [DVec3::ZERO; 8];
        assert!(
            edge_stretch(&rest, &gone, &triangles)
                .expect("a surface")
                .iter()
                .all(|v| v.is_finite() && *v < -1.0)
        );
    }

    #[test]
    fn counts_must_agree() {
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y];
        assert_eq!(
            vertex_displacements(&p, &p.map(|q| q + DVec3::Z * 2.0)),
            Ok(vec![2.0; 3])
        );
        for e in [
            vertex_displacements(&p, &p[..2]).expect_err("too few"),
            edge_stretch(&p, &p[..2], &[[0, 1, 2]]).expect_err("too few"),
        ] {
            assert!(e.to_string().contains('2') && e.to_string().contains('3'), "{e}");
        }
    }
}
