//! The nearest places of other parts: a tree over triangles whose nodes know whose triangles they hold.

use crate::graph::ties::options::LOOSE;
use crate::mesh::query::bvh::ChildBoxes;
use crate::mesh::query::closest_point::closest_weights_on_triangle;
use crate::mesh::query::{NearVisitor, TriangleBvh};
use crate::pool::Pool;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// A node with triangles of several families.
const MIXED: u32 = u32::MAX - 1;
/// Other families that a vertex is tied to, at most.
const MOST_FAMILIES: usize = 3;
/// Triangles of other parts that are compared for one vertex, at most.
const MOST_COMPARED: usize = 256;
/// Triangles of any part that are looked at for one vertex, at most.
const MOST_SEEN: usize = 2048;
/// By how much of the largest coordinate a place that was computed may lie outside the box around its triangle: many times what
/// rounding does.
const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// A place on a triangle of another family.
#[derive(Debug, Clone, Copy)]
pub(super) struct NearPlace {
    family: u32,
    pub(super) triangle: u32,
    /// Weights of the triangle's corners; they add to 1.
    pub(super) shares: [f64; 3],
    /// Squared distance.
    pub(super) square: f64,
    /// Triangles whose boxes are further away than this, squared, are not nearer.
    gate: f64,
}

/// Triangles of all parts.
pub(super) struct PartTree<'a> {
    bvh: TriangleBvh<'a>,
    /// By vertex, or [`LOOSE`].
    families: &'a [u32],
    /// By place in the order of the leaves.
    family_of_place: Vec<u32>,
    /// By leaf, the boxes around its triangles.
    boxes: Vec<ChildBoxes>,
    /// How far a place that was computed may lie outside the box around its triangle.
    slack: f64,
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
        let (family_of_place, boxes) = pool.install(|| {
            let own = |&t: &u32| families[triangles[t as usize][0] as usize];
            let of_place = bvh.triangle_order().par_iter().with_min_len(1024).map(own).collect();
            (of_place, bvh.triangle_boxes())
        });
        let mut family_of_node: Vec<u32> = Vec::with_capacity(bvh.nodes().len());
        for (index, node) in bvh.nodes().iter().enumerate() {
            let below = node.first as usize..(node.first + node.count) as usize;
            let families: &Vec<u32> = if index < bvh.leaf_count() {
                &family_of_place
            } else {
                &family_of_node
            };
            let family = families[below].iter().copied().fold(LOOSE, join_families);
            family_of_node.push(family);
        }
        let largest = positions
            .iter()
            .fold(0.0, |most: f64, p| most.max(p.abs().max_element()));
        Self {
            bvh,
            families,
            family_of_place,
            boxes,
            slack: ROUNDING * largest,
            family_of_node,
        }
    }

    /// How far the box around a triangle may be, squared, if a place of that triangle can come out no further away than the root
    /// of `square`.
    fn widened_square(&self, square: f64) -> f64 {
        let most = square.sqrt() + self.slack;
        most * most * (1.0 + ROUNDING) + f64::MIN_POSITIVE
    }

    /// All vertices of the triangles, so that those next to each other in the list are close in space.
    pub(super) fn vertices_in_space_order(&self) -> Vec<u32> {
        self.bvh.vertices_in_space_order()
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
            gate: self.widened_square(reach * reach),
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
    /// Triangles whose boxes are further away than this, squared, are out of reach.
    gate: f64,
    compared: usize,
    seen: usize,
}

impl NearVisitor for PlaceSearch<'_, '_> {
    fn ignores_node(&self, node: usize) -> bool {
        let family = self.tree.family_of_node[node];
        family == self.own || family == LOOSE
    }

    fn skips_node(&self, node: usize, square: f64) -> bool {
        let family = self.tree.family_of_node[node];
        self.ignores_node(node) || self.found.iter().any(|f| f.family == family && f.square < square)
    }

    fn see_leaf(&mut self, leaf: usize, places: Range<usize>, limit: &mut f64) {
        let squares = self.tree.boxes[leaf].distances_squared(self.at);
        for (place, square) in places.zip(squares) {
            self.see_place(place, square, limit);
        }
    }
}

impl PlaceSearch<'_, '_> {
    /// Looks at a triangle, the box around which is the root of `box_square` away.
    fn see_place(&mut self, place: usize, box_square: f64, limit: &mut f64) {
        self.seen += 1;
        if self.seen >= MOST_SEEN || self.compared >= MOST_COMPARED {
            // Nothing is nearer than this, so the search ends.
            *limit = -1.0;
            return;
        }
        let family = self.tree.family_of_place[place];
        if family == self.own || family == LOOSE {
            return;
        }
        // What a box rules out counts too, so that it changes nothing but the time.
        self.compared += 1;
        if box_square > self.gate {
            return;
        }
        let known = self.found.iter().position(|f| f.family == family);
        if known.is_some_and(|known| box_square > self.found[known].gate) {
            return;
        }
        let bvh = &self.tree.bvh;
        let (shares, square) = closest_weights_on_triangle(self.at, bvh.corners(place));
        if square > *limit {
            return;
        }
        let near = NearPlace {
            family,
            triangle: bvh.triangle_order()[place],
            shares,
            square,
            gate: self.tree.widened_square(square),
        };
        let nearer = |a: &NearPlace, b: &NearPlace| (a.square, a.triangle) < (b.square, b.triangle);
        if let Some(known) = known {
            if nearer(&near, &self.found[known]) {
                self.found[known] = near;
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
            self.gate = self.tree.widened_square(limit.max(0.0));
        }
    }
}
