//! After edits of the topology every attribute has followed its vertices, in every format, and files stay valid.

use crate::support::bench::largest_distance;
use crate::support::gltf_draft::Draft;
use crate::support::{gltf_parsed, gltf_sets, khronos};
mod real;
use crate::support::recipes;

use crate::support::data::data_folder;
use crate::support::skinning::list;
use glam::{DAffine3, DVec3};
use gltf_parsed::{Parsed, parse};
use gltf_sets::{file_set, gltf_files};
use pliant::asset::{BaseModel, FileSet, Format, Limits, Model, write_edited_model};
use proptest::prelude::*;
use recipes::{Edited, at_rest, read_back, size};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The numbers of an accessor without sparse values, scaled where it says so.
fn numbers(parsed: &Parsed, accessor: usize) -> Vec<f64> {
    let accessor = &parsed.json["accessors"][accessor];
    let number = |v: &Value| v.as_u64().unwrap_or(0) as usize;
    let view = &parsed.json["bufferViews"][number(&accessor["bufferView"])];
    let bytes = &parsed.buffers[number(&view["buffer"])];
    let lanes = match accessor["type"].as_str().expect("a type") {
        "SCALAR" => 1,
        "VEC2" => 2,
        "VEC3" => 3,
        _ => 4,
    };
    let component = number(&accessor["componentType"]);
    let width = match component {
        5120 | 5121 => 1,
        5122 | 5123 => 2,
        _ => 4,
    };
    let stride = view["byteStride"].as_u64().map_or(lanes * width, |s| s as usize);
    let start = number(&view["byteOffset"]) + number(&accessor["byteOffset"]);
    let scale = if accessor["normalized"] == true {
        f64::from((1u32 << (8 * width)) - 1)
    } else {
        1.0
    };
    let one = |at: usize| match component {
        5121 => f64::from(bytes[at]),
        5123 => f64::from(u16::from_le_bytes([bytes[at], bytes[at + 1]])),
        5125 => f64::from(u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four"))),
        5126 => f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().expect("four"))),
        other => panic!("component type {other}"),
    };
    let elements =
        (0..number(&accessor["count"])).flat_map(|i| (0..lanes).map(move |k| start + i * stride + k * width));
    elements.map(|at| one(at) / scale).collect()
}

