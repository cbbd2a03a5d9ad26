//! Avatars (VRM): what they say in lengths follows the body, and joints are turned only where VRM allows it. An evaluator of its
//! own, written from the VRM specification, says where colliders and eyes are.

use crate::skins::{off_from_drawn, read_back};
use crate::support::avatar::avatar;
use crate::support::commands::Workplace;
use crate::support::data::data_bytes;
use crate::support::gltf_parsed::{Parsed, parse};
use crate::support::khronos;
use crate::support::skinning::{list, world_transforms};
use glam::DVec3;
use pliant::asset::{FileSet, Following, Format, Limits, Model, RigRule, WrittenFiles};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// What an avatar says in lengths, by its place in the file: points in the world, and lengths.
struct Measured {
    points: BTreeMap<String, DVec3>,
    lengths: BTreeMap<String, f64>,
}

impl Measured {
    fn of(file: &Parsed) -> Self {
        let world = world_transforms(file, None).expect("plain nodes");
        let mut all = Self {
            points: BTreeMap::new(),
            lengths: BTreeMap::new(),
        };
        let node = |value: &Value| value.as_u64().expect("a node") as usize;
        let mut point = |name: String, at: usize, lanes: [&Value; 3], sign: f64| {
            let [x, y, z] = lanes.map(|lane| lane.as_f64().expect("a number"));
            all.points
                .insert(name, world[at].transform_point3(DVec3::new(x, y, sign * z)));
        };
        let extensions = &file.json["extensions"];
        let vrm = &extensions["VRM"];
        let xyz = |v: &Value| -> [Value; 3] { ["x", "y", "z"].map(|lane| v[lane].clone()) };
        if vrm.is_object() {
            let bones = list(&vrm["humanoid"]["humanBones"]);
            let head = bones.iter().find(|bone| bone["bone"] == "head").expect("a head");
            let eyes = xyz(&vrm["firstPerson"]["firstPersonBoneOffset"]);
            point("eyes".into(), node(&head["node"]), eyes.each_ref(), -1.0);
        }
        let secondary = &vrm["secondaryAnimation"];
        for (g, group) in list(&secondary["colliderGroups"]).iter().enumerate() {
            for (c, collider) in list(&group["colliders"]).iter().enumerate() {
                point(
                    format!("collider {g} {c}"),
                    node(&group["node"]),
                    xyz(&collider["offset"]).each_ref(),
                    -1.0,
                );
                let radius = collider["radius"].as_f64().expect("a number");
                all.lengths.insert(format!("radius {g} {c}"), radius);
            }
        }
        for (g, group) in list(&secondary["boneGroups"]).iter().enumerate() {
            all.lengths
                .insert(format!("hit {g}"), group["hitRadius"].as_f64().expect("a number"));
        }
        let mut list_point = |name: String, at: usize, v: &Value| point(name, at, [&v[0], &v[1], &v[2]], 1.0);
        let core = &extensions["VRMC_vrm"];
        if core.is_object() {
            let head = node(&core["humanoid"]["humanBones"]["head"]["node"]);
            list_point("eyes".into(), head, &core["lookAt"]["offsetFromHeadBone"]);
        }
        let springs = &extensions["VRMC_springBone"];
        for (c, collider) in list(&springs["colliders"]).iter().enumerate() {
            for (kind, shape) in collider["shape"].as_object().expect("a shape") {
                for key in ["offset", "tail"].into_iter().filter(|key| !shape[*key].is_null()) {
                    list_point(format!("{kind} {c} {key}"), node(&collider["node"]), &shape[key]);
                }
                all.lengths
                    .insert(format!("radius {c}"), shape["radius"].as_f64().expect("a number"));
            }
        }
        for (s, spring) in list(&springs["springs"]).iter().enumerate() {
            for (j, joint) in list(&spring["joints"]).iter().enumerate() {
                if let Some(radius) = joint["hitRadius"].as_f64() {
                    all.lengths.insert(format!("hit {s} {j}"), radius);
                }
            }
        }
        all
    }

    fn check(&self, before: &Self, near: f64, point: impl Fn(DVec3) -> DVec3, growth: f64) {
        assert!(before.points.len() > 2 && before.lengths.len() > 2);
        for (name, was) in &before.points {
            let (seen, wanted) = (self.points[name], point(*was));
            assert!((seen - wanted).length() < near, "{name}: {seen} is not {wanted}");
        }
        for (name, was) in &before.lengths {
            let (seen, wanted) = (self.lengths[name], was * growth);
            assert!((seen - wanted).abs() < near * wanted, "{name}: {seen} is not {wanted}");
        }
    }
}

