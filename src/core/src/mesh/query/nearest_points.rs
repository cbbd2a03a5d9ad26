//! Nearest of a set of points, by a balanced k-d tree without pointers.

use crate::mesh::query::visits::VisitCount;
use glam::DVec3;

/// A set of points that can be asked which of them is nearest to a place.
#[derive(Debug, Clone)]
pub struct NearestPoints {
    /// Points in tree order: the median of every range stands in its middle.
    points: Vec<(DVec3, u32)>,
    /// What long queries have looked at.
    pub(crate) visits: VisitCount,
}

impl NearestPoints {
    /// Takes points with the numbers to be returned.
    pub fn new(points: impl IntoIterator<Item = (DVec3, u32)>) -> Self {
        let mut points: Vec<_> = points.into_iter().collect();
        let mut ranges = vec![(0, points.len())];
        while let Some((from, to)) = ranges.pop() {
            if to - from < 2 {
                continue;
            }
            let axis = split_axis(to - from);
            let middle = from + (to - from) / 2;
            points[from..to].select_nth_unstable_by(middle - from, |a, b| {
                a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1))
            });
            ranges.push((from, middle));
            ranges.push((middle + 1, to));
        }
        Self {
            points,
            visits: VisitCount::default(),
        }
    }

    /// The number of the nearest point and its squared distance; ties go to the smaller number. `None` without points.
    pub fn nearest(&self, place: DVec3) -> Option<(u32, f64)> {
        self.nearest_within(place, f64::INFINITY)
    }

    /// As [`NearestPoints::nearest`], for points whose squared distance is at most `square`; a small one makes the search faster.
    pub fn nearest_within(&self, place: DVec3, square: f64) -> Option<(u32, f64)> {
        let mut best: Option<(u32, f64)> = None;
        // (range, squared distance below which nothing in it can be nearer). Each range taken puts back two of half its
        // length, so there are never more than twice as many as the number of points has digits.
        let mut stack = [(0usize, 0usize, 0.0f64); 2 * usize::BITS as usize];
        stack[0].1 = self.points.len();
        let (mut waiting, mut visits) = (1, 0);
        while waiting > 0 {
            (waiting, visits) = (waiting - 1, visits + 1);
            let (from, to, bound) = stack[waiting];
            if from >= to || bound > best.map_or(square, |b| b.1) {
                continue;
            }
            let axis = split_axis(to - from);
            let middle = from + (to - from) / 2;
            let (point, number) = self.points[middle];
            let distance = point.distance_squared(place);
            let is_better = |(n, d)| distance < d || (distance == d && number < n);
            if best.map_or(distance <= square, is_better) {
                best = Some((number, distance));
            }
            let ahead = place[axis] - point[axis];
            let far = ahead * ahead;
            let halves = [(from, middle), (middle + 1, to)];
            let [near, other] = if ahead < 0.0 { halves } else { [halves[1], halves[0]] };
            // The half that the place lies in goes on top.
            stack[waiting] = (other.0, other.1, far.max(bound));
            stack[waiting + 1] = (near.0, near.1, bound);
            waiting += 2;
        }
        self.visits.add(visits);
        best
    }
}

/// Axes take turns with the size of the range, which building and asking both know.
fn split_axis(len: usize) -> usize {
    (usize::BITS - len.leading_zeros()) as usize % 3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_looking_at_every_point() {
        let mut state = 1u64;
        let mut random = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 40) as f64 / (1u64 << 24) as f64
        };
        let points: Vec<_> = (0..500)
            .map(|k| (DVec3::new(random(), random() * 0.1, random()), k))
            .collect();
        let tree = NearestPoints::new(points.iter().copied());
        for _ in 0..200 {
            let place = DVec3::new(random() * 2.0, random(), random());
            let expected = points
                .iter()
                .map(|p| (p.0.distance_squared(place), p.1))
                .min_by(|a, b| a.partial_cmp(b).unwrap());
            assert_eq!(tree.nearest(place).map(|(n, d)| (d, n)), expected);
            let square = 0.01 * random();
            let within = expected.filter(|e| e.0 <= square);
            assert_eq!(tree.nearest_within(place, square).map(|(n, d)| (d, n)), within);
        }
        assert_eq!(NearestPoints::new([]).nearest(DVec3::ZERO), None);
    }
}