/// A bent square of two triangles with everything that a primitive can have, drawn by two nodes, and points beside it.
fn figure() -> Vec<u8> {
    let mut draft = Draft::default();
    let position = draft.floats(
        &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [1.0, 1.0, 0.0], [0.0, 1.0, 0.25]],
        "VEC3",
    );
    let normal = draft.floats(&[[0.0, 0.0, 1.0]; 4], "VEC3");
    let tangent = draft.floats(&[[1.0, 0.0, 0.0, -1.0]; 4], "VEC4");
    let uv = draft.floats(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], "VEC2");
    let second_uv: Vec<u8> = [[0_u16, 0], [65535, 0], [65535, 13107], [0, 65535]]
        .iter()
        .flatten()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let second_uv = draft.add(&second_uv, 5123, "VEC2", 4, json!({"normalized": true}));
    let colour = [255, 0, 0, 255, 0, 255, 0, 255, 0, 0, 255, 255, 51, 51, 51, 255];
    let colour = draft.add(&colour, 5121, "VEC4", 4, json!({"normalized": true}));
    let joints = draft.add(
        &[0, 1, 0, 0, 1, 2, 0, 0, 2, 3, 4, 5, 6, 7, 0, 0],
        5121,
        "VEC4",
        4,
        json!({}),
    );
    let weights = draft.floats(
        &[
            [0.75, 0.25, 0.0, 0.0],
            [0.5, 0.5, 0.0, 0.0],
            [0.25; 4],
            [0.5, 0.5, 0.0, 0.0],
        ],
        "VEC4",
    );
    let heat = draft.floats(&[[0.0], [1.0], [2.0], [4.0]], "SCALAR");
    let label = draft.floats(&[[7.0], [9.0], [9.0], [11.0]], "SCALAR");
    let up = draft.floats(&[[0.0, 0.0, 1.0], [0.0; 3], [0.0, 0.0, 3.0], [0.0; 3]], "VEC3");
    let turn = draft.floats(&[[0.0; 3], [0.5, 0.0, 0.0], [0.0; 3], [0.0; 3]], "VEC3");
    let side = draft.floats(&[[1.0, 0.0, 0.0]; 4], "VEC3");
    let indices: Vec<u8> = [0_u16, 1, 2, 3].iter().flat_map(|v| v.to_le_bytes()).collect();
    let strip = draft.add(&[0, 0, 1, 0, 3, 0, 2, 0], 5123, "SCALAR", 4, json!({}));
    let points = draft.add(&indices, 5123, "SCALAR", 4, json!({}));
    let matrices: Vec<[f32; 16]> = (0..8)
        .map(|_| [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.])
        .collect();
    let matrices = draft.floats(&matrices, "MAT4");
    let times = draft.floats(&[[0.0], [1.0]], "SCALAR");
    let moves = draft.floats(&[[0.0], [0.0], [1.0], [1.0]], "SCALAR");
    let joints_list: Vec<usize> = (2..10).collect();
    let mut nodes = vec![
        json!({"mesh": 0, "skin": 0, "name": "skinned"}),
        json!({"mesh": 1, "name": "still", "scale": [2, 2, -2], "translation": [0, 0, 5]}),
    ];
    nodes.extend(joints_list.iter().map(|i| json!({"name": format!("joint {i}")})));
    draft.glb(json!({
        "scene": 0,
        "scenes": [{"nodes": [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]}],
        "nodes": nodes,
        "skins": [{"joints": joints_list, "inverseBindMatrices": matrices}],
        "animations": [{
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
            "samplers": [{"input": times, "output": moves}],
        }],
        "materials": [{"name": "paint"}],
        "extras": {"kept": [1, 2.5]},
        "meshes": [
            {"name": "figure", "weights": [0.25, 0.0], "primitives": [{
                "attributes": {
                    "POSITION": position, "NORMAL": normal, "TANGENT": tangent, "TEXCOORD_0": uv, "TEXCOORD_1": second_uv,
                    "COLOR_0": colour, "JOINTS_0": joints, "WEIGHTS_0": weights, "_HEAT": heat, "_FEATURE_ID_0": label,
                },
                "indices": strip, "mode": 5, "material": 0, "extras": {"x": 1},
                "targets": [{"POSITION": up, "NORMAL": turn}, {"POSITION": side}],
            }]},
            {"name": "plain", "primitives": [
                {"attributes": {"POSITION": position, "TEXCOORD_0": uv}, "indices": strip, "mode": 5, "material": 0},
                {"attributes": {"POSITION": position}, "indices": points, "mode": 0},
            ]},
        ],
    }))
}

fn open(main: Vec<u8>, format: Format) -> Model {
    Model::read(FileSet::single("model", main), Some(format), &Limits::default()).expect("readable")
}

/// The attributes of a primitive of a written file, by name.
fn attributes(parsed: &Parsed, primitive: &Value) -> BTreeMap<String, Vec<f64>> {
    let all = primitive.as_object().expect("attributes").iter();
    all.map(|(name, a)| (name.clone(), numbers(parsed, a.as_u64().expect("an index") as usize)))
        .collect()
}

