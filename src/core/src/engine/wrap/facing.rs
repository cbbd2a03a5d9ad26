//! The closest place of a surface that faces a way. Where a thin leg is to become a thick one, the closest places of all its vertices
//! are on one side of the thick one; those that also face as the vertices do are all around it.

use super::target::barycentric;
use crate::mesh::query::closest_point::closest_point_on_triangle;
use crate::mesh::query::{NearVisitor, TriangleBvh};
use glam::DVec3;
use std::ops::Range;

/// Places count whose normals are less than 70° apart.
pub(in crate::engine) const LEAST_COSINE: f64 = 0.34;
/// The square of the difference of two such normals, of which the second may be shorter than 1.
const MOST_APART: f64 = 2.0 - 2.0 * LEAST_COSINE;

/// How far a place may be, and what differences of normals count.
#[derive(Debug, Clone, Copy)]
pub(super) struct FacingLimits {
    /// No place counts that is farther.
    pub within: f64,
    /// What a difference of normals of length 1 counts as, as a distance.
    pub turn: f64,
}

/// A point with the normal of the surface that it is of; zero where it is of none.
#[derive(Debug, Clone, Copy)]
pub(in crate::engine) struct OrientedPoint {
    pub point: DVec3,
    pub normal: DVec3,
}

/// A tree over a surface with normals.
pub(super) struct FacingTree<'a> {
    pub tree: TriangleBvh<'a>,
    /// By vertex, of unit length, or zero where there is none.
    normals: &'a [DVec3],
    /// By node of the tree, the least and the greatest coordinates of the normals below it.
    bounds: Vec<[DVec3; 2]>,
}

/// A place of a surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct FacingPlace {
    pub triangle: u32,
    pub point: DVec3,
    /// The cosine between its normal and that asked for.
    pub cosine: f64,
}

impl<'a> FacingTree<'a> {
    pub fn new(tree: TriangleBvh<'a>, normals: &'a [DVec3]) -> Self {
        let join = |a: [DVec3; 2], b: [DVec3; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        let of = |triangle: u32| {
            let [a, b, c] = tree.triangles()[triangle as usize].map(|v| [normals[v as usize]; 2]);
            join(a, join(b, c))
        };
        Self {
            bounds: tree.fold_nodes(of, join),
            tree,
            normals,
        }
    }

    /// The place for which the squares of the distance and of the difference of normals have the least sum; of equal ones that of the
    /// smallest triangle. Of each triangle its closest point is looked at, with what lies between the normals of its corners. A triangle
    /// that is probably near, such as the answer of the step before, makes the search faster and does not change the answer.
    pub fn closest(&self, asked: OrientedPoint, reach: FacingLimits, near: Option<u32>) -> Option<FacingPlace> {
        let mut search = FacingSearch::new(self, asked, reach);
        let mut limit = reach.within * reach.within;
        if let Some(triangle) = near {
            search.see(triangle, &mut limit);
        }
        self.tree.visit_near(asked.point, limit, &mut search);
        search.best.map(|b| b.1)
    }
}

/// Looks for one place.
struct FacingSearch<'a> {
    facing: &'a FacingTree<'a>,
    asked: OrientedPoint,
    turn_square: f64,
    /// The sum of squares, and the place.
    best: Option<(f64, FacingPlace)>,
}

impl<'a> FacingSearch<'a> {
    fn new(facing: &'a FacingTree<'a>, asked: OrientedPoint, reach: FacingLimits) -> Self {
        Self {
            facing,
            asked,
            turn_square: reach.turn * reach.turn,
            best: None,
        }
    }

    /// Looks at a triangle.
    fn see(&mut self, triangle: u32, limit: &mut f64) {
        let FacingTree { tree, normals, .. } = self.facing;
        let OrientedPoint { point, normal } = self.asked;
        let corners = tree.triangles()[triangle as usize];
        let at = corners.map(|v| tree.positions()[v as usize]);
        let on = closest_point_on_triangle(point, at);
        let square = on.distance_squared(point);
        if square > *limit {
            return;
        }
        let weights = barycentric(on, at);
        let there: DVec3 = (0..3).map(|k| normals[corners[k] as usize] * weights[k]).sum();
        let cosine = there.normalize_or_zero().dot(normal);
        let sum = square + self.turn_square * there.distance_squared(normal);
        if cosine >= LEAST_COSINE && self.best.is_none_or(|b| (sum, triangle) < (b.0, b.1.triangle)) {
            *limit = limit.min(sum);
            let found = FacingPlace {
                triangle,
                point: on,
                cosine,
            };
            self.best = Some((sum, found));
        }
    }
}

impl NearVisitor for FacingSearch<'_> {
    fn skips_node(&self, node: usize, square: f64) -> bool {
        let [least, most] = self.facing.bounds[node];
        let normal = self.asked.normal;
        let apart = normal.distance_squared(normal.clamp(least, most));
        apart > MOST_APART || self.best.is_some_and(|b| square + self.turn_square * apart > b.0)
    }

    fn see_leaf(&mut self, _leaf: usize, places: Range<usize>, limit: &mut f64) {
        let facing = self.facing;
        places.for_each(|place| self.see(facing.tree.triangle_order()[place], limit));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::shapes;
    use crate::engine::wrap::normals::smooth_normals;
    use crate::pool::Pool;

    /// All triangles looked at, one after the other.
    fn by_looking_at_all(facing: &FacingTree<'_>, asked: OrientedPoint, reach: FacingLimits) -> Option<u32> {
        let mut search = FacingSearch::new(facing, asked, reach);
        for triangle in 0..facing.tree.triangles().len() {
            search.see(triangle as u32, &mut (reach.within * reach.within));
        }
        search.best.map(|b| b.1.triangle)
    }

    #[test]
    fn the_tree_finds_what_looking_at_all_triangles_finds() {
        let (round, triangles) = shapes::icosphere(1.0, 3);
        let bent = |p: &DVec3| DVec3::new(p.x, 0.5 * p.y + p.x * p.x, 0.4 * p.z * (1.0 + p.x));
        let positions: Vec<DVec3> = round.iter().map(bent).collect();
        let normals = smooth_normals(&positions, &triangles);
        let pool = Pool::new(1).expect("a thread");
        let tree = TriangleBvh::build(&positions, &triangles, &pool);
        let facing = FacingTree::new(tree, &normals);
        let mut found = 0;
        for (k, normal) in round.iter().enumerate() {
            let asked = OrientedPoint {
                point: positions[(k * 97) % positions.len()] * 0.7,
                normal: *normal,
            };
            for turn in [0.0, 0.1, 0.5] {
                let reach = FacingLimits { within: 0.4, turn };
                let of_all = by_looking_at_all(&facing, asked, reach);
                for near in [None, Some(k as u32)] {
                    let place = facing.closest(asked, reach, near).map(|f| f.triangle);
                    assert_eq!(place, of_all, "{k} {turn} {near:?}");
                }
                found += usize::from(of_all.is_some());
            }
        }
        assert!(
            found > round.len(),
            "{found} of {} questions have an answer",
            3 * round.len()
        );
    }
}
