//! Where an edit may change what is inside: a table of cells around the changed faces.
//!
//! Cells are those of the lattice, shifted by a quarter so that no node lies on a side; where the edit is spread so wide
//! that they would be too many, a cell is a block of them.

use crate::mesh::BoundingBox;
use crate::mesh::query::closest_point::closest_point_on_triangle;
use glam::DVec3;

/// A changed face passes through the cell, or it lies within what changed faces enclose.
pub(super) const CHANGED: u8 = 1;
/// Near enough to a changed cell that a place in it may have become inside or outside, deep or shallow.
pub(super) const NEAR: u8 = 2;
/// Near enough that edges of a node in it may have changed.
pub(super) const CORE: u8 = 4;
/// Near enough that what is decided in the core may depend on a face in it.
pub(super) const RIM: u8 = 8;

/// Most cells of a table.
const MOST: f64 = (1 << 22) as f64;

/// A box of cells with marks.
pub(super) struct ChangeZone {
    origin: DVec3,
    interval: f64,
    /// Lattice cells along a side of a cell, as a power of two.
    level: u32,
    /// The first cell along each axis.
    base: [i64; 3],
    count: [usize; 3],
    marks: Vec<u8>,
}

/// How far marks spread, in lengths.
pub(super) struct SpreadLengths {
    pub(super) near: f64,
    pub(super) core: f64,
    pub(super) rim: f64,
}

impl ChangeZone {
    /// Marks the cells that `faces` and `boxes` pass through. `None` without any, or where they are too far apart for
    /// lattice cells to be numbered.
    pub(super) fn around_changes(
        faces: &[[DVec3; 3]],
        boxes: &[BoundingBox],
        origin: DVec3,
        interval: f64,
        spread: &SpreadLengths,
    ) -> Option<Self> {
        let corners = faces.iter().flatten().copied();
        let all: Vec<DVec3> = corners.chain(boxes.iter().flat_map(|b| [b.min, b.max])).collect();
        if all.is_empty() {
            return None;
        }
        let bounds = BoundingBox::of(&all);
        let reach = spread.core + spread.rim;
        let mut zone = Self {
            origin,
            interval,
            level: 0,
            base: [0; 3],
            count: [0; 3],
            marks: Vec::new(),
        };
        for level in 0..40 {
            zone.level = level;
            let side = zone.cell_side();
            let margin = (reach / side).ceil() + 2.0;
            let low = zone.cell_coordinates(bounds.min) - DVec3::splat(margin);
            let high = zone.cell_coordinates(bounds.max) + DVec3::splat(margin);
            let extent = high.floor() - low.floor() + DVec3::ONE;
            let numbered = low.abs().max(high.abs()).max_element() < 1e15;
            let fits = (extent * 2f64.powi(level as i32)).max_element() < f64::from(1u32 << 19);
            if !numbered || !(level == 0 || fits) {
                return None;
            }
            if fits && extent.x * extent.y * extent.z <= MOST {
                zone.base = low.floor().to_array().map(|c| c as i64);
                zone.count = extent.to_array().map(|c| c as usize);
                break;
            }
        }
        zone.marks = vec![0; zone.count.iter().product()];
        if zone.marks.is_empty() {
            return None;
        }
        faces.iter().for_each(|&face| zone.mark_face(face));
        for b in boxes {
            zone.each_in(b, |marks, cell, _| marks[cell] |= CHANGED);
        }
        Some(zone)
    }

    /// Side of a cell.
    fn cell_side(&self) -> f64 {
        self.interval * 2f64.powi(self.level as i32)
    }

    /// A place in cells from the grid's origin.
    fn cell_coordinates(&self, p: DVec3) -> DVec3 {
        ((p - self.origin) / self.interval + DVec3::splat(0.25)) / 2f64.powi(self.level as i32)
    }

