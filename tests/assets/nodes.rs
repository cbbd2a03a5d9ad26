//! Nodes of a model's own file that ride along: sockets, cameras and what hangs on them, through jobs.

use crate::support::bench::pool;
use crate::support::gltf_draft::Draft;
use crate::support::gltf_parsed::{Parsed, parse};
use crate::support::khronos;
use crate::support::shapes::obj_text;
use crate::support::skinning::{ClipTime, draw, list, world_transforms};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use pliant::asset::{FileSet, Format, Limits, Model, sample, shapes};
use pliant::batch::BatchOutcome;
use pliant::engine::DeformerLimits;
use pliant::exec::Exec;
use pliant::progress::Silent;
use pliant::wire::{Error, json as wire_json, pb};
use serde_json::{Value, json};
use std::collections::BTreeMap;

const SOCKET: usize = 2;
const LAMP: usize = 3;
const CAMERA: usize = 4;
const GROUND: usize = 5;
/// Two nodes of one name; a clip moves the first of them by a pointer.
const TWINS: [usize; 2] = [6, 7];
const OUTSIDE: usize = 8;

/// A bar along z, 1 wide and 4 long, under a turned and larger frame, with a block that stands apart from it on a lamp, which
/// hangs on a socket of the frame; a camera by its matrix, and marks beside the scene. A clip moves socket and twin.
fn bar_with_nodes() -> FileSet {
    let (bar, bar_faces) = shapes::box_with_cells(DVec3::new(1.0, 1.0, 4.0), [4, 4, 16]);
    let (block, block_faces) = shapes::box_with_cells(DVec3::splat(0.25), [2, 2, 2]);
    let mut draft = Draft::default();
    // Where the bar is put back by the frame that it hangs on.
    let stored = |p: &DVec3| ((*p - DVec3::new(0.5, 0.5, 0.0)) * 0.5).as_vec3().to_array();
    for (points, faces) in [
        (bar.iter().map(stored).collect::<Vec<_>>(), &bar_faces),
        (block.iter().map(stored).collect(), &block_faces),
    ] {
        draft.floats(&points, "VEC3");
        let corners: Vec<u8> = faces.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        draft.add(&corners, 5125, "SCALAR", 3 * faces.len(), json!({}));
    }
    draft.floats(&[[0.0], [1.0]], "SCALAR");
    draft.floats(&[[0.3, 0.1, 1.6], [0.3, 0.4, 1.6]], "VEC3");
    draft.floats(&[[0.6, 0.0, 0.0, 0.8], [0.0, 0.0, 0.0, 1.0]], "VEC4");
    draft.floats(&[[-0.8, 0.0, 3.0], [-0.8, 0.0, 3.5]], "VEC3");
    let sampler = |output: usize| json!({"input": 4, "output": output});
    let channel = |sampler: usize, path: &str| json!({"sampler": sampler, "target": {"node": SOCKET, "path": path}});
    let pointer = json!({"sampler": 2, "target": {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": format!("/nodes/{}/translation", TWINS[0])}}}});
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let document = json!({
        "scene": 0, "scenes": [{"nodes": [0, CAMERA, GROUND, 6, 7]}],
        "extensionsUsed": ["KHR_animation_pointer"],
        "nodes": [
            {"name": "frame", "children": [1, SOCKET], "translation": [0, 0, 0], "rotation": [0, 0, half, half], "scale": [2, 2, 2]},
            {"name": "body", "mesh": 0},
            {"name": "socket", "children": [LAMP], "translation": [0.3, 0.1, 1.6], "rotation": [0.6, 0, 0, 0.8]},
            {"name": "lamp", "mesh": 1, "translation": [0, 0.1, 0.3]},
            {"name": "camera", "camera": 0, "matrix": [0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 1.5, 0.25, 3.5, 1]},
            {"name": "ground", "translation": [0.25, 0.125, 0.0625]},
            {"name": "twin", "translation": [-0.8, 0, 3]},
            {"name": "twin", "translation": [0, -0.8, 3], "rotation": [0, half, 0, half]},
            {"name": "outside", "translation": [0, 0, 4.5]},
        ],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.01}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}, {"primitives": [{"attributes": {"POSITION": 2}, "indices": 3}]}],
        "animations": [{"samplers": [sampler(5), sampler(6), sampler(7)], "channels": [channel(0, "translation"), channel(1, "rotation"), pointer]}],
    });
    FileSet::single("bar.glb", draft.glb(document))
}

