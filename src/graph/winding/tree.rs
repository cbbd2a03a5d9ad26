//! The tree: triangles sorted along a Morton curve, four to a leaf, four nodes to a node above.

use super::moments::{Field, Moments};
use crate::mesh::Bounds;
use crate::pool::Pool;
use glam::DVec3;
use rayon::prelude::*;

/// Triangles per leaf and nodes per inner node.
pub(super) const FAN: usize = 4;

/// A bounding-volume tree over triangles that answers winding-number, nearest-point and crossing queries.
///
/// Its shape depends on the triangles only. Built in `n log n` time; holds about 70 bytes per triangle.
#[derive(Debug)]
pub struct WindingTree<'a> {
    pub(super) positions: &'a [DVec3],
    pub(super) triangles: &'a [[u32; 3]],
    /// Triangle numbers in the order of the leaves.
    pub(super) order: Vec<u32>,
    /// Leaves first, then each level above; the root is last.
    pub(super) nodes: Vec<Node>,
    pub(super) leaves: usize,
    /// Boxes around the children of each node that is no leaf.
    pub(super) boxes: Vec<Boxes>,
}

/// The boxes around up to four children, laid out so that four are tested at once.
#[derive(Debug, Clone, Copy)]
pub(super) struct Boxes {
    /// By axis, then by child.
    pub(super) min: [[f64; FAN]; 3],
    pub(super) max: [[f64; FAN]; 3],
}

/// One node: its far field and its children.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    /// Area-weighted centroid.
    pub(super) center: DVec3,
    /// No point of the node is further from `center`.
    pub(super) radius: f64,
    pub(super) field: Field,
    /// First child: a place in `order` for leaves, a node for others.
    pub(super) first: u32,
    /// Number of children.
    pub(super) count: u32,
}

/// What a node is built from.
struct Draft {
    moments: Moments,
    radius: f64,
    bounds: Bounds,
    first: u32,
    count: u32,
}

impl Draft {
    fn node(&self) -> Node {
        Node {
            center: self.moments.center,
            radius: self.radius,
            field: Field::of(&self.moments, self.radius),
            first: self.first,
            count: self.count,
        }
    }
}

impl<'a> WindingTree<'a> {
    /// Sorts `triangles` into a tree.
    ///
    /// # Panics
    /// When a triangle names a position that does not exist.
    pub fn build(positions: &'a [DVec3], triangles: &'a [[u32; 3]], pool: &Pool) -> Self {
        pool.install(|| {
            let order = morton_order(positions, triangles);
            let mut tree = Self {
                positions,
                triangles,
                order,
                nodes: Vec::new(),
                leaves: 0,
                boxes: Vec::new(),
            };
            let mut level: Vec<Draft> = (0..triangles.len().div_ceil(FAN))
                .into_par_iter()
                .map(|i| tree.leaf(i * FAN, ((i + 1) * FAN).min(triangles.len())))
                .collect();
            tree.leaves = level.len();
            while level.len() > 1 {
                let first = tree.nodes.len();
                tree.boxes.par_extend(level.par_chunks(FAN).map(Boxes::around));
                let above = level
                    .par_chunks(FAN)
                    .enumerate()
                    .map(|(i, children)| inner(children, (first + i * FAN) as u32))
                    .collect();
                tree.nodes.par_extend(level.par_iter().map(Draft::node));
                level = above;
            }
            tree.nodes.par_extend(level.par_iter().map(Draft::node));
            tree
        })
    }

    /// The triangles that it was built from.
    pub fn triangles(&self) -> &'a [[u32; 3]] {
        self.triangles
    }

    /// The positions that its triangles name.
    pub fn positions(&self) -> &'a [DVec3] {
        self.positions
    }

    /// The corners of all triangles, each once, so that vertices next to each other in the list are close in space.
    pub(in crate::graph) fn vertices_in_space(&self) -> Vec<u32> {
        let mut seen = vec![false; self.positions.len()];
        let corners = self.order.iter().flat_map(|&t| self.triangles[t as usize]);
        corners
            .filter(|&v| !std::mem::replace(&mut seen[v as usize], true))
            .collect()
    }

    /// Bytes held on the heap.
    pub fn bytes(&self) -> usize {
        self.order.capacity() * size_of::<u32>()
            + self.nodes.capacity() * size_of::<Node>()
            + self.boxes.capacity() * size_of::<Boxes>()
    }

    /// Corners of the triangle at a place in the order of the leaves.
    pub(super) fn corners(&self, place: usize) -> [DVec3; 3] {
        self.triangles[self.order[place] as usize].map(|v| self.positions[v as usize])
    }

    fn leaf(&self, from: usize, to: usize) -> Draft {
        let moments: Vec<Moments> = (from..to)
            .map(|place| Moments::of_triangle(self.corners(place)))
            .collect();
        let moments = Moments::of_all(&moments);
        let points: Vec<DVec3> = (from..to).flat_map(|place| self.corners(place)).collect();
        Draft {
            radius: points.iter().map(|p| p.distance(moments.center)).fold(0.0, f64::max),
            moments,
            bounds: Bounds::of(&points),
            first: from as u32,
            count: (to - from) as u32,
        }
    }
}

