//! A cloud of Gaussian splats: what each is, and where a motion takes it.

use super::harmonics::HarmonicTurn;
use crate::{Error, Format};
use bytes::Bytes;
use glam::{DMat3, DQuat, DVec3, Vec3};
use pliant_exec::pool::Pool;
use pliant_mesh::carry::CarriedSpace;
use pliant_mesh::rotation::nearest_rotation;
use rayon::prelude::*;

/// Splats that one piece of parallel work takes.
const BATCH: usize = 256;
/// The largest logarithm of a scale: beyond it a square leaves single precision.
const MOST_LOG_SCALE: f32 = 40.0;
/// The least one that a motion makes of a larger one, when it flattens a splat.
const LEAST_LOG_SCALE: f32 = -40.0;
/// Below this cosine two axes count as perpendicular; single precision resolves no more.
const PERPENDICULAR: f64 = 1e-9;
/// Rounds of turning axes against each other; five are enough for any.
const ROUNDS: usize = 12;

/// Gaussian splats: an ellipsoid each, with a colour that depends on the side it is seen from.
///
/// Read by [`Splats::read`], moved by [`Splats::carry`], written by [`Splats::write`].
#[derive(Debug, Clone)]
pub struct Splats {
    /// The format that they came in.
    pub format: Format,
    pub(super) centers: Vec<DVec3>,
    pub(super) shapes: Vec<SplatShape>,
    pub(super) looks: Vec<SplatLook>,
    /// Normals, where the file has some that are not 0.
    pub(super) normals: Vec<Vec3>,
    /// Degree of the spherical harmonics, 0 to 3.
    pub(super) degree: u8,
    /// Their coefficients beyond degree 0: for each splat those of red, of green and of blue.
    pub(super) harmonics: Vec<f32>,
    /// What a motion has made of each.
    pub(super) changes: Vec<SplatChange>,
    /// The place of each in the file, counted from 0: parts of a divided one have the same.
    pub(super) rows: Vec<u32>,
    /// How many the file has.
    pub(super) rows_of_file: usize,
    /// How many of the file were divided.
    pub(super) divided: usize,
    /// How many were larger than the bend around them in the last motion, and stayed whole.
    pub(super) bent: usize,
    /// The file, decompressed.
    pub(super) source: Bytes,
    /// The file as it came.
    pub(super) upload: Bytes,
    /// What no other format takes, in words.
    pub(super) beyond: Vec<String>,
}

/// What has become of a splat since it was read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum SplatChange {
    /// It stands where the file has it.
    None,
    /// It has moved.
    Moved,
    /// It has moved and is a part of the one that it was.
    Divided,
}

/// The ellipsoid of a splat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SplatShape {
    /// The rotation of its axes, x, y, z, w: of length 1, or NaN where the file has none.
    pub turn: [f32; 4],
    /// Natural logarithms of the standard deviations along the axes.
    pub log_scale: [f32; 3],
}

/// What a motion leaves as it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SplatLook {
    /// Coefficients of degree 0, of red, green and blue.
    pub colour: [f32; 3],
    /// Opacity before the logistic function.
    pub opacity: f32,
}

impl SplatShape {
    /// Of numbers as a file has them: a quaternion x, y, z, w of any length.
    pub fn new(turn: [f32; 4], log_scale: [f32; 3]) -> Self {
        let quaternion = DQuat::from_array(turn.map(f64::from));
        let length = quaternion.length();
        let turn = match length.is_finite() && length > 1e-12 {
            true => (quaternion * (1.0 / length)).to_array().map(|v| v as f32),
            false => [f32::NAN; 4],
        };
        Self { turn, log_scale }
    }

    /// Whether its numbers are those of an ellipsoid.
    pub fn is_sound(&self) -> bool {
        let sound = |scale: &f32| *scale <= MOST_LOG_SCALE;
        self.turn[3].is_finite() && self.log_scale.iter().all(sound)
    }

    /// Its logarithms of scales; of one that is none that of 0.
    pub fn sound_scales(&self) -> [f32; 3] {
        let sound = |scale: f32| {
            if scale <= MOST_LOG_SCALE {
                scale
            } else {
                f32::NEG_INFINITY
            }
        };
        self.log_scale.map(sound)
    }

    /// The ellipsoid after a motion with this gradient: the axes are those of the old one, carried along and turned against each
    /// other by no more than makes them perpendicular, so that a small motion is a small change.
    fn carried(&self, gradient: DMat3) -> Self {
        let old = DQuat::from_array(self.turn.map(f64::from)).normalize();
        let frame = gradient * DMat3::from_quat(old);
        let mut axes = [frame.x_axis, frame.y_axis, frame.z_axis];
        for (axis, log_scale) in axes.iter_mut().zip(self.log_scale) {
            *axis *= libm::exp(f64::from(log_scale));
        }
        make_perpendicular(&mut axes);
        let lengths = axes.map(|axis| axis.length());
        let turn = rotation_of(axes, lengths, frame);
        let turn = if turn.dot(old) < 0.0 { -turn } else { turn };
        let mut log_scale = self.log_scale;
        for (log_scale, length) in log_scale.iter_mut().zip(lengths) {
            // What is thinner than that stays as thin.
            if *log_scale > LEAST_LOG_SCALE {
                *log_scale = (libm::log(length) as f32).max(LEAST_LOG_SCALE);
            }
        }
        Self {
            turn: turn.to_array().map(|v| v as f32),
            log_scale,
        }
    }
}

