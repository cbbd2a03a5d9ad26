//! The bounding-volume hierarchy: triangles sorted along a Morton curve, four to a leaf, four nodes to a node above.

use crate::measure::BoundingBox;
use crate::query::visits::VisitCount;
use glam::DVec3;
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// Triangles per leaf and nodes per inner node.
pub(crate) const FAN: usize = 4;

/// A bounding-volume hierarchy over triangles that answers closest-point, crossing and overlap queries.
///
/// Its shape depends on the triangles only. It is built in `n log n` time and holds about 30 bytes per triangle.
///
/// ```
/// use glam::DVec3;
/// use pliant_mesh::query::TriangleBvh;
/// use pliant_exec::pool::Pool;
///
/// let positions = [DVec3::ZERO, DVec3::X, DVec3::Y];
/// let triangles = [[0, 1, 2]];
/// let bvh = TriangleBvh::build(&positions, &triangles, &Pool::new(1).expect("a thread"));
///
/// let closest = bvh.closest_point(DVec3::new(0.25, 0.25, 2.0)).expect("a triangle");
/// assert_eq!((closest.distance, closest.point), (2.0, DVec3::new(0.25, 0.25, 0.0)));
///
/// let hit = bvh.first_hit(DVec3::new(0.2, 0.2, 1.0), DVec3::new(0.2, 0.2, -1.0), None);
/// assert_eq!(hit.expect("a crossing").along, 0.5);
/// ```
#[derive(Debug)]
pub struct TriangleBvh<'a> {
    pub(super) positions: &'a [DVec3],
    pub(super) triangles: &'a [[u32; 3]],
    /// Triangle numbers in the order of the leaves.
    pub(super) order: Vec<u32>,
    /// Leaves first, then each level above; the root is last.
    pub(super) nodes: Vec<BvhNode>,
    pub(super) leaves: usize,
    /// Boxes around the children of each inner node.
    pub(super) boxes: Vec<ChildBoxes>,
    /// What long queries have looked at.
    pub visits: VisitCount,
}

/// The children of one node of a [`TriangleBvh`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct BvhNode {
    /// First child: a place in the order of the leaves for leaves, a node for others.
    pub(crate) first: u32,
    /// Number of children.
    pub(crate) count: u32,
}

/// The boxes around up to four children, laid out so that four are tested at once.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ChildBoxes {
    /// By axis, then by child.
    pub(super) min: [[f64; FAN]; 3],
    pub(super) max: [[f64; FAN]; 3],
}

