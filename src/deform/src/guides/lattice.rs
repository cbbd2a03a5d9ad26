//! Vertices in a lattice of control points.

use super::pose::{GuideProblem, MOST_CONTROL_POINTS, finite};
use glam::{DMat3, DVec3};
use pliant_exec::Exec;

/// Vertices bound to a lattice.
#[derive(Debug, Clone)]
pub(super) struct LatticePlaces {
    counts: [usize; 3],
    /// The control points in the rest shape.
    rest: Vec<DVec3>,
    /// By vertex: its place in the lattice in cells along each edge; `None` outside of the box.
    cells: Vec<Option<DVec3>>,
}

/// The box reaches that far beyond its faces, in cells, so that what was drawn on them lies in it.
const MARGIN: f64 = 1e-6;

impl LatticePlaces {
    pub fn bind(origin: DVec3, edges: [DVec3; 3], counts: [u32; 3], rest: &[DVec3]) -> Self {
        let counts = counts.map(|count| count as usize);
        let most = DVec3::from_array(counts.map(|count| (count - 1) as f64));
        let inverse = DMat3::from_cols_array_2d(&edges.map(|edge| edge.to_array())).inverse();
        let cell = |p: &DVec3| {
            let cell = (inverse * (*p - origin)) * most;
            let is_within = cell.cmpge(DVec3::splat(-MARGIN)).all() && cell.cmple(most + MARGIN).all();
            is_within.then(|| cell.clamp(DVec3::ZERO, most))
        };
        Self {
            counts,
            rest: control_points(origin, edges, counts),
            cells: rest.iter().map(cell).collect(),
        }
    }

    pub fn controls(&self) -> usize {
        self.rest.len()
    }

    pub fn rest_places(&self, rest: &[DVec3]) -> Vec<Option<DVec3>> {
        let led = self.cells.iter().zip(rest);
        led.map(|(cell, place)| cell.is_some().then_some(*place)).collect()
    }

    pub fn places(&self, rest: &[DVec3], positions: &[DVec3], exec: &Exec<'_>) -> Vec<Option<DVec3>> {
        let moves: Vec<DVec3> = positions
            .iter()
            .zip(&self.rest)
            .map(|(now, rest)| *now - *rest)
            .collect();
        exec.pool.map(rest.len(), 1024, |v| {
            self.cells[v].map(|cell| rest[v] + self.blended(cell.to_array(), &moves))
        })
    }

    /// The blend of what control points have, by cubic B-splines along each edge: linear functions are kept.
    fn blended(&self, cell: [f64; 3], moves: &[DVec3]) -> DVec3 {
        let [x, y, z] = [0, 1, 2].map(|axis| spline_weights(cell[axis], self.counts[axis]));
        let mut sum = DVec3::ZERO;
        for (k, weight_z) in z {
            for (j, weight_y) in y {
                let row = (k * self.counts[1] + j) * self.counts[0];
                for (i, weight_x) in x {
                    sum += moves[row + i] * (weight_x * weight_y * weight_z);
                }
            }
        }
        sum
    }

    pub fn byte_size(&self) -> usize {
        size_of_val(&self.rest[..]) + size_of_val(&self.cells[..])
    }
}

fn control_points(origin: DVec3, edges: [DVec3; 3], counts: [usize; 3]) -> Vec<DVec3> {
    let share = |k: usize, axis: usize| k as f64 / (counts[axis] - 1) as f64;
    let numbers = (0..counts[2]).flat_map(|k| (0..counts[1]).flat_map(move |j| (0..counts[0]).map(move |i| [i, j, k])));
    let place =
        |[i, j, k]: [usize; 3]| origin + edges[0] * share(i, 0) + edges[1] * share(j, 1) + edges[2] * share(k, 2);
    numbers.map(place).collect()
}

/// The control points that count at a place along one edge, with their weights. Beyond the ends there are points on the straight line
/// through the last two, so that linear functions are kept up to the faces.
fn spline_weights(place: f64, count: usize) -> [(usize, f64); 4] {
    let cell = (place as usize).min(count - 2);
    let t = place - cell as f64;
    let s = 1.0 - t;
    let weights = [
        s * s * s / 6.0,
        (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0,
        (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0,
        t * t * t / 6.0,
    ];
    let mut at = [cell.wrapping_sub(1), cell, cell + 1, cell + 2].map(|k| (k, 0.0));
    for k in 0..4 {
        at[k].1 += weights[k];
    }
    if cell == 0 {
        // The point before the first is twice the first less the second.
        at[1].1 += 2.0 * weights[0];
        at[2].1 -= weights[0];
        at[0] = (0, 0.0);
    }
    if cell + 2 == count {
        at[2].1 += 2.0 * weights[3];
        at[1].1 -= weights[3];
        at[3] = (count - 1, 0.0);
    }
    at
}

pub(super) fn check(origin: DVec3, edges: &[DVec3; 3], counts: [u32; 3]) -> Result<(), GuideProblem> {
    finite(&[origin], "lattice.origin")?;
    finite(edges, "lattice.edges")?;
    if let Some(axis) = counts.iter().position(|count| *count < 2) {
        return Err(GuideProblem::new(
            format!("lattice.counts[{axis}]"),
            "is not at least 2",
        ));
    }
    let all = counts
        .iter()
        .try_fold(1usize, |all, count| all.checked_mul(*count as usize));
    if all.is_none_or(|all| all > MOST_CONTROL_POINTS) {
        let problem = format!("give more control points than {MOST_CONTROL_POINTS}");
        return Err(GuideProblem::new("lattice.counts", problem));
    }
    let unit = edges.map(DVec3::normalize_or_zero);
    match unit[0].cross(unit[1]).dot(unit[2]).abs() > 1e-6 {
        true => Ok(()),
        false => Err(GuideProblem::new("lattice.edges", "lie in one plane")),
    }
}
