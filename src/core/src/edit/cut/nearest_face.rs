//! The nearest place on a surface, and the triangles in a box, without a tree: runs of triangles that follow each other
//! in the file lie close together, so the boxes of such runs sort out nearly all of them.

use crate::edit::surface::SurfaceView;
use crate::mesh::query::closest_point::closest_barycentric_point;
use glam::DVec3;

/// Triangles in a run.
const RUN: usize = 256;

/// A place on a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FacePosition {
    pub face: u32,
    pub position: DVec3,
}

/// The boxes around runs of 256 triangles that follow each other in a surface.
pub(super) struct TriangleRuns {
    boxes: Vec<(DVec3, DVec3)>,
}

impl TriangleRuns {
    pub fn build(surface: &SurfaceView<'_>) -> Self {
        let boxes = surface.triangles.chunks(RUN).map(|run| {
            run.iter()
                .flatten()
                .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &v| {
                    let x = surface.positions[v as usize];
                    (low.min(x), high.max(x))
                })
        });
        Self { boxes: boxes.collect() }
    }

    /// The place nearest to `x`; of equally near ones that on the first triangle. `None` without triangles.
    pub fn find_nearest(&self, surface: &SurfaceView<'_>, x: DVec3) -> Option<FacePosition> {
        let far = |(low, high): &(DVec3, DVec3)| (x.clamp(*low, *high) - x).length_squared();
        let start = (0..self.boxes.len()).min_by(|&a, &b| far(&self.boxes[a]).total_cmp(&far(&self.boxes[b])))?;
        let mut best: Option<(f64, FacePosition)> = None;
        for run in std::iter::once(start).chain(0..self.boxes.len()) {
            if best.is_some_and(|b| far(&self.boxes[run]) > b.0) {
                continue;
            }
            for face in run * RUN..((run + 1) * RUN).min(surface.triangles.len()) {
                if surface.proper_points(face as u32).is_none() {
                    continue;
                }
                let position = closest_barycentric_point(x, surface.corner_positions(face as u32));
                let place = FacePosition {
                    face: face as u32,
                    position,
                };
                let distance = position.distance_squared(x);
                if best.is_none_or(|(d, p)| (distance, place.face) < (d, p.face)) {
                    best = Some((distance, place));
                }
            }
        }
        best.map(|b| b.1)
    }

    /// Adds the triangles whose boxes meet the box from `low` to `high`.
    pub fn collect_in_box(&self, surface: &SurfaceView<'_>, low: DVec3, high: DVec3, found: &mut Vec<u32>) {
        let meets = |l: DVec3, h: DVec3| l.cmple(high).all() && h.cmpge(low).all();
        for (run, _) in self.boxes.iter().enumerate().filter(|(_, b)| meets(b.0, b.1)) {
            for face in run * RUN..((run + 1) * RUN).min(surface.triangles.len()) {
                let [a, b, c] = surface.corner_positions(face as u32);
                if meets(a.min(b).min(c), a.max(b).max(c)) {
                    found.push(face as u32);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_places_are_those_of_a_search_over_all() {
        let positions: Vec<DVec3> = (0..400u32)
            .map(|i| {
                let (x, y) = (f64::from(i % 20), f64::from(i / 20));
                DVec3::new(x, y, libm::sin(x * 0.7) * libm::cos(y * 0.5))
            })
            .collect();
        let corner = |x: u32, y: u32| 20 * y + x;
        let triangles: Vec<[u32; 3]> = (0..361u32)
            .flat_map(|i| {
                let (x, y) = (i % 19, i / 19);
                let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
                [[a, b, c], [a, c, d]]
            })
            .collect();
        let points: Vec<u32> = (0..400).collect();
        let surface = SurfaceView {
            positions: &positions,
            triangles: &triangles,
            primitive_of: &vec![0; triangles.len()],
            point_of: &points,
            points: 400,
        };
        let runs = TriangleRuns::build(&surface);
        for k in 0..60 {
            let x = DVec3::new(
                f64::from(k % 9) * 2.6 - 1.0,
                f64::from(k / 9) * 3.1 - 0.5,
                f64::from(k % 4) - 1.5,
            );
            let all = triangles
                .iter()
                .map(|t| closest_barycentric_point(x, t.map(|v| positions[v as usize])).distance(x));
            let least = all.fold(f64::INFINITY, f64::min);
            let found = runs.find_nearest(&surface, x).expect("a surface");
            assert_eq!(found.position.distance(x), least);
            // No step around the place gets closer.
            let t = triangles[found.face as usize].map(|v| positions[v as usize]);
            let steps = [[0.5, 0.25, 0.25], [0.25, 0.5, 0.25], [0.25, 0.25, 0.5]];
            for s in steps {
                let inside = t[0] * s[0] + t[1] * s[1] + t[2] * s[2];
                assert!(found.position.lerp(inside, 1e-3).distance(x) >= least - 1e-12);
            }
        }
        let mut some = Vec::new();
        runs.collect_in_box(
            &surface,
            DVec3::new(4.5, 4.5, -9.0),
            DVec3::new(4.6, 4.6, 9.0),
            &mut some,
        );
        assert_eq!(some.len(), 2);
    }
}
