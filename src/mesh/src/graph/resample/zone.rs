//! Where an edit may change what is inside: a table of cells around the changed faces.
//!
//! Cells are those of the lattice, shifted by a quarter so that no node lies on a side; where the edit is spread so wide
//! that they would be too many, a cell is a block of them.
//!
//! The faces around an edit, as a small mesh of their own, and those that decide what lies inside there.

use crate::graph::resample::change::{ChangedPoints, GraphBefore, MeshChange};
use crate::graph::resample::hull::{HullChange, fan_over_loop};
use crate::graph::volume::caps::FaceColumns;
use crate::graph::volume::shell::walk;
use crate::query::VisitCount;
use crate::query::closest_point::closest_point_on_triangle;
use crate::{Adjacency, BoundingBox, NONE, sorted_set};
use glam::DVec3;
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// A changed face passes through the cell, or it lies within what changed faces enclose.
const CHANGED: u8 = 1;
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
    fn box_has_mark(&self, b: &BoundingBox, mark: u8) -> bool {
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

/// Faces looked at in one go.
const BLOCK: usize = 1 << 14;
/// In a code: the fan of the point changed. The other bits say on which sides of the zone's box it lies.
const FAN: u8 = 64;
/// For each axis the sides across it.
const ACROSS: [u8; 3] = [0b11_1100, 0b11_0011, 0b00_1111];

/// Faces that an edit may have to do with.
pub(super) struct FoundFaces {
    /// Those that may meet the zone or have a point whose fan changed; rising.
    near: Vec<u32>,
    /// Those that lines through the zone along `along` may cross; rising.
    beyond: Vec<u32>,
    along: usize,
}

/// One look at all points and one at all faces.
pub(super) fn find_local(
    change: &MeshChange,
    points: &ChangedPoints,
    zone: Option<&ChangeZone>,
    pool: &Pool,
) -> FoundFaces {
    let bounds = zone.map(ChangeZone::bounds);
    let code = |p: &DVec3| match &bounds {
        // Beside the box on every axis: only faces that changed are found.
        None => 0b01_0101,
        Some(b) => {
            let side = |axis: usize| u8::from(p[axis] < b.min[axis]) | u8::from(p[axis] > b.max[axis]) << 1;
            side(0) | side(1) << 2 | side(2) << 4
        }
    };
    let mut codes: Vec<u8> = pool.install(|| change.positions.par_iter().with_min_len(BLOCK).map(code).collect());
    points.fans.iter().for_each(|&p| codes[p as usize] |= FAN);
    // What all corners of a face share, and what any has: those sides of the box are beside the whole face.
    let both = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| codes[v as usize]);
        (a & b & c & !FAN, (a | b | c) & FAN != 0)
    };
    let seen: Vec<(u32, u8)> = pool.install(|| {
        let blocks = change.triangles.par_chunks(BLOCK).enumerate();
        let found = blocks.flat_map_iter(|(block, faces)| {
            let first = (block * BLOCK) as u32;
            let faces = faces.iter().zip(first..);
            faces.filter_map(|(t, number)| {
                let (beside, changed) = both(t);
                let wanted = changed || ACROSS.iter().any(|across| beside & across == 0);
                wanted.then_some((number, beside))
            })
        });
        found.collect()
    });
    let crossing = |axis: usize| seen.iter().filter(move |s| s.1 & ACROSS[axis] == 0);
    let count = [0, 1, 2].map(|axis| crossing(axis).count());
    let along = (1..3).fold(0, |best, axis| if count[axis] < count[best] { axis } else { best });
    let near = seen
        .iter()
        .filter(|s| s.1 == 0 || both(&change.triangles[s.0 as usize]).1);
    FoundFaces {
        near: near.map(|s| s.0).collect(),
        beyond: if zone.is_some() {
            crossing(along).map(|s| s.0).collect()
        } else {
            Vec::new()
        },
        along,
    }
}

impl FoundFaces {
    /// The faces with a corner among `wanted` (by point).
    fn with_corner(&self, change: &MeshChange, wanted: &[bool]) -> Vec<[u32; 3]> {
        let faces = self.near.iter().map(|&t| change.triangles[t as usize]);
        faces.filter(|t| t.iter().any(|&v| wanted[v as usize])).collect()
    }
}

