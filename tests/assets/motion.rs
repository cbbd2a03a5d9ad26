//! Motion: recorded clips of the data folder, the built-in recordings and figure, and damaged clips and rigs, which are refused or
//! give numbers.

use crate::support::commands::Workplace;
use crate::support::data::data_folder;
use crate::support::gltf_parsed::parse;
use crate::support::khronos;
use crate::support::skinning::{ClipTime, clip_length, draw};
use glam::DVec3;
use pliant::asset::sample::{BuiltInModel, BuiltInRecording};
use pliant::motion::bvh::{ClipLimits, read_bvh};
use pliant::motion::rig::{DriveOptions, RigDriver, rig_handles};
use pliant::motion::{Error, MotionClip};
use pliant::wire::rig_from_json;
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

fn read(path: &Path) -> Result<MotionClip, Error> {
    read_bvh(&std::fs::read(path).expect("a file"), &ClipLimits::default())
}

fn clips_below(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    paths.retain(|path| path.extension().is_some_and(|e| e == "bvh"));
    paths.sort();
    paths
}

#[test]
fn every_recorded_clip_is_read_and_stands_upright() {
    let Some(data) = data_folder("recorded clips") else {
        return;
    };
    let paths = clips_below(&data.join("bvh"));
    assert!(paths.len() > 10);
    for path in paths {
        let clip = read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let frames = clip.recorded.expect("frames");
        let is_whole = clip.skeleton.joints.len() > 20 && frames.count > 60;
        assert!(is_whole, "{}", path.display());
        // Bones keep their lengths over the clip where only the root is moved, and places stay finite.
        let mut reach = 0.0_f64;
        for k in 0..16 {
            let seconds = clip.duration * f64::from(k) / 15.0;
            let world = clip.skeleton.world_transforms(&clip.pose_at(seconds));
            for (joint, own) in clip.skeleton.joints.iter().zip(&world) {
                assert!(own.is_finite(), "{}: {}", path.display(), joint.name);
                if let Some(parent) = joint.parent {
                    let length = own.translation.distance(world[parent].translation);
                    let rest = joint.rest.translation.length();
                    let is_kept = (length - rest).abs() < 1e-3 * (1.0 + rest);
                    assert!(is_kept, "{}: {}", path.display(), joint.name);
                    reach = reach.max(own.translation.distance(world[0].translation));
                }
            }
        }
        assert!(reach > 1.0, "{}", path.display());
    }
}

#[test]
fn more_frames_than_declared_count() {
    let Some(data) = data_folder("a clip with a row too many") else {
        return;
    };
    let clip = read(&data.join("bvh/boxing_toes.bvh")).expect("a clip");
    assert_eq!(clip.recorded.map(|frames| frames.count), Some(3070));
    assert_eq!(clip.warnings.len(), 1);
}

#[test]
fn hostile_clips_are_refused_with_a_reason() {
    let Some(data) = data_folder("hostile clips") else {
        return;
    };
    for path in clips_below(&data.join("hostile/bvh")) {
        let refused = read(&path).expect_err(&path.display().to_string()).to_string();
        assert!(refused.len() < 300 && !refused.contains('\n'), "{refused}");
    }
}

fn built_in(recording: BuiltInRecording) -> MotionClip {
    read_bvh(recording.bvh_text().as_bytes(), &ClipLimits::default()).expect("a clip")
}

#[test]
fn who_stands_stands_on_the_ground() {
    for recording in BuiltInRecording::ALL {
        let name = recording.recording_name();
        assert_eq!(BuiltInRecording::from_name(name), Some(recording));
        assert_eq!(recording.bvh_text(), recording.bvh_text(), "the same bytes");
        let clip = built_in(recording);
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
    let clip = built_in(BuiltInRecording::Twist);
    let recorded = clip.recorded.expect("frames");
    let last = recorded.interval * (recorded.count - 1) as f64;
    for (number, joint) in clip.skeleton.joints.iter().enumerate() {
        let [before, after] = [0.0, last].map(|seconds| clip.pose_at(seconds)[number].rotation);
        let turned = before.angle_between(after).to_degrees();
        let wanted = if joint.name == "LeftHand" { 170.0 } else { 0.0 };
        assert!((turned - wanted).abs() < 0.1, "{}: {turned}", joint.name);
    }
}

#[test]
fn the_validator_finds_nothing_wrong_with_the_figure() {
    let folder = Workplace::empty();
    let at = folder.join("figure.glb");
    std::fs::write(&at, BuiltInModel::Figure.glb()).expect("written");
    khronos::assert_valid("the figure", &[at]);
}

#[test]
fn the_figure_walks_and_waves_without_tearing() {
    let file = parse(BuiltInModel::Figure.glb(), &BTreeMap::new());
    let body = |at: Option<ClipTime>| {
        draw(&file, at, &[])
            .expect("a plain player draws it")
            .swap_remove(0)
            .positions
    };
    let rest = body(None);
    let least = |of: &dyn Fn(DVec3) -> f64| (0..rest.len()).min_by(|&a, &b| of(rest[a]).total_cmp(&of(rest[b])));
    let foot = least(&|p| (p - DVec3::new(0.11, 0.0, 0.15)).length()).expect("a vertex");
    let hand = least(&|p| p.x).expect("a vertex");
    for (clip, watched, least) in [(0, foot, 0.3), (1, hand, 0.6)] {
        let length = clip_length(&file, clip);
        let at = |k: i32| length * f64::from(k) / 8.0;
        let frames: Vec<Vec<DVec3>> = (0..=8).map(|k| body(Some(ClipTime { clip, seconds: at(k) }))).collect();
        let way = |a: &[DVec3], b: &[DVec3]| a[watched].distance(b[watched]);
        let farthest = frames.iter().map(|frame| way(frame, &frames[0])).fold(0.0, f64::max);
        assert!(farthest > least, "clip {clip}: {farthest}");
        assert!(way(&frames[0], &frames[8]) < 1e-6, "clip {clip} ends as it begins");
        // No foot goes deep into the ground.
        let lowest = frames.iter().flatten().map(|p| p.y).fold(f64::INFINITY, f64::min);
        assert!(lowest > -0.06, "clip {clip}: {lowest}");
    }
}

const CLIP: &str = "HIERARCHY\nROOT low\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
    JOINT high\n{\nOFFSET 3 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 3 0 0\n}\n}\n}\nMOTION\nFrames: 3\n\
    Frame Time: 0.04\n0 0 0 0 0 0 0 0 0\n1 2 3 90 10 20 170 0 0\n1 2 9 -90 370 20 0 45 180\n";

