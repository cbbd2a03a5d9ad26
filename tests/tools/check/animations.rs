//! Cases that are animations: a golden keeps a digest a frame, and the shape of the last one.

use super::folder::{Suite, sample_suite};
use std::fs;

/// The sample suite's animation in a folder of its own.
fn wave() -> Suite {
    let suite = Suite::new();
    for folder in ["models", "clips"] {
        fs::create_dir(suite.path().join(folder)).expect("a folder");
    }
    for name in ["wave.case.json", "wave.golden.json", "models/bar.obj", "clips/wave.bvh"] {
        fs::copy(sample_suite().join(name), suite.path().join(name)).expect("copied");
    }
    suite
}

#[test]
fn a_frame_that_differs_is_told_by_its_number() {
    let suite = wave();
    let passed = suite.check(&[]);
    assert_eq!(passed.code, Some(0), "{}", passed.err);
    let golden: serde_json::Value = serde_json::from_str(&suite.read("wave.golden.json")).expect("JSON");
    let frames: Vec<&str> = golden["frames"]
        .as_array()
        .expect("a digest a frame")
        .iter()
        .filter_map(|digest| digest.as_str())
        .collect();
    assert_eq!(frames.len(), 68);
    assert_eq!(golden["digest"], frames[67], "the shape is that of the last frame");
    let other = suite
        .read("wave.golden.json")
        .replacen(frames[5], "xxh3:0000000000000000", 1);
    suite.write("wave.golden.json", &other);
    let failed = suite.check(&[]);
    assert_eq!(failed.code, Some(1));
    let told = "1 of 68 frames differ; the digest of the first of them, number 5, is";
    assert!(failed.err.contains(told), "{}", failed.err);
    assert_eq!(suite.check(&["--bless"]).code, Some(0));
    assert_eq!(suite.check(&[]).code, Some(0));
}

#[test]
fn another_clip_makes_the_golden_stale_and_a_damaged_one_is_told() {
    let suite = wave();
    let clip = suite.read("clips/wave.bvh");
    suite.write("clips/wave.bvh", &clip.replacen("0 0 0 0.5 0 0", "0 0 0 1.5 0 0", 1));
    let stale = suite.check(&[]);
    assert_eq!(stale.code, Some(1));
    assert!(
        stale.err.contains("the golden is stale: the case's job has changed"),
        "{}",
        stale.err
    );
    suite.write("clips/wave.bvh", &clip.replacen("Frame Time: 0.05", "Frame Time: 0", 1));
    let damaged = suite.check(&[]);
    assert_eq!(damaged.code, Some(1));
    assert!(damaged.err.contains("clip: line "), "{}", damaged.err);
    suite.remove("clips/wave.bvh");
    let missing = suite.check(&[]);
    assert_eq!(missing.code, Some(2));
    assert!(missing.last().contains("wave.bvh"), "{}", missing.err);
}
