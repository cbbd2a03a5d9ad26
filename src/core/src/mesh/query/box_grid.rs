//! Boxes sorted into the cells of a uniform grid.

use crate::mesh::measure::BoundingBox;
use crate::mesh::query::visits::VisitCount;
use crate::pool::Pool;
use glam::{DVec3, Vec3A};
use rayon::prelude::*;
use std::ops::Range;

/// Marks of an entry: the cell is the box's first along x, y or z. The number of the box is below them.
const FIRST: [u32; 3] = [1 << 29, 1 << 30, 1 << 31];
const NUMBER: u32 = FIRST[0] - 1;
/// Cells along an axis, at most: single precision must resolve their numbers.
const LONGEST: f64 = 1e6;

/// Boxes sorted into cells, identified by number. Boxes and cells are in single precision, rounded so that nothing is
/// missed: what overlaps also overlaps here.
#[derive(Debug)]
pub(crate) struct BoxGrid {
    low: DVec3,
    /// Cells for each unit of length; 0 along axes with one cell.
    per_unit: Vec3A,
    /// Cells along each axis, and the last of them.
    count: [u32; 3],
    last: Vec3A,
    /// Where the entries of each cell begin, cells along x next to each other; one more than cells.
    starts: Vec<u32>,
    /// Numbers with their marks, cell after cell, rising within each.
    entries: Vec<u32>,
    /// The box of each number, from `low`.
    boxes: Vec<[Vec3A; 2]>,
    /// What long queries have looked at.
    pub(crate) visits: VisitCount,
}

/// How large a [`BoxGrid`] may become, for each box.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GridLimits {
    /// Cells; more would cost more to empty than they save.
    pub(crate) cells: f64,
    /// Entries of boxes in cells; larger cells have fewer.
    pub(crate) entries: f64,
}