/// Holds one end and bends the other, with `passengers` and after `first` steps.
fn bending(passengers: &Value, first: &[Value]) -> Value {
    let bend = json!({"pose": {"handles": [{"id": "top", "pose": {"rotationVector": [0.9, 0, 0.4], "translation": [0.1, 0.5, -0.2], "pivot": [0, 0, 3.85]}}]}});
    let steps = [first, &[bend]].concat();
    json!({
        "create": {"passengers": passengers},
        "handles": [
            {"id": "base", "region": {"halfSpace": {"normal": [0, 0, -1], "offset": -0.8}}},
            {"id": "top", "region": {"halfSpace": {"normal": [0, 0, 1], "offset": 3.7}}},
        ],
        "steps": steps,
    })
}

pub fn try_run(files: FileSet, job: &Value, format: Option<Format>) -> Result<BatchOutcome, Error> {
    let job: pb::Job = wire_json::from_json(job.to_string().as_bytes()).expect("a job");
    let limits = DeformerLimits::default();
    pliant::batch::run(files, &job, format, &limits, &Exec::new(&pool(2), &Silent), &|| 0.0)
}

pub fn run(files: FileSet, job: &Value) -> BatchOutcome {
    try_run(files, job, None).expect("the job runs")
}

pub fn parsed(outcome: &BatchOutcome) -> Parsed {
    parse(&outcome.written.main, &outcome.written.companions)
}

pub fn parsed_files(files: &FileSet) -> Parsed {
    let companions = files
        .companions
        .iter()
        .map(|(name, bytes)| (name.clone(), bytes.to_vec()));
    parse(&files.main, &companions.collect())
}

pub fn at_rest(file: &Parsed) -> Vec<DAffine3> {
    world_transforms(file, None).expect("nodes")
}

fn all_nodes() -> Value {
    json!([
        {"node": SOCKET}, {"nodesNamed": "camera", "name": "view"}, {"node": GROUND}, {"nodesNamed": "twin"}, {"nodesNamed": "outside"},
    ])
}

/// Points with axes at the places of nodes.
fn as_points(world: &[DAffine3], nodes: &[usize]) -> Value {
    let positions: Vec<f64> = nodes.iter().flat_map(|&n| world[n].translation.to_array()).collect();
    let rotations: Vec<f64> = nodes.iter().flat_map(|&n| turn_of(&world[n]).to_array()).collect();
    json!({"name": "points", "points": {"positions": positions, "rotations": rotations}})
}

pub fn turn_of(world: &DAffine3) -> DQuat {
    let m = &world.matrix3;
    DQuat::from_mat3(&DMat3::from_cols(
        m.x_axis.normalize(),
        m.y_axis.normalize(),
        m.z_axis.normalize(),
    ))
}

pub fn frames(reported: &pb::report::Passenger) -> Vec<(DVec3, DQuat)> {
    let places = reported.positions.chunks_exact(3).map(DVec3::from_slice);
    places
        .zip(reported.rotations.chunks_exact(4).map(DQuat::from_slice))
        .collect()
}

pub fn off(a: &DAffine3, b: &DAffine3) -> f64 {
    let axes = (0..3).map(|k| a.matrix3.col(k).distance(b.matrix3.col(k)));
    axes.fold(a.translation.distance(b.translation), f64::max)
}

/// Runs a job with nodes and one with points at their places, and says how far the written nodes stand and are turned from
/// the points, at most; `report` entries are compared too.
fn off_from_points(files: &FileSet, nodes: &Value, order: &[usize], first: &[Value]) -> (BatchOutcome, f64) {
    let before = at_rest(&parsed_files(files));
    let mut passengers = nodes.as_array().expect("a list").clone();
    passengers.push(as_points(&before, order));
    let outcome = run(files.clone(), &bending(&json!(passengers), first));
    let after = at_rest(&parsed(&outcome));
    let (points, reported) = outcome.report.passengers.split_last().expect("passengers");
    let points = frames(points);
    let nodes: Vec<u32> = reported.iter().flat_map(|p| p.nodes.clone()).collect();
    assert_eq!(nodes, order.iter().map(|&n| n as u32).collect::<Vec<_>>());
    let reported: Vec<_> = reported.iter().flat_map(frames).collect();
    let mut worst = 0.0f64;
    for ((&node, (place, turn)), (reported_place, reported_turn)) in order.iter().zip(&points).zip(&reported) {
        // A quaternion and its negative are one rotation.
        let apart = |q: DQuat| (q - *turn).length().min((q + *turn).length());
        worst = worst.max(reported_place.distance(*place)).max(apart(*reported_turn));
        worst = worst
            .max(after[node].translation.distance(*place))
            .max(apart(turn_of(&after[node])));
        for k in 0..3 {
            let lengths = [&before, &after].map(|world| world[node].matrix3.col(k).length());
            assert!(
                (lengths[0] - lengths[1]).abs() < 1e-5,
                "node {node} keeps its scale: {lengths:?}"
            );
        }
    }
    (outcome, worst)
}

