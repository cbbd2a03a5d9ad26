//! `pliant skin` as a script sees it.

use crate::support::data::{data_path, tell_skipped};
use crate::support::gltf_parsed::{Parsed, parse};
use crate::support::khronos;
use crate::support::skinning::draw;
use glam::DVec3;
use pliant::asset::shapes;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

const RIG: &str = r#"{"version": 1, "joints": {"a": [0.2, 0.5, 0.5], "b": [2, 0.5, 0.5], "c": [4, 0.5, 0.5], "d": [5.8, 0.5, 0.5]}, "bones": [
    {"id": "hand", "from": "c", "to": "d", "parent": "arm", "joint": "hand", "radius": 0.5},
    {"id": "trunk", "from": "a", "to": "b", "joint": "trunk", "radius": 0.5},
    {"id": "arm", "from": "b", "to": "c", "parent": "trunk", "joint": "arm", "radius": 0.5}]}"#;

/// A bar of 6 by 1 by 1 and a rig of three bones along it, one on the other.
fn make_bar(folder: &Path) {
    let (positions, triangles) = shapes::box_with_cells(DVec3::new(6.0, 1.0, 1.0), [24, 4, 4]);
    let mut text = String::new();
    for p in &positions {
        writeln!(text, "v {} {} {}", p.x, p.y, p.z).expect("text");
    }
    for t in &triangles {
        writeln!(text, "f {} {} {}", t[0] + 1, t[1] + 1, t[2] + 1).expect("text");
    }
    fs::write(folder.join("bar.obj"), text).expect("written");
    fs::write(folder.join("rig.json"), RIG).expect("written");
}

fn skin(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pliant"))
        .arg("skin")
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("it runs")
}

fn read_glb(path: &Path) -> Parsed {
    parse(&fs::read(path).expect("a file"), &BTreeMap::new())
}

fn assert_valid(file: &Path) {
    match khronos::validate(&[file.to_owned()]) {
        Some(findings) => assert!(findings[file].is_empty(), "{:?}", findings[file]),
        None => tell_skipped("bound models by the validator", "it cannot be had"),
    }
}

#[test]
fn joints_hang_on_each_other_as_the_bones_do_and_stand_where_the_model_is() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    make_bar(folder);
    let done = skin(folder, &["bar.obj", "--rig", "rig.json", "-o", "bar.glb", "--json"]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let report: Value = serde_json::from_slice(&done.stdout).expect("one document");
    assert_eq!((&report["unweighted"], &report["bones"]), (&0.into(), &3.into()));
    assert!(report["influences"].as_u64().is_some_and(|most| most <= 4), "{report}");
    let file = read_glb(&folder.join("bar.glb"));
    let nodes = file.json["nodes"].as_array().expect("nodes");
    let joints = file.json["skins"][0]["joints"].as_array().expect("joints");
    let node = |name: &str| nodes.iter().position(|n| n["name"] == name).expect(name);
    assert_eq!(joints.len(), 3);
    for (above, below) in [("skeleton", "trunk"), ("trunk", "arm"), ("arm", "hand")] {
        let children: Vec<u64> = nodes[node(above)]["children"]
            .as_array()
            .expect("children")
            .iter()
            .filter_map(Value::as_u64)
            .collect();
        assert_eq!(children, [node(below) as u64], "{below} hangs on {above}");
    }
    assert!(file.json.get("animations").is_none());
    let drawn: Vec<DVec3> = draw(&file, None, &[])
        .expect("a plain player draws it")
        .into_iter()
        .flat_map(|d| d.positions)
        .collect();
    let (rest, _) = shapes::box_with_cells(DVec3::new(6.0, 1.0, 1.0), [24, 4, 4]);
    for p in &drawn {
        assert!(
            rest.iter().any(|q| q.distance(*p) < 1e-5),
            "{p} is not a place of the bar"
        );
    }
    assert_valid(&folder.join("bar.glb"));
}

#[test]
fn more_than_four_joints_of_a_vertex_are_a_second_set() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    make_bar(folder);
    // Six short bones, so that several reach every vertex.
    let joint = |k: usize| format!(r#""{k}": [{}, 0.5, 0.5]"#, k as f64);
    let joints: Vec<String> = (0..7).map(joint).collect();
    let bone = |k: usize| {
        let parent = if k > 0 {
            format!(r#""parent": "{}","#, k - 1)
        } else {
            String::new()
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
    fs::write(folder.join("six.json"), rig).expect("written");
    for (most, sets) in [("1", 1), ("4", 1), ("8", 2)] {
        let name = format!("bar{most}.glb");
        let done = skin(
            folder,
            &["bar.obj", "--rig", "six.json", "-o", &name, "--influences", most],
        );
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let file = read_glb(&folder.join(&name));
        let attributes = &file.json["meshes"][0]["primitives"][0]["attributes"];
        assert_eq!(attributes.get("JOINTS_1").is_some(), sets == 2, "{most}: {attributes}");
        assert_eq!(attributes.get("WEIGHTS_1").is_some(), sets == 2, "{most}: {attributes}");
        assert_valid(&folder.join(&name));
    }
}

#[test]
fn what_cannot_be_bound_is_refused_and_nothing_is_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    make_bar(folder);
    let refused = |arguments: &[&str], told: &str| {
        let done = skin(folder, arguments);
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        let last = said.lines().last().unwrap_or_default();
        assert_eq!(done.status.code(), Some(2), "{said}");
        assert!(last.contains(told), "{last}");
    };
    refused(
        &["bar.obj", "--rig", "rig.json", "-o", "bar.glb", "--influences", "9"],
        "influences: are 9, allowed are 1 to 8",
    );
    refused(
        &["bar.obj", "--rig", "rig.json", "-o", "bar.glb", "--influences", "0"],
        "influences: are 0, allowed are 1 to 8",
    );
    refused(
        &["bar.obj", "--rig", "rig.json", "-o", "bar.obj"],
        "use a .glb file name",
    );
    refused(
        &["bar.obj", "--rig", "none.json", "-o", "bar.glb"],
        "cannot read none.json",
    );
    refused(
        &["bar.obj", "--rig", "rig.json", "-o", "far/bar.glb"],
        "--parents makes it",
    );
    fs::write(
        folder.join("cycle.json"),
        RIG.replace(r#""id": "trunk", "#, r#""id": "trunk", "parent": "hand", "#),
    )
    .expect("written");
    refused(&["bar.obj", "--rig", "cycle.json", "-o", "bar.glb"], "form a cycle");
    assert!(!folder.join("bar.glb").exists());
    let done = skin(
        folder,
        &["bar.obj", "--rig", "rig.json", "-o", "far/bar.glb", "--parents"],
    );
    assert!(done.status.success());
    refused(
        &["bar.obj", "--rig", "rig.json", "-o", "far/bar.glb"],
        "--force replaces it",
    );
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
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("doorman.glb");
    let [model, rig, at] = [&model, &rig, &out].map(|p| p.to_str().expect("a path"));
    let done = skin(folder.path(), &[model, "--rig", rig, "-o", at, "--json"]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let report: Value = serde_json::from_slice(&done.stdout).expect("one document");
    assert_eq!((&report["unweighted"], &report["bones"]), (&0.into(), &19.into()));
    assert_valid(&out);
}
