//! Weights of mesh edges.

use crate::mesh::Adjacency;
use glam::DVec3;

/// How much each edge of the mesh counts. Edges of the shell and the lattice always count 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EdgeWeights {
    /// All the same, which the paper found sufficient (section 2.2).
    #[default]
    Uniform,
    /// Half the sum of the cotangents of the angles opposite to the edge, divided by their mean over the mesh and
    /// limited to 0.001 … 1000, so that harmonic fields keep within their bounds.
    Cotangent,
}

/// Cotangents beyond this, of angles under 0.6°, say nothing but that a face is thin.
const STEEPEST: f64 = 100.0;

/// The cotangent weight of each edge of `adjacency`, and what their raw values were multiplied by.
pub(super) fn cotangents(positions: &[DVec3], triangles: &[[u32; 3]], adjacency: &Adjacency) -> (Vec<f32>, f64) {
    let edges = adjacency.edges.iter();
    let raw: Vec<f64> = edges
        .map(|e| half_cotangent_sum(positions, triangles, adjacency, e.vertices))
        .collect();
    let mean = raw.iter().map(|w| w.max(0.0)).sum::<f64>() / raw.len().max(1) as f64;
    // Only a mesh without any acute angle opposite to an edge has no positive mean, and then no cotangent helps.
    let scale = if mean > 0.0 { 1.0 / mean } else { 0.0 };
    (raw.iter().map(|&w| limited_weight(w, scale)).collect(), scale)
}

/// Half the sum of the cotangents of the angles opposite to the edge from `a` to `b`.
fn half_cotangent_sum(positions: &[DVec3], triangles: &[[u32; 3]], adjacency: &Adjacency, [a, b]: [u32; 2]) -> f64 {
    let opposite = adjacency.faces.of(a).iter().filter_map(|&f| {
        let t = triangles[f as usize];
        t.contains(&b)
            .then(|| t.into_iter().find(|&v| v != a && v != b))
            .flatten()
    });
    opposite
        .map(|c| 0.5 * cotangent([a, b, c].map(|v| positions[v as usize])))
        .sum()
}

fn limited_weight(raw: f64, scale: f64) -> f32 {
    (raw * scale).clamp(1e-3, 1e3) as f32
}

/// The weight of one edge, the smaller end first, where the others have been multiplied by `scale`.
pub(super) fn cotangent_of(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    adjacency: &Adjacency,
    edge: [u32; 2],
    scale: f64,
) -> f32 {
    limited_weight(half_cotangent_sum(positions, triangles, adjacency, edge), scale)
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
    fn cotangents_are_relative_symmetric_and_positive() {
        // An equilateral pair beside a very obtuse face.
        let h = 0.75f64.sqrt();
        let p = [[0., 0.], [1., 0.], [0.5, h], [1.5, h], [3., 0.001]].map(|[x, y]| DVec3::new(x, y, 0.0));
        let faces = [[0, 1, 2], [2, 1, 3], [1, 4, 3]];
        let adjacency = Adjacency::build(5, &faces);
        let (w, _) = cotangents(&p, &faces, &adjacency);
        let of = |a: u32, b: u32| {
            w[adjacency
                .edges
                .iter()
                .position(|e| e.vertices == [a, b])
                .expect("an edge")]
        };
        assert!(
            (of(1, 2) / of(0, 1) - 2.0).abs() < 1e-6,
            "an inner edge has two equal angles opposite"
        );
        assert!(w.iter().all(|&w| (1e-3..=1e3).contains(&w)));
    }
}