const ORDER: [usize; 6] = [SOCKET, CAMERA, GROUND, TWINS[0], TWINS[1], OUTSIDE];

#[test]
fn nodes_go_where_points_at_their_places_go_and_what_hangs_on_them_rides_along() {
    let files = bar_with_nodes();
    let (outcome, off_points) = off_from_points(&files, &all_nodes(), &ORDER, &[]);
    let (file, source) = (parsed(&outcome), parsed_files(&files));
    let (before, after) = (at_rest(&source), at_rest(&file));
    assert!(off_points < 1e-6 * 4.2, "{off_points}");
    for node in [SOCKET, CAMERA, TWINS[0], TWINS[1], OUTSIDE] {
        assert!(off(&before[node], &after[node]) > 0.3, "node {node} moves");
    }
    let names: Vec<&str> = outcome.report.passengers.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(names, ["socket", "view", "ground", "twin", "outside", "points"]);
    // The lamp hangs on the socket as it did.
    let hung = |world: &[DAffine3]| world[SOCKET].inverse() * world[LAMP];
    assert!(off(&hung(&before), &hung(&after)) < 1e-5);
    // What did not move, or rides along, is the same text.
    for node in [0, 1, LAMP, GROUND] {
        assert_eq!(file.json["nodes"][node], source.json["nodes"][node]);
    }
    assert!(file.json["nodes"][CAMERA]["matrix"].is_array() && file.json["nodes"][CAMERA].get("rotation").is_none());
    // The block on the lamp is part of what was solved, and drawn where the solve put it.
    let drawn = draw(&file, None, &[]).expect("drawn");
    assert_eq!(drawn.len(), 2);
    let drawn: Vec<DVec3> = drawn.into_iter().flat_map(|d| d.positions).collect();
    for (seen, solved) in drawn.iter().zip(outcome.positions.iter()) {
        assert!(seen.distance(*solved) < 1e-6 * 4.2, "{seen} {solved}");
    }
}

#[test]
fn clips_play_on_the_new_rest_pose_of_a_node() {
    let files = bar_with_nodes();
    let source = parsed_files(&files);
    let outcome = run(files, &bending(&all_nodes(), &[]));
    let file = parsed(&outcome);
    let at = |file: &Parsed, seconds: f64| {
        // The plain player knows no pointers.
        let mut plain = parse(&outcome.written.main, &outcome.written.companions);
        plain.json = file.json.clone();
        plain.buffers.clone_from(&file.buffers);
        let channels = plain.json["animations"][0]["channels"]
            .as_array_mut()
            .expect("channels");
        channels.retain(|c| c["target"]["path"] != "pointer");
        world_transforms(&plain, Some(ClipTime { clip: 0, seconds })).expect("played")
    };
    let rest = at_rest(&file);
    for node in [SOCKET, LAMP] {
        assert!(
            off(&at(&file, 0.0)[node], &rest[node]) < 2e-5,
            "the first key is the rest pose"
        );
    }
    // In the node's own frame the clip does what it did.
    let done = |file: &Parsed| at_rest(file)[SOCKET].inverse() * at(file, 1.0)[SOCKET];
    assert!(
        off(&done(&file), &done(&source)) < 1e-5,
        "{:?} {:?}",
        done(&file),
        done(&source)
    );
    let pointed = |file: &Parsed| {
        let output = &file.json["animations"][0]["samplers"][2]["output"];
        let keys = crate::support::skinning::numbers(file, output).expect("numbers");
        [0, 3].map(|k| DVec3::from_slice(&keys[k..]))
    };
    let (old, new) = (pointed(&source), pointed(&file));
    assert!(new[0].distance(rest[TWINS[0]].translation) < 1e-5, "{new:?}");
    assert!((new[1].distance(new[0]) - old[1].distance(old[0])).abs() < 1e-5 && new[0].distance(old[0]) > 0.3);
}

