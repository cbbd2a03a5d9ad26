//! Recordings made on the spot, for trying how clips drive models where none is at hand: files in the format BVH, of one and the
//! same skeleton.

use super::recorded_poses::{RecordedPose, ballet_keys, boxing_keys, pose_between};
use super::recorded_skeleton::{JOINTS, RecordedFrame, joint_rotations, lowest_sole};
use glam::{DMat3, DQuat, DVec3};
use std::fmt::Write as _;

/// Seconds between frames.
const FRAME_TIME: f64 = 1.0 / 30.0;
/// How long the hand takes for its turn, in frames, and how far that goes, in degrees.
const TWIST_FRAMES: usize = 51;
const TWIST: f64 = 170.0;

/// A clip that needs no file: a body of the skeleton's own size, 175 units tall, y up, facing along z, with its arms stretched
/// out where the file lists it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BuiltInRecording {
    /// Comes from standing to a boxer's stance; jabs, a cross, a hook, a duck and an uppercut.
    Boxing,
    /// A dance: plié, rise, a leg that unfolds, a pirouette, an arabesque, a leap.
    Ballet,
    /// The left hand of an arm that is stretched out turns over by 170 degrees, and nothing else.
    Twist,
}

impl BuiltInRecording {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Boxing, Self::Ballet, Self::Twist];

    /// What it is called, without an ending.
    pub fn recording_name(self) -> &'static str {
        match self {
            Self::Boxing => "boxing",
            Self::Ballet => "ballet",
            Self::Twist => "twist",
        }
    }

    /// The one of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|recording| recording.recording_name() == name)
    }

    /// Builds its BVH file; the same bytes every time.
    pub fn bvh_text(self) -> String {
        let frames = match self {
            Self::Boxing => frames_of_keys(&boxing_keys()),
            Self::Ballet => frames_of_keys(&ballet_keys()),
            Self::Twist => twist_frames(),
        };
        let mut text = String::from("HIERARCHY\n");
        list_joint(&mut text, 0, 0);
        // Writing into a string does not fail.
        let _ = write!(text, "MOTION\nFrames: {}\nFrame Time: {FRAME_TIME:.6}\n", frames.len());
        for frame in &frames {
            let [x, y, z] = frame.hips.to_array();
            let _ = write!(
                text,
                "{} {} {}",
                to_thousandths(x),
                to_thousandths(y),
                to_thousandths(z)
            );
            for rotation in &frame.rotations {
                for angle in angles_zxy(*rotation) {
                    let _ = write!(text, " {}", to_thousandths(angle.to_degrees()));
                }
            }
            text.push('\n');
        }
        text
    }
}

/// A number with three digits after the point, and no zero with a sign.
fn to_thousandths(x: f64) -> f64 {
    (x * 1e3).round() / 1e3 + 0.0
}

/// Lists a joint and what hangs on it. Joints come in the order of the file.
fn list_joint(text: &mut String, joint: usize, depth: usize) {
    let indent = "  ".repeat(depth);
    let own = &JOINTS[joint];
    let (kind, channels) = match own.parent {
        None => ("ROOT", "6 Xposition Yposition Zposition"),
        Some(_) => ("JOINT", "3"),
    };
    let [x, y, z] = own.offset;
    let _ = write!(
        text,
        "{indent}{kind} {}\n{indent}{{\n{indent}  OFFSET {x} {y} {z}\n{indent}  CHANNELS {channels} Zrotation Xrotation Yrotation\n",
        own.name
    );
    for (child, _) in JOINTS.iter().enumerate().filter(|(_, j)| j.parent == Some(joint)) {
        list_joint(text, child, depth + 1);
    }
    if let Some([x, y, z]) = own.end {
        let _ = write!(
            text,
            "{indent}  End Site\n{indent}  {{\n{indent}    OFFSET {x} {y} {z}\n{indent}  }}\n"
        );
    }
    let _ = writeln!(text, "{indent}}}");
}

/// The frames of poses at times, the first at 0; who stands, stands on the ground.
fn frames_of_keys(keys: &[(f64, RecordedPose)]) -> Vec<RecordedFrame> {
    let end = keys.last().map_or(0.0, |key| key.0);
    let count = (end / FRAME_TIME).round() as usize + 1;
    let frame = |number: usize| {
        let pose = pose_between(keys, number as f64 * FRAME_TIME);
        let rotations = joint_rotations(&pose);
        let hips = DVec3::Y * (pose.lift - lowest_sole(&rotations));
        RecordedFrame { hips, rotations }
    };
    (0..count).map(frame).collect()
}

fn twist_frames() -> Vec<RecordedFrame> {
    let hand = JOINTS.iter().position(|joint| joint.name == "LeftHand");
    let frame = |number: usize| {
        let mut rotations = vec![DQuat::IDENTITY; JOINTS.len()];
        let angle = TWIST.to_radians() * number as f64 / (TWIST_FRAMES - 1) as f64;
        if let Some(hand) = hand {
            rotations[hand] = DQuat::from_xyzw(libm::sin(0.5 * angle), 0.0, 0.0, libm::cos(0.5 * angle));
        }
        RecordedFrame {
            hips: DVec3::from_array(JOINTS[0].offset),
            rotations,
        }
    };
    (0..TWIST_FRAMES).map(frame).collect()
}

/// Angles about z, x and y in radians: a rotation is the product of the three in this order.
fn angles_zxy(rotation: DQuat) -> [f64; 3] {
    let [first, second, third] = DMat3::from_quat(rotation).transpose().to_cols_array_2d();
    [
        libm::atan2(-first[1], second[1]),
        libm::asin(third[1].clamp(-1.0, 1.0)),
        libm::atan2(-third[0], third[2]),
    ]
}