const RIG: &str = r#"{"version": 1, "joints": {"a": [-2.7, 0, 0], "b": {"at": [0, 0, 0]}, "c": [2.7, 0, 0]}, "reference": {"frame": 1},
    "scale": 0.5, "bones": [{"id": "low", "from": "a", "to": "b", "joint": "low", "rest": "ORIENTATION", "radius": 0.5, "slices": 3},
    {"id": "high", "from": "b", "to": "c", "parent": "low", "joint": "high", "aim": "high", "span": [0.1, 0.9], "radius": 0.5,
    "jointRadius": 0.2, "limitDegrees": 60, "slices": 2}]}"#;

/// What a change puts in: bytes, and numbers at the ends of their ranges.
const WORDS: [&str; 12] = [
    "1e308",
    "-1e308",
    "1e-320",
    "nan",
    "0",
    "-1",
    "99999999999999999999",
    "\"low\"",
    "[]",
    "{}",
    "null",
    "4294967295",
];

/// Bytes replaced, taken out and put in anywhere, and words in place of bytes.
fn changed(text: &str, changes: &[(usize, u8, usize)]) -> Vec<u8> {
    let mut bytes = text.as_bytes().to_vec();
    for (place, byte, kind) in changes {
        let place = place % bytes.len().max(1);
        match kind {
            0 => bytes[place] = *byte,
            1 => _ = bytes.remove(place),
            2 => bytes.insert(place, *byte),
            _ => {
                // A number as a whole, so that what comes of it is read and not refused as a word.
                let is_part = |b: &u8| b.is_ascii_digit() || b".-".contains(b);
                let start = bytes[..place].iter().rposition(|b| !is_part(b)).map_or(0, |at| at + 1);
                let length = bytes[start..].iter().position(|b| !is_part(b)).unwrap_or(0);
                bytes.splice(start..start + length, WORDS[kind % WORDS.len()].bytes());
            }
        }
        if bytes.is_empty() {
            bytes.push(b'0');
        }
    }
    bytes
}

fn changes() -> impl Strategy<Value = Vec<(usize, u8, usize)>> {
    prop::collection::vec((0usize..2000, any::<u8>(), 0usize..15), 0..6)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn no_clip_and_no_rig_make_poses_that_are_no_numbers(of_clip in changes(), of_rig in changes()) {
        let clip = read_bvh(&changed(CLIP, &of_clip), &ClipLimits::default());
        let rig = rig_from_json(&changed(RIG, &of_rig));
        if let Err(e) = &rig {
            prop_assert!(!e.to_string().is_empty());
        }
        let (Ok(clip), Ok(rig)) = (clip, rig) else { return Ok(()) };
        for start in [0.0, 0.04] {
            let options = DriveOptions { start, ..Default::default() };
            let mut driver = match RigDriver::new(&rig, clip.clone(), &options) {
                Ok(driver) => driver,
                Err(e) => {
                    prop_assert!(!e.to_string().is_empty());
                    continue;
                }
            };
            driver.warn_of_twists(&rig, (0..3).map(|k| (k, 0.04 * k as f64)));
            prop_assert!(driver.scale().is_finite() && driver.scale() > 0.0, "{}", driver.scale());
            for seconds in [-1.0, 0.0, 0.05, 1e9] {
                let pose = driver.pose_at(seconds);
                prop_assert_eq!(pose.bones.len(), rig.bones.len());
                for motion in pose.bones.iter().chain([&pose.root]) {
                    prop_assert!(motion.rotation.is_finite() && motion.to.is_finite() && motion.from.is_finite(), "{motion:?}");
                }
                for handle in rig_handles(&rig) {
                    let motion = handle.motion(&rig, &pose);
                    prop_assert!(motion.rotation.is_finite() && motion.to.is_finite(), "{}: {motion:?}", handle.name);
                }
            }
        }
    }
}
