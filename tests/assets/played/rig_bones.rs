//! Animations that leave with the bones of their rig: fitted weights, twists and correctives.

use super::outputs::farthest_of_bar;
use super::{BAR, animate, animate_bar, make_bar, read_glb};
use crate::support::data::tell_skipped;
use crate::support::khronos;
use crate::support::program::words;
use glam::DVec3;
use pliant::asset::sample::BuiltInModel;
use serde_json::Value;
use std::fs;
use std::path::Path;

fn assert_valid(file: &Path) {
    match khronos::validate(&[file.to_owned()]) {
        Some(findings) => assert!(findings[file].is_empty(), "{:?}", findings[file]),
        None => tell_skipped("skins of rigs by the validator", "it cannot be had"),
    }
}

/// The percentage after a text in a line of what was said.
fn percent_after(said: &str, text: &str) -> f64 {
    let (_, rest) = said.split_once(text).unwrap_or_else(|| panic!("no {text:?} in {said}"));
    let (number, _) = rest.split_once(" %").expect("a percentage");
    number.trim().parse().expect("a number")
}

#[test]
fn bones_of_the_rig_play_the_frames_as_nearly_as_is_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    make_bar(folder);
    animate_bar(folder, &["-o", "bar.pc2"]);
    let percent = |file: &str| {
        100.0 * farthest_of_bar(folder, &read_glb(&folder.join(file))) / DVec3::new(6.0, 1.0, 1.0).length()
    };
    let said = animate_bar(folder, &["-o", "rig.glb", "--as", "skin", "--skeleton", "rig"]);
    let told = percent_after(&said, "(root mean square), ");
    assert!(
        (percent("rig.glb") - told).abs() < 5e-3,
        "{} is told as {told}",
        percent("rig.glb")
    );
    let file = read_glb(&folder.join("rig.glb"));
    let nodes = file.json["nodes"].as_array().expect("nodes");
    let names: Vec<&str> = nodes.iter().filter_map(|n| n["name"].as_str()).collect();
    assert!(names.contains(&"low") && names.contains(&"high"), "{names:?}");
    let low = nodes.iter().find(|n| n["name"] == "low").expect("a bone");
    assert_eq!(low["children"].as_array().map(Vec::len), Some(1), "high hangs on low");
    assert_valid(&folder.join("rig.glb"));

    let rig = fs::read_to_string(folder.join("rig.json")).expect("a rig");
    fs::write(
        folder.join("rig.json"),
        rig.replace(r#""joint": "high","#, r#""joint": "high", "slices": 3,"#),
    )
    .expect("written");
    animate_bar(folder, &["-o", "bar.pc2", "--force"]);
    let said = animate_bar(folder, &["-o", "twist.glb", "--as", "skin", "--skeleton", "twist"]);
    assert!(said.contains("5 bones play"), "{said}");
    let told = percent_after(&said, "(root mean square), ");
    assert!((percent("twist.glb") - told).abs() < 5e-3);
    assert!(fs::read(folder.join("twist.glb")).is_ok_and(|b| String::from_utf8_lossy(&b).contains("high twist 3")));
    assert_valid(&folder.join("twist.glb"));
}

#[test]
fn correctives_make_up_for_what_bones_do_not_play() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    make_bar(folder);
    animate_bar(folder, &["-o", "bar.pc2"]);
    let said = animate_bar(folder, &["-o", "few.glb", "--as", "correctives", "--poses", "2"]);
    let before = percent_after(&said, "bones are off by ");
    let (_, corrected) = said.split_once("with correctives of frames ").expect("correctives");
    let few = percent_after(corrected, " by ");
    assert!(few < before && before > 0.0, "{few} of {before}");
    // As many correctives as frames leave nothing.
    let said = animate_bar(folder, &["-o", "all.glb", "--as", "correctives", "--poses", "64"]);
    let file = read_glb(&folder.join("all.glb"));
    let worst = 100.0 * farthest_of_bar(folder, &file) / DVec3::new(6.0, 1.0, 1.0).length();
    assert!(worst < 0.02, "{worst} % of the diagonal: {said}");
    let targets = file.json["meshes"][0]["primitives"][0]["targets"]
        .as_array()
        .map_or(0, Vec::len);
    assert!(targets > 2, "{targets} correctives");
    assert_valid(&folder.join("few.glb"));
    assert_valid(&folder.join("all.glb"));
}

#[test]
fn a_skins_own_clip_is_corrected_on_its_own_weights() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    fs::write(
        folder.join("figure.glb"),
        BuiltInModel::from_name("figure").expect("a figure").glb(),
    )
    .expect("written");
    let done = animate(
        folder,
        &words("figure.glb --clip walk -o walk.glb --as correctives --poses 3 --frames 0:8"),
    );
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(done.status.success(), "{said}");
    let file = read_glb(&folder.join("walk.glb"));
    let clips = file.json["animations"].as_array().expect("clips");
    let weights = |clip: &Value| {
        clip["channels"]
            .as_array()
            .is_some_and(|all| all.iter().any(|c| c["target"]["path"] == "weights"))
    };
    assert!(clips.iter().any(weights), "weights are animated");
    assert_valid(&folder.join("walk.glb"));
}

#[test]
fn options_of_other_skins_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    make_bar(folder);
    for (arguments, told) in [
        (&["-o", "a.glb", "--skeleton", "rig"][..], "--skeleton is for --as skin"),
        (
            &["-o", "a.glb", "--as", "skin", "--skeleton", "rig", "--bones", "3"],
            "--bones is for --as skin with free bones",
        ),
        (
            &["-o", "a.glb", "--as", "skin", "--poses", "3"],
            "--poses is for --as correctives",
        ),
        (
            &["-o", "a.glb", "--as", "correctives", "--poses", "0"],
            "--poses is 0, allowed are 1 to 256",
        ),
    ] {
        let all: Vec<&str> = BAR.iter().chain(arguments).copied().collect();
        let done = animate(folder, &all);
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(2), "{said}");
        assert!(said.lines().last().is_some_and(|l| l.contains(told)), "{said}");
    }
    assert!(!folder.join("a.glb").exists());
}