#[test]
fn every_attribute_of_a_middle_is_between_those_of_its_ends() {
    let model = open(figure(), Format::GLB);
    assert_eq!(model.triangles, [[0, 1, 3], [1, 2, 3], [4, 7, 5], [5, 7, 6]]);
    let edited = Edited::of(&model, true);
    let written = edited.write(&model, Format::GLB).expect("writable");
    let parsed = parse(&written.main, &written.companions);
    let primitive = &parsed.json["meshes"][0]["primitives"][0];
    let all = attributes(&parsed, &primitive["attributes"]);
    // Middles in the order in which the strip's triangles have their edges: 0-1, 1-3, 3-0, 1-2, 2-3.
    let middle = |name: &str, i: usize, lanes: usize| all[name][(4 + i) * lanes..][..lanes].to_vec();
    let near = |seen: Vec<f64>, wanted: &[f64]| {
        let off = seen.iter().zip(wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(seen.len() == wanted.len() && off < 1e-6, "{seen:?} is not {wanted:?}");
    };
    near(middle("POSITION", 0, 3), &[0.5, 0.0, 0.25]);
    near(middle("NORMAL", 0, 3), &[0.0, 0.0, 1.0]);
    near(middle("TANGENT", 0, 4), &[1.0, 0.0, 0.0, -1.0]);
    near(middle("TEXCOORD_0", 3, 2), &[1.0, 0.5]);
    near(middle("TEXCOORD_1", 3, 2), &[1.0, 0.1]);
    near(middle("COLOR_0", 0, 4), &[0.5, 0.5, 0.0, 1.0]);
    near(middle("_HEAT", 4, 1), &[3.0]);
    near(middle("_FEATURE_ID_0", 3, 1), &[9.0]);
    assert!(
        [7.0, 9.0].contains(&middle("_FEATURE_ID_0", 0, 1)[0]),
        "an identifier is not blended"
    );
    // 0: joints 0 (¾) and 1 (¼); 1: joints 1 (½) and 2 (½).
    near(middle("JOINTS_0", 0, 4), &[0.0, 1.0, 2.0, 0.0]);
    near(middle("WEIGHTS_0", 0, 4), &[0.375, 0.375, 0.25, 0.0]);
    // 2: four joints of a quarter each; 3: joints 6 and 7. The two heaviest are kept, and the first of the rest.
    near(middle("JOINTS_0", 4, 4), &[6.0, 7.0, 2.0, 3.0]);
    near(middle("WEIGHTS_0", 4, 4), &[1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0]);
    for (target, name, i, wanted) in [
        (0, "POSITION", 3, [0.0, 0.0, 1.5]),
        (0, "NORMAL", 0, [0.25, 0.0, 0.0]),
        (1, "POSITION", 2, [1.0, 0.0, 0.0]),
    ] {
        let values = attributes(&parsed, &primitive["targets"][target]);
        near(values[name][(4 + i) * 3..][..3].to_vec(), &wanted);
    }
    assert_eq!(
        (&primitive["mode"], &primitive["material"], &primitive["extras"]),
        (&json!(4), &json!(0), &json!({"x": 1}))
    );
    assert_eq!(parsed.json["meshes"][0]["weights"], json!([0.25, 0.0]));
    for key in ["extras", "skins", "animations", "materials", "nodes", "scenes"] {
        let before: Value = parse(&figure(), &BTreeMap::new()).json[key].clone();
        let (seen, wanted) = (&parsed.json[key], before);
        let accessors = matches!(key, "skins" | "animations");
        assert!(
            accessors && seen.as_array().map(Vec::len) == wanted.as_array().map(Vec::len) || *seen == wanted,
            "{key}"
        );
    }
    let points = &parsed.json["meshes"][1]["primitives"][1];
    assert_eq!(points["mode"], 0);
    assert_eq!(
        attributes(&parsed, &points["attributes"])["POSITION"].len(),
        12,
        "points pass untouched"
    );

    let again = read_back(&written, Format::GLB);
    assert_eq!(again.triangles, edited.triangles);
    let off = largest_distance(&again.positions, &edited.positions);
    assert!(off < 1e-6, "{off}");
}

#[test]
fn a_mesh_that_lost_all_triangles_goes_with_its_reference_and_its_animation() {
    let model = open(figure(), Format::GLB);
    let mut edited = Edited::of(&model, false);
    edited.runs[0].triangle_count = 0;
    (edited.runs[1].first_triangle, edited.runs[2].first_triangle) = (0, 2);
    edited.triangles.drain(..2);
    let written = edited.write(&model, Format::GLB).expect("writable");
    let json = parse(&written.main, &written.companions).json;
    assert_eq!(json["nodes"][0], json!({"name": "skinned"}));
    assert_eq!(json["nodes"][1]["mesh"], 0);
    assert_eq!(json["meshes"].as_array().map(Vec::len), Some(1));
    assert!(json.get("animations").is_none());
    assert_eq!(read_back(&written, Format::GLB).triangles.len(), 2);

    edited.runs.truncate(1);
    edited.runs[0].vertex_count = 8;
    edited.triangles.clear();
    let refused = edited
        .write(&model, Format::GLB)
        .expect_err("nothing is left")
        .to_string();
    assert!(refused.contains("triangle"), "{refused}");
}

fn same_shape(seen: &Model, edited: &Edited, name: &str) {
    let (positions, triangles) = edited.as_read();
    assert_eq!(seen.positions.len(), positions.len(), "{name}");
    let tolerance = 1e-6 * size(&positions);
    let off = largest_distance(&seen.positions, &positions);
    assert!(off <= tolerance, "{name}: {off} is more than {tolerance}");
    assert!(seen.triangles == triangles, "{name}");
}

/// The square of [`figure`] alone, drawn by three nodes of the scene and by one that is outside of it.
fn instances(more: &Value) -> Vec<u8> {
    let mut draft = Draft::default();
    let position = draft.floats(
        &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
        "VEC3",
    );
    let uv = draft.floats(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], "VEC2");
    let indices = draft.add(&[0, 0, 1, 0, 2, 0, 0, 0, 2, 0, 3, 0], 5123, "SCALAR", 6, json!({}));
    let mut document = json!({
        "scene": 0,
        "scenes": [{"nodes": [0, 1, 2]}, {"nodes": [3]}],
        "nodes": [{"mesh": 0}, {"mesh": 0, "translation": [2, 0, 0]}, {"mesh": 0, "translation": [4, 0, 0]}, {"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": position, "TEXCOORD_0": uv}, "indices": indices}]}],
    });
    for (key, value) in more.as_object().expect("an object") {
        document[key] = value.clone();
    }
    draft.glb(document)
}

