//! Clips, rigs and skins that are damaged, row by row: what is wrong, where, and what is allowed stand in the last line.

use super::beside::scene_folder;
use super::{BAR, animate, bar_folder};
use crate::support::commands::{Ran, Workplace};

/// Runs `pliant animate` on files of a folder. Nothing is written when it is refused.
fn run(folder: &Workplace, arguments: &[&str]) -> Ran {
    let done = animate(folder, &[arguments, &["-o", "out.pc2", "--force"]].concat());
    assert_eq!(folder.join("out.pc2").exists(), done.code == Some(0), "{}", done.err);
    assert!(!folder.join("out.pc2.part").exists(), "{}", done.err);
    done
}

/// Checks that a run is refused with the words of each row in its last line where the row's change is made in a file.
fn refuse_each(folder: &Workplace, arguments: &[&str], name: &str, cases: &[(&str, &str, &[&str])]) {
    for (from, to, wanted) in cases {
        let whole = change(folder, name, from, to);
        run(folder, arguments).refused(wanted);
        folder.put(name, whole);
    }
}

/// Puts a changed text in place of a file.
fn change(folder: &Workplace, name: &str, from: &str, to: &str) -> String {
    let text = folder.text(name);
    assert!(text.contains(from), "{from}");
    folder.put(name, text.replacen(from, to, 1));
    text
}

#[test]
fn damaged_clips_are_refused_with_their_line() {
    let folder = &bar_folder();
    let row = "0 0 0 0 0 0 0 0 0\n";
    let cases: &[(&str, &str, &[&str])] = &[
        ("MOTION\n", "", &["bar.bvh: line", "MOTION"]),
        ("}\nMOTION", "MOTION", &["bar.bvh: line", "not closed"]),
        (row, "0 0 0 nan 0 0 0 0 0\n", &["line 19", "not finite"]),
        (row, "0 0 0 0 0 0 0 0\n", &["line 19", "8 numbers, the joints have 9"]),
        (
            row,
            "0 0 0 0 0 0 0 0 0 0\n",
            &["line 19", "10 numbers, the joints have 9"],
        ),
        (row, "0 0 0 0,5 0 0 0 0 0\n", &["line 19", "comma"]),
        (
            "Frames: 12",
            "Frames: 13",
            &["line", "13 frames are declared, 12 follow"],
        ),
        ("Frames: 12", "Frames: 0", &["line 17", "at least 1"]),
        ("Frames: 12", "Frames: -3", &["line 17"]),
        (
            "Frames: 12",
            "Frames: 1000000000000",
            &["frames", "1000000000000", "at most"],
        ),
        ("Frame Time: 0.25", "Frame Time: 0", &["line 18", "frame time"]),
        ("Frame Time: 0.25", "Frame Time: -1", &["line 18", "frame time"]),
        ("Xposition", "Wposition", &["line 5", "Xposition"]),
        ("MOTION", "ROOT b\n{\nOFFSET 0 0 0\n}\nMOTION", &["line", "second ROOT"]),
    ];
    refuse_each(folder, &BAR, "bar.bvh", cases);
    let whole = folder.bytes("bar.bvh");
    folder.put("bar.bvh", "");
    run(folder, &BAR).refused(&["bar.bvh", "empty"]);
    let chain = |count: usize| {
        let joints = "JOINT a\n{\nOFFSET 0 1 0\nCHANNELS 0\n".repeat(count - 1);
        let ends = "}\n".repeat(count);
        format!("HIERARCHY\nROOT low\n{{\nOFFSET 0 0 0\nCHANNELS 0\n{joints}{ends}MOTION\nFrames: 1\nFrame Time: 1\n")
    };
    folder.put("bar.bvh", chain(6000));
    run(folder, &BAR).refused(&["bar.bvh", "joints", "4096"]);
    // A row more than is declared counts, with a warning.
    folder.put("bar.bvh", whole);
    change(folder, "bar.bvh", "Frames: 12", "Frames: 11");
    let said = run(folder, &BAR).well().err;
    assert!(said.contains("warning:") && said.contains("12 frames, "), "{said}");
}

