//! Rotation and scale of each node, blended from the handles' by their fields, and frames of nodes as they are stored.
//!
//! Frames of all nodes many times a second: about one axis by three matrices and a polynomial, else as the first pass blends them.

use crate::body::DeformableBody;
use crate::field_terms::FieldTerms;
use crate::fields::HarmonicFields;
use crate::handles::system::HandleSystem;
use crate::rotation::{RotationBlending, Transform};
use glam::{DMat3, DQuat, DVec3, Mat3};
use pliant_mesh::rotation::{exp_rotation, exp_symmetric, relative_rotation};
use pliant_solver::{MapColumns, prefetch};
use std::f64::consts::{FRAC_2_PI, FRAC_PI_2};

/// A node's linear map R S, column-major.
pub type LocalFrame = [f32; 9];

/// The identity frame.
pub(crate) const IDENTITY_FRAME: LocalFrame = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// A rotation per node, as (x, y, z, w) of a unit quaternion.
pub type LocalRotation = [f32; 4];

/// A rotation as it is stored for a node.
pub fn pack_rotation(q: DQuat) -> LocalRotation {
    q.as_quat().to_array()
}

pub(crate) fn unpack_rotation(turn: LocalRotation) -> DQuat {
    glam::Quat::from_array(turn).as_dquat().normalize()
}

/// R S of a node.
pub(crate) fn pack_frame(rotation: DQuat, scale: Option<DMat3>) -> LocalFrame {
    let r = DMat3::from_quat(rotation);
    scale.map_or(r, |s| r * s).as_mat3().to_cols_array()
}

/// Rotations and scales of a pose, node by node.
pub struct PoseBlend<'a> {
    rotations: HandleRotations<'a>,
    scales: HandleScales<'a>,
    component: &'a [u32],
    instead: Option<&'a [LocalRotation]>,
}

impl<'a> PoseBlend<'a> {
    /// Those of the holds' transforms; `instead` of blended rotations those of all nodes, where they are given.
    pub fn new(
        body: &'a DeformableBody,
        handles: &'a HandleSystem,
        transforms: &[Transform],
        instead: Option<&'a [LocalRotation]>,
    ) -> Self {
        Self {
            rotations: HandleRotations::new(handles, transforms),
            scales: HandleScales::new(handles, transforms),
            component: &body.graph.component,
            instead,
        }
    }

    /// The rotation at a node; `None` for the identity.
    pub fn rotation(&self, node: usize) -> Option<DQuat> {
        match self.instead {
            Some(turns) if turns[node] == pack_rotation(DQuat::IDENTITY) => None,
            Some(turns) => Some(unpack_rotation(turns[node])),
            None => self.rotations.at(node, self.component[node] as usize),
        }
    }

    /// Whether all rotations are about one axis and no handle is scaled: what the blend is made of then.
    fn one_axis(&self) -> Option<OneAxisBlend<'a>> {
        let rotations = &self.rotations;
        let axis = rotations
            .blending
            .axis()
            .filter(|_| self.is_unscaled() && self.instead.is_none())?;
        Some(OneAxisBlend {
            base: rotations.base,
            axis,
            terms: FieldTerms::new(rotations.fields, {
                (rotations.terms.iter()).map(|t| (t.hold, t.vector.dot(axis)))
            }),
            covered: rotations.covered,
            component: self.component,
        })
    }

    /// R S at a node, with no memory of its own but `scratch`. `None` for the identity.
    pub(crate) fn map(&self, node: usize, scratch: &mut Vec<(usize, f64)>) -> Option<DMat3> {
        let component = self.component[node] as usize;
        let rotation = self.rotations.at_with(node, component, scratch);
        match (rotation, self.scale(node)) {
            (None, scale) => scale,
            (Some(rotation), None) => Some(DMat3::from_quat(rotation)),
            (Some(rotation), Some(scale)) => Some(DMat3::from_quat(rotation) * scale),
        }
    }

    /// The scale at a node, a symmetric matrix; `None` for the identity.
    pub fn scale(&self, node: usize) -> Option<DMat3> {
        self.scales.at(node)
    }

    /// Whether no handle is scaled.
    pub fn is_unscaled(&self) -> bool {
        self.scales.terms.is_empty()
    }

    /// Whether any handle that constrains rotations has a say at a node.
    pub fn is_covered(&self, node: usize) -> bool {
        self.rotations.covered[self.component[node] as usize]
    }

    /// The rotation of a hold, or of the frozen surroundings, which come last; with the sign that the blend has there.
    pub fn held_rotation(&self, hold: usize) -> DQuat {
        self.rotations.held_rotation(hold)
    }

    /// The weighted sum of the holds' rotation matrices at a node; `None` where nothing is turned.
    pub fn matrix(&self, node: usize) -> Option<DMat3> {
        self.rotations.matrix(node, self.component[node] as usize)
    }

    /// Whether the rotation is the identity everywhere.
    pub fn is_unturned(&self) -> bool {
        self.rotations.are_still()
    }

    /// The longest way from the base to any hold's rotation, in radians.
    pub fn reach(&self) -> f64 {
        self.rotations
            .terms
            .iter()
            .map(|t| t.vector.length())
            .fold(0.0, f64::max)
    }
}

