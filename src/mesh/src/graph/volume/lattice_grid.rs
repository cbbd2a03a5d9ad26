//! The body-centred cubic grid that lattice nodes lie on, the neighbours in it, and the surface near it.
//!
//! Two cubic grids A and B of side `a`, B shifted by half a cell along each axis. Each node has six neighbours in its
//! own grid and eight in the other. A node is named by a key whose order is sheet by sheet, row by row.
//!
//! The surface as shell and lattice ask for it: by cells where its faces are of about one size, else by a tree.

use crate::graph::winding::WindingTree;
use crate::query::{SegmentHit, TriangleBvh, TriangleCells};
use crate::{BoundingBox, Mesh};
use glam::DVec3;
use pliant_exec::pool::Pool;
use rayon::prelude::*;
use std::sync::OnceLock;

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

/// Name of a grid node: 20 bits each of z, then one bit for the grid (0 = A), then y and x.
pub(in crate::graph) type LatticeKey = u64;

/// Coordinates run from 1 to this, so that steps to a neighbour never leave their 20 bits.
pub(in crate::graph) const LAST: u32 = (1 << 20) - 2;

const AXIS: [LatticeKey; 3] = [1, 1 << 20, 1 << 41];
const IN_B: LatticeKey = 1 << 40;

pub(in crate::graph) fn key(at: [u32; 3], in_b: bool) -> LatticeKey {
    LatticeKey::from(at[0])
        + LatticeKey::from(at[1]) * AXIS[1]
        + LatticeKey::from(at[2]) * AXIS[2]
        + if in_b { IN_B } else { 0 }
}

/// Place of a node in grid units, from the place of A's node (0, 0, 0).
pub(in crate::graph) fn place(key: LatticeKey) -> DVec3 {
    let mask = (1 << 20) - 1;
    let coordinate = |shift: u32| ((key >> shift) & mask) as f64;
    let half = if key & IN_B == 0 { 0.0 } else { 0.5 };
    DVec3::new(coordinate(0), coordinate(20), coordinate(41)) + DVec3::splat(half)
}

/// The key of the neighbour in `direction`: 0 to 5 along the axes (+x, −x, +y, …), 6 to 13 in the other grid (bits of
/// `direction − 6`: towards +x, +y, +z).
pub(in crate::graph) fn toward(key: LatticeKey, direction: usize) -> LatticeKey {
    if direction < 6 {
        let axis = AXIS[direction / 2];
        return if direction.is_multiple_of(2) {
            key + axis
        } else {
            key - axis
        };
    }
    let bits = direction - 6;
    let along = |wanted: usize| {
        (0..3)
            .filter(move |axis| bits >> axis & 1 == wanted)
            .map(|axis| AXIS[axis])
            .sum::<LatticeKey>()
    };
    // A's node (i, j, k) lies half a cell below B's node of the same numbers along each axis.
    if key & IN_B == 0 {
        key + IN_B - along(0)
    } else {
        key - IN_B + along(1)
    }
}

#[cfg(test)]
fn opposite(direction: usize) -> usize {
    if direction < 6 {
        direction ^ 1
    } else {
        6 + (7 - (direction - 6))
    }
}

/// Directions that a lattice of the given valence (14 or 8) has.
pub(in crate::graph) fn directions(valence: u32) -> std::ops::Range<usize> {
    if valence == 8 { 6..14 } else { 0..14 }
}

/// In a [`LatticeRow`]: no neighbour.
pub(in crate::graph) const NONE: u32 = u32::MAX;
/// For a node the node in each of the 14 directions, or [`NONE`].
pub(in crate::graph) type LatticeRow = [u32; 14];

/// Nodes whose rows are found in one go.
const BLOCK: usize = 1 << 12;