#[test]
fn a_model_that_does_not_move_comes_back_to_the_byte() {
    let files = bar_with_nodes();
    let mut job = bending(&all_nodes(), &[]);
    job["steps"] = json!([]);
    let still = run(files.clone(), &job);
    assert!(still.written.main == files.main);
    let there = &still.report.passengers[0];
    assert_eq!(
        (there.nodes.as_slice(), there.scales.as_slice()),
        (&[SOCKET as u32][..], &[1.0][..])
    );
    // Without nodes that ride along nothing of the scene but its meshes changes.
    let plain = run(files.clone(), &bending(&json!([]), &[]));
    assert_eq!(parsed(&plain).json["nodes"], parsed_files(&files).json["nodes"]);
}

#[test]
fn nodes_ride_on_after_edits() {
    let files = bar_with_nodes();
    let half = json!({"pose": {"handles": [{"id": "top", "pose": {"rotationVector": [0, 0.5, 0], "translation": [0.3, 0, 0]}}]}});
    let finer = |on: &str| json!({"edit": {"on": on, "subdivide": {"scheme": "MIDPOINT"}}});
    for first in [vec![finer("REST")], vec![half, finer("CURRENT")]] {
        let (outcome, off_points) = off_from_points(&files, &all_nodes(), &ORDER, &first);
        assert!(off_points < 1e-6 * 4.2, "{off_points}");
        let file = parsed(&outcome);
        let drawn = draw(&file, None, &[]).expect("drawn");
        let drawn: Vec<DVec3> = drawn.into_iter().flat_map(|d| d.positions).collect();
        assert_eq!(drawn.len(), outcome.positions.len());
        for (seen, solved) in drawn.iter().zip(outcome.positions.iter()) {
            assert!(seen.distance(*solved) < 1e-6 * 4.2, "{seen} {solved}");
        }
        // The first key of the clip is the rest pose still.
        let keys = &file.json["animations"][0]["samplers"][0]["output"];
        let keys = crate::support::skinning::numbers(&file, keys).expect("numbers");
        let at: Vec<f64> = serde_json::from_value(file.json["nodes"][SOCKET]["translation"].clone()).expect("numbers");
        assert!(DVec3::from_slice(&keys).distance(DVec3::from_slice(&at)) < 1e-5);
    }
}

#[test]
fn wrong_nodes_are_refused_with_their_passenger() {
    let reported = |files: FileSet, passengers: Value| {
        let mut job = bending(&passengers, &[]);
        job["handles"] = json!([]);
        job["steps"] = json!([]);
        try_run(files, &job, None).expect_err("refused").to_string()
    };
    let obj = FileSet::single("one.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    let figure = || FileSet::single("figure.glb", sample::figure_glb());
    for (files, passengers, at, needle) in [
        (
            bar_with_nodes(),
            json!([{"node": 9}]),
            0,
            "is node 9, the model has 9 nodes, counted from 0",
        ),
        (
            bar_with_nodes(),
            json!([{"node": 4}, {"nodesNamed": "hook"}]),
            1,
            "no node is named \"hook\", there are \"frame\", \"body\", \"socket\"",
        ),
        (
            bar_with_nodes(),
            json!([{"node": 4}, {"nodesNamed": "camera"}]),
            1,
            "node 4 is a passenger already",
        ),
        (
            bar_with_nodes(),
            json!([{"nodesNamed": ""}]),
            0,
            "nodesNamed: is empty, a name is needed",
        ),
        (
            obj,
            json!([{"node": 0}]),
            0,
            "is a node, but the model is obj; only glTF has nodes",
        ),
        (
            figure(),
            json!([{"nodesNamed": "hips"}]),
            0,
            "node 0 \"hips\" is a joint of a skin",
        ),
        (
            figure(),
            json!([{"nodesNamed": "nobody"}]),
            0,
            "there are \"rightHandSocket\", \"hatSocket\", \"body\"",
        ),
    ] {
        let reported = reported(files, passengers);
        assert!(
            reported.starts_with(&format!("passengers[{at}]")) && reported.contains(needle),
            "{reported}"
        );
    }
}

#[test]
fn the_khronos_validator_finds_nothing_new_about_moved_nodes() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let files = bar_with_nodes();
    let before = folder.path().join("before.glb");
    std::fs::write(&before, &files.main).expect("written");
    let mut made = Vec::new();
    let finer = json!({"edit": {"on": "REST", "subdivide": {"scheme": "MIDPOINT"}}});
    for (name, first) in [("bent", vec![]), ("edited", vec![finer])] {
        for format in [Format::GLB, Format::GLTF] {
            let outcome = try_run(files.clone(), &bending(&all_nodes(), &first), Some(format)).expect("runs");
            let at = folder
                .path()
                .join(format!("{name}-{}/model.{}", format.name(), format.name()));
            khronos::store(&outcome.written, &at);
            made.push((at, before.clone()));
        }
    }
    khronos::assert_nothing_new("moved nodes", &made);
}

