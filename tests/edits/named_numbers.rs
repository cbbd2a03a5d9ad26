//! What names vertices by number goes through edits with them, or is left out and said.

use super::edit_support::cube;
use crate::support::data::data_bytes;
use crate::support::gltf_draft::Draft;
use crate::support::gltf_parsed::{Parsed, parse};
use pliant::asset::{FileSet, Format, Limits, Model};
use pliant::batch::{self, BatchOutcome};
use pliant::engine::DeformerLimits;
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::{json::from_json, pb};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

fn edited(files: FileSet, edits: &[Value], format: Option<Format>) -> BatchOutcome {
    let steps: Vec<Value> = edits.iter().map(|edit| json!({"edit": edit})).collect();
    let job: pb::Job = from_json(json!({"steps": steps}).to_string().as_bytes()).expect("a job");
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    batch::run(files, &job, format, &DeformerLimits::default(), &exec, &|| 0.0).expect("the job runs")
}

fn halved() -> Value {
    json!({"subdivide": {"scheme": "MIDPOINT"}})
}

fn thinned() -> Value {
    json!({"decimate": {"ratio": 0.3}})
}

/// The numbers of an accessor of 16 or 32 bits with a view of its own.
fn vertex_numbers(parsed: &Parsed, accessor: &Value) -> Vec<u32> {
    let accessor = &parsed.json["accessors"][accessor.as_u64().expect("a number") as usize];
    let view = &parsed.json["bufferViews"][accessor["bufferView"].as_u64().expect("a view") as usize];
    let [first, size] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().unwrap_or(0) as usize);
    let bytes = &parsed.buffers[0][first..first + size];
    match accessor["componentType"].as_u64() {
        Some(5123) => bytes
            .chunks_exact(2)
            .map(|b| u32::from(u16::from_le_bytes([b[0], b[1]])))
            .collect(),
        _ => bytes
            .chunks_exact(4)
            .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect(),
    }
}

fn warned<'a>(outcome: &'a BatchOutcome, code: &str) -> Vec<&'a str> {
    let warnings = outcome.report.warnings.iter().filter(|w| w.code == code);
    warnings.map(|w| w.message.as_str()).collect()
}

/// A cube with whatever extensions of its primitive and its mesh, and accessors of vertex numbers that they may name: 2 is its
/// twelve edges of one step each.
fn cube_with(of_primitive: &Value, of_mesh: &Value) -> FileSet {
    let (points, faces) = cube(2);
    let mut draft = Draft::default();
    let list: Vec<[f32; 3]> = points.iter().map(|p| p.as_vec3().to_array()).collect();
    draft.floats(&list, "VEC3");
    let bytes = |numbers: &[u32]| numbers.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    draft.add(&bytes(faces.as_flattened()), 5125, "SCALAR", 3 * faces.len(), json!({}));
    let edges: Vec<u32> = faces.iter().take(12).flat_map(|f| [f[0], f[1]]).collect();
    draft.add(&bytes(&edges), 5125, "SCALAR", edges.len(), json!({}));
    let names = |object: &Value| -> Vec<String> { object.as_object().expect("an object").keys().cloned().collect() };
    let used = [names(of_primitive), names(of_mesh)].concat();
    let primitive = json!({"attributes": {"POSITION": 0}, "indices": 1, "extensions": of_primitive});
    let document = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "extensionsUsed": used, "meshes": [{"primitives": [primitive], "extensions": of_mesh}],
    });
    FileSet::single("cube.glb", draft.glb(document))
}

