//! How long edges should be, from place to place.
//!
//! What a remesh aims for.

use crate::region_mesh::RegionMesh;
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// By how much the target length may change over a unit of distance.
const SLOPE: f64 = 0.5;

/// A chord of this length times the root of what is allowed over the curvature keeps within three quarters of it.
const CHORD: f64 = 6.0;

/// Shortens `wanted` lengths to chords that keep within `max_deviation` of a surface curved as `mesh` is, but not below
/// the shortest edges that are there: shorter ones would follow it no better. Edges with a smaller cosine than
/// `sharp_cosine` between their faces are no curvature.
///
/// The curvature at a point is what edges turn by, over the area around it and around its neighbours.
pub(super) fn shorten_for_curvature(mesh: &RegionMesh, wanted: &mut [f64], max_deviation: f64, sharp_cosine: f64) {
    let edges = mesh.edges();
    let mut shortest = vec![(0.0, 0.0); mesh.points.len()];
    let mut around = vec![(0.0, 0.0); mesh.points.len()];
    for f in mesh.living_faces() {
        let [a, b, c] = mesh.points_of(f);
        let area = 0.5 * mesh.area_normal(f).length();
        let least = (mesh.edge_length(a, b))
            .min(mesh.edge_length(b, c))
            .min(mesh.edge_length(c, a));
        for p in [a, b, c] {
            shortest[p as usize].0 += least;
            shortest[p as usize].1 += 1.0;
            around[p as usize].1 += area / 3.0;
        }
    }
    for &(a, b) in &edges {
        let edge = mesh.edge_faces(a, b);
        if edge.faces().count() != 2 {
            continue;
        }
        let [n, m] = [edge.left, edge.right].map(|f| mesh.area_normal(f).normalize_or_zero());
        if n.dot(m) >= sharp_cosine {
            let turned = 0.5 * n.distance(m) * mesh.edge_length(a, b);
            around[a as usize].0 += turned;
            around[b as usize].0 += turned;
        }
    }
    let mut wider = around.clone();
    for &(a, b) in &edges {
        for (p, q) in [(a as usize, b as usize), (b as usize, a as usize)] {
            wider[p].0 += around[q].0;
            wider[p].1 += around[q].1;
        }
    }
    for ((length, (turned, area)), (sum, count)) in wanted.iter_mut().zip(wider).zip(shortest) {
        let chord = (CHORD * max_deviation * area / turned).sqrt();
        if chord.is_finite() && count > 0.0 {
            *length = length.min(chord.max(sum / count));
        }
    }
}

/// Target lengths at the points of a mesh: `wanted` where nothing stands against it; at points that hold edges which
/// cannot change, the length of those; in between no steeper than [`SLOPE`].
pub(super) fn grade_lengths(mesh: &RegionMesh, wanted: &[f64]) -> Vec<f64> {
    let edges = mesh.edges();
    let mut held = vec![(0.0, 0u32); mesh.points.len()];
    let mut rows: Vec<Vec<(u32, f64)>> = vec![Vec::new(); mesh.points.len()];
    for &(a, b) in &edges {
        let length = mesh.edge_length(a, b);
        rows[a as usize].push((b, length));
        rows[b as usize].push((a, length));
        if mesh.is_locked(mesh.edge_faces(a, b)) {
            for p in [a, b] {
                held[p as usize].0 += length;
                held[p as usize].1 += 1;
            }
        }
    }
    let pinned: Vec<Option<f64>> = held
        .iter()
        .map(|&(sum, count)| (count > 0).then(|| sum / f64::from(count)))
        .collect();
    // No smaller than what held edges of a larger length nearby ask for: its negative, rising from them.
    let floor = limit_slope(&rows, pinned.iter().map(|p| p.map(|l| -l)).collect());
    let start = wanted.iter().zip(&pinned).zip(&floor).map(|((&w, pin), floor)| {
        let least = floor.map_or(0.0, |f| -f);
        Some(pin.unwrap_or(w.max(least)))
    });
    let ceiling = limit_slope(&rows, start.collect());
    ceiling.iter().zip(wanted).map(|(c, &w)| c.unwrap_or(w)).collect()
}

