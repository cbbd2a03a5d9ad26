//! Merging what joints hold: an accessory with a skeleton of its own onto a model of the same joints, by jobs.

use crate::nodes::{at_rest, parsed, parsed_files, run};
use crate::support::avatar::avatar;
use crate::support::bench::largest_distance;
use crate::support::gltf_draft::Draft;
use crate::support::gltf_parsed::Parsed;
use crate::support::khronos;
use crate::support::skinning::{draw, list};
use base64::Engine as _;
use glam::DVec3;
use pliant::asset::FileSet;
use pliant::batch::BatchOutcome;
use serde_json::{Value, json};
use std::path::Path;

/// A tube around the head, made in centimetres under a scaled node, with joints of these names in a row: hips, head, brim. A
/// target makes it wider by 5 cm along x.
fn hat(names: [&str; 3]) -> Vec<u8> {
    let mut draft = Draft::default();
    let (mut places, mut weights, mut faces) = (Vec::new(), Vec::new(), Vec::new());
    for ring in 0..=6_u16 {
        let y = 170.0 + 5.0 * f32::from(ring);
        for k in 0..8_u16 {
            let angle = f32::from(k) * std::f32::consts::FRAC_PI_4;
            places.push([20.0 * angle.cos(), y, 20.0 * angle.sin()]);
            let brim = if ring < 2 { 0.5 } else { 0.0 };
            weights.push([1.0 - brim, brim, 0.0, 0.0]);
            if ring < 6 {
                let (a, b) = (8 * ring + k, 8 * ring + (k + 1) % 8);
                faces.extend([a, a + 8, b, b, a + 8, b + 8]);
            }
        }
    }
    let count = places.len();
    // Joints in another order than that of the body.
    let joints: Vec<u8> = places
        .iter()
        .flat_map(|p| [0, if p[1] < 180.0 { 2 } else { 0 }, 0, 0])
        .collect();
    let faces: Vec<u8> = faces.iter().flat_map(|v| v.to_le_bytes()).collect();
    let bind = |y: f32| {
        [
            1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -y, 0.0, 1.0,
        ]
    };
    let wide = vec![[5.0, 0.0, 0.0]; count];
    let primitive = json!({
        "attributes": {
            "POSITION": draft.floats(&places, "VEC3"), "WEIGHTS_0": draft.floats(&weights, "VEC4"),
            "JOINTS_0": draft.add(&joints, 5121, "VEC4", count, json!({})),
        },
        "indices": draft.add(&faces, 5123, "SCALAR", faces.len() / 2, json!({})),
        "targets": [{"POSITION": draft.floats(&wide, "VEC3")}], "material": 0,
    });
    let binds = draft.floats(&[bind(150.0), bind(90.0), bind(175.0)], "MAT4");
    let [hips, head, brim] = names;
    draft.glb(json!({
        "scene": 0, "scenes": [{"nodes": [0, 4]}], "materials": [{"name": "felt"}],
        "meshes": [{"primitives": [primitive], "extras": {"targetNames": ["wide"]}}],
        "skins": [{"joints": [2, 1, 3], "inverseBindMatrices": binds}],
        "nodes": [
            {"name": "armature", "scale": [0.01, 0.01, 0.01], "children": [1]},
            {"name": hips, "translation": [0, 90, 0], "children": [2]},
            {"name": head, "translation": [0, 60, 0], "children": [3]},
            {"name": brim, "translation": [0, 25, 0]},
            {"name": "hat", "mesh": 0, "skin": 0},
        ],
    }))
}

/// The body with the hat on, moved aside by 0.01, and a step after that.
fn merged(body: Vec<u8>, hat: &[u8], after: &[Value]) -> BatchOutcome {
    let hat = base64::engine::general_purpose::STANDARD.encode(hat);
    let merge = json!({"edit": {"merge": {"model": hat, "how": "LOOSE", "transform": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.01, 0, 0, 1]}}});
    let handles = json!([
        {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.5}}},
        {"id": "head", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": 1.55}}},
    ]);
    let steps = [&[merge], after].concat();
    run(
        FileSet::single("body.vrm", body),
        &json!({"handles": handles, "steps": steps}),
    )
}

/// What is drawn of the node of that name.
fn drawn(file: &Parsed, name: &str, weights: &[f64]) -> Vec<DVec3> {
    let own = |node: usize| file.json["nodes"][node]["name"] == name;
    let all = draw(file, None, weights).expect("plain");
    all.into_iter().find(|d| own(d.node)).expect("it is drawn").positions
}

/// The nodes of the joints of the hat.
fn joints(file: &Parsed) -> Vec<usize> {
    let nodes = list(&file.json["nodes"]);
    let hat = nodes
        .iter()
        .find(|n| n["name"] == "hat" && n["skin"].is_u64())
        .expect("a hat");
    let skin = &file.json["skins"][hat["skin"].as_u64().expect("a skin") as usize];
    list(&skin["joints"])
        .iter()
        .map(|j| j.as_u64().expect("a node") as usize)
        .collect()
}

fn codes(outcome: &BatchOutcome) -> Vec<&str> {
    outcome.written.warnings.iter().map(|w| w.code).collect()
}

fn store(outcome: &BatchOutcome, name: &str) -> std::path::PathBuf {
    let at = Path::new(env!("CARGO_TARGET_TMPDIR")).join("merged").join(name);
    khronos::store(&outcome.written, &at);
    at
}