/// Rotations about one axis: the turn of `base`, and before it one about `axis` by the sum of the terms' shares of their angles.
struct OneAxisBlend<'a> {
    pub base: DQuat,
    /// A unit vector.
    pub axis: DVec3,
    /// Angles in radians.
    pub terms: FieldTerms<'a, f64>,
    /// By component: whether any handle that constrains rotations has a say there.
    pub covered: &'a [bool],
    pub component: &'a [u32],
}

/// The rotation of one hold relative to the base.
struct RotationTerm {
    hold: usize,
    vector: DVec3,
}

/// The moved handles' rotations relative to a base, with their fields.
struct HandleRotations<'a> {
    base: DQuat,
    turned_base: bool,
    /// By rising hold.
    terms: Vec<RotationTerm>,
    fields: &'a HarmonicFields,
    /// By hold, the number of its term.
    numbers: FieldTerms<'a, usize>,
    covered: &'a [bool],
    blending: RotationBlending,
}

impl<'a> HandleRotations<'a> {
    fn new(handles: &'a HandleSystem, transforms: &[Transform]) -> Self {
        let fields = handles.blending_fields.as_ref().unwrap_or(&handles.rotation_fields);
        // The frozen surroundings stand still; they come after the holds.
        let rotation = |k: usize| transforms.get(k).map_or(DVec3::ZERO, |t| t.rotation);
        let active: Vec<usize> = (0..=handles.handle_count()).filter(|&k| fields.has_say(k)).collect();
        let base_hold = active
            .iter()
            .copied()
            .find(|&k| rotation(k) == DVec3::ZERO)
            .or(active.first().copied());
        let base = base_hold.map_or(DVec3::ZERO, rotation);
        let terms: Vec<_> = active
            .iter()
            .map(|&hold| RotationTerm {
                hold,
                vector: relative_rotation(base, rotation(hold)),
            })
            .filter(|term| term.vector != DVec3::ZERO)
            .collect();
        let vectors: Vec<DVec3> = terms.iter().map(|t| t.vector).collect();
        Self {
            base: exp_rotation(base),
            turned_base: base != DVec3::ZERO,
            blending: RotationBlending::new(&vectors),
            numbers: FieldTerms::new(
                fields,
                terms.iter().enumerate().map(|(number, term)| (term.hold, number)),
            ),
            terms,
            fields,
            covered: &fields.covered,
        }
    }

    /// Whether the rotation is the identity everywhere.
    fn are_still(&self) -> bool {
        self.terms.is_empty() && !self.turned_base
    }

    /// Puts the terms with a say at a node in the place of `weights`: (index, weight).
    fn find_weights(&self, node: usize, weights: &mut Vec<(usize, f64)>) {
        weights.clear();
        self.numbers.each_at(node, |u, &number| {
            if u > 0.0 {
                weights.push((number, f64::from(u)));
            }
        });
    }

    /// The rotation at a node; `None` for the identity.
    fn at(&self, node: usize, component: usize) -> Option<DQuat> {
        self.at_with(node, component, &mut Vec::new())
    }

