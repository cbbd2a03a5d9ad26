//! Triangles sorted into the cells of a uniform grid.
//!
//! Where triangles are of about one size, a query that reaches about as far as they are long finds all it needs in a few
//! cells: no tree is walked, and the cells of a row stand next to each other in memory.
//!
//! Boxes sorted into the cells of a uniform grid.

use crate::measure::BoundingBox;
use crate::query::closest_point::closest_point_on_triangle;
use crate::query::closest_surface_point::{SegmentHit, corner_near, crossing};
use crate::query::visits::VisitCount;
use glam::{DVec3, Vec3A};
use pliant_exec::pool::Pool;
use rayon::prelude::*;
use std::ops::Range;

/// Cells and entries for each triangle, at most.
const LIMITS: GridLimits = GridLimits {
    cells: 16.0,
    entries: 8.0,
};
/// Triangles that share a cell with one of them on average, at most: beyond this the triangles are of too many sizes.
const CROWD: u64 = 64;
/// Sides of cells that a piece of a segment is long, at most.
const STRIDE: f64 = 2.0;

/// Triangles sorted into the cells of a uniform grid, which answers queries of short reach.
///
/// It is built in linear time and holds at most about 130 bytes per triangle.
///
/// ```
/// use glam::DVec3;
/// use pliant_mesh::query::TriangleCells;
/// use pliant_exec::pool::Pool;
///
/// let positions = [DVec3::ZERO, DVec3::X, DVec3::Y];
/// let triangles = [[0, 1, 2]];
/// let cells = TriangleCells::sort(&positions, &triangles, 1.0, &Pool::new(1)?).expect("one triangle fits");
/// assert!(cells.has_triangle_within(DVec3::new(0.2, 0.2, 0.5), 0.6));
/// assert!(!cells.has_triangle_within(DVec3::new(0.2, 0.2, 0.5), 0.4));
/// assert!(cells.is_crossed(DVec3::new(0.2, 0.2, 0.5), DVec3::new(0.2, 0.2, -0.5), None));
/// # Ok::<(), pliant_exec::pool::PoolError>(())
/// ```
#[derive(Debug)]
pub struct TriangleCells<'a> {
    positions: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    grid: BoxGrid,
    /// Side of a cell.
    side: f64,
}

impl<'a> TriangleCells<'a> {
    /// Sorts `triangles` into cells of about the given `side`, which is to be about what queries reach. `None` where the
    /// triangles are of too many sizes for one size of cells, or too many; then a tree is the better choice.
    ///
    /// # Panics
    /// When a triangle names a position that does not exist.
    pub fn sort(positions: &'a [DVec3], triangles: &'a [[u32; 3]], side: f64, pool: &Pool) -> Option<Self> {
        if !side.is_finite() {
            return None;
        }
        let grid = BoxGrid::of_triangles(positions, triangles, DVec3::splat(side), LIMITS, pool)?;
        let side = grid.longest_side();
        (grid.crowd() <= CROWD).then_some(Self {
            positions,
            triangles,
            grid,
            side,
        })
    }

    /// Lists the corners of all triangles, each once, so that vertices next to each other in the list are close in space.
    pub fn vertices_in_space_order(&self) -> Vec<u32> {
        let mut seen = vec![false; self.positions.len()];
        let corners = self.grid.numbers_in_order().flat_map(|t| self.triangles[t as usize]);
        corners
            .filter(|&v| !std::mem::replace(&mut seen[v as usize], true))
            .collect()
    }

    /// What long queries have looked at.
    pub(crate) fn visits(&self) -> u64 {
        self.grid.visits.total()
    }

    /// Side of a cell.
    pub fn side(&self) -> f64 {
        self.side
    }

    /// Returns whether any triangle is nearer than `radius`. The work grows with the cells that the ball overlaps.
    pub fn has_triangle_within(&self, point: DVec3, radius: f64) -> bool {
        let reach = DVec3::splat(radius);
        let square = radius * radius;
        self.grid.find_overlapping(point - reach, point + reach, |triangle| {
            closest_point_on_triangle(point, self.corners_of(triangle)).distance_squared(point) < square
        })
    }

    /// Returns whether the segment crosses or touches any triangle, but for those with the corner `except`.
    pub fn is_crossed(&self, from: DVec3, to: DVec3, except: Option<u32>) -> bool {
        let direction = to - from;
        self.find_along(from, to, |triangle, _| {
            let left_out = except.is_some_and(|v| self.triangles[triangle as usize].contains(&v));
            !left_out && crossing(from, direction, self.corners_of(triangle)).is_some()
        })
    }

