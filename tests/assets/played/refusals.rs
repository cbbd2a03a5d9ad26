//! What `pliant animate` does not write, and what it says then.

use super::{animate, animate_bar, bar_folder, run_bar};
use crate::support::bench::obj;
use crate::support::commands::Workplace;
use std::fs;

/// Everything in a folder with its bytes.
pub(super) fn contents(folder: &Workplace) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder.path()).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.display().to_string();
        all.push((name, fs::read(&path).unwrap_or_default()));
    }
    all.sort();
    all
}

#[test]
fn bad_arguments_say_what_is_allowed_and_write_nothing() {
    let folder = &bar_folder();
    fs::create_dir(folder.join("there")).expect("a folder");
    let before = contents(folder);
    let cases: [(&str, &str); 19] = [
        (
            "-o walk",
            "allowed are .glb, .usda, .pc2, .mdd, .png, .apng and a folder",
        ),
        (
            "-o walk.abc",
            "allowed are .glb, .usda, .pc2, .mdd, .png, .apng and a folder",
        ),
        (
            "-o walk.usdc",
            "USD is written as text, and .usdc is not; write a .usda",
        ),
        ("-o walk.ply", "a folder of them ends in a slash, with --format ply"),
        (
            "-o walk.fbx",
            "fbx is read, not written; allowed are .glb, .usda, .pc2, .mdd, .png, .apng",
        ),
        ("-o there/ --format docx", "--format is \"docx\", allowed are glb,"),
        ("-o there/ --format fbx", "--format is \"fbx\", allowed are glb,"),
        ("-o walk.glb --format obj", "--format is for folders"),
        ("-o there/ --as morph", "--as is for .glb"),
        ("-o walk.pc2 --max-targets 9", "--max-targets is for .glb"),
        (
            "-o walk.glb --max-targets 1",
            "--max-targets is 1, allowed are 2 to 4096",
        ),
        ("-o walk.glb --bones 9", "--bones is for --as skin"),
        ("-o walk.glb --as skin --bones 0", "--bones is 0, allowed are 1 to 256"),
        (
            "-o walk.glb --as skin --max-targets 9",
            "--max-targets is for .glb files with morph targets",
        ),
        ("-o walk.pc2 --root node", "allowed here are baked and none"),
        ("-o walk.glb --root sideways", "possible values: node, baked, none"),
        ("--resume", "--resume needs an --output"),
        ("-o new/walk.glb", "--parents makes it"),
        ("-o new/", "--parents makes it"),
    ];
    for (arguments, wanted) in cases {
        run_bar(folder, arguments).refused(&[wanted]);
        assert_eq!(contents(folder), before, "{arguments:?}");
    }
}

#[test]
fn nothing_is_replaced_unless_forced() {
    let folder = &bar_folder();
    fs::create_dir(folder.join("frames")).expect("a folder");
    let there = ["bar.glb", "bar.mdd", "frames/frame_00003.obj"];
    for name in there {
        folder.put(name, "mine");
    }
    for (output, name) in ["bar.glb", "bar.mdd", "frames/"].into_iter().zip(there) {
        run_bar(folder, &["-o", output, "--frames", "0:4"]).refused(&["it exists; --force replaces it"]);
        assert_eq!(folder.bytes(name), b"mine");
        animate_bar(folder, &["-o", output, "--frames", "0:4", "--force"]);
        assert_ne!(folder.bytes(name), b"mine");
    }
    let frames = fs::read_dir(folder.join("frames")).expect("a folder").count();
    assert_eq!(frames, 4, "and nothing else is left behind");
    let left = contents(folder).into_iter().filter(|(name, _)| name.ends_with(".part"));
    assert_eq!(left.count(), 0);
}

#[test]
fn a_recording_for_which_no_rig_can_be_made_says_why() {
    let reason = "pliant: rig: is missing, and pliant rig finds none: clip: ";
    animate(&bar_folder(), &["bar.obj", "--bvh", "bar.bvh"]).refused(&[reason]);
}

#[test]
fn a_clip_that_moves_no_skin_is_reported_as_one() {
    let folder = &Workplace::empty();
    let corners = [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let numbers = corners
        .into_iter()
        .flatten()
        .chain([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0]);
    let bytes: Vec<u8> = numbers.flat_map(f32::to_le_bytes).collect();
    folder.put("a.bin", &bytes);
    let gltf = serde_json::json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "animations": [{
            "name": "lift", "samplers": [{"input": 1, "output": 2}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
        }],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 2, "type": "SCALAR", "min": [0], "max": [1]},
            {"bufferView": 2, "componentType": 5126, "count": 2, "type": "VEC3"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 8},
            {"buffer": 0, "byteOffset": 44, "byteLength": 24},
        ],
        "buffers": [{"uri": "a.bin", "byteLength": bytes.len()}],
    });
    folder.put("a.gltf", gltf.to_string());
    let reason = "rig: the model has no skin, and clip 0 \"lift\" moves nodes or morph targets alone";
    animate(folder, &["a.gltf", "--clip", "lift"]).refused(&[reason]);
}

#[test]
fn an_open_model_has_no_change_of_volume() {
    let folder = &bar_folder();
    let whole = animate_bar(folder, "--frames 0:2");
    assert!(
        whole.contains("; volume ") && whole.contains(" %, at worst "),
        "{whole}"
    );
    // The bar without one of its triangles is open.
    let text = folder.text("bar.obj");
    let (kept, _) = text.trim_end().rsplit_once('\n').expect("lines");
    folder.put("bar.obj", format!("{kept}\n"));
    let open = animate_bar(folder, "--frames 0:2");
    assert!(open.contains("; volume n/a (the surface is open); "), "{open}");
}

#[test]
fn faces_too_large_for_the_bends_of_a_rig_are_warned_of() {
    let folder = &bar_folder();
    let fine = animate_bar(folder, "--frames 0:2");
    assert!(!fine.contains("faces-too-large"), "{fine}");
    let (positions, triangles) = pliant::asset::shapes::box_with_cells(glam::DVec3::new(6.0, 1.0, 1.0), [2, 1, 1]);
    let text = obj(&(
        positions
            .into_iter()
            .map(|p| p - glam::DVec3::new(3.0, 0.5, 0.5))
            .collect(),
        triangles,
    ));
    folder.put("bar.obj", text.main);
    let coarse = animate_bar(folder, "--frames 0:2");
    assert!(
        coarse.contains("warning: faces-too-large: ") && coarse.contains("the edit \"subdivide\" with \"auto\""),
        "{coarse}"
    );
}