/// Turns vectors against each other until they are perpendicular; what they span and the sum of their squares stay
/// (Hestenes 1958).
fn make_perpendicular(axes: &mut [DVec3; 3]) {
    for _ in 0..ROUNDS {
        let mut done = true;
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = (axes[i], axes[j]);
            let (aa, bb, ab) = (a.length_squared(), b.length_squared(), a.dot(b));
            let is_skew = ab.abs() > PERPENDICULAR * (aa * bb).sqrt();
            if !is_skew {
                continue;
            }
            done = false;
            let ratio = (bb - aa) / (2.0 * ab);
            let tangent = ratio.signum() / (ratio.abs() + (1.0 + ratio * ratio).sqrt());
            let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
            let sine = cosine * tangent;
            (axes[i], axes[j]) = (a * cosine - b * sine, a * sine + b * cosine);
        }
        if done {
            return;
        }
    }
}

/// The rotation whose axes are these; `frame` says where one without length points.
fn rotation_of(axes: [DVec3; 3], lengths: [f64; 3], frame: DMat3) -> DQuat {
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| lengths[b].total_cmp(&lengths[a]));
    let [first, second, third] = order;
    let guesses = [frame.x_axis, frame.y_axis, frame.z_axis];
    let one = axes[first].try_normalize().or_else(|| guesses[first].try_normalize());
    let one = one.unwrap_or(DVec3::AXES[first]);
    let aside = |v: DVec3| (v - one * one.dot(v)).try_normalize();
    let two = aside(axes[second]).or_else(|| aside(guesses[second]));
    let two = two.unwrap_or_else(|| one.any_orthonormal_vector());
    // The third completes a frame of the right hand, whichever number it has.
    let side = if (second + 3 - first) % 3 == 1 { 1.0 } else { -1.0 };
    let three = one.cross(two) * side;
    let mut columns = [DVec3::ZERO; 3];
    columns[first] = one;
    columns[second] = two;
    columns[third] = three;
    DQuat::from_mat3(&DMat3::from_cols(columns[0], columns[1], columns[2])).normalize()
}

impl Splats {
    /// A cloud of no splats, with room for as many as a file has.
    pub(super) fn with_room(format: Format, rows: usize, degree: u8, upload: Bytes) -> Self {
        Self {
            format,
            centers: Vec::with_capacity(rows),
            shapes: Vec::with_capacity(rows),
            looks: Vec::with_capacity(rows),
            normals: Vec::new(),
            degree,
            harmonics: vec![0.0; rows * coefficients_of(degree)],
            changes: vec![SplatChange::None; rows],
            rows: (0..rows as u32).collect(),
            rows_of_file: rows,
            divided: 0,
            bent: 0,
            source: upload.clone(),
            upload,
            beyond: Vec::new(),
        }
    }

    /// Those of these numbers, in that order; one may be there several times.
    pub(super) fn kept(&self, numbers: &[u32]) -> Self {
        fn of<T: Copy>(all: &[T], numbers: &[u32]) -> Vec<T> {
            numbers.iter().filter_map(|&k| all.get(k as usize).copied()).collect()
        }
        let width = self.coefficients();
        let harmonics = numbers.iter().map(|&k| k as usize * width);
        Self {
            centers: of(&self.centers, numbers),
            shapes: of(&self.shapes, numbers),
            looks: of(&self.looks, numbers),
            normals: of(&self.normals, numbers),
            harmonics: harmonics
                .flat_map(|first| &self.harmonics[first..first + width])
                .copied()
                .collect(),
            changes: of(&self.changes, numbers),
            rows: of(&self.rows, numbers),
            ..self.without_splats()
        }
    }

    /// All but the splats.
    fn without_splats(&self) -> Self {
        Self {
            rows_of_file: self.rows_of_file,
            divided: self.divided,
            bent: self.bent,
            source: self.source.clone(),
            beyond: self.beyond.clone(),
            ..Self::with_room(self.format, 0, self.degree, self.upload.clone())
        }
    }

    /// Whether they are those of the file, each once and in its order.
    pub(super) fn is_whole(&self) -> bool {
        self.rows.len() == self.rows_of_file && self.rows.iter().zip(0..).all(|(row, k)| *row == k)
    }

    /// Bytes held in memory, without those of the file as it came.
    pub(super) fn bytes_held(&self) -> u64 {
        let source = if self.source.as_ptr() == self.upload.as_ptr() {
            0
        } else {
            self.source.len() as u64
        };
        self.len() as u64 * bytes_of_splat(self.coefficients()) + source
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.centers.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.centers.is_empty()
    }

