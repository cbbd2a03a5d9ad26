//! How a clip is turned and scaled to stand as a model does.

use super::bones::RigBone;
use super::swing_twist::rotation_about;
use glam::{DQuat, DVec3};

/// Where a bone lies in the model and in the clip at its reference pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct BonePair {
    pub model: [DVec3; 2],
    /// The end is `None` for a joint that nothing tells the end of.
    pub clip: (DVec3, Option<DVec3>),
}

/// The turn about the vertical that lets a clip face as the model does: of all such turns the one that brings the clip's joints
/// nearest to the model's, both about their means. It is nothing where both are as good as on one vertical line.
pub(super) fn heading(pairs: &[BonePair]) -> DQuat {
    let points: Vec<[DVec3; 2]> = pairs.iter().flat_map(points_of).collect();
    let count = points.len().max(1) as f64;
    let [model_mean, clip_mean] = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<DVec3>() / count);
    let (mut along, mut across, mut size) = (0.0, 0.0, 0.0);
    for [model, clip] in points {
        let (m, c) = (model - model_mean, clip - clip_mean);
        along += m.x * c.x + m.z * c.z;
        // Positive where the clip has to be turned from z towards x.
        across += m.x * c.z - m.z * c.x;
        size += m.length() * c.length();
    }
    if libm::hypot(along, across) <= 1e-6 * size {
        return DQuat::IDENTITY;
    }
    rotation_about(DVec3::Y, libm::atan2(across, along))
}

fn points_of(pair: &BonePair) -> impl Iterator<Item = [DVec3; 2]> {
    let end = pair.clip.1.map(|end| [pair.model[1], end]);
    [Some([pair.model[0], pair.clip.0]), end].into_iter().flatten()
}

/// Model units for one unit of a clip: the lengths of the model's bones over those of the clip's. 1 where the clip's have none.
pub(super) fn scale(bones: &[RigBone], pairs: &[BonePair]) -> f64 {
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
