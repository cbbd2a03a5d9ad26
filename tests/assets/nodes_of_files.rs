//! Nodes that ride along in models of others: the built-in figure, files of the data folder, an FBX.

use crate::nodes::{at_rest, frames, off, parsed, parsed_files, run, try_run, turn_of};
use crate::support::bench::pool;
use crate::support::data::data_path;
use crate::support::gltf_sets;
use crate::support::skinning::draw;
use glam::DVec3;
use pliant::asset::{FileSet, Format, sample};
use pliant::engine::DeformerLimits;
use pliant::exec::Exec;
use pliant::progress::Silent;
use pliant::wire::pb;
use serde_json::{Value, json};

#[test]
fn a_socket_below_a_joint_follows_the_flesh_and_joints_that_stay_do_so_under_a_node_that_goes() {
    let figure = FileSet::single("figure.glb", sample::figure_glb());
    let job = |rig: &str| {
        json!({
            "create": {"rig": rig, "passengers": [{"nodesNamed": "hatSocket"}]},
            "handles": [
                {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.3}}},
                {"id": "head", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": 1.54}}},
            ],
            "steps": [{"pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0.3, 0.6, 0], "translation": [0.1, 0.1, 0]}}]}}],
        })
    };
    let source = parsed_files(&figure);
    let socket = (source.json["nodes"].as_array().into_iter().flatten()).position(|n| n["name"] == "hatSocket");
    let socket = socket.expect("a socket");
    for rig in ["FOLLOW", "KEEP"] {
        let outcome = run(figure.clone(), &job(rig));
        let file = parsed(&outcome);
        let (before, after) = (at_rest(&source), at_rest(&file));
        let (place, _) = frames(&outcome.report.passengers[0])[0];
        assert!(after[socket].translation.distance(place) < 1e-5, "{rig}");
        assert!(before[socket].translation.distance(place) > 0.05, "{rig}");
        let joints = source.json["skins"][0]["joints"].as_array().expect("joints");
        let joints = joints.iter().filter_map(Value::as_u64).map(|j| j as usize);
        let moved = joints.map(|j| off(&before[j], &after[j])).fold(0.0, f64::max);
        assert_eq!(moved == 0.0, rig == "KEEP", "{moved}");
    }

    // A skeleton under a node of its own, which rides along while the joints stay.
    let mut glb = source.json.clone();
    let roots = glb["scenes"][0]["nodes"].as_array().expect("roots").clone();
    let nodes = glb["nodes"].as_array_mut().expect("nodes");
    let armature = nodes.len();
    nodes.push(json!({"name": "armature", "translation": [0, 1.6, 0]}));
    let is_hips = |n: &Value| n.as_u64() == Some(0);
    let others: Vec<Value> = roots
        .iter()
        .filter(|n| !is_hips(n))
        .cloned()
        .chain([json!(armature)])
        .collect();
    nodes[armature]["children"] = json!([0]);
    let hips = nodes[0]["translation"].as_array().expect("a place").clone();
    nodes[0]["translation"][1] = json!(hips[1].as_f64().expect("a number") - 1.6);
    glb["scenes"][0]["nodes"] = json!(others);
    glb["buffers"][0]["uri"] = json!("figure.bin");
    let mut files = FileSet::single("figure.gltf", glb.to_string());
    files
        .companions
        .insert("figure.bin".into(), source.buffers[0].clone().into());
    for rig in ["FOLLOW", "KEEP"] {
        let mut job = job(rig);
        job["create"]["passengers"] = json!([{"nodesNamed": "armature"}]);
        let outcome = run(files.clone(), &job);
        let file = parsed(&outcome);
        let (before, after) = (at_rest(&parsed_files(&files)), at_rest(&file));
        assert!(off(&before[armature], &after[armature]) > 0.05, "{rig}");
        if rig == "KEEP" {
            assert!(off(&before[0], &after[0]) < 1e-6, "{:?} {:?}", before[0], after[0]);
        }
        let drawn = draw(&file, None, &[]).expect("drawn");
        let body = drawn.iter().find(|d| d.node == 19).expect("the body");
        for (seen, solved) in body.positions.iter().zip(outcome.positions.iter()) {
            assert!(seen.distance(*solved) < 1e-5, "{rig}: {seen} {solved}");
        }
    }
}

#[test]
fn cameras_of_real_models_ride_along() {
    let Some(folder) = data_path("cameras of real models", "gltf") else {
        return;
    };
    let mut tried = 0;
    for path in gltf_sets::gltf_files(&folder) {
        let name = path.file_name().expect("a file").to_string_lossy().into_owned();
        if !(name.starts_with("Duck") || name.starts_with("2Cylinder")) {
            continue;
        }
        let files = gltf_sets::file_set(&path);
        let source = parsed_files(&files);
        let nodes = source.json["nodes"].as_array().cloned().unwrap_or_default();
        let Some(camera) = nodes.iter().position(|n| n.get("camera").is_some()) else {
            continue;
        };
        tried += 1;
        let found = pliant::batch::inspect(
            files.clone(),
            &pb::CreateOptions::default(),
            &DeformerLimits::default(),
            &Exec::new(&pool(2), &Silent),
        );
        let (found, _) = found.expect("inspected");
        assert_eq!(
            found.nodes[camera].position,
            at_rest(&source)[camera].translation.to_array().to_vec()
        );
        let height = |t: f64| found.box_min[1] + t * (found.box_max[1] - found.box_min[1]);
        let job = json!({
            "create": {"passengers": [{"node": camera}], "volumeGraph": {"mode": "OFF"}},
            "handles": [
                {"id": "low", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -height(0.1)}}},
                {"id": "high", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": height(0.8)}}},
            ],
            "steps": [{"pose": {"handles": [{"id": "high", "pose": {"rotationVector": [0.3, 0.5, 0]}}]}}],
        });
        let outcome = run(files, &job);
        let file = parsed(&outcome);
        let (place, turn) = frames(&outcome.report.passengers[0])[0];
        let after = at_rest(&file)[camera];
        let size = DVec3::from_slice(&found.box_max).distance(DVec3::from_slice(&found.box_min));
        assert!(
            after.translation.distance(place) < 1e-6 * size.max(place.length()),
            "{name}"
        );
        let turned = turn_of(&after);
        let apart = (turned - turn).length().min((turned + turn).length());
        assert!(apart < 1e-6, "{name}: {turned} {turn}");
        assert!(
            at_rest(&source)[camera].translation.distance(place) > 1e-3 * size,
            "{name}: it moves"
        );
        // A mesh that several nodes draw has parted.
        let but_mesh = |node: &Value| {
            let mut node = node.clone();
            node.as_object_mut().map(|members| members.remove("mesh"));
            node
        };
        let changed = (0..nodes.len()).filter(|&n| but_mesh(&file.json["nodes"][n]) != but_mesh(&nodes[n]));
        assert_eq!(changed.collect::<Vec<_>>(), [camera], "{name}");
    }
    assert!(tried >= 4, "{tried}");
}