/// The neighbours of each of the sorted `keys`. One pass over a block of keys per direction: the partner's key rises
/// with the node's.
pub(in crate::graph) fn rows(keys: &[LatticeKey], valence: u32, pool: &Pool) -> Vec<LatticeRow> {
    let mut rows = vec![[NONE; 14]; keys.len()];
    let fill = |(rows, block): (&mut [LatticeRow], &[LatticeKey])| {
        for direction in directions(valence) {
            // Steps from A and from B differ, and the partners of each rise on their own.
            for grid in [0, IN_B] {
                let mut own = rows.iter_mut().zip(block).filter(|(_, k)| *k & IN_B == grid).peekable();
                let Some((_, first)) = own.peek() else { continue };
                let wanted = toward(**first, direction);
                let mut partner = keys.partition_point(|&k| k < wanted);
                for (row, &key) in own {
                    let wanted = toward(key, direction);
                    while keys.get(partner).is_some_and(|&k| k < wanted) {
                        partner += 1;
                    }
                    if keys.get(partner) == Some(&wanted) {
                        row[direction] = partner as u32;
                    }
                }
            }
        }
    };
    pool.install(|| rows.par_chunks_mut(BLOCK).zip(keys.par_chunks(BLOCK)).for_each(fill));
    rows
}

/// The directions in the order of the neighbours' keys, for nodes of A and of B.
pub(in crate::graph) fn rising() -> [[usize; 14]; 2] {
    [false, true].map(|in_b| {
        let middle = key([LAST / 2; 3], in_b);
        let mut order: [usize; 14] = std::array::from_fn(|d| d);
        order.sort_by_key(|&d| toward(middle, d));
        order
    })
}

/// Whether a node belongs to grid B.
pub(in crate::graph) fn in_b(key: LatticeKey) -> bool {
    key & IN_B != 0
}

/// Side of a cell in mean edges.
const SIDE: f64 = 1.5;
/// Cells are no help to queries that reach further than this many of their sides.
const REACH: f64 = 4.0;

/// Answers whether there is room for a copy of a vertex.
pub(in crate::graph) trait RoomQueries {
    /// Whether any face is nearer to `point` than `radius`.
    fn has_face_within(&self, point: DVec3, radius: f64) -> bool;

    /// Whether the segment crosses any face but those around vertex `except`.
    fn is_way_crossed(&self, from: DVec3, to: DVec3, except: Option<u32>) -> bool;
}

impl RoomQueries for TriangleBvh<'_> {
    fn has_face_within(&self, point: DVec3, radius: f64) -> bool {
        self.has_triangle_within(point, radius)
    }

    fn is_way_crossed(&self, from: DVec3, to: DVec3, except: Option<u32>) -> bool {
        self.first_hit(from, to, except).is_some()
    }
}

/// The faces of a mesh, sorted for queries of short reach, and for all others when somebody asks.
pub(in crate::graph) struct NearSurface<'a> {
    positions: &'a [DVec3],
    faces: &'a [[u32; 3]],
    cells: Option<TriangleCells<'a>>,
    tree: OnceLock<WindingTree<'a>>,
    pool: &'a Pool,
}

impl<'a> NearSurface<'a> {
    /// Sorts the faces of a mesh for queries that reach about as far as its edges are long.
    pub(in crate::graph) fn sort(mesh: &'a Mesh, pool: &'a Pool) -> Self {
        let (positions, faces) = (&mesh.positions, &mesh.triangles);
        let perimeter = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            a.distance(b) + b.distance(c) + c.distance(a)
        };
        let total: f64 = faces.iter().map(perimeter).sum();
        let mean_edge = total / (3.0 * faces.len() as f64);
        Self {
            positions,
            faces,
            cells: TriangleCells::sort(positions, faces, SIDE * mean_edge, pool),
            tree: OnceLock::new(),
            pool,
        }
    }

    /// Takes the tree from now on where cells are no help to queries that reach `reach`.
    pub(in crate::graph) fn prepare_for(&mut self, reach: f64) {
        if !self.cells.as_ref().is_some_and(|cells| reach <= REACH * cells.side()) {
            self.cells = None;
            self.tree();
        }
    }

    /// The tree over all faces, which is built by the first who asks; that is never to be one of many in parallel.
    pub(in crate::graph) fn tree(&self) -> &WindingTree<'a> {
        let build = || WindingTree::build(self.positions, self.faces, self.pool);
        self.tree.get_or_init(build)
    }

    /// What long queries have looked at.
    pub(in crate::graph) fn visits(&self) -> u64 {
        let in_cells = self.cells.as_ref().map_or(0, TriangleCells::visits);
        in_cells + self.tree.get().map_or(0, |tree| tree.bvh().visits.total())
    }

    /// Lists all vertices, so that those next to each other in the list are close in space.
    pub(in crate::graph) fn vertices_in_space_order(&self) -> Vec<u32> {
        match &self.cells {
            Some(cells) => cells.vertices_in_space_order(),
            None => self.tree().bvh().vertices_in_space_order(),
        }
    }

    /// Finds the first face that the segment crosses or touches.
    pub(in crate::graph) fn first_hit(&self, from: DVec3, to: DVec3) -> Option<SegmentHit> {
        match &self.cells {
            Some(cells) => cells.first_hit(from, to),
            None => self.tree().bvh().first_hit(from, to, None),
        }
    }
}

