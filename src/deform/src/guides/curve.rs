//! Vertices along a curve: their places by a frame carried along it that does not turn about it.

use super::pose::{GuidePose, GuideProblem, MOST_POINTS, finite};
use crate::error::Error;
use glam::{DMat3, DQuat, DVec3};
use pliant_exec::Exec;
use pliant_mesh::query::closest_point::{NearestPoints, closest_parameter_on_segment};

/// Straight pieces between two points of a curve.
const PIECES: usize = 16;

/// A curve as a fine polyline with a frame at each of its places.
#[derive(Debug, Clone)]
struct FinePolyline {
    places: Vec<DVec3>,
    /// The columns: the direction, and two across it.
    frames: Vec<DMat3>,
    /// Length from the first place.
    lengths: Vec<f64>,
}

/// Vertices bound to a curve.
#[derive(Debug, Clone)]
pub(super) struct CurvePlaces {
    rest: FinePolyline,
    points: Vec<DVec3>,
    keeps_length: bool,
    /// By vertex: how far along the rest curve its nearest place lies.
    along: Vec<f64>,
    /// By vertex: its offset from there in the frame of that place.
    offsets: Vec<DVec3>,
}

impl CurvePlaces {
    pub fn bind(points: &[DVec3], keeps_length: bool, rest: &[DVec3], exec: &Exec<'_>) -> Result<Self, Error> {
        let curve = FinePolyline::through(points, None);
        let nearest = NearestPoints::new(curve.places.iter().copied().zip(0u32..));
        exec.check()?;
        let bound = exec.pool.map(rest.len(), 1024, |v| {
            let along = curve.nearest_length(rest[v], &nearest);
            let (place, frame) = curve.at(along);
            (along, frame.transpose() * (rest[v] - place))
        });
        exec.check()?;
        let (along, offsets) = bound.into_iter().unzip();
        Ok(Self {
            rest: curve,
            points: points.to_vec(),
            keeps_length,
            along,
            offsets,
        })
    }

    pub fn places(&self, rest: &[DVec3], pose: &GuidePose, exec: &Exec<'_>) -> Vec<Option<DVec3>> {
        let stays = pose.positions == self.points
            && pose.twists.iter().all(|t| *t == 0.0)
            && pose.scales.iter().all(|s| *s == 1.0);
        if stays {
            return rest.iter().copied().map(Some).collect();
        }
        let posed = FinePolyline::through(&pose.positions, Some(self.rest.frames[0]));
        let ratio = if self.keeps_length {
            1.0
        } else {
            posed.length() / self.rest.length()
        };
        exec.pool.map(rest.len(), 1024, |v| {
            let along = self.along[v] * ratio;
            let (place, frame) = posed.at(along);
            // Values belong to points of the curve, which PIECES places lie between.
            let point = posed.place_number(along) / PIECES as f64;
            let [x, y, z] = self.offsets[v].to_array();
            let (mut y, mut z) = (y, z);
            if !pose.twists.is_empty() {
                let (sin, cos) = libm::sincos(between(&pose.twists, point));
                (y, z) = (cos * y - sin * z, sin * y + cos * z);
            }
            let scale = if pose.scales.is_empty() {
                1.0
            } else {
                between(&pose.scales, point)
            };
            Some(place + frame * DVec3::new(x, y * scale, z * scale))
        })
    }

    pub fn byte_size(&self) -> usize {
        let fine = size_of::<DVec3>() + size_of::<DMat3>() + size_of::<f64>();
        fine * self.rest.places.len()
            + size_of_val(&self.points[..])
            + size_of_val(&self.along[..])
            + size_of_val(&self.offsets[..])
    }
}

impl FinePolyline {
    /// The curve through points that have been checked. Its first frame is made from `first`, the first frame of the rest curve, by
    /// the least rotation between both directions; without one, from the axis that is most across the curve.
    fn through(points: &[DVec3], first: Option<DMat3>) -> Self {
        let places = smooth_places(points);
        let mut lengths = vec![0.0];
        for pair in places.windows(2) {
            lengths.push(lengths[lengths.len() - 1] + pair[0].distance(pair[1]));
        }
        let directions = directions_at(&places);
        let start = match first {
            Some(frame) => {
                let turned = least_rotation(frame.x_axis, directions[0]);
                frame_of(directions[0], turned * frame.y_axis)
            }
            None => frame_of(directions[0], most_across(directions[0])),
        };
        let mut frames = vec![start];
        for k in 1..places.len() {
            let before = frames[k - 1];
            frames.push(transported(before, places[k] - places[k - 1], directions[k]));
        }
        Self {
            places,
            frames,
            lengths,
        }
    }

