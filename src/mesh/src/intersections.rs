//! Where a surface passes through itself: pairs of triangles that cross.
//!
//! Positions are rounded to 32 bits first, which is what frames and most formats carry, far from the origin relative to
//! [`BoundingBox::origin`]; differences of such numbers and the signs of the volumes made of them are then taken in 64 bits. Touching is
//! not crossing.

use crate::Mesh;
use crate::measure::BoundingBox;
use crate::query::bvh::TriangleBvh;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};

/// Triangles looked at in one piece of work.
const BLOCK: usize = 16;

/// Counts the pairs of triangles that cross.
///
/// A pair that shares an edge never counts. A pair that shares one vertex counts when the edge opposite to it in one
/// triangle passes through the other triangle. Any other pair counts when an edge of one passes through the other. An
/// edge passes through a triangle when its ends lie on both sides, by more than what rounding moves them by, and it meets the triangle
/// or its border.
///
/// Takes time in proportion to n log n plus the pairs whose boxes overlap, which may be all when a surface has
/// collapsed; `progress` is asked often. The count does not depend on threads.
///
/// # Errors
/// [`Cancelled`] when `progress` says so.
///
/// # Panics
/// When a triangle names a position that does not exist. Triangles of a [`super::Mesh`] never do.
pub fn self_intersections(positions: &[DVec3], triangles: &[[u32; 3]], exec: &Exec<'_>) -> Result<u64, Cancelled> {
    let count = AtomicU64::new(0);
    let count_one = |_| {
        count.fetch_add(1, Ordering::Relaxed);
    };
    visit_crossings(positions, triangles, None, &count_one, exec)?;
    Ok(count.into_inner())
}

/// How many pairs of triangles cross.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CrossingCount {
    /// All of them, as [`self_intersections`] counts.
    pub all: u64,
    /// Those that do not cross in the rest pose.
    pub new: u64,
}

/// Counts the pairs of triangles that cross, and those of them that do not cross with positions in the rest pose, of the same vertices.
///
/// # Errors
/// [`Cancelled`] when `progress` says so.
///
/// # Panics
/// When a triangle names a position that does not exist, in either pose.
pub fn count_crossings(
    positions: &[DVec3],
    rest: &[DVec3],
    triangles: &[[u32; 3]],
    exec: &Exec<'_>,
) -> Result<CrossingCount, Cancelled> {
    let rest = rounded(rest);
    let (all, new) = (AtomicU64::new(0), AtomicU64::new(0));
    let count_one = |pair: [u32; 2]| {
        all.fetch_add(1, Ordering::Relaxed);
        let [a, b] = pair.map(|t| triangles[t as usize]);
        new.fetch_add(u64::from(!do_cross(&rest, a, b)), Ordering::Relaxed);
    };
    visit_crossings(positions, triangles, None, &count_one, exec)?;
    Ok(CrossingCount {
        all: all.into_inner(),
        new: new.into_inner(),
    })
}

/// What a triangle of a surface crosses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Crossing {
    /// No other one.
    #[default]
    None,
    /// Others, each of which it crosses in the rest pose too.
    AtRest,
    /// One that it does not cross in the rest pose.
    New,
}

/// Finds which triangles cross others, by the rule of [`self_intersections`]. With positions in the rest pose, of the same vertices, a pair that
/// crosses there too is not new. Without, all are.
///
/// # Errors
/// [`Cancelled`] when `progress` says so.
///
/// # Panics
/// When a triangle names a position that does not exist, in either pose.
pub fn crossing_triangles(
    positions: &[DVec3],
    rest: Option<&[DVec3]>,
    triangles: &[[u32; 3]],
    exec: &Exec<'_>,
) -> Result<Vec<Crossing>, Cancelled> {
    let rest = rest.map(rounded);
    let found: Vec<AtomicU8> = triangles.iter().map(|_| AtomicU8::new(0)).collect();
    let note = |pair: [u32; 2]| {
        let is_old = rest.as_ref().is_some_and(|rest| {
            let [a, b] = pair.map(|t| triangles[t as usize]);
            do_cross(rest, a, b)
        });
        for t in pair {
            // The largest of all that are noted does not depend on their order.
            found[t as usize].fetch_max(if is_old { 1 } else { 2 }, Ordering::Relaxed);
        }
    };
    visit_crossings(positions, triangles, None, &note, exec)?;
    let of_number = |number: AtomicU8| match number.into_inner() {
        0 => Crossing::None,
        1 => Crossing::AtRest,
        _ => Crossing::New,
    };
    Ok(found.into_iter().map(of_number).collect())
}

