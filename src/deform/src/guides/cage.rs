//! Vertices in a cage, by mean value coordinates.

use super::pose::{GuideProblem, finite};
use crate::error::Error;
use glam::DVec3;
use pliant_exec::Exec;

/// Vertices bound to a cage.
#[derive(Debug, Clone)]
pub(super) struct CageWeights {
    rest: Vec<DVec3>,
    /// By vertex a row with a weight for each vertex of the cage; a row's sum is 1.
    weights: Vec<f32>,
}

/// Weights at most: the vertices of the cage times those that it leads.
const MOST_WEIGHTS: usize = 1 << 26;

/// Vertices whose weights are found between two looks for a cancellation.
const BLOCK: usize = 4096;

impl CageWeights {
    pub fn bind(positions: &[DVec3], triangles: &[[u32; 3]], rest: &[DVec3], exec: &Exec<'_>) -> Result<Self, Error> {
        let mut weights = Vec::with_capacity(rest.len() * positions.len());
        for block in rest.chunks(BLOCK) {
            exec.check()?;
            let rows = exec
                .pool
                .map(block.len(), 16, |v| mean_value_weights(block[v], positions, triangles));
            rows.iter()
                .for_each(|row| weights.extend(row.iter().map(|w| *w as f32)));
        }
        Ok(Self {
            rest: positions.to_vec(),
            weights,
        })
    }

    pub fn controls(&self) -> usize {
        self.rest.len()
    }

    /// The weights blend how far the cage has moved, so that rounding them moves nothing where the cage stays.
    pub fn places(&self, rest: &[DVec3], positions: &[DVec3], exec: &Exec<'_>) -> Vec<Option<DVec3>> {
        let moves: Vec<DVec3> = positions
            .iter()
            .zip(&self.rest)
            .map(|(now, rest)| *now - *rest)
            .collect();
        let width = moves.len();
        exec.pool.map(rest.len(), 256, |v| {
            let row = self.weights[v * width..][..width].iter().zip(&moves);
            let moved = row.fold(DVec3::ZERO, |sum, (weight, m)| sum + *m * f64::from(*weight));
            Some(rest[v] + moved)
        })
    }

    pub fn byte_size(&self) -> usize {
        size_of_val(&self.rest[..]) + size_of_val(&self.weights[..])
    }
}

/// The mean value coordinates of a place, whose sum is 1.
fn mean_value_weights(place: DVec3, positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<f64> {
    let mut weights = vec![0.0; positions.len()];
    let ways: Vec<(DVec3, f64)> = (positions.iter())
        .map(|p| {
            let way = *p - place;
            let distance = way.length();
            (way / distance.max(f64::MIN_POSITIVE), distance)
        })
        .collect();
    let size = ways.iter().fold(0.0f64, |most, way| most.max(way.1));
    if let Some(k) = ways.iter().position(|way| way.1 <= 1e-12 * size) {
        weights[k] = 1.0;
        return weights;
    }
    for triangle in triangles {
        let corners = triangle.map(|v| ways[v as usize]);
        match triangle_weights(corners) {
            TriangleWeights::Within(within) => {
                weights.fill(0.0);
                (0..3).for_each(|k| weights[triangle[k] as usize] = within[k]);
                break;
            }
            TriangleWeights::Beside(beside) => (0..3).for_each(|k| weights[triangle[k] as usize] += beside[k]),
        }
    }
    let sum: f64 = weights.iter().sum();
    let size: f64 = weights.iter().map(|w| w.abs()).sum();
    if sum.abs() > 1e-9 * size && sum.is_finite() {
        weights.iter_mut().for_each(|w| *w /= sum);
        return weights;
    }
    // Far outside of a cage that folds back on itself they may cancel: the nearest vertex leads then.
    let nearest = (0..ways.len()).fold(0, |best, k| if ways[k].1 < ways[best].1 { k } else { best });
    weights.fill(0.0);
    weights[nearest] = 1.0;
    weights
}

/// What a triangle of the cage adds to the weights of its corners.
enum TriangleWeights {
    /// The place lies in the triangle: it alone counts.
    Within([f64; 3]),
    /// It lies elsewhere.
    Beside([f64; 3]),
}

/// For the directions and distances of a triangle's corners from a place (Ju, Schaefer and Warren 2005, figure 4).
fn triangle_weights(corners: [(DVec3, f64); 3]) -> TriangleWeights {
    let unit = corners.map(|corner| corner.0);
    let distance = corners.map(|corner| corner.1);
    let angle = [0, 1, 2].map(|k| {
        let chord = unit[(k + 1) % 3].distance(unit[(k + 2) % 3]);
        2.0 * libm::asin((0.5 * chord).min(1.0))
    });
    let half = 0.5 * (angle[0] + angle[1] + angle[2]);
    let sine = angle.map(libm::sin);
    if std::f64::consts::PI - half < 1e-9 {
        return TriangleWeights::Within([0, 1, 2].map(|k| sine[k] * distance[(k + 1) % 3] * distance[(k + 2) % 3]));
    }
    let cosine = [0, 1, 2].map(|k| {
        let across = sine[(k + 1) % 3] * sine[(k + 2) % 3];
        (2.0 * libm::sin(half) * libm::sin(half - angle[k]) / across - 1.0).clamp(-1.0, 1.0)
    });
    let side = unit[0].cross(unit[1]).dot(unit[2]);
    let dihedral = cosine.map(|c| (1.0 - c * c).sqrt().copysign(side));
    if side == 0.0 || dihedral.iter().any(|s| s.is_nan() || s.abs() <= 1e-9) {
        // In the plane of the triangle and beside it, the triangle is seen as a line.
        return TriangleWeights::Beside([0.0; 3]);
    }
    TriangleWeights::Beside([0, 1, 2].map(|k| {
        let (after, before) = ((k + 1) % 3, (k + 2) % 3);
        (angle[k] - cosine[after] * angle[before] - cosine[before] * angle[after])
            / (distance[k] * sine[after] * dihedral[before])
    }))
}

pub(super) fn check(positions: &[DVec3], triangles: &[[u32; 3]], vertices: usize) -> Result<(), GuideProblem> {
    if !(4..=1 << 16).contains(&positions.len()) {
        let problem = format!("has {} vertices; a cage has from 4 to 65536", positions.len());
        return Err(GuideProblem::new("cage.positions", problem));
    }
    if positions.len().saturating_mul(vertices) > MOST_WEIGHTS {
        let problem = format!(
            "has {} vertices that lead {vertices} of the model: their product is at most {MOST_WEIGHTS}",
            positions.len()
        );
        return Err(GuideProblem::new("cage.positions", problem));
    }
    finite(positions, "cage.positions")?;
    let mut edges = Vec::with_capacity(3 * triangles.len());
    for (k, triangle) in triangles.iter().enumerate() {
        if let Some(vertex) = triangle.iter().find(|v| **v as usize >= positions.len()) {
            let problem = format!("names vertex {vertex}, but the cage has {}", positions.len());
            return Err(GuideProblem::new(format!("cage.triangles[{k}]"), problem));
        }
        let [a, b, c] = *triangle;
        edges.extend([[a, b], [b, c], [c, a]]);
    }
    edges.sort_unstable();
    let is_closed = !edges.is_empty()
        && edges.windows(2).all(|pair| pair[0] != pair[1])
        && edges
            .iter()
            .all(|[a, b]| a != b && edges.binary_search(&[*b, *a]).is_ok());
    match is_closed {
        true => Ok(()),
        false => Err(GuideProblem::new(
            "cage.triangles",
            "are not a closed surface: each edge lies in two triangles, once in each direction",
        )),
    }
}
