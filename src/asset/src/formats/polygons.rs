//! Polygons of a file and their cut into triangles.
//!
//! Convex polygons become fans from their first corner. Concave ones are cut by ear clipping in their own plane, so that
//! no triangle leaves the polygon.

use crate::edited::FaceOutlines;
use crate::files::ReadWatch;
use crate::{Error, Geometry};
use glam::{DVec2, DVec3, Vec3};

/// How many point-in-ear tests one file may cost; polygons beyond it become fans. Far above what real files need, and
/// reached within about a second by files made to be slow.
const EAR_TESTS: u64 = 200_000_000;
/// Tests after which it is asked whether to go on: some milliseconds.
const TESTS_BETWEEN_CHECKS: u64 = 1 << 20;

/// Faces of any number of corners.
#[derive(Debug, Clone, Default)]
pub(super) struct Polygons {
    /// Vertices of all corners, face after face.
    pub corners: Vec<u32>,
    /// For each face the place in `corners` past its last corner.
    ends: Vec<u32>,
}

impl Polygons {
    /// Ends the face whose corners were pushed since the last one. A face of less than three corners is dropped.
    pub fn end_face(&mut self) {
        let first = self.ends.last().map_or(0, |&e| e as usize);
        if self.corners.len() - first < 3 {
            self.corners.truncate(first);
        } else {
            self.ends.push(self.corners.len() as u32);
        }
    }

    /// Triangles that the faces so far will give.
    pub fn triangle_count(&self) -> u64 {
        self.corners.len() as u64 - 2 * self.ends.len() as u64
    }

    /// The faces that have more than three corners. `slots` are the triangles that [`Polygons::triangulate`] gave.
    pub fn find_outlines(&self, slots: &[[u32; 3]]) -> FaceOutlines {
        let mut outlines = FaceOutlines::default();
        let (mut first, mut triangle) = (0u32, 0usize);
        let mut place_of = Vec::new();
        for &end in &self.ends {
            let count = (end - first) as usize;
            if count > 3 {
                place_of.clear();
                place_of.resize(count, u32::MAX);
                let own = slots[triangle..triangle + count - 2].as_flattened();
                for (corner, slot) in own.iter().enumerate().rev() {
                    place_of[(slot - first) as usize] = corner as u32;
                }
                if !place_of.contains(&u32::MAX) {
                    outlines.add_face(triangle as u32, place_of.iter().copied());
                }
            }
            triangle += count - 2;
            first = end;
        }
        outlines
    }

    /// The mesh of the faces over these vertices, and the faces that have more than three corners.
    ///
    /// # Errors
    /// When the read is cancelled.
    pub fn into_geometry(
        self,
        positions: Vec<DVec3>,
        normals: Vec<Vec3>,
        watch: &ReadWatch<'_>,
    ) -> Result<(Geometry, FaceOutlines), Error> {
        let (slots, crude) = self.triangulate(&positions, || watch.check())?;
        let outlines = self.find_outlines(&slots);
        let triangles = slots.iter().map(|t| t.map(|s| self.corners[s as usize])).collect();
        let mut geometry = Geometry::from_one_mesh(positions, normals, triangles);
        geometry.warn_about_crude_polygons(crude);
        Ok((geometry, outlines))
    }

    /// Cuts every face into triangles, as places in `corners`, in face order. Also says how many faces were too costly
    /// to cut well. All corners must be indices into `positions`.
    ///
    /// # Errors
    /// Those of `check`, which is called every few milliseconds.
    pub fn triangulate(
        &self,
        positions: &[DVec3],
        check: impl Fn() -> Result<(), Error>,
    ) -> Result<(Vec<[u32; 3]>, usize), Error> {
        let mut triangles = Vec::with_capacity(self.triangle_count() as usize);
        let mut cutter = PolygonCutter {
            tests_left: EAR_TESTS,
            unchecked: 0,
            points: Vec::new(),
            flat: Vec::new(),
            crude: 0,
        };
        let mut first = 0u32;
        for &end in &self.ends {
            let face = &self.corners[first as usize..end as usize];
            if let [_, _, _] = face {
                triangles.push([first, first + 1, first + 2]);
            } else {
                cutter.points.clear();
                cutter.points.extend(face.iter().map(|&v| positions[v as usize]));
                cutter.cut_polygon(&mut |t| triangles.push(t.map(|i| first + i)), &check)?;
            }
            first = end;
        }
        Ok((triangles, cutter.crude))
    }
}

/// Cuts one polygon after the other.
struct PolygonCutter {
    tests_left: u64,
    /// Tests since it was asked whether to go on.
    unchecked: u64,
    points: Vec<DVec3>,
    flat: Vec<DVec2>,
    crude: usize,
}