/// A mesh of the faces around an edit.
pub(super) struct LocalMesh {
    /// New numbers of its points, rising.
    pub(super) points: Vec<u32>,
    pub(super) positions: Vec<DVec3>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) adjacency: Adjacency,
    /// For each point whether all its faces are here and its fan changed.
    pub(super) fan_changed: Vec<bool>,
}

impl LocalMesh {
    /// The vertex where a walk along the mesh from `start` comes no nearer to `p`.
    pub(super) fn walk(&self, start: u32, p: DVec3, looked: &VisitCount) -> u32 {
        walk(&self.positions, &self.adjacency, start, p, looked)
    }

    pub(super) fn gather_faces(
        change: &MeshChange,
        points: &ChangedPoints,
        found: &FoundFaces,
        zone: Option<&ChangeZone>,
        pool: &Pool,
    ) -> Self {
        let at = |v: u32| change.positions[v as usize];
        let has_fan = |v: u32| points.fans.binary_search(&v).is_ok();
        let wanted = |&&t: &&u32| {
            let t = change.triangles[t as usize];
            zone.is_some_and(|zone| zone.box_has_mark(&BoundingBox::of(&t.map(at)), RIM)) || t.into_iter().any(has_fan)
        };
        let faces: Vec<[u32; 3]> = pool.install(|| {
            let near = found.near.par_iter().with_min_len(1024).filter(|t| wanted(t));
            near.map(|&t| change.triangles[t as usize]).collect()
        });
        let mut used: Vec<u32> = faces.iter().flatten().copied().collect();
        pool.install(|| used.par_sort_unstable());
        used.dedup();
        let local = |v: u32| used.binary_search(&v).unwrap_or(0) as u32;
        let triangles: Vec<[u32; 3]> =
            pool.install(|| faces.par_iter().with_min_len(1024).map(|t| t.map(local)).collect());
        Self {
            positions: used.iter().map(|&v| at(v)).collect(),
            adjacency: Adjacency::build(used.len(), &triangles),
            fan_changed: used.iter().map(|&v| has_fan(v)).collect(),
            points: used,
            triangles,
        }
    }

    /// The number here of a point that is here.
    pub(super) fn find_local(&self, point: u32) -> Option<u32> {
        self.points.binary_search(&point).ok().map(|at| at as u32)
    }
}

/// Which faces enclose space before an edit and after it.
pub(super) struct EnclosingFaces<'a> {
    /// By a corner before the edit.
    pub(super) before: &'a dyn Fn(u32) -> bool,
    /// By a corner after it.
    pub(super) now: &'a dyn Fn(u32) -> bool,
    /// Loops that faces closed, and close now.
    pub(super) lost_loops: &'a [Vec<u32>],
    pub(super) new_loops: &'a [Vec<u32>],
}

/// Faces with corners of their own.
#[derive(Default)]
pub(super) struct LocalFaces {
    pub(super) positions: Vec<DVec3>,
    pub(super) triangles: Vec<[u32; 3]>,
}

impl LocalFaces {
    /// Numbers the corners of named faces in the order of their names, so that an edge runs the same way in all of them.
    fn from_named_faces(faces: Vec<[u64; 3]>, at: impl Fn(u64) -> DVec3) -> Self {
        let names: Vec<u64> = sorted_set(faces.iter().flatten().copied());
        let local = |name: u64| names.binary_search(&name).unwrap_or(0) as u32;
        Self {
            triangles: faces.into_iter().map(|t| t.map(local)).collect(),
            positions: names.iter().map(|&name| at(name)).collect(),
        }
    }

    /// All faces that lines through the zone may cross, closed by caps.
    pub(super) fn around_zone(change: &MeshChange, hull: &HullChange, found: &FoundFaces) -> Self {
        let points = change.positions.len() as u64;
        let faces = found.beyond.iter().map(|&t| change.triangles[t as usize]);
        let enclosing = faces.filter(|t| hull.reach[t[0] as usize] != 0.0);
        let mut faces: Vec<[u64; 3]> = enclosing.map(|t| t.map(u64::from)).collect();
        let mut middles = Vec::with_capacity(hull.loops.len());
        for ring in &hull.loops {
            let (middle, edges) = fan_over_loop(ring, |v| change.positions[v as usize]);
            let name = points + middles.len() as u64;
            faces.extend(edges.map(|[a, b]| [u64::from(a), u64::from(b), name]));
            middles.push(middle);
        }
        Self::from_named_faces(faces, |name| match name.checked_sub(points) {
            Some(middle) => middles[middle as usize],
            None => change.positions[name as usize],
        })
    }

