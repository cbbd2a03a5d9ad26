//! Nearest point, nearest vertex and first crossing.

use super::tree::{Boxes, FAN, Stack, WindingTree};
use glam::DVec3;

/// The point of the triangles that is nearest to a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// How far away it is.
    pub distance: f64,
    /// Where it is.
    pub point: DVec3,
    /// The triangle it lies on; of equally near ones the smallest.
    pub triangle: u32,
    /// The corner of that triangle nearest to the query.
    pub vertex: u32,
}

/// Where a segment first meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// How far along the segment, 0 to 1.
    pub along: f64,
    /// Where it is.
    pub point: DVec3,
    /// The triangle; of several at one place the smallest.
    pub triangle: u32,
    /// The corner of that triangle nearest to the crossing.
    pub vertex: u32,
}

impl WindingTree<'_> {
    /// The nearest point of the surface; `None` when there are no triangles.
    pub fn closest(&self, point: DVec3) -> Option<Nearest> {
        self.closest_within(point, f64::INFINITY)
    }

    /// The nearest point of the surface if it is not further than `radius`.
    pub fn closest_within(&self, point: DVec3, radius: f64) -> Option<Nearest> {
        let mut best: Option<(f64, u32, DVec3)> = None;
        self.visit_near(point, radius * radius, |place, limit| {
            let on = closest_on_triangle(point, self.corners(place));
            let found = (on.distance_squared(point), self.order[place]);
            if found.0 <= *limit && best.is_none_or(|b| found < (b.0, b.1)) {
                *limit = found.0;
                best = Some((found.0, found.1, on));
            }
        });
        best.map(|(square, triangle, at)| Nearest {
            distance: square.sqrt(),
            point: at,
            triangle,
            vertex: self.corner_near(triangle, point),
        })
    }

    /// Whether any triangle is nearer than `radius`.
    pub fn is_within(&self, point: DVec3, radius: f64) -> bool {
        let mut found = false;
        self.visit_near(point, radius * radius, |place, limit| {
            if !found && closest_on_triangle(point, self.corners(place)).distance_squared(point) < *limit {
                found = true;
                // Nothing is nearer than this, so the search ends.
                *limit = -1.0;
            }
        });
        found
    }

    /// The triangle corner nearest to `point`; of equally near ones the smallest. `None` without triangles.
    ///
    /// A vertex that is probably near, such as the answer for a neighbouring point, makes the search faster; it does
    /// not change the answer.
    ///
    /// # Panics
    /// When `near` is no vertex.
    pub fn closest_vertex(&self, point: DVec3, near: Option<u32>) -> Option<u32> {
        let mut best = near.map(|v| (self.positions[v as usize].distance_squared(point), v));
        self.visit_near(point, best.map_or(f64::INFINITY, |b| b.0), |place, limit| {
            for v in self.triangles[self.order[place] as usize] {
                let found = (self.positions[v as usize].distance_squared(point), v);
                if best.is_none_or(|b| found < b) {
                    *limit = found.0;
                    best = Some(found);
                }
            }
        });
        best.map(|b| b.1)
    }

    /// The first triangle that the segment crosses or touches, leaving out those with the corner `except`.
    pub fn first_hit(&self, from: DVec3, to: DVec3, except: Option<u32>) -> Option<Hit> {
        let ray = Ray::new(from, to);
        let mut best: Option<(f64, u32)> = None;
        let mut stack = Stack::new(self);
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index];
            if index >= self.leaves {
                let boxes = &self.boxes[index - self.leaves];
                let until = best.map_or(1.0, |b| b.0);
                let met = ray.meets(boxes, until);
                let met = (0..node.count).filter(|&child| met[child as usize]);
                met.for_each(|child| stack.push(node.first + child));
                continue;
            }
            for place in node.first as usize..(node.first + node.count) as usize {
                let triangle = self.order[place];
                if except.is_some_and(|v| self.triangles[triangle as usize].contains(&v)) {
                    continue;
                }
                if let Some(along) = crossing(from, ray.direction, self.corners(place))
                    && best.is_none_or(|b| (along, triangle) < b)
                {
                    best = Some((along, triangle));
                }
            }
        }
        best.map(|(along, triangle)| {
            let point = from + ray.direction * along;
            Hit {
                along,
                point,
                triangle,
                vertex: self.corner_near(triangle, point),
            }
        })
    }

    fn corner_near(&self, triangle: u32, point: DVec3) -> u32 {
        let distance = |v: u32| self.positions[v as usize].distance_squared(point);
        let [a, b, c] = self.triangles[triangle as usize];
        let nearer = |x: u32, y: u32| if (distance(y), y) < (distance(x), x) { y } else { x };
        nearer(nearer(a, b), c)
    }

    /// Shows `see` the triangles (as places in the order of the leaves) of all leaves whose box is not further than
    /// the square root of the limit, nearest boxes first; `see` may lower the limit.
    fn visit_near(&self, point: DVec3, mut limit: f64, mut see: impl FnMut(usize, &mut f64)) {
        let Some(root) = self.nodes.len().checked_sub(1) else {
            return;
        };
        let mut waiting = [(0.0f64, 0u32); 64];
        waiting[0].1 = root as u32;
        let mut len = 1;
        while len > 0 {
            len -= 1;
            let (square, index) = waiting[len];
            if square > limit {
                continue;
            }
            let node = &self.nodes[index as usize];
            let Some(inner) = (index as usize).checked_sub(self.leaves) else {
                (node.first as usize..(node.first + node.count) as usize).for_each(|place| see(place, &mut limit));
                continue;
            };
            let squares = self.boxes[inner].distances_squared(point);
            let mut near: [(f64, u32); FAN] = std::array::from_fn(|child| {
                let there = (child as u32) < node.count;
                (
                    if there { squares[child] } else { f64::INFINITY },
                    node.first + child as u32,
                )
            });
            // Farthest first onto the stack, so that the nearest is visited next.
            for (i, j) in [(0, 1), (2, 3), (0, 2), (1, 3), (1, 2)] {
                if near[i].0 < near[j].0 {
                    near.swap(i, j);
                }
            }
            for n in near.into_iter().filter(|n| n.0 <= limit && n.0 < f64::INFINITY) {
                waiting[len] = n;
                len += 1;
            }
        }
    }
}