#[test]
fn nodes_of_an_fbx_ride_along_where_the_result_has_nodes() {
    let files = || FileSet::single("cube.fbx", crate::support::fbx_text::cube().text().into_bytes());
    let found = pliant::batch::inspect(
        files(),
        &pb::CreateOptions::default(),
        &DeformerLimits::default(),
        &Exec::new(&pool(2), &Silent),
    );
    let (found, _) = found.expect("inspected");
    let node = found.primitives[0].node;
    let job = json!({
        "create": {"passengers": [{"node": node}]},
        "handles": [
            {"id": "low", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.6}}},
            {"id": "high", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": 2.4}}},
        ],
        "steps": [{"pose": {"handles": [{"id": "low", "pose": {"rotationVector": [0, 0.4, 0], "translation": [0.5, 0.2, 0]}}]}}],
    });
    let outcome = try_run(files(), &job, Some(Format::GLB)).expect("the job runs");
    let file = parsed(&outcome);
    let (place, _) = frames(&outcome.report.passengers[0])[0];
    let after = at_rest(&file)[node as usize];
    assert!(after.translation.distance(place) < 3e-6);
    let before = DVec3::from_slice(&found.nodes[node as usize].position);
    assert!(place.distance(before) > 0.1, "{place} {before}");
    // The mesh hangs on that node, and is drawn where it was solved.
    let drawn = draw(&file, None, &[]).expect("drawn");
    for (seen, solved) in drawn[0].positions.iter().zip(outcome.positions.iter()) {
        assert!(seen.distance(*solved) < 3e-6, "{seen} {solved}");
    }
    // A format without nodes is written all the same, and the report has the place.
    let plain = try_run(files(), &job, Some(Format::OBJ)).expect("the job runs");
    assert_eq!(plain.report.passengers, outcome.report.passengers);
    assert!(plain.written.main.starts_with(b"#") || plain.written.main.contains(&b'v'));
}

#[test]
fn a_mesh_on_a_node_that_goes_is_drawn_and_shaded_as_on_one_that_stays() {
    let Some(path) = data_path("a mesh on a node that goes", "gltf/Duck.glb") else {
        return;
    };
    let files = gltf_sets::file_set(&path);
    let job = |passengers: Value| {
        json!({
            "create": {"passengers": passengers, "volumeGraph": {"mode": "OFF"}},
            "handles": [
                {"id": "low", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.3}}},
                {"id": "high", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": 1.3}}},
            ],
            "steps": [{"pose": {"handles": [
                {"id": "high", "pose": {"rotationVector": [0.3, 0.5, 0]}},
                {"id": "low", "pose": {"rotationVector": [0, -0.7, 0], "translation": [0.2, 0, 0]}},
            ]}}],
        })
    };
    let seen = |passengers: Value| {
        let file = parsed(&run(files.clone(), &job(passengers)));
        let drawn = draw(&file, None, &[]).expect("drawn").remove(0);
        let world = at_rest(&file)[drawn.node].matrix3;
        let normal = &file.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"];
        let normals = crate::support::skinning::numbers(&file, normal).expect("normals");
        let normals = normals
            .chunks_exact(3)
            .map(|n| (world * DVec3::from_slice(n)).normalize());
        (drawn.positions, normals.collect::<Vec<_>>(), at_rest(&file)[drawn.node])
    };
    let (positions, normals, stays) = seen(json!([]));
    let mesh = parsed_files(&files).json["nodes"]
        .as_array()
        .into_iter()
        .flatten()
        .position(|n| n.get("mesh").is_some());
    let (ridden, turned, goes) = seen(json!([{"node": mesh}]));
    assert!(
        off(&stays, &goes) > 0.1 * stays.matrix3.x_axis.length(),
        "{stays:?} {goes:?}"
    );
    for (a, b) in positions.iter().zip(&ridden) {
        assert!(a.distance(*b) < 3e-6, "{a} {b}");
    }
    for (a, b) in normals.iter().zip(&turned) {
        assert!(a.distance(*b) < 1e-4, "{a} {b}");
    }
}
