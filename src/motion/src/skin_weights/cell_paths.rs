//! Cells of a cubic lattice that a mesh occupies, all its parts together, and the ways through them.
//!
//! Parts that nearly touch, such as a hand beside a thigh, have cells beside each other with air in between. Heat does not cross it, and a
//! bone reaches a cell only by a way through cells. Air in a furrow of the surface separates nothing.

use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::graph::WindingTree;
use pliant_mesh::query::closest_point::closest_point_on_segment;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

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
/// Cells that one thread takes in a row.
const RUN: usize = 256;
/// Cells by which a furrow closes from each of its ends at most.
const FURROW: usize = 32;
/// Places along a bone at most.
const MOST_STEPS: f64 = 4096.0;
/// How far below the surface the place of a cell is whose middle is outside, in cells.
const BELOW: f64 = 0.1;
/// Steps that a straight way takes at most more than it is long along the axes, in cells: a bone passes a cell beside its middle.
const SPARE_STEPS: f64 = 1.5;
/// A bone that is so many times as near through the air as the one that reaches a cell counts all the same: skirts hang around legs.
const THROUGH_AIR: f64 = 3.0;
/// How near to its end a segment may meet the surface and still end there, of its length.
const AT_END: f64 = 1e-3;

/// A bone that vertices can follow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkinBone {
    /// Where it begins and where it ends, in model space; the same point twice for a bone without length.
    pub ends: [DVec3; 2],
    /// Number of the bone that it hangs on, lower than its own; `None` for a root.
    pub parent: Option<usize>,
}

/// Cells of a cubic lattice, numbered with x running fastest; the occupied ones are nodes.
pub(crate) struct OccupiedCells {
    /// The lowest corner.
    origin: DVec3,
    /// Side of a cell.
    pub(crate) side: f64,
    size: [usize; 3],
    /// By cell: its node, or [`EMPTY`].
    pub(super) node: Vec<u32>,
    /// By node: the middle of its cell.
    pub(crate) places: Vec<DVec3>,
}

