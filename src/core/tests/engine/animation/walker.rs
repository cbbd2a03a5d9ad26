//! A recording of a figure that walks, with feet that stand exactly, and rigs of figures with other proportions.

use glam::{DQuat, DVec3, EulerRot};
use pliant_core::motion::MotionClip;
use pliant_core::motion::bvh::{ClipLimits, read_bvh};
use pliant_core::motion::rig::{MotionRig, ReferencePose, RestAttitude, RigBone};
use std::fmt::Write as _;

/// Frames a second.
pub const RATE: f64 = 30.0;
/// Frames of a step: each foot stands for one and swings for one.
pub const STEP: usize = 18;
/// Frames of the recording.
pub const FRAMES: usize = 6 * STEP;
/// From hip to knee, from knee to ankle, height of the ankle above the floor, in units of the clip.
const THIGH: f64 = 45.0;
const SHIN: f64 = 40.0;
const ANKLE: f64 = 8.0;
/// Height of the hips above the floor.
const HIPS: f64 = 90.0;
/// How far the figure goes in a step.
const STRIDE: f64 = 30.0;

/// Where an ankle is in a frame, along the way and above the floor. `late`: half a cycle for the right foot.
fn ankle(frame: usize, late: usize) -> (f64, f64) {
    let at = frame + late * STEP;
    let (cycle, within) = (at / (2 * STEP), at % (2 * STEP));
    let stood = (2 * cycle) as f64 * STRIDE - late as f64 * STRIDE;
    if within < STEP {
        return (stood, ANKLE);
    }
    let share = (within - STEP) as f64 / STEP as f64;
    let eased = share * share * (3.0 - 2.0 * share);
    (
        stood + 2.0 * STRIDE * eased,
        ANKLE + 12.0 * (std::f64::consts::PI * share).sin().powi(2),
    )
}

/// Angles about x of a leg that reaches from the hip to an ankle, in degrees: of the thigh, the shin and the foot, which stays level.
fn leg_angles(hip: (f64, f64), ankle: (f64, f64)) -> [f64; 3] {
    let (along, down) = (ankle.0 - hip.0, hip.1 - ankle.1);
    let reach = along.hypot(down);
    let cosine = |near: f64, far: f64| (near * near + reach * reach - far * far) / (2.0 * near * reach);
    let (hip, knee) = (cosine(THIGH, SHIN).acos(), cosine(SHIN, THIGH).acos());
    let thigh = -(along.atan2(down)) - hip;
    let shin = hip + knee;
    [thigh, shin, -thigh - shin].map(f64::to_degrees)
}

/// How recorded feet stand.
#[derive(Debug, Clone, Copy, Default)]
pub struct RecordedFeet {
    /// How much steeper they are when they stand than in the T-pose, in degrees.
    pub steeper: f64,
    /// How far they turn about the vertical to and fro, from frame to frame, while they stand, in degrees.
    pub tremble: f64,
}

/// The recording. Its first frame is the T-pose.
pub fn walk() -> MotionClip {
    walk_of(RecordedFeet::default())
}

