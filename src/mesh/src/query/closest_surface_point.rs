//! The closest point and the closest vertex of many triangles.
//!
//! Fans: the groups into which the faces around a vertex fall when neighbours share an edge at that vertex.
//!
//! Where a segment first meets many triangles.

use crate::adjacency::Components;
use crate::query::bvh::{ChildBoxes, FAN, NodeStack, TriangleBvh};
use crate::query::closest_point::closest_point_on_triangle;
use glam::DVec3;
use std::ops::Range;

/// A point of a surface that was found closest to a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// How far away it is.
    pub distance: f64,
    /// Where it is.
    pub point: DVec3,
    /// The triangle it lies on; of equally near ones the smallest.
    pub triangle: u32,
    /// The corner of that triangle nearest to the query.
    pub vertex: u32,
}

/// Visits the triangles near a point, nearest boxes first.
pub trait NearVisitor {
    /// Whether nothing below a node of the tree is wanted, whatever else is found.
    fn ignores_node(&self, _node: usize) -> bool {
        false
    }

    /// Whether a node of the tree, whose box is the root of `square` away, need not be looked into.
    fn skips_node(&self, _node: usize, _square: f64) -> bool {
        false
    }

    /// Visits the triangles of a leaf, given as places in the order of the leaves; may lower the squared distance that
    /// the search goes to.
    fn see_leaf(&mut self, leaf: usize, places: Range<usize>, limit: &mut f64);
}

impl<See: FnMut(usize, &mut f64)> NearVisitor for See {
    fn see_leaf(&mut self, _leaf: usize, places: Range<usize>, limit: &mut f64) {
        places.for_each(|place| self(place, limit));
    }
}

/// Finds the closest point of wanted triangles.
struct NearestWanted<'a, N, W> {
    tree: &'a TriangleBvh<'a>,
    point: DVec3,
    wanted_nodes: N,
    wanted: W,
    /// The squared distance, the triangle and the point on it.
    best: Option<(f64, u32, DVec3)>,
}

impl<N: Fn(usize) -> bool, W: Fn(u32) -> bool> NearVisitor for NearestWanted<'_, N, W> {
    fn ignores_node(&self, node: usize) -> bool {
        !(self.wanted_nodes)(node)
    }

    fn see_leaf(&mut self, _leaf: usize, places: Range<usize>, limit: &mut f64) {
        for place in places {
            let on = closest_point_on_triangle(self.point, self.tree.corners(place));
            let found = (on.distance_squared(self.point), self.tree.order[place]);
            if found.0 <= *limit && self.best.is_none_or(|b| found < (b.0, b.1)) && (self.wanted)(found.1) {
                *limit = found.0;
                self.best = Some((found.0, found.1, on));
            }
        }
    }
}