/// An edit that cuts the last triangle of the second node's square.
fn second_cut(model: &Model) -> Edited {
    let mut edited = Edited {
        runs: Vec::new(),
        recipes: pliant::asset::VertexBlends::identity(model.positions.len() as u32),
        triangles: model.triangles.clone(),
        positions: model.positions.clone(),
    };
    edited.triangles.remove(3);
    edited.runs = Edited::of(model, false).runs;
    edited.runs[1].triangle_count = 1;
    edited.runs[2].first_triangle = 3;
    edited
}

#[test]
fn only_the_nodes_that_were_edited_get_a_mesh_of_their_own() {
    let model = open(instances(&json!({})), Format::GLB);
    let edited = second_cut(&model);
    let written = edited.write(&model, Format::GLB).expect("writable");
    let json = parse(&written.main, &written.companions).json;
    let meshes = |json: &Value| -> Vec<Value> { list(&json["nodes"]).iter().map(|n| n["mesh"].clone()).collect() };
    assert_eq!(meshes(&json), [0, 1, 0, 0]);
    let (stored, cut) = (&json["meshes"][0]["primitives"][0], &json["meshes"][1]["primitives"][0]);
    assert_eq!(stored["attributes"]["TEXCOORD_0"], 1);
    assert_ne!(stored["indices"], cut["indices"]);
    same_shape(&read_back(&written, Format::GLB), &edited, "instances");

    // The same edit at all three nodes: one mesh for them, the old one for the node outside the scene.
    let all = Edited::of(&model, true);
    let written = all.write(&model, Format::GLB).expect("writable");
    let json = parse(&written.main, &written.companions).json;
    assert_eq!(meshes(&json), [1, 1, 1, 0]);
    same_shape(&read_back(&written, Format::GLB), &all, "all instances");
}

