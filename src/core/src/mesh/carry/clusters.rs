//! The rest surface: a tree whose nodes stand for the triangles below them when seen from far away.

use crate::mesh::measure::BoundingBox;
use crate::mesh::query::TriangleBvh;
use crate::mesh::query::closest_point::closest_weights_on_triangle;
use crate::pool::Pool;
use glam::DVec3;
use rayon::prelude::*;

/// What a triangle without area weighs, as a fraction of the squared diagonal: a surface of nothing else has samples too.
const LEAST_AREA: f64 = 1e-12;

/// A rest surface, ready to carry points. It owns what it needs, about 150 bytes per triangle, and depends on the
/// triangles alone.
///
/// Its *samples* are the vertices, numbered as given, and after them the clusters: nodes of a bounding-volume hierarchy that
/// have an area, a centre of mass and a mean normal.
#[derive(Debug, Clone)]
pub struct CarrySurface {
    pub(super) rest: Vec<DVec3>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Triangle numbers in the order of the leaves.
    pub(super) order: Vec<u32>,
    /// What each triangle weighs, in that order.
    pub(super) weights: Vec<f64>,
    /// Leaves first, then each level above; the root is last.
    pub(super) nodes: Vec<ClusterNode>,
    pub(super) leaves: usize,
    /// Length of the diagonal of the box around all triangles.
    pub(super) diagonal: f64,
}

/// A node of the tree, as what it is seen as from afar.
#[derive(Debug, Clone, Copy)]
pub(super) struct ClusterNode {
    pub(super) bounds: BoundingBox,
    /// Centre of mass of its triangles.
    pub(super) center: DVec3,
    /// Mean of its unit normals; shorter than 1 where they differ.
    pub(super) normal: DVec3,
    /// What its triangles weigh together.
    pub(super) weight: f64,
    /// First child: a place in the order of the leaves for leaves, a node for others.
    pub(super) first: u32,
    /// Number of children.
    pub(super) count: u32,
}

/// The place of the surface that is closest to a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct NearestPlace {
    pub(super) distance: f64,
    pub(super) triangle: u32,
    /// Barycentric.
    pub(super) corners: [f64; 3],
}

impl CarrySurface {
    /// Sorts `triangles` over `rest` into a tree.
    ///
    /// # Panics
    /// When a triangle names a position that does not exist.
    pub fn build(rest: &[DVec3], triangles: &[[u32; 3]], pool: &Pool) -> Self {
        let bvh = TriangleBvh::build(rest, triangles, pool);
        let order = bvh.triangle_order().to_vec();
        let (leaves, shape) = (bvh.leaf_count(), bvh.nodes().to_vec());
        let diagonal = match shape.len().checked_sub(1) {
            Some(root) if root >= leaves => bvh.inner_bounds(root).diagonal(),
            _ => BoundingBox::of(&corner_points(rest, triangles)).diagonal(),
        };
        let floor = if diagonal > 0.0 {
            LEAST_AREA * diagonal * diagonal
        } else {
            1.0
        };
        let mut surface = Self {
            rest: rest.to_vec(),
            triangles: triangles.to_vec(),
            order,
            weights: Vec::new(),
            nodes: Vec::with_capacity(shape.len()),
            leaves,
            diagonal,
        };
        pool.install(|| {
            let area = |&t: &u32| 0.5 * surface.doubled_normal(t).length() + floor;
            surface.weights = surface.order.par_iter().map(area).collect();
            let leaf = |node: &_| surface.measure_leaf(node);
            let measured: Vec<ClusterNode> = shape[..leaves]
                .par_iter()
                .map(|node| leaf(&(node.first, node.count)))
                .collect();
            surface.nodes.extend(measured);
        });
        for node in &shape[leaves..] {
            let merged = surface.merge_children(node.first, node.count);
            surface.nodes.push(merged);
        }
        surface
    }

    /// Number of samples that points can follow: vertices and clusters.
    pub fn samples(&self) -> usize {
        self.rest.len() + self.nodes.len()
    }

    /// Number of vertices, whether a triangle uses them or not.
    pub fn vertices(&self) -> usize {
        self.rest.len()
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        size_of_val(self.rest.as_slice())
            + size_of_val(self.triangles.as_slice())
            + size_of_val(self.order.as_slice())
            + size_of_val(self.weights.as_slice())
            + size_of_val(self.nodes.as_slice())
    }

