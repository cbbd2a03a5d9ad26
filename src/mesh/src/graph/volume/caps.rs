//! Faces that close the holes of open parts.
//!
//! What edges lack to be passed equally often both ways runs in loops, for any set of triangles: as much of it ends at a
//! vertex as begins there. A fan from the middle of each loop closes it, and then the winding number is whole
//! everywhere off the surface, which rows can be followed through.
//!
//! Whether places lie inside a closed hull, by counting the faces beyond them along one axis.
//!
//! A line along an axis enters and leaves a closed hull equally often, so the faces that it crosses on one side of a
//! place give the winding number there, a whole number. Faces are sorted into the columns of a grid across that axis;
//! a place needs the faces of its own column only.

use crate::query::triangle_cells::{BoxGrid, GridLimits};
use crate::{Adjacency, BoundingBox, Mesh, MeshEdge};
use glam::DVec3;
use pliant_exec::pool::Pool;

/// Positions and faces of a closed surface.
#[derive(Debug, Default)]
pub(in crate::graph) struct ClosedHull {
    /// The mesh's positions, then the middles of loops.
    pub(in crate::graph) positions: Vec<DVec3>,
    pub(in crate::graph) faces: Vec<[u32; 3]>,
    /// For each loop one of its vertices, its length in edges and its middle.
    pub(in crate::graph) loops: Vec<(u32, usize, DVec3)>,
}

/// Positions and faces of a closed surface.
#[derive(Debug, Clone, Copy)]
pub(in crate::graph) struct HullFaces<'a> {
    pub(in crate::graph) positions: &'a [DVec3],
    pub(in crate::graph) faces: &'a [[u32; 3]],
}

impl<'a> HullFaces<'a> {
    /// Those of a mesh that is closed.
    pub(in crate::graph) fn of_mesh(mesh: &'a Mesh) -> Self {
        Self {
            positions: &mesh.positions,
            faces: &mesh.triangles,
        }
    }
}

impl ClosedHull {
    /// Its positions and faces.
    pub(in crate::graph) fn as_faces(&self) -> HullFaces<'_> {
        HullFaces {
            positions: &self.positions,
            faces: &self.faces,
        }
    }

    /// The faces of `triangles` whose vertices `wanted` says, closed by fans.
    pub(in crate::graph) fn close(
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        adjacency: &Adjacency,
        wanted: impl Fn(u32) -> bool,
    ) -> Self {
        let mut hull = Self {
            positions: positions.to_vec(),
            faces: triangles.iter().copied().filter(|t| wanted(t[0])).collect(),
            loops: Vec::new(),
        };
        let mut lacking: Vec<[u32; 2]> = Vec::new();
        for e in adjacency.edges.iter().filter(|e| wanted(e.vertices[0])) {
            lacking.extend(missing(e));
        }
        lacking.sort_unstable();
        for ring in rings(positions.len(), &lacking) {
            let middle = hull.positions.len() as u32;
            let sum: DVec3 = ring.iter().map(|&v| positions[v as usize]).sum();
            hull.positions.push(sum / ring.len() as f64);
            hull.loops.push((ring[0], ring.len(), sum / ring.len() as f64));
            let next = ring.iter().cycle().skip(1);
            hull.faces.extend(ring.iter().zip(next).map(|(&a, &b)| [a, b, middle]));
        }
        hull
    }
}

/// The passages that an edge lacks.
pub(in crate::graph) fn missing(e: &MeshEdge) -> impl Iterator<Item = [u32; 2]> + use<> {
    missing_of(e.vertices, i32::from(e.forward) - i32::from(e.backward))
}

/// The passages that an edge lacks which is passed `more` times more from its first end than from its second.
pub(in crate::graph) fn missing_of([a, b]: [u32; 2], more: i32) -> impl Iterator<Item = [u32; 2]> + use<> {
    let passage = if more > 0 { [b, a] } else { [a, b] };
    (0..more.unsigned_abs()).map(move |_| passage)
}

/// Loops without repeated vertices that use each of the sorted `passages` once.
pub(in crate::graph) fn rings(vertices: usize, passages: &[[u32; 2]]) -> Vec<Vec<u32>> {
    const OFF: u32 = u32::MAX;
    let mut place = vec![OFF; vertices];
    let mut used = vec![false; passages.len()];
    // By vertex: where the first passage from it stands that has not been looked at.
    let mut next = vec![passages.len(); vertices];
    (0..passages.len())
        .rev()
        .for_each(|k| next[passages[k][0] as usize] = k);
    let mut rings = Vec::new();
    for first in 0..passages.len() {
        // Passages from one vertex are used in order, so an unused one is the next from its vertex.
        if used[first] {
            continue;
        }
        let mut path = vec![passages[first][0]];
        place[path[0] as usize] = 0;
        while let Some(&here) = path.last() {
            let out = next[here as usize];
            if passages.get(out).is_none_or(|p| p[0] != here) {
                break;
            }
            next[here as usize] += 1;
            used[out] = true;
            let to = passages[out][1];
            if place[to as usize] == OFF {
                place[to as usize] = path.len() as u32;
                path.push(to);
                continue;
            }
            let ring = path.split_off(place[to as usize] as usize + 1);
            let whole: Vec<u32> = std::iter::once(to).chain(ring).collect();
            whole[1..].iter().for_each(|&v| place[v as usize] = OFF);
            rings.push(whole);
        }
        path.iter().for_each(|&v| place[v as usize] = OFF);
    }
    rings
}