#[test]
fn numbers_stay_where_an_unknown_extension_may_name_them() {
    let known = json!({"extensionsUsed": ["KHR_materials_unlit"]});
    let unknown = json!({"extensionsUsed": ["EXT_structural_metadata"], "extensions": {"EXT_structural_metadata": {"propertyTables": []}}});
    for (more, kept) in [(known, false), (unknown, true)] {
        let document = instances(&more);
        let before = parse(&document, &BTreeMap::new());
        let model = open(document, Format::GLB);
        let mut edited = Edited::of(&model, true);
        // Without the node outside the scene nothing would use the old data.
        edited.positions.iter_mut().for_each(|p| p.z += 1.0);
        for format in [Format::GLB, Format::GLTF] {
            let written = edited.write(&model, format).expect("writable");
            let after = parse(&written.main, &written.companions);
            let list = |parsed: &Parsed, key: &str| parsed.json[key].as_array().expect("a list").clone();
            for key in ["accessors", "bufferViews"] {
                let same = list(&after, key).starts_with(&list(&before, key));
                assert!(same || !kept, "{key} of {format}");
            }
            assert_eq!(after.json["extensionsUsed"], before.json["extensionsUsed"]);
            same_shape(&read_back(&written, format), &edited, "kept");
        }
        let other = open(figure(), Format::GLB);
        edited.merge(&Edited::of(&other, true));
        let bases = [at_rest(&model), at_rest(&other)];
        let written = write_edited_model(&edited.remade(&bases), &edited.positions, Format::GLB).expect("writable");
        same_shape(&read_back(&written, Format::GLB), &edited, "merged");
        let json = parse(&written.main, &written.companions).json;
        assert_eq!(json["materials"], json!([{"name": "paint"}]));
    }
}

#[test]
fn compressed_and_quantised_files_come_back_as_floats_without_the_extensions() {
    let mut seen = 0;
    for (path, model) in real::models("compressed glTF files") {
        let before = parse(&model.files.main, &BTreeMap::new()).json;
        let uses = |json: &Value, name: &str| list(&json["extensionsUsed"]).iter().any(|e| e == name);
        let packed = [
            "EXT_meshopt_compression",
            "KHR_meshopt_compression",
            "KHR_mesh_quantization",
        ];
        if !packed.iter().any(|name| uses(&before, name)) {
            continue;
        }
        seen += 1;
        let written = Edited::of(&model, true).write(&model, Format::GLB).expect("writable");
        let after = parse(&written.main, &written.companions).json;
        for name in packed {
            assert!(!uses(&after, name), "{}: {name}", path.display());
        }
        assert!(!after.to_string().contains("meshopt"), "{}", path.display());
        assert_eq!(after["buffers"].as_array().map(Vec::len), Some(1));
    }
    if data_folder("compressed glTF files").is_some() {
        assert!(seen > 2, "only {seen} compressed models");
    }
}