impl Boxes {
    fn around(children: &[Draft]) -> Self {
        let by = |of: fn(&Bounds) -> DVec3| {
            let corner = |child: usize| children.get(child).map_or(DVec3::NAN, |c| of(&c.bounds));
            std::array::from_fn(|axis| std::array::from_fn(|child| corner(child)[axis]))
        };
        Self {
            min: by(|b| b.min),
            max: by(|b| b.max),
        }
    }

    /// Squared distances from `p`; anything for children that are not there.
    #[inline]
    pub(super) fn distances_squared(&self, p: DVec3) -> [f64; FAN] {
        let mut square = [0.0; FAN];
        for axis in 0..3 {
            let (min, max, p) = (&self.min[axis], &self.max[axis], p[axis]);
            for child in 0..FAN {
                let (below, above) = (min[child] - p, p - max[child]);
                let out = if below > above { below } else { above };
                let out = if out > 0.0 { out } else { 0.0 };
                square[child] += out * out;
            }
        }
        square
    }
}

fn inner(children: &[Draft], first: u32) -> Draft {
    let parts: Vec<Moments> = children.iter().map(|c| c.moments).collect();
    let moments = Moments::of_all(&parts);
    let mut bounds = children[0].bounds;
    let mut radius = 0.0f64;
    for c in children {
        bounds.min = bounds.min.min(c.bounds.min);
        bounds.max = bounds.max.max(c.bounds.max);
        radius = radius.max(c.radius + c.moments.center.distance(moments.center));
    }
    let far_corner = (bounds.max - moments.center).max(moments.center - bounds.min);
    Draft {
        moments,
        radius: radius.min(far_corner.length()),
        bounds,
        first,
        count: children.len() as u32,
    }
}

/// Triangle numbers sorted by the Morton code of their centroids, 21 bits an axis, then by number.
fn morton_order(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<u32> {
    let middle = |t: &[u32; 3]| t.iter().map(|&v| positions[v as usize]).sum::<DVec3>() / 3.0;
    let middles: Vec<DVec3> = triangles.par_iter().map(middle).collect();
    let bounds = Bounds::of(&middles);
    let longest = bounds.size().max_element();
    let scale = if longest > 0.0 { 2_097_151.0 / longest } else { 0.0 };
    let code = |p: DVec3| {
        let cell = (p - bounds.min) * scale;
        spread_bits(cell.x as u64) | spread_bits(cell.y as u64) << 1 | spread_bits(cell.z as u64) << 2
    };
    let mut codes: Vec<(u64, u32)> = middles
        .par_iter()
        .zip(0..triangles.len() as u32)
        .map(|(&p, t)| (code(p), t))
        .collect();
    codes.par_sort_unstable();
    codes.into_iter().map(|c| c.1).collect()
}

/// Puts two zero bits between the lowest 21 bits.
fn spread_bits(x: u64) -> u64 {
    let x = x & 0x1f_ffff;
    let x = (x | x << 32) & 0x001f_0000_0000_ffff;
    let x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    let x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    let x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// A stack of nodes still to visit. A tree over 2³² triangles is 16 levels high, and a visit takes one entry and puts
/// back at most four.
pub(super) struct Stack {
    entries: [u32; 64],
    len: usize,
}

impl Stack {
    pub(super) fn new(tree: &WindingTree) -> Self {
        let mut stack = Self {
            entries: [0; 64],
            len: 0,
        };
        if !tree.nodes.is_empty() {
            stack.push(tree.nodes.len() as u32 - 1);
        }
        stack
    }

    pub(super) fn push(&mut self, node: u32) {
        self.entries[self.len] = node;
        self.len += 1;
    }

    pub(super) fn pop(&mut self) -> Option<usize> {
        self.len = self.len.checked_sub(1)?;
        Some(self.entries[self.len] as usize)
    }
}
