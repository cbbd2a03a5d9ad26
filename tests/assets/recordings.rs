//! The built-in recordings: they read back as what they say they are, and drive a body well.

use pliant::asset::sample::BuiltInRecording;
use pliant::motion::MotionClip;
use pliant::motion::bvh::{ClipLimits, read_bvh};

fn clip_of(recording: BuiltInRecording) -> MotionClip {
    read_bvh(recording.bvh_text().as_bytes(), &ClipLimits::default()).expect("a clip")
}

#[test]
fn who_stands_stands_on_the_ground() {
    for recording in BuiltInRecording::ALL {
        let name = recording.recording_name();
        assert_eq!(BuiltInRecording::from_name(name), Some(recording));
        assert_eq!(recording.bvh_text(), recording.bvh_text(), "the same bytes");
        let clip = clip_of(recording);
        let recorded = clip.recorded.expect("frames");
        assert!((40..=240).contains(&recorded.count), "{name}: {}", recorded.count);
        let mut highest = 0.0f64;
        for frame in 0..recorded.count {
            let places = clip
                .skeleton
                .world_transforms(&clip.pose_at(frame as f64 * recorded.interval));
            let lowest = places.iter().map(|p| p.translation.y).fold(f64::INFINITY, f64::min);
            assert!(
                lowest > 1.0,
                "{name}: a joint is below the ground in frame {frame}: {lowest}"
            );
            highest = highest.max(lowest);
        }
        // Joints of toes are 3 above the ground, those of ankles 9; only the dance leaps.
        let leaps = highest > 40.0;
        assert_eq!(leaps, recording == BuiltInRecording::Ballet, "{name}: {highest}");
    }
}

#[test]
fn the_hand_that_is_turned_over_is_the_left_one_alone() {
    let clip = clip_of(BuiltInRecording::Twist);
    let recorded = clip.recorded.expect("frames");
    let last = recorded.interval * (recorded.count - 1) as f64;
    for (number, joint) in clip.skeleton.joints.iter().enumerate() {
        let [before, after] = [0.0, last].map(|seconds| clip.pose_at(seconds)[number].rotation);
        let turned = before.angle_between(after).to_degrees();
        let wanted = if joint.name == "LeftHand" { 170.0 } else { 0.0 };
        assert!((turned - wanted).abs() < 0.1, "{}: {turned}", joint.name);
    }
}