#[test]
fn a_primitive_that_the_edit_left_alone_keeps_its_accessors() {
    let model = open(figure(), Format::GLB);
    let mut edited = Edited::of(&model, true);
    // The first primitive as it was, the second cut into four.
    let plain = Edited::of(&model, false);
    let (v, t) = (
        edited.runs[1].first_vertex as usize,
        edited.runs[1].first_triangle as usize,
    );
    let mut recipes = pliant::asset::VertexBlends::identity(4);
    (v..edited.positions.len()).for_each(|i| recipes.push_composed(&edited.recipes, &[(i as u32, 1.0)]));
    let shift = (v - 4) as u32;
    edited.triangles = (model.triangles[..2].iter().copied())
        .chain(edited.triangles[t..].iter().map(|t| t.map(|c| c - shift)))
        .collect();
    edited.positions.drain(4..v);
    (edited.recipes, edited.runs[0]) = (recipes, plain.runs[0]);
    (edited.runs[1].first_vertex, edited.runs[1].first_triangle) = (4, 2);
    let points = &mut edited.runs[2];
    points.first_vertex -= shift;
    points.first_triangle = edited.triangles.len() as u32;
    let (before, written) = (
        parse(&figure(), &BTreeMap::new()),
        edited.write(&model, Format::GLB).expect("writable"),
    );
    let after = parse(&written.main, &written.companions);
    let first = |parsed: &Parsed| parsed.json["meshes"][0]["primitives"][0].clone();
    assert_eq!(first(&after)["mode"], 5, "still a strip");
    for (name, old) in first(&before)["attributes"].as_object().expect("attributes") {
        let new = &first(&after)["attributes"][name];
        let accessor = |parsed: &Parsed, a: &Value| {
            let mut accessor = parsed.json["accessors"][a.as_u64().expect("an index") as usize].clone();
            accessor.as_object_mut().expect("an object").remove("bufferView");
            accessor
        };
        assert_eq!(accessor(&after, new), accessor(&before, old), "{name}");
    }
    same_shape(&read_back(&written, Format::GLB), &edited, "half");

    // Moved as well, it has new positions, normals and tangents, and the rest of its accessors.
    edited.positions[..4]
        .iter_mut()
        .for_each(|p| *p = DVec3::new(p.z, p.y, -p.x));
    let written = edited.write(&model, Format::GLB).expect("writable");
    let parsed = parse(&written.main, &written.companions);
    let all = attributes(&parsed, &first(&parsed)["attributes"]);
    assert_eq!(first(&parsed)["mode"], 5);
    assert!(
        all["NORMAL"].chunks(3).all(|n| (n[0] - 1.0).abs() < 1e-6),
        "{:?}",
        all["NORMAL"]
    );
    assert!(
        all["TANGENT"]
            .chunks(4)
            .all(|t| (t[2] + 1.0).abs() < 1e-6 && t[3] == -1.0)
    );
    same_shape(&read_back(&written, Format::GLB), &edited, "half and moved");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Files that say odd things and are read all the same are written after an edit, or refused; nothing panics.
    #[test]
    fn odd_files_never_panic(
        seed in 0usize..2,
        digits in prop::collection::vec((any::<u32>(), 0u8..10), 1..4),
        merged in any::<bool>(),
    ) {
        let mut bytes = if seed == 0 { figure() } else { instances(&json!({})) };
        let length = u32::from_le_bytes(bytes[12..16].try_into().expect("four")) as usize;
        let places: Vec<usize> = (20..20 + length).filter(|&i| bytes[i].is_ascii_digit()).collect();
        for (at, digit) in digits {
            bytes[places[at as usize % places.len()]] = b'0' + digit;
        }
        let Ok(model) = Model::read(FileSet::single("odd", bytes), Some(Format::GLB), &Limits::default()) else {
            return Ok(());
        };
        let mut edited = Edited::of(&model, true);
        let figure = open(figure(), Format::GLB);
        let bases = if merged {
            let mut first = Edited::of(&figure, false);
            first.merge(&edited);
            edited = first;
            vec![at_rest(&figure), at_rest(&model)]
        } else {
            vec![at_rest(&model)]
        };
        for format in [Format::GLB, Format::GLTF, Format::OBJ] {
            if let Ok(written) = write_edited_model(&edited.remade(&bases), &edited.positions, format) {
                prop_assert_eq!(read_back(&written, format).triangles.len(), edited.triangles.len());
            }
        }
    }
}