/// The nodes that an avatar calls bones of its body and of chains that swing.
fn bones(file: &Parsed) -> BTreeSet<usize> {
    let extensions = &file.json["extensions"];
    let mut nodes: Vec<Value> = (list(&extensions["VRM"]["humanoid"]["humanBones"]).iter())
        .map(|bone| bone["node"].clone())
        .collect();
    let named = extensions["VRMC_vrm"]["humanoid"]["humanBones"].as_object();
    nodes.extend(
        named
            .into_iter()
            .flat_map(|all| all.values())
            .map(|bone| bone["node"].clone()),
    );
    for spring in list(&extensions["VRMC_springBone"]["springs"]) {
        nodes.extend(list(&spring["joints"]).iter().map(|joint| joint["node"].clone()));
    }
    nodes
        .iter()
        .map(|node| node.as_u64().expect("a node") as usize)
        .collect()
}

fn avatars() -> Vec<(&'static str, Model, bool)> {
    let read =
        |bytes: Vec<u8>| Model::read(FileSet::single("person.vrm", bytes), None, &Limits::default()).expect("a model");
    let mut all = vec![
        ("VRM 0.x", read(avatar(true)), true),
        ("VRM 1.0", read(avatar(false)), false),
    ];
    if let Some(bytes) = data_bytes("field/person_vrm0.vrm") {
        all.push(("person", read(bytes), true));
    }
    all
}

fn parsed(model: &Model) -> Parsed {
    parse(&model.files.main, &BTreeMap::new())
}

fn written_with(model: &Model, rig: RigRule, move_to: impl Fn(DVec3) -> DVec3) -> WrittenFiles {
    let following = Following {
        rig,
        ..Following::default()
    };
    let positions: Vec<DVec3> = model.positions.iter().map(|p| move_to(*p)).collect();
    let written = model
        .write_following(&positions, Format::GLB, following)
        .expect("writable");
    let (again, file) = read_back(&written, Format::GLB);
    let off = off_from_drawn(&positions, &again, &file).expect("plain");
    assert!(off < 1e-5, "drawn {off} beside the shape");
    written
}

/// Nodes without a rotation and a scale other than those that they had.
fn check_turns(name: &str, before: &Parsed, after: &Parsed) {
    for (was, is) in list(&before.json["nodes"]).iter().zip(list(&after.json["nodes"])) {
        assert_eq!(
            (&was["rotation"], &was["scale"]),
            (&is["rotation"], &is["scale"]),
            "{name}: {}",
            was["name"]
        );
        assert!(is["matrix"].is_null(), "{name}");
    }
}

/// An avatar without what is measured: who binds what, gravity, constraints.
fn others(file: &Parsed) -> Value {
    fn strip(value: &mut Value) {
        const MEASURES: [&str; 6] = [
            "offset",
            "tail",
            "radius",
            "hitRadius",
            "firstPersonBoneOffset",
            "offsetFromHeadBone",
        ];
        match value {
            Value::Object(members) => {
                members.retain(|key, _| !MEASURES.contains(&key.as_str()));
                members.values_mut().for_each(strip);
            }
            Value::Array(items) => items.iter_mut().for_each(strip),
            _ => {}
        }
    }
    let mut all = json!([
        file.json["extensions"],
        list(&file.json["nodes"])
            .iter()
            .map(|n| n["extensions"].clone())
            .collect::<Vec<_>>(),
        list(&file.json["meshes"])
            .iter()
            .map(|m| m["extras"].clone())
            .collect::<Vec<_>>()
    ]);
    strip(&mut all);
    all
}