#[test]
fn rigs_that_cannot_be_are_refused_with_the_bone() {
    let folder = &bar_folder();
    let high = r#"{"id": "high", "from": "b", "to": "c", "parent": "low""#;
    let cases: &[(&str, &str, &[&str])] = &[
        (
            "\"joint\": \"low\"",
            "\"joint\": \"pelvis\"",
            &["joint: ", "\"pelvis\" of bone \"low\"", "it has \"low\", \"high\""],
        ),
        (
            "\"radius\": 0.5",
            "\"radius\": 0",
            &["rig.json: bones[0].radius: is 0, a number above 0"],
        ),
        (
            "\"radius\": 0.5",
            "\"radius\": -1",
            &["rig.json: bones[0].radius: is -1"],
        ),
        (
            r#""id": "low","#,
            r#""id": "low", "parent": "high","#,
            &["bones: the parents of \"low\", \"high\" form a cycle"],
        ),
        (
            high,
            r#"{"id": "high", "from": "b", "to": "c""#,
            &["\"low\", \"high\" have no parent; all but one"],
        ),
        (
            high,
            r#"{"id": "high", "from": "b", "to": "c", "parent": "tail""#,
            &["bones[1].parent: is \"tail\"", "there are"],
        ),
        (
            r#""from": "a""#,
            r#""from": "z""#,
            &["bones[0].from: is \"z\", the rig's joints have no such name"],
        ),
        (
            "\"version\": 1",
            "\"version\": 7",
            &["version: is 7, this program reads version 1"],
        ),
        (
            "\"version\": 1,",
            "\"version\": 1, \"reference\": {\"frame\": 99},",
            &["referenceFrame: is 99, the clip has 12 frames"],
        ),
        ("{\"version\"", "\"version\"", &["rig.json"]),
    ];
    refuse_each(folder, &BAR, "rig.json", cases);
    // A bone without length makes no handle, and a warning.
    change(
        folder,
        "rig.json",
        r#""bones": ["#,
        r#""bones": [{"id": "none", "from": "b", "to": "b", "parent": "low", "joint": "high", "radius": 0.5},"#,
    );
    let said = run(folder, &BAR).well().err;
    assert!(said.contains("warning: bone \"none\" has no length"), "{said}");
}

#[test]
fn a_long_chain_of_bones_is_refused_without_recursion() {
    let folder = &bar_folder();
    let bone = |k: usize| {
        let parent = if k == 0 {
            String::new()
        } else {
            format!("\"parent\": \"b{}\",", k - 1)
        };
        format!(r#"{{"id": "b{k}", {parent} "from": "a", "to": "b", "joint": "low", "radius": 0.5}}"#)
    };
    let bones: Vec<String> = (0..6000).map(bone).collect();
    let rig = format!(
        r#"{{"version": 1, "joints": {{"a": [0, 0, 0], "b": [1, 0, 0]}}, "bones": [{}]}}"#,
        bones.join(",")
    );
    folder.put("rig.json", rig);
    run(folder, &BAR).refused(&["rig.json: bones: has", "allowed are 1 to 1024"]);
}

#[test]
fn skins_and_clips_of_a_model_that_name_what_is_not_there_are_refused() {
    let folder = &scene_folder();
    let act = ["scene.gltf", "--clip", "act", "--fps", "5", "--refine", "0"];
    let cases: &[(&str, &str, &[&str])] = &[
        (
            r#""joints":[1,2]"#,
            r#""joints":[1,99]"#,
            &["node 99 as a joint, there are 7 nodes"],
        ),
        (
            r#""joints":[1,2]"#,
            r#""joints":[1,2],"inverseBindMatrices":999"#,
            &["inverse bind matrices", "999"],
        ),
        (
            r#""joints":[1,2]"#,
            r#""joints":[1,2],"inverseBindMatrices":0"#,
            &["inverse bind matrices"],
        ),
        (
            r#"{"sampler":0,"#,
            r#"{"sampler":77,"#,
            &["animations/0/channels/0/sampler", "is 77, there are 5 samplers"],
        ),
        (
            r#"{"sampler":0,"target":{"node":2,"#,
            r#"{"sampler":0,"target":{"node":70,"#,
            &["animations/0/channels/0/target/node", "is 70, there are 7 nodes"],
        ),
        (
            r#""samplers":[{"input":"#,
            r#""samplers":[{"input":5"#,
            &["animations/0/channels/0/sampler/input", "accessors"],
        ),
        (
            r#""interpolation":"STEP""#,
            r#""interpolation":"LEAP""#,
            &["\"LEAP\", allowed are LINEAR, STEP and CUBICSPLINE"],
        ),
    ];
    refuse_each(folder, &act, "scene.gltf", cases);
    let reason = "clip: \"sing\" is not a clip of the model; there are 0 \"act\"";
    run(folder, &["scene.gltf", "--clip", "sing"]).refused(&[reason]);
    // Of a joint's matrix that shears, the nearest rotation is taken, with a warning.
    change(
        folder,
        "scene.gltf",
        r#""name":"low","#,
        r#""name":"low","matrix":[1,0,0,0, 0.3,1,0,0, 0,0,1,0, 0,0,0,1],"#,
    );
    change(folder, "scene.gltf", r#""target":{"node":1,"#, r#""target":{"node":4,"#);
    let said = run(folder, &act).well().err;
    assert!(
        said.contains("warning: ") && said.contains("\"low\"") && said.contains("shear"),
        "{said}"
    );
}
