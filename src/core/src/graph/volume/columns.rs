//! Whether places lie inside a closed hull, by counting the faces beyond them along one axis.
//!
//! A line along an axis enters and leaves a closed hull equally often, so the faces that it crosses on one side of a
//! place give the winding number there, a whole number. Faces are sorted into the columns of a grid across that axis;
//! a place needs the faces of its own column only.

use crate::mesh::BoundingBox;
use crate::mesh::query::triangle_cells::{BoxGrid, GridLimits};
use crate::pool::Pool;
use glam::DVec3;

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
    use crate::graph::winding::tree::WindingTree;

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
