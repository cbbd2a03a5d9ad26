//! Which points lie within a distance of a polyline.

use super::error::Error;
use crate::exec::Exec;
use crate::graph::parallel::map;
use crate::mesh::query::closest_point::closest_point_on_segment;
use crate::mesh::query::{QueryStop, TriangleBvh, VisitBudget};
use glam::DVec3;

/// The most points that a tube may be given by.
pub const MOST_TUBE_POINTS: usize = 4096;
/// Pieces that segments are cut into, for each segment: a box around a long one would have room for most of a model.
const PIECES: f64 = 4.0;
/// What one point may look at on average, and all of them together in any case.
const VISITS_PER_POINT: u64 = 64;
const LEAST_VISITS: u64 = 1 << 22;
/// By how much of the largest coordinate rounding may move a point of a segment out of the box around its piece: many times what
/// it does.
const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// A polyline whose segments have been cut into short pieces.
pub(super) struct Tube<'a> {
    line: &'a [DVec3],
    radius: f64,
    ends: Vec<DVec3>,
    /// Pieces as triangles without area.
    pieces: Vec<[u32; 3]>,
    /// For each piece the segment that it is of.
    segments: Vec<u32>,
}

impl<'a> Tube<'a> {
    /// Cuts a polyline into pieces.
    ///
    /// # Errors
    /// When it has fewer than two points, or too many.
    pub fn cut_pieces(line: &'a [DVec3], radius: f64) -> Result<Self, Error> {
        if !(2..=MOST_TUBE_POINTS).contains(&line.len()) {
            let problem = format!(
                "is a tube along {} points, allowed are 2 to {MOST_TUBE_POINTS}",
                line.len()
            );
            return Err(Error::invalid("", problem));
        }
        let total: f64 = line.windows(2).map(|s| s[0].distance(s[1])).sum();
        let length = total / (PIECES * line.len() as f64);
        let mut tube = Self {
            line,
            radius,
            ends: vec![line[0]],
            pieces: Vec::new(),
            segments: Vec::new(),
        };
        for (segment, ends) in (0u32..).zip(line.windows(2)) {
            let wanted = (ends[0].distance(ends[1]) / length).ceil();
            // Not a number, and more than all together, are those of lengths that are beyond counting.
            let count = if wanted <= PIECES * line.len() as f64 + 1.0 {
                wanted.max(1.0)
            } else {
                1.0
            };
            for k in 1..=count as u32 {
                let end = tube.ends.len() as u32;
                tube.ends.push(match f64::from(k) < count {
                    true => ends[0] + (ends[1] - ends[0]) * (f64::from(k) / count),
                    false => ends[1],
                });
                tube.pieces.push([end - 1, end, end]);
                tube.segments.push(segment);
            }
        }
        Ok(tube)
    }

    /// Returns for each point whether it is within the radius, as by its distances from all segments.
    ///
    /// # Errors
    /// When most points lie so near to the surface of the tube that its pieces have to be compared one by one, and
    /// when the caller cancels.
    pub fn find_inside(
        &self,
        points: &[DVec3],
        place: impl Fn(DVec3) -> DVec3 + Sync + Send,
        exec: &Exec<'_>,
    ) -> Result<Vec<bool>, Error> {
        let tree = TriangleBvh::build(&self.ends, &self.pieces, exec.pool);
        let most = self
            .line
            .iter()
            .fold(0.0, |most: f64, p| most.max(p.abs().max_element()));
        let reach = self.radius * (1.0 + ROUNDING) + ROUNDING * most;
        let seen = || tree.visits.total();
        let budget = VisitBudget::new(LEAST_VISITS + VISITS_PER_POINT * points.len() as u64, &seen, exec);
        let found = map(points, &budget, |&p| self.contains(&tree, place(p), reach));
        found.map_err(|stop| match stop {
            QueryStop::Cancelled => Error::Cancelled,
            QueryStop::TooMany { limit } => Error::invalid(
                "",
                format!(
                    "is a tube whose {} points take more than {limit} comparisons with this model; give it fewer points",
                    self.line.len()
                ),
            ),
        })
    }