#[test]
fn an_accessory_stands_where_it_stood_and_moves_with_the_joints_of_the_same_names() {
    let aside = |p: &DVec3| *p + DVec3::X * 0.01;
    let mut stored = Vec::new();
    for is_first in [true, false] {
        let source = hat(["hips", "head", "brim"]);
        let alone = parsed_files(&FileSet::single("hat.glb", source.clone()));
        let outcome = merged(avatar(is_first), &source, &[]);
        let file = parsed(&outcome);
        for weight in [0.0, 1.0] {
            let wanted: Vec<DVec3> = drawn(&alone, "hat", &[weight]).iter().map(aside).collect();
            assert!(
                largest_distance(&drawn(&file, "hat", &[weight]), &wanted) < 1e-6,
                "{weight}"
            );
        }
        assert_eq!(file.json["meshes"][1]["extras"]["targetNames"][0], "wide");
        // Head and hips are those of the body; the brim came along below the head, which is said.
        let [head, hips, brim] = joints(&file)[..] else {
            panic!("three joints")
        };
        assert_eq!(
            (head, hips, file.json["nodes"][brim]["name"].as_str()),
            (2, 1, Some("brim"))
        );
        assert!(list(&file.json["nodes"][2]["children"]).contains(&json!(brim)));
        let told = outcome
            .written
            .warnings
            .iter()
            .find(|w| w.code == "joints-added")
            .expect("a warning");
        assert!(
            told.message.contains("1 of 3 joints") && told.message.contains("brim"),
            "{}",
            told.message
        );
        assert!(!codes(&outcome).contains(&"left-out"), "{:?}", outcome.written.warnings);
        // The hat goes with the head.
        let mut turned = parsed(&outcome);
        turned.json["nodes"][2]["rotation"] = json!([0.6, 0.0, 0.0, 0.8]);
        let go = at_rest(&turned)[2] * at_rest(&file)[2].inverse();
        let wanted: Vec<DVec3> = drawn(&file, "hat", &[])
            .iter()
            .map(|p| go.transform_point3(*p))
            .collect();
        assert!(largest_distance(&drawn(&turned, "hat", &[]), &wanted) < 1e-5);
        // An avatar says something of each of its materials.
        if is_first {
            let properties = list(&file.json["extensions"]["VRM"]["materialProperties"]);
            assert_eq!((properties.len(), properties[1]["name"].as_str()), (2, Some("felt")));
        }
        stored.push(store(&outcome, &format!("{is_first}.glb")));

        // Posed after the merge, body and hat are drawn where the shape is.
        let up = json!({"pose": {"handles": [{"id": "head", "pose": {"translation": [0, 0.2, 0.05]}}]}});
        let outcome = merged(avatar(is_first), &hat(["hips", "head", "brim"]), &[up]);
        let file = parsed(&outcome);
        let seen = [drawn(&file, "body", &[]), drawn(&file, "hat", &[])].concat();
        assert!(largest_distance(&seen, &outcome.positions) < 1e-5);
        assert!(
            (at_rest(&file)[2].translation.y - 1.7).abs() < 0.05,
            "{}",
            at_rest(&file)[2].translation
        );
        stored.push(store(&outcome, &format!("{is_first} posed.glb")));
    }
    for (file, codes) in khronos::validate(&stored).unwrap_or_default() {
        let known = |code: &&String| {
            ["ACCESSOR_JOINTS_USED_ZERO_WEIGHT", "INVALID_EXTENSION_NAME_FORMAT"].contains(&code.as_str())
        };
        let others: Vec<_> = codes.iter().filter(|code| !known(code)).collect();
        assert!(others.is_empty(), "{}: {others:?}", file.display());
    }
}

#[test]
fn a_skeleton_of_other_names_comes_along_and_that_is_said() {
    let source = hat(["a", "b", "c"]);
    let alone = parsed_files(&FileSet::single("hat.glb", source.clone()));
    let outcome = merged(avatar(false), &source, &[]);
    let file = parsed(&outcome);
    let wanted: Vec<DVec3> = drawn(&alone, "hat", &[1.0])
        .iter()
        .map(|p| *p + DVec3::X * 0.01)
        .collect();
    assert!(largest_distance(&drawn(&file, "hat", &[1.0]), &wanted) < 1e-6);
    let names: Vec<&str> = joints(&file)
        .iter()
        .filter_map(|j| file.json["nodes"][*j]["name"].as_str())
        .collect();
    assert_eq!(names, ["b", "a", "c"]);
    assert!(
        codes(&outcome).contains(&"joints-added"),
        "{:?}",
        outcome.written.warnings
    );
    // Where the body has no skeleton, there is none that the joints should have been part of.
    let cube = crate::support::shapes::cube(1);
    let outcome = run(
        FileSet::single("cube.obj", crate::support::shapes::obj_text(&cube)),
        &json!({"steps": [{"edit": {"merge": {"model": base64::engine::general_purpose::STANDARD.encode(&source), "how": "LOOSE"}}}]}),
    );
    let told = outcome
        .written
        .warnings
        .iter()
        .find(|w| w.code == "left-out")
        .expect("a warning");
    assert!(told.message.contains("1 skin"), "{}", told.message);
}