    /// What the edit added to the enclosing faces, and what it took from them, turned round: together they are closed, and
    /// enclose what became inside or outside.
    pub(super) fn between_hulls(
        old: &GraphBefore<'_>,
        change: &MeshChange,
        points: &ChangedPoints,
        hull: &HullChange,
        found: &FoundFaces,
    ) -> Self {
        let reach = old.recipe.inside.as_ref().map_or(&[][..], |inside| &inside.reach);
        let encloses = EnclosingFaces {
            before: &|o| reach[o as usize] != 0.0,
            now: &|v| hull.reach[v as usize] != 0.0,
            lost_loops: &hull.lost_loops,
            new_loops: &hull.new_loops,
        };
        Self::between_surfaces(old, change, points, &encloses, found)
    }

    /// As [`between_hulls`](Self::between_hulls), of the faces that `encloses` says.
    pub(super) fn between_surfaces(
        old: &GraphBefore<'_>,
        change: &MeshChange,
        points: &ChangedPoints,
        encloses: &EnclosingFaces<'_>,
        found: &FoundFaces,
    ) -> Self {
        let (new, before) = (change.positions.len() as u64, old.surface as u64);
        // Old points that stay where they were have the names of new ones.
        let name = |o: u32| match points.new_from_old[o as usize] {
            n if n != NONE && !points.moved[n as usize] => u64::from(n),
            _ => new + u64::from(o),
        };
        let turned = |[a, b, c]: [u64; 3]| [a, c, b];
        let mut faces: Vec<[u64; 3]> = Vec::new();
        let gone = change.removed.iter().filter(|t| (encloses.before)(t[0]));
        faces.extend(gone.map(|t| turned(t.map(name))));
        let mut added: Vec<[u32; 3]> = change.added.iter().map(|&t| change.triangles[t as usize]).collect();
        let enclosing = |t: &&[u32; 3]| (encloses.now)(t[0]);
        faces.extend(added.iter().filter(enclosing).map(|t| t.map(u64::from)));
        added.sort_unstable();
        let moved = found.with_corner(change, &points.moved);
        for t in moved
            .iter()
            .filter(enclosing)
            .filter(|t| added.binary_search(t).is_err())
        {
            // A face with a new point is new, and named as such.
            if t.iter().all(|&v| (v as usize) < points.kept) {
                faces.push(t.map(u64::from));
                faces.push(turned(t.map(|v| name(change.old_from_new[v as usize]))));
            }
        }
        let mut middles: Vec<DVec3> = Vec::new();
        for ring in encloses.new_loops {
            let (middle, edges) = fan_over_loop(ring, |v| change.positions[v as usize]);
            let own = new + before + middles.len() as u64;
            faces.extend(edges.map(|[a, b]| [u64::from(a), u64::from(b), own]));
            middles.push(middle);
        }
        for ring in encloses.lost_loops {
            let (middle, edges) = fan_over_loop(ring, |v| old.positions[v as usize]);
            let own = new + before + middles.len() as u64;
            faces.extend(edges.map(|[a, b]| turned([name(a), name(b), own])));
            middles.push(middle);
        }
        Self::from_named_faces(faces, |name| {
            if name < new {
                change.positions[name as usize]
            } else if name < new + before {
                old.positions[(name - new) as usize]
            } else {
                middles[(name - new - before) as usize]
            }
        })
    }

    /// Sorted to find what lies inside, along the given axis.
    pub(super) fn sort_columns(&self, along: usize, pool: &Pool) -> FaceColumns<'_> {
        FaceColumns::along(along, &self.positions, &self.triangles, pool)
    }
}

impl FoundFaces {
    /// The axis along which the fewest faces lie beyond the zone.
    pub(super) fn best_axis(&self) -> usize {
        self.along
    }
}
