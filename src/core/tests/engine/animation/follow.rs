//! Bones of the model follow those of the clip, whichever way it faces.

use super::arm::{ENDS, animate, arm_rig, clip_text, frames, open_arm};
use glam::DVec3;
use pliant_core::exec::Exec;
use pliant_core::motion::bvh::{ClipLimits, read_bvh};
use pliant_core::motion::rig::{DriveOptions, MotionRig, RigDriver, RigError, rig_handles};
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

const ROWS: [[f64; 2]; 3] = [[0.0, 0.0], [35.0, 20.0], [70.0, -80.0]];

#[test]
fn the_model_stands_at_rest_where_the_clip_does_and_turns_with_its_root() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let deformer = open_arm(&exec);
    let animation = animate(&deformer, &clip_text(0.0, &ROWS), arm_rig(3), Some(1), &exec);
    assert!((animation.driver().scale() - 0.01).abs() < 1e-9);
    assert!(
        animation.handle_facts().iter().all(|h| h.nodes >= 8),
        "{:?}",
        animation.handle_facts()
    );
    let frames = frames(&animation, 0..3, 1, &exec);
    let rest = deformer.rest();
    for (p, q) in rest.iter().zip(&frames[0].positions) {
        assert!(p.distance(*q) < 1e-6, "{p} {q}");
    }
    // The upper arm is the root: what turns about its axis is distinguished, and nothing is left of it in the shape.
    let root = frames[1].root;
    let end = root.place(DVec3::X * ENDS[1]);
    let expected = DVec3::X * ENDS[0] + glam::DQuat::from_rotation_y(35f64.to_radians()) * (DVec3::X * 2.4);
    assert!(end.distance(expected) < 1e-5, "{end} {expected}");
}

#[test]
fn a_clip_that_faces_elsewhere_gives_the_same_shape() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let deformer = open_arm(&exec);
    let shapes = [0.0, 180.0, 77.0].map(|heading| {
        let animation = animate(&deformer, &clip_text(heading, &ROWS), arm_rig(3), None, &exec);
        frames(&animation, 0..3, 1, &exec)
    });
    for other in &shapes[1..] {
        for (a, b) in shapes[0].iter().zip(other) {
            let worst = a
                .positions
                .iter()
                .zip(&b.positions)
                .map(|(p, q)| p.distance(*q))
                .fold(0.0, f64::max);
            assert!(worst < 1e-5 * deformer.diagonal(), "frame {}: {worst}", a.index);
            let far = a.root.place(DVec3::ONE).distance(b.root.place(DVec3::ONE));
            assert!(far < 1e-5 * deformer.diagonal(), "root of frame {}: {far}", a.index);
        }
    }
}

#[test]
fn a_joint_that_the_clip_lacks_is_refused_with_those_that_it_has() {
    let clip = read_bvh(clip_text(0.0, &ROWS).as_bytes(), &ClipLimits::default()).expect("a clip");
    let refused = |rig: &MotionRig| RigDriver::new(rig, clip.clone(), &DriveOptions::default()).map(drop);
    let mut rig = arm_rig(1);
    rig.bones[1].joint = "LeftForeArm".into();
    let reported = refused(&rig).expect_err("refused").to_string();
    let expected =
        "joint: \"LeftForeArm\" of bone \"fore\" is not a joint of the clip; it has \"upper\", \"fore\", \"hand\"";
    assert!(reported.starts_with(expected), "{reported}");
    rig = arm_rig(1);
    rig.reference = pliant_core::motion::rig::ReferencePose::Frame(3);
    let reported = refused(&rig);
    assert!(
        matches!(
            &reported,
            Err(RigError::Field {
                field: "referenceFrame",
                ..
            })
        ),
        "{reported:?}"
    );
}

#[test]
fn a_rig_outside_the_model_is_refused() {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let deformer = open_arm(&exec);
    let mut rig = arm_rig(1);
    for bone in &mut rig.bones {
        bone.from.y += 5e4;
        bone.to.y += 5e4;
    }
    let clip = read_bvh(clip_text(0.0, &ROWS).as_bytes(), &ClipLimits::default()).expect("a clip");
    let times = pliant_core::engine::FrameTimes::between(0.0, clip.duration, 30.0);
    let driver = RigDriver::new(&rig, clip, &DriveOptions::default()).expect("a driver");
    let refused = deformer
        .animation(rig, driver, times, &Default::default(), &exec)
        .map(drop);
    let reported = refused.expect_err("refused").to_string();
    assert!(
        reported.contains("holds nothing; its joints have to lie inside the model"),
        "{reported}"
    );
}