impl OccupiedCells {
    /// Finds them, among `most` cells or fewer; `tree` has the triangles of the mesh, if there are any.
    pub(crate) fn find(
        positions: &[DVec3],
        tree: Option<&WindingTree<'_>>,
        most: usize,
        exec: &Exec<'_>,
    ) -> Result<Self, Cancelled> {
        let low = positions.iter().fold(DVec3::INFINITY, |a, p| a.min(*p));
        let high = positions.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
        let mut cells = Self::around(low, high, most);
        exec.check()?;
        let mut occupied = cells.inside_or_passed(tree, exec)?;
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
    fn inside_or_passed(&self, tree: Option<&WindingTree<'_>>, exec: &Exec<'_>) -> Result<Vec<bool>, Cancelled> {
        let [nx, ny, nz] = self.size;
        let mut occupied = vec![false; nx * ny * nz];
        let Some(tree) = tree else {
            return Ok(occupied);
        };
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
    fn rows(&self) -> (Vec<u32>, Vec<u32>) {
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

    /// The nodes that a segment passes.
    fn nodes_along(&self, [from, to]: [DVec3; 2]) -> Vec<u32> {
        let steps = (2.0 * from.distance(to) / self.side).ceil().clamp(1.0, MOST_STEPS);
        let passed = (0..=steps as usize).map(|k| from.lerp(to, k as f64 / steps));
        let around = passed.filter(|p| {
            let at = (*p - self.origin) / self.side;
            (0..3).all(|k| at[k] >= 0.0 && at[k] < self.size[k] as f64)
        });
        let nodes = around.map(|p| self.node[self.cell_of(p)]).filter(|n| *n != EMPTY);
        let mut nodes: Vec<u32> = nodes.collect();
        nodes.dedup();
        nodes
    }

    /// The nodes around a point and their shares, by which what is known at nodes is read off in between. Cells that
    /// are not occupied have none.
    fn around_point(&self, p: DVec3) -> ([(u32, f64); 8], usize) {
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
        (found, count)
    }
}

/// Which cells hang together.
pub(super) struct CellPaths<'a> {
    pub(super) cells: &'a OccupiedCells,
    /// Where the neighbours of each cell begin.
    pub(super) offsets: Vec<u32>,
    /// In rising order.
    pub(super) neighbours: Vec<u32>,
    tree: Option<&'a WindingTree<'a>>,
    /// By cell, its middle; where that is outside, a place just below the surface nearest to it.
    below: Vec<DVec3>,
}

impl<'a> CellPaths<'a> {
    /// Joins cells with a side in common, without air in between.
    pub(super) fn of(
        cells: &'a OccupiedCells,
        tree: Option<&'a WindingTree<'a>>,
        exec: &Exec<'_>,
    ) -> Result<Self, Cancelled> {
        let (offsets, neighbours) = cells.rows();
        let mut paths = Self {
            cells,
            offsets,
            neighbours,
            tree,
            below: Vec::new(),
        };
        let Some(tree) = tree else { return Ok(paths) };
        exec.pool.install(|| {
            let all = cells.places.par_iter().with_min_len(RUN);
            let below = all.map(|p| {
                exec.check()?;
                let surface = tree.bvh().closest_point_within(*p, cells.side);
                let below = surface.map(|s| s.point + (s.point - *p).normalize_or_zero() * (BELOW * cells.side));
                let is_passed = below.is_some();
                Ok((below.filter(|_| !tree.contains(*p)).unwrap_or(*p), is_passed))
            });
            let (below, is_passed): (Vec<DVec3>, Vec<bool>) =
                below.collect::<Result<Vec<_>, Cancelled>>()?.into_iter().unzip();
            let kept = (0..cells.places.len()).into_par_iter().with_min_len(RUN).map(|node| {
                exec.check()?;
                let joined = |next: &&u32| {
                    let (a, b) = (node.min(**next as usize), node.max(**next as usize));
                    !(is_passed[a] && is_passed[b] && has_air(tree, below[a], below[b]))
                };
                Ok(paths.row(node).iter().filter(joined).copied().collect())
            });
            let kept: Vec<Vec<u32>> = kept.collect::<Result<_, Cancelled>>()?;
            paths.take_rows(&kept);
            paths.close_furrows(exec)?;
            paths.below = below;
            Ok(paths)
        })
    }

    /// Joins cells across furrows of the surface: where air is between them, but joined cells around at least two squares lead from
    /// one to the other. A furrow closes from its ends and from below; what separates two limbs stays.
    fn close_furrows(&mut self, exec: &Exec<'_>) -> Result<(), Cancelled> {
        let (offsets, neighbours) = self.cells.rows();
        for _ in 0..FURROW {
            let all = (0..self.cells.places.len()).into_par_iter().with_min_len(RUN);
            let rows = all.map(|node| {
                exec.check()?;
                let own = self.row(node);
                let row = &neighbours[offsets[node] as usize..offsets[node + 1] as usize];
                let is_joined = |next: &&u32| own.contains(next) || self.has_two_short_ways(node, **next);
                Ok(row.iter().filter(is_joined).copied().collect())
            });
            let rows: Vec<Vec<u32>> = rows.collect::<Result<_, Cancelled>>()?;
            let before = self.neighbours.len();
            self.take_rows(&rows);
            if self.neighbours.len() == before {
                break;
            }
        }
        Ok(())
    }

    /// Whether ways of three steps, around a square of cells each, lead from one cell to another along two sides.
    fn has_two_short_ways(&self, from: usize, to: u32) -> bool {
        let second = self.row(from).iter().flat_map(|node| self.row(*node as usize));
        let ways = second.filter(|node| self.row(**node as usize).contains(&to));
        ways.take(2).count() == 2
    }

    /// Replaces the cells that each is joined to.
    fn take_rows(&mut self, rows: &[Vec<u32>]) {
        self.neighbours.clear();
        for (node, row) in rows.iter().enumerate() {
            self.neighbours.extend(row);
            self.offsets[node + 1] = self.neighbours.len() as u32;
        }
    }

    /// The cells that a cell is joined to.
    pub(super) fn row(&self, node: usize) -> &[u32] {
        &self.neighbours[self.offsets[node] as usize..self.offsets[node + 1] as usize]
    }

    /// By cell, the bone that is nearest through the cells, and how far it is: the straight distance and the steps that the way takes
    /// more than a straight one. What none reaches, and what is much nearer to one through the air, has the bone nearest through
    /// the air.
    pub(super) fn nearest_bones(&self, bones: &[SkinBone], exec: &Exec<'_>) -> Result<Vec<(usize, f64)>, Cancelled> {
        let places = &self.cells.places;
        let mut best = vec![(f64::INFINITY, 0, 0); places.len()];
        let mut open = BinaryHeap::new();
        let mut reach = |open: &mut BinaryHeap<_>, node: u32, bone: u32, steps: u32, before: f64| {
            let straight = bones[bone as usize].nearest_to(places[node as usize]) - places[node as usize];
            let needed = straight.abs().element_sum() / self.cells.side + SPARE_STEPS;
            let detour = (f64::from(steps) - needed).max(0.0) * self.cells.side;
            let way = (straight.length() + detour).max(before);
            let known = &mut best[node as usize];
            if (way, steps) < (known.0, known.1) {
                *known = (way, steps, bone);
                // Numbers that are not negative have the order of their bits.
                open.push(Reverse((way.to_bits(), steps, bone, node)));
            }
        };
        for (bone, own) in bones.iter().enumerate() {
            exec.check()?;
            let along = self.cells.nodes_along(own.ends);
            along
                .into_iter()
                .for_each(|node| reach(&mut open, node, bone as u32, 0, 0.0));
        }
        let mut done = vec![false; places.len()];
        while let Some(Reverse((way, steps, bone, node))) = open.pop() {
            if std::mem::replace(&mut done[node as usize], true) {
                continue;
            }
            exec.check()?;
            let beside = self.row(node as usize).iter();
            beside.for_each(|next| reach(&mut open, *next, bone, steps + 1, f64::from_bits(way)));
        }
        exec.pool.install(|| {
            let all = places.par_iter().zip(&best).with_min_len(RUN);
            let found = all.map(|(p, (way, _, bone))| {
                exec.check()?;
                let (other, square) = nearest(bones, *p);
                let through_air = square.sqrt();
                let is_nearer = through_air * THROUGH_AIR < *way;
                Ok(if is_nearer {
                    (other, through_air)
                } else {
                    (*bone as usize, *way)
                })
            });
            found.collect()
        })
    }

    /// The nodes around a point of the mesh and their shares, by which what is known at nodes is read off in between. Shares add up to
    /// one; cells that are not occupied have none, nor have those of other parts: the one with the largest share from which no
    /// surface is before the point is its own, and those count that are joined to it around the point.
    pub(super) fn around_point(&self, p: DVec3) -> ([(u32, f64); 8], usize) {
        let cells = self.cells;
        let (mut found, mut count) = cells.around_point(p);
        if let Some(tree) = self.tree {
            // What of the way to the point is below the surface.
            let own_way = |node: u32| {
                let hit = tree.bvh().first_hit(self.below[node as usize], p, None);
                hit.map_or(1.0, |hit| hit.along.min(1.0 - AT_END))
            };
            found[..count].sort_by(|a, b| b.1.total_cmp(&a.1));
            let mut own = (0, -1.0);
            for (k, (node, _)) in found[..count].iter().enumerate() {
                let way = own_way(*node);
                if way > own.1 {
                    own = (k, way);
                }
                if way >= 1.0 - AT_END {
                    break;
                }
            }
            found.swap(0, own.0);
            let mut kept = 1;
            let mut at = 0;
            while at < kept {
                let row = self.row(found[at].0 as usize);
                while let Some(next) = found[kept..count].iter().position(|f| row.contains(&f.0)) {
                    found.swap(kept, kept + next);
                    kept += 1;
                }
                at += 1;
            }
            count = kept;
        }
        let sum: f64 = found[..count].iter().map(|f| f.1).sum();
        found[..count].iter_mut().for_each(|f| f.1 /= sum);
        (found, count)
    }
}

/// Whether a segment leaves the mesh and comes back.
fn has_air(tree: &WindingTree<'_>, from: DVec3, to: DVec3) -> bool {
    let Some(first) = tree.bvh().first_hit(from, to, None) else {
        return false;
    };
    let Some(last) = tree.bvh().first_hit(to, from, None) else {
        return false;
    };
    let middle = 0.5 * (first.along + 1.0 - last.along);
    first.along < 1.0 - last.along && !tree.contains(from.lerp(to, middle))
}

impl SkinBone {
    /// The point of it nearest to another.
    fn nearest_to(&self, p: DVec3) -> DVec3 {
        closest_point_on_segment(p, self.ends[0], self.ends[1])
    }
}

pub(super) fn distance_squared(bone: &SkinBone, p: DVec3) -> f64 {
    bone.nearest_to(p).distance_squared(p)
}

/// The bone nearest to a point, and its squared distance.
pub(super) fn nearest(bones: &[SkinBone], p: DVec3) -> (usize, f64) {
    let mut best = (0, f64::INFINITY);
    for (bone, own) in bones.iter().enumerate() {
        let square = distance_squared(own, p);
        if square < best.1 {
            best = (bone, square);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::super::{SkinWeightOptions, skin_weights};
    use super::*;
    use pliant_exec::pool::Pool;
    use pliant_exec::progress::Silent;

    /// Adds a box whose sides are divided into squares of about a tenth.
    fn add_box(low: DVec3, high: DVec3, positions: &mut Vec<DVec3>, triangles: &mut Vec<[u32; 3]>) {
        let size = high - low;
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let [m, n] = [u, v].map(|k| (size[k] / 0.1).ceil() as u32);
            for at in [low, high] {
                let base = positions.len() as u32;
                for i in 0..=m {
                    for j in 0..=n {
                        let mut p = low;
                        p[axis] = at[axis];
                        p[u] += size[u] * f64::from(i) / f64::from(m);
                        p[v] += size[v] * f64::from(j) / f64::from(n);
                        positions.push(p);
                    }
                }
                for (i, j) in (0..m).flat_map(|i| (0..n).map(move |j| (i, j))) {
                    let [a, b] = [0, 1].map(|k| base + (i + k) * (n + 1) + j);
                    let faces = [[a, b, b + 1], [a, b + 1, a + 1]];
                    triangles.extend(faces.map(|[a, b, c]| if at == high { [a, b, c] } else { [a, c, b] }));
                }
            }
        }
    }

    #[test]
    fn a_limb_beside_another_one_does_not_carry_it() {
        for gap in [0.06, 0.02] {
            let (mut positions, mut triangles) = (Vec::new(), Vec::new());
            // A thick limb, and beside it a thin one that hangs from the same block above.
            add_box(
                DVec3::new(-0.4, 0.0, -0.4),
                DVec3::new(0.4, 2.0, 0.4),
                &mut positions,
                &mut triangles,
            );
            let thick = positions.len();
            let near = 0.4 + gap;
            add_box(
                DVec3::new(near, 0.0, -0.1),
                DVec3::new(near + 0.2, 2.0, 0.1),
                &mut positions,
                &mut triangles,
            );
            add_box(
                DVec3::new(-0.4, 1.9, -0.4),
                DVec3::new(near + 0.2, 2.4, 0.4),
                &mut positions,
                &mut triangles,
            );
            let bone = |from: DVec3, to: DVec3, parent: Option<usize>| SkinBone {
                ends: [from, to],
                parent,
            };
            let [above, beside] = [DVec3::Y * 2.2, DVec3::new(near + 0.1, 2.2, 0.0)];
            let bones = [
                bone(above, beside, None),
                bone(above, DVec3::Y * 0.1, Some(0)),
                bone(beside, DVec3::new(near + 0.1, 0.1, 0.0), Some(0)),
            ];
            let pool = Pool::new(1).expect("a pool");
            let exec = Exec::new(&pool, &Silent);
            let options = SkinWeightOptions {
                cells: 1 << 17,
                ..SkinWeightOptions::default()
            };
            let found = skin_weights(&positions, &triangles, &bones, &options, &exec).expect("weights");
            for (k, (p, own)) in positions.iter().zip(&found).enumerate().filter(|(_, (p, _))| p.y < 1.5) {
                let other = if k < thick { 2 } else { 1 };
                let bleeding = own.iter().find(|own| own.0 == other).map_or(0.0, |own| own.1);
                assert!(bleeding < 0.05, "gap {gap}: {bleeding} of the other limb at {p}");
            }
        }
    }
}