impl Mesh {
    /// [`crossing_triangles`] of a shape of the model that the mesh was built of, one for each of its `triangles`. `positions`, and
    /// `rest` where it is given, are those of the model's vertices; seams are closed as in the mesh.
    ///
    /// # Errors
    /// [`Cancelled`] when `progress` says so.
    ///
    /// # Panics
    /// When there are fewer positions or triangles than the model has.
    pub fn crossing_triangles(
        &self,
        positions: &[DVec3],
        rest: Option<&[DVec3]>,
        triangles: usize,
        exec: &Exec<'_>,
    ) -> Result<Vec<Crossing>, Cancelled> {
        let (now, before) = (self.welded(positions), rest.map(|rest| self.welded(rest)));
        let found = crossing_triangles(&now, before.as_deref(), &self.triangles, exec)?;
        let mut of_model = vec![Crossing::None; triangles];
        for (&source, crossing) in self.source_triangle.iter().zip(found) {
            of_model[source as usize] = crossing;
        }
        Ok(of_model)
    }
}

/// Hands each pair of triangles that cross to `visit` once, the smaller number first, from any thread and in any order; with `is_asked`
/// those pairs alone of which at least one is asked for. What crosses, and the time that it takes, are those of
/// [`self_intersections`]; triangles far from all that are asked for cost next to nothing.
///
/// # Errors
/// [`Cancelled`] when `progress` says so.
///
/// # Panics
/// When a triangle names a position that does not exist, or `is_asked` has not one entry for each.
pub fn visit_crossings(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    is_asked: Option<&[bool]>,
    visit: &(impl Fn([u32; 2]) + Sync),
    exec: &Exec<'_>,
) -> Result<(), Cancelled> {
    visit_crossings_within(u64::MAX, positions, triangles, is_asked, visit, exec).map(|_| ())
}

/// As [`visit_crossings`], up to `most` pairs whose boxes overlap, which is what time is in proportion to. Answers whether all pairs were
/// looked at; where there are more, some are not, and which depends on threads.
///
/// # Errors
/// As `visit_crossings`.
///
/// # Panics
/// As `visit_crossings`.
pub fn visit_crossings_within(
    most: u64,
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    is_asked: Option<&[bool]>,
    visit: &(impl Fn([u32; 2]) + Sync),
    exec: &Exec<'_>,
) -> Result<bool, Cancelled> {
    let seen = AtomicU64::new(0);
    let asked = |t: u32| is_asked.is_none_or(|is_asked| is_asked[t as usize]);
    let all = || (0..triangles.len() as u32).into_par_iter();
    exec.pool.install(|| {
        let points = rounded(positions);
        let box_of = |t: u32| BoundingBox::of(&triangles[t as usize].map(|v| points[v as usize]));
        let joined = |a: BoundingBox, b: BoundingBox| BoundingBox {
            min: a.min.min(b.min),
            max: a.max.max(b.max),
        };
        let near: Option<Vec<u32>> = is_asked.map(|_| {
            let around = all().filter(|&t| asked(t)).map(box_of).reduce_with(joined);
            let is_near = |t: u32| around.as_ref().is_some_and(|around| around.overlaps(&box_of(t)));
            all().filter(|&t| asked(t) || is_near(t)).collect()
        });
        let corners: Cow<'_, [[u32; 3]]> = match &near {
            None => triangles.into(),
            Some(near) => near.iter().map(|&t| triangles[t as usize]).collect(),
        };
        if corners.len() < 2 {
            return Ok(true);
        }
        let surface = BoxedTriangles::build(&points, &corners, exec);
        exec.check()?;
        let order = surface.bvh.triangle_order();
        let number = |place: usize| {
            let own = order[place];
            near.as_ref().map_or(own, |near| near[own as usize])
        };
        let places: Vec<usize> = (0..order.len()).filter(|&place| asked(number(place))).collect();
        places.par_chunks(BLOCK).try_for_each(|places| {
            // A triangle meets every other one at worst.
            places.iter().try_for_each(|&place| {
                exec.check()?;
                if seen.load(Ordering::Relaxed) > most {
                    return Ok(());
                }
                // Where all are asked for, each pair is met from the first of the two.
                let from = if is_asked.is_none() { place + 1 } else { 0 };
                let overlaps = surface.for_crossings(place, from, |other| {
                    let (own, theirs) = (number(place), number(other));
                    if from > 0 || !asked(theirs) || own < theirs {
                        visit([own.min(theirs), own.max(theirs)]);
                    }
                });
                seen.fetch_add(overlaps, Ordering::Relaxed);
                Ok(())
            })
        })?;
        Ok(seen.into_inner() <= most)
    })
}