    fn length(&self) -> f64 {
        self.lengths[self.lengths.len() - 1]
    }

    /// How far along the curve its place nearest to `p` lies.
    fn nearest_length(&self, p: DVec3, nearest: &NearestPoints) -> f64 {
        let Some((k, _)) = nearest.nearest(p) else { return 0.0 };
        let k = k as usize;
        let pieces = [k.checked_sub(1), (k + 1 < self.places.len()).then_some(k)];
        let mut best = (f64::INFINITY, self.lengths[k]);
        for piece in pieces.into_iter().flatten() {
            let (a, b) = (self.places[piece], self.places[piece + 1]);
            let t = closest_parameter_on_segment(p, a, b);
            let square = (a + (b - a) * t).distance_squared(p);
            if square < best.0 {
                best = (
                    square,
                    self.lengths[piece] + t * (self.lengths[piece + 1] - self.lengths[piece]),
                );
            }
        }
        best.1
    }

    /// The piece that a length lies in, and where in it: from 0 to 1 within the curve, beyond that in its first and last piece.
    fn piece(&self, length: f64) -> (usize, f64) {
        let piece = self
            .lengths
            .partition_point(|l| *l <= length)
            .saturating_sub(1)
            .min(self.places.len() - 2);
        let all = self.lengths[piece + 1] - self.lengths[piece];
        (
            piece,
            if all > 0.0 {
                (length - self.lengths[piece]) / all
            } else {
                0.0
            },
        )
    }

    /// A length as a number of places, whole at each of them, within the curve.
    fn place_number(&self, length: f64) -> f64 {
        let (piece, t) = self.piece(length);
        piece as f64 + t.clamp(0.0, 1.0)
    }

    /// Place and frame at a length from the first point; beyond the ends straight on.
    fn at(&self, length: f64) -> (DVec3, DMat3) {
        let (piece, t) = self.piece(length);
        let (a, b) = (self.places[piece], self.places[piece + 1]);
        let [from, to] = [self.frames[piece], self.frames[piece + 1]];
        if !(0.0..=1.0).contains(&t) {
            let end = if t < 0.0 { (a, from) } else { (b, to) };
            let beyond = if t < 0.0 { length } else { length - self.length() };
            return (end.0 + end.1.x_axis * beyond, end.1);
        }
        let direction = from.x_axis.lerp(to.x_axis, t);
        (a.lerp(b, t), frame_of(direction, from.y_axis.lerp(to.y_axis, t)))
    }
}

/// Places of a cubic curve through points, [`PIECES`] between two of them (Catmull and Rom 1974, centripetal: Yuksel et al. 2011, so
/// that unequal distances make no loops). Its first and its last piece are parabolas.
fn smooth_places(points: &[DVec3]) -> Vec<DVec3> {
    let last = points.len() - 1;
    // Of an inner point, the derivative by the parameter, which goes with the square root of the distance.
    let inner = |k: usize| {
        let (a, b, c) = (points[k - 1], points[k], points[k + 1]);
        let [ab, bc] = [a.distance(b), b.distance(c)].map(f64::sqrt);
        (b - a) / ab - (c - a) / (ab + bc) + (c - b) / bc
    };
    let mut places = Vec::with_capacity(last * PIECES + 1);
    for k in 0..last {
        let b = points[k];
        let along = points[k + 1] - b;
        let size = along.length().sqrt();
        let (at_b, at_c) = match (k > 0, k + 1 < last) {
            (true, true) => (inner(k) * size, inner(k + 1) * size),
            (true, false) => (inner(k) * size, along * 2.0 - inner(k) * size),
            (false, true) => (along * 2.0 - inner(k + 1) * size, inner(k + 1) * size),
            (false, false) => (along, along),
        };
        places.extend((0..PIECES).map(|i| {
            let t = i as f64 / PIECES as f64;
            b + (at_b + ((along * 3.0 - at_b * 2.0 - at_c) + (at_b + at_c - along * 2.0) * t) * t) * t
        }));
    }
    places.push(points[last]);
    places
}

