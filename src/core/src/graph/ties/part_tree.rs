//! The nearest places of other parts: a tree over triangles whose nodes know whose triangles they hold.

use crate::graph::ties::options::LOOSE;
use crate::mesh::query::closest_point::closest_weights_on_triangle;
use crate::mesh::query::{NearVisitor, TriangleBvh};
use crate::pool::Pool;
use glam::DVec3;

/// A node with triangles of several families.
const MIXED: u32 = u32::MAX - 1;
/// Other families that a vertex is tied to, at most.
const MOST_FAMILIES: usize = 3;
/// Triangles of other parts that are compared for one vertex, at most.
const MOST_COMPARED: usize = 256;
/// Triangles of any part that are looked at for one vertex, at most.
const MOST_SEEN: usize = 2048;

/// A place on a triangle of another family.
#[derive(Debug, Clone, Copy)]
pub(super) struct NearPlace {
    family: u32,
    pub(super) triangle: u32,
    /// Weights of the triangle's corners; they add to 1.
    pub(super) shares: [f64; 3],
    /// Squared distance.
    pub(super) square: f64,
}

/// Triangles of all parts.
pub(super) struct PartTree<'a> {
    bvh: TriangleBvh<'a>,
    /// By vertex, or [`LOOSE`].
    families: &'a [u32],
    /// By node of the tree: the family of all its triangles, [`MIXED`], or [`LOOSE`] where none may be tied.
    family_of_node: Vec<u32>,
}

impl<'a> PartTree<'a> {
    pub(super) fn build_tree(
        positions: &'a [DVec3],
        triangles: &'a [[u32; 3]],
        families: &'a [u32],
        pool: &Pool,
    ) -> Self {
        let bvh = TriangleBvh::build(positions, triangles, pool);
        let mut family_of_node: Vec<u32> = Vec::with_capacity(bvh.nodes().len());
        for (index, node) in bvh.nodes().iter().enumerate() {
            let below = node.first as usize..(node.first + node.count) as usize;
            let family = if index < bvh.leaf_count() {
                let own = |&t: &u32| families[triangles[t as usize][0] as usize];
                bvh.triangle_order()[below].iter().map(own).fold(LOOSE, join_families)
            } else {
                family_of_node[below].iter().copied().fold(LOOSE, join_families)
            };
            family_of_node.push(family);
        }
        Self {
            bvh,
            families,
            family_of_node,
        }
    }

    /// Finds the nearest place on each of the nearest families other than that of `vertex`, no further than `reach` from it;
    /// nearest first, of equally near ones that of the smaller triangle.
    pub(super) fn nearest_places(&self, vertex: u32, at: DVec3, reach: f64, found: &mut Vec<NearPlace>) {
        found.clear();
        let own = self.families[vertex as usize];
        if own == LOOSE {
            return;
        }
        let mut search = PlaceSearch {
            tree: self,
            at,
            own,
            found,
            compared: 0,
            seen: 0,
        };
        self.bvh.visit_near(at, reach * reach, &mut search);
        found.sort_by(|a, b| a.square.total_cmp(&b.square).then(a.triangle.cmp(&b.triangle)));
    }
}

fn join_families(a: u32, b: u32) -> u32 {
    match (a, b) {
        (LOOSE, other) | (other, LOOSE) => other,
        (a, b) if a == b => a,
        _ => MIXED,
    }
}

/// A search under way.
struct PlaceSearch<'a, 'b> {
    tree: &'a PartTree<'a>,
    at: DVec3,
    own: u32,
    found: &'b mut Vec<NearPlace>,
    compared: usize,
    seen: usize,
}

impl NearVisitor for PlaceSearch<'_, '_> {
    fn skips_node(&self, node: usize, square: f64) -> bool {
        let family = self.tree.family_of_node[node];
        let nearer = || self.found.iter().any(|f| f.family == family && f.square < square);
        family == self.own || family == LOOSE || nearer()
    }

    fn see_triangle(&mut self, place: usize, limit: &mut f64) {
        self.seen += 1;
        if self.seen >= MOST_SEEN || self.compared >= MOST_COMPARED {
            // Nothing is nearer than this, so the search ends.
            *limit = -1.0;
            return;
        }
        let bvh = &self.tree.bvh;
        let triangle = bvh.triangle_order()[place];
        let corner = bvh.triangles()[triangle as usize][0] as usize;
        let family = self.tree.families[corner];
        if family == self.own || family == LOOSE {
            return;
        }
        self.compared += 1;
        let (shares, square) = closest_weights_on_triangle(self.at, bvh.corners(place));
        if square > *limit {
            return;
        }
        let near = NearPlace {
            family,
            triangle,
            shares,
            square,
        };
        let nearer = |a: &NearPlace, b: &NearPlace| (a.square, a.triangle) < (b.square, b.triangle);
        if let Some(known) = self.found.iter_mut().find(|f| f.family == family) {
            if nearer(&near, known) {
                *known = near;
            }
        } else if self.found.len() < MOST_FAMILIES {
            self.found.push(near);
        } else if let Some(farthest) = self.found.iter_mut().reduce(|a, b| if nearer(a, b) { b } else { a })
            && nearer(&near, farthest)
        {
            *farthest = near;
        }
        if self.found.len() == MOST_FAMILIES {
            let farthest = self.found.iter().map(|f| f.square).fold(0.0, f64::max);
            *limit = limit.min(farthest);
        }
    }
}
