//! An arm of two bones and a hand, with clips that move it.

use glam::{DQuat, DVec3};
use pliant_core::asset::{FileSet, shapes};
use pliant_core::engine::{
    ANIMATION_QUALITY, AnimatedFrame, Animation, Deformer, DeformerLimits, FrameTimes, OpenOptions, Quality,
};
use pliant_core::exec::Exec;
use pliant_core::motion::bvh::{ClipLimits, read_bvh};
use pliant_core::motion::rig::{DriveOptions, MotionRig, ReferencePose, RestAttitude, RigBone, RigDriver};
use std::fmt::Write as _;

/// The arm lies along x from the shoulder at 0; upper arm, forearm and hand end at these places.
pub const ENDS: [f64; 4] = [-3.0, -0.6, 1.8, 3.0];

/// A bar of 6 by 1 by 1 with its middle at the origin.
pub fn open_arm(exec: &Exec<'_>) -> Deformer {
    let (positions, triangles) = shapes::box_with_cells(DVec3::new(6.0, 1.0, 1.0), [60, 10, 10]);
    let mut text = String::new();
    for p in &positions {
        writeln!(text, "v {} {} {}", p.x - 3.0, p.y - 0.5, p.z - 0.5).expect("text");
    }
    for t in &triangles {
        writeln!(text, "f {} {} {}", t[0] + 1, t[1] + 1, t[2] + 1).expect("text");
    }
    let files = FileSet::single("arm.obj", text);
    Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), exec).expect("an arm")
}

/// The rig of the arm, made for clips of [`clip_text`].
pub fn arm_rig(slices: usize) -> MotionRig {
    let bone = |k: usize, id: &str, rest: RestAttitude, slices: usize| RigBone {
        id: id.into(),
        parent: None,
        from: DVec3::X * ENDS[k],
        to: DVec3::X * ENDS[k + 1],
        joint: id.into(),
        aim: None,
        rest,
        radius: 0.5,
        slices,
        span: [0.15, 0.85],
        joint_radius: None,
        limit_degrees: None,
    };
    let bones = vec![
        bone(0, "upper", RestAttitude::Direction, slices),
        bone(1, "fore", RestAttitude::Direction, slices),
        bone(2, "hand", RestAttitude::Parent, 1),
    ];
    let parents = [None, Some("upper".into()), Some("fore".into())];
    MotionRig::from_named_parents(bones, &parents, ReferencePose::Rest, None).expect("a rig")
}

/// A clip in centimetres whose arm lies along x turned by `heading` degrees about y. `rows` are, by frame, the angles of the upper arm
/// about y and of the hand about x.
pub fn clip_text(heading: f64, rows: &[[f64; 2]]) -> String {
    let turn = DQuat::from_rotation_y(heading.to_radians());
    let offset = |length: f64| {
        let p = turn * (DVec3::X * length);
        format!("OFFSET {:.9} {:.9} {:.9}", p.x, p.y, p.z)
    };
    let mut text = format!(
        "HIERARCHY\nROOT upper\n{{\n{}\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
         JOINT fore\n{{\n{}\nCHANNELS 3 Zrotation Xrotation Yrotation\nJOINT hand\n{{\n{}\n\
         CHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{{\n{}\n}}\n}}\n}}\n}}\nMOTION\nFrames: {}\nFrame Time: 0.0333333\n",
        offset(-300.0),
        offset(240.0),
        offset(240.0),
        offset(120.0),
        rows.len()
    );
    for [upper, hand] in rows {
        // A turn about the arm's own axis, in a clip that faces elsewhere.
        let axis = turn * DVec3::X;
        let q = DQuat::from_axis_angle(axis, hand.to_radians());
        let (z, x, y) = q.to_euler(glam::EulerRot::ZXY);
        let [z, x, y] = [z, x, y].map(f64::to_degrees);
        writeln!(text, "0 0 0 0 0 {upper} 0 0 0 {z:.9} {x:.9} {y:.9}").expect("text");
    }
    text
}

/// The animation of the arm by a clip.
pub fn animate(deformer: &Deformer, text: &str, rig: MotionRig, refine: Option<u32>, exec: &Exec<'_>) -> Animation {
    let clip = read_bvh(text.as_bytes(), &ClipLimits::default()).expect("a clip");
    let times = FrameTimes::between(0.0, clip.duration, 30.0);
    let driver = RigDriver::new(&rig, clip, &DriveOptions::default()).expect("a driver");
    let quality = Quality {
        refine,
        ..ANIMATION_QUALITY
    };
    deformer
        .animation(rig, driver, times, &quality, exec)
        .expect("an animation")
}

/// Frames of an animation, in their order.
pub fn frames(
    animation: &Animation,
    range: std::ops::Range<usize>,
    at_once: usize,
    exec: &Exec<'_>,
) -> Vec<AnimatedFrame> {
    let mut all = Vec::new();
    let taken = animation.solve(&[range], at_once, &|| 0.0, exec, &mut |frame, _| {
        all.push(frame);
        true
    });
    taken.expect("frames");
    all.sort_by_key(|frame| frame.index);
    all
}
