//! The first pass: every node's rotation and scale, blended from the handles' by their fields (paper section 2.1).
//!
//! Rotations are blended as rotation vectors relative to a base handle, so any number of turns is spread evenly; where
//! several axes are in play and none turns past half a circle, a few Karcher steps make the blend independent of the
//! base. Scales are blended as logarithms, so that halving and doubling weigh the same.

use super::rig::Rig;
use super::rotation::{blend_rotations, coaxial, exp_rotation, exp_symmetric, relative_rotation, within_half_turn};
use super::{Body, Transform};
use crate::pool::Pool;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

/// A node's linear map R S, column-major.
pub type Frame = [f32; 9];

/// The identity frame.
pub(super) const IDENTITY_FRAME: Frame = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// Steps towards the Karcher mean from the log-space start; more change nothing that can be seen.
const KARCHER_STEPS: usize = 3;

/// The frames of all nodes for the holds' transforms (`transforms[k]` belongs to hold k of the rig).
pub fn frames(body: &Body, rig: &Rig, transforms: &[Transform], pool: &Pool) -> Vec<Frame> {
    let rotations = Rotations::new(rig, transforms);
    let scales = Scales::new(rig, transforms);
    let component = &body.graph.component;
    pool.install(|| {
        (0..body.nodes())
            .into_par_iter()
            .with_min_len(1024)
            .map(|i| {
                let rotation = rotations.at(i, component[i] as usize);
                match (rotation, scales.at(i)) {
                    (None, None) => IDENTITY_FRAME,
                    (rotation, scale) => {
                        let r = rotation.map_or(DMat3::IDENTITY, DMat3::from_quat);
                        scale.map_or(r, |s| r * s).as_mat3().to_cols_array()
                    }
                }
            })
            .collect()
    })
}

/// The moved handles' rotations relative to a base, with their fields.
struct Rotations<'a> {
    base: DQuat,
    turned_base: bool,
    terms: Vec<(&'a [f32], DVec3)>,
    covered: &'a [bool],
    karcher: usize,
}

impl<'a> Rotations<'a> {
    fn new(rig: &'a Rig, transforms: &[Transform]) -> Self {
        let fields = &rig.rotation_fields;
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
            .map(|&k| (fields.of(k), relative_rotation(base, rotation(k))))
            .filter(|(_, v)| *v != DVec3::ZERO)
            .collect();
        let vectors: Vec<DVec3> = terms.iter().map(|t| t.1).collect();
        let karcher = if coaxial(&vectors) || !within_half_turn(&vectors) {
            0
        } else {
            KARCHER_STEPS
        };
        Self {
            base: exp_rotation(base),
            turned_base: base != DVec3::ZERO,
            terms,
            covered: &fields.covered,
            karcher,
        }
    }

    /// The rotation at a node; `None` for the identity.
    fn at(&self, node: usize, component: usize) -> Option<DQuat> {
        if !self.covered[component] || (self.terms.is_empty() && !self.turned_base) {
            return None;
        }
        let weighted: Vec<(f64, DVec3)> = self
            .terms
            .iter()
            .map(|(field, v)| (f64::from(field[node]), *v))
            .filter(|(u, _)| *u > 0.0)
            .collect();
        if weighted.is_empty() && !self.turned_base {
            return None;
        }
        let blend = match weighted.as_slice() {
            [] => DQuat::IDENTITY,
            some => blend_rotations(some, self.karcher),
        };
        Some(if self.turned_base { self.base * blend } else { blend })
    }
}

/// The scaled handles' log-scales with their fields.
struct Scales<'a> {
    terms: Vec<(&'a [f32], DMat3)>,
}

impl<'a> Scales<'a> {
    fn new(rig: &'a Rig, transforms: &[Transform]) -> Self {
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
