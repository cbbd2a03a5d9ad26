//! What the figure can do: a walk on the spot and a wave of the hand, as rotations of its joints over time.

use glam::{DQuat, DVec3};
use std::f64::consts::{PI, TAU};

/// A clip: at each time the rotation of some joints, and where the hips are.
pub(super) struct FigureClip {
    pub name: &'static str,
    /// Seconds.
    pub times: Vec<f64>,
    /// For each joint that moves its name and a rotation for each time, relative to the joint above.
    pub rotations: Vec<(&'static str, Vec<DQuat>)>,
    /// How high the hips are above where they rest, for each time; empty when they stay.
    pub lift: Vec<f64>,
}

/// How far the arms hang down from where they are stretched out.
const HANG: f64 = 1.2;

/// Both clips. Each ends as it begins.
pub(super) fn clips() -> [FigureClip; 2] {
    [walk(), wave()]
}

fn walk() -> FigureClip {
    let phases: Vec<f64> = (0..=16).map(|k| f64::from(k) / 16.0 * TAU).collect();
    let over = |turn: &dyn Fn(f64) -> DQuat| phases.iter().map(|&phase| turn(phase)).collect::<Vec<_>>();
    let upper_leg = |phase: f64| about_x(-0.45 * libm::sin(phase) - 0.05);
    let lower_leg = |phase: f64| about_x(0.15 + 0.75 * half_wave(phase + 0.6 * PI));
    let foot = |phase: f64| about_x(-0.15 * libm::sin(phase + 0.3 * PI));
    let arm = |phase: f64, side: f64| about_x(0.5 * libm::sin(phase)) * about_z(-HANG * side);
    let elbow = |phase: f64, side: f64| about_y(-side * (0.35 + 0.2 * libm::sin(phase)));
    FigureClip {
        name: "walk",
        times: phases.iter().map(|phase| phase / TAU * 1.2).collect(),
        rotations: vec![
            ("leftUpperLeg", over(&upper_leg)),
            ("rightUpperLeg", over(&|phase| upper_leg(phase + PI))),
            ("leftLowerLeg", over(&lower_leg)),
            ("rightLowerLeg", over(&|phase| lower_leg(phase + PI))),
            ("leftFoot", over(&foot)),
            ("rightFoot", over(&|phase| foot(phase + PI))),
            ("leftUpperArm", over(&|phase| arm(phase, 1.0))),
            ("rightUpperArm", over(&|phase| arm(phase + PI, -1.0))),
            ("leftLowerArm", over(&|phase| elbow(phase, 1.0))),
            ("rightLowerArm", over(&|phase| elbow(phase + PI, -1.0))),
            ("chest", over(&|phase| about_y(0.12 * libm::sin(phase)))),
        ],
        lift: phases
            .iter()
            .map(|phase| -0.02 + 0.015 * libm::cos(2.0 * phase))
            .collect(),
    }
}

fn wave() -> FigureClip {
    let times: Vec<f64> = (0..=16).map(|k| f64::from(k) * 0.125).collect();
    // Up within half a second, down in the last half.
    let raised = |time: f64| (time.min(2.0 - time) / 0.5).clamp(0.0, 1.0);
    let over = |turn: &dyn Fn(f64) -> DQuat| times.iter().map(|&time| turn(time)).collect::<Vec<_>>();
    FigureClip {
        name: "wave",
        rotations: vec![
            ("leftUpperArm", over(&|_| about_z(-HANG))),
            ("rightUpperArm", over(&|time| about_z(HANG - 1.5 * raised(time)))),
            (
                "rightLowerArm",
                over(&|time| about_z(-(0.9 + 0.45 * libm::sin(time * TAU)) * raised(time))),
            ),
            (
                "rightHand",
                over(&|time| about_z(-0.25 * libm::sin(time * TAU) * raised(time))),
            ),
            ("head", over(&|time| about_y(-0.25 * raised(time)))),
        ],
        lift: Vec::new(),
        times,
    }
}

/// A hump over half of a turn, nothing over the other half.
fn half_wave(phase: f64) -> f64 {
    let height = libm::sin(phase).max(0.0);
    height * height
}

fn about_x(angle: f64) -> DQuat {
    about(DVec3::X, angle)
}

fn about_y(angle: f64) -> DQuat {
    about(DVec3::Y, angle)
}

fn about_z(angle: f64) -> DQuat {
    about(DVec3::Z, angle)
}

/// By `libm`, which gives the same bits everywhere.
fn about(axis: DVec3, angle: f64) -> DQuat {
    let half = axis * libm::sin(0.5 * angle);
    DQuat::from_xyzw(half.x, half.y, half.z, libm::cos(0.5 * angle))
}
