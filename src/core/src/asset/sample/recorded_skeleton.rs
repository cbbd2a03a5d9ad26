//! The skeleton of the built-in recordings, and how a pose turns its joints.

use super::recorded_poses::{LimbPose, RecordedPose};
use glam::{DQuat, DVec3};

/// A joint as a BVH file lists it.
pub(super) struct RecordedJoint {
    pub name: &'static str,
    /// Number of its parent, which comes before it.
    pub parent: Option<usize>,
    /// Its rest offset.
    pub offset: [f64; 3],
    /// The end of one without children.
    pub end: Option<[f64; 3]>,
}

/// Where a recording is at one time.
pub(super) struct RecordedFrame {
    pub hips: DVec3,
    /// By joint, relative to the one that it hangs on.
    pub rotations: Vec<DQuat>,
}

const fn joint_row(name: &'static str, parent: usize, offset: [f64; 3]) -> RecordedJoint {
    RecordedJoint {
        name,
        parent: Some(parent),
        offset,
        end: None,
    }
}

const fn last_row(name: &'static str, parent: usize, offset: [f64; 3], end: [f64; 3]) -> RecordedJoint {
    RecordedJoint {
        end: Some(end),
        ..joint_row(name, parent, offset)
    }
}

/// All joints, in the order of the file.
pub(super) const JOINTS: [RecordedJoint; 21] = [
    RecordedJoint {
        parent: None,
        ..joint_row("Hips", 0, [0.0, 95.0, 0.0])
    },
    joint_row("Spine", 0, [0.0, 12.0, 0.0]),
    joint_row("Chest", 1, [0.0, 17.0, 0.0]),
    joint_row("Neck", 2, [0.0, 21.0, -1.0]),
    last_row("Head", 3, [0.0, 9.0, 1.0], [0.0, 20.0, 0.0]),
    joint_row("LeftShoulder", 2, [4.0, 16.0, 0.0]),
    joint_row("LeftArm", 5, [14.0, 0.0, 0.0]),
    joint_row("LeftForeArm", 6, [27.0, 0.0, 0.0]),
    last_row("LeftHand", 7, [25.0, 0.0, 0.0], [15.0, 0.0, 0.0]),
    joint_row("RightShoulder", 2, [-4.0, 16.0, 0.0]),
    joint_row("RightArm", 9, [-14.0, 0.0, 0.0]),
    joint_row("RightForeArm", 10, [-27.0, 0.0, 0.0]),
    last_row("RightHand", 11, [-25.0, 0.0, 0.0], [-15.0, 0.0, 0.0]),
    joint_row("LeftUpLeg", 0, [10.0, -5.0, 0.0]),
    joint_row("LeftLeg", 13, [0.0, -41.0, 0.0]),
    joint_row("LeftFoot", 14, [0.0, -40.0, -1.0]),
    last_row("LeftToeBase", 15, [0.0, -6.0, 13.0], [0.0, 0.0, 5.0]),
    joint_row("RightUpLeg", 0, [-10.0, -5.0, 0.0]),
    joint_row("RightLeg", 17, [0.0, -41.0, 0.0]),
    joint_row("RightFoot", 18, [0.0, -40.0, -1.0]),
    last_row("RightToeBase", 19, [0.0, -6.0, 13.0], [0.0, 0.0, 5.0]),
];

/// Numbers of joints that poses turn.
const SPINE: usize = 1;
const CHEST: usize = 2;
const NECK: usize = 3;
const HEAD: usize = 4;
/// The upper joint of each limb.
const ARMS: [usize; 2] = [6, 10];
const LEGS: [usize; 2] = [13, 17];

/// Rest heights of ankles and toes above the ground.
const ANKLE: f64 = 9.0;
const TOE: f64 = 3.0;

/// By joint the rotation of a pose relative to the joint above.
pub(super) fn joint_rotations(pose: &RecordedPose) -> Vec<DQuat> {
    let mut rotations = vec![DQuat::IDENTITY; JOINTS.len()];
    rotations[0] = turned_by(pose.hips);
    // Backs bend in several places.
    let half = turned_by(pose.chest.map(|degrees| 0.5 * degrees));
    rotations[SPINE] = half;
    rotations[CHEST] = half;
    let half = turned_by(pose.head.map(|degrees| 0.5 * degrees));
    rotations[NECK] = half;
    rotations[HEAD] = half;
    for (side, mirror) in [(0, 1.0), (1, -1.0)] {
        let rest = DVec3::X * mirror;
        let upper = DQuat::from_rotation_arc(rest, limb_direction(pose.arms[side].upper, mirror, rest));
        // What arms do, they do as the chest sees it, legs as the hips do.
        let lower = limb_direction(pose.arms[side].lower, mirror, rest);
        rotations[ARMS[side]] = upper;
        rotations[ARMS[side] + 1] = DQuat::from_rotation_arc(rest, upper.inverse() * lower);
        bend_leg(&mut rotations, LEGS[side], &pose.legs[side], pose.points[side], mirror);
    }
    rotations
}

fn bend_leg(rotations: &mut [DQuat], upper: usize, leg: &LimbPose, points: f64, mirror: f64) {
    let rest = DVec3::NEG_Y;
    let thigh = DQuat::from_rotation_arc(rest, limb_direction(leg.upper, mirror, rest));
    let shin = limb_direction(leg.lower, mirror, rest);
    rotations[upper] = thigh;
    rotations[upper + 1] = DQuat::from_rotation_arc(rest, thigh.inverse() * shin);
    // A foot that points goes on as the shin does.
    rotations[upper + 2] = turned_by([60.0 * points, 0.0, 0.0]);
}

/// A direction that is given for the left side.
fn limb_direction(told: [f64; 3], mirror: f64, rest: DVec3) -> DVec3 {
    (DVec3::from_array(told) * DVec3::new(mirror, 1.0, 1.0)).normalize_or(rest)
}

/// Degrees about x, y and z: first leaned forward, then sideways, then turned about the vertical.
fn turned_by([x, y, z]: [f64; 3]) -> DQuat {
    let about = |axis: DVec3, degrees: f64| {
        let half = 0.5 * degrees.to_radians();
        let axis = axis * libm::sin(half);
        DQuat::from_xyzw(axis.x, axis.y, axis.z, libm::cos(half))
    };
    about(DVec3::Y, y) * about(DVec3::Z, z) * about(DVec3::X, x)
}

/// How high the lowest sole is when the hips are at 0.
pub(super) fn lowest_sole(rotations: &[DQuat]) -> f64 {
    let mut turns: Vec<DQuat> = Vec::with_capacity(JOINTS.len());
    let mut places: Vec<DVec3> = Vec::with_capacity(JOINTS.len());
    let mut lowest = f64::INFINITY;
    for (joint, own) in JOINTS.iter().zip(rotations) {
        let offset = DVec3::from_array(joint.offset);
        let (turn, place) = match joint.parent {
            None => (*own, DVec3::ZERO),
            Some(parent) => (turns[parent] * *own, places[parent] + turns[parent] * offset),
        };
        if joint.name.ends_with("Foot") {
            lowest = lowest.min(place.y - ANKLE);
        }
        if let (true, Some(end)) = (joint.name.ends_with("ToeBase"), joint.end) {
            let tip = place + turn * DVec3::from_array(end);
            lowest = lowest.min(place.y.min(tip.y) - TOE);
        }
        turns.push(turn);
        places.push(place);
    }
    lowest
}
