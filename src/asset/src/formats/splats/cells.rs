//! A grid of cells that are full or empty, and the surface between the two.

use crate::Error;
use crate::files::ReadWatch;
use glam::DVec3;

/// Cells that a grid has at most: a wider grid is taken before it has more.
const MOST_CELLS: f64 = (1u64 << 23) as f64;
/// Empty cells around what is full on each side: one to dilate into, one to walk around it, one for what is filled in.
const MARGIN: f64 = 3.0;
/// Parts of fewer cells than this share of all are strays.
const STRAY_SHARE: f64 = 0.01;
/// Rounds of filling what touches along an edge or in a corner alone.
const ROUNDS: usize = 64;
/// Bytes that a cell takes beside others at most: twice its state, its part, and its corner.
const BYTES_PER_CELL: f64 = 12.0;

/// The grid. Cells are numbered along x first.
#[derive(Debug)]
pub(super) struct CellGrid {
    origin: DVec3,
    /// Length of a cell's edges.
    pub step: f64,
    size: [usize; 3],
    full: Vec<bool>,
}

impl CellGrid {
    /// An empty grid over a box, with cells of that size, or wider ones where there would be too many.
    ///
    /// # Errors
    /// [`Error::TooLarge`] where it may not be held, [`Error::Cancelled`].
    pub fn over(min: DVec3, max: DVec3, step: f64, watch: &ReadWatch<'_>) -> Result<Self, Error> {
        watch.check()?;
        let extent = max - min;
        let mut step = step;
        let cells = |step: f64| (extent / step).ceil() + DVec3::splat(2.0 * MARGIN);
        while cells(step).element_product() > MOST_CELLS {
            step *= 1.05;
        }
        let cells = cells(step);
        let bytes = (cells.element_product() * BYTES_PER_CELL) as u64;
        // Given back at once: the grid is gone before the model is whole.
        watch.reserve(bytes)?;
        watch.release(bytes);
        let size = [cells.x as usize, cells.y as usize, cells.z as usize];
        Ok(Self {
            origin: min - DVec3::splat(MARGIN * step),
            step,
            full: vec![false; size.iter().product()],
            size,
        })
    }

    /// The cell that holds a place, which may be none in the margin.
    pub fn cell_at(&self, place: DVec3) -> Option<usize> {
        let at = (place - self.origin) / self.step;
        let inside = |axis: usize| at[axis] >= MARGIN && at[axis] < self.size[axis] as f64 - MARGIN;
        (inside(0) && inside(1) && inside(2)).then(|| self.number([at.x as usize, at.y as usize, at.z as usize]))
    }

