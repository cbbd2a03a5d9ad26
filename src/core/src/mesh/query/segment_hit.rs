//! Where a segment first meets many triangles.

use crate::mesh::query::bvh::{ChildBoxes, FAN, NodeStack, TriangleBvh};
use crate::mesh::query::closest_surface_point::corner_near;
use glam::DVec3;

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
    use crate::pool::Pool;

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