#[test]
fn an_outline_is_that_of_the_new_vertices_or_none() {
    let files = || cube_with(&json!({"CESIUM_primitive_outline": {"indices": 2}}), &json!({}));
    let fine = edited(files(), &[halved()], None);
    let parsed = parse(&fine.written.main, &BTreeMap::new());
    let outline = &parsed.json["meshes"][0]["primitives"][0]["extensions"]["CESIUM_primitive_outline"];
    let ends = vertex_numbers(&parsed, &outline["indices"]);
    assert_eq!(ends.len(), 48, "every edge is two");
    let model = Model::read(
        FileSet::single("fine.glb", fine.written.main.clone()),
        None,
        &Limits::default(),
    );
    let model = model.expect("it reads");
    let sides: BTreeSet<[u32; 2]> = model
        .triangles
        .iter()
        .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a], [b, a], [c, b], [a, c]])
        .collect();
    assert!(ends.chunks(2).all(|e| sides.contains(&[e[0], e[1]])));
    assert_eq!(warned(&fine, "extension-dropped"), [""; 0]);

    let coarse = edited(files(), &[thinned()], None);
    let text = String::from_utf8_lossy(&coarse.written.main).into_owned();
    assert!(!text.contains("CESIUM"), "no name of it is left");
    assert!(warned(&coarse, "extension-dropped")[0].starts_with("CESIUM_primitive_outline"));
}

#[test]
fn what_lists_triangles_goes_and_is_said() {
    let of_mesh = json!({"EXT_mesh_manifold": {"manifoldPrimitive": {"indices": 1}}});
    let files = || cube_with(&json!({"FB_ngon_encoding": {}}), &of_mesh);
    let fine = edited(files(), &[halved()], None);
    let parsed = parse(&fine.written.main, &BTreeMap::new());
    assert_eq!(parsed.json["extensionsUsed"], Value::Null);
    assert_eq!(parsed.json["meshes"][0]["extensions"], Value::Null);
    let said = warned(&fine, "extension-dropped");
    assert!(
        said[0].contains("EXT_mesh_manifold") && said[0].contains("FB_ngon_encoding"),
        "{said:?}"
    );
    // Nothing happens to them where no triangle changes.
    let same = edited(files(), &[], None);
    assert_eq!(same.written.main, files().main);
    assert!(warned(&same, "extension-dropped").is_empty());
}

#[test]
fn features_that_are_numbered_as_vertices_get_an_attribute() {
    let features = json!({"featureIds": [{"featureCount": 98}, {"featureCount": 4, "texture": {"index": 0}}]});
    let fine = edited(
        cube_with(&json!({"EXT_mesh_features": features}), &json!({})),
        &[halved()],
        None,
    );
    let primitive = parse(&fine.written.main, &BTreeMap::new()).json["meshes"][0]["primitives"][0].clone();
    let sets = &primitive["extensions"]["EXT_mesh_features"]["featureIds"];
    assert_eq!(
        (&sets[0]["attribute"], &sets[1]["attribute"]),
        (&json!(0), &Value::Null)
    );
    assert!(primitive["attributes"]["_FEATURE_ID_0"].is_u64());
}

#[test]
fn extensions_that_may_not_fit_are_named() {
    let files = cube_with(&json!({"ACME_anchors": {"vertices": [1, 2]}}), &json!({}));
    let fine = edited(files, &[halved()], None);
    assert!(warned(&fine, "extension-kept")[0].starts_with("ACME_anchors stays"));
}

/// The cube as a text of one format or another, with lines and points behind it.
fn cube_text(head: &str, prefix: &str, face: &str, base: u32, tail: &str) -> String {
    let (points, faces) = cube(2);
    let vertices: String = points
        .iter()
        .map(|p| format!("{prefix}{} {} {}\n", p.x, p.y, p.z))
        .collect();
    let faces = faces.iter().map(|f| f.map(|v| v + base));
    let faces: String = faces.map(|[a, b, c]| format!("{face}{a} {b} {c}\n")).collect();
    format!("{head}{vertices}{faces}{tail}")
}