/// A segment prepared for box tests.
struct Ray {
    from: DVec3,
    direction: DVec3,
    inverse: DVec3,
    /// Boxes are widened by this, so that rounding never hides a crossing on a face of the box.
    margin: f64,
}

impl Ray {
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
    fn meets(&self, boxes: &Boxes, until: f64) -> [bool; FAN] {
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
fn crossing(from: DVec3, direction: DVec3, [a, b, c]: [DVec3; 3]) -> Option<f64> {
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

/// The point of a triangle nearest to `p`, by the region of the plane that its foot lies in (Ericson 2005). A face
/// without area is its edges.
pub(in crate::graph) fn closest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let (ab, ac) = (b - a, c - a);
    let (d11, d12, d22) = (ab.length_squared(), ab.dot(ac), ac.length_squared());
    // Thin faces lose their regions to rounding; the nearest point of their edges is as good.
    if d11 * d22 - d12 * d12 <= d11 * d22 * 1e-12 {
        let nearer = |x: DVec3, y: DVec3| {
            if y.distance_squared(p) < x.distance_squared(p) {
                y
            } else {
                x
            }
        };
        return nearer(
            nearer(closest_on_segment(p, a, b), closest_on_segment(p, b, c)),
            closest_on_segment(p, c, a),
        );
    }
    let ap = p - a;
    let (a1, a2) = (ab.dot(ap), ac.dot(ap));
    if a1 <= 0.0 && a2 <= 0.0 {
        return a;
    }
    let (b1, b2) = (a1 - d11, a2 - d12);
    if b1 >= 0.0 && b2 <= b1 {
        return b;
    }
    let over_c = a1 * b2 - b1 * a2;
    if over_c <= 0.0 && a1 >= 0.0 && b1 <= 0.0 {
        return a + ab * (a1 / d11);
    }
    let (c1, c2) = (a1 - d12, a2 - d22);
    if c2 >= 0.0 && c1 <= c2 {
        return c;
    }
    let over_b = c1 * a2 - a1 * c2;
    if over_b <= 0.0 && a2 >= 0.0 && c2 <= 0.0 {
        return a + ac * (a2 / d22);
    }
    let over_a = b1 * c2 - c1 * b2;
    if over_a <= 0.0 && b2 >= b1 && c1 >= c2 {
        return b + (c - b) * ((b2 - b1) / ((b2 - b1) + (c1 - c2)));
    }
    let scale = 1.0 / (over_a + over_b + over_c);
    a + ab * (over_b * scale) + ac * (over_c * scale)
}

fn closest_on_segment(p: DVec3, a: DVec3, b: DVec3) -> DVec3 {
    let d = b - a;
    let square = d.length_squared();
    let t = if square > 0.0 {
        ((p - a).dot(d) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    a + d * t
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pool::Pool;

    fn soup(count: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut state = 3u64;
        let mut next = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 33) as f64 / (1u64 << 31) as f64
        };
        let mut points = Vec::new();
        for _ in 0..count {
            let middle = DVec3::new(next(), next(), next());
            points.extend((0..3).map(|_| middle + 0.1 * DVec3::new(next(), next(), next())));
        }
        let faces = (0..count as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        (points, faces)
    }

    #[test]
    fn the_tree_finds_what_a_search_over_all_finds() {
        let (points, faces) = soup(300);
        let tree = WindingTree::build(&points, &faces, &Pool::new(2).expect("a pool"));
        let corners = |t: &[u32; 3]| t.map(|v| points[v as usize]);
        for i in 0..200usize {
            let (q, to) = (
                points[(i * 37) % points.len()] * 1.3 - DVec3::splat(0.11),
                points[(i * 91) % points.len()],
            );
            let near = tree.closest(q).expect("triangles");
            let best = faces
                .iter()
                .map(|t| closest_on_triangle(q, corners(t)).distance(q))
                .fold(9.0, f64::min);
            assert!((near.distance - best).abs() < 1e-12 && (near.point.distance(q) - best).abs() < 1e-12);
            assert_eq!(tree.closest_within(q, best * 0.999), None);
            assert_eq!(tree.closest_within(q, best * 1.001), Some(near));
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
    fn nearest_points_are_right_on_faces_edges_corners_and_needles() {
        let t = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let cases = [
            ([0.2, 0.2, 3.0], [0.2, 0.2, 0.0]),
            ([0.4, -1.0, 0.0], [0.4, 0.0, 0.0]),
            ([2.0, -1.0, 1.0], [1.0, 0.0, 0.0]),
            ([1.0, 1.0, 0.0], [0.5, 0.5, 0.0]),
        ];
        for (p, expected) in cases {
            let found = closest_on_triangle(DVec3::from_array(p), t);
            assert!(found.distance(DVec3::from_array(expected)) < 1e-12, "{p:?} to {found}");
        }
        let needle = [DVec3::ZERO, DVec3::X, DVec3::X * 0.5];
        assert_eq!(
            closest_on_triangle(DVec3::new(0.3, 1.0, 0.0), needle),
            DVec3::new(0.3, 0.0, 0.0)
        );
        assert_eq!(closest_on_triangle(DVec3::Y, [DVec3::ZERO; 3]), DVec3::ZERO);
    }

    #[test]
    fn faces_around_the_excepted_corner_do_not_count() {
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let faces = [[0, 1, 2]];
        let tree = WindingTree::build(&p, &faces, &Pool::new(1).expect("a pool"));
        let (from, to) = (DVec3::new(0.2, 0.2, 1.0), DVec3::new(0.2, 0.2, -1.0));
        let hit = tree.first_hit(from, to, None).expect("a crossing");
        assert_eq!((hit.along, hit.triangle, hit.vertex), (0.5, 0, 0));
        assert_eq!(tree.first_hit(from, to, Some(2)), None);
        assert_eq!(tree.first_hit(from, DVec3::new(0.2, 0.2, 0.5), None), None);
    }
}