/// The least of all `values` after each has risen by [`SLOPE`] with the distance along edges. `None`: without a value.
fn limit_slope(rows: &[Vec<(u32, f64)>], mut values: Vec<Option<f64>>) -> Vec<Option<f64>> {
    // Order numbers of either sign by their bits.
    let key = |x: f64| {
        let bits = x.to_bits() as i64;
        bits ^ (((bits >> 63) as u64) >> 1) as i64
    };
    let mut queue: BinaryHeap<Reverse<(i64, u32)>> = (values.iter().zip(0u32..))
        .filter_map(|(v, p)| Some(Reverse((key((*v)?), p))))
        .collect();
    while let Some(Reverse((order, p))) = queue.pop() {
        let Some(value) = values[p as usize].filter(|&v| key(v) == order) else {
            continue;
        };
        for &(q, length) in &rows[p as usize] {
            let risen = value + SLOPE * length;
            if values[q as usize].is_none_or(|v| risen < v) {
                values[q as usize] = Some(risen);
                queue.push(Reverse((key(risen), q)));
            }
        }
    }
    values
}

/// How many triangles the region would have with these target lengths, at least.
pub(super) fn estimate_triangles(mesh: &RegionMesh, sizes: &[f64]) -> f64 {
    let equilateral = 3f64.sqrt() / 4.0;
    mesh.living_faces()
        .map(|f| {
            let area = 0.5 * mesh.area_normal(f).length();
            let size: f64 = mesh.points_of(f).iter().map(|&p| sizes[p as usize]).sum::<f64>() / 3.0;
            area / (equilateral * size * size)
        })
        .sum()
}

/// What a remesh aims for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RemeshTarget<'a> {
    /// Edges of this length everywhere.
    Length(f64),
    /// Only around faces with an edge longer than [`STRETCH`] times its rest length, or an aspect over [`ASPECT`]; there
    /// edges get their rest length.
    Auto {
        /// The rest shape: one position per render vertex.
        rest: &'a [DVec3],
    },
}

/// How a remesh goes about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RemeshOptions<'a> {
    /// What it aims for.
    pub target: RemeshTarget<'a>,
    /// How far the old and the new surface may be from each other, model units. `None`: [`DEVIATION`] of the diagonal of
    /// the surface's bounding box, or [`LENGTH_DEVIATION`] of the length that is aimed for where that is more.
    pub max_deviation: Option<f64>,
    /// An edge stays an edge when the normals of its faces differ by more, degrees.
    pub sharp_degrees: f64,
}

impl<'a> From<RemeshTarget<'a>> for RemeshOptions<'a> {
    fn from(target: RemeshTarget<'a>) -> Self {
        Self {
            target,
            max_deviation: None,
            sharp_degrees: SHARP_DEGREES,
        }
    }
}

/// The part of the diagonal by which surfaces may differ where nothing else is asked for.
pub const DEVIATION: f64 = 1.5e-3;

/// The part of the length aimed for by which surfaces may differ where nothing else is asked for.
pub const LENGTH_DEVIATION: f64 = 0.2;

/// Edges sharper than this stay edges where nothing else is asked for, degrees.
pub const SHARP_DEGREES: f64 = 40.0;

/// [`RemeshTarget::Auto`] remeshes where an edge is longer than this times its rest length.
pub const STRETCH: f64 = 1.5;

/// [`RemeshTarget::Auto`] remeshes where a face is further from equilateral than this: longest side times perimeter over
/// 4·√3 times the area, 1 at best.
pub const ASPECT: f64 = 4.0;

/// Faces are mended until none is worse than this, as far as boundaries and lines allow.
pub const MENDED: f64 = 4.0;

/// Most triangles that a remesh makes.
pub const MOST_TRIANGLES: u64 = 8 << 20;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_rise_with_distance_from_the_least_source_of_either_sign() {
        let rows: Vec<Vec<(u32, f64)>> = vec![
            vec![(1, 2.0)],
            vec![(0, 2.0), (2, 2.0)],
            vec![(1, 2.0), (3, 4.0)],
            vec![(2, 4.0)],
            vec![],
        ];
        let grown = limit_slope(&rows, vec![Some(1.0), None, Some(9.0), Some(1.5), None]);
        assert_eq!(grown, [Some(1.0), Some(2.0), Some(3.0), Some(1.5), None]);
        let grown = limit_slope(&rows, vec![Some(-4.0), None, None, Some(-4.5), None]);
        assert_eq!(grown, [Some(-4.0), Some(-3.0), Some(-2.5), Some(-4.5), None]);
    }
}
