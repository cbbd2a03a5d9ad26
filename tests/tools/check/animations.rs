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
    suite.passes(&[]);
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
    let failed = suite.fails(&[]);
    let told = "1 of 68 frames differ; the digest of the first of them, number 5, is";
    failed.says(&[told]);
    suite.passes("--bless");
    suite.passes(&[]);
}

#[test]
fn another_clip_makes_the_golden_stale_and_a_damaged_one_is_told() {
    let suite = wave();
    let clip = suite.read("clips/wave.bvh");
    suite.write("clips/wave.bvh", &clip.replacen("0 0 0 0.5 0 0", "0 0 0 1.5 0 0", 1));
    let stale = suite.fails(&[]);
    stale.says(&["the golden is stale: the case's job has changed"]);
    suite.write("clips/wave.bvh", &clip.replacen("Frame Time: 0.05", "Frame Time: 0", 1));
    let damaged = suite.fails(&[]);
    damaged.says(&["clip: line "]);
    suite.remove("clips/wave.bvh");
    let missing = suite.exits(2, &[]);
    missing.gives(&["wave.bvh"]);
}
