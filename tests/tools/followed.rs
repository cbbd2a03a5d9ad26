//! What the command line reports of skeletons, clips, morph targets and passengers that followed, and bones that keep their
//! lengths in a job.

use crate::support::commands::{Ran, Workplace};
use crate::support::data::data_folder;
use pliant::asset::sample;
use serde_json::{Value, json};

const FIGURE_PASSENGERS: [&str; 3] = ["lod1", "lod2", "hull"];

fn run(folder: &Workplace, model: &str, job: &Value, more: &str) -> Ran {
    folder.put("job.json", job.to_string());
    folder.run(&format!("deform {model} --job job.json -o out.glb --force {more}"))
}

/// What a job reports that followed, as numbers and as a line; both agree in being there.
fn followed(folder: &Workplace, model: &str, job: &Value) -> Option<(Value, String)> {
    let report = run(folder, model, job, "--json").exits(0).json();
    let said = run(folder, model, job, "").err;
    let line = said.lines().find_map(|line| line.strip_prefix("followed: "));
    assert_eq!(report["followed"].is_null(), line.is_none(), "{said}");
    line.map(|line| (report["followed"].clone(), line.to_owned()))
}

fn workplace() -> Workplace {
    let folder = Workplace::new();
    folder.put("figure.glb", sample::figure_glb());
    folder
}

/// The figure's head goes up by `up`, its feet stay; everything else rides along.
fn stretched_figure(up: f64) -> Value {
    json!({
        "create": {"passengers": FIGURE_PASSENGERS.map(|name| json!({"primitivesNamed": name}))},
        "handles": [
            {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.08}}},
            {"id": "head", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": 1.54}}}],
        "steps": [{"pose": {"handles": [{"id": "head", "pose": {"translation": [0, up, 0]}}]}}]
    })
}

fn nodes(folder: &Workplace, file: &str) -> Vec<Value> {
    let bytes = folder.bytes(file);
    let length = u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]) as usize;
    let json: Value = serde_json::from_slice(&bytes[20..20 + length]).expect("JSON");
    json["nodes"].as_array().expect("nodes").clone()
}

/// The figure's bones are the translations of joints below others.
fn bone(nodes: &[Value], name: &str) -> f64 {
    let node = nodes.iter().find(|node| node["name"] == name).expect(name);
    let parts = node["translation"].as_array().expect("a translation").iter();
    parts.map(|v| v.as_f64().expect("a number").powi(2)).sum::<f64>().sqrt()
}

#[test]
fn what_followed_of_the_figure_is_reported_in_numbers_and_in_a_line() {
    let folder = workplace();
    let (reply, line) = followed(&folder, "figure.glb", &stretched_figure(0.2)).expect("a report");
    let (joints, moved) = (17, reply["movedJoints"].as_u64().expect("a number"));
    assert!(reply["joints"] == joints && (10..=joints).contains(&moved), "{reply}");
    assert!(
        reply["clips"] == 2 && reply["rewrittenClips"] == 2 && reply["morphTargets"] == 0,
        "{reply}"
    );
    assert!(reply["passengers"] == 3 && reply["movedPassengers"] == 3, "{reply}");
    assert_eq!(
        line,
        format!("{moved} of {joints} joints, 2 of 2 clips, 3 of 3 passenger primitives")
    );
    // The head has gone farthest, and as far as its handle.
    let farthest = reply["farthest"].as_array().expect("a list");
    assert_eq!(farthest.len(), 8);
    let distances: Vec<f64> = farthest
        .iter()
        .map(|j| j["distance"].as_f64().expect("a number"))
        .collect();
    assert!(distances.is_sorted_by(|a, b| a >= b), "{distances:?}");
    let head = farthest.iter().find(|joint| joint["name"] == "head").expect("the head");
    assert!(
        (head["distance"].as_f64().expect("a number") - 0.2).abs() < 0.02,
        "{reply}"
    );
    let old = nodes(&folder, "figure.glb");
    let node = head["node"].as_u64().expect("an index") as usize;
    assert_eq!(old[node]["name"], "head");
}

#[test]
fn what_stays_is_reported_as_nothing_of_so_many() {
    let folder = workplace();
    let mut job = stretched_figure(0.2);
    job["create"]["rig"] = "KEEP".into();
    let (_, line) = followed(&folder, "figure.glb", &job).expect("a report");
    assert_eq!(line, "0 of 17 joints, 0 of 2 clips, 3 of 3 passenger primitives");
    let (reply, line) = followed(&folder, "figure.glb", &json!({})).expect("a report");
    assert_eq!(line, "0 of 17 joints, 0 of 2 clips");
    assert_eq!(reply["farthest"], json!([]));
}

#[test]
fn nodes_that_ride_along_are_counted_beside_primitives() {
    let folder = workplace();
    let mut job = stretched_figure(0.2);
    let riders = json!([{"primitivesNamed": "lod1"}, {"primitivesNamed": "lod2"}, {"primitivesNamed": "hull"},
        {"nodesNamed": "hatSocket"}]);
    job["create"]["passengers"] = riders.clone();
    let mentioned = |job: &Value| followed(&folder, "figure.glb", job).expect("a report");
    let (reply, line) = mentioned(&job);
    assert!(
        line.ends_with("3 of 3 passenger primitives, 1 of 1 passenger node"),
        "{line}"
    );
    assert!(
        reply["passengerNodes"] == 1 && reply["movedPassengerNodes"] == 1,
        "{reply}"
    );
    // After an edit as before it, and one that stays is counted as such.
    job["steps"].as_array_mut().expect("steps").push(json!({"edit":
        {"subdivide": {"region": {"halfSpace": {"normal": [0, 1, 0], "offset": 1.6}}}, "on": "CURRENT"}}));
    assert!(mentioned(&job).1.ends_with(", 1 of 1 passenger node"));
    let (reply, line) = mentioned(&json!({"create": {"passengers": riders}}));
    assert!(line.ends_with(", 0 of 1 passenger node"), "{line}");
    assert_eq!(reply["movedPassengerNodes"], 0);
}

