//! Avatars as web pages read them, with three-vrm: bones, colliders, eyes and expressions are where VRM says.

use crate::node::install;
use crate::support::avatar::avatar;
use crate::support::commands::Workplace;
use crate::support::process::{said, show};
use glam::DVec3;
use serde_json::{Value, json};
use std::process::Command;

const PACKAGE: &str = "tests/clients/avatars";

/// The bones that VRM asks for beside hips and head, each with where it is from the hips.
const LIMBS: [(&str, [f64; 3]); 13] = [
    ("spine", [0.0, 0.2, 0.0]),
    ("leftUpperLeg", [0.1, -0.1, 0.0]),
    ("leftLowerLeg", [0.1, -0.4, 0.0]),
    ("leftFoot", [0.1, -0.8, 0.0]),
    ("rightUpperLeg", [-0.1, -0.1, 0.0]),
    ("rightLowerLeg", [-0.1, -0.4, 0.0]),
    ("rightFoot", [-0.1, -0.8, 0.0]),
    ("leftUpperArm", [0.1, 0.4, 0.0]),
    ("leftLowerArm", [0.1, 0.3, 0.0]),
    ("leftHand", [0.1, 0.1, 0.0]),
    ("rightUpperArm", [-0.1, 0.4, 0.0]),
    ("rightLowerArm", [-0.1, 0.3, 0.0]),
    ("rightHand", [-0.1, 0.1, 0.0]),
];

/// An avatar with all bones that VRM asks for.
fn whole_avatar(is_first: bool) -> Vec<u8> {
    let glb = avatar(is_first);
    let size = |at: usize| u32::from_le_bytes([glb[at], glb[at + 1], glb[at + 2], glb[at + 3]]) as usize;
    let (json_bytes, rest) = glb[20..].split_at(size(12));
    let mut document: Value = serde_json::from_slice(json_bytes).expect("JSON");
    for (name, at) in LIMBS {
        let nodes = document["nodes"].as_array_mut().expect("nodes");
        let node = nodes.len();
        nodes.push(json!({"name": name, "translation": at}));
        nodes[1]["children"].as_array_mut().expect("children").push(json!(node));
        let extensions = &mut document["extensions"];
        match is_first {
            true => {
                let bones = extensions["VRM"]["humanoid"]["humanBones"]
                    .as_array_mut()
                    .expect("bones");
                bones.push(json!({"bone": name, "node": node}));
            }
            false => extensions["VRMC_vrm"]["humanoid"]["humanBones"][name] = json!({"node": node}),
        }
    }
    // three-vrm reads no avatar without these.
    document["extensions"][if is_first { "VRM" } else { "VRMC_vrm" }]["meta"] = json!({
        "title": "column", "name": "column", "authors": ["pliant"], "licenseUrl": "https://vrm.dev/licenses/1.0/",
    });
    if is_first {
        // three-vrm refuses hair whose colliders are on the bone that it moves.
        document["extensions"]["VRM"]["secondaryAnimation"]["boneGroups"][0]["bones"] = json!([3]);
    } else {
        let springs = &mut document["extensions"]["VRMC_springBone"];
        springs["colliderGroups"] = json!([{"colliders": [1]}]);
        springs["springs"][0]["colliderGroups"] = json!([0]);
    }
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut file = glb[..8].to_vec();
    file.extend((20 + text.len() as u32 + rest.len() as u32).to_le_bytes());
    file.extend((text.len() as u32).to_le_bytes());
    file.extend(b"JSON");
    file.extend(text);
    file.extend(rest);
    file
}

/// What three-vrm finds in files of a folder.
fn read(folder: &Workplace, names: &[&str]) -> Vec<Value> {
    let mut node = Command::new("node");
    node.arg(
        std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
            .join(PACKAGE)
            .join("read.mjs"),
    )
    .args(names.iter().map(|name| folder.at(name)));
    let done = node.output().expect("node runs");
    assert!(done.status.success(), "{}", said(&done));
    // Warnings of the library come before the last line.
    let text = String::from_utf8_lossy(&done.stdout);
    serde_json::from_str(text.trim().lines().last().unwrap_or_default())
        .unwrap_or_else(|e| panic!("{e}: {}", said(&done)))
}