/// All places as tests take them.
pub(crate) fn rounded(positions: &[DVec3]) -> Vec<DVec3> {
    let origin = BoundingBox::of(positions).origin();
    let all = positions.par_iter().map(|p| (*p - origin).as_vec3().as_dvec3());
    all.collect()
}

/// Whether two triangles cross, in the sense of [`self_intersections`]. `origin` is that of the box of all positions.
pub fn is_crossing(positions: &[DVec3], origin: DVec3, triangles: &[[u32; 3]], [f, g]: [u32; 2]) -> bool {
    let rounded = |v: u32| (positions[v as usize] - origin).as_vec3().as_dvec3();
    let corners = [f, g].map(|t| triangles[t as usize]);
    let points = corners.map(|t| t.map(rounded));
    let all = points.concat();
    // The corners by their places in `all`; a shared one by its first.
    let place = |v: u32| corners.as_flattened().iter().position(|&w| w == v).unwrap_or_default() as u32;
    do_cross(&all, corners[0].map(place), corners[1].map(place))
}

/// Triangles in a hierarchy, each with its box.
struct BoxedTriangles<'a> {
    bvh: TriangleBvh<'a>,
    /// The box of each triangle, in the order of the hierarchy's leaves.
    boxes: Vec<BoundingBox>,
}

impl<'a> BoxedTriangles<'a> {
    fn build(points: &'a [DVec3], triangles: &'a [[u32; 3]], exec: &Exec<'_>) -> Self {
        let bvh = TriangleBvh::build(points, triangles, exec.pool);
        let places = (0..triangles.len()).into_par_iter();
        let boxes = places.map(|place| BoundingBox::of(&bvh.corners(place))).collect();
        Self { bvh, boxes }
    }

    /// Calls for the triangles at places from `from` on that cross the one at `place`; answers how many boxes overlap its own.
    fn for_crossings(&self, place: usize, from: usize, mut see: impl FnMut(usize)) -> u64 {
        let mut overlaps = 0;
        let order = self.bvh.triangle_order();
        let (own, bounds) = (order[place], &self.boxes[place]);
        self.bvh.visit_overlapping(bounds, from, |other| {
            if self.boxes[other].overlaps(bounds) {
                overlaps += 1;
                let theirs = order[other];
                let [f, g] = [own.min(theirs), own.max(theirs)].map(|t| self.bvh.triangles()[t as usize]);
                if do_cross(self.bvh.positions(), f, g) {
                    see(other);
                }
            }
        });
        overlaps
    }
}

/// Whether two triangles cross.
pub(crate) fn do_cross(points: &[DVec3], f: [u32; 3], g: [u32; 3]) -> bool {
    let (mut shared, mut i, mut j) = (0, 0, 0);
    for (k, v) in f.iter().enumerate() {
        for (l, w) in g.iter().enumerate() {
            if v == w {
                (shared, i, j) = (shared + 1, k, l);
            }
        }
    }
    let at = |v: u32| points[v as usize];
    let (a, b) = (f.map(at), g.map(at));
    match shared {
        0 => {
            if is_beside(a, b) || is_beside(b, a) {
                return false;
            }
            (0..3).any(|k| passes(a[k], a[(k + 1) % 3], b) || passes(b[k], b[(k + 1) % 3], a))
        }
        1 => passes(a[(i + 1) % 3], a[(i + 2) % 3], b) || passes(b[(j + 1) % 3], b[(j + 2) % 3], a),
        _ => false,
    }
}

