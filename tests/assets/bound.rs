//! `pliant skin` as a script sees it.

use crate::support::bench::obj;
use crate::support::commands::{Ran, Workplace};
use crate::support::data::data_path;
use crate::support::gltf_parsed::{Parsed, parse};
use crate::support::khronos;
use crate::support::skinning::{draw, list};
use glam::DVec3;
use pliant::asset::shapes;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

const RIG: &str = r#"{"version": 1, "joints": {"a": [0.2, 0.5, 0.5], "b": [2, 0.5, 0.5], "c": [4, 0.5, 0.5], "d": [5.8, 0.5, 0.5]}, "bones": [
    {"id": "hand", "from": "c", "to": "d", "parent": "arm", "joint": "hand", "radius": 0.5},
    {"id": "trunk", "from": "a", "to": "b", "joint": "trunk", "radius": 0.5},
    {"id": "arm", "from": "b", "to": "c", "parent": "trunk", "joint": "arm", "radius": 0.5}]}"#;

/// A folder with a bar of 6 by 1 by 1 and a rig of three bones along it, one on the other.
fn bar_folder() -> Workplace {
    let folder = Workplace::empty();
    let bar = obj(&shapes::box_with_cells(DVec3::new(6.0, 1.0, 1.0), [24, 4, 4]));
    folder.put("bar.obj", bar.main);
    folder.put("rig.json", RIG);
    folder
}

fn skin(folder: &Workplace, arguments: &str) -> Ran {
    folder.run(&format!("skin {arguments}"))
}

fn read_glb(path: &Path) -> Parsed {
    parse(&fs::read(path).expect("a file"), &BTreeMap::new())
}

fn assert_valid(file: PathBuf) {
    khronos::assert_valid("bound models", &[file]);
}

#[test]
fn joints_hang_on_each_other_as_the_bones_do_and_stand_where_the_model_is() {
    let folder = &bar_folder();
    let report = skin(folder, "bar.obj --rig rig.json -o bar.glb --json").well().json();
    assert_eq!((&report["unweighted"], &report["bones"]), (&0.into(), &3.into()));
    assert!(report["influences"].as_u64().is_some_and(|most| most <= 4), "{report}");
    let file = read_glb(&folder.join("bar.glb"));
    let nodes = list(&file.json["nodes"]);
    let node = |name: &str| nodes.iter().position(|n| n["name"] == name).expect(name);
    let joints = list(&file.json["skins"][0]["joints"]);
    assert_eq!(joints.len(), 3);
    for (above, below) in [("skeleton", "trunk"), ("trunk", "arm"), ("arm", "hand")] {
        let children = &nodes[node(above)]["children"];
        assert_eq!(*children, serde_json::json!([node(below)]), "{below} hangs on {above}");
    }
    assert!(file.json.get("animations").is_none());
    let drawn = draw(&file, None, &[]).expect("a plain player draws it");
    let (rest, _) = shapes::box_with_cells(DVec3::new(6.0, 1.0, 1.0), [24, 4, 4]);
    for p in drawn.iter().flat_map(|d| &d.positions) {
        let near = rest.iter().any(|q| q.distance(*p) < 1e-5);
        assert!(near, "{p} is not a place of the bar");
    }
    assert_valid(folder.join("bar.glb"));
}

#[test]
fn more_than_four_joints_of_a_vertex_are_a_second_set() {
    let folder = &bar_folder();
    // Six short bones, so that several reach every vertex.
    let joint = |k: usize| format!(r#""{k}": [{}, 0.5, 0.5]"#, k as f64);
    let joints: Vec<String> = (0..7).map(joint).collect();
    let bone = |k: usize| {
        let parent = match k {
            0 => String::new(),
            _ => format!(r#""parent": "{}","#, k - 1),
        };
        format!(
            r#"{{"id": "{k}", "from": "{k}", "to": "{}", {parent} "joint": "x", "radius": 0.5}}"#,
            k + 1
        )
    };
    let bones: Vec<String> = (0..6).map(bone).collect();
    let rig = format!(
        r#"{{"version": 1, "joints": {{{}}}, "bones": [{}]}}"#,
        joints.join(","),
        bones.join(",")
    );
    folder.put("six.json", rig);
    for (most, sets) in [("1", 1), ("4", 1), ("8", 2)] {
        let name = format!("bar{most}.glb");
        skin(folder, &format!("bar.obj --rig six.json -o {name} --influences {most}")).well();
        let file = read_glb(&folder.join(&name));
        let attributes = &file.json["meshes"][0]["primitives"][0]["attributes"];
        assert_eq!(attributes.get("JOINTS_1").is_some(), sets == 2, "{most}: {attributes}");
        assert_eq!(attributes.get("WEIGHTS_1").is_some(), sets == 2, "{most}: {attributes}");
        assert_valid(folder.join(&name));
    }
}

#[test]
fn what_cannot_be_bound_is_refused_and_nothing_is_written() {
    let folder = &bar_folder();
    let cycle = RIG.replace(r#""id": "trunk", "#, r#""id": "trunk", "parent": "hand", "#);
    folder.put("cycle.json", cycle);
    for (arguments, reported) in [
        (
            "rig.json -o bar.glb --influences 9",
            "influences: are 9, allowed are 1 to 8",
        ),
        (
            "rig.json -o bar.glb --influences 0",
            "influences: are 0, allowed are 1 to 8",
        ),
        ("rig.json -o bar.obj", "use a .glb file name"),
        ("none.json -o bar.glb", "cannot read none.json"),
        ("rig.json -o far/bar.glb", "--parents makes it"),
        ("cycle.json -o bar.glb", "form a cycle"),
    ] {
        skin(folder, &format!("bar.obj --rig {arguments}")).refused(&[reported]);
    }
    assert!(!folder.join("bar.glb").exists());
    skin(folder, "bar.obj --rig rig.json -o far/bar.glb --parents").well();
    skin(folder, "bar.obj --rig rig.json -o far/bar.glb").refused(&["--force replaces it"]);
}

#[test]
fn a_man_of_many_parts_is_bound_whole() {
    let what = "a clothed man on a rig";
    let (Some(model), Some(rig)) = (
        data_path(what, "meshes/doorman.obj"),
        data_path(what, "../motion/rig_doorman_cmu.json"),
    ) else {
        return;
    };
    let folder = Workplace::empty();
    let out = folder.join("doorman.glb");
    let [model, rig, at] = [&model, &rig, &out].map(|p| p.to_str().expect("a path"));
    let report = folder.done(&["skin", model, "--rig", rig, "-o", at, "--json"]).json();
    assert_eq!((&report["unweighted"], &report["bones"]), (&0.into(), &19.into()));
    assert_valid(out);
}