#[test]
fn lines_and_points_of_an_obj_follow() {
    let faces = cube(2).1;
    let [a, b, c] = faces[0].map(|v| v + 1);
    let tail = format!("g seam\nl {a} {b} {c}\ng marks\np {a} {c}\n");
    let files = || FileSet::single("cube.obj", cube_text("", "v ", "f ", 1, &tail));
    let fine = edited(files(), &[halved()], None);
    let text = String::from_utf8(fine.written.main.clone()).expect("text");
    let model = Model::read(FileSet::single("fine.obj", text.clone()), None, &Limits::default()).expect("it reads");
    let of_line = |keyword: &str| -> Vec<usize> {
        let line = text.lines().find_map(|line| line.strip_prefix(keyword)).expect(keyword);
        line.split_whitespace()
            .map(|v| v.parse::<usize>().expect("a number") - 1)
            .collect()
    };
    let (line, points) = (of_line("l "), of_line("p "));
    assert_eq!(line.len(), 5, "one more vertex on each edge");
    let before = cube(2).0;
    let middle = (before[faces[0][0] as usize] + before[faces[0][1] as usize]) / 2.0;
    assert!(model.positions[line[1]].distance(middle) < 1e-9);
    assert_eq!(points, [line[0], line[4]]);
    assert!(text.contains("g seam\nl ") && text.contains("g marks\np "), "{text}");
    assert!(warned(&fine, "left-out").is_empty());

    // What is gone is said, with how much of it.
    let every: String = (1..=before.len()).map(|v| format!(" {v}")).collect();
    let files = FileSet::single("cube.obj", cube_text("", "v ", "f ", 1, &format!("p{every}\n")));
    let coarse = edited(files, &[thinned()], None);
    let left = String::from_utf8(coarse.written.main.clone()).expect("text");
    let left = left
        .lines()
        .find(|line| line.starts_with("p "))
        .expect("points")
        .split(' ')
        .count()
        - 1;
    let gone = format!("{} vertices of lines and points", before.len() - left);
    assert!(
        warned(&coarse, "left-out")[0].contains(&gone),
        "{gone}: {:?}",
        warned(&coarse, "left-out")
    );

    let converted = edited(cube_lines(&tail), &[], Some(Format::GLB));
    assert!(warned(&converted, "left-out")[0].ends_with("1 line, 1 statement of points"));
}

fn cube_lines(tail: &str) -> FileSet {
    FileSet::single("cube.obj", cube_text("", "v ", "f ", 1, tail))
}

#[test]
fn edges_of_a_ply_follow() {
    let (points, faces) = cube(2);
    let [a, b, c] = faces[0];
    let head = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\nelement face {}\n\
         property list uchar int vertex_indices\nelement edge 2\nproperty uchar vertex1\nproperty uchar vertex2\n\
         property float crease\nend_header\n",
        points.len(),
        faces.len()
    );
    let files = FileSet::single(
        "cube.ply",
        cube_text(&head, "", "3 ", 0, &format!("{a} {b} 0.5\n{b} {c} 1\n")),
    );
    let fine = edited(files.clone(), &[halved(), halved()], None);
    let text = String::from_utf8(fine.written.main.clone()).expect("text");
    assert!(text.contains("element edge 8\nproperty uint vertex1\n"), "{text}");
    let rows: Vec<&str> = text.lines().rev().take(8).collect();
    assert!(
        rows[7].starts_with(&format!("{a} ")) && rows[4].ends_with(" 0.5"),
        "{rows:?}"
    );
    assert!(warned(&fine, "left-out").is_empty());
    let converted = edited(files, &[], Some(Format::OBJ));
    assert!(warned(&converted, "left-out")[0].ends_with("has not: 2 edges"));
}

#[test]
fn the_field_cases_say_or_keep() {
    let Some(bytes) = data_bytes("field/bar_outline.glb") else {
        return;
    };
    for edit in [halved(), thinned()] {
        let done = edited(FileSet::single("bar.glb", bytes.clone()), &[edit], None);
        let parsed = parse(&done.written.main, &BTreeMap::new());
        let primitive = &parsed.json["meshes"][0]["primitives"][0];
        let outline = &primitive["extensions"]["CESIUM_primitive_outline"];
        let vertices =
            parsed.json["accessors"][primitive["attributes"]["POSITION"].as_u64().expect("one") as usize]["count"]
                .clone();
        match outline["indices"].as_u64() {
            Some(at) => {
                let ends = vertex_numbers(&parsed, &json!(at));
                assert!(
                    ends.iter()
                        .all(|end| u64::from(*end) < vertices.as_u64().expect("a count"))
                        && !ends.is_empty()
                );
            }
            None => {
                assert_eq!(parsed.json["extensionsUsed"], Value::Null);
                assert_eq!(warned(&done, "extension-dropped").len(), 1);
            }
        }
    }
}