/// Whether all corners of `a` lie strictly on one side of the plane of `b`.
fn is_beside(a: [DVec3; 3], b: [DVec3; 3]) -> bool {
    let sides = a.map(|p| signed_volume(b[0], b[1], b[2], p));
    sides.iter().all(|&s| s > 0.0) || sides.iter().all(|&s| s < 0.0)
}

/// What rounding to 32 bits moves a coordinate by at most, relative to it: half of the last place.
const ROUNDING: f64 = 0.5 * f32::EPSILON as f64;

/// Whether the segment from `p` to `q` passes through `t`, border included, with its ends on both sides, by more than what rounding
/// moves them by. Faces of one plane that share a corner would cross otherwise once the plane is turned.
pub(crate) fn passes(p: DVec3, q: DVec3, t: [DVec3; 3]) -> bool {
    let [a, b, c] = t;
    let (s, e) = (signed_volume(a, b, c, p), signed_volume(a, b, c, q));
    if !((s < 0.0 && e > 0.0) || (s > 0.0 && e < 0.0)) {
        return false;
    }
    let around = [
        signed_volume(p, q, a, b),
        signed_volume(p, q, b, c),
        signed_volume(p, q, c, a),
    ];
    if !(around.iter().all(|&v| v >= 0.0) || around.iter().all(|&v| v <= 0.0)) {
        return false;
    }
    let largest = [a, b, c, p, q]
        .iter()
        .map(|at| at.abs().max_element())
        .fold(0.0, f64::max);
    s.abs().min(e.abs()) > ROUNDING * largest * (b - a).cross(c - a).length()
}

