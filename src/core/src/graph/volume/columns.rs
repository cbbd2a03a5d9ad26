//! Whether places lie inside a closed hull, by counting the faces beyond them along one axis.
//!
//! A line along an axis enters and leaves a closed hull equally often, so the faces that it crosses on one side of a
//! place tell the winding number there, a whole number. Faces are sorted into the columns of a grid across that axis,
//! and a place looks at the faces of its own column only.

use crate::graph::winding::tree::WindingTree;
use crate::mesh::{BoundingBox, Lists};
use crate::pool::Pool;
use glam::DVec3;
use rayon::prelude::*;

/// Columns for each face.
const COLUMNS: f64 = 2.0;
/// Entries of faces in columns for each face, at most; wider columns have fewer.
const ENTRIES: f64 = 12.0;
/// Faces that a place looks at on average, at most; where it would be more, the tree is asked.
const DEEP: u64 = 512;

/// The faces of a hull by columns.
pub(in crate::graph) struct FaceColumns<'a> {
    positions: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    /// Asked where columns are of no help.
    tree: Option<&'a WindingTree<'a>>,
    /// The axis along the columns, then those across.
    axes: [usize; 3],
    low: DVec3,
    /// Side of a column.
    side: f64,
    /// Columns along either axis across.
    count: [u32; 2],
    /// Faces by column; `None` where too many lie behind each other and there is a tree to ask.
    faces: Option<Lists>,
}

impl<'a> FaceColumns<'a> {
    /// Sorts the faces of `hull`, along the axis on which the fewest lie behind each other.
    pub(in crate::graph) fn sort(hull: &'a WindingTree<'a>, pool: &Pool) -> Self {
        let (positions, triangles) = (hull.bvh().positions(), hull.bvh().triangles());
        let bounds = BoundingBox::of(positions);
        let size = bounds.size();
        let mut shadow = DVec3::ZERO;
        for t in triangles {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            shadow += (b - a).cross(c - a).abs();
        }
        let depth = |axis: usize| shadow[axis] * size[axis];
        let along = (1..3).fold(0, |best, axis| if depth(axis) < depth(best) { axis } else { best });
        Self::build(positions, triangles, along, Some(hull), pool)
    }

    /// Sorts `triangles` along a given axis. They may be those faces of a closed hull that any line along the axis through
    /// the places asked about can cross.
    pub(in crate::graph) fn along(
        along: usize,
        positions: &'a [DVec3],
        triangles: &'a [[u32; 3]],
        pool: &Pool,
    ) -> Self {
        Self::build(positions, triangles, along, None, pool)
    }

    fn build(
        positions: &'a [DVec3],
        triangles: &'a [[u32; 3]],
        along: usize,
        tree: Option<&'a WindingTree<'a>>,
        pool: &Pool,
    ) -> Self {
        let bounds = BoundingBox::of(positions);
        let size = bounds.size();
        let axes = [along, (along + 1) % 3, (along + 2) % 3];
        let across = [size[axes[1]], size[axes[2]]];
        let widest = across[0].max(across[1]);
        let mut columns = Self {
            positions,
            triangles,
            tree,
            axes,
            low: bounds.min,
            side: (across[0] * across[1] / (COLUMNS * triangles.len() as f64)).sqrt(),
            count: [1, 1],
            faces: None,
        };
        // Thin boxes have few columns across, long ones not more than faces.
        columns.side = columns
            .side
            .max(widest / (triangles.len() as f64 + 1.0))
            .max(widest * 1e-6);
        if !(columns.side > 0.0 && columns.side.is_finite()) {
            return columns;
        }
        let spans = loop {
            columns.count = across.map(|length| (length / columns.side) as u32 + 1);
            let span = |t| columns.span(t);
            let spans: Vec<[[u32; 2]; 2]> =
                pool.install(|| triangles.par_iter().with_min_len(1024).map(span).collect());
            let entries: f64 = spans.iter().map(entries).sum();
            if entries <= ENTRIES * triangles.len() as f64 + 1024.0 || columns.count == [1, 1] {
                break spans;
            }
            columns.side *= 1.5;
        };
        let wide = columns.count[0];
        let lists = Lists::gather((wide * columns.count[1]) as usize, || {
            spans.iter().zip(0u32..).flat_map(|(&[first, last], number)| {
                (first[1]..=last[1]).flat_map(move |j| (first[0]..=last[0]).map(move |i| (j * wide + i, number)))
            })
        });
        let squares: u64 = lists.offsets().windows(2).map(|w| u64::from(w[1] - w[0]).pow(2)).sum();
        if tree.is_none() || squares <= DEEP * lists.items().len() as u64 {
            columns.faces = Some(lists);
        }
        columns
    }

    /// The column of a place along an axis across; places beyond the box belong to the columns at its rim.
    fn column(&self, p: DVec3, across: usize) -> u32 {
        let axis = self.axes[1 + across];
        let at = (p[axis] - self.low[axis]) / self.side;
        (at.max(0.0) as u32).min(self.count[across] - 1)
    }

    /// The first and last column of a face.
    fn span(&self, t: &[u32; 3]) -> [[u32; 2]; 2] {
        let [a, b, c] = t.map(|v| self.positions[v as usize]);
        [a.min(b).min(c), a.max(b).max(c)].map(|p| [0, 1].map(|across| self.column(p, across)))
    }

    /// Whether the winding number at a place is not 0.
    pub(in crate::graph) fn contains(&self, p: DVec3) -> bool {
        let Some(faces) = &self.faces else {
            return self.tree.is_some_and(|tree| tree.contains(p));
        };
        let column = self.column(p, 1) * self.count[0] + self.column(p, 0);
        let near = faces.of(column).iter();
        near.map(|&t| self.turn(self.triangles[t as usize], p)).sum::<i32>() != 0
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

fn entries([first, last]: &[[u32; 2]; 2]) -> f64 {
    f64::from(last[0] - first[0] + 1) * f64::from(last[1] - first[1] + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let columns = FaceColumns::sort(&tree, &pool);
        assert!(columns.faces.is_some());
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
