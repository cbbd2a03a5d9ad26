//! The first pass: every node's rotation and scale, blended from the handles' by their fields (paper section 2.1).
//!
//! Rotations are blended as rotation vectors relative to a base handle, so any number of turns is spread evenly; how
//! several axes go together is [`super::blending`]'s. Scales are blended as logarithms, so that halving and doubling
//! weigh the same. [`FirstPass`] says what may replace the blend of rotations; scales stay as they are.

use super::blending::Blending;
use super::rig::Rig;
use super::rotation::{exp_rotation, exp_symmetric, relative_rotation};
use super::{Body, Error, Transform, diffusion, linear_frames};
use crate::exec::Exec;
use crate::pool::Pool;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

/// How rotations are spread from the handles over the nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FirstPass {
    /// Blended with bounded harmonic fields (the paper's choice, after Zayer et al. 2005). Any number of turns.
    #[default]
    Harmonic,
    /// The state at rest of the paper's orientation diffusion, equation (2), begun at the blend. Unit quaternions do not
    /// tell one full turn from two: where a handle has turned further than that, the blend stays as it is.
    Diffusion,
    /// The linear frames of Lipman et al. 2005, made orthogonal afterwards, for comparison: they pile turns up half-way
    /// between handles and know none beyond half a circle.
    LinearFrames,
}

/// A node's linear map R S, column-major.
pub type Frame = [f32; 9];

/// The identity frame.
pub(super) const IDENTITY_FRAME: Frame = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// A rotation per node, as (x, y, z, w) of a unit quaternion.
pub(super) type Turn = [f32; 4];

pub(super) fn turn(q: DQuat) -> Turn {
    q.as_quat().to_array()
}

pub(super) fn rotation(turn: Turn) -> DQuat {
    glam::Quat::from_array(turn).as_dquat().normalize()
}

/// The frames of all nodes for the holds' transforms (`transforms[k]` belongs to hold k of the rig), by harmonic fields.
pub fn frames(body: &Body, rig: &Rig, transforms: &[Transform], pool: &Pool) -> Vec<Frame> {
    frames_with(body, rig, transforms, None, pool)
}

/// As [`frames`], with other rotations where there are any.
pub(super) fn frames_with(
    body: &Body,
    rig: &Rig,
    transforms: &[Transform],
    instead: Option<&[Turn]>,
    pool: &Pool,
) -> Vec<Frame> {
    let blend = Blend::new(body, rig, transforms, instead);
    pool.install(|| {
        (0..body.nodes())
            .into_par_iter()
            .with_min_len(1024)
            .map(|i| match (blend.rotation(i), blend.scale(i)) {
                (None, None) => IDENTITY_FRAME,
                (rotation, scale) => frame(rotation.unwrap_or(DQuat::IDENTITY), scale),
            })
            .collect()
    })
}

/// The rotations that take the blend's place: none for [`FirstPass::Harmonic`], nor where nothing is turned.
pub(super) fn instead(
    body: &Body,
    rig: &Rig,
    transforms: &[Transform],
    how: FirstPass,
    exec: &Exec<'_>,
) -> Result<Option<Vec<Turn>>, Error> {
    let blend = Blend::new(body, rig, transforms, None);
    match how {
        FirstPass::Harmonic => Ok(None),
        _ if blend.rotations.are_still() => Ok(None),
        FirstPass::Diffusion => diffusion::diffuse(body, rig, &blend, exec).map(Some),
        FirstPass::LinearFrames => Ok(Some(linear_frames::linear_frames(&blend, body.nodes(), exec.pool))),
    }
}

/// R S of a node.
pub(super) fn frame(rotation: DQuat, scale: Option<DMat3>) -> Frame {
    let r = DMat3::from_quat(rotation);
    scale.map_or(r, |s| r * s).as_mat3().to_cols_array()
}

/// Rotations and scales of a pose, node by node.
pub(super) struct Blend<'a> {
    rotations: Rotations<'a>,
    scales: Scales<'a>,
    component: &'a [u32],
    instead: Option<&'a [Turn]>,
}

impl<'a> Blend<'a> {
    pub fn new(body: &'a Body, rig: &'a Rig, transforms: &[Transform], instead: Option<&'a [Turn]>) -> Self {
        Self {
            rotations: Rotations::new(rig, transforms),
            scales: Scales::new(rig, transforms),
            component: &body.graph.component,
            instead,
        }
    }