#[test]
fn what_an_avatar_says_in_lengths_grows_with_it() {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("avatars");
    let mut stored = Vec::new();
    for (name, model, is_first) in avatars() {
        let before = parsed(&model);
        let written = written_with(&model, RigRule::Follow, |p| p * 1.5);
        assert!(written.warnings.is_empty(), "{name}: {:?}", written.warnings);
        let (_, after) = read_back(&written, Format::GLB);
        Measured::of(&after).check(&Measured::of(&before), 1e-5, |p| p * 1.5, 1.5);
        assert_eq!(others(&before), others(&after), "{name}");
        if is_first {
            check_turns(name, &before, &after);
        }
        let [was, is] = [&before, &after].map(|file| world_transforms(file, None).expect("plain nodes"));
        for bone in bones(&before) {
            // Joints of skins and others alike.
            let off = is[bone].translation.distance(1.5 * was[bone].translation);
            assert!(off < 1e-4, "{name}: bone {bone} is {off} beside the body");
        }
        let pair = ["before", "after"].map(|which| folder.join(format!("{name} {which}.glb")));
        khronos::store(
            &WrittenFiles {
                main: model.files.main.to_vec(),
                ..WrittenFiles::default()
            },
            &pair[0],
        );
        khronos::store(&written, &pair[1]);
        let [was, is] = pair;
        stored.push((is, was));
        // With joints as they are stored lengths stay too, which is said.
        let kept = written_with(&model, RigRule::Keep, |p| p * 1.5);
        let (_, after) = read_back(&kept, Format::GLB);
        assert_eq!(before.json["extensions"], after.json["extensions"], "{name}");
        assert!(kept.warnings.iter().any(|w| w.code == "extension-kept"), "{name}");
    }
    khronos::assert_nothing_new("avatars", &stored);
}

#[test]
fn a_taller_avatar_has_its_colliders_and_eyes_where_they_were_in_the_body() {
    for (name, model, is_first) in avatars() {
        let before = parsed(&model);
        // The head goes up as it is, the trunk is stretched, the legs stay.
        let taller = |p: DVec3| p + DVec3::Y * (0.2 * ((p.y - 0.9) / 0.5).clamp(0.0, 1.0));
        let written = written_with(&model, RigRule::Follow, taller);
        let (_, after) = read_back(&written, Format::GLB);
        if is_first {
            check_turns(name, &before, &after);
        }
        assert_eq!(others(&before), others(&after), "{name}");
        let (was, is) = (Measured::of(&before), Measured::of(&after));
        for (place, old) in &was.points {
            let (new, wanted) = (is.points[place], taller(*old));
            assert!(
                (new - wanted).length() < 0.02,
                "{name}, {place}: {old} to {new}, not {wanted}"
            );
        }
        assert!(
            (is.points["eyes"] - was.points["eyes"] - DVec3::Y * 0.2).length() < 0.01,
            "{name}"
        );
        for (place, old) in &was.lengths {
            let growth = is.lengths[place] / old;
            assert!((0.99..1.4).contains(&growth), "{name}, {place}: {growth}");
        }
    }
}

#[test]
fn joints_of_any_model_move_and_do_not_turn_where_that_is_chosen() {
    let read = Model::read(FileSet::single("column.glb", avatar(false)), None, &Limits::default()).expect("a model");
    let before = parsed(&read);
    let bend = |p: DVec3| glam::DQuat::from_rotation_x(0.3 * (p.y - 0.9).max(0.0)) * p;
    let turned = read_back(&written_with(&read, RigRule::Follow, bend), Format::GLB).1;
    assert_ne!(before.json["nodes"][2]["rotation"], turned.json["nodes"][2]["rotation"]);
    let moved = read_back(&written_with(&read, RigRule::Move, bend), Format::GLB).1;
    check_turns("moved", &before, &moved);
    let [a, b] = [&turned, &moved].map(|file| world_transforms(file, None).expect("plain")[2].translation);
    assert!((a - b).length() < 1e-5 && (a.y - 1.5).abs() > 0.01, "{a} {b}");
}

#[test]
fn an_avatar_comes_and_goes_by_its_own_name() {
    let folder = Workplace::empty();
    folder.put("person.vrm", avatar(true));
    let job = json!({
        "handles": [
            {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.5}}},
            {"id": "head", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": 1.55}}},
        ],
        "steps": [{"pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0, 0, 0.2], "translation": [0, 0.2, 0]}}]}}],
    });
    for (name, rig) in [("plain", "FOLLOW"), ("moved", "MOVE")] {
        let mut job = job.clone();
        job["create"] = json!({"rig": rig, "format": "vrm"});
        folder.put("job.json", job.to_string());
        folder.done(&format!("deform person.vrm --job job.json -o {name}.vrm"));
        let written = folder.bytes(&format!("{name}.vrm"));
        let file = parse(&written, &BTreeMap::new());
        assert!(
            file.json["nodes"][2]["rotation"].is_null() && file.json["nodes"][2]["scale"].is_null(),
            "{rig}"
        );
        let head = world_transforms(&file, None).expect("plain")[2].translation;
        assert!(head.y > 1.6, "{head}");
    }
}