impl<'a> TriangleBvh<'a> {
    /// Sorts `triangles` into a hierarchy.
    ///
    /// # Panics
    /// When a triangle names a position that does not exist.
    pub fn build(positions: &'a [DVec3], triangles: &'a [[u32; 3]], pool: &Pool) -> Self {
        pool.install(|| {
            let mut bvh = Self {
                positions,
                triangles,
                order: morton_order(positions, triangles),
                nodes: Vec::new(),
                leaves: triangles.len().div_ceil(FAN),
                boxes: Vec::new(),
                visits: VisitCount::default(),
            };
            let mut level: Vec<BoundingBox> = (0..bvh.leaves).into_par_iter().map(|i| bvh.leaf_bounds(i)).collect();
            let (mut first, mut below) = (0, triangles.len());
            while !level.is_empty() {
                bvh.nodes.extend(group_nodes(first, below));
                if level.len() == 1 {
                    break;
                }
                (first, below) = (bvh.nodes.len() - level.len(), level.len());
                bvh.boxes.par_extend(level.par_chunks(FAN).map(ChildBoxes::around));
                level = level.par_chunks(FAN).map(join_bounds).collect();
            }
            bvh
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

    /// Lists the corners of all triangles, each once, so that vertices next to each other in the list are close in space.
    pub fn vertices_in_space_order(&self) -> Vec<u32> {
        let mut seen = vec![false; self.positions.len()];
        let corners = self.order.iter().flat_map(|&t| self.triangles[t as usize]);
        corners
            .filter(|&v| !std::mem::replace(&mut seen[v as usize], true))
            .collect()
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.order.capacity() * size_of::<u32>()
            + self.nodes.capacity() * size_of::<BvhNode>()
            + self.boxes.capacity() * size_of::<ChildBoxes>()
    }

    /// Triangle numbers in the order of the leaves.
    pub fn triangle_order(&self) -> &[u32] {
        &self.order
    }

    /// The corners of the triangle at a place in the order of the leaves.
    pub(crate) fn corners(&self, place: usize) -> [DVec3; 3] {
        self.triangles[self.order[place] as usize].map(|v| self.positions[v as usize])
    }

    /// The boxes around the triangles of each leaf.
    pub(crate) fn triangle_boxes(&self) -> Vec<ChildBoxes> {
        let bounds = |place: usize| BoundingBox::of(&self.corners(place));
        let leaf = |node: &BvhNode| {
            let places = node.first as usize..(node.first + node.count) as usize;
            let mut boxes = [BoundingBox::of(&[]); FAN];
            let count = places.len();
            boxes
                .iter_mut()
                .zip(places)
                .for_each(|(own, place)| *own = bounds(place));
            ChildBoxes::around(&boxes[..count])
        };
        self.nodes[..self.leaves]
            .par_iter()
            .with_min_len(256)
            .map(leaf)
            .collect()
    }

    /// All nodes: leaves first, then each level above; the root is last.
    pub(crate) fn nodes(&self) -> &[BvhNode] {
        &self.nodes
    }

    /// Number of leaves.
    pub(crate) fn leaf_count(&self) -> usize {
        self.leaves
    }

    /// The box around an inner node.
    pub(crate) fn inner_bounds(&self, node: usize) -> BoundingBox {
        let boxes = &self.boxes[node - self.leaves];
        let corner = |of: &[[f64; FAN]; 3], child: usize| DVec3::from_array([0, 1, 2].map(|axis| of[axis][child]));
        let children: [BoundingBox; FAN] = std::array::from_fn(|child| BoundingBox {
            min: corner(&boxes.min, child),
            max: corner(&boxes.max, child),
        });
        join_bounds(&children[..self.nodes[node].count as usize])
    }

    /// Shows `see` the places from `from` on, in the order of the leaves, of leaves whose box overlaps or touches `bounds`.
    pub(crate) fn visit_overlapping(&self, bounds: &BoundingBox, from: usize, mut see: impl FnMut(usize)) {
        let Some(root) = self.nodes.len().checked_sub(1) else {
            return;
        };
        // Places that a full node of the root's height spans.
        let mut span = FAN;
        while span < self.order.len() {
            span *= FAN;
        }
        let mut waiting = [(0u32, 0usize, 0usize); 64];
        waiting[0] = (root as u32, 0, span);
        let mut len = 1;
        while len > 0 {
            len -= 1;
            let (index, start, span) = waiting[len];
            let node = &self.nodes[index as usize];
            let Some(inner) = (index as usize).checked_sub(self.leaves) else {
                (start.max(from)..node.first as usize + node.count as usize).for_each(&mut see);
                continue;
            };
            let overlaps = self.boxes[inner].overlap(bounds);
            let below = span / FAN;
            for child in (0..node.count as usize).rev() {
                let child_start = start + child * below;
                if overlaps[child] && child_start + below > from {
                    waiting[len] = (node.first + child as u32, child_start, below);
                    len += 1;
                }
            }
        }
    }
}

impl TriangleBvh<'_> {
    fn leaf_bounds(&self, leaf: usize) -> BoundingBox {
        let places = leaf * FAN..((leaf + 1) * FAN).min(self.order.len());
        let first = self.corners(places.start)[0];
        let point = BoundingBox { min: first, max: first };
        places.fold(point, |all, place| {
            let [a, b, c] = self.corners(place);
            BoundingBox {
                min: all.min.min(a).min(b).min(c),
                max: all.max.max(a).max(b).max(c),
            }
        })
    }
}

/// The nodes above `below` children, the first of which is `first`.
fn group_nodes(first: usize, below: usize) -> impl Iterator<Item = BvhNode> {
    (0..below).step_by(FAN).map(move |child| BvhNode {
        first: (first + child) as u32,
        count: FAN.min(below - child) as u32,
    })
}

fn join_bounds(parts: &[BoundingBox]) -> BoundingBox {
    let mut all = parts[0];
    for part in parts {
        all.min = all.min.min(part.min);
        all.max = all.max.max(part.max);
    }
    all
}

impl ChildBoxes {
    fn around(children: &[BoundingBox]) -> Self {
        let by = |of: fn(&BoundingBox) -> DVec3| {
            let corner = |child: usize| children.get(child).map_or(DVec3::NAN, of);
            std::array::from_fn(|axis| std::array::from_fn(|child| corner(child)[axis]))
        };
        Self {
            min: by(|b| b.min),
            max: by(|b| b.max),
        }
    }

    /// Squared distances from `p`; anything for children that are not there.
    #[inline]
    pub(crate) fn distances_squared(&self, p: DVec3) -> [f64; FAN] {
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

    /// Which of the boxes overlap or touch `bounds`.
    #[inline]
    fn overlap(&self, bounds: &BoundingBox) -> [bool; FAN] {
        let mut overlaps = [true; FAN];
        for axis in 0..3 {
            for child in 0..FAN {
                overlaps[child] &=
                    self.min[axis][child] <= bounds.max[axis] && bounds.min[axis] <= self.max[axis][child];
            }
        }
        overlaps
    }
}

/// Triangle numbers sorted by the Morton code of their centroids, 21 bits an axis, then by number.
fn morton_order(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<u32> {
    let middle = |t: &[u32; 3]| t.iter().map(|&v| positions[v as usize]).sum::<DVec3>() / 3.0;
    let middles: Vec<DVec3> = triangles.par_iter().map(middle).collect();
    let bounds = BoundingBox::of(&middles);
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
pub(crate) struct NodeStack {
    entries: [u32; 64],
    len: usize,
}

impl NodeStack {
    /// Begins with the root.
    pub(crate) fn new(bvh: &TriangleBvh) -> Self {
        let mut stack = Self {
            entries: [0; 64],
            len: 0,
        };
        if !bvh.nodes.is_empty() {
            stack.push(bvh.nodes.len() as u32 - 1);
        }
        stack
    }

    pub(crate) fn push(&mut self, node: u32) {
        self.entries[self.len] = node;
        self.len += 1;
    }

    pub(crate) fn pop(&mut self) -> Option<usize> {
        self.len = self.len.checked_sub(1)?;
        Some(self.entries[self.len] as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlap_shows_each_place_of_touched_leaves_once() {
        // Triangles in a row, one unit apart.
        for count in [1u32, 4, 5, 17, 70, 300] {
            let positions: Vec<DVec3> = (0..count)
                .flat_map(|t| [DVec3::ZERO, DVec3::Y * 0.5, DVec3::Z * 0.5].map(|p| p + DVec3::X * f64::from(t)))
                .collect();
            let triangles: Vec<[u32; 3]> = (0..count).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
            let bvh = TriangleBvh::build(&positions, &triangles, &Pool::new(1).expect("a thread"));
            let middle = positions[3 * (count as usize / 2)];
            let near = BoundingBox {
                min: middle,
                max: middle,
            };
            for from in [0, count as usize / 2, count as usize] {
                let mut seen = Vec::new();
                bvh.visit_overlapping(&near, from, |place| seen.push(place));
                assert!(seen.is_sorted() && seen.windows(2).all(|w| w[0] != w[1]) && seen.len() <= 3 * FAN);
                let own = bvh.order.iter().position(|&t| t == count / 2).expect("sorted");
                assert_eq!(seen.contains(&own), own >= from, "{count} triangles from {from}");
            }
            let mut all = Vec::new();
            bvh.visit_overlapping(&BoundingBox::of(&positions), 0, |place| all.push(place));
            assert!(all.into_iter().eq(0..count as usize));
        }
    }
}
