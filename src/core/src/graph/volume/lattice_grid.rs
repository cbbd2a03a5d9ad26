//! The body-centred cubic grid that lattice nodes lie on.

use crate::graph::volume::neighbours::{LAST, LatticeKey, place};
use crate::mesh::BoundingBox;
use glam::DVec3;

/// Two balls without triangles join when they overlap; balls that touch at the surface from both sides must not be
/// taken to overlap for a rounding error.
pub(in crate::graph) const CERTAIN: f64 = 1.0 - 1e-9;

/// A body-centred cubic grid around a box.
#[derive(Debug, Clone, Copy)]
pub(in crate::graph) struct LatticeGrid {
    /// Place of A's node (0, 0, 0); nodes are numbered from 1.
    pub(in crate::graph) origin: DVec3,
    /// Side of a cell.
    pub(in crate::graph) interval: f64,
    /// Cells along each axis.
    pub(in crate::graph) cells: [u32; 3],
}

impl LatticeGrid {
    /// A grid with one of its nodes in the middle of `bounds`, so that a symmetric shape gets a symmetric lattice.
    /// `None` when it would have more cells along an axis than can be numbered.
    pub(in crate::graph) fn around(bounds: &BoundingBox, interval: f64) -> Option<Self> {
        let half = (bounds.size() * 0.5 / interval).ceil();
        if !half.is_finite() || half.max_element() >= f64::from(LAST / 2 - 2) {
            return None;
        }
        let cells = half.to_array().map(|h| 2 * h as u32 + 1);
        let origin = bounds.center() - (half + DVec3::ONE) * interval;
        Some(Self {
            origin,
            interval,
            cells,
        })
    }

    pub(in crate::graph) fn position(&self, key: LatticeKey) -> DVec3 {
        self.origin + place(key) * self.interval
    }
}

/// Nodes found inside, in rising order of their keys.
#[derive(Debug, Default)]
pub(in crate::graph) struct LatticeNodes {
    pub(in crate::graph) keys: Vec<LatticeKey>,
    /// For each node a length: no triangle is nearer.
    pub(in crate::graph) clearance: Vec<f64>,
    /// Nodes of the grid that were left out because they are too near to the surface, as far as they are known.
    pub(in crate::graph) shallow: ShallowNodes,
}

/// Nodes inside but near to the surface, in rising order of their keys.
#[derive(Debug, Default)]
pub(in crate::graph) struct ShallowNodes {
    pub(in crate::graph) keys: Vec<LatticeKey>,
    /// The squared distance of the nearest triangle.
    pub(in crate::graph) squares: Vec<f64>,
    /// That triangle; of equally near ones the smallest.
    pub(in crate::graph) triangles: Vec<u32>,
}

impl ShallowNodes {
    /// Takes over the nodes of another, whose keys are all larger.
    pub(in crate::graph) fn append_all(&mut self, mut other: Self) {
        self.keys.append(&mut other.keys);
        self.squares.append(&mut other.squares);
        self.triangles.append(&mut other.triangles);
    }

    /// Finds the node with a key. `hint` is where the search begins, and is left where it ends: searching for keys that
    /// rise takes few steps each.
    pub(in crate::graph) fn find_key(&self, wanted: LatticeKey, hint: &mut usize) -> Option<usize> {
        let keys = &self.keys;
        let mut low = if keys.get(*hint).is_some_and(|&k| k <= wanted) {
            *hint
        } else {
            0
        };
        let mut step = 1;
        while keys.get(low + step).is_some_and(|&k| k <= wanted) {
            low += step;
            step *= 2;
        }
        let end = (low + step).min(keys.len());
        let at = low + keys[low.min(end)..end].partition_point(|&k| k < wanted);
        *hint = at;
        (keys.get(at) == Some(&wanted)).then_some(at)
    }
}

/// More blocks or nodes than allowed; the interval must grow.
pub(in crate::graph) struct TooFine {
    /// By at least about this factor.
    pub(in crate::graph) factor: f64,
}

impl TooFine {
    pub(in crate::graph) fn by(factor: f64) -> Self {
        Self {
            factor: factor.max(1.05),
        }
    }
}