fn point(value: &Value) -> DVec3 {
    let list: Vec<f64> = value
        .as_array()
        .expect("three numbers")
        .iter()
        .filter_map(Value::as_f64)
        .collect();
    DVec3::from_slice(&list)
}

/// Places of hips, head and colliders, and lengths: the distance of the eyes from the head's joint, and radii.
fn measured(found: &Value) -> (Vec<DVec3>, Vec<f64>) {
    // The limbs are no joints of the skin, and hang on the hips as they did.
    let bones = ["hips", "head"].map(|name| point(&found["bones"][name])).into_iter();
    let colliders = found["colliders"].as_array().expect("colliders");
    let places = bones.chain(colliders.iter().map(|collider| point(&collider["at"])));
    let radii = colliders
        .iter()
        .map(|collider| collider["radius"].as_f64().expect("a radius"));
    let offsets = colliders.iter().map(|collider| point(&collider["offset"]).length());
    let eyes = point(&found["eyes"]).length();
    (places.collect(), radii.chain(offsets).chain([eyes]).collect())
}

#[test]
#[ignore = "fetches packages; .ci/run runs it"]
fn three_vrm_finds_everything_of_an_avatar_where_the_body_is() {
    if let Err(reason) = install(PACKAGE) {
        return show(&format!("SKIPPED: {PACKAGE}: {reason}"));
    }
    let folder = Workplace::empty();
    let job = |pose: Value| {
        json!({"create": {"rig": "MOVE"},
            "handles": [{"id": "all", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": -9}}, "pose": pose}]})
    };
    folder.put(
        "larger.json",
        job(json!({"scale": [1.5], "pivot": [0, 0, 0]})).to_string(),
    );
    let taller = json!({"create": {"rig": "MOVE"}, "handles": [
        {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.3}}},
        {"id": "head", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": 1.4}}, "pose": {"translation": [0, 0.2, 0]}}]});
    folder.put("taller.json", taller.to_string());
    for (is_first, version, smile) in [(true, "0", "happy"), (false, "1", "happy")] {
        folder.put("rest.vrm", whole_avatar(is_first));
        for name in ["larger", "taller"] {
            folder.done(&format!("deform rest.vrm --job {name}.json -o {name}.vrm --force"));
        }
        let found = read(&folder, &["rest.vrm", "larger.vrm", "taller.vrm"]);
        for file in &found {
            assert_eq!(file["version"], version);
            assert_eq!(file["expressions"], found[0]["expressions"]);
            assert_eq!(file["springs"], found[0]["springs"]);
            let expressions = file["expressions"].as_array().expect("expressions");
            assert!(expressions.contains(&json!(smile)), "{file}");
        }
        assert!(found[0]["springs"].as_u64() >= Some(1));
        let [rest, larger, taller] = [0, 1, 2].map(|k| measured(&found[k]));
        assert!(rest.0.len() >= 3 && rest.1.len() >= 3, "{}", found[0]);
        for (was, now) in rest.0.iter().zip(&larger.0) {
            assert!((*was * 1.5).distance(*now) < 1e-4, "{was} {now}");
        }
        for (was, now) in rest.1.iter().zip(&larger.1) {
            assert!((was * 1.5 - now).abs() < 1e-3 * now, "{was} {now}");
        }
        // The head goes up with its collider, and keeps its size; the hip between stays between.
        let head = point(&found[2]["bones"]["head"]) - point(&found[0]["bones"]["head"]);
        assert!(head.distance(DVec3::new(0.0, 0.2, 0.0)) < 0.01, "{head}");
        let hips = point(&found[2]["bones"]["hips"]) - point(&found[0]["bones"]["hips"]);
        assert!(hips.y > 0.02 && hips.y < 0.18, "{hips}");
        let on_head = taller.0[taller.0.len() - 2] - rest.0[rest.0.len() - 2];
        assert!(on_head.distance(DVec3::new(0.0, 0.2, 0.0)) < 0.01, "{on_head}");
    }
}
