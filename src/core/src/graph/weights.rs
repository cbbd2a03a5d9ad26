//! Weights of mesh edges.

use crate::mesh::Adjacency;
use glam::DVec3;

/// How much each edge of the mesh counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EdgeWeights {
    /// All the same, which the paper found sufficient (section 2.2).
    Uniform,
    /// Half the sum of the cotangents of the angles opposite to the edge, in terms of what it is among equilateral
    /// triangles, and at least 0.9. So the surface is as stiff whatever its triangles, and harmonic fields keep within their bounds.
    #[default]
    Cotangent,
}

/// Half the sum of the two cotangents of 60°, those of an edge between equilateral triangles.
const EQUILATERAL: f64 = 0.577_350_269_189_625_8;
/// The least weight, in terms of that. Edges opposite to obtuse angles would weigh little or less than nothing, and stretch most.
const LEAST: f64 = 0.9;
/// Cotangents beyond this, of angles under 0.6°, say nothing but that a face is thin.
const STEEPEST: f64 = 100.0;

/// The cotangent weight of each edge of `adjacency`.
pub(super) fn cotangents(positions: &[DVec3], triangles: &[[u32; 3]], adjacency: &Adjacency) -> Vec<f32> {
    let edges = adjacency.edges.iter();
    edges
        .map(|e| cotangent_of(positions, triangles, adjacency, e.vertices))
        .collect()
}

/// The cotangent weight of the edge from `a` to `b`.
pub(super) fn cotangent_of(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    adjacency: &Adjacency,
    [a, b]: [u32; 2],
) -> f32 {
    let opposite = adjacency.faces.of(a).iter().filter_map(|&f| {
        let t = triangles[f as usize];
        t.contains(&b)
            .then(|| t.into_iter().find(|&v| v != a && v != b))
            .flatten()
    });
    let half_sum: f64 = opposite
        .map(|c| 0.5 * cotangent([a, b, c].map(|v| positions[v as usize])))
        .sum();
    (half_sum / EQUILATERAL).max(LEAST) as f32
}

/// Cotangent of the angle at the last corner; 0 for a face without area.
fn cotangent([a, b, c]: [DVec3; 3]) -> f64 {
    let (u, v) = (a - c, b - c);
    let sine = u.cross(v).length();
    if sine > 0.0 {
        (u.dot(v) / sine).clamp(-STEEPEST, STEEPEST)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cotangents_are_those_of_equilateral_triangles_or_0_9_of_them_at_least() {
        // An equilateral pair beside a very obtuse face.
        let h = 0.75f64.sqrt();
        let p = [[0., 0.], [1., 0.], [0.5, h], [1.5, h], [3., 0.001]].map(|[x, y]| DVec3::new(x, y, 0.0));
        let faces = [[0, 1, 2], [2, 1, 3], [1, 4, 3]];
        let adjacency = Adjacency::build(5, &faces);
        let w = cotangents(&p, &faces, &adjacency);
        let of = |a: u32, b: u32| {
            w[adjacency
                .edges
                .iter()
                .position(|e| e.vertices == [a, b])
                .expect("an edge")]
        };
        assert!((of(1, 2) - 1.0).abs() < 1e-6, "an edge between equal triangles");
        assert!((of(0, 1) - 0.9).abs() < 1e-6, "an open edge has one angle opposite");
        assert!(w.iter().all(|&w| (0.9..=174.0).contains(&w)));
    }
}
