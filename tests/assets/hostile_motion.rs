//! Damaged clips and rigs on their way to poses: whatever bytes they have, they are refused, or give numbers.

use pliant::motion::bvh::{ClipLimits, read_bvh};
use pliant::motion::rig::{DriveOptions, RigDriver, rig_handles};
use pliant::wire::rig_from_json;
use proptest::prelude::*;

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