    fn contains(&self, tree: &TriangleBvh<'_>, p: DVec3, reach: f64) -> bool {
        let reach = reach + ROUNDING * p.abs().max_element();
        let mut is_inside = false;
        tree.visit_near(p, reach * reach, &mut |place: usize, limit: &mut f64| {
            let segment = self.segments[tree.triangle_order()[place] as usize] as usize;
            let (from, to) = (self.line[segment], self.line[segment + 1]);
            if !is_inside && p.distance(closest_point_on_segment(p, from, to)) <= self.radius {
                is_inside = true;
                // Nothing is nearer than this, so the search ends.
                *limit = -1.0;
            }
        });
        is_inside
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pool::Pool;
    use crate::progress::Silent;
    use proptest::prelude::*;

    fn find(line: &[DVec3], radius: f64, points: &[DVec3]) -> Result<Vec<bool>, Error> {
        let pool = Pool::new(2).expect("threads");
        Tube::cut_pieces(line, radius)?.find_inside(points, |p| p, &Exec::new(&pool, &Silent))
    }

    fn point() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(prop_oneof![-2.0..2.0, (-8i32..8).prop_map(|n| f64::from(n) * 0.25)])
            .prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn a_tube_holds_what_a_comparison_with_every_segment_finds(
            line in prop::collection::vec(point(), 2..40),
            points in prop::collection::vec(point(), 1..60),
            radius in prop_oneof![1e-9..3.0, (1u32..12).prop_map(|n| f64::from(n) * 0.25)],
            scale in prop_oneof![Just(1.0), Just(1e-3), Just(1e6)],
        ) {
            let scaled = |p: &[DVec3]| p.iter().map(|p| *p * scale).collect::<Vec<_>>();
            let (line, points, radius) = (scaled(&line), scaled(&points), radius * scale);
            let near = |p: DVec3| {
                line.windows(2).any(|s| p.distance(closest_point_on_segment(p, s[0], s[1])) <= radius)
            };
            let slowly: Vec<bool> = points.iter().map(|&p| near(p)).collect();
            prop_assert_eq!(find(&line, radius, &points), Ok(slowly));
        }
    }

    #[test]
    fn lines_of_no_length_and_of_endless_length_are_tubes_too() {
        let points = [DVec3::ZERO, DVec3::X, DVec3::splat(3.0)];
        assert_eq!(find(&[DVec3::X; 5], 0.5, &points), Ok(vec![false, true, false]));
        let endless = [DVec3::splat(-1e300), DVec3::splat(1e300)];
        assert_eq!(find(&endless, 0.5, &points).map(|found| found.len()), Ok(3));
        assert_eq!(find(&points, 1e300, &points), Ok(vec![true; 3]));
    }

    #[test]
    fn a_tube_of_too_many_points_or_at_its_radius_from_everything_is_refused() {
        let circle = |count: usize| {
            let at = |k: usize| std::f64::consts::TAU * k as f64 / count as f64;
            (0..count)
                .map(move |k| DVec3::new(libm::cos(at(k)), libm::sin(at(k)), 0.0))
                .collect::<Vec<_>>()
        };
        let middle: Vec<DVec3> = (0..2000).map(|k| DVec3::Z * (f64::from(k) * 1e-9)).collect();
        assert!(matches!(
            find(&circle(MOST_TUBE_POINTS + 1), 0.5, &middle),
            Err(Error::Invalid { .. })
        ));
        // The sides of this circle come as near as 0.9999997.
        assert!(matches!(
            find(&circle(MOST_TUBE_POINTS), 0.9999995, &middle),
            Err(Error::Invalid { .. })
        ));
        assert_eq!(find(&circle(MOST_TUBE_POINTS), 0.5, &middle), Ok(vec![false; 2000]));
    }
}
