//! How every node gets its rotation and scale (paper section 2.1).
//!
//! Rotations are blended as rotation vectors relative to a base handle, so any number of turns is spread evenly; how
//! several axes go together is in [`crate::rotation`]. Scales are blended as logarithms, so that halving and
//! doubling weigh the same. [`FirstPass`] says what may replace the blend of rotations; scales stay as they are.
//!
//! Animations, which solve many poses a second, blend rotations without trigonometry. At each node the quaternions of the
//! few handles with a weight there get the sign of the heaviest one, are weighted, summed and normalised. It costs some
//! multiplications a node, and is as good as the mean on the sphere where handles differ by less than half a turn there;
//! whole turns are lost.

use crate::body::DeformableBody;
use crate::first_pass::blend::{IDENTITY_FRAME, LocalFrame, LocalRotation, PoseBlend, pack_frame};
use crate::handles::system::HandleSystem;
use crate::pose::{FirstPass, PoseRequest};
use crate::rotation::Transform;
use glam::{DQuat, Quat};
use pliant_exec::pool::Pool;
use pliant_mesh::rotation::exp_rotation;
use std::borrow::Cow;

/// The frames of all nodes for the holds' transforms (`transforms[k]` belongs to hold k of the handles), by harmonic fields.
pub fn frames(body: &DeformableBody, handles: &HandleSystem, transforms: &[Transform], pool: &Pool) -> Vec<LocalFrame> {
    blend_frames_with(body, handles, transforms, None, pool)
}

/// How one pose gets its rotations: what [`FirstPass`] comes to, decided once at the top of a solve.
pub(crate) struct FirstRotations<'a> {
    /// Rotations in place of the blend by harmonic fields; `None` for the blend itself, and where nothing is turned.
    pub instead: Option<Cow<'a, [LocalRotation]>>,
    /// Whether the pose is one of an animation: nodes follow weighted sums, and sums over edges are in single precision.
    pub is_animation: bool,
}

impl<'a> FirstRotations<'a> {
    /// Those of the blend by harmonic fields.
    pub const BLEND: Self = Self {
        instead: None,
        is_animation: false,
    };

    /// Those that a pose asks for.
    pub fn of(body: &DeformableBody, handles: &HandleSystem, request: &PoseRequest<'a>, pool: &Pool) -> Self {
        let transforms = request.transforms;
        let is_unturned = || PoseBlend::new(body, handles, transforms, None).is_unturned();
        match request.first_pass {
            FirstPass::Harmonic => Self::BLEND,
            FirstPass::Given(turns) => Self {
                instead: turns.map(Cow::Borrowed),
                is_animation: false,
            },
            FirstPass::WeightedSum => Self {
                instead: (!is_unturned()).then(|| Cow::Owned(weighted_sums(handles, transforms, pool))),
                is_animation: true,
            },
        }
    }
}

/// As [`frames`], with other rotations where there are any.
pub(crate) fn blend_frames_with(
    body: &DeformableBody,
    handles: &HandleSystem,
    transforms: &[Transform],
    instead: Option<&[LocalRotation]>,
    pool: &Pool,
) -> Vec<LocalFrame> {
    let blend = PoseBlend::new(body, handles, transforms, instead);
    pool.map(body.nodes(), 1024, |i| match (blend.rotation(i), blend.scale(i)) {
        (None, None) => IDENTITY_FRAME,
        (rotation, scale) => pack_frame(rotation.unwrap_or(DQuat::IDENTITY), scale),
    })
}

/// The rotations of all nodes for the holds' transforms.
fn weighted_sums(handles: &HandleSystem, transforms: &[Transform], pool: &Pool) -> Vec<LocalRotation> {
    let shares = handles.sparse_shares(pool);
    // The frozen surroundings stand still; they come after the holds.
    let holds: Vec<Quat> = (transforms.iter())
        .map(|t| exp_rotation(t.rotation).as_quat())
        .chain([Quat::IDENTITY])
        .collect();
    let blend = |node: usize| {
        let some = shares.at(node);
        let Some(&(most, _)) = some.first() else {
            return Quat::IDENTITY.to_array();
        };
        let most = holds[most as usize];
        let mut sum = Quat::from_array([0.0; 4]);
        for &(hold, share) in some {
            let hold = holds[hold as usize];
            let share = if hold.dot(most) < 0.0 { -share } else { share };
            sum += hold * share;
        }
        match sum.length_squared() > 1e-12 {
            true => sum.normalize().to_array(),
            false => most.to_array(),
        }
    };
    pool.map(shares.nodes(), 4096, blend)
}