impl TriangleBvh<'_> {
    /// Finds the point of the surface that is closest to `point`; `None` when there are no triangles.
    pub fn closest_point(&self, point: DVec3) -> Option<SurfacePoint> {
        self.closest_point_within(point, f64::INFINITY)
    }

    /// Finds the closest point of the surface if it is not further away than `radius`.
    pub fn closest_point_within(&self, point: DVec3, radius: f64) -> Option<SurfacePoint> {
        self.closest_point_where(point, radius, &|_| true)
    }

    /// As [`TriangleBvh::closest_point_within`], of those triangles that are wanted.
    pub fn closest_point_where(
        &self,
        point: DVec3,
        radius: f64,
        wanted: &impl Fn(u32) -> bool,
    ) -> Option<SurfacePoint> {
        self.closest_point_below(point, radius, &|_| true, wanted)
    }

    /// As [`TriangleBvh::closest_point_where`], of triangles below wanted nodes alone: the search is as fast as if there were no others.
    pub fn closest_point_below(
        &self,
        point: DVec3,
        radius: f64,
        wanted_nodes: &impl Fn(usize) -> bool,
        wanted: &impl Fn(u32) -> bool,
    ) -> Option<SurfacePoint> {
        let mut nearest = NearestWanted {
            tree: self,
            point,
            wanted_nodes,
            wanted,
            best: None,
        };
        self.visit_near(point, radius * radius, &mut nearest);
        nearest.best.map(|(square, triangle, at)| SurfacePoint {
            distance: square.sqrt(),
            point: at,
            triangle,
            vertex: corner_near(self.positions, self.triangles[triangle as usize], point),
        })
    }

    /// For each node of the tree, what its triangles and the nodes below it come to, joined in the order of the tree.
    pub fn fold_nodes<T: Copy>(&self, of_triangle: impl Fn(u32) -> T, join: impl Fn(T, T) -> T) -> Vec<T> {
        let mut folded: Vec<T> = Vec::with_capacity(self.nodes.len());
        for (index, node) in self.nodes.iter().enumerate() {
            let of = |child: usize| match index < self.leaves {
                true => of_triangle(self.order[child]),
                false => folded[child],
            };
            let first = node.first as usize;
            let others = first + 1..first + node.count as usize;
            folded.push(others.map(of).fold(of(first), &join));
        }
        folded
    }

    /// Returns whether any triangle is nearer than `radius`.
    pub fn has_triangle_within(&self, point: DVec3, radius: f64) -> bool {
        let mut found = false;
        self.visit_near(point, radius * radius, &mut |place: usize, limit: &mut f64| {
            if !found && closest_point_on_triangle(point, self.corners(place)).distance_squared(point) < *limit {
                found = true;
                // Nothing is nearer than this, so the search ends.
                *limit = -1.0;
            }
        });
        found
    }

    /// Finds the triangle corner that is closest to `point`; of equally near ones the smallest. `None` without triangles.
    ///
    /// A vertex that is probably near, such as the answer for a neighbouring point, makes the search faster; it does
    /// not change the answer.
    ///
    /// # Panics
    /// When `near` is not a vertex.
    pub fn closest_vertex(&self, point: DVec3, near: Option<u32>) -> Option<u32> {
        let mut best = near.map(|v| (self.positions[v as usize].distance_squared(point), v));
        self.visit_near(
            point,
            best.map_or(f64::INFINITY, |b| b.0),
            &mut |place: usize, limit: &mut f64| {
                for v in self.triangles[self.order[place] as usize] {
                    let found = (self.positions[v as usize].distance_squared(point), v);
                    if best.is_none_or(|b| found < b) {
                        *limit = found.0;
                        best = Some(found);
                    }
                }
            },
        );
        best.map(|b| b.1)
    }

    /// Shows a visitor the triangles (as places in the order of the leaves) of all leaves whose box is not further than
    /// the square root of the limit, nearest boxes first; the visitor may lower the limit and leave nodes out.
    pub fn visit_near(&self, point: DVec3, mut limit: f64, visitor: &mut impl NearVisitor) {
        let Some(root) = self.nodes.len().checked_sub(1) else {
            return;
        };
        let mut waiting = [(0.0f64, 0u32); 64];
        waiting[0].1 = root as u32;
        let (mut len, mut visits) = (1, 0);
        while len > 0 {
            (len, visits) = (len - 1, visits + 1);
            let (square, index) = waiting[len];
            if square > limit || visitor.skips_node(index as usize, square) {
                continue;
            }
            let node = &self.nodes[index as usize];
            let Some(inner) = (index as usize).checked_sub(self.leaves) else {
                let places = node.first as usize..(node.first + node.count) as usize;
                visitor.see_leaf(index as usize, places, &mut limit);
                continue;
            };
            let squares = self.boxes[inner].distances_squared(point);
            let mut near: [(f64, u32, bool); FAN] = std::array::from_fn(|child| {
                let there = (child as u32) < node.count;
                let square = if there { squares[child] } else { f64::INFINITY };
                let index = node.first + child as u32;
                let within = square <= limit && square < f64::INFINITY;
                (square, index, within && !visitor.ignores_node(index as usize))
            });
            // Farthest first onto the stack, so that the nearest is visited next. One alone needs no order.
            if near.iter().filter(|n| n.2).count() > 1 {
                for (i, j) in [(0, 1), (2, 3), (0, 2), (1, 3), (1, 2)] {
                    let (a, b) = (near[i], near[j]);
                    let swapped = a.0 < b.0;
                    near[i] = if swapped { b } else { a };
                    near[j] = if swapped { a } else { b };
                }
            }
            for (square, index, _) in near.into_iter().filter(|n| n.2) {
                waiting[len] = (square, index);
                len += 1;
            }
        }
        self.visits.add(visits);
    }
}

/// The corner of a triangle that is closest to `point`; of equally close ones the smallest.
pub fn corner_near(positions: &[DVec3], [a, b, c]: [u32; 3], point: DVec3) -> u32 {
    let distance = |v: u32| positions[v as usize].distance_squared(point);
    let nearer = |x: u32, y: u32| if (distance(y), y) < (distance(x), x) { y } else { x };
    nearer(nearer(a, b), c)
}