/// Columns for each face.
const COLUMNS: f64 = 2.0;
/// Columns and entries of faces in columns for each face, at most; wider columns have fewer.
const LIMITS: GridLimits = GridLimits {
    cells: 4.0,
    entries: 12.0,
};
/// Faces that a place looks at on average, at most; where it would be more, a tree is to be asked.
const DEEP: u64 = 512;

/// The faces of a hull by columns.
pub(in crate::graph) struct FaceColumns<'a> {
    positions: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    /// The axis along the columns, then those across.
    axes: [usize; 3],
    /// Faces by column; `None` where the box around them is flat.
    grid: Option<BoxGrid>,
}

impl<'a> FaceColumns<'a> {
    /// Sorts the faces of a hull, along the axis on which the fewest lie behind each other. `None` where too many do on any
    /// axis, and a tree is the better choice.
    pub(in crate::graph) fn sort(positions: &'a [DVec3], triangles: &'a [[u32; 3]], pool: &Pool) -> Option<Self> {
        let size = BoundingBox::of(positions).size();
        let mut shadow = DVec3::ZERO;
        for t in triangles {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            shadow += (b - a).cross(c - a).abs();
        }
        let depth = |axis: usize| shadow[axis] * size[axis];
        let along = (1..3).fold(0, |best, axis| if depth(axis) < depth(best) { axis } else { best });
        let columns = Self::along(along, positions, triangles, pool);
        let is_shallow = columns.grid.as_ref().is_some_and(|grid| grid.crowd() <= DEEP);
        is_shallow.then_some(columns)
    }

    /// Sorts `triangles` along a given axis. They may be those faces of a closed hull that any line along the axis through
    /// the places asked about can cross.
    pub(in crate::graph) fn along(
        along: usize,
        positions: &'a [DVec3],
        triangles: &'a [[u32; 3]],
        pool: &Pool,
    ) -> Self {
        let size = BoundingBox::of(positions).size();
        let axes = [along, (along + 1) % 3, (along + 2) % 3];
        let across = [size[axes[1]], size[axes[2]]];
        let widest = across[0].max(across[1]);
        let side = (across[0] * across[1] / (COLUMNS * triangles.len() as f64)).sqrt();
        // Thin boxes have few columns across, long ones not more than faces.
        let side = side.max(widest / (triangles.len() as f64 + 1.0)).max(widest * 1e-6);
        let mut sides = DVec3::splat(side);
        sides[along] = f64::INFINITY;
        let is_length = side > 0.0 && side.is_finite();
        let sorted = || BoxGrid::of_triangles(positions, triangles, sides, LIMITS, pool);
        Self {
            positions,
            triangles,
            axes,
            grid: is_length.then(sorted).flatten(),
        }
    }

    /// Lists the corners of the faces, each once, so that those next to each other in the list are close in space.
    pub(in crate::graph) fn vertices_in_space_order(&self) -> Vec<u32> {
        let mut seen = vec![false; self.positions.len()];
        let faces = self.grid.iter().flat_map(BoxGrid::numbers_in_order);
        let corners = faces.flat_map(|t| self.triangles[t as usize]);
        corners
            .filter(|&v| !std::mem::replace(&mut seen[v as usize], true))
            .collect()
    }

    /// What long queries have looked at.
    pub(in crate::graph) fn visits(&self) -> u64 {
        self.grid.as_ref().map_or(0, |grid| grid.visits.total())
    }

    /// Whether the winding number at a place is not 0.
    pub(in crate::graph) fn contains(&self, p: DVec3) -> bool {
        let Some(grid) = &self.grid else {
            return false;
        };
        let place = grid.place_of(p);
        // Only faces that reach beyond the place along the axis, and to both sides of it across, can count.
        let mut beyond = place;
        beyond[self.axes[0]] = f32::INFINITY;
        let near = grid.numbers_around(place);
        let near = near.filter(|(_, [min, max])| (min.cmple(beyond) & place.cmple(*max)).all());
        near.map(|(t, _)| self.turn(self.triangles[t as usize], p)).sum::<i32>() != 0
    }