    /// As [`HandleRotations::at`]; `scratch` is memory for the terms.
    fn at_with(&self, node: usize, component: usize, scratch: &mut Vec<(usize, f64)>) -> Option<DQuat> {
        if !self.covered[component] || self.are_still() {
            return None;
        }
        self.find_weights(node, scratch);
        if scratch.is_empty() && !self.turned_base {
            return None;
        }
        let blend = match scratch.as_slice() {
            [] => DQuat::IDENTITY,
            some => self.blending.at(some),
        };
        Some(if self.turned_base { self.base * blend } else { blend })
    }

    fn held_rotation(&self, hold: usize) -> DQuat {
        match self.terms.binary_search_by_key(&hold, |t| t.hold) {
            Ok(k) => self.base * self.blending.at(&[(k, 1.0)]),
            Err(_) => self.base,
        }
    }

    fn matrix(&self, node: usize, component: usize) -> Option<DMat3> {
        if !self.covered[component] || self.are_still() {
            return None;
        }
        let mut weights = Vec::new();
        self.find_weights(node, &mut weights);
        if weights.is_empty() && !self.turned_base {
            return None;
        }
        let mut sum = DMat3::IDENTITY * (1.0 - weights.iter().map(|w| w.1).sum::<f64>());
        for (k, u) in weights {
            sum += DMat3::from_quat(exp_rotation(self.terms[k].vector)) * u;
        }
        Some(DMat3::from_quat(self.base) * sum)
    }
}

/// The scaled handles' log-scales with their fields.
struct HandleScales<'a> {
    terms: FieldTerms<'a, DMat3>,
}

impl<'a> HandleScales<'a> {
    fn new(handles: &'a HandleSystem, transforms: &[Transform]) -> Self {
        let fields = handles.scale_fields.as_ref().unwrap_or(&handles.rotation_fields);
        let scaled = (transforms.iter().enumerate())
            .filter(|(k, t)| t.log_scale != DMat3::ZERO && fields.has_say(*k))
            .map(|(k, t)| (k, t.log_scale));
        Self {
            terms: FieldTerms::new(fields, scaled),
        }
    }

    /// The scale at a node; `None` for the identity.
    fn at(&self, node: usize) -> Option<DMat3> {
        let mut sum = DMat3::ZERO;
        self.terms.each_at(node, |share, log| {
            if share > 0.0 {
                sum += *log * f64::from(share);
            }
        });
        (sum != DMat3::ZERO).then(|| exp_symmetric(sum))
    }
}

/// π/2 less its nearest double.
const FRAC_PI_2_REST: f64 = 6.123_233_995_736_766e-17;

/// Angles beyond this many radians, which no hand turns, are left to the library.
const FARTHEST: f64 = 1e6;

/// Added to a double and taken off again, leaves the nearest whole number.
const ROUNDING: f64 = 6_755_399_441_055_744.0;

/// The frames of a pose.
pub(crate) struct QuickFrames<'a> {
    blend: PoseBlend<'a>,
    one_axis: Option<OneAxisFrames<'a>>,
}

/// Frames about one axis: a base, and what sine and 1 − cosine of an angle add to it (Rodrigues).
struct OneAxisFrames<'a> {
    blend: OneAxisBlend<'a>,
    matrices: [MapColumns; 3],
}

impl<'a> QuickFrames<'a> {
    pub fn new(blend: PoseBlend<'a>) -> Self {
        let one_axis = blend.one_axis().map(|blend| {
            let DVec3 { x, y, z } = blend.axis;
            let across = DMat3::from_cols_array(&[0.0, z, -y, -z, 0.0, x, y, -x, 0.0]);
            let base = DMat3::from_quat(blend.base);
            let matrices = [base, base * across, base * across * across];
            OneAxisFrames {
                blend,
                matrices: matrices.map(|m| columns(&m.as_mat3())),
            }
        });
        Self { blend, one_axis }
    }

    /// The frame of a node; `scratch` is memory for the terms.
    #[inline]
    pub fn at(&self, node: usize, scratch: &mut Vec<(usize, f64)>) -> MapColumns {
        match &self.one_axis {
            Some(frames) => frames.at(node),
            None => self.blended_at(node, scratch),
        }
    }