/// Groups the faces around a vertex: answers the fan of each face, numbered in the order of the first face of each, and how
/// many fans there are.
///
/// A spoke is an edge from the vertex to another, given as that other vertex and the face (below `faces`) that has the edge.
/// Faces with a common spoke are in one fan.
///
/// ```
/// use pliant_mesh::query::closest_surface_point::group_fans;
///
/// // Faces 0 and 1 share the spoke to vertex 8; face 2 has spokes of its own.
/// let spokes = [(7, 0), (8, 0), (8, 1), (9, 1), (4, 2), (5, 2)];
/// assert_eq!(group_fans(3, spokes), (vec![0, 0, 1], 2));
/// ```
pub fn group_fans(faces: usize, spokes: impl IntoIterator<Item = (u32, u32)>) -> (Vec<u32>, usize) {
    let mut spokes: Vec<(u32, u32)> = spokes.into_iter().collect();
    spokes.sort_unstable();
    let shared = spokes.windows(2).filter(|pair| pair[0].0 == pair[1].0);
    let fans = Components::of_edges(faces, shared.map(|pair| (pair[0].1, pair[1].1)));
    (fans.of_vertex, fans.count)
}

/// Returns whether directed links make one path or one ring. Each face around a vertex gives one link, from its corner
/// after the vertex to its corner before it; so the faces make one fan, open or closed, of one winding. Sorts links.
pub fn is_single_oriented_fan(links: &mut [(u32, u32)]) -> bool {
    links.sort_unstable();
    if links.is_empty() || links.windows(2).any(|l| l[0].0 == l[1].0) {
        return false;
    }
    let mut ends: Vec<u32> = links.iter().map(|l| l.1).collect();
    ends.sort_unstable();
    if ends.windows(2).any(|e| e[0] == e[1]) {
        return false;
    }
    // An open fan begins at the one corner that no link leads to; a ring begins anywhere.
    let mut starts = links.iter().map(|l| l.0).filter(|s| ends.binary_search(s).is_err());
    let start = starts.next().unwrap_or(links[0].0);
    if starts.next().is_some() {
        return false;
    }
    let mut here = start;
    for step in 0..links.len() {
        let Ok(i) = links.binary_search_by_key(&here, |l| l.0) else {
            return false;
        };
        here = links[i].1;
        if here == start {
            return step + 1 == links.len();
        }
    }
    true
}

#[cfg(test)]
mod fan_tests {
    use super::*;

    #[test]
    fn rings_and_paths_are_fans_and_pairs_of_them_are_not() {
        assert!(is_single_oriented_fan(&mut [(1, 2), (3, 1), (2, 3)]), "a ring");
        assert!(is_single_oriented_fan(&mut [(7, 2), (2, 5)]), "an open fan");
        assert!(!is_single_oriented_fan(&mut [(1, 2), (3, 4)]), "two leaves that touch");
        assert!(
            !is_single_oriented_fan(&mut [(1, 2), (2, 1), (3, 4), (4, 3)]),
            "two rings"
        );
        assert!(!is_single_oriented_fan(&mut [(1, 2), (3, 2)]), "a leaf turned over");
        assert!(!is_single_oriented_fan(&mut [(1, 2), (1, 3)]), "three faces at an edge");
        assert!(
            !is_single_oriented_fan(&mut [(1, 2), (3, 4), (4, 3)]),
            "a leaf and a ring"
        );
        assert!(!is_single_oriented_fan(&mut []));
    }
}

/// The place where a segment first meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentHit {
    /// How far along the segment, 0 to 1.
    pub along: f64,
    /// Where it is.
    pub point: DVec3,
    /// The triangle; of several at one place the smallest.
    pub triangle: u32,
    /// The corner of that triangle nearest to the crossing.
    pub vertex: u32,
}

impl TriangleBvh<'_> {
    /// Finds the first triangle that the segment crosses or touches, leaving out those with the corner `except`.
    pub fn first_hit(&self, from: DVec3, to: DVec3, except: Option<u32>) -> Option<SegmentHit> {
        let segment = PreparedSegment::new(from, to);
        let mut best: Option<(f64, u32)> = None;
        let mut visits = 0;
        let mut stack = NodeStack::new(self);
        while let Some(index) = stack.pop() {
            visits += 1;
            let node = &self.nodes[index];
            if index >= self.leaves {
                let boxes = &self.boxes[index - self.leaves];
                let until = best.map_or(1.0, |b| b.0);
                let met = segment.meets(boxes, until);
                let met = (0..node.count).filter(|&child| met[child as usize]);
                met.for_each(|child| stack.push(node.first + child));
                continue;
            }
            for place in node.first as usize..(node.first + node.count) as usize {
                let triangle = self.order[place];
                if except.is_some_and(|v| self.triangles[triangle as usize].contains(&v)) {
                    continue;
                }
                if let Some(along) = crossing(from, segment.direction, self.corners(place))
                    && best.is_none_or(|b| (along, triangle) < b)
                {
                    best = Some((along, triangle));
                }
            }
        }
        self.visits.add(visits);
        best.map(|(along, triangle)| {
            let point = from + segment.direction * along;
            SegmentHit {
                along,
                point,
                triangle,
                vertex: corner_near(self.positions, self.triangles[triangle as usize], point),
            }
        })
    }
}