    /// The middle of a cell.
    fn cell_middle(&self, at: [usize; 3]) -> DVec3 {
        let unit = |axis: usize| (self.base[axis] + at[axis] as i64) as f64 + 0.5;
        let unit = DVec3::new(unit(0), unit(1), unit(2)) * 2f64.powi(self.level as i32) - DVec3::splat(0.25);
        self.origin + unit * self.interval
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.count[1] + y) * self.count[0] + x
    }

    fn cell_of_index(&self, index: usize) -> [usize; 3] {
        let [nx, ny, _] = self.count;
        [index % nx, index / nx % ny, index / nx / ny]
    }

    /// The box of all cells.
    pub(super) fn bounds(&self) -> BoundingBox {
        let half = DVec3::splat(0.5 * self.cell_side());
        let last = self.count.map(|c| c - 1);
        BoundingBox {
            min: self.cell_middle([0; 3]) - half,
            max: self.cell_middle(last) + half,
        }
    }

    /// The cells that a box passes through.
    fn each_in(&mut self, b: &BoundingBox, mut see: impl FnMut(&mut [u8], usize, [usize; 3])) {
        let (low, high) = (self.cell_coordinates(b.min), self.cell_coordinates(b.max));
        let cell = |unit: f64, axis: usize| {
            let at = unit.floor() - self.base[axis] as f64;
            (at.max(0.0) as usize).min(self.count[axis] - 1)
        };
        let [first, last] = [low, high].map(|u| [0, 1, 2].map(|axis| cell(u[axis], axis)));
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    let index = self.index([x, y, z]);
                    see(&mut self.marks, index, [x, y, z]);
                }
            }
        }
    }

    fn mark_face(&mut self, face: [DVec3; 3]) {
        let bounds = BoundingBox::of(&face);
        // A face much larger than a cell misses most cells of its box.
        if bounds.size().max_element() < 3.0 * self.cell_side() {
            self.each_in(&bounds, |marks, cell, _| marks[cell] |= CHANGED);
            return;
        }
        let reach = 0.87 * self.cell_side();
        let (origin, interval, base, scale) = (self.origin, self.interval, self.base, 2f64.powi(self.level as i32));
        self.each_in(&bounds, |marks, cell, at| {
            let unit: [f64; 3] = std::array::from_fn(|axis| (base[axis] + at[axis] as i64) as f64 + 0.5);
            let middle = origin + (DVec3::from_array(unit) * scale - DVec3::splat(0.25)) * interval;
            if closest_point_on_triangle(middle, face).distance_squared(middle) <= reach * reach {
                marks[cell] |= CHANGED;
            }
        });
    }

    /// The marks of a place; 0 beyond the table.
    pub(super) fn marks_at(&self, p: DVec3) -> u8 {
        let unit = self.cell_coordinates(p);
        let mut at = [0usize; 3];
        for axis in 0..3 {
            let cell = unit[axis].floor() - self.base[axis] as f64;
            if !(cell >= 0.0 && cell < self.count[axis] as f64) {
                return 0;
            }
            at[axis] = cell as usize;
        }
        self.marks[self.index(at)]
    }

    /// Whether any cell that a box passes through has the mark.
    pub(super) fn box_has_mark(&self, b: &BoundingBox, mark: u8) -> bool {
        let (low, high) = (self.cell_coordinates(b.min), self.cell_coordinates(b.max));
        let mut ranges = [[0usize; 2]; 3];
        for axis in 0..3 {
            let first = (low[axis].floor() - self.base[axis] as f64).max(0.0);
            let last = (high[axis].floor() - self.base[axis] as f64).min(self.count[axis] as f64 - 1.0);
            if first > last || first.is_nan() || last.is_nan() {
                return false;
            }
            ranges[axis] = [first as usize, last as usize];
        }
        let [x, y, z] = ranges;
        // A box of very many cells is taken for one that meets some.
        if ranges.iter().map(|r| r[1] - r[0] + 1).product::<usize>() > 4096 {
            return true;
        }
        (z[0]..=z[1]).any(|z| {
            (y[0]..=y[1]).any(|y| {
                let row = self.index([x[0], y, z]);
                self.marks[row..=row + (x[1] - x[0])].iter().any(|m| m & mark != 0)
            })
        })
    }

    /// Marks what changed cells enclose, as far as `enclosed` says so of a place in it, and then spreads all marks.
    pub(super) fn mark_enclosed(&mut self, spread: &SpreadLengths, enclosed: impl Fn(DVec3) -> bool) {
        let mut seen: Vec<bool> = self.marks.iter().map(|m| m & CHANGED != 0).collect();
        let mut pocket: Vec<usize> = Vec::new();
        for first in 0..self.marks.len() {
            if seen[first] {
                continue;
            }
            pocket.clear();
            pocket.push(first);
            seen[first] = true;
            let mut next = 0;
            while let Some(&here) = pocket.get(next) {
                next += 1;
                let at = self.cell_of_index(here);
                for axis in 0..3 {
                    for forward in [false, true] {
                        let mut to = at;
                        if forward {
                            to[axis] += 1;
                        } else if to[axis] > 0 {
                            to[axis] -= 1;
                        } else {
                            continue;
                        }
                        if to[axis] == self.count[axis] {
                            continue;
                        }
                        let there = self.index(to);
                        if !std::mem::replace(&mut seen[there], true) {
                            pocket.push(there);
                        }
                    }
                }
            }
            // The first pocket is the one that reaches the rim of the table; nothing is enclosed there.
            if first > 0 && enclosed(self.cell_middle(self.cell_of_index(first))) {
                pocket.iter().for_each(|&cell| self.marks[cell] |= CHANGED);
            }
        }
        let steps = |length: f64| (length / self.cell_side()).ceil().max(1.0) as usize;
        let [near, core, rim] = [spread.near, spread.core, spread.rim].map(steps);
        self.spread_mark(CHANGED, NEAR, near);
        self.spread_mark(CHANGED, CORE, core);
        self.spread_mark(CORE, RIM, rim);
    }

    /// Gives the mark `to` to all cells no more than `steps` away, along each axis, from one with the mark `from`.
    fn spread_mark(&mut self, from: u8, to: u8, steps: usize) {
        self.marks.iter_mut().filter(|m| **m & from != 0).for_each(|m| *m |= to);
        let stride = [1, self.count[0], self.count[0] * self.count[1]];
        let mut line: Vec<bool> = Vec::new();
        for axis in 0..3 {
            let (along, step) = (self.count[axis], stride[axis]);
            for first in 0..self.marks.len() {
                if !(first / step).is_multiple_of(along) {
                    continue;
                }
                line.clear();
                line.extend((0..along).map(|k| self.marks[first + k * step] & to != 0));
                if !line.contains(&true) {
                    continue;
                }
                // Distance to the last marked cell, there and back.
                for back in [false, true] {
                    let mut left = 0usize;
                    for k in 0..along {
                        let k = if back { along - 1 - k } else { k };
                        if line[k] {
                            left = steps + 1;
                        }
                        if left > 0 {
                            self.marks[first + k * step] |= to;
                            left -= 1;
                        }
                    }
                }
            }
        }
    }

    /// How many lattice cells lie within all cells with the mark.
    pub(super) fn lattice_count(&self, mark: u8) -> usize {
        let cells = self.marks.iter().filter(|m| **m & mark != 0).count();
        cells.saturating_mul(1usize.checked_shl(3 * self.level).unwrap_or(usize::MAX))
    }

    /// The lattice cells within all cells with the mark, as coordinates from the grid's origin, in rising order.
    pub(super) fn lattice_cells(&self, mark: u8) -> Vec<[i64; 3]> {
        let side = 1i64 << self.level;
        let mut found = Vec::new();
        for (index, _) in self.marks.iter().enumerate().filter(|(_, m)| **m & mark != 0) {
            let at = self.cell_of_index(index);
            let first: [i64; 3] = std::array::from_fn(|axis| (self.base[axis] + at[axis] as i64) * side);
            for z in 0..side {
                for y in 0..side {
                    found.extend((0..side).map(|x| [first[0] + x, first[1] + y, first[2] + z]));
                }
            }
        }
        found
    }

    /// The first lattice cell along each axis.
    pub(super) fn first_cell(&self) -> [i64; 3] {
        self.base.map(|b| b << self.level)
    }
}