/// The recording, with other feet.
pub fn walk_of(feet: RecordedFeet) -> MotionClip {
    let turning = "CHANNELS 3 Zrotation Xrotation Yrotation";
    let mut text = String::from(
        "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n",
    );
    for (side, x) in [("Left", 10.0), ("Right", -10.0)] {
        write!(
            text,
            "JOINT {side}UpLeg\n{{\nOFFSET {x} 0 0\n{turning}\nJOINT {side}Leg\n{{\nOFFSET 0 {} 0\n{turning}\nJOINT {side}Foot\n{{\n\
             OFFSET 0 {} 0\n{turning}\nEnd Site\n{{\nOFFSET 0 {} 15\n}}\n}}\n}}\n}}\n",
            -THIGH, -SHIN, -ANKLE
        )
        .expect("text");
    }
    write!(text, "JOINT Spine\n{{\nOFFSET 0 20 0\n{turning}\n").expect("text");
    for (side, x) in [("Left", 1.0), ("Right", -1.0)] {
        write!(
            text,
            "JOINT {side}Arm\n{{\nOFFSET {} 30 0\n{turning}\nJOINT {side}ForeArm\n{{\nOFFSET {} 0 0\n{turning}\nEnd Site\n{{\n\
             OFFSET {} 0 0\n}}\n}}\n}}\n",
            20.0 * x,
            25.0 * x,
            25.0 * x
        )
        .expect("text");
    }
    writeln!(
        text,
        "}}\n}}\nMOTION\nFrames: {}\nFrame Time: {:.7}",
        FRAMES + 1,
        1.0 / RATE
    )
    .expect("text");
    let still = " 0 0 0".repeat(12);
    writeln!(text, "0 {HIPS} 0{still}").expect("text");
    for frame in 0..FRAMES {
        let hips = (STRIDE * (frame as f64 / STEP as f64 - 0.5), HIPS - 6.0);
        write!(text, "0 {} {} 0 0 0", hips.1, hips.0).expect("text");
        for late in [0, 1] {
            let [thigh, shin, foot] = leg_angles(hips, ankle(frame, late));
            let stands = (frame + late * STEP) % (2 * STEP) < STEP;
            let way = if frame.is_multiple_of(2) {
                feet.tremble
            } else {
                -feet.tremble
            };
            let turn = if stands { way } else { 0.0 };
            // Turned about the vertical after it is level, and then made steeper.
            let level = DQuat::from_rotation_x(foot.to_radians()) * DQuat::from_rotation_y(turn.to_radians());
            let (z, x, y) = (level * DQuat::from_rotation_x(feet.steeper.to_radians())).to_euler(EulerRot::ZXY);
            let [z, x, y] = [z, x, y].map(f64::to_degrees);
            write!(text, " 0 {thigh:.9} 0 0 {shin:.9} 0 {z:.9} {x:.9} {y:.9}").expect("text");
        }
        writeln!(text, "{}", " 0 0 0".repeat(5)).expect("text");
    }
    read_bvh(text.as_bytes(), &ClipLimits::default()).expect("a clip")
}

/// The rig of a figure with arms `arms` times as long as in the recording, and with a thigh and a shin of these lengths.
pub fn figure_rig(arms: f64, [thigh, shin]: [f64; 2]) -> MotionRig {
    let hips = thigh + shin + 0.08;
    let bone = |id: String, from: DVec3, to: DVec3, joint: String, rest: RestAttitude| RigBone {
        joint,
        rest,
        ..RigBone::along(id, from, to, 0.05)
    };
    let level = DVec3::Y * hips;
    let mut bones = vec![
        bone(
            "pelvis".into(),
            level,
            level + DVec3::Y * 0.2,
            "Hips".into(),
            RestAttitude::Orientation,
        ),
        bone(
            "spine".into(),
            level + DVec3::Y * 0.2,
            level + DVec3::Y * 0.5,
            "Spine".into(),
            RestAttitude::Orientation,
        ),
    ];
    let mut parents: Vec<Option<String>> = vec![None, Some("pelvis".into())];
    for (side, x) in [("Left", 1.0), ("Right", -1.0)] {
        let hip = level + DVec3::X * (0.1 * x);
        let knee = hip - DVec3::Y * thigh;
        let ankle = knee - DVec3::Y * shin;
        let shoulder = level + DVec3::new(0.2 * x, 0.5, 0.0);
        let elbow = shoulder + DVec3::X * (0.25 * x * arms);
        for (name, from, to, rest, parent) in [
            ("UpLeg", hip, knee, RestAttitude::Direction, "pelvis".to_owned()),
            ("Leg", knee, ankle, RestAttitude::Direction, format!("{side}UpLeg")),
            (
                "Foot",
                ankle,
                ankle + DVec3::new(0.0, -0.08, 0.15),
                RestAttitude::Orientation,
                format!("{side}Leg"),
            ),
            ("Arm", shoulder, elbow, RestAttitude::Direction, "spine".to_owned()),
            (
                "ForeArm",
                elbow,
                elbow + DVec3::X * (0.25 * x * arms),
                RestAttitude::Direction,
                format!("{side}Arm"),
            ),
        ] {
            let name = format!("{side}{name}");
            bones.push(bone(name.clone(), from, to, name, rest));
            parents.push(Some(parent));
        }
    }
    MotionRig::from_named_parents(bones, &parents, ReferencePose::Frame(0), None).expect("a rig")
}
