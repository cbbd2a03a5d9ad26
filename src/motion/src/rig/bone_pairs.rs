//! How the bones of a clip and of a model stand to each other at the reference pose: which way both face, and how much larger one is.

use super::bones::{MotionRig, RigBone};
use super::legs::Leg;
use super::rigid_motion::rotation_about;
use crate::signed_axis::SignedAxis;
use glam::{DQuat, DVec3};

/// Where a bone lies in the model and in the clip at its reference pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct BonePair {
    pub(super) model: [DVec3; 2],
    /// The end is `None` for a joint whose end is unknown.
    pub(super) clip: (DVec3, Option<DVec3>),
}

/// The heading of a model whose vertical is any axis.
pub(super) fn heading_for_vertical(pairs: &[BonePair], up: SignedAxis) -> Heading {
    if up == SignedAxis::Y {
        return heading(pairs);
    }
    let stand = DQuat::from_rotation_arc(up.direction(), DVec3::Y);
    let upright = |pair: &BonePair| BonePair {
        model: pair.model.map(|p| stand * p),
        ..*pair
    };
    let upright: Vec<BonePair> = pairs.iter().map(upright).collect();
    let found = heading(&upright);
    Heading {
        turn: (stand.inverse() * found.turn).normalize(),
        ..found
    }
}

/// The turn about the vertical that lets a clip face as the model does: of all such turns the one that brings the clip's joints
/// nearest to the model's, both about their means. It is nothing where both are almost on one vertical line. A clip
/// that lies along z, such as one whose vertical is z, is turned upright before, where that brings it nearer.
fn heading(pairs: &[BonePair]) -> Heading {
    let upright = turn_about_vertical(pairs.iter().flat_map(points_of).collect());
    let clip = || pairs.iter().flat_map(points_of).map(|p| p[1]);
    let low = clip().fold(DVec3::INFINITY, |a, p| a.min(p));
    let high = clip().fold(DVec3::NEG_INFINITY, |a, p| a.max(p));
    let (tall, long) = (high.y - low.y, high.z - low.z);
    let as_read = Heading {
        turn: upright.0,
        up: DVec3::Y,
    };
    if long <= LYING * tall {
        return as_read;
    }
    let stood = |p: DVec3| DVec3::new(p.x, p.z, -p.y);
    let standing = pairs.iter().flat_map(points_of).map(|[m, c]| [m, stood(c)]);
    let standing = turn_about_vertical(standing.collect());
    if standing.1 <= upright.1 {
        return as_read;
    }
    Heading {
        turn: standing.0 * rotation_about(DVec3::X, -std::f64::consts::FRAC_PI_2),
        up: DVec3::Z,
    }
}

/// How a clip is turned to stand as a model does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Heading {
    /// From the clip's space to the model's.
    pub(super) turn: DQuat,
    /// The clip's axis that becomes the vertical.
    pub(super) up: DVec3,
}

/// How much longer a clip is along z than along y whose vertical may be z.
const LYING: f64 = 1.5;

/// The turn about the vertical that brings clip's points nearest to the model's, and how near they then are: larger is nearer.
fn turn_about_vertical(points: Vec<[DVec3; 2]>) -> (DQuat, f64) {
    let count = points.len().max(1) as f64;
    let [model_mean, clip_mean] = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<DVec3>() / count);
    let (mut along, mut across, mut size, mut level) = (0.0, 0.0, 0.0, 0.0);
    for [model, clip] in points {
        let (m, c) = (model - model_mean, clip - clip_mean);
        along += m.x * c.x + m.z * c.z;
        // Positive where the clip has to be turned from z towards x.
        across += m.x * c.z - m.z * c.x;
        level += m.y * c.y;
        size += m.length() * c.length();
    }
    let near = libm::hypot(along, across);
    if near <= 1e-6 * size {
        return (DQuat::IDENTITY, level);
    }
    (rotation_about(DVec3::Y, libm::atan2(across, along)), level + near)
}

fn points_of(pair: &BonePair) -> impl Iterator<Item = [DVec3; 2]> {
    let end = pair.clip.1.map(|end| [pair.model[1], end]);
    [Some([pair.model[0], pair.clip.0]), end].into_iter().flatten()
}

/// Model units for one unit of a clip: the lengths of the model's legs over those of the clip's, so that steps are as long as legs
/// make them and feet on the floor stay there. `None` without legs that have a length.
pub(super) fn scale_of_legs(rig: &MotionRig, legs: &[Leg], pairs: &[BonePair]) -> Option<f64> {
    let length = |[hip, knee, ankle]: [DVec3; 3]| hip.distance(knee) + knee.distance(ankle);
    let (mut model, mut clip) = (0.0, 0.0);
    for leg in legs {
        let [thigh, shin] = [leg.thigh, leg.shin].map(|bone| &pairs[bone]);
        let Some(ankle) = leg.foot.map_or(shin.clip.1, |foot| Some(pairs[foot].clip.0)) else {
            continue;
        };
        model += length(leg.rest_joints(rig));
        clip += length([thigh.clip.0, shin.clip.0, ankle]);
    }
    (clip > 0.0 && model > 0.0).then(|| model / clip)
}

/// Model units for one unit of a clip: the lengths of the model's bones over those of the clip's. 1 where the clip's have none.
pub(super) fn scale_of_bones(bones: &[RigBone], pairs: &[BonePair]) -> f64 {
    let (mut model, mut clip) = (0.0, 0.0);
    for (bone, pair) in bones.iter().zip(pairs) {
        let mut add = |[a, b]: [DVec3; 2], from: DVec3, to: DVec3| {
            let length = from.distance(to);
            if length > 0.0 {
                model += a.distance(b);
                clip += length;
            }
        };
        if let Some(end) = pair.clip.1 {
            add(pair.model, pair.clip.0, end);
        }
        if let Some(parent) = bone.parent.map(|p| &pairs[p]) {
            add([parent.model[0], pair.model[0]], parent.clip.0, pair.clip.0);
        }
    }
    match clip > 0.0 && model > 0.0 {
        true => model / clip,
        false => 1.0,
    }
}
