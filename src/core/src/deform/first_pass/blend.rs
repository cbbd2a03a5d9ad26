//! Rotation and scale of each node, blended from the handles' by their fields, and frames of nodes as they are stored.

use crate::deform::body::DeformableBody;
use crate::deform::handles::system::HandleSystem;
use crate::deform::rotation::RotationBlending;
use crate::deform::transform::Transform;
use crate::mesh::rotation::{exp_rotation, exp_symmetric, relative_rotation};
use glam::{DMat3, DQuat, DVec3};

/// A node's linear map R S, column-major.
pub type LocalFrame = [f32; 9];

/// The identity frame.
pub(in crate::deform) const IDENTITY_FRAME: LocalFrame = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// A rotation per node, as (x, y, z, w) of a unit quaternion.
pub(in crate::deform) type LocalRotation = [f32; 4];

pub(in crate::deform) fn pack_rotation(q: DQuat) -> LocalRotation {
    q.as_quat().to_array()
}

pub(in crate::deform) fn unpack_rotation(turn: LocalRotation) -> DQuat {
    glam::Quat::from_array(turn).as_dquat().normalize()
}

/// R S of a node.
pub(in crate::deform) fn pack_frame(rotation: DQuat, scale: Option<DMat3>) -> LocalFrame {
    let r = DMat3::from_quat(rotation);
    scale.map_or(r, |s| r * s).as_mat3().to_cols_array()
}

/// Rotations and scales of a pose, node by node.
pub(in crate::deform) struct PoseBlend<'a> {
    rotations: HandleRotations<'a>,
    scales: HandleScales<'a>,
    component: &'a [u32],
    instead: Option<&'a [LocalRotation]>,
}

impl<'a> PoseBlend<'a> {
    pub fn new(
        body: &'a DeformableBody,
        rig: &'a HandleSystem,
        transforms: &[Transform],
        instead: Option<&'a [LocalRotation]>,
    ) -> Self {
        Self {
            rotations: HandleRotations::new(rig, transforms),
            scales: HandleScales::new(rig, transforms),
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
    pub fn one_axis(&self) -> Option<OneAxisBlend<'a>> {
        let rotations = &self.rotations;
        let axis = rotations
            .blending
            .axis()
            .filter(|_| self.is_unscaled() && self.instead.is_none())?;
        Some(OneAxisBlend {
            base: rotations.base,
            axis,
            terms: (rotations.terms.iter())
                .map(|t| (t.field, t.vector.dot(axis)))
                .collect(),
            covered: rotations.covered,
            component: self.component,
        })
    }

    /// R S at a node, with no memory of its own but `scratch`. `None` for the identity.
    pub fn map(&self, node: usize, scratch: &mut Vec<(usize, f64)>) -> Option<DMat3> {
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
pub(in crate::deform) struct OneAxisBlend<'a> {
    pub base: DQuat,
    /// A unit vector.
    pub axis: DVec3,
    /// Fields, and angles in radians.
    pub terms: Vec<(&'a [f32], f64)>,
    /// By component: whether any handle that constrains rotations has a say there.
    pub covered: &'a [bool],
    pub component: &'a [u32],
}

/// The rotation of one hold relative to the base.
struct RotationTerm<'a> {
    hold: usize,
    field: &'a [f32],
    vector: DVec3,
}

/// The moved handles' rotations relative to a base, with their fields.
struct HandleRotations<'a> {
    base: DQuat,
    turned_base: bool,
    terms: Vec<RotationTerm<'a>>,
    covered: &'a [bool],
    blending: RotationBlending,
}

impl<'a> HandleRotations<'a> {
    fn new(rig: &'a HandleSystem, transforms: &[Transform]) -> Self {
        let fields = rig.blending_fields.as_ref().unwrap_or(&rig.rotation_fields);
        // The frozen surroundings stand still; they come after the holds.
        let rotation = |k: usize| transforms.get(k).map_or(DVec3::ZERO, |t| t.rotation);
        let active: Vec<usize> = (0..=rig.handle_count()).filter(|&k| !fields.of(k).is_empty()).collect();
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
                field: fields.of(hold),
                vector: relative_rotation(base, rotation(hold)),
            })
            .filter(|term| term.vector != DVec3::ZERO)
            .collect();
        let vectors: Vec<DVec3> = terms.iter().map(|t| t.vector).collect();
        Self {
            base: exp_rotation(base),
            turned_base: base != DVec3::ZERO,
            blending: RotationBlending::new(&vectors),
            terms,
            covered: &fields.covered,
        }
    }

    /// Whether the rotation is the identity everywhere.
    fn are_still(&self) -> bool {
        self.terms.is_empty() && !self.turned_base
    }

    /// The terms with a say at a node: (index, weight).
    fn weights(&self, node: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let weights = self.terms.iter().enumerate();
        weights
            .map(move |(k, term)| (k, f64::from(term.field[node])))
            .filter(|(_, u)| *u > 0.0)
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
        scratch.clear();
        scratch.extend(self.weights(node));
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
        match self.terms.iter().position(|t| t.hold == hold) {
            Some(k) => self.base * self.blending.at(&[(k, 1.0)]),
            None => self.base,
        }
    }

    fn matrix(&self, node: usize, component: usize) -> Option<DMat3> {
        if !self.covered[component] || self.are_still() {
            return None;
        }
        let weights: Vec<(usize, f64)> = self.weights(node).collect();
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
    terms: Vec<(&'a [f32], DMat3)>,
}

impl<'a> HandleScales<'a> {
    fn new(rig: &'a HandleSystem, transforms: &[Transform]) -> Self {
        let fields = rig.scale_fields.as_ref().unwrap_or(&rig.rotation_fields);
        let terms = transforms
            .iter()
            .enumerate()
            .filter(|(k, t)| t.log_scale != DMat3::ZERO && !fields.of(*k).is_empty())
            .map(|(k, t)| (fields.of(k), t.log_scale))
            .collect();
        Self { terms }
    }

    /// The scale at a node; `None` for the identity.
    fn at(&self, node: usize) -> Option<DMat3> {
        let mut sum = DMat3::ZERO;
        for (field, log) in self.terms.iter().filter(|(field, _)| field[node] > 0.0) {
            sum += *log * f64::from(field[node]);
        }
        (sum != DMat3::ZERO).then(|| exp_symmetric(sum))
    }
}