/// Six times the signed volume of a tetrahedron.
pub(crate) fn signed_volume(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    (b - a).cross(c - a).dot(d - a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_exec::pool::Pool;
    use pliant_exec::progress::{CancelFlag, Silent};
    use std::sync::Mutex;

    fn pool() -> Pool {
        Pool::new(2).expect("two threads")
    }

    fn count(positions: &[DVec3], triangles: &[[u32; 3]]) -> u64 {
        self_intersections(positions, triangles, &Exec::new(&pool(), &Silent)).expect("no cancel")
    }

    fn points(p: &[[f64; 3]]) -> Vec<DVec3> {
        p.iter().copied().map(DVec3::from_array).collect()
    }

    #[test]
    fn pairs_with_a_triangle_that_is_asked_for_are_named_each_once() {
        let (positions, triangles) = crossed_sheets(12);
        let exec_pool = pool();
        let exec = Exec::new(&exec_pool, &Silent);
        let asked = |is_asked: &dyn Fn(usize) -> bool| {
            let is_asked: Vec<bool> = (0..triangles.len()).map(is_asked).collect();
            let found = Mutex::new(Vec::new());
            let keep = |pair| found.lock().expect("no panic").push(pair);
            visit_crossings(&positions, &triangles, Some(&is_asked), &keep, &exec).expect("no cancel");
            let mut found = found.into_inner().expect("no panic");
            found.sort_unstable();
            found
        };
        let all = asked(&|_| true);
        assert_eq!(all.len() as u64, count(&positions, &triangles));
        assert!(
            all.is_sorted_by(|a, b| a < b)
                && all
                    .iter()
                    .all(|&pair| is_crossing(&positions, DVec3::ZERO, &triangles, pair))
        );
        assert!(asked(&|_| false).is_empty());
        let some = |t: usize| t.is_multiple_of(5);
        let expected = all
            .iter()
            .filter(|pair| pair.iter().any(|&t| some(t as usize)))
            .copied();
        let expected: Vec<_> = expected.collect();
        assert!(!expected.is_empty() && expected.len() < all.len());
        assert_eq!(asked(&some), expected);
    }

    #[test]
    fn triangles_of_a_flat_lid_cross_at_no_angle() {
        let sides = 24;
        let triangles: Vec<[u32; 3]> = (0..sides).map(|k| [0, 1 + k, 1 + (k + 1) % sides]).collect();
        for (radius, height) in [(0.25, 0.0), (0.3, 2.0)] {
            for degrees in 0..180 {
                let turn = glam::DMat3::from_rotation_z(f64::from(degrees).to_radians());
                let corner = |k: u32| {
                    let (sine, cosine) = (f64::from(k) / f64::from(sides) * std::f64::consts::TAU).sin_cos();
                    DVec3::new(radius * cosine, height, radius * sine)
                };
                let lid = std::iter::once(DVec3::new(0.0, height, 0.0)).chain((0..sides).map(corner));
                let lid: Vec<DVec3> = lid.map(|p| turn * p.as_vec3().as_dvec3()).collect();
                assert_eq!(
                    count(&lid, &triangles),
                    0,
                    "radius {radius}, turned by {degrees} degrees"
                );
            }
        }
    }

    #[test]
    fn a_search_ends_where_too_many_boxes_overlap() {
        let (positions, triangles) = crossed_sheets(12);
        let exec_pool = pool();
        let exec = Exec::new(&exec_pool, &Silent);
        let within = |most: u64, positions: &[DVec3]| {
            let found = AtomicU64::new(0);
            let keep = |_| {
                found.fetch_add(1, Ordering::Relaxed);
            };
            let whole = visit_crossings_within(most, positions, &triangles, None, &keep, &exec).expect("no cancel");
            (whole, found.into_inner())
        };
        let all = count(&positions, &triangles);
        assert_eq!(within(u64::MAX, &positions), (true, all));
        let usual = 64 * triangles.len() as u64;
        assert_eq!(within(usual, &positions), (true, all));
        // All in one place, but for noise: each box overlaps each.
        let collapsed: Vec<DVec3> = (positions.iter().enumerate())
            .map(|(k, p)| *p * 1e-3 + DVec3::splat((k % 7) as f64))
            .collect();
        let (whole, found) = within(usual, &collapsed);
        assert!(!whole && found < count(&collapsed, &triangles), "{found}");
    }

    #[test]
    fn pairs_count_by_what_they_share() {
        let flat = [[0., 0., 0.], [4., 0., 0.], [0., 4., 0.]];
        let with = |more: &[[f64; 3]]| points(&[&flat[..], more].concat());
        // A blade through the middle, the same blade beside, and one that only touches with a corner.
        let through = with(&[[1., 1., -1.], [1., 1., 1.], [2., 1., 1.]]);
        let beside = with(&[[9., 1., -1.], [9., 1., 1.], [9., 2., 1.]]);
        let touching = with(&[[1., 1., 0.], [1., 1., 1.], [2., 1., 1.]]);
        for (positions, wanted) in [(through, 1), (beside, 0), (touching, 0)] {
            assert_eq!(count(&positions, &[[0, 1, 2], [3, 4, 5]]), wanted);
        }
        // From a shared corner, back through the triangle.
        let back = with(&[[1., 1., -1.], [1., 1., 1.]]);
        assert_eq!(count(&back, &[[0, 1, 2], [0, 3, 4]]), 1);
        let away = with(&[[-1., -1., -1.], [-1., -1., 1.]]);
        assert_eq!(count(&away, &[[0, 1, 2], [0, 3, 4]]), 0);
        // Folded flat onto its neighbour across an edge: never counted.
        let folded = with(&[[3., 3., 0.]]);
        assert_eq!(count(&folded, &[[0, 1, 2], [1, 2, 3]]), 0);
    }

    #[test]
    fn triangles_that_cross_are_named_and_old_pairs_told_apart() {
        let flat = [[0., 0., 0.], [4., 0., 0.], [0., 4., 0.]];
        let blade = |x: f64| [[x, 1., -1.], [x, 1., 1.], [x + 1., 1., 1.]];
        let with = |blades: [f64; 2]| points(&[flat, blade(blades[0]), blade(blades[1])].concat());
        let triangles = [[0, 1, 2], [3, 4, 5], [6, 7, 8]];
        let pool = pool();
        let exec = Exec::new(&pool, &Silent);
        let found = |now, rest: Option<&[DVec3]>| crossing_triangles(now, rest, &triangles, &exec).expect("no cancel");
        use Crossing::{AtRest, New, None as Apart};
        let (one, other, both) = (with([1.0, 9.0]), with([9.0, 1.0]), with([1.0, 0.5]));
        assert_eq!(found(&one, None), [New, New, Apart]);
        assert_eq!(found(&one, Some(&one)), [AtRest, AtRest, Apart]);
        // Of the two that cross the first triangle, one did so before.
        assert_eq!(found(&both, Some(&one)), [New, AtRest, New]);
        // The first triangle crossed another one before: that pair is new.
        assert_eq!(found(&one, Some(&other)), [New, New, Apart]);
    }

    /// Sheets of n × n cells in planes that cross at a right angle along a line between grid lines.
    fn crossed_sheets(n: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut positions = Vec::new();
        let mut triangles = Vec::new();
        for sheet in 0..2 {
            let first = positions.len();
            for i in 0..=n {
                for j in 0..=n {
                    let (x, y) = (i as f64 - n as f64 / 2.0 + 0.25, j as f64);
                    positions.push(if sheet == 0 {
                        DVec3::new(x, y, 0.0)
                    } else {
                        DVec3::new(0.0, y + 0.3, x)
                    });
                }
            }
            let at = |i: usize, j: usize| (first + i * (n + 1) + j) as u32;
            for i in 0..n {
                for j in 0..n {
                    triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                    triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
                }
            }
        }
        (positions, triangles)
    }

    /// Every pair, without the tree.
    fn slowly(positions: &[DVec3], triangles: &[[u32; 3]]) -> u64 {
        let points: Vec<DVec3> = positions.iter().map(|p| p.as_vec3().as_dvec3()).collect();
        let mut found = 0;
        for (k, f) in triangles.iter().enumerate() {
            found += triangles[k + 1..].iter().filter(|g| do_cross(&points, *f, **g)).count() as u64;
        }
        found
    }

    #[test]
    fn the_tree_misses_nothing_and_counts_nothing_twice() {
        for n in [1, 2, 3, 7, 16] {
            let (positions, triangles) = crossed_sheets(n);
            let all = slowly(&positions, &triangles);
            assert!(all >= n as u64, "{n} cells cross in {all} pairs");
            assert_eq!(count(&positions, &triangles), all, "{n} cells");
            let one = self_intersections(
                &positions,
                &triangles,
                &Exec::new(&Pool::new(1).expect("a thread"), &Silent),
            );
            assert_eq!(one, Ok(all));
            // The count belongs to the shape, not to the order of its triangles or where it lies.
            let turned: Vec<_> = triangles.iter().rev().map(|&[a, b, c]| [c, a, b]).collect();
            assert_eq!(count(&positions, &turned), all);
            let doubled: Vec<_> = positions.iter().map(|p| *p * 2.0).collect();
            assert_eq!(count(&doubled, &triangles), all);
        }
    }

    #[test]
    fn nothing_odd_counts_or_panics() {
        assert_eq!(count(&[], &[]), 0);
        let nan = points(&[[f64::NAN, 0., 0.], [1e300, 0., 0.], [0., 1., 0.], [0., 0., 1.]]);
        assert_eq!(count(&nan, &[[0, 1, 2], [1, 2, 3], [0, 2, 3]]), 0);
        let heap = vec![DVec3::ONE; 300];
        let triangles: Vec<[u32; 3]> = (0..100).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        assert_eq!(count(&heap, &triangles), 0, "points are not a surface");
    }

    #[test]
    fn a_cancelled_count_stops() {
        let flag = CancelFlag::default();
        flag.cancel();
        let (positions, triangles) = crossed_sheets(4);
        assert_eq!(
            self_intersections(&positions, &triangles, &Exec::new(&pool(), &flag)),
            Err(Cancelled)
        );
    }
}
