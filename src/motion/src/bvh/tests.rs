//! Clips as tools write them, and malformed ones.

use super::*;
use glam::{DQuat, DVec3};
use proptest::prelude::*;

const TWO_BONES: &str = "HIERARCHY
ROOT Hips
{
  OFFSET 1 2 3
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Left Arm:upper
  {
    OFFSET 0 5 0
    CHANNELS 3 Xrotation Zrotation Yrotation
    End Site
    {
      OFFSET 0 4 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
10 20 30 90 0 0  0 0 0
10 20 30 450 0 0  30 0 -360
";

fn read(text: &str) -> Result<MotionClip, Error> {
    read_bvh(text.as_bytes(), &ClipLimits::default())
}

#[test]
fn joints_stand_where_offsets_orders_and_channels_put_them() {
    let clip = read(TWO_BONES).expect("a clip");
    let names: Vec<&str> = clip.skeleton.joints.iter().map(|joint| joint.name.as_str()).collect();
    assert_eq!(names, ["Hips", "Left Arm:upper", "Left Arm:upper.end"]);
    let place = |seconds: f64, joint: usize| clip.skeleton.world_transforms(&clip.pose_at(seconds))[joint].translation;
    // Position channels replace the offset of the root.
    assert_eq!(place(0.0, 0), DVec3::new(10.0, 20.0, 30.0));
    // A quarter turn about z leads the arm from +y to −x.
    assert!(place(0.0, 1).distance(DVec3::new(5.0, 20.0, 30.0)) < 1e-12);
    assert!(place(0.0, 2).distance(DVec3::new(1.0, 20.0, 30.0)) < 1e-12);
    // In frame 1 the arm is bent by 30° about the x axis of a frame that is turned: y goes to −x, z stays.
    let bent = DVec3::new(
        5.0 - 4.0 * 30f64.to_radians().cos(),
        20.0,
        30.0 + 4.0 * 30f64.to_radians().sin(),
    );
    assert!(place(1.0, 2).distance(bent) < 1e-12, "{}", place(1.0, 2));
    assert_eq!(clip.recorded.map(|r| r.count), Some(2));
    assert!((clip.duration - 0.0333333).abs() < 1e-15 && clip.warnings.is_empty());
}

#[test]
fn angles_that_wrap_turn_nothing_on_the_way() {
    let clip = read(TWO_BONES).expect("a clip");
    let start = clip.pose_at(0.0)[0].rotation;
    for k in 0..=10 {
        let now = clip.pose_at(0.00333333 * f64::from(k))[0].rotation;
        assert!((now.dot(start).abs() - 1.0).abs() < 1e-12);
    }
}

#[test]
fn channels_multiply_in_the_order_in_which_they_are_listed() {
    let clip = TWO_BONES.replace("30 0 -360", "30 40 50");
    let turn = read(&clip).expect("a clip").pose_at(1.0)[1].rotation;
    let [x, z, y] = [30f64, 40.0, 50.0].map(f64::to_radians);
    let wanted = DQuat::from_rotation_x(x) * DQuat::from_rotation_z(z) * DQuat::from_rotation_y(y);
    assert!((turn.dot(wanted).abs() - 1.0).abs() < 1e-12);
}

#[test]
fn what_other_tools_write_is_read_all_the_same() {
    let clip = read(TWO_BONES).expect("a clip");
    let tabs = TWO_BONES.replace("  ", "\t");
    let exponents = TWO_BONES.replace("10 20 30 90", "1e1 2.0E+1 +30. 90");
    for text in [
        TWO_BONES.replace('\n', "\r\n"),
        TWO_BONES.replace('\n', "\r"),
        format!("\u{feff}{TWO_BONES}"),
        TWO_BONES.trim_end().to_owned(),
        TWO_BONES
            .replace("Frames: 2", "Frames:\t2")
            .replace("Frame Time: ", "Frame Time:"),
        TWO_BONES.replace("Hips\n{", "Hips {"),
        TWO_BONES.replace("OFFSET", "Offset").replace("HIERARCHY", "Hierarchy"),
        tabs,
        exponents,
    ] {
        assert_eq!(read(&text), Ok(clip.clone()), "{text}");
    }
    let longer = read(&TWO_BONES.replace("Frames: 2", "Frames: 1")).expect("a clip");
    assert_eq!((longer.curves, longer.warnings.len()), (clip.curves, 1));
    let still = read("HIERARCHY\nROOT a\n{\nOFFSET 0 0 1\nCHANNELS 0\n}\nMOTION\nFrames: 5\nFrame Time: 0.1\n");
    assert_eq!(still.expect("a clip").recorded.map(|r| r.count), Some(5));
}

#[test]
fn what_is_no_clip_is_refused_with_its_line() {
    let with = |from: &str, to: &str| {
        assert!(TWO_BONES.contains(from), "{from}");
        TWO_BONES.replacen(from, to, 1)
    };
    for (text, line, reported) in [
        ("v 0 0 0\n".to_owned(), 1, "begins with HIERARCHY"),
        (with("MOTION", "MOVEMENT"), 16, "MOVEMENT"),
        (
            TWO_BONES.split("MOTION").next().unwrap_or_default().to_owned(),
            15,
            "no MOTION",
        ),
        (with("\n}\nMOTION", "\nMOTION"), 15, "not closed"),
        (
            with("Frames: 2", "Frames: 1000"),
            20,
            "1000 frames are declared, 2 follow",
        ),
        (with("Frames: 2", "Frames: 0"), 17, "at least 1"),
        (with("Frames: 2", "Frames: 2.5"), 17, "whole"),
        (with("0.0333333", "0"), 18, "frame time"),
        (with("0.0333333", "-0.1"), 18, "frame time"),
        (with("10 20 30 90", "10 nan 30 90"), 19, "not finite"),
        (with("10 20 30 90", "10 0,5 30 90"), 19, "comma"),
        (with("10 20 30 90", "10 20 30"), 19, "8 numbers, the joints have 9"),
        (
            with("10 20 30 90", "10 20 30 40 90"),
            19,
            "10 numbers, the joints have 9",
        ),
        (with("Xposition", "Wposition"), 5, "Xposition"),
        (with("6 Xposition", "5 Xposition"), 5, "5 channels are declared, 6"),
        (with("Yposition", "Xposition"), 5, "twice"),
        (with("OFFSET 1 2 3", "OFFSET 1 2"), 4, "three numbers"),
        (
            with("MOTION", "ROOT other\n{\nOFFSET 0 0 0\n}\nMOTION"),
            16,
            "second ROOT",
        ),
        (with("ROOT Hips", "JOINT Hips"), 2, "within"),
    ] {
        match read(&text) {
            Err(Error::Malformed { line: at, problem }) => {
                assert!(problem.contains(reported), "{reported}: {problem}");
                assert_eq!(at, line, "{problem}");
            }
            other => panic!("{reported}: {other:?}"),
        }
    }
    assert_eq!(read(" \n"), Err(Error::Empty));
    let many = read(&with("Frames: 2", "Frames: 1000000000000"));
    assert!(matches!(many, Err(Error::TooMany { what: "frames", .. })), "{many:?}");
}

#[test]
fn a_deep_chain_is_read_without_recursion_up_to_the_limit() {
    let chain = |count: usize| {
        let open = "JOINT a\n{\nOFFSET 0 1 0\nCHANNELS 0\n".repeat(count - 1);
        let root = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n";
        format!(
            "{root}{open}{}MOTION\nFrames: 1\nFrame Time: 1\n0\n",
            "}\n".repeat(count)
        )
    };
    let clip = read(&chain(4096)).expect("a clip");
    assert_eq!(
        clip.skeleton.world_transforms(&clip.pose_at(0.0))[4095].translation.y,
        4095.0
    );
    let refused = read(&chain(6000));
    let limit = Error::TooMany {
        what: "joints",
        seen: 4097,
        limit: 4096,
    };
    assert_eq!(refused, Err(limit));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Bytes replaced, taken out and put in anywhere.
    #[test]
    fn no_bytes_make_it_panic(changes in prop::collection::vec((0usize..600, any::<u8>(), 0u8..3), 1..8)) {
        let mut bytes = TWO_BONES.as_bytes().to_vec();
        for (place, byte, kind) in changes {
            let place = place % bytes.len();
            match kind {
                0 => bytes[place] = byte,
                1 => { bytes.remove(place); }
                _ => bytes.insert(place, byte),
            }
        }
        if let Ok(clip) = read_bvh(&bytes, &ClipLimits::default()) {
            let pose = clip.pose_at(0.01);
            prop_assert_eq!(pose.len(), clip.skeleton.joints.len());
            prop_assert!(pose.iter().all(|p| p.translation.is_finite() && p.rotation.is_finite()));
        }
    }
}
