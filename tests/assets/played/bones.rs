//! Animations that leave as a skin of rigid bones.

use super::outputs::farthest_of_bar;
use super::{animate_bar, make_bar, read_glb};
use crate::support::data::tell_skipped;
use crate::support::khronos;
use glam::DVec3;

#[test]
fn a_few_bones_play_the_frames_as_nearly_as_is_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    make_bar(folder);
    animate_bar(folder, &["-o", "bar.pc2"]);
    let said = animate_bar(folder, &["-o", "bar.glb", "--as", "skin", "--bones", "12"]);
    let line = said
        .lines()
        .find(|l| l.contains("12 bones play the frames"))
        .expect(&said);
    let worst = line
        .split_once("mean square), ")
        .and_then(|(_, rest)| rest.split_once(" %"));
    let told: f64 = worst.expect("a percentage").0.parse().expect("a number");
    let file = read_glb(&folder.join("bar.glb"));
    assert_eq!(file.json["skins"][0]["joints"].as_array().map(Vec::len), Some(12));
    assert!(file.json["meshes"][0]["primitives"][0].get("targets").is_none());
    let worst = farthest_of_bar(folder, &file);
    let percent = 100.0 * worst / DVec3::new(6.0, 1.0, 1.0).length();
    assert!((percent - told).abs() < 5e-3, "{percent} % is told as {told} %");
    assert!(told < 1.0, "{told} %");
    let Some(findings) = khronos::validate(&[folder.join("bar.glb")]) else {
        return tell_skipped("skins by the validator", "it cannot be had");
    };
    let found = &findings[&folder.join("bar.glb")];
    assert!(found.is_empty(), "{found:?}");
}
