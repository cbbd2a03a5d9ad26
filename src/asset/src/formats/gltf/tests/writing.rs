//! What a changed file looks like, to the byte, and what of it is shared.

use super::*;
use crate::{BaseModel, CapLooks, EditedModel, PrimitiveRun, VertexBlends};
use glam::DAffine3;

#[test]
fn text_outside_the_changed_places_stays_to_the_character() {
    let mut draft = DocumentDraft::default();
    let view = draft.view(&bytes_of(&SQUARE), "");
    draft.accessor(
        view,
        5126,
        4,
        "VEC3",
        r#", "max" : [ 1,1.0,0e0 ],"min":[0,0,-0.0] ,"extras":{"é":1.50}"#,
    );
    let indices = draft.indices(&CORNERS);
    let primitive = format!(r#"{{"attributes":{{"POSITION":0}} , "indices":{indices},"x":1,"x":2}}"#);
    let files = draft.glb(&format!(
        r#""zebra":[ 1E2,"\u00e9\/" ],{},"extras":{{}}"#,
        one(&primitive)
    ));

    let written = moved(&files, |i, p| if i == 2 { p + DVec3::new(0.1, 0.0, 2.0) } else { p });
    let expected = text(&files.main)
        .replace("[ 1,1.0,0e0 ]", "[1.100000023841858,1.0,2.0]")
        .replace("[0,0,-0.0]", "[0.0,0.0,0.0]");
    assert_eq!(text(&written.main), expected);

    let (before, after) = (bin(&files.main), bin(&written.main));
    let changed: Vec<usize> = (0..before.len()).filter(|&i| before[i] != after[i]).collect();
    assert_eq!(before.len(), after.len());
    assert!(
        !changed.is_empty() && changed.iter().all(|i| (24..36).contains(i)),
        "vertex 2 only, not {changed:?}"
    );
}

#[test]
fn bounds_read_back_as_the_same_floats_and_are_added_where_missing() {
    let draft = square_draft();
    let files = draft.glb(&one(PLAIN));
    let odd = DVec3::new(1.0 / 3.0, 1e-30, -1e20);
    let written = moved(&files, |i, p| if i == 0 { odd } else { p });
    let accessor = &json(&written)["accessors"][0];
    let floats = |key: &str| -> Vec<f32> {
        accessor[key]
            .as_array()
            .expect("bounds")
            .iter()
            .map(|v| v.to_string().parse().expect("a number"))
            .collect()
    };
    assert_eq!(floats("min"), [0.0, 0.0, -1e20]);
    assert_eq!(floats("max"), [1.0, 1.0, 0.0]);
    assert_eq!(open(&again(&written)).positions[0], odd.as_vec3().as_dvec3());
}

#[test]
fn interleaved_attributes_are_overwritten_between_the_others() {
    let mut draft = DocumentDraft::default();
    let vertices: Vec<u8> = (0..4)
        .flat_map(|i| [&bytes_of(&SQUARE[i..=i])[..], &bytes_of(&UP[..1]), b"uvuvuvuv"].concat())
        .collect();
    let view = draft.view(&vertices, r#","byteStride":32"#);
    draft.accessor(view, 5126, 4, "VEC3", "");
    draft.accessor(view, 5126, 4, "VEC3", r#","byteOffset":12"#);
    draft.accessor(view, 5126, 4, "VEC2", r#","byteOffset":24"#);
    draft.indices(&CORNERS);
    let files = draft.glb(&one(
        r#"{"attributes":{"POSITION":0,"NORMAL":1,"TEXCOORD_0":2},"indices":3}"#,
    ));
    let written = moved(&files, |_, p| DVec3::new(-p.x, p.z, p.y));
    let after = bin(&written.main);
    assert_eq!(after.len(), bin(&files.main).len(), "all in place");
    assert!(after[..128].chunks(32).all(|vertex| &vertex[24..] == b"uvuvuvuv"));
    let geometry = open(&again(&written));
    assert_eq!(geometry.positions[2], DVec3::new(-1.0, 0.0, 1.0));
    assert!(
        geometry.normals.iter().all(|n| (n.y - 1.0).abs() < 1e-6),
        "{:?}",
        geometry.normals
    );
    assert_eq!(count(&written, "accessors"), 4);
}

#[test]
fn a_translation_leaves_normals_alone() {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    let tilted = [
        [0.36, 0.48, 0.8],
        [-0.6, 0.0, 0.8],
        [0.0, 0.0, 1.0],
        [0.1, 0.2, 0.974_679_5],
    ];
    draft.points(&tilted);
    draft.indices(&CORNERS);
    let files = draft.glb(&one(r#"{"attributes":{"POSITION":0,"NORMAL":1},"indices":2}"#));
    let written = moved(&files, |_, p| p + DVec3::new(0.1, 0.7, -1.3));
    assert_eq!(bin(&written.main)[48..96], bin(&files.main)[48..96]);
}

#[test]
fn sparse_positions_become_an_accessor_of_their_own() {
    let mut draft = DocumentDraft::default();
    let base = draft.view(&bytes_of(&SQUARE), "");
    let at = draft.view(&[1, 3], "");
    let to = draft.view(&bytes_of(&[[2.0, 0.0, 0.0], [0.0, 3.0, 0.0]]), "");
    let sparse = format!(
        r#","sparse":{{"count":2,"indices":{{"bufferView":{at},"componentType":5121}},"values":{{"bufferView":{to}}}}}"#
    );
    draft.accessor(base, 5126, 4, "VEC3", &sparse);
    draft.indices(&CORNERS);
    let files = draft.glb(&one(PLAIN));
    let rest = open(&files);
    assert_eq!(rest.positions[1], DVec3::new(2.0, 0.0, 0.0));
    assert_eq!(rest.positions[3], DVec3::new(0.0, 3.0, 0.0));

    let written = moved(&files, |_, p| p + DVec3::Z);
    let (before, after) = (bin(&files.main), bin(&written.main));
    assert_eq!(after[..before.len()], before[..], "the old data stays");
    assert_eq!(
        json(&written)["meshes"][0]["primitives"][0]["attributes"]["POSITION"],
        2
    );
    assert_eq!(json(&written)["accessors"][0]["sparse"]["count"], 2);
    assert_eq!(
        json(&written)["accessors"][2]["max"],
        serde_json::json!([2.0, 3.0, 1.0])
    );
    assert_eq!(open(&again(&written)).positions[3], DVec3::new(0.0, 3.0, 1.0));
}

#[test]
fn quantised_positions_come_back_as_floats() {
    let mut draft = DocumentDraft::default();
    let steps: Vec<u8> = SQUARE
        .iter()
        .flat_map(|p| [p[0] as u8 * 255, p[1] as u8 * 51, 0, 0])
        .collect();
    let view = draft.view(&steps, r#","byteStride":4"#);
    draft.accessor(view, 5121, 4, "VEC3", r#","normalized":true"#);
    draft.indices(&CORNERS);
    let body = one(PLAIN);
    let files = draft.glb(&format!(r#""extensionsUsed":["KHR_mesh_quantization"],{body}"#));
    let rest = open(&files);
    assert_eq!(rest.positions[2], DVec3::new(1.0, f64::from(0.2_f32), 0.0));

    let written = moved(&files, |i, p| if i == 0 { p - DVec3::Y } else { p });
    let after = open(&again(&written));
    assert_eq!(
        after.positions[1..],
        rest.positions[1..],
        "unmoved vertices keep their values"
    );
    assert_eq!(after.positions[0], DVec3::new(0.0, -1.0, 0.0));
    assert_eq!(json(&written)["accessors"][2]["componentType"], 5126);
    assert!(
        refusal(&draft.glb(&body)).contains("KHR_mesh_quantization"),
        "only with the extension"
    );
}

#[test]
fn quantised_normals_and_tangents_come_back_at_unit_length() {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    // Of lengths from 0.996 to 1.004.
    let normals = [[13i8, 0, 126, 0], [0, 30, 123, 0], [40, 40, 114, 0], [0, 0, 127, 0]];
    let tangents = [
        [126i8, 3, 0, 127],
        [123, -30, 0, -127],
        [90, 90, 0, 127],
        [127, 0, 0, 127],
    ];
    for (values, shape) in [(normals, "VEC3"), (tangents, "VEC4")] {
        let bytes: Vec<u8> = values.as_flattened().iter().map(|v| *v as u8).collect();
        let view = draft.view(&bytes, r#","byteStride":4"#);
        draft.accessor(view, 5120, 4, shape, r#","normalized":true"#);
    }
    draft.indices(&CORNERS);
    let body = one(r#"{"attributes":{"POSITION":0,"NORMAL":1,"TANGENT":2},"indices":3}"#);
    let files = draft.glb(&format!(r#""extensionsUsed":["KHR_mesh_quantization"],{body}"#));
    let written = moved(&files, |i, p| if i == 0 { p + DVec3::Z } else { p });
    let document = json(&written);
    let attributes = &document["meshes"][0]["primitives"][0]["attributes"];
    for (name, lanes) in [("NORMAL", 3), ("TANGENT", 4)] {
        let accessor = index(&attributes[name]);
        assert_eq!(document["accessors"][accessor]["componentType"], 5126, "{name}");
        let values = floats_of(&written, accessor);
        for element in values.chunks(lanes) {
            let length = glam::Vec3::from_slice(element).length();
            assert!((length - 1.0).abs() < 1e-6, "{name} {element:?}: {length}");
            assert!(lanes == 3 || element[3].abs() == 1.0, "{element:?}");
        }
    }
}

#[test]
fn an_invalid_normal_is_kept_until_its_primitive_changes() {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.points(&[[f32::NAN, 0.0, 0.0], [0.0; 3], UP[0], UP[0]]);
    let plain = [1.0, 0.0, 0.0, 1.0];
    let odd = [0.0, f32::INFINITY, 0.0, 1.0];
    draft.elements(&[[1.0, 0.0, 0.0, -1.0], odd, plain, plain], "VEC4", "");
    draft.indices(&CORNERS);
    let files = draft.glb(&one(
        r#"{"attributes":{"POSITION":0,"NORMAL":1,"TANGENT":2},"indices":3}"#,
    ));
    let rest = open(&files);
    assert!(rest.normals.iter().all(|n| n.is_finite()) && rest.tangents.iter().all(|t| t.is_finite()));
    let codes: Vec<&str> = rest.warnings.iter().map(|w| w.0.as_str()).collect();
    assert_eq!(codes, ["bad-normal", "bad-tangent"]);

    assert_eq!(moved(&files, |_, p| p).main, files.main);
    let written = moved(&files, |i, p| if i == 2 { p + DVec3::Z } else { p });
    let stored = bin(&written.main);
    assert!(floats_in(&stored[48..160]).iter().all(|v| v.is_finite()));
    assert_eq!(open(&again(&written)).tangents[0].w, -1.0, "handedness is kept");
}

#[test]
fn a_stale_draco_copy_is_dropped_where_the_mesh_changed() {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.points(&SQUARE);
    draft.indices(&CORNERS);
    let packed = draft.view(b"draco", "");
    let draco = format!(r#""KHR_draco_mesh_compression":{{"bufferView":{packed},"attributes":{{"POSITION":0}}}}"#);
    let primitives = format!(
        r#"{{"attributes":{{"POSITION":0}},"indices":2,"extensions":{{{draco}}}}},{{"attributes":{{"POSITION":1}},"indices":2,"extensions":{{{draco},"X_y":{{}}}}}}"#
    );
    let files = draft.glb(&format!(
        r#""extensionsUsed":["KHR_draco_mesh_compression"],{}"#,
        one(&primitives)
    ));
    let primitives = |written: &WrittenFiles| json(written)["meshes"][0]["primitives"].clone();
    let first = primitives(&moved(&files, |i, p| if i < 4 { p + DVec3::Z } else { p }));
    assert!(first[0].get("extensions").is_none());
    assert!(first[1]["extensions"]["KHR_draco_mesh_compression"].is_object());
    let second = primitives(&moved(&files, |i, p| if i >= 4 { p + DVec3::Z } else { p }));
    assert_eq!(second[1]["extensions"], serde_json::json!({"X_y": {}}));

    let required = draft.json(
        &format!(
            r#""extensionsRequired":["KHR_draco_mesh_compression"],{}"#,
            one(&format!(
                r#"{{"attributes":{{"POSITION":0}},"indices":2,"extensions":{{{draco}}}}}"#
            ))
        ),
        "",
    );
    // Only Draco holds its triangles, and the buffer with it is not there.
    let refused = refusal(&FileSet::single("a.gltf", required));
    assert!(refused.contains("buffers/0"), "{refused}");
}

#[test]
fn positions_that_do_not_fit_are_refused() {
    let draft = square_draft();
    let files = draft.glb(&one(PLAIN));
    let text = try_moved(&files, |i, p| if i == 1 { DVec3::splat(1e300) } else { p })
        .expect_err("too far")
        .to_string();
    assert!(text.contains("vertex 1") && text.contains("32-bit"), "{text}");
    let text = try_moved(&files, |_, _| DVec3::NAN)
        .expect_err("not finite")
        .to_string();
    assert!(text.contains("vertex 0"), "{text}");
    let text = open(&files).write(&[], Format::GLB).expect_err("none").to_string();
    assert!(text.contains("0 positions") && text.contains("4 vertices"), "{text}");
}

fn square_under(nodes: &str, scene: &str) -> FileSet {
    let draft = square_draft();
    draft.glb(&format!(
        r#""scene":0,"scenes":[{{"nodes":[{scene}]}}],"nodes":[{nodes}],"meshes":[{{"name":"m","primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}]"#
    ))
}

#[test]
fn instances_part_only_when_their_shapes_differ() {
    let files = square_under(
        r#"{"mesh":0},{"mesh":0,"translation":[5,0,0]},{"mesh":0,"rotation":[0,0,1,0]}"#,
        "0,1,2",
    );
    let alike = json(&moved(&files, |_, p| p + DVec3::Z));
    assert_eq!(
        alike["meshes"].as_array().map(Vec::len),
        Some(1),
        "all three moved alike"
    );
    assert_eq!(alike["accessors"].as_array().map(Vec::len), Some(2), "in place");

    let written = moved(&files, |i, p| if i < 4 { p } else { p + DVec3::Z * p.x.abs() });
    let parted = json(&written);
    let meshes = [0, 1, 2].map(|node: usize| index(&parted["nodes"][node]["mesh"]));
    assert_eq!(
        (count(&written, "nodes"), meshes),
        (3, [0, 1, 2]),
        "the first keeps the mesh"
    );
    assert_eq!(parted["meshes"][1]["name"], "m");
    let (rest, after) = (open(&files), open(&again(&written)));
    assert_eq!(after.positions[..4], rest.positions[..4]);
    for (i, (p, q)) in rest.positions.iter().zip(&after.positions).enumerate().skip(4) {
        assert!((*p + DVec3::Z * p.x.abs() - *q).length() < 1e-6, "vertex {i}");
    }
    assert_eq!(
        bin(&files.main)[..48],
        bin(&written.main)[..48],
        "the first still reads the old bytes"
    );
}

/// The square with a line along its diagonal, drawn by nodes of their own or one.
fn square_and_line(nodes: &str, scene: &str, meshes: &[&str]) -> FileSet {
    let mut draft = square_draft();
    draft.points(&[SQUARE[0], SQUARE[2]]);
    let meshes: Vec<String> = meshes.iter().map(|p| format!(r#"{{"primitives":[{p}]}}"#)).collect();
    draft.glb(&format!(
        r#""scene":0,"scenes":[{{"nodes":[{scene}]}}],"nodes":[{nodes}],"meshes":[{}]"#,
        meshes.join(",")
    ))
}

const LINE: &str = r#"{"attributes":{"POSITION":2},"mode":3}"#;

#[test]
fn instances_with_lines_part_only_when_their_shapes_differ() {
    for primitives in [format!("{PLAIN},{LINE}"), format!("{LINE},{PLAIN}")] {
        let nodes = r#"{"mesh":0},{"mesh":0,"translation":[5,0,0]}"#;
        let files = square_and_line(nodes, "0,1", &[&primitives]);
        let alike = json(&moved(&files, |_, p| p + DVec3::Z));
        assert_eq!(alike["meshes"].as_array().map(Vec::len), Some(1));
        assert_eq!(alike["accessors"].as_array().map(Vec::len), Some(3), "in place");

        let stretched = |p: DVec3| p + DVec3::Z * p.x;
        let written = moved(&files, |_, p| stretched(p));
        assert_eq!((count(&written, "nodes"), count(&written, "meshes")), (2, 2));
        let (rest, after) = (open(&files), open(&again(&written)));
        assert_eq!(rest.positions.len(), 12);
        for (i, (p, q)) in rest.positions.iter().zip(&after.positions).enumerate() {
            assert!((stretched(*p) - *q).length() < 1e-6, "vertex {i}");
        }
    }
}

#[test]
fn only_triangles_under_a_flattening_node_are_refused() {
    let nodes = r#"{"mesh":0},{"mesh":1,"scale":[1,1,0]},{"mesh":1}"#;
    let files = square_and_line(nodes, "0,1,2", &[PLAIN, LINE]);
    let rest = open(&files);
    assert_eq!(
        rest.warnings
            .iter()
            .filter(|(code, ..)| code == "singular-transform")
            .count(),
        1
    );
    let after = open(&again(&moved(&files, |_, p| p + DVec3::Z)));
    let moves: Vec<f64> = rest
        .positions
        .iter()
        .zip(&after.positions)
        .map(|(p, q)| (*q - *p).z)
        .collect();
    assert_eq!(moves, [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0]);

    let runs: Vec<PrimitiveRun> = (0u32..)
        .zip(&rest.primitives)
        .map(|(primitive, p)| PrimitiveRun {
            base: 0,
            primitive,
            first_vertex: p.first_vertex,
            vertex_count: p.vertex_count,
            first_triangle: if primitive == 0 { 0 } else { 1 },
            triangle_count: u32::from(primitive == 0),
        })
        .collect();
    let edited = EditedModel {
        bases: &[BaseModel {
            model: &rest,
            world_from_model: DAffine3::IDENTITY,
        }],
        runs: &runs,
        blends: &VertexBlends::identity(8),
        triangles: &rest.triangles[..1],
        origins: &[],
        bare: &[],
        caps: CapLooks::default(),
    };
    let now = places_of(&rest, |_, p| p + DVec3::Z);
    let written = crate::write_edited_model(&edited, &now, Format::GLB).expect("writable");
    assert_eq!(open(&again(&written)).positions, after.positions);

    let files = square_and_line(nodes, "0,1,2", &[LINE, PLAIN]);
    let refused = try_moved(&files, |_, p| p + DVec3::Z).expect_err("flat").to_string();
    assert!(refused.contains("node 1") && refused.contains("flattens"), "{refused}");
}

#[test]
fn two_of_three_instances_may_share_the_new_shape() {
    let files = square_under(
        r#"{"mesh":0},{"mesh":0,"translation":[5,0,0]},{"mesh":0,"translation":[9,0,0]}"#,
        "0,1,2",
    );
    let parted = json(&moved(&files, |i, p| if i < 4 { p } else { p + DVec3::Z }));
    assert_eq!(parted["meshes"].as_array().map(Vec::len), Some(2));
    assert_eq!(
        (&parted["nodes"][1]["mesh"], &parted["nodes"][2]["mesh"]),
        (&1.into(), &1.into())
    );
    assert_eq!(parted["accessors"].as_array().map(Vec::len), Some(3));
}

#[test]
fn nodes_outside_the_scene_keep_the_old_shape() {
    let files = square_under(r#"{"mesh":0},{"mesh":0}"#, "1");
    let written = moved(&files, |_, p| p + DVec3::Z);
    let parted = json(&written);
    assert_eq!(
        (&parted["nodes"][0]["mesh"], &parted["nodes"][1]["mesh"]),
        (&1.into(), &0.into())
    );
    let position = |mesh: usize| parted["meshes"][mesh]["primitives"][0]["attributes"]["POSITION"].clone();
    assert_eq!((position(1), position(0)), (0.into(), 2.into()));
    assert_eq!(bin(&files.main)[..48], bin(&written.main)[..48]);
}

/// Two halves of one square that share its vertices, as levels of detail and material splits do.
fn halves() -> FileSet {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.indices(&CORNERS[..3]);
    draft.indices(&CORNERS[3..]);
    draft.glb(&one(
        r#"{"attributes":{"POSITION":0},"indices":1},{"attributes":{"POSITION":0},"indices":2}"#,
    ))
}

#[test]
fn halves_that_agree_where_they_meet_share_on() {
    let files = halves();
    // Each half moves what it draws: vertex 1 is drawn by the first only, vertex 3 by the second only.
    let written = moved(&files, |i, p| if [1, 4 + 3].contains(&i) { p + DVec3::Z } else { p });
    assert_eq!(count(&written, "accessors"), 3, "in place");
    let stored = open(&again(&written)).geometry.positions;
    let heights = [0.0, 1.0, 0.0, 1.0].into_iter().zip(&SQUARE);
    let expected: Vec<DVec3> = heights.map(|(z, p)| DVec3::new(p[0].into(), p[1].into(), z)).collect();
    assert_eq!(stored[..4], expected);
}

#[test]
fn halves_that_disagree_part() {
    let files = halves();
    // Vertex 2 is drawn by both; the second half leaves it where it was.
    let written = moved(&files, |i, p| if i == 2 { p + DVec3::Z } else { p });
    let after = json(&written);
    let attribute = |p: usize| after["meshes"][0]["primitives"][p]["attributes"]["POSITION"].clone();
    assert_eq!((attribute(0), attribute(1)), (3.into(), 0.into()));
    let stored = open(&again(&written)).geometry.positions;
    assert_eq!((stored[2].z, stored[4 + 2].z), (1.0, 0.0));
}

#[test]
fn bytes_that_others_use_are_not_overwritten() {
    let users = [
        // A morph target, an animation, another attribute, an image, a view of something unknown.
        (r#","targets":[{"POSITION":0}]"#, ""),
        (
            "",
            r#","animations":[{"samplers":[{"input":9,"output":0}],"channels":[]}]"#,
        ),
        ("", r#","images":[{"bufferView": 0 ,"mimeType":"image/png"}]"#),
        ("", r#","extensions":{"X_any":{"bufferView":0}}"#),
    ];
    for (primitive, root) in users {
        let draft = square_draft();
        let primitive = format!(r#"{{"attributes":{{"POSITION":0}},"indices":1{primitive}}}"#);
        let files = draft.glb(&format!("{}{root}", one(&primitive)));
        let written = moved(&files, |_, p| p + DVec3::Z);
        assert_eq!(
            bin(&files.main)[..],
            bin(&written.main)[..bin(&files.main).len()],
            "{primitive} {root}"
        );
        assert_eq!(
            json(&written)["meshes"][0]["primitives"][0]["attributes"]["POSITION"],
            2
        );
    }
    // A second view over the same bytes that nothing is known to read.
    let mut draft = square_draft();
    draft
        .views
        .push(r#"{"buffer":0,"byteOffset":44,"byteLength":8}"#.into());
    let files = draft.glb(&one(PLAIN));
    assert_eq!(
        bin(&files.main)[..48],
        bin(&moved(&files, |_, p| p + DVec3::Z).main)[..48]
    );
}