    /// The rest place of a sample.
    pub(super) fn sample_place(&self, sample: u32) -> DVec3 {
        match self.rest.get(sample as usize) {
            Some(&vertex) => vertex,
            None => self.nodes[sample as usize - self.rest.len()].center,
        }
    }

    pub(super) fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|v| self.rest[v as usize])
    }

    /// Perpendicular to a triangle, twice its area long.
    pub(super) fn doubled_normal(&self, triangle: u32) -> DVec3 {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(c - a)
    }

    fn measure_leaf(&self, &(first, count): &(u32, u32)) -> ClusterNode {
        let places = first as usize..(first + count) as usize;
        let points = corner_points(
            &self.rest,
            self.order[places.clone()].iter().map(|&t| &self.triangles[t as usize]),
        );
        let mut node = ClusterNode::empty(BoundingBox::of(&points), first, count);
        for place in places {
            let triangle = self.order[place];
            let middle = self.corners(triangle).iter().sum::<DVec3>() / 3.0;
            node.add(
                self.weights[place],
                middle,
                self.doubled_normal(triangle).normalize_or_zero(),
            );
        }
        node.finished()
    }

    fn merge_children(&self, first: u32, count: u32) -> ClusterNode {
        let children = &self.nodes[first as usize..(first + count) as usize];
        let mut node = ClusterNode::empty(children[0].bounds, first, count);
        for child in children {
            node.bounds.min = node.bounds.min.min(child.bounds.min);
            node.bounds.max = node.bounds.max.max(child.bounds.max);
            node.add(child.weight, child.center, child.normal);
        }
        node.finished()
    }

    /// Finds the place closest to `point`, of equally near triangles the first; `None` without triangles. Adds to `visits` how
    /// many nodes it looked at.
    pub(super) fn find_nearest(&self, point: DVec3, visits: &mut u64) -> Option<NearestPlace> {
        let root = self.nodes.len().checked_sub(1)?;
        let mut best = (f64::INFINITY, u32::MAX, [1.0, 0.0, 0.0]);
        // Sixteen levels, four children each, one of them taken off.
        let mut waiting = [(0.0f64, root as u32); 64];
        let mut len = 1;
        while len > 0 {
            len -= 1;
            *visits += 1;
            let (square, index) = waiting[len];
            if square > best.0 {
                continue;
            }
            let node = &self.nodes[index as usize];
            if (index as usize) < self.leaves {
                for &t in &self.order[node.first as usize..(node.first + node.count) as usize] {
                    let (corners, square) = closest_weights_on_triangle(point, self.corners(t));
                    if (square, t) < (best.0, best.1) {
                        best = (square, t, corners);
                    }
                }
                continue;
            }
            let begin = len;
            for child in node.first..node.first + node.count {
                let square = self.nodes[child as usize].distance_squared(point);
                if square <= best.0 {
                    waiting[len] = (square, child);
                    len += 1;
                }
            }
            // The nearest is visited next.
            waiting[begin..len].sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)));
        }
        (best.1 != u32::MAX).then(|| NearestPlace {
            distance: best.0.sqrt(),
            triangle: best.1,
            corners: best.2,
        })
    }
}

impl ClusterNode {
    fn empty(bounds: BoundingBox, first: u32, count: u32) -> Self {
        Self {
            bounds,
            center: DVec3::ZERO,
            normal: DVec3::ZERO,
            weight: 0.0,
            first,
            count,
        }
    }

    /// Adds a part; centre and normal are sums until [`ClusterNode::finished`] divides them.
    fn add(&mut self, weight: f64, center: DVec3, normal: DVec3) {
        self.weight += weight;
        self.center += center * weight;
        self.normal += normal * weight;
    }

    fn finished(mut self) -> Self {
        self.center /= self.weight;
        self.normal /= self.weight;
        self
    }

    /// Squared distance of the box from `point`; 0 inside.
    pub(super) fn distance_squared(&self, point: DVec3) -> f64 {
        let out = (self.bounds.min - point).max(point - self.bounds.max);
        out.max(DVec3::ZERO).length_squared()
    }
}

fn corner_points<'a>(rest: &[DVec3], triangles: impl IntoIterator<Item = &'a [u32; 3]>) -> Vec<DVec3> {
    let corners = triangles.into_iter().flatten();
    corners.map(|&v| rest[v as usize]).collect()
}
