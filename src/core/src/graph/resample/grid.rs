//! Lattice nodes by their places, around an edit.

use crate::graph::recipe::InteriorRecipe;
use crate::graph::resample::zone::ChangeZone;
use crate::graph::volume::neighbours::{LAST, LatticeKey, key, place, toward};
use glam::DVec3;

/// A node that is left, or a new one.
pub(super) struct ZoneNode {
    /// As in [`NodeNumbers`].
    pub(super) number: u32,
    pub(super) at: DVec3,
    /// Its place in the grid, unless it was moved.
    pub(super) key: Option<LatticeKey>,
    /// No face is nearer.
    pub(super) clearance: f64,
    /// Whether its edges are found again.
    pub(super) again: bool,
}

/// The grid around a zone, with keys of its own.
pub(super) struct ZoneGrid {
    origin: DVec3,
    interval: f64,
    /// Coordinates of the place that would have the key (0, 0, 0).
    base: [i64; 3],
}

impl ZoneGrid {
    pub(super) fn around_zone(inside: &InteriorRecipe, zone: &ChangeZone) -> Self {
        Self {
            origin: inside.origin,
            interval: inside.interval,
            base: zone.first_cell().map(|c| c - 4),
        }
    }

    pub(super) fn position(&self, key: LatticeKey) -> DVec3 {
        let base = DVec3::from_array(self.base.map(|b| b as f64));
        // Whole and half numbers: the same bits as with the keys of the whole lattice.
        self.origin + (place(key) + base) * self.interval
    }

    pub(super) fn cell_key(&self, cell: [i64; 3], in_b: bool) -> Option<LatticeKey> {
        let mut at = [0u32; 3];
        for axis in 0..3 {
            let own = cell[axis] - self.base[axis];
            at[axis] = u32::try_from(own).ok().filter(|&c| (1..=LAST).contains(&c))?;
        }
        Some(key(at, in_b))
    }

    /// The key of the place nearest to `p` in grid A.
    pub(super) fn nearest_key(&self, p: DVec3) -> Option<LatticeKey> {
        let cell = ((p - self.origin) / self.interval).round().to_array();
        self.cell_key(cell.map(|c| c as i64), false)
    }

    /// The key of a node that is where the grid puts it.
    pub(super) fn key_at(&self, p: DVec3) -> Option<LatticeKey> {
        let unit = (p - self.origin) / self.interval;
        let found = [(0.0, false), (0.5, true)].map(|(shift, in_b)| {
            let cell = (unit - DVec3::splat(shift)).round().to_array();
            self.cell_key(cell.map(|c| c as i64), in_b)
                .filter(|&key| self.position(key) == p)
        });
        found[0].or(found[1])
    }
}

/// Nodes by place.
pub(super) struct NodeTable {
    /// Unmoved nodes by key.
    pub(super) fixed: Vec<(LatticeKey, u32)>,
    /// Moved nodes by the nearest place of grid A.
    pub(super) adrift: Vec<(LatticeKey, u32)>,
}

impl NodeTable {
    pub(super) fn fixed_node(&self, key: LatticeKey) -> Option<usize> {
        self.fixed
            .binary_search_by_key(&key, |f| f.0)
            .ok()
            .map(|at| self.fixed[at].1 as usize)
    }

    /// The nearest node within less than an interval of `p` among the moved ones, or among all.
    pub(super) fn nearest_node(
        &self,
        nodes: &[ZoneNode],
        grid: &ZoneGrid,
        p: DVec3,
        within: f64,
        all: bool,
    ) -> Option<usize> {
        if self.adrift.is_empty() && !all {
            return None;
        }
        let middle = grid.nearest_key(p)?;
        let mut best: Option<(f64, u32)> = None;
        let mut offer = |node: u32| {
            let found = (nodes[node as usize].at.distance_squared(p), node);
            if found.0 <= within * within && best.is_none_or(|b| found < b) {
                best = Some(found);
            }
        };
        let (low, one) = (
            toward(toward(toward(middle, 1), 3), 5),
            [toward(0, 0), toward(0, 2), toward(0, 4)],
        );
        for z in 0..3 {
            for y in 0..3 {
                let first = low + y * one[1] + z * one[2];
                let from = self.adrift.partition_point(|a| a.0 < first);
                let row = self.adrift[from..].iter().take_while(|a| a.0 < first + 3);
                row.for_each(|a| offer(a.1));
                for place in (0..3).map(|x| first + x).filter(|_| all) {
                    [place, toward(place, 13)]
                        .into_iter()
                        .filter_map(|k| self.fixed_node(k))
                        .for_each(|n| offer(n as u32));
                }
            }
        }
        best.map(|b| b.1 as usize)
    }
}