impl PolygonCutter {
    fn cut_polygon(
        &mut self,
        emit: &mut impl FnMut([u32; 3]),
        check: &impl Fn() -> Result<(), Error>,
    ) -> Result<(), Error> {
        let convex = !self.project_on_plane() || {
            let (n, p) = (self.flat.len(), &self.flat);
            (0..n).all(|i| is_corner(p[(i + n - 1) % n], p[i], p[(i + 1) % n]))
        };
        if convex {
            for i in 2..self.points.len() as u32 {
                emit([0, i - 1, i]);
            }
        } else {
            self.clip_ears(emit, check)?;
        }
        Ok(())
    }

    /// Projects the points on the plane in which the polygon is widest; false when it has none.
    fn project_on_plane(&mut self) -> bool {
        let origin = self.points[0];
        let size = self
            .points
            .iter()
            .map(|&p| (p - origin).abs().max_element())
            .fold(0.0, f64::max);
        if !(size > 0.0 && size.is_finite()) {
            return false;
        }
        let scaled = |p: DVec3| (p - origin) / size;
        let mut normal = DVec3::ZERO;
        for i in 0..self.points.len() {
            normal += scaled(self.points[i]).cross(scaled(self.points[(i + 1) % self.points.len()]));
        }
        let Some(normal) = normal.try_normalize() else {
            return false;
        };
        let u = normal.any_orthonormal_vector();
        let v = normal.cross(u);
        self.flat.clear();
        self.flat.extend(
            self.points
                .iter()
                .map(|&p| DVec2::new(scaled(p).dot(u), scaled(p).dot(v))),
        );
        true
    }

    fn clip_ears(
        &mut self,
        emit: &mut impl FnMut([u32; 3]),
        check: &impl Fn() -> Result<(), Error>,
    ) -> Result<(), Error> {
        let points = &self.flat;
        let n = points.len();
        let mut next: Vec<usize> = (1..=n).map(|i| i % n).collect();
        let mut previous: Vec<usize> = (0..n).map(|i| (i + n - 1) % n).collect();
        let bends_in = |i: usize, a: usize, b: usize| turn(points[a], points[i], points[b]) < 0.0;
        // Corners that bend in; only they can lie in an ear. Those that no longer do are struck out now and then.
        let mut is_reflex: Vec<bool> = (0..n).map(|i| bends_in(i, previous[i], next[i])).collect();
        let mut reflex: Vec<usize> = (0..n).filter(|&i| is_reflex[i]).collect();
        let mut struck = 0;
        let (mut left, mut at, mut refused) = (n, 0, 0);
        while left > 3 {
            let (a, b) = (previous[at], next[at]);
            let corner = [points[a], points[at], points[b]];
            // When no ear is left the polygon crosses itself, and any cut is as good as another.
            if refused < left && self.tests_left > 0 {
                let tests = reflex.len() as u64 + 1;
                self.unchecked += tests;
                if self.unchecked >= TESTS_BETWEEN_CHECKS {
                    self.unchecked = 0;
                    check()?;
                }
                self.tests_left = self.tests_left.saturating_sub(tests);
                self.crude += usize::from(self.tests_left == 0);
                let blocked = |&i: &usize| is_reflex[i] && ![a, at, b].contains(&i) && is_inside(points[i], corner);
                if !is_corner(corner[0], corner[1], corner[2]) || reflex.iter().any(blocked) {
                    at = b;
                    refused += 1;
                    continue;
                }
            }
            emit([a as u32, at as u32, b as u32]);
            next[a] = b;
            previous[b] = a;
            for i in [a, at, b] {
                if is_reflex[i] && (i == at || !bends_in(i, previous[i], next[i])) {
                    is_reflex[i] = false;
                    struck += 1;
                }
            }
            if struck > reflex.len() / 2 {
                reflex.retain(|&i| is_reflex[i]);
                struck = 0;
            }
            left -= 1;
            refused = 0;
            // Going on past the neighbour spreads the cuts around instead of making a fan of needles.
            at = next[b];
        }
        emit([previous[at] as u32, at as u32, next[at] as u32]);
        Ok(())
    }
}

/// Twice the signed area of a triangle: positive for a left turn.
fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - b)
}

/// Whether the path turns left at `b` by more than rounding can explain; a straight one would give a triangle without area.
fn is_corner(a: DVec2, b: DVec2, c: DVec2) -> bool {
    turn(a, b, c) > 1e-6 * ((b - a).length() * (c - b).length())
}

