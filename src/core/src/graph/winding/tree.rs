//! The tree: a bounding-volume hierarchy whose nodes know their far fields.

use crate::graph::winding::moments::{FarField, Moments};
use crate::mesh::query::TriangleBvh;
use crate::mesh::query::bvh::FAN;
use crate::pool::Pool;
use glam::DVec3;
use rayon::prelude::*;

/// A tree over triangles that answers winding-number queries, and by its [`TriangleBvh`] all others.
///
/// Its shape depends on the triangles only. It is built in `n log n` time and holds about 80 bytes per triangle.
///
/// ```
/// use glam::DVec3;
/// use pliant_core::graph::WindingTree;
/// use pliant_core::pool::Pool;
///
/// let positions = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
/// let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
/// let tree = WindingTree::build(&positions, &tetrahedron, &Pool::new(1).expect("a thread"));
/// assert!(tree.contains(DVec3::splat(0.1)) && !tree.contains(DVec3::ONE));
/// ```
#[derive(Debug)]
pub struct WindingTree<'a> {
    pub(super) bvh: TriangleBvh<'a>,
    /// The nodes of `bvh`, in its order.
    pub(super) nodes: Vec<WindingNode>,
}

/// One node: its far field and its children.
#[derive(Debug, Clone, Copy)]
pub(super) struct WindingNode {
    /// Area-weighted centroid.
    pub(super) center: DVec3,
    /// No point of the node is further from `center`.
    pub(super) radius: f64,
    pub(super) field: FarField,
    /// First child: a place in the order of the leaves for leaves, a node for others.
    pub(super) first: u32,
    /// Number of children.
    pub(super) count: u32,
}

/// The moments of a node and how far its points lie from their centre.
struct NodeMoments {
    moments: Moments,
    radius: f64,
}

impl<'a> WindingTree<'a> {
    /// Sorts `triangles` into a tree.
    ///
    /// # Panics
    /// When a triangle names a position that does not exist.
    pub fn build(positions: &'a [DVec3], triangles: &'a [[u32; 3]], pool: &Pool) -> Self {
        let bvh = TriangleBvh::build(positions, triangles, pool);
        let mut tree = Self { bvh, nodes: Vec::new() };
        pool.install(|| {
            let mut level: Vec<NodeMoments> = (0..tree.bvh.leaf_count())
                .into_par_iter()
                .map(|leaf| tree.measure_leaf(leaf))
                .collect();
            let mut first = 0;
            while !level.is_empty() {
                let nodes = level.par_iter().enumerate();
                tree.nodes
                    .par_extend(nodes.map(|(i, measured)| measured.node(&tree.bvh, first + i)));
                if level.len() == 1 {
                    break;
                }
                let above = first + level.len();
                level = (above..above + level.len().div_ceil(4))
                    .into_par_iter()
                    .map(|node| tree.measure_inner(node, &level, first))
                    .collect();
                first = above;
            }
        });
        tree
    }

    /// The hierarchy over the same triangles, for all queries but the winding number.
    pub fn bvh(&self) -> &TriangleBvh<'a> {
        &self.bvh
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.bvh.byte_size() + self.nodes.capacity() * size_of::<WindingNode>()
    }

    fn measure_leaf(&self, leaf: usize) -> NodeMoments {
        let node = self.bvh.nodes()[leaf];
        let places = node.first as usize..(node.first + node.count) as usize;
        let mut corners = [[DVec3::ZERO; 3]; FAN];
        let count = places.len();
        corners
            .iter_mut()
            .zip(places)
            .for_each(|(own, place)| *own = self.bvh.corners(place));
        let parts = corners.map(Moments::from_triangle);
        let moments = Moments::from_parts(&parts[..count]);
        let points = corners[..count].iter().flatten();
        NodeMoments {
            radius: points.map(|p| p.distance(moments.center)).fold(0.0, f64::max),
            moments,
        }
    }

    /// Measures an inner node; `below` are the nodes of the level below, the first of which is `first`.
    fn measure_inner(&self, node: usize, below: &[NodeMoments], first: usize) -> NodeMoments {
        let children = self.bvh.nodes()[node];
        let begin = children.first as usize - first;
        let children = &below[begin..begin + children.count as usize];
        let parts: [Moments; FAN] = std::array::from_fn(|k| children[k.min(children.len() - 1)].moments);
        let moments = Moments::from_parts(&parts[..children.len()]);
        let mut radius = 0.0f64;
        for c in children {
            radius = radius.max(c.radius + c.moments.center.distance(moments.center));
        }
        let bounds = self.bvh.inner_bounds(node);
        let far_corner = (bounds.max - moments.center).max(moments.center - bounds.min);
        NodeMoments {
            moments,
            radius: radius.min(far_corner.length()),
        }
    }
}

impl NodeMoments {
    fn node(&self, bvh: &TriangleBvh<'_>, index: usize) -> WindingNode {
        let children = bvh.nodes()[index];
        WindingNode {
            center: self.moments.center,
            radius: self.radius,
            field: FarField::from_moments(&self.moments, self.radius),
            first: children.first,
            count: children.count,
        }
    }
}
