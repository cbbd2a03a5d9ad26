//! The largest body of cells that hang together in a mesh, and how far they are from each other through it.

use crate::skin_weights::OccupiedCells;
use glam::{DMat3, DVec3};
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::graph::WindingTree;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Cells of the box around a mesh, about.
const CELLS: usize = 1 << 18;
/// Not reached.
pub(super) const FAR: u32 = u32::MAX;
/// Lengths of steps along one, two and three axes, in tenths of a cell.
const STEPS: [u32; 4] = [0, 10, 14, 17];

/// Cells of a cubic lattice inside a mesh.
pub(super) struct BodyLattice {
    /// Side of a cell.
    pub(super) side: f64,
    /// The middle of each cell.
    pub(super) places: Vec<DVec3>,
    low: DVec3,
    size: [usize; 3],
    /// By place in the box, the cell, or [`FAR`].
    cell: Vec<u32>,
}

impl BodyLattice {
    /// Finds the cells of a mesh, and keeps the largest part of them.
    pub(super) fn of_mesh(positions: &[DVec3], triangles: &[[u32; 3]], exec: &Exec<'_>) -> Result<Self, Cancelled> {
        let tree = (!triangles.is_empty()).then(|| WindingTree::build(positions, triangles, exec.pool));
        let cells = OccupiedCells::find(positions, tree.as_ref(), CELLS, exec)?;
        let whole = Self::around_places(cells.places, cells.side);
        let mut part = vec![FAR; whole.places.len()];
        let mut largest = (0, 0);
        for seed in 0..whole.places.len() {
            if part[seed] != FAR {
                continue;
            }
            let mut count = 0;
            let mut open = vec![seed];
            part[seed] = seed as u32;
            while let Some(at) = open.pop() {
                count += 1;
                for (next, _) in whole.cells_around(at) {
                    if part[next] == FAR {
                        part[next] = seed as u32;
                        open.push(next);
                    }
                }
            }
            if count > largest.0 {
                largest = (count, seed as u32);
            }
        }
        let kept = whole.places.iter().zip(&part).filter(|(_, p)| **p == largest.1);
        Ok(Self::around_places(kept.map(|(p, _)| *p).collect(), whole.side))
    }

    /// The same cells where a turn by quarters takes them.
    pub(super) fn turned(&self, turn: DMat3) -> Self {
        Self::around_places(self.places.iter().map(|p| turn * *p).collect(), self.side)
    }

    fn around_places(places: Vec<DVec3>, side: f64) -> Self {
        let low = places.iter().fold(DVec3::INFINITY, |a, p| a.min(*p));
        let high = places.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
        let size = ((high - low) / side).round().to_array().map(|n| n as usize + 1);
        let mut lattice = Self {
            side,
            low,
            size,
            cell: vec![FAR; size[0] * size[1] * size[2]],
            places,
        };
        for k in 0..lattice.places.len() {
            let at = lattice.coordinates(lattice.places[k]);
            let place = lattice.place_of(at);
            lattice.cell[place] = k as u32;
        }
        lattice
    }

    /// Which cell of the box a point is in, as steps from the lowest one.
    pub(super) fn coordinates(&self, p: DVec3) -> [usize; 3] {
        let at = ((p - self.low) / self.side).round().max(DVec3::ZERO);
        [0, 1, 2].map(|k| (at[k] as usize).min(self.size[k] - 1))
    }

    fn place_of(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.size[1] + y) * self.size[0] + x
    }

    /// Rows of cells from bottom to top.
    pub(super) fn height(&self) -> usize {
        self.size[1]
    }

    /// Columns of cells from right to left.
    pub(super) fn width(&self) -> usize {
        self.size[0]
    }

    /// x of a column.
    pub(super) fn x_of(&self, column: f64) -> f64 {
        self.low.x + column * self.side
    }

    /// The cells that touch one, and how long the steps to them are.
    pub(super) fn cells_around(&self, cell: usize) -> impl Iterator<Item = (usize, u32)> + '_ {
        let at = self.coordinates(self.places[cell]);
        (0..27).filter_map(move |k| {
            let shift = [k % 3, k / 3 % 3, k / 9];
            let mut to = [0; 3];
            for axis in 0..3 {
                to[axis] = (at[axis] + shift[axis])
                    .checked_sub(1)
                    .filter(|v| *v < self.size[axis])?;
            }
            let axes = shift.iter().filter(|s| **s != 1).count();
            let next = self.cell[self.place_of(to)];
            (axes > 0 && next != FAR).then_some((next as usize, STEPS[axes]))
        })
    }

    /// Whether a point is in a cell or beside one.
    pub(super) fn is_near(&self, p: DVec3) -> bool {
        let at = (p - self.low) / self.side;
        let [x, y, z] = at.round().to_array().map(|n| n as i64);
        let is_cell = |dx: i64, dy: i64, dz: i64| {
            let at = [x.saturating_add(dx), y.saturating_add(dy), z.saturating_add(dz)];
            self.cell_at(at).is_some()
        };
        (-1..=1).any(|dx| (-1..=1).any(|dy| (-1..=1).any(|dz| is_cell(dx, dy, dz))))
    }

    /// The cell at a place of the lattice.
    pub(super) fn cell_at(&self, at: [i64; 3]) -> Option<usize> {
        let mut to = [0; 3];
        for axis in 0..3 {
            to[axis] = usize::try_from(at[axis]).ok().filter(|v| *v < self.size[axis])?;
        }
        let cell = self.cell[self.place_of(to)];
        (cell != FAR).then_some(cell as usize)
    }

    /// How far each cell is from one of them, through those that are open, in tenths of a cell.
    pub(super) fn distances_from(&self, seed: usize, is_open: &[bool]) -> Vec<u32> {
        let mut far = vec![FAR; self.places.len()];
        let mut open = BinaryHeap::from([Reverse((0, seed))]);
        far[seed] = 0;
        while let Some(Reverse((distance, at))) = open.pop() {
            if distance > far[at] {
                continue;
            }
            for (next, step) in self.cells_around(at) {
                let there = distance + step;
                if is_open[next] && there < far[next] {
                    far[next] = there;
                    open.push(Reverse((there, next)));
                }
            }
        }
        far
    }

    /// The cell nearest to a point.
    pub(super) fn cell_near(&self, p: DVec3) -> usize {
        let ranked = self.places.iter().enumerate().map(|(k, q)| (q.distance_squared(p), k));
        ranked
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
            .map_or(0, |best| best.1)
    }
}