    /// Where their centres are now.
    pub fn centers(&self) -> &[DVec3] {
        &self.centers
    }

    /// The longest axis of a splat as it is now, one standard deviation long; zero where its numbers are those of none.
    pub fn longest_axis(&self, splat: usize) -> DVec3 {
        let shape = &self.shapes[splat];
        if !shape.is_sound() {
            return DVec3::ZERO;
        }
        let mut longest = 0;
        for axis in 1..3 {
            if shape.log_scale[axis] > shape.log_scale[longest] {
                longest = axis;
            }
        }
        let turn = DQuat::from_array(shape.turn.map(f64::from));
        turn * DVec3::AXES[longest] * libm::exp(f64::from(shape.log_scale[longest]))
    }

    /// Coefficients of spherical harmonics of a splat beyond degree 0, of three colours.
    pub(super) fn coefficients(&self) -> usize {
        coefficients_of(self.degree)
    }

    /// Moves splats from `first` on, one for each of `spaces`: centres go where they are carried, ellipsoids turn and stretch with
    /// the gradient, and the colours by side turn with its rotation. What has not moved keeps its bits.
    ///
    /// # Panics
    /// When there are fewer splats.
    pub fn carry(&mut self, first: usize, spaces: &[CarriedSpace], pool: &Pool) {
        let turns = HarmonicTurn::new();
        let (width, degree) = (self.coefficients(), self.degree);
        let mut centers = &mut self.centers[first..];
        let mut shapes = &mut self.shapes[first..];
        let mut changes = &mut self.changes[first..];
        let mut normals = self.normals.get_mut(first..).unwrap_or_default();
        let mut harmonics = &mut self.harmonics[first * width..];
        let mut parts = Vec::new();
        for spaces in spaces.chunks(BATCH) {
            let count = spaces.len();
            parts.push(CloudPart {
                spaces,
                centers: take_first(&mut centers, count),
                shapes: take_first(&mut shapes, count),
                changes: take_first(&mut changes, count),
                normals: take_first(&mut normals, count),
                harmonics: take_first(&mut harmonics, count * width),
            });
        }
        pool.install(|| parts.into_par_iter().for_each(|part| part.carry(degree, &turns)));
    }

    /// How many have numbers that are those of no ellipsoid.
    pub(super) fn unsound(&self) -> usize {
        self.shapes.iter().filter(|shape| !shape.is_sound()).count()
    }

    /// Refuses centres that are no places.
    pub(super) fn check_centers(&self) -> Result<(), Error> {
        match self.centers.iter().position(|center| !center.is_finite()) {
            Some(i) => {
                let problem = format!("the centre is {}, not finite", self.centers[i]);
                Err(Error::malformed(self.format, format!("splat {i}"), problem))
            }
            None => Ok(()),
        }
    }
}

/// Some splats on their way.
struct CloudPart<'a> {
    spaces: &'a [CarriedSpace],
    centers: &'a mut [DVec3],
    shapes: &'a mut [SplatShape],
    changes: &'a mut [SplatChange],
    /// Empty where there are none.
    normals: &'a mut [Vec3],
    harmonics: &'a mut [f32],
}

impl CloudPart<'_> {
    fn carry(self, degree: u8, turns: &HarmonicTurn) {
        let width = coefficients_of(degree);
        for (i, space) in self.spaces.iter().enumerate() {
            if *space == CarriedSpace::resting(self.centers[i]) {
                continue;
            }
            self.changes[i] = self.changes[i].max(SplatChange::Moved);
            self.centers[i] = space.frame.position;
            if self.shapes[i].is_sound() {
                self.shapes[i] = self.shapes[i].carried(space.gradient);
            }
            if degree == 0 && self.normals.is_empty() {
                continue;
            }
            let turn = nearest_rotation(space.gradient, space.frame.rotation);
            if let Some(normal) = self.normals.get_mut(i) {
                *normal = (turn * normal.as_dvec3()).as_vec3();
            }
            if degree > 0 {
                turns.turn(degree, turn, &mut self.harmonics[i * width..(i + 1) * width]);
            }
        }
    }
}

/// Takes the first items off a slice; fewer where it has fewer.
fn take_first<'a, T>(from: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let count = count.min(from.len());
    let (first, rest) = std::mem::take(from).split_at_mut(count);
    *from = rest;
    first
}

/// Coefficients of spherical harmonics of this degree beyond degree 0, of three colours.
pub(super) fn coefficients_of(degree: u8) -> usize {
    let width = usize::from(degree) + 1;
    3 * (width * width - 1)
}

/// Bytes that a splat with so many coefficients takes while it is read.
pub(super) fn bytes_of_splat(coefficients: usize) -> u64 {
    let fixed = size_of::<DVec3>() + size_of::<SplatShape>() + size_of::<SplatLook>() + size_of::<Vec3>() + 5;
    (fixed + 4 * coefficients) as u64
}