#[test]
fn a_node_rides_at_the_end_of_any_chain() {
    let files = bar_with_nodes();
    let mut file = parsed_files(&files);
    let nodes = file.json["nodes"].as_array_mut().expect("nodes");
    // A chain from the camera on, each link a little further; its last one rides on its own.
    let (first, links) = (nodes.len(), 30_000);
    nodes[CAMERA]["children"] = json!([first]);
    nodes.extend((0..links).map(|k| json!({"translation": [0, 0, 1e-5], "children": [first + k + 1]})));
    nodes.push(json!({"name": "hook"}));
    let last = nodes.len() - 1;
    file.json["buffers"][0]["uri"] = json!("bar.bin");
    let mut files = FileSet::single("bar.gltf", file.json.to_string());
    files
        .companions
        .insert("bar.bin".into(), file.buffers[0].clone().into());
    let outcome = run(
        files,
        &bending(&json!([{"nodesNamed": "camera"}, {"nodesNamed": "hook"}]), &[]),
    );
    let mut world = DAffine3::IDENTITY;
    let written = parsed(&outcome);
    let json = &written.json["nodes"];
    let place = |n: usize| {
        let place: [f64; 3] = serde_json::from_value(json[n]["translation"].clone()).expect("a place");
        DVec3::from_array(place)
    };
    let matrix: Vec<f64> = serde_json::from_value(json[CAMERA]["matrix"].clone()).expect("a matrix");
    world.matrix3 = DMat3::from_cols_slice(&[&matrix[0..3], &matrix[4..7], &matrix[8..11]].concat());
    world.translation = DVec3::from_slice(&matrix[12..15]);
    let end = (first..=last).fold(world, |world, n| world * DAffine3::from_translation(place(n)));
    for (at, reported) in [(world, 0), (end, 1)] {
        let (reported, _) = frames(&outcome.report.passengers[reported])[0];
        assert!(at.translation.distance(reported) < 1e-5, "{at:?} {reported}");
    }
}

#[test]
fn a_wrap_takes_passengers_and_skeleton_along() {
    let files = FileSet::single("figure.glb", sample::figure_glb().to_vec());
    let read = |files: FileSet| Model::read(files, None, &Limits::default()).expect("a model");
    let before = read(files.clone());
    let body = before.geometry.primitives[0].vertices();
    let aside = DVec3::new(5.0, 0.0, 2.0);
    let own: Vec<DVec3> = before.positions[body.clone()].iter().map(|p| *p + aside).collect();
    let mut triangles = before.geometry.triangles.clone();
    triangles.retain(|t| t.iter().all(|v| body.contains(&(*v as usize))));
    let scan = STANDARD.encode(obj_text(&(own, triangles)));
    let job = json!({
        "create": {"passengers": [{"primitivesNamed": "lod1"}, {"primitivesNamed": "hull"}, {"points": {"positions": [0, 1.5, 0]}}]},
        "steps": [{"edit": {"wrap": {"model": scan}}}],
    });
    let outcome = run(files, &job);
    let height = 1.8;
    let moves = |what: &str, was: DVec3, now: DVec3| {
        let off = (now - was).distance(aside);
        assert!(off < 0.02 * height, "{what}: {was} to {now}");
    };
    let after = read(FileSet::single("out.glb", outcome.written.main.clone()));
    assert_eq!(before.positions.len(), after.positions.len());
    for primitive in before.geometry.primitives.iter().filter(|p| p.name != "lod2") {
        for v in primitive.vertices() {
            moves(&primitive.name, before.positions[v], after.positions[v]);
        }
    }
    let point = &outcome.report.passengers[0].positions;
    moves("point", DVec3::new(0.0, 1.5, 0.0), DVec3::from_slice(point));
    let worlds = [sample::figure_glb(), &outcome.written.main].map(|glb| {
        let file = parse(glb, &BTreeMap::new());
        let world = world_transforms(&file, None).expect("nodes");
        let joints = list(&list(&file.json["skins"])[0]["joints"]);
        joints
            .iter()
            .map(|j| world[j.as_u64().expect("a node") as usize].translation)
            .collect::<Vec<_>>()
    });
    assert_eq!(worlds[0].len(), worlds[1].len());
    for (was, now) in worlds[0].iter().zip(&worlds[1]) {
        moves("joint", *was, *now);
    }
}
