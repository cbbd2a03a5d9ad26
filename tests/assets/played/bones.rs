//! Animations that leave as a skin of rigid bones.

use super::outputs::{bar_vertices, rest_of_bar};
use super::{FRAMES, STEP, animate_bar, farthest, make_bar, read_cache, read_glb};
use crate::support::data::tell_skipped;
use crate::support::khronos;
use crate::support::skinning::{ClipTime, draw};
use glam::{DVec3, Vec3};

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
    let (_, frames) = read_cache(&folder.join("bar.pc2"));
    let rest = rest_of_bar(folder);
    let file = read_glb(&folder.join("bar.glb"));
    assert_eq!(file.json["skins"][0]["joints"].as_array().map(Vec::len), Some(12));
    assert!(file.json["meshes"][0]["primitives"][0].get("targets").is_none());
    let still = draw(&file, None, &[]).expect("it is drawn").swap_remove(0);
    let same = bar_vertices(&still.positions, &rest);
    let mut worst: f64 = 0.0;
    for (k, frame) in frames.iter().enumerate() {
        let at = ClipTime {
            clip: 0,
            seconds: STEP * k as f64,
        };
        let drawn = draw(&file, Some(at), &[]).expect("it is drawn").swap_remove(0);
        let wanted: Vec<Vec3> = same.iter().map(|v| frame[*v]).collect();
        worst = worst.max(farthest(&drawn.positions, &wanted));
    }
    let percent = 100.0 * worst / DVec3::new(6.0, 1.0, 1.0).length();
    assert_eq!(frames.len(), FRAMES);
    assert!((percent - told).abs() < 5e-3, "{percent} % is told as {told} %");
    assert!(told < 1.0, "{told} %");
    let Some(findings) = khronos::validate(&[folder.join("bar.glb")]) else {
        return tell_skipped("skins by the validator", "it cannot be had");
    };
    let found = &findings[&folder.join("bar.glb")];
    assert!(found.is_empty(), "{found:?}");
}
