//! Clips and rigs at the ends of what numbers can say: what comes out is finite, or refused before anything is written.

use super::beside::{make_scene, scene_folder};
use super::{animate, animate_bar, bar_folder, read_cache, run_bar};
use crate::support::commands::{Ran, Workplace};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::Vec3;
use std::fs;

/// When the keys of [`make_scene`]'s clip are, and where its walk goes.
const TIMES: [f32; 4] = [0.0, 0.5, 1.1, 2.0];
const WALK: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.5, 0.0, 4.0, 0.0, 1.0];

/// Puts other numbers into the buffer of a scene.
fn replace_numbers(folder: &Workplace, from: &[f32], to: &[f32]) {
    let path = folder.join("scene.gltf");
    let text = fs::read_to_string(&path).expect("a scene");
    let (head, tail) = text.split_once("base64,").expect("a buffer");
    let (data, end) = tail.split_once('"').expect("its end");
    let mut bytes = STANDARD.decode(data).expect("base64");
    let [from, to] = [from, to].map(|v| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>());
    let at = bytes.windows(from.len()).position(|w| w == from).expect("the numbers");
    bytes[at..at + to.len()].copy_from_slice(&to);
    fs::write(&path, format!("{head}base64,{}\"{end}", STANDARD.encode(&bytes))).expect("written");
}

/// Plays the clip of a scene.
fn act(folder: &Workplace) -> Ran {
    animate(folder, "scene.gltf --clip act --refine 0 -o act.pc2 --force")
}

#[test]
fn a_clip_of_endless_seconds_or_endless_ways_is_refused() {
    let folder = &scene_folder();
    replace_numbers(folder, &TIMES, &[0.0, 0.5, 1.1, 1e30]);
    act(folder).refused(&["frames are asked for, at most 1000000 are allowed"]);
    make_scene(folder, false);
    replace_numbers(folder, &WALK[3..], &[3e38, 3e38, 3e38]);
    act(folder).refused(&["farther than 1e37 from the origin in frame"]);
    assert!(!folder.join("act.pc2").exists() && !folder.join("act.pc2.part").exists());
}

#[test]
fn a_clip_that_scales_only_for_a_while_is_warned_of() {
    let folder = &scene_folder();
    replace_numbers(folder, &TIMES, &[0.0, 0.5, 1.0, 2.0]);
    let sizes = [1.0, 1.0, 1.0, 1.5, 1.5, 1.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0];
    replace_numbers(folder, &WALK, &sizes);
    let path = folder.join("scene.gltf");
    let text = fs::read_to_string(&path).expect("a scene");
    let walks = r#"{"node":1,"path":"translation"}"#;
    assert!(text.contains(walks));
    fs::write(&path, text.replace(walks, r#"{"node":1,"path":"scale"}"#)).expect("written");
    let said = act(folder).well().err;
    assert!(said.contains("warning: the clip scales or shears \"low\""), "{said}");
}

#[test]
fn a_scale_beyond_what_floats_hold_is_refused() {
    let folder = &bar_folder();
    for scale in ["1e300", "1e-300", "inf"] {
        let reason = "allowed are auto and numbers from 1e-12 to 1e12";
        run_bar(folder, &["-o", "out.pc2", "--scale", scale]).refused(&[reason]);
    }
    assert!(!folder.join("out.pc2").exists());
}

#[test]
fn what_a_rig_says_that_cannot_be_meant_is_reported() {
    let folder = &bar_folder();
    let rig = folder.text("rig.json");
    let said = animate_bar(folder, "-o there.pc2");
    assert!(!said.contains("bones of the rig"), "{said}");

    // The bone that the tail of another model has: it holds what is nearest.
    let away = rig
        .replace("[-2.7, 0, 0]", "[-2.7, 9, 0]")
        .replace("[0, 0, 0]", "[0, 9, 0]");
    folder.put("rig.json", away);
    let said = animate_bar(folder, "-o away.pc2");
    let wanted = "warning: bones of the rig lie outside of the model and hold what is nearest to them: \"low\";";
    assert!(said.contains(wanted), "{said}");

    let point = rig.replace(r#""from": "b", "to": "c""#, r#""from": "b", "to": "b""#);
    folder.put("rig.json", point);
    let said = animate_bar(folder, "-o point.pc2");
    assert!(
        said.contains("warning: bones of the rig have no length, so that nothing is held along them: \"high\""),
        "{said}"
    );

    folder.put("rig.json", rig.replacen(r#""ORIENTATION""#, "99", 1));
    let reason = "rig.json: bones[0].rest: is 99, which is not a value of this enum";
    run_bar(folder, "-o out.pc2").refused(&[reason]);

    let long = format!("x\\u001b[31m{}", "y".repeat(100_000));
    let far = rig.replacen(r#""parent": "low""#, r#""parent": "none""#, 1);
    folder.put("rig.json", far.replace("\"low\"", &format!("\"{long}\"")));
    let done = run_bar(folder, "-o out.pc2").refused(&["there is no such bone"]);
    assert!(
        done.last().len() < 500 && !done.last().contains('\u{1b}'),
        "{}",
        done.last()
    );
}

#[test]
fn weights_of_morph_targets_may_be_whole_numbers() {
    let folder = &scene_folder();
    let path = folder.join("scene.gltf");
    let text = fs::read_to_string(&path).expect("a scene");
    let floats = r#""componentType":5126,"count":24,"type":"SCALAR""#;
    assert!(text.contains(floats));
    let bytes = r#""componentType":5121,"normalized":true,"count":24,"type":"SCALAR""#;
    fs::write(&path, text.replace(floats, bytes)).expect("written");
    act(folder).well();
    // The last key's weight is byte 20 of the floats that stood there: 0.8 begins with 0xcd.
    let (_, frames) = read_cache(&folder.join("act.pc2"));
    let smiling = Vec3::new(0.5 + 205.0 / 255.0, 5.0, 0.0);
    let last = frames.last().expect("frames");
    assert!(last.iter().any(|p| p.distance(smiling) < 1e-3), "{smiling}: {last:?}");
}