/// A segment prepared for box tests.
struct PreparedSegment {
    from: DVec3,
    direction: DVec3,
    inverse: DVec3,
    /// Boxes are widened by this, so that rounding never hides a crossing on a face of the box.
    margin: f64,
}

impl PreparedSegment {
    fn new(from: DVec3, to: DVec3) -> Self {
        let direction = to - from;
        let margin = from.abs().max(to.abs()).max_element() * 1e-14;
        Self {
            from,
            direction,
            inverse: direction.recip(),
            margin,
        }
    }

    /// Which of the boxes the segment meets no later than `until` along it.
    #[inline]
    fn meets(&self, boxes: &ChildBoxes, until: f64) -> [bool; FAN] {
        let (mut enter, mut leave) = ([0.0f64; FAN], [until; FAN]);
        for axis in 0..3 {
            let (from, inverse) = (self.from[axis], self.inverse[axis]);
            let (min, max) = (&boxes.min[axis], &boxes.max[axis]);
            for child in 0..FAN {
                let a = (min[child] - self.margin - from) * inverse;
                let b = (max[child] + self.margin - from) * inverse;
                // Zero times infinity is not a number: the segment runs in the face of the box, which limits nothing.
                let (low, high) = if a <= b {
                    (a, b)
                } else if b < a {
                    (b, a)
                } else {
                    (f64::NEG_INFINITY, f64::INFINITY)
                };
                enter[child] = if low > enter[child] { low } else { enter[child] };
                leave[child] = if high < leave[child] { high } else { leave[child] };
            }
        }
        std::array::from_fn(|child| enter[child] <= leave[child])
    }
}

/// Where along the segment it meets a triangle (Möller and Trumbore 1997); edges belong to the triangle.
pub(super) fn crossing(from: DVec3, direction: DVec3, [a, b, c]: [DVec3; 3]) -> Option<f64> {
    let (ab, ac) = (b - a, c - a);
    let p = direction.cross(ac);
    let determinant = ab.dot(p);
    if determinant == 0.0 {
        return None;
    }
    let s = from - a;
    let u = s.dot(p) / determinant;
    let q = s.cross(ab);
    let v = direction.dot(q) / determinant;
    let along = ac.dot(q) / determinant;
    let slack = -1e-12;
    (u >= slack && v >= slack && u + v <= 1.0 - slack && (0.0..=1.0).contains(&along)).then_some(along)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_exec::pool::Pool;

    #[test]
    fn the_tree_finds_what_a_search_over_all_finds() {
        let (points, faces) = crate::testing::scattered_triangles(300, DVec3::ONE, 3);
        let tree = TriangleBvh::build(&points, &faces, &Pool::new(2).expect("a pool"));
        let corners = |t: &[u32; 3]| t.map(|v| points[v as usize]);
        for i in 0..200usize {
            let (q, to) = (
                points[(i * 37) % points.len()] * 1.3 - DVec3::splat(0.11),
                points[(i * 91) % points.len()],
            );
            let near = tree.closest_point(q).expect("triangles");
            let best = faces
                .iter()
                .map(|t| closest_point_on_triangle(q, corners(t)).distance(q))
                .fold(9.0, f64::min);
            assert!((near.distance - best).abs() < 1e-12 && (near.point.distance(q) - best).abs() < 1e-12);
            assert_eq!(tree.closest_point_within(q, best * 0.999), None);
            assert_eq!(tree.closest_point_within(q, best * 1.001), Some(near));
            let vertex = tree.closest_vertex(q, Some((i % 5) as u32)).expect("triangles");
            assert!(
                points
                    .iter()
                    .all(|p| p.distance(q) >= points[vertex as usize].distance(q))
            );
            let first = faces
                .iter()
                .filter_map(|t| crossing(q, to - q, corners(t)))
                .fold(2.0, f64::min);
            assert_eq!(tree.first_hit(q, to, None).map_or(2.0, |h| h.along), first);
        }
    }

    #[test]
    fn faces_around_the_excepted_corner_do_not_count() {
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let faces = [[0, 1, 2]];
        let tree = TriangleBvh::build(&p, &faces, &Pool::new(1).expect("a pool"));
        let (from, to) = (DVec3::new(0.2, 0.2, 1.0), DVec3::new(0.2, 0.2, -1.0));
        let hit = tree.first_hit(from, to, None).expect("a crossing");
        assert_eq!((hit.along, hit.triangle, hit.vertex), (0.5, 0, 0));
        assert_eq!(tree.first_hit(from, to, Some(2)), None);
        assert_eq!(tree.first_hit(from, DVec3::new(0.2, 0.2, 0.5), None), None);
    }
}