impl RoomQueries for NearSurface<'_> {
    fn has_face_within(&self, point: DVec3, radius: f64) -> bool {
        match &self.cells {
            Some(cells) => cells.has_triangle_within(point, radius),
            None => self.tree().bvh().has_face_within(point, radius),
        }
    }

    fn is_way_crossed(&self, from: DVec3, to: DVec3, except: Option<u32>) -> bool {
        match &self.cells {
            Some(cells) => cells.is_crossed(from, to, except),
            None => self.tree().bvh().is_way_crossed(from, to, except),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(direction: usize) -> DVec3 {
        if direction < 6 {
            return DVec3::AXES[direction / 2] * [1.0, -1.0][direction % 2];
        }
        DVec3::from_array(std::array::from_fn(|axis| {
            if (direction - 6) >> axis & 1 == 1 { 0.5 } else { -0.5 }
        }))
    }

    #[test]
    fn steps_and_keys_agree_in_all_fourteen_directions() {
        for in_b in [false, true] {
            let here = key([7, 9, 11], in_b);
            for d in directions(14) {
                let there = toward(here, d);
                assert_eq!(place(there) - place(here), step(d), "direction {d}, in B: {in_b}");
                assert_eq!(toward(there, opposite(d)), here);
            }
        }
        assert_eq!(place(key([1, 2, 3], true)), DVec3::new(1.5, 2.5, 3.5));
    }

    #[test]
    fn pairs_are_those_at_neighbour_distance() {
        let mut keys: Vec<LatticeKey> = Vec::new();
        for n in 0..6 * 5 * 4 * 2u32 {
            if n % 7 != 3 {
                keys.push(key([1 + n % 6, 1 + n / 6 % 5, 1 + n / 30 % 4], n >= 120));
            }
        }
        keys.sort_unstable();
        for (valence, longest) in [(14, 1.0), (8, 0.9)] {
            let mut expected = Vec::new();
            for i in 0..keys.len() {
                for j in i + 1..keys.len() {
                    if place(keys[i]).distance(place(keys[j])) < longest + 1e-9 {
                        expected.push([i as u32, j as u32]);
                    }
                }
            }
            let rows = rows(&keys, valence, &Pool::new(2).expect("threads"));
            let mut found: Vec<[u32; 2]> = Vec::new();
            for (i, row) in (0u32..).zip(&rows) {
                found.extend(row.iter().filter(|&&j| j != NONE && j > i).map(|&j| [i, j]));
                for (d, &j) in row.iter().enumerate().filter(|r| *r.1 != NONE) {
                    assert_eq!(rows[j as usize][opposite(d)], i, "from {i} to {j} and back");
                }
                let order = rising()[usize::from(in_b(keys[i as usize]))];
                let along: Vec<u32> = order.iter().map(|&d| row[d]).filter(|&j| j != NONE).collect();
                assert!(along.is_sorted(), "{along:?} rises");
            }
            found.sort_unstable();
            assert_eq!(found, expected, "valence {valence}");
        }
    }
}