impl BoxGrid {
    /// Sorts the boxes around `triangles` into cells of about the given `sides` (none along an axis where it is infinite),
    /// which are widened until the limits hold. `None` where there are too many triangles or no length is one.
    ///
    /// # Panics
    /// When a triangle names a position that does not exist.
    pub(crate) fn of_triangles(
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        sides: DVec3,
        limits: GridLimits,
        pool: &Pool,
    ) -> Option<Self> {
        let bounds = BoundingBox::of(positions);
        let size = bounds.size();
        let many = triangles.len() as f64;
        if triangles.len() > NUMBER as usize || !(sides.cmpgt(DVec3::ZERO).all() && size.is_finite()) {
            return None;
        }
        let low = bounds.min;
        let around = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| positions[v as usize] - low);
            rounded_outwards(a.min(b).min(c), a.max(b).max(c))
        };
        pool.install(|| {
            let mut grid = Self {
                low,
                per_unit: Vec3A::ZERO,
                count: [1; 3],
                last: Vec3A::ZERO,
                starts: Vec::new(),
                entries: Vec::new(),
                boxes: triangles.par_iter().with_min_len(1024).map(around).collect(),
                visits: VisitCount::default(),
            };
            let mut per_unit = sides.recip();
            let across = per_unit.cmpgt(DVec3::ZERO).bitmask().count_ones();
            loop {
                let along = (size * per_unit).floor() + DVec3::ONE;
                let (total, most) = (along.element_product(), limits.cells * many + 4096.0);
                if total > most || along.max_element() > LONGEST {
                    let factor = libm::pow(total / most, 1.0 / f64::from(across.max(1)));
                    per_unit /= factor.max(along.max_element() / LONGEST).max(1.05);
                    continue;
                }
                grid.per_unit = per_unit.as_vec3a();
                grid.last = (along - DVec3::ONE).as_vec3a();
                grid.count = along.to_array().map(|n| n as u32);
                let each = grid.boxes.par_iter().with_min_len(1024);
                let entries: u64 = each.map(|own| grid.cells_under(own)).sum();
                if entries as f64 <= limits.entries * many + 1024.0 || grid.count == [1; 3] {
                    break;
                }
                per_unit /= 1.5;
            }
            grid.fill_cells(pool.threads());
            Some(grid)
        })
    }

    /// How many boxes share a cell with a box on average, itself included.
    pub(crate) fn crowd(&self) -> u64 {
        let squares: u64 = self.starts.windows(2).map(|w| u64::from(w[1] - w[0]).pow(2)).sum();
        squares / (self.entries.len() as u64).max(1)
    }

    /// The longest side of a cell, of those that are limited.
    pub(crate) fn longest_side(&self) -> f64 {
        let least = self.per_unit.to_array().into_iter().filter(|&n| n > 0.0);
        1.0 / f64::from(least.fold(f32::INFINITY, f32::min))
    }

    /// All numbers, each once, so that those next to each other are close in space.
    pub(crate) fn numbers_in_order(&self) -> impl Iterator<Item = u32> {
        let all = FIRST[0] | FIRST[1] | FIRST[2];
        let once = self.entries.iter().filter(move |&&entry| entry & all == all);
        once.map(|&entry| entry & NUMBER)
    }

    /// A place in the coordinates of the boxes, to the nearest number.
    #[inline]
    pub(crate) fn place_of(&self, p: DVec3) -> Vec3A {
        (p - self.low).as_vec3a()
    }

    /// The numbers whose box contains the cell of a place, with their boxes.
    #[inline]
    pub(crate) fn numbers_around(&self, place: Vec3A) -> impl Iterator<Item = (u32, &[Vec3A; 2])> {
        let [x, y, z] = self.cell_of(place).map(|n| n as usize);
        let cell = (z * self.count[1] as usize + y) * self.count[0] as usize + x;
        let entries = &self.entries[self.starts[cell] as usize..self.starts[cell + 1] as usize];
        self.visits.add(entries.len() as u64 / 4);
        entries.iter().map(|&entry| {
            let number = entry & NUMBER;
            (number, &self.boxes[number as usize])
        })
    }

    /// Shows `is_found` each number whose box overlaps or touches the given one, once, until it says so.
    #[inline]
    pub(crate) fn find_overlapping(&self, least: DVec3, most: DVec3, mut is_found: impl FnMut(u32) -> bool) -> bool {
        let [low, high] = rounded_outwards(least - self.low, most - self.low);
        let (first, last) = (self.cell_of(low), self.cell_of(high));
        let mut visits = 0;
        let mut look = |entries: &[u32], marks: u32| {
            visits += entries.len() as u64;
            entries.iter().any(|&entry| {
                let number = entry & NUMBER;
                let [min, max] = self.boxes[number as usize];
                ((entry & marks == marks) & (min.cmple(high) & low.cmple(max)).all()) && is_found(number)
            })
        };
        let [nx, ny, _] = self.count.map(|n| n as usize);
        let found = 'search: {
            for z in first[2]..=last[2] {
                for y in first[1]..=last[1] {
                    let row = (z as usize * ny + y as usize) * nx;
                    // A box is looked at in the first of its cells here.
                    let marks = if z > first[2] { FIRST[2] } else { 0 } | if y > first[1] { FIRST[1] } else { 0 };
                    let start = |x: u32| self.starts[row + x as usize] as usize;
                    let (from, next, end) = (start(first[0]), start(first[0] + 1), start(last[0] + 1));
                    if look(&self.entries[from..next], marks) || look(&self.entries[next..end], marks | FIRST[0]) {
                        break 'search true;
                    }
                }
            }
            false
        };
        // An entry costs a quarter of what a node of a tree does.
        self.visits.add(visits / 4);
        found
    }

    /// The cell of a place; places beyond the box belong to the cells at its rim. Rises with each coordinate.
    #[inline]
    fn cell_of(&self, place: Vec3A) -> [u32; 3] {
        let at = (place * self.per_unit).min(self.last).max(Vec3A::ZERO);
        at.to_array().map(|n| n as u32)
    }

    fn cells_under(&self, [low, high]: &[Vec3A; 2]) -> u64 {
        let (first, last) = (self.cell_of(*low), self.cell_of(*high));
        (0..3).map(|axis| u64::from(last[axis] - first[axis] + 1)).product()
    }

    /// Counts and places the entries, each of so many slabs of rows on its own.
    fn fill_cells(&mut self, slabs: usize) {
        let [nx, ny, nz] = self.count.map(|n| n as usize);
        let slab = (ny * nz).div_ceil(slabs);
        let mut starts = vec![0; nx * ny * nz + 1];
        // Every cell's slot first counts its entries, then tells where the next one goes, which is in the end where
        // the entries of the next cell begin.
        let parts: Vec<Vec<u32>> = (starts[1..].par_chunks_mut(slab * nx).enumerate())
            .map(|(k, cells)| {
                let rows = k * slab..((k + 1) * slab).min(ny * nz);
                self.each_entry(&rows, |cell, _| cells[cell] += 1);
                let mut total = 0;
                for cell in cells.iter_mut() {
                    total += std::mem::replace(cell, total);
                }
                let mut entries = vec![0; total as usize];
                self.each_entry(&rows, |cell, entry| {
                    entries[cells[cell] as usize] = entry;
                    cells[cell] += 1;
                });
                entries
            })
            .collect();
        let mut before = 0u32;
        for (cells, entries) in starts[1..].chunks_mut(slab * nx).zip(&parts) {
            if before > 0 {
                let each = cells.par_iter_mut().with_min_len(1 << 14);
                each.for_each(|start| *start += before);
            }
            before += entries.len() as u32;
        }
        self.starts = starts;
        self.entries = match <[Vec<u32>; 1]>::try_from(parts) {
            Ok([all]) => all,
            Err(parts) => parts.concat(),
        };
    }

    /// Calls `put` with every cell in the given rows that a box overlaps, counted from the first of them, and the entry that
    /// stands there.
    #[inline]
    fn each_entry(&self, rows: &Range<usize>, mut put: impl FnMut(usize, u32)) {
        let [nx, ny, _] = self.count.map(|n| n as usize);
        let mark = |axis: usize, is_first: bool| if is_first { FIRST[axis] } else { 0 };
        for (number, [low, high]) in (0u32..).zip(&self.boxes) {
            let (first, last) = (self.cell_of(*low), self.cell_of(*high));
            for z in first[2]..=last[2] {
                for y in first[1]..=last[1] {
                    let row = z as usize * ny + y as usize;
                    if !rows.contains(&row) {
                        continue;
                    }
                    let entry = number | mark(2, z == first[2]) | mark(1, y == first[1]);
                    let cell = (row - rows.start) * nx;
                    put(cell + first[0] as usize, entry | FIRST[0]);
                    (first[0] + 1..=last[0]).for_each(|x| put(cell + x as usize, entry));
                }
            }
        }
    }
}

/// A box in single precision that contains it.
#[inline]
fn rounded_outwards(least: DVec3, most: DVec3) -> [Vec3A; 2] {
    let (low, high) = (least.as_vec3a(), most.as_vec3a());
    [
        Vec3A::new(low.x.next_down(), low.y.next_down(), low.z.next_down()),
        Vec3A::new(high.x.next_up(), high.y.next_up(), high.z.next_up()),
    ]
}