    /// Finds the first triangle that the segment crosses or touches.
    pub fn first_hit(&self, from: DVec3, to: DVec3) -> Option<SegmentHit> {
        let direction = to - from;
        let mut best: Option<(f64, u32)> = None;
        let mut piece = 0.0;
        self.find_along(from, to, |triangle, until| {
            // A hit on the pieces before is nearer than all that is found on this one.
            if until > piece && best.is_some_and(|b| b.0 <= piece) {
                return true;
            }
            piece = until;
            if let Some(along) = crossing(from, direction, self.corners_of(triangle))
                && best.is_none_or(|b| (along, triangle) < b)
            {
                best = Some((along, triangle));
            }
            false
        });
        best.map(|(along, triangle)| {
            let point = from + direction * along;
            SegmentHit {
                along,
                point,
                triangle,
                vertex: corner_near(self.positions, self.triangles[triangle as usize], point),
            }
        })
    }

    fn corners_of(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|v| self.positions[v as usize])
    }

    /// Shows `is_found` the triangles near a segment, piece after piece, with how far along the piece ends.
    #[inline]
    fn find_along(&self, from: DVec3, to: DVec3, mut is_found: impl FnMut(u32, f64) -> bool) -> bool {
        let way = to - from;
        let pieces = (way.abs().max_element() / (STRIDE * self.side)).ceil().clamp(1.0, 1e6);
        // Rounding must not hide a crossing on a face of the box.
        let margin = DVec3::splat(from.abs().max(to.abs()).max_element() * 1e-14);
        let mut a = from;
        for piece in 1..=pieces as u32 {
            let until = f64::from(piece) / pieces;
            let b = if until < 1.0 { from + way * until } else { to };
            let (least, most) = (a.min(b) - margin, a.max(b) + margin);
            if self
                .grid
                .find_overlapping(least, most, |triangle| is_found(triangle, until))
            {
                return true;
            }
            a = b;
        }
        false
    }
}

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
    fn find_overlapping(&self, least: DVec3, most: DVec3, mut is_found: impl FnMut(u32) -> bool) -> bool {
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
        // Every cell's slot first counts its entries, then holds where the next one goes, which is in the end where
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::TriangleBvh;
    use crate::testing::scattered_triangles;

    fn confetti(count: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        scattered_triangles(count, DVec3::new(1.0, 2.0, 0.5), 7)
    }

    #[test]
    fn cells_answer_as_the_tree_does_whatever_their_size_and_the_number_of_threads() {
        let (points, faces) = confetti(600);
        let pool = Pool::new(3).expect("threads");
        let tree = TriangleBvh::build(&points, &faces, &pool);
        for side in [0.004, 0.05, 0.2, 0.35] {
            let cells = TriangleCells::sort(&points, &faces, side, &pool).expect("of one size");
            let alone = TriangleCells::sort(&points, &faces, side, &Pool::new(1).expect("a thread")).expect("as well");
            let mut order = cells.vertices_in_space_order();
            assert_eq!(order, alone.vertices_in_space_order());
            order.sort_unstable();
            assert!(order.into_iter().eq(0..points.len() as u32), "every vertex once");
            let mut seen = [0; 3];
            for k in 0..400 {
                let from = points[k * 37 % points.len()] * 1.2 - DVec3::splat(0.1);
                let to = from.lerp(points[k * 91 % points.len()], 0.3 * (k % 4) as f64);
                let radius = 0.01 * (k % 9) as f64;
                let within = tree.has_triangle_within(from, radius);
                assert_eq!(
                    cells.has_triangle_within(from, radius),
                    within,
                    "{radius} around {from}"
                );
                let first = tree.first_hit(from, to, None);
                assert_eq!(cells.first_hit(from, to), first, "from {from} to {to}");
                let except = first.map(|hit| hit.vertex);
                let crossed = tree.first_hit(from, to, except).is_some();
                assert_eq!(cells.is_crossed(from, to, except), crossed, "from {from} to {to}");
                [within, first.is_some(), crossed]
                    .iter()
                    .zip(&mut seen)
                    .for_each(|(&is, n)| *n += usize::from(is));
            }
            assert!(
                seen.iter().all(|n| (5..395).contains(n)),
                "answers of both kinds: {seen:?}"
            );
        }
    }

    #[test]
    fn triangles_of_too_many_sizes_are_left_to_a_tree() {
        let (mut points, mut faces) = confetti(3000);
        points.iter_mut().for_each(|p| *p *= 1e-4);
        faces.push([0, points.len() as u32, points.len() as u32 + 1]);
        points.extend([DVec3::X, DVec3::Y]);
        let pool = Pool::new(1).expect("a thread");
        assert!(TriangleCells::sort(&points, &faces, 0.01, &pool).is_none());
        assert!(TriangleCells::sort(&points, &faces, f64::NAN, &pool).is_none());
    }
}