#[test]
fn a_bone_that_is_twisted_nearly_half_around_is_reported_once_with_its_frame() {
    let warnings = |rows: &[[f64; 2]], heading: f64| {
        let clip = read_bvh(clip_text(heading, rows).as_bytes(), &ClipLimits::default()).expect("a clip");
        let rig = arm_rig(3);
        let mut driver = RigDriver::new(&rig, clip, &DriveOptions::default()).expect("a driver");
        let frames = (0..rows.len()).map(|frame| (frame, frame as f64 * 0.0333333));
        driver.warn_of_twists(&rig, frames);
        driver.warnings().to_vec()
    };
    for heading in [0.0, 130.0] {
        let reported = warnings(&[[0.0, 0.0], [40.0, 172.0], [10.0, -178.0], [0.0, 171.0]], heading);
        assert_eq!(reported.len(), 1, "{reported:?}");
        let wanted = "bone \"hand\" is twisted by 178 degrees about its own axis in frame 2, against how it stands";
        assert!(reported[0].starts_with(wanted), "{reported:?}");
        let none = warnings(&[[0.0, 0.0], [178.0, 168.0], [0.0, -169.0]], heading);
        assert!(none.is_empty(), "turns of the whole count for nothing: {none:?}");
    }
}

#[test]
fn a_wrist_turned_by_150_degrees_keeps_its_volume() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let deformer = open_arm(&exec);
    let volume = |slices: usize, refine: Option<u32>| {
        let text = clip_text(0.0, &[[0.0, 150.0]]);
        let animation = animate(&deformer, &text, arm_rig(slices), refine, &exec);
        let frame = frames(&animation, 0..1, 1, &exec).remove(0);
        let quality = deformer.quality(&frame.positions, &pool);
        (quality.volume_change, quality.flipped_triangles)
    };
    let (sliced, flipped) = volume(3, None);
    assert!(sliced > -0.12 && flipped == 0, "{sliced}, {flipped} flipped");
    let (whole, _) = volume(1, Some(0));
    assert!(whole < sliced - 0.02, "three slices {sliced}, one {whole}");
}

/// A hand that is turned over by `degrees` in this many frames, and back.
fn turned_over(degrees: f64) -> Vec<[f64; 2]> {
    let angle = |k: i32| degrees * 0.5 * (1.0 - (std::f64::consts::TAU * f64::from(k) / 60.0).cos());
    (0..=60).map(|k| [0.0, angle(k)]).collect()
}

#[test]
fn a_wrist_that_is_turned_past_half_a_turn_flips_nothing() {
    let largest = |degrees: f64| {
        let clip = read_bvh(clip_text(0.0, &turned_over(degrees)).as_bytes(), &ClipLimits::default()).expect("a clip");
        let rig = arm_rig(3);
        let mut driver = RigDriver::new(&rig, clip, &DriveOptions::default()).expect("a driver");
        driver.follow_turns(0.0);
        let place = |frame: u32| -> Vec<DVec3> {
            // Frames between those that were recorded, too.
            let pose = driver.pose_at(f64::from(frame) * 0.25 * 0.0333333);
            let beside = DVec3::new(0.0, 0.3, 0.4);
            let handles = rig_handles(&rig).into_iter().map(|handle| handle.motion(&rig, &pose));
            handles.map(|motion| motion.place(motion.from + beside)).collect()
        };
        let frames: Vec<Vec<DVec3>> = (0..=240).map(place).collect();
        let step = |w: &[Vec<DVec3>]| w[0].iter().zip(&w[1]).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        frames.windows(2).map(step).fold(0.0, f64::max)
    };
    let usual = largest(150.0);
    for degrees in [181.0, 200.0, 250.0] {
        let found = largest(degrees);
        assert!(
            found <= 1.1 * usual * degrees / 150.0,
            "{degrees}: {found} against {usual}"
        );
    }
}
