//! Recordings and rigs.

use pliant::motion::bvh::{ClipLimits, read_bvh};
use pliant::wire;

pub fn bvh(bytes: &[u8]) {
    let limits = ClipLimits {
        bytes: 1 << 20,
        joints: 256,
        frames: 4096,
        numbers: 1 << 18,
    };
    match read_bvh(bytes, &limits) {
        Ok(clip) => {
            let frames = clip.recorded.map_or(0, |recorded| recorded.count);
            assert!(clip.skeleton.joints.len() <= limits.joints && frames <= limits.frames);
            for pose in clip.pose_at(clip.duration * 0.5) {
                assert!(
                    pose.rotation.is_finite() && pose.translation.is_finite(),
                    "a pose that is not a number"
                );
            }
        }
        Err(refused) => assert!(!refused.to_string().is_empty()),
    }
}

pub fn rig(bytes: &[u8]) {
    if let Err(refused) = wire::rig_from_json(bytes) {
        assert!(!refused.to_string().is_empty());
    }
}