    fn number(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.size[1] + y) * self.size[0] + x
    }

    fn place(&self, cell: usize) -> [usize; 3] {
        let [w, h, _] = self.size;
        [cell % w, cell / w % h, cell / (w * h)]
    }

    /// Steps in numbers along the axes.
    fn strides(&self) -> [usize; 3] {
        [1, self.size[0], self.size[0] * self.size[1]]
    }

    /// Fills a cell.
    pub fn fill(&mut self, cell: usize) {
        self.full[cell] = true;
    }

    /// Fills the cells within `reach` of a place whose middle is `inside`; those of the margin stay empty.
    pub fn fill_within(&mut self, center: DVec3, reach: DVec3, inside: impl Fn(DVec3) -> bool) {
        let range = |axis: usize| {
            let at = |offset: f64| (center[axis] + offset - self.origin[axis]) / self.step;
            let (least, most) = (MARGIN - 1.0, self.size[axis] as f64 - MARGIN);
            at(-reach[axis]).clamp(least, most) as usize..=at(reach[axis]).clamp(least, most) as usize
        };
        let [xs, ys, zs] = [range(0), range(1), range(2)];
        for z in zs {
            for y in ys.clone() {
                for x in xs.clone() {
                    let middle = self.origin + (DVec3::new(x as f64, y as f64, z as f64) + 0.5) * self.step;
                    if inside(middle) {
                        let cell = self.number([x, y, z]);
                        self.full[cell] = true;
                    }
                }
            }
        }
    }

    /// Fills what is enclosed, drops strays, and makes the surface a manifold.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn make_solid(&mut self, watch: &ReadWatch<'_>) -> Result<(), Error> {
        watch.check()?;
        self.fill_enclosed();
        watch.check()?;
        self.drop_strays();
        for _ in 0..ROUNDS {
            watch.check()?;
            if !self.join_touching() {
                break;
            }
        }
        Ok(())
    }

    /// Fills what cannot be reached from outside through gaps wider than two cells.
    fn fill_enclosed(&mut self) {
        let wall = self.dilated(&self.full);
        let mut outside = vec![false; self.full.len()];
        let mut waiting = vec![0];
        outside[0] = true;
        while let Some(cell) = waiting.pop() {
            for next in self.neighbours(cell) {
                if !outside[next] && !wall[next] {
                    outside[next] = true;
                    waiting.push(next);
                }
            }
        }
        let reached = self.dilated(&outside);
        for (full, reached) in self.full.iter_mut().zip(reached) {
            *full |= !reached;
        }
    }

    /// The cells that are marked or have a marked neighbour.
    fn dilated(&self, marked: &[bool]) -> Vec<bool> {
        let mut wide = marked.to_vec();
        for (cell, _) in marked.iter().enumerate().filter(|(_, marked)| **marked) {
            for next in self.neighbours(cell) {
                wide[next] = true;
            }
        }
        wide
    }

    fn neighbours(&self, cell: usize) -> impl Iterator<Item = usize> + use<> {
        let (at, size, strides) = (self.place(cell), self.size, self.strides());
        (0..3).flat_map(move |axis| {
            let below = (at[axis] > 0).then(|| cell - strides[axis]);
            let above = (at[axis] + 1 < size[axis]).then(|| cell + strides[axis]);
            below.into_iter().chain(above)
        })
    }

    /// Empties parts that are small beside all.
    fn drop_strays(&mut self) {
        let mut part_of = vec![u32::MAX; self.full.len()];
        let mut sizes: Vec<usize> = Vec::new();
        let mut waiting = Vec::new();
        for first in 0..self.full.len() {
            if !self.full[first] || part_of[first] != u32::MAX {
                continue;
            }
            let part = sizes.len() as u32;
            let mut count = 0;
            part_of[first] = part;
            waiting.push(first);
            while let Some(cell) = waiting.pop() {
                count += 1;
                for next in self.neighbours(cell) {
                    if self.full[next] && part_of[next] == u32::MAX {
                        part_of[next] = part;
                        waiting.push(next);
                    }
                }
            }
            sizes.push(count);
        }
        let least = STRAY_SHARE * sizes.iter().sum::<usize>() as f64;
        for (full, part) in self.full.iter_mut().zip(part_of) {
            *full = *full && sizes[part as usize] as f64 >= least;
        }
    }

    /// Fills a cell wherever full ones, or empty ones, touch along an edge or in a corner alone. Answers whether there were any.
    fn join_touching(&mut self) -> bool {
        let [sx, sy, sz] = self.strides();
        let [w, h, d] = self.size;
        let mut found = false;
        for z in 0..d - 1 {
            for y in 0..h - 1 {
                for x in 0..w - 1 {
                    let cell = self.number([x, y, z]);
                    for (a, b) in [(sx, sy), (sx, sz), (sy, sz)] {
                        found |= self.join_diagonal([cell, cell + a, cell + b, cell + a + b]);
                    }
                    let corners: [usize; 8] =
                        std::array::from_fn(|k| cell + (k & 1) * sx + (k >> 1 & 1) * sy + (k >> 2) * sz);
                    found |= self.join_corner(&corners);
                }
            }
        }
        found
    }

    /// Of four cells around an edge, fills one where two opposite ones alone are full.
    fn join_diagonal(&mut self, [a, b, c, d]: [usize; 4]) -> bool {
        let [fa, fb, fc, fd] = [a, b, c, d].map(|cell| self.full[cell]);
        if fa == fd && fb == fc && fa != fb {
            self.full[if fa { b } else { a }] = true;
            return true;
        }
        false
    }

    /// Of eight cells around a corner, fills one where two opposite ones alone are full, or alone are empty.
    fn join_corner(&mut self, corners: &[usize; 8]) -> bool {
        let mut state = 0u8;
        for (k, &cell) in corners.iter().enumerate() {
            state |= u8::from(self.full[cell]) << k;
        }
        let opposite = |k: u32| 1u8 << k | 1u8 << (7 - k);
        for k in 0..4 {
            let pair = opposite(k);
            if state == pair || state == !pair {
                // Beside the first full one, or the first empty one itself.
                let filled = if state == pair { k ^ 1 } else { k };
                self.full[corners[filled as usize]] = true;
                return true;
            }
        }
        false
    }

    /// How many faces there are between full and empty cells.
    pub fn faces(&self) -> usize {
        let mut count = 0;
        self.each_face(|_, _, _| count += 1);
        count
    }

    /// Hands out the faces: the full cell, the axis, and whether the empty one is above it.
    fn each_face(&self, mut face: impl FnMut(usize, usize, bool)) {
        let strides = self.strides();
        for (cell, _) in self.full.iter().enumerate().filter(|(_, full)| **full) {
            for (axis, stride) in strides.into_iter().enumerate() {
                // What is full is never at the border.
                if !self.full[cell - stride] {
                    face(cell, axis, false);
                }
                if !self.full[cell + stride] {
                    face(cell, axis, true);
                }
            }
        }
    }

    /// The surface between full and empty cells: corners, and quads that face what is empty.
    pub fn surface(&self) -> (Vec<DVec3>, Vec<[u32; 4]>) {
        let strides = self.strides();
        let mut number = vec![u32::MAX; self.full.len()];
        let (mut positions, mut quads) = (Vec::new(), Vec::new());
        self.each_face(|cell, axis, above| {
            let (u, v) = (strides[(axis + 1) % 3], strides[(axis + 2) % 3]);
            let first = if above { cell + strides[axis] } else { cell };
            let corners = [first, first + u, first + u + v, first + v];
            let mut quad = corners.map(|corner| {
                if number[corner] == u32::MAX {
                    number[corner] = positions.len() as u32;
                    let [x, y, z] = self.place(corner).map(|k| k as f64);
                    positions.push(self.origin + DVec3::new(x, y, z) * self.step);
                }
                number[corner]
            });
            if !above {
                quad.reverse();
            }
            quads.push(quad);
        });
        (positions, quads)
    }
}
