//! Rotation and scale of each node, blended from the handles' by their fields, and frames of nodes as they are stored.

use crate::body::DeformableBody;
use crate::field_terms::FieldTerms;
use crate::fields::HarmonicFields;
use crate::handles::system::HandleSystem;
use crate::rotation::{RotationBlending, Transform};
use glam::{DMat3, DQuat, DVec3};
use pliant_mesh::rotation::{exp_rotation, exp_symmetric, relative_rotation};

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
    pub(super) rotations: HandleRotations<'a>,
    scales: HandleScales<'a>,
    pub(super) component: &'a [u32],
    /// Whether a handle has a say at every node.
    pub(super) covers_all: bool,
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
        let rotations = HandleRotations::new(handles, transforms);
        Self {
            covers_all: rotations.covered.iter().all(|&covered| covered),
            rotations,
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

    /// The same of a number that may name no node, where it says nothing.
    pub(super) fn covers(&self, node: u32) -> bool {
        self.covers_all || (node as usize) < self.component.len() && self.is_covered(node as usize)
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

/// The rotation of one hold relative to the base.
pub(super) struct RotationTerm {
    pub(super) hold: usize,
    pub(super) vector: DVec3,
}

/// The moved handles' rotations relative to a base, with their fields.
pub(super) struct HandleRotations<'a> {
    pub(super) base: DQuat,
    pub(super) turned_base: bool,
    /// By rising hold.
    pub(super) terms: Vec<RotationTerm>,
    pub(super) fields: &'a HarmonicFields,
    /// By hold, the number of its term.
    pub(super) numbers: FieldTerms<'a, usize>,
    covered: &'a [bool],
    pub(super) blending: RotationBlending,
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
        if !self.covered[component] || self.are_still() {
            return None;
        }
        let mut weights = Vec::new();
        self.find_weights(node, &mut weights);
        if weights.is_empty() && !self.turned_base {
            return None;
        }
        let blend = match weights.as_slice() {
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