/// The direction of a polyline at each place: the mean of those of the pieces beside it.
fn directions_at(places: &[DVec3]) -> Vec<DVec3> {
    let piece = |k: usize| (places[k + 1] - places[k]).normalize_or_zero();
    let last = places.len() - 1;
    let mut before = DVec3::X;
    (0..=last)
        .map(|k| {
            let sum = match k {
                0 => piece(0),
                _ if k == last => piece(k - 1),
                _ => piece(k - 1) + piece(k),
            };
            // A curve that turns back on the spot goes on as before.
            before = sum.try_normalize().unwrap_or(before);
            before
        })
        .collect()
}

/// A right-handed frame with a direction and, as nearly as possible, the second axis given.
fn frame_of(direction: DVec3, second: DVec3) -> DMat3 {
    let x = direction.try_normalize().unwrap_or(DVec3::X);
    let across = second - x * x.dot(second);
    let y = across.try_normalize().unwrap_or_else(|| {
        let other = most_across(x);
        (other - x * x.dot(other)).normalize_or_zero()
    });
    DMat3::from_cols(x, y, x.cross(y))
}

/// The axis of space that is most across a direction.
fn most_across(direction: DVec3) -> DVec3 {
    let size = direction.abs();
    match () {
        _ if size.y <= size.x && size.y <= size.z => DVec3::Y,
        _ if size.z <= size.x => DVec3::Z,
        _ => DVec3::X,
    }
}

/// The least rotation between two unit directions; half a turn about an axis across them where they are opposite.
fn least_rotation(from: DVec3, to: DVec3) -> DQuat {
    let across = from.cross(to);
    let twice = DQuat::from_xyzw(across.x, across.y, across.z, 1.0 + from.dot(to));
    match twice.length_squared() > 1e-24 {
        true => twice.normalize(),
        false => {
            let axis = from.cross(most_across(from)).normalize_or_zero();
            DQuat::from_xyzw(axis.x, axis.y, axis.z, 0.0)
        }
    }
}

/// The frame one place on, which has not turned about the curve: two reflections (Wang, Jüttler, Zheng and Liu 2008).
fn transported(before: DMat3, step: DVec3, direction: DVec3) -> DMat3 {
    let reflected = |v: DVec3, across: DVec3| {
        let square = across.length_squared();
        if square > 0.0 {
            v - across * (2.0 * across.dot(v) / square)
        } else {
            v
        }
    };
    let second = direction - reflected(before.x_axis, step);
    frame_of(direction, reflected(reflected(before.y_axis, step), second))
}

/// The value at a place between points.
fn between(values: &[f64], point: f64) -> f64 {
    let k = (point as usize).min(values.len() - 2);
    let t = point - k as f64;
    values[k] + (values[k + 1] - values[k]) * t
}

pub(super) fn check_points(points: &[DVec3], field: &str) -> Result<(), GuideProblem> {
    if !(2..=MOST_POINTS).contains(&points.len()) {
        let problem = format!("has {} points; a curve has from 2 to {MOST_POINTS}", points.len());
        return Err(GuideProblem::new(field, problem));
    }
    finite(points, field)?;
    match points.windows(2).position(|pair| pair[0].distance(pair[1]) <= 0.0) {
        Some(k) => Err(GuideProblem::new(
            format!("{field}[{}]", k + 1),
            "is where the point before it is",
        )),
        None => Ok(()),
    }
}

/// Checks the twists and scales of a pose whose points have been checked.
pub(super) fn check_values(pose: &GuidePose) -> Result<(), GuideProblem> {
    for (field, values) in [("twists", &pose.twists), ("scales", &pose.scales)] {
        if !values.is_empty() && values.len() != pose.positions.len() {
            let problem = format!("has {} values for {} points", values.len(), pose.positions.len());
            return Err(GuideProblem::new(field, problem));
        }
    }
    if let Some(k) = pose.twists.iter().position(|t| t.is_nan() || t.abs() > 1e6) {
        return Err(GuideProblem::new(
            format!("twists[{k}]"),
            "is not an angle from -1e6 to 1e6 radians",
        ));
    }
    match pose.scales.iter().position(|s| !(*s > 0.0 && *s <= 1e6)) {
        Some(k) => Err(GuideProblem::new(
            format!("scales[{k}]"),
            "is not above 0 and at most 1e6",
        )),
        None => Ok(()),
    }
}
