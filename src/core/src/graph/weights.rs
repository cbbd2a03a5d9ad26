//! Weights of mesh edges.

use crate::mesh::Adjacency;
use glam::DVec3;

/// How much each edge of the mesh counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EdgeWeights {
    /// All the same, which the paper found sufficient (section 2.2).
    Uniform,
    /// Half the sum of the cotangents of the angles opposite to the edge, in terms of what it is among equilateral
    /// triangles, and at least 0.87. So the surface is as stiff whatever its triangles, and harmonic fields keep within their bounds.
    #[default]
    Cotangent,
    /// The same sum divided by its mean over the mesh, and limited to 0.001 … 1000: what sessions have that were stored before.
    CotangentOfMean,
}

/// Half the sum of the two cotangents of 60°, those of an edge between equilateral triangles.
const EQUILATERAL: f64 = 0.577_350_269_189_625_8;
/// The least weight, in terms of that. Edges opposite to obtuse angles would weigh little or less than nothing, and stretch most.
const LEAST: f64 = 0.87;
/// Cotangents beyond this, of angles under 0.6°, say nothing but that a face is thin.
const STEEPEST: f64 = 100.0;

/// What half sums of cotangents are multiplied by, and the least and the most that comes of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CotangentScale {
    factor: f64,
    limits: [f64; 2],
}

/// The cotangent weight of each edge of `adjacency`, with their scale; `None` where all weights are 1.
pub(super) fn cotangents(
    weights: EdgeWeights,
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    adjacency: &Adjacency,
) -> Option<(Vec<f32>, CotangentScale)> {
    let edges = adjacency.edges.iter();
    let half_sums = edges.map(|e| half_cotangent_sum(positions, triangles, adjacency, e.vertices));
    let half_sums: Vec<f64> = match weights {
        EdgeWeights::Uniform => return None,
        EdgeWeights::Cotangent | EdgeWeights::CotangentOfMean => half_sums.collect(),
    };
    let scale = if weights == EdgeWeights::Cotangent {
        CotangentScale {
            factor: 1.0 / EQUILATERAL,
            limits: [LEAST, f64::INFINITY],
        }
    } else {
        let mean = half_sums.iter().map(|w| w.max(0.0)).sum::<f64>() / half_sums.len().max(1) as f64;
        CotangentScale {
            // Only a mesh without any acute angle opposite to an edge has no positive mean, and then no cotangent helps.
            factor: if mean > 0.0 { 1.0 / mean } else { 0.0 },
            limits: [1e-3, 1e3],
        }
    };
    Some((half_sums.iter().map(|&sum| scale.weight_of(sum)).collect(), scale))
}

impl CotangentScale {
    fn weight_of(self, half_sum: f64) -> f32 {
        (half_sum * self.factor).clamp(self.limits[0], self.limits[1]) as f32
    }

    /// The weight of one edge, the smaller end first.
    pub(super) fn of_edge(
        self,
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        adjacency: &Adjacency,
        edge: [u32; 2],
    ) -> f32 {
        self.weight_of(half_cotangent_sum(positions, triangles, adjacency, edge))
    }
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
    fn cotangents_are_those_of_equilateral_triangles_or_0_87_of_them_at_least() {
        // An equilateral pair beside a very obtuse face.
        let h = 0.75f64.sqrt();
        let p = [[0., 0.], [1., 0.], [0.5, h], [1.5, h], [3., 0.001]].map(|[x, y]| DVec3::new(x, y, 0.0));
        let faces = [[0, 1, 2], [2, 1, 3], [1, 4, 3]];
        let adjacency = Adjacency::build(5, &faces);
        let (w, _) = cotangents(EdgeWeights::Cotangent, &p, &faces, &adjacency).expect("cotangents");
        let of = |a: u32, b: u32| {
            w[adjacency
                .edges
                .iter()
                .position(|e| e.vertices == [a, b])
                .expect("an edge")]
        };
        assert!((of(1, 2) - 1.0).abs() < 1e-6, "an edge between equal triangles");
        assert!((of(0, 1) - 0.87).abs() < 1e-6, "an open edge has one angle opposite");
        assert!(w.iter().all(|&w| (0.87..=174.0).contains(&w)));
    }
}