    /// The rotation at a node; `None` for the identity.
    pub fn rotation(&self, node: usize) -> Option<DQuat> {
        match self.instead {
            Some(turns) if turns[node] == turn(DQuat::IDENTITY) => None,
            Some(turns) => Some(rotation(turns[node])),
            None => self.rotations.at(node, self.component[node] as usize),
        }
    }

    /// The scale at a node, a symmetric matrix; `None` for the identity.
    pub fn scale(&self, node: usize) -> Option<DMat3> {
        self.scales.at(node)
    }

    /// Whether any handle that constrains rotations has a say at a node.
    pub fn is_covered(&self, node: usize) -> bool {
        self.rotations.covered[self.component[node] as usize]
    }

    /// The rotation of a hold, or of the frozen surroundings, which come last; with the sign that the blend has there.
    pub fn held(&self, hold: usize) -> DQuat {
        self.rotations.held(hold)
    }

    /// The weighted sum of the holds' rotation matrices at a node; `None` where nothing is turned.
    pub fn matrix(&self, node: usize) -> Option<DMat3> {
        self.rotations.matrix(node, self.component[node] as usize)
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
struct Term<'a> {
    hold: usize,
    field: &'a [f32],
    vector: DVec3,
}

/// The moved handles' rotations relative to a base, with their fields.
struct Rotations<'a> {
    base: DQuat,
    turned_base: bool,
    terms: Vec<Term<'a>>,
    covered: &'a [bool],
    blending: Blending,
}

impl<'a> Rotations<'a> {
    fn new(rig: &'a Rig, transforms: &[Transform]) -> Self {
        let fields = rig.blending_fields.as_ref().unwrap_or(&rig.rotation_fields);
        // The frozen surroundings stand still; they come after the holds.
        let rotation = |k: usize| transforms.get(k).map_or(DVec3::ZERO, |t| t.rotation);
        let active: Vec<usize> = (0..=rig.holds()).filter(|&k| !fields.of(k).is_empty()).collect();
        let base_hold = active
            .iter()
            .copied()
            .find(|&k| rotation(k) == DVec3::ZERO)
            .or(active.first().copied());
        let base = base_hold.map_or(DVec3::ZERO, rotation);
        let terms: Vec<_> = active
            .iter()
            .map(|&hold| Term {
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
            blending: Blending::new(&vectors),
            terms,
            covered: &fields.covered,
        }
    }

    /// Whether the rotation is the identity everywhere.
    fn are_still(&self) -> bool {
        self.terms.is_empty() && !self.turned_base
    }

    /// The terms with a say at a node: (index, weight).
    fn weights(&self, node: usize) -> Vec<(usize, f64)> {
        let weights = self.terms.iter().enumerate();
        weights
            .map(|(k, term)| (k, f64::from(term.field[node])))
            .filter(|(_, u)| *u > 0.0)
            .collect()
    }

    /// The rotation at a node; `None` for the identity.
    fn at(&self, node: usize, component: usize) -> Option<DQuat> {
        if !self.covered[component] || self.are_still() {
            return None;
        }
        let weights = self.weights(node);
        if weights.is_empty() && !self.turned_base {
            return None;
        }
        let blend = match weights.as_slice() {
            [] => DQuat::IDENTITY,
            some => self.blending.at(some),
        };
        Some(if self.turned_base { self.base * blend } else { blend })
    }

    fn held(&self, hold: usize) -> DQuat {
        match self.terms.iter().position(|t| t.hold == hold) {
            Some(k) => self.base * self.blending.at(&[(k, 1.0)]),
            None => self.base,
        }
    }

    fn matrix(&self, node: usize, component: usize) -> Option<DMat3> {
        if !self.covered[component] || self.are_still() {
            return None;
        }
        let weights = self.weights(node);
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
struct Scales<'a> {
    terms: Vec<(&'a [f32], DMat3)>,
}

impl<'a> Scales<'a> {
    fn new(rig: &'a Rig, transforms: &[Transform]) -> Self {
        let fields = rig.scale_fields.as_deref().unwrap_or(&rig.rotation_fields);
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
