//! Animations that leave with the bones of their rig: fitted weights, twists and correctives.

use super::outputs::{farthest_of_bar, percent_after, written_error};
use super::{animate, animate_bar, bar_folder, read_glb, run_bar};
use crate::support::commands::Workplace;
use crate::support::khronos;
use crate::support::skinning::list;
use glam::DVec3;
use pliant::asset::sample::BuiltInModel;
use serde_json::Value;

#[test]
fn bones_of_the_rig_play_the_frames_as_nearly_as_is_reported() {
    let folder = &bar_folder();
    animate_bar(folder, "-o bar.pc2");
    let (_, file) = written_error(folder, "--as skin --skeleton rig", "bones play the frames");
    let nodes = file.json["nodes"].as_array().expect("nodes");
    let names: Vec<&str> = nodes.iter().filter_map(|n| n["name"].as_str()).collect();
    assert!(names.contains(&"low") && names.contains(&"high"), "{names:?}");
    let low = nodes.iter().find(|n| n["name"] == "low").expect("a bone");
    assert_eq!(low["children"].as_array().map(Vec::len), Some(1), "high hangs on low");
    khronos::assert_valid("skins of rigs", &[folder.join("bar.glb")]);

    let rig = folder.text("rig.json");
    let sliced = rig.replace(r#""joint": "high","#, r#""joint": "high", "slices": 3,"#);
    folder.put("rig.json", sliced);
    animate_bar(folder, "-o bar.pc2 --force");
    let (reported, _) = written_error(folder, "--as skin --skeleton twist", "5 bones play");
    assert_eq!(reported["parts"], 5, "{reported}");
    assert!(String::from_utf8_lossy(&folder.bytes("bar.glb")).contains("high twist 3"));
    khronos::assert_valid("skins of rigs", &[folder.join("bar.glb")]);
}

#[test]
fn correctives_make_up_for_what_bones_do_not_play() {
    let folder = &bar_folder();
    animate_bar(folder, "-o bar.pc2");
    let said = animate_bar(folder, "-o few.glb --as correctives --poses 2");
    let before = percent_after(&said, "bones are off by ");
    let (_, corrected) = said.split_once("with correctives of frames ").expect("correctives");
    let few = percent_after(corrected, " by ");
    assert!(few < before && before > 0.0, "{few} of {before}");
    // As many correctives as frames leave nothing.
    let said = animate_bar(folder, "-o all.glb --as correctives --poses 64");
    let file = read_glb(&folder.join("all.glb"));
    let worst = 100.0 * farthest_of_bar(folder, &file) / DVec3::new(6.0, 1.0, 1.0).length();
    assert!(worst < 0.02, "{worst} % of the diagonal: {said}");
    let targets = list(&file.json["meshes"][0]["primitives"][0]["targets"]).len();
    assert!(targets > 2, "{targets} correctives");
    khronos::assert_valid("skins of rigs", &[folder.join("few.glb"), folder.join("all.glb")]);
}

#[test]
fn a_skins_own_clip_is_corrected_on_its_own_weights() {
    let folder = &Workplace::empty();
    folder.put("figure.glb", BuiltInModel::Figure.glb());
    let options = "figure.glb --clip walk -o walk.glb --as correctives --poses 3 --frames 0:8";
    animate(folder, options).well();
    let file = read_glb(&folder.join("walk.glb"));
    let clips = file.json["animations"].as_array().expect("clips");
    let weights = |clip: &Value| list(&clip["channels"]).iter().any(|c| c["target"]["path"] == "weights");
    assert!(clips.iter().any(weights), "weights are animated");
    khronos::assert_valid("skins of rigs", &[folder.join("walk.glb")]);
}

#[test]
fn options_of_other_skins_are_refused() {
    let folder = &bar_folder();
    for (arguments, reported) in [
        ("--skeleton rig", "--skeleton is for --as skin"),
        (
            "--as skin --skeleton rig --bones 3",
            "--bones is for --as skin with free bones",
        ),
        ("--as skin --poses 3", "--poses is for --as correctives"),
        ("--as correctives --poses 0", "--poses is 0, allowed are 1 to 256"),
    ] {
        run_bar(folder, &format!("-o a.glb {arguments}")).refused(&[reported]);
    }
    assert!(!folder.join("a.glb").exists());
}