#[test]
fn nothing_is_reported_of_a_model_without_anything_of_the_kind() {
    let folder = workplace();
    let job = json!({
        "handles": [
            {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.14}}},
            {"id": "head", "region": {"sphere": {"center": [0.76, 1.22, 0], "radius": 0.36}},
             "pose": {"rotationVector": [0, 0.8, 0]}}]});
    assert_eq!(followed(&folder, "creature.glb", &job), None);
}

#[test]
fn an_edited_figure_reports_what_followed_from_the_uploaded_file() {
    let folder = workplace();
    let plain = followed(&folder, "figure.glb", &stretched_figure(0.2))
        .expect("a report")
        .0;
    // The shape becomes the rest pose of an edit that takes nothing from what joints hold but some triangles.
    let mut job = stretched_figure(0.2);
    let edit = json!({"edit": {"subdivide": {"region": {"halfSpace": {"normal": [0, 1, 0], "offset": 1.6}}}, "on": "CURRENT"}});
    let steps = job["steps"].as_array_mut().expect("steps");
    steps.push(edit);
    let reply = followed(&folder, "figure.glb", &job).expect("a report").0;
    for same in [
        "joints",
        "movedJoints",
        "clips",
        "rewrittenClips",
        "passengers",
        "movedPassengers",
    ] {
        assert_eq!(reply[same], plain[same], "{same}");
    }
    let distance = |reply: &Value| reply["farthest"][0]["distance"].as_f64().expect("a number");
    assert!((distance(&reply) - distance(&plain)).abs() < 0.02, "{reply} {plain}");
}

#[test]
fn morph_targets_that_turned_are_counted_and_those_that_did_not() {
    let Some(data) = data_folder("counted morph targets") else {
        return;
    };
    let folder = workplace();
    let model = data.join("gltf/AnimatedMorphCube.glb");
    let model = model.to_str().expect("a path");
    let turned = |vector: [f64; 3]| {
        json!({"handles": [{"id": "all", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": -1e6}},
            "pose": {"rotationVector": vector, "translation": [1, 0, 0]}}]})
    };
    let line = |job: &Value| followed(&folder, model, job).expect("a report").1;
    assert_eq!(line(&turned([0.0, 0.5, 0.0])), "2 of 2 morph targets");
    assert_eq!(line(&turned([0.0; 3])), "0 of 2 morph targets");
    let mut edited = turned([0.0, 0.5, 0.0]);
    edited["steps"] = json!([{"pose": {}}, {"edit": {"subdivide": {}}}]);
    assert_eq!(line(&edited), "2 of 2 morph targets");
}

/// The lengths of two bones of the trunk, one of an arm, and three of a leg.
fn bones(nodes: &[Value]) -> [f64; 6] {
    [
        "spine",
        "chest",
        "leftLowerArm",
        "leftUpperLeg",
        "leftLowerLeg",
        "leftFoot",
    ]
    .map(|name| bone(nodes, name))
}

#[test]
fn a_job_keeps_the_lengths_of_all_bones_or_of_named_chains() {
    let folder = workplace();
    let lengths = |key: &str, value: Value| {
        let mut job = stretched_figure(0.3);
        job["create"][key] = value;
        run(&folder, "figure.glb", &job, "").exits(0);
        bones(&nodes(&folder, "out.glb"))
    };
    let old = bones(&nodes(&folder, "figure.glb"));
    let is_kept = |now: [f64; 6]| std::array::from_fn::<bool, 6, _>(|i| (now[i] - old[i]).abs() < 1e-6);
    assert_eq!(is_kept(lengths("boneLengths", "KEEP".into())), [true; 6]);
    let free = is_kept(lengths("boneLengths", "FOLLOW".into()));
    assert!(!free[0] && !free[1] && !free[4], "{free:?}");
    let legs = is_kept(lengths("rigidChains", json!(["leftUpperLeg"])));
    assert_eq!(legs[4..], [true; 2], "below the joint");
    assert_eq!(legs[..4], free[..4], "elsewhere");
}

#[test]
fn a_chain_that_is_not_there_is_refused_with_those_that_are() {
    let folder = workplace();
    for (model, create, reply) in [
        (
            "figure.glb",
            json!({"rigidChains": ["hips", "tail"]}),
            "rigidChains[1]: no joint is named \"tail\"; there are \"chest\"",
        ),
        (
            "figure.glb",
            json!({"rigidChains": ["body"]}),
            "no joint is named \"body\"",
        ),
        (
            "creature.glb",
            json!({"rigidChains": ["hips"]}),
            "the model has no joint with a name; boneLengths KEEP",
        ),
        (
            "figure.glb",
            json!({"boneLengths": "KEEP", "rigidChains": ["hips"]}),
            "leave one out",
        ),
    ] {
        run(&folder, model, &json!({"create": create}), "")
            .exits(2)
            .says(&[reply]);
    }
}
