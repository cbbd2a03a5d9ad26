//! Cells of a cubic lattice that a mesh occupies, all its parts together.

use crate::exec::Exec;
use crate::graph::WindingTree;
use crate::progress::Cancelled;
use glam::DVec3;
use rayon::prelude::*;

/// A cell is passed by a triangle that comes this near to its centre, in cells. From √3/2 on no triangle passes unseen; less
/// keeps parts that nearly touch apart.
const REACH: f64 = 0.75;
/// Cells in a row, all without a triangle, after which the test for inside is repeated. In between the answer cannot
/// change where the surface is closed, and changes slowly where it is not.
const ASK_EVERY: usize = 8;
/// Cells along the longest side at most.
const LONGEST: f64 = 256.0;
/// Not occupied.
const EMPTY: u32 = u32::MAX;

/// Cells of a cubic lattice, numbered with x running fastest; the occupied ones are nodes.
pub(in crate::motion) struct OccupiedCells {
    /// The lowest corner.
    origin: DVec3,
    /// Side of a cell.
    pub(in crate::motion) side: f64,
    size: [usize; 3],
    /// By cell: its node, or [`EMPTY`].
    node: Vec<u32>,
    /// By node: the middle of its cell.
    pub(in crate::motion) places: Vec<DVec3>,
}

impl OccupiedCells {
    /// Finds them, among `most` cells or fewer.
    pub(in crate::motion) fn find(
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        most: usize,
        exec: &Exec<'_>,
    ) -> Result<Self, Cancelled> {
        let low = positions.iter().fold(DVec3::INFINITY, |a, p| a.min(*p));
        let high = positions.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
        let mut cells = Self::around(low, high, most);
        exec.check()?;
        let mut occupied = cells.inside_or_passed(positions, triangles, exec)?;
        for p in positions {
            occupied[cells.cell_of(*p)] = true;
        }
        cells.node = vec![EMPTY; occupied.len()];
        for (cell, _) in occupied.iter().enumerate().filter(|(_, o)| **o) {
            cells.node[cell] = cells.places.len() as u32;
            cells.places.push(cells.middle(cell));
        }
        Ok(cells)
    }

    /// A lattice around a box, whose middle is the middle of the lattice.
    fn around(low: DVec3, high: DVec3, most: usize) -> Self {
        let extent = high - low;
        let longest = extent.max_element();
        let mut side = if longest > 0.0 { longest / LONGEST } else { 1.0 };
        let count = |side: f64| (extent / side).floor() + DVec3::ONE;
        let total = |side: f64| count(side).to_array().iter().product::<f64>();
        while total(side) > most as f64 {
            side *= 1.02;
        }
        let size = count(side);
        Self {
            origin: 0.5 * (low + high) - 0.5 * side * size,
            side,
            size: size.to_array().map(|n| n as usize),
            node: Vec::new(),
            places: Vec::new(),
        }
    }

    fn middle(&self, cell: usize) -> DVec3 {
        let [nx, ny, _] = self.size;
        let at = DVec3::new((cell % nx) as f64, (cell / nx % ny) as f64, (cell / (nx * ny)) as f64);
        self.origin + (at + 0.5) * self.side
    }

    /// The cell around a point, or the nearest to it.
    fn cell_of(&self, p: DVec3) -> usize {
        let at = (p - self.origin) / self.side;
        let [x, y, z] = [0, 1, 2].map(|k| (at[k].max(0.0) as usize).min(self.size[k] - 1));
        (z * self.size[1] + y) * self.size[0] + x
    }

    /// By cell: whether a triangle passes it or its middle lies inside.
    fn inside_or_passed(
        &self,
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        exec: &Exec<'_>,
    ) -> Result<Vec<bool>, Cancelled> {
        let [nx, ny, nz] = self.size;
        let mut occupied = vec![false; nx * ny * nz];
        if triangles.is_empty() {
            return Ok(occupied);
        }
        let tree = WindingTree::build(positions, triangles, exec.pool);
        for (z, layer) in occupied.chunks_mut(nx * ny).enumerate() {
            exec.pool.install(|| {
                layer.par_chunks_mut(nx).enumerate().try_for_each(|(y, row)| {
                    let mut known = None;
                    for (x, cell) in row.iter_mut().enumerate() {
                        // Triangles as long as the mesh are near every cell.
                        exec.check()?;
                        let middle = self.middle((z * ny + y) * nx + x);
                        if tree.bvh().has_triangle_within(middle, REACH * self.side) {
                            (*cell, known) = (true, None);
                            continue;
                        }
                        let (inside, since) = match known {
                            Some((inside, since)) if since < ASK_EVERY => (inside, since + 1),
                            _ => (tree.contains(middle), 0),
                        };
                        *cell = inside;
                        known = Some((inside, since));
                    }
                    Ok::<(), Cancelled>(())
                })
            })?;
        }
        Ok(occupied)
    }

    /// Rows of the graph that joins cells with a side in common: where each begins, and the neighbours in rising order.
    pub(super) fn rows(&self) -> (Vec<u32>, Vec<u32>) {
        let [nx, ny, nz] = self.size;
        let steps = [(2, nx * ny), (1, nx), (0, 1)];
        let size = [nx, ny, nz];
        let mut offsets = Vec::with_capacity(self.places.len() + 1);
        let mut neighbours = Vec::with_capacity(6 * self.places.len());
        offsets.push(0);
        for (cell, _) in self.node.iter().enumerate().filter(|(_, n)| **n != EMPTY) {
            let at = [cell % nx, cell / nx % ny, cell / (nx * ny)];
            let below = steps.iter().filter(|s| at[s.0] > 0).map(|s| cell - s.1);
            let above = steps
                .iter()
                .rev()
                .filter(|s| at[s.0] + 1 < size[s.0])
                .map(|s| cell + s.1);
            let found = below.chain(above).map(|c| self.node[c]).filter(|n| *n != EMPTY);
            neighbours.extend(found);
            offsets.push(neighbours.len() as u32);
        }
        (offsets, neighbours)
    }

    /// The nodes around a point and their shares, by which what is known at nodes is read off in between. Shares add up to
    /// one; cells that are not occupied have none.
    pub(super) fn around_point(&self, p: DVec3) -> ([(u32, f64); 8], usize) {
        let at = (p - self.origin) / self.side - 0.5;
        let base = at.floor();
        let part = at - base;
        let mut found = [(0, 0.0); 8];
        let mut count = 0;
        let mut sum = 0.0;
        for corner in 0..8 {
            let step = [corner & 1, corner >> 1 & 1, corner >> 2];
            let mut share = 1.0;
            let mut cell = [0; 3];
            for k in 0..3 {
                let place = base[k] + step[k] as f64;
                share *= if step[k] == 1 { part[k] } else { 1.0 - part[k] };
                if place < 0.0 || place >= self.size[k] as f64 {
                    share = 0.0;
                } else {
                    cell[k] = place as usize;
                }
            }
            let node = self.node[(cell[2] * self.size[1] + cell[1]) * self.size[0] + cell[0]];
            if share > 0.0 && node != EMPTY {
                found[count] = (node, share);
                count += 1;
                sum += share;
            }
        }
        if sum <= 1e-9 {
            return ([(self.node[self.cell_of(p)], 1.0); 8], 1);
        }
        found[..count].iter_mut().for_each(|f| f.1 /= sum);
        (found, count)
    }
}