    /// Asks memory for what the frame of a node is made from.
    #[inline]
    pub fn prefetch(&self, node: usize) {
        if let Some(OneAxisFrames { blend, .. }) = &self.one_axis {
            prefetch(blend.component, node);
            blend.terms.prefetch(node);
        }
    }

    fn blended_at(&self, node: usize, scratch: &mut Vec<(usize, f64)>) -> MapColumns {
        let map = self.blend.map(node, scratch);
        columns(&map.map_or(Mat3::IDENTITY, |map| map.as_mat3()))
    }
}

impl OneAxisFrames<'_> {
    #[inline]
    fn at(&self, node: usize) -> MapColumns {
        let OneAxisBlend {
            terms,
            covered,
            component,
            ..
        } = &self.blend;
        if !covered[component[node] as usize] {
            return columns(&Mat3::IDENTITY);
        }
        let mut angle = 0.0;
        terms.each_at(node, |share, whole| angle += f64::from(share).max(0.0) * whole);
        let [base, by_sine, by_rest] = &self.matrices;
        if angle == 0.0 {
            return *base;
        }
        let (sine, cosine) = sin_cos(angle);
        let (sine, rest) = (sine as f32, (1.0 - cosine) as f32);
        std::array::from_fn(|k| {
            let column = |c: usize| base[k][c] + by_sine[k][c] * sine + by_rest[k][c] * rest;
            std::array::from_fn(column)
        })
    }
}

fn columns(map: &Mat3) -> MapColumns {
    map.to_cols_array_2d().map(|[x, y, z]| [x, y, z, 0.0])
}

/// Sine and cosine. On an eighth of a turn either side of 0 the Taylor series up to x¹³ and x¹² are off by less than the term
/// left out: (π/4)¹⁵ / 15! < 3e-14 and (π/4)¹⁴ / 14! < 4e-13; taking quarter turns off loses 1e-16 of the angle.
#[inline]
fn sin_cos(x: f64) -> (f64, f64) {
    if x.is_nan() || x.abs() > FARTHEST {
        return libm::sincos(x);
    }
    let quarters = (x * FRAC_2_PI + ROUNDING) - ROUNDING;
    let r = (x - quarters * FRAC_PI_2) - quarters * FRAC_PI_2_REST;
    let s = r * r;
    let sin = 1.0 / 6_227_020_800.0;
    let sin = -1.0 / 39_916_800.0 + s * sin;
    let sin = 1.0 / 362_880.0 + s * sin;
    let sin = -1.0 / 5_040.0 + s * sin;
    let sin = 1.0 / 120.0 + s * sin;
    let sin = r + r * s * (-1.0 / 6.0 + s * sin);
    let cos = 1.0 / 479_001_600.0;
    let cos = -1.0 / 3_628_800.0 + s * cos;
    let cos = 1.0 / 40_320.0 + s * cos;
    let cos = -1.0 / 720.0 + s * cos;
    let cos = 1.0 / 24.0 + s * cos;
    let cos = 1.0 + s * (-0.5 + s * cos);
    match quarters as i64 & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_are_those_of_the_library() {
        let mut worst = 0.0f64;
        for k in -400_000..400_000 {
            let x = f64::from(k) * 1.7e-4;
            let (quick, exact) = (sin_cos(x), libm::sincos(x));
            worst = worst.max((quick.0 - exact.0).abs()).max((quick.1 - exact.1).abs());
        }
        assert!(worst < 1e-12, "{worst}");
        for odd in [0.0, -0.0, 1e-200, 1e5 + 0.3, -9e5, 1e9, f64::INFINITY, f64::NAN] {
            let (quick, exact) = (sin_cos(odd), libm::sincos(odd));
            let near = (quick.0 - exact.0).abs() < 1e-10 && (quick.1 - exact.1).abs() < 1e-10;
            assert!(
                near || exact.0.is_nan() && quick.0.is_nan(),
                "{odd}: {quick:?} against {exact:?}"
            );
        }
    }
}
