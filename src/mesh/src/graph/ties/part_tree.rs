//! The nearest places of other parts: a tree over triangles whose nodes know whose triangles they hold.
//!
//! Which vertices are tied to which triangles, and how firmly.

use crate::BoundingBox;
use crate::graph::mesh_graph::MeshGraph;
use crate::graph::parallel::map_few;
use crate::graph::ties::part_ties::{LOOSE, TieAnchor, TieOptions, TieReach};
use crate::query::bvh::ChildBoxes;
use crate::query::closest_point::closest_weights_on_triangle;
use crate::query::{NearVisitor, TriangleBvh};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::Cancelled;
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
    fn build_tree(positions: &'a [DVec3], triangles: &'a [[u32; 3]], families: &'a [u32], pool: &Pool) -> Self {
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
    fn nearest_places(&self, vertex: u32, at: DVec3, reach: f64, found: &mut Vec<NearPlace>) {
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

/// The shortest and the longest reach that is chosen, as parts of the diagonal.
const REACH: [f64; 2] = [0.005, 0.02];
/// The reach that is chosen, in mean lengths of the edges around.
const REACH_IN_EDGES: f64 = 0.5;
/// What a tie weighs at the end of its reach,
const LIGHTEST: f64 = 1.0;
/// and what it weighs more where parts touch: some three times what all other edges of a vertex weigh together. With more,
/// those would count as weak when the hierarchy is built.
const FIRMNESS: f64 = 47.0;
/// Corners with a smaller share in a place get no edge.
const LEAST_SHARE: f64 = 0.05;
/// Vertices in one piece of work.
const RUN: usize = 1024;

/// The surface that ties are looked for on.
#[derive(Clone, Copy)]
pub(super) struct TieSite<'a> {
    /// The graph without ties. Its first rows have the lengths of edges.
    pub(super) graph: &'a MeshGraph,
    /// Triangles that ties may lead to.
    pub(super) triangles: &'a [[u32; 3]],
    /// The family of each vertex, or [`LOOSE`](super::part_ties::LOOSE).
    pub(super) families: &'a [u32],
    pub(super) reach: TieReach,
}

impl TieReach {
    /// The reach on a mesh within `bounds`.
    pub(super) fn from_options(options: &TieOptions, bounds: &BoundingBox) -> Self {
        let diagonal = bounds.diagonal();
        match options.distance {
            Some(distance) => Self {
                least: distance,
                most: distance,
            },
            None => Self {
                least: REACH[0] * diagonal,
                most: REACH[1] * diagonal,
            },
        }
    }
}

/// Finds what ties the vertices `asked`, which rise, to other parts.
pub(super) fn find_anchors(site: &TieSite, asked: &[u32], exec: &Exec<'_>) -> Result<Vec<TieAnchor>, Cancelled> {
    let surface = &site.graph.positions[..site.graph.surface];
    let tree = PartTree::build_tree(surface, site.triangles, site.families, exec.pool);
    let asked = in_space_order(&tree, asked, surface.len());
    let mut anchors: Vec<TieAnchor> = Vec::new();
    // Some runs at a time, with a look at the progress in between.
    for runs in asked.chunks(64 * RUN) {
        let runs: Vec<&[u32]> = runs.chunks(RUN).collect();
        let found = map_few(&runs, exec, |run| {
            let (mut anchors, mut places) = (Vec::new(), Vec::new());
            for &vertex in *run {
                exec.check()?;
                let reach = reach_of(site, vertex);
                tree.nearest_places(vertex, surface[vertex as usize], reach, &mut places);
                anchors.extend(places.iter().map(|place| anchor_at(site, vertex, place, reach)));
            }
            Ok::<_, Cancelled>(anchors)
        })?;
        found.into_iter().for_each(|found| anchors.extend(found));
    }
    // Those of one vertex lie next to each other and stay in their order.
    exec.pool.install(|| anchors.par_sort_by_key(|a| a.vertex));
    Ok(anchors)
}

/// The vertices `asked` in the order of the tree, so that one search finds in the cache what the last one read; those without
/// triangles last.
fn in_space_order(tree: &PartTree, asked: &[u32], vertices: usize) -> Vec<u32> {
    let mut waiting = vec![false; vertices];
    asked.iter().for_each(|&v| waiting[v as usize] = true);
    let mut order = tree.vertices_in_space_order();
    order.retain(|&v| std::mem::replace(&mut waiting[v as usize], false));
    order.extend(asked.iter().copied().filter(|&v| waiting[v as usize]));
    order
}

/// How far a vertex looks for other parts.
fn reach_of(site: &TieSite, vertex: u32) -> f64 {
    let TieReach { least, most } = site.reach;
    if least == most {
        return most;
    }
    let graph = site.graph;
    let at = |v: u32| graph.positions[v as usize];
    let around = graph.row(vertex).iter().take_while(|&&w| (w as usize) < graph.surface);
    let (length, edges) = around.fold((0.0, 0usize), |sum, &w| (sum.0 + at(vertex).distance(at(w)), sum.1 + 1));
    (REACH_IN_EDGES * length / edges.max(1) as f64).clamp(least, most)
}

/// The tie of a vertex to a place.
fn anchor_at(site: &TieSite, vertex: u32, place: &NearPlace, reach: f64) -> TieAnchor {
    let away = if reach > 0.0 {
        (place.square.sqrt() / reach).min(1.0)
    } else {
        0.0
    };
    let weight = LIGHTEST + FIRMNESS * (1.0 - away) * (1.0 - away);
    let shares = place.shares.map(|s| if s < LEAST_SHARE { 0.0 } else { s });
    let sum: f64 = shares.iter().sum();
    TieAnchor {
        vertex,
        corners: site.triangles[place.triangle as usize],
        weights: shares.map(|s| (weight * s / sum) as f32),
    }
}
