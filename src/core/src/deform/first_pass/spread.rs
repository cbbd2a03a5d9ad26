//! The first pass: every node's rotation and scale, blended from the handles' by their fields (paper section 2.1).
//!
//! Rotations are blended as rotation vectors relative to a base handle, so any number of turns is spread evenly; how
//! several axes go together is [`super::blending`]'s. Scales are blended as logarithms, so that halving and doubling
//! weigh the same. [`FirstPass`] says what may replace the blend of rotations; scales stay as they are.

use crate::deform::body::DeformableBody;
use crate::deform::comparison;
use crate::deform::error::Error;
use crate::deform::first_pass::blend::PoseBlend;
use crate::deform::first_pass::frame::{IDENTITY_FRAME, LocalFrame, LocalRotation, pack_frame};
use crate::deform::first_pass::weighted_sum::weighted_sums;
use crate::deform::handles::system::HandleSystem;
use crate::deform::transform::Transform;
use crate::exec::Exec;
use crate::pool::Pool;
use glam::DQuat;
use rayon::prelude::*;

/// How rotations are spread from the handles over the nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FirstPass {
    /// Blended with bounded harmonic fields (the paper's choice, after Zayer et al. 2005). Any number of turns.
    #[default]
    Harmonic,
    /// The steady state of the paper's orientation diffusion, equation (2), begun at the blend. Unit quaternions are
    /// equal for one full turn and two: where a handle has turned further than that, the blend stays as it is.
    Diffusion,
    /// The linear frames of Lipman et al. 2005, made orthogonal afterwards, for comparison: they pile turns up half-way
    /// between handles and know none beyond half a circle.
    LinearFrames,
    /// Weighted sums of the quaternions of the few handles with a say at a node: little work, for animations, and blind to
    /// whole turns. What handles that constrain rotations alone do is taken whole where a solve starts from the last one.
    WeightedSum,
}

/// The frames of all nodes for the holds' transforms (`transforms[k]` belongs to hold k of the rig), by harmonic fields.
pub fn frames(body: &DeformableBody, rig: &HandleSystem, transforms: &[Transform], pool: &Pool) -> Vec<LocalFrame> {
    blend_frames_with(body, rig, transforms, None, pool)
}

/// How one pose gets its rotations: what [`FirstPass`] comes to, decided once at the top of a solve.
pub(in crate::deform) struct FirstRotations {
    /// Rotations in place of the blend by harmonic fields; `None` for the blend itself, and where nothing is turned.
    pub instead: Option<Vec<LocalRotation>>,
    /// Whether the pose is one of an animation: nodes follow weighted sums, and sums over edges are in single precision.
    pub is_animation: bool,
}

impl FirstRotations {
    /// Those of the blend by harmonic fields.
    pub const BLEND: Self = Self {
        instead: None,
        is_animation: false,
    };

    /// Those of `how` for the holds' transforms.
    pub fn of(
        body: &DeformableBody,
        rig: &HandleSystem,
        transforms: &[Transform],
        how: FirstPass,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        let blend = PoseBlend::new(body, rig, transforms, None);
        let instead = match how {
            FirstPass::Harmonic => None,
            _ if blend.is_unturned() => None,
            FirstPass::WeightedSum => Some(weighted_sums(rig, transforms, exec.pool)),
            FirstPass::Diffusion => Some(comparison::diffuse(body, rig, &blend, exec)?),
            FirstPass::LinearFrames => Some(comparison::linear_frames(&blend, body.nodes(), exec.pool)),
        };
        Ok(Self {
            instead,
            is_animation: how == FirstPass::WeightedSum,
        })
    }
}

/// As [`frames`], with other rotations where there are any.
pub(in crate::deform) fn blend_frames_with(
    body: &DeformableBody,
    rig: &HandleSystem,
    transforms: &[Transform],
    instead: Option<&[LocalRotation]>,
    pool: &Pool,
) -> Vec<LocalFrame> {
    let blend = PoseBlend::new(body, rig, transforms, instead);
    pool.install(|| {
        (0..body.nodes())
            .into_par_iter()
            .with_min_len(1024)
            .map(|i| match (blend.rotation(i), blend.scale(i)) {
                (None, None) => IDENTITY_FRAME,
                (rotation, scale) => pack_frame(rotation.unwrap_or(DQuat::IDENTITY), scale),
            })
            .collect()
    })
}