    /// How a face that lies beyond a place changes the winding number; 0 for others. Each edge is cut in one way whichever
    /// face asks, so a place sees no gap between neighbours.
    fn turn(&self, face: [u32; 3], p: DVec3) -> i32 {
        let [x, y, z] = self.axes;
        let positions = self.positions;
        let above = face.map(|v| positions[v as usize][z] > p[z]);
        if above == [above[0]; 3] {
            return 0;
        }
        // The plane through the place cuts two edges, one on its way up and one on its way down.
        let mut cuts = [(0.0f64, 0.0f64); 2];
        for k in 0..3 {
            let (from, to) = (face[k], face[(k + 1) % 3]);
            if above[k] != above[(k + 1) % 3] {
                let [a, b] = [from.min(to), from.max(to)].map(|v| positions[v as usize]);
                let cut = a + (b - a) * ((p[z] - a[z]) / (b[z] - a[z]));
                cuts[usize::from(above[k])] = (cut[y], cut[x]);
            }
        }
        let [up, down] = cuts;
        if (up.0 > p[y]) == (down.0 > p[y]) {
            return 0;
        }
        let at = up.1 + (down.1 - up.1) * ((p[y] - up.0) / (down.0 - up.0));
        match (at > p[x], up.0 > down.0) {
            (false, _) => 0,
            (true, true) => 1,
            (true, false) => -1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::winding::WindingTree;

    #[test]
    fn any_set_of_triangles_is_closed() {
        // A fan of three around an edge, two that share a corner only, and one wound against its neighbour.
        let faces = [
            [0, 1, 2],
            [0, 1, 3],
            [1, 0, 4],
            [4, 5, 6],
            [7, 8, 9],
            [8, 9, 10],
            [0, 1, 11],
        ];
        let positions: Vec<DVec3> = (0..12)
            .map(|k| DVec3::new(f64::from(k % 3), f64::from(k % 5), f64::from(k)))
            .collect();
        let adjacency = Adjacency::build(positions.len(), &faces);
        let hull = ClosedHull::close(&positions, &faces, &adjacency, |_| true);
        assert_eq!(hull.faces[..faces.len()], faces);
        assert!(Adjacency::build(hull.positions.len(), &hull.faces).is_balanced());
        let some = ClosedHull::close(&positions, &faces, &adjacency, |v| v >= 7);
        assert!(Adjacency::build(some.positions.len(), &some.faces).is_balanced());
        assert_eq!(some.faces[..2], faces[4..6]);
    }

    #[test]
    fn a_square_hole_gets_a_fan_of_four() {
        let corner = |k: u32| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2));
        let positions: Vec<DVec3> = (0..8).map(corner).collect();
        let quads = [[0, 2, 3, 1], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces: Vec<[u32; 3]> = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let adjacency = Adjacency::build(8, &faces);
        let hull = ClosedHull::close(&positions, &faces, &adjacency, |_| true);
        assert_eq!((hull.positions.len(), hull.faces.len()), (9, faces.len() + 4));
        assert_eq!(hull.positions[8], DVec3::new(0.5, 0.5, 1.0));
        assert!((crate::signed_volume(&hull.positions, &hull.faces) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn columns_agree_with_the_winding_number_of_a_box_in_a_box() {
        let corner = |k: u32| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2));
        let quads = [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ];
        let mut positions: Vec<DVec3> = (0..8).map(|k| corner(k) * DVec3::new(3.0, 2.0, 1.0)).collect();
        positions.extend((0..8).map(|k| corner(k) * 0.5 + DVec3::splat(0.25)));
        let side = |q: &[u32; 4], by: u32| [[q[0] + by, q[1] + by, q[2] + by], [q[0] + by, q[2] + by, q[3] + by]];
        let mut faces: Vec<[u32; 3]> = quads.iter().flat_map(|q| side(q, 0)).collect();
        // The inner box is hollow.
        faces.extend(quads.iter().flat_map(|q| side(q, 8)).map(|[a, b, c]| [a, c, b]));
        let pool = Pool::new(1).expect("a pool");
        let tree = WindingTree::build(&positions, &faces, &pool);
        let columns = FaceColumns::sort(&positions, &faces, &pool).expect("two boxes are not deep");
        let mut seen = [0; 2];
        for k in 0..1000u32 {
            let step = |n: u32| f64::from(k / n % 10) * 0.123 - 0.11;
            let p = DVec3::new(step(1) * 3.0, step(10) * 2.0, step(100));
            assert_eq!(columns.contains(p), tree.contains(p), "at {p}");
            seen[usize::from(tree.contains(p))] += 1;
        }
        assert!(seen[0] > 100 && seen[1] > 100, "{seen:?}");
    }
}