fn is_inside(p: DVec2, [a, b, c]: [DVec2; 3]) -> bool {
    // A point that repeats one of the ear's own (a polygon with a bridge to a hole) does not block it.
    p != a && p != b && p != c && turn(a, b, p) >= 0.0 && turn(b, c, p) >= 0.0 && turn(c, a, p) >= 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cut(points: &[DVec3]) -> Vec<[u32; 3]> {
        let mut polygons = Polygons {
            corners: (0..points.len() as u32).collect(),
            ..Default::default()
        };
        polygons.end_face();
        polygons
            .triangulate(points, || Ok(()))
            .expect("the check lets it go on")
            .0
    }

    fn area(points: &[DVec3], t: &[u32; 3]) -> DVec3 {
        let [a, b, c] = t.map(|i| points[i as usize]);
        (b - a).cross(c - a) * 0.5
    }

    /// A polygon that winds once around the origin at any distance is simple.
    fn star(radii: &[f64], tilt: f64) -> Vec<DVec3> {
        let n = radii.len() as f64;
        let at = |(i, r): (usize, &f64)| {
            let (sin, cos) = libm::sincos(i as f64 / n * std::f64::consts::TAU);
            DVec3::new(r * cos, r * sin, tilt * r * cos)
        };
        radii.iter().enumerate().map(at).collect()
    }

    proptest! {
        #[test]
        fn triangles_cover_a_polygon_exactly_once(radii in prop::collection::vec(0.1..1.0f64, 4..40), tilt in -2.0..2.0f64) {
            let points = star(&radii, tilt);
            let triangles = cut(&points);
            prop_assert_eq!(triangles.len(), points.len() - 2);
            let whole: DVec3 = (0..points.len()).map(|i| points[i].cross(points[(i + 1) % points.len()]) * 0.5).sum();
            for t in &triangles {
                prop_assert!(area(&points, t).dot(whole) >= -1e-9, "triangle {t:?} is turned over");
            }
            let sum: f64 = triangles.iter().map(|t| area(&points, t).length()).sum();
            prop_assert!((sum - whole.length()).abs() < 1e-9);
        }

        #[test]
        fn any_points_give_the_right_number_of_triangles(
            points in prop::collection::vec([-4i32..5, -4i32..5, -1i32..2], 3..24)
        ) {
            let points: Vec<_> = points.into_iter().map(|p| DVec3::from_array(p.map(f64::from))).collect();
            let triangles = cut(&points);
            prop_assert_eq!(triangles.len(), points.len() - 2);
            prop_assert!(triangles.iter().flatten().all(|&i| (i as usize) < points.len()));
        }
    }

    #[test]
    fn convex_faces_become_fans_from_their_first_corner() {
        assert_eq!(cut(&star(&[1.0; 5], 0.0)), [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
    }

    #[test]
    fn a_corner_in_the_middle_of_an_edge_gives_no_triangle_without_area() {
        let points = [[0., 0., 0.], [1., 0., 0.], [2., 0., 0.], [2., 2., 0.], [0., 2., 0.]].map(DVec3::from_array);
        assert!(cut(&points).iter().all(|t| area(&points, t).length() > 0.4));
    }

    /// A polygon with so many teeth, whose corners between them all bend in.
    fn comb(teeth: u32) -> Vec<DVec3> {
        let end = f64::from(teeth);
        (0..teeth)
            .map(|i| DVec3::new(f64::from(i), if i % 2 == 0 { 1.0 } else { 1000.0 }, 0.0))
            .chain([DVec3::new(end, -1.0, 0.0), DVec3::new(-1.0, -1.0, 0.0)])
            .rev()
            .collect()
    }

    #[test]
    fn a_huge_comb_is_cut_in_bounded_time() {
        let comb = comb(400_000);
        assert_eq!(cut(&comb).len(), comb.len() - 2);
    }

    #[test]
    fn a_huge_comb_is_given_up_when_it_is_cancelled() {
        let points = comb(40_000);
        let mut polygons = Polygons {
            corners: (0..points.len() as u32).collect(),
            ..Default::default()
        };
        polygons.end_face();
        assert_eq!(
            polygons.triangulate(&points, || Err(Error::Cancelled)),
            Err(Error::Cancelled)
        );
    }

    #[test]
    fn faces_of_less_than_three_corners_are_dropped() {
        let mut polygons = Polygons::default();
        for face in [&[0u32, 1][..], &[0, 1, 2], &[], &[2], &[2, 1, 0]] {
            polygons.corners.extend(face);
            polygons.end_face();
        }
        assert_eq!(polygons.triangle_count(), 2);
        assert_eq!(
            polygons.triangulate(&[DVec3::ZERO, DVec3::X, DVec3::Y], || Ok(())),
            Ok((vec![[0, 1, 2], [3, 4, 5]], 0))
        );
    }
}
