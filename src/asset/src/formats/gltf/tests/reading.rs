//! Where vertices are in the world, which triangles there are, and where buffers are kept.

use super::*;
use crate::neutral::NeutralModel;
use glam::Vec4;

fn square(node: &str, more: &str) -> FileSet {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.points(&[[1.0, 0.0, 0.0]; 4]);
    draft.elements(&[[0.0, 0.0, 1.0, 1.0]; 4], "VEC4", "");
    draft.indices(&CORNERS);
    draft.glb(&format!(
        r#""scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0{node}}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":1,"TANGENT":2}},"indices":3}}]}}]{more}"#
    ))
}

#[test]
fn a_mirrored_mesh_is_outside_out() {
    let files = square(r#","scale":[-2,1,1]"#, "");
    let geometry = open(&files);
    assert_eq!(geometry.positions[1], DVec3::new(-2.0, 0.0, 0.0));
    assert_eq!(geometry.triangles, [[0, 2, 1], [0, 3, 2]]);
    assert_eq!(geometry.normals[0], Vec3::NEG_X);
    // The bitangent is (0, -1, 0) times w before and after.
    assert_eq!(geometry.tangents[0], Vec4::new(0.0, 0.0, 1.0, -1.0));

    let written = moved(&files, |_, p| DVec3::new(p.x, -p.z, p.y));
    let again = open(&again(&written));
    assert_eq!(again.triangles, geometry.triangles);
    assert_eq!(again.positions[2], DVec3::new(-2.0, 0.0, 1.0));
    assert!((again.normals[0] - Vec3::NEG_X).length() < 1e-6);
    assert!((again.tangents[0] - Vec4::new(0.0, -1.0, 0.0, -1.0)).length() < 1e-6);
    let stored = bin(&written.main);
    assert_eq!(floats_in(&stored[96 + 12..96 + 16]), [1.0], "stored handedness");
}

#[test]
fn a_skinned_mesh_ignores_its_node() {
    let files = square(r#","translation":[7,7,7],"skin":0"#, r#","skins":[{"joints":[0]}]"#);
    let geometry = open(&files);
    assert_eq!(geometry.positions[2], DVec3::new(1.0, 1.0, 0.0));
    let written = moved(&files, |_, p| p + DVec3::X);
    assert_eq!(open(&again(&written)).positions[2], DVec3::new(2.0, 1.0, 0.0));
}

#[test]
fn transforms_multiply_down_the_tree_and_rotations_need_not_be_of_unit_length() {
    let draft = square_draft();
    let body = concat!(
        r#""scenes":[{"nodes":[2]},{"nodes":[2,3]}],"nodes":[{"name":"leaf","mesh":0,"translation":[1,0,0]},"#,
        r#"{"children":[0],"rotation":[0,0,7,7]},{"children":[1],"matrix":[2,0,0,0, 0,2,0,0, 0,0,2,0, 10,0,0,1]},{"mesh":0}],"#,
        r#""meshes":[{"name":"plate","primitives":[{"attributes":{"POSITION":0},"indices":1}]}]"#
    );
    let geometry = open(&draft.glb(body));
    // Out by one, a quarter turn about z, twice as large, shifted by ten.
    assert!((geometry.positions[1] - DVec3::new(10.0, 4.0, 0.0)).length() < 1e-12);
    let rows: Vec<_> = geometry
        .primitives
        .iter()
        .map(|p| (p.node, p.name.as_str(), p.first_vertex))
        .collect();
    assert_eq!(rows, [(0, "leaf", 0), (3, "plate", 4)], "all scenes, each node once");
}

#[test]
fn strips_and_fans_become_triangles_of_the_same_side() {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.indices(&[0, 1, 3, 2]);
    draft.indices(&[0, 1, 2, 3]);
    draft.indices(&[0, 1, 3, 3, 1, 1, 1, 2, 3]);
    let primitive = |indices, mode| format!(r#"{{"attributes":{{"POSITION":0}},"indices":{indices},"mode":{mode}}}"#);
    let all = [
        primitive(1, 5),
        primitive(2, 6),
        primitive(3, 5),
        primitive(2, 3),
        primitive(2, 0),
    ]
    .join(",");
    let geometry = open(&draft.glb(&one(&all)));
    let sides: Vec<f64> = geometry
        .triangles
        .iter()
        .map(|t| t.map(|v| geometry.positions[v as usize]))
        .map(|[a, b, c]| (b - a).cross(c - a).z)
        .collect();
    assert_eq!(sides, [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
    let corners: Vec<u32> = geometry.primitives.iter().map(|p| p.index_count).collect();
    assert_eq!(
        corners,
        [6, 6, 6, 0, 0],
        "points and lines come behind all others, stitches are not triangles"
    );
}

#[test]
fn all_quantised_types_follow_the_rules_of_normalisation() {
    let cases: [(u32, &str, Vec<u8>, [f64; 3]); 8] = [
        (5120, "true", vec![0x81, 0x80, 0x7f, 0], [-1.0, -1.0, 1.0]),
        (5120, "false", vec![0x81, 0x80, 0x7f, 0], [-127.0, -128.0, 127.0]),
        (
            5121,
            "true",
            vec![0, 255, 51, 0],
            [0.0, 1.0, f64::from(51.0_f32 / 255.0)],
        ),
        (5121, "false", vec![0, 255, 51, 0], [0.0, 255.0, 51.0]),
        (
            5122,
            "true",
            vec![1, 0x80, 0, 0x80, 0xff, 0x7f, 0, 0],
            [-1.0, -1.0, 1.0],
        ),
        (
            5122,
            "false",
            vec![1, 0x80, 0, 0x80, 0xff, 0x7f, 0, 0],
            [-32767.0, -32768.0, 32767.0],
        ),
        (5123, "true", vec![0xff, 0xff, 0, 0, 0, 0, 0, 0], [1.0, 0.0, 0.0]),
        (5123, "false", vec![0xff, 0xff, 1, 0, 0, 1, 0, 0], [65535.0, 1.0, 256.0]),
    ];
    for (component, normalized, element, expected) in cases {
        let mut draft = DocumentDraft::default();
        let view = draft.view(&element.repeat(3), &format!(r#","byteStride":{}"#, element.len()));
        draft.accessor(view, component, 3, "VEC3", &format!(r#","normalized":{normalized}"#));
        let files = draft.glb(&format!(
            r#""extensionsUsed":["KHR_mesh_quantization"],{}"#,
            one(r#"{"attributes":{"POSITION":0}}"#)
        ));
        assert_eq!(
            open(&files).positions[0],
            DVec3::from_array(expected),
            "{component} {normalized}"
        );
    }
}

#[test]
fn versions_and_extensions_decide_what_is_read() {
    let draft = square_draft();
    let body = one(PLAIN);
    let with = |asset: &str, more: &str| {
        let uri = format!(r#","uri":"{}""#, super::super::buffers::embed(&draft.bin));
        let json = draft
            .json(&format!("{more}{body}"), &uri)
            .replace(r#"{"version":"2.0"}"#, asset);
        Model::read(FileSet::single("a.gltf", json), Some(Format::GLTF), &Limits::default())
            .map(drop)
            .map_err(|e| e.to_string())
    };
    let neutral = r#"{"version":"2.0"}"#;
    for asset in [
        neutral,
        r#"{"version":"2.1"}"#,
        r#"{"version":"2.1","minVersion":"2.0"}"#,
    ] {
        assert_eq!(with(asset, ""), Ok(()), "{asset}");
    }
    let refused = [
        r#"{"version":"2.1","minVersion":"2.1"}"#,
        r#"{"version":"2.0","minVersion":"2.1"}"#,
        r#"{"version":"1.0"}"#,
        r#"{"version":"3.0"}"#,
        r#"{"version":"2"}"#,
        r#"{"version":2.0}"#,
        "{}",
    ];
    for asset in refused {
        let text = with(asset, "").expect_err(asset);
        assert!(text.contains("asset"), "{text}");
    }
    for harmless in [
        "KHR_materials_unlit",
        "KHR_texture_basisu",
        "EXT_texture_webp",
        "KHR_lights_punctual",
    ] {
        assert_eq!(
            with(neutral, &format!(r#""extensionsRequired":["{harmless}"],"#)),
            Ok(())
        );
    }
    let text = with(neutral, r#""extensionsRequired":["KHR_x","ACME_zipped_geometry"],"#).expect_err("unknown");
    assert!(
        text.contains("KHR_x") && text.contains("extensionsRequired/0"),
        "{text}"
    );
}

#[test]
fn instances_on_the_gpu_are_reported_and_their_data_is_left_alone() {
    let more = r#","extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":0}}}"#;
    let files = square(more, "");
    let codes: Vec<String> = open(&files).geometry.warnings.into_iter().map(|w| w.0).collect();
    assert_eq!(codes, ["gpu-instances"]);
    let written = moved(&files, |_, p| p + DVec3::Z);
    assert_eq!(
        bin(&written.main)[..48],
        bin(&files.main)[..48],
        "the instances' translations stay"
    );
}

/// A .gltf whose buffer is the companion "my data.bin", and one that nothing names.
fn separate() -> FileSet {
    let draft = square_draft();
    let mut files = FileSet::single("a.gltf", draft.json(&one(PLAIN), r#","uri":"my%20data.bin""#));
    let longer = [&draft.bin[..], b"more than declared"].concat();
    files.companions.insert("my data.bin".into(), longer.into());
    files.companions.insert("picture.png".into(), "png".into());
    files
}

fn convert(files: &FileSet, format: Format, shift: DVec3) -> WrittenFiles {
    let model = open(files);
    let positions: Vec<DVec3> = model.positions.iter().map(|&p| p + shift).collect();
    model.write(&positions, format).expect("writable")
}

#[test]
fn a_changed_companion_is_returned_under_its_name_and_the_others_as_they_were() {
    let files = separate();
    let written = convert(&files, Format::GLTF, DVec3::Z);
    assert_eq!(written.companions["picture.png"], b"png");
    let (before, after) = (&files.companions["my data.bin"], &written.companions["my data.bin"]);
    assert_eq!((after.len(), &after[48..]), (before.len(), &before[48..]));
    assert_ne!(after[..48], before[..48]);
    assert_eq!(open(&again(&written)).positions[0], DVec3::Z);
}

#[test]
fn the_first_buffer_moves_into_the_chunk_and_out_of_it() {
    let files = separate();
    for shift in [DVec3::ZERO, DVec3::Z] {
        let glb = convert(&files, Format::GLB, shift);
        assert_eq!(glb.companions.keys().collect::<Vec<_>>(), ["picture.png"]);
        assert_eq!(
            bin(&glb.main).len(),
            square_draft().bin.len(),
            "what was not declared is left out"
        );
        assert_eq!(open(&again(&glb)).positions[3], DVec3::Y + shift);
        let gltf = convert(&again(&glb), Format::GLTF, DVec3::ZERO);
        assert_eq!(open(&again(&gltf)).positions[3], DVec3::Y + shift);
        assert!(
            json(&gltf)["buffers"][0]["uri"]
                .as_str()
                .is_some_and(|uri| uri.starts_with("data:"))
        );
    }
    // There and back, the text differs in the buffer only.
    let neutral = text(&convert(&files, Format::GLB, DVec3::ZERO).main);
    assert_eq!(neutral, text(&files.main).replace(r#","uri":"my%20data.bin""#, ""));
}

#[test]
fn embedded_buffers_stay_embedded() {
    let draft = square_draft();
    let uri = super::super::buffers::embed(&draft.bin);
    let files = FileSet::single(
        "a.gltf",
        draft.json(&one(PLAIN), &format!(r#","uri":"{uri}","name":"b""#)),
    );
    let written = convert(&files, Format::GLTF, DVec3::X);
    assert_eq!(json(&written)["buffers"][0]["name"], "b");
    assert_eq!(open(&again(&written)).positions[1], DVec3::new(2.0, 0.0, 0.0));
    assert!(written.companions.is_empty());
}

#[test]
fn two_buffers_in_one_file_are_not_overwritten() {
    let mut files = separate();
    let json = text(&files.main).replace(
        r#""buffers":["#,
        r#""buffers":[{"byteLength":60,"uri":"my%20data.bin"},"#,
    );
    files.main = json.into();
    let written = convert(&files, Format::GLTF, DVec3::Z);
    assert_eq!(written.companions["my data.bin"], files.companions["my data.bin"]);
    assert_eq!(open(&again(&written)).positions[0], DVec3::Z);
}

#[test]
fn unknown_chunks_come_along() {
    let mut main = square_draft().glb(&one(PLAIN)).main.to_vec();
    main.extend_from_slice(&[4, 0, 0, 0, b'A', b'C', b'M', b'E', 1, 2, 3, 4]);
    let length = main.len() as u32;
    main[8..12].copy_from_slice(&length.to_le_bytes());
    let files = FileSet::single("a.glb", main);
    let written = convert(&files, Format::GLB, DVec3::Z);
    assert!(written.main.ends_with(&[b'A', b'C', b'M', b'E', 1, 2, 3, 4]));
}

#[test]
fn a_missing_companion_is_named_with_a_way_to_send_it() {
    let mut files = separate();
    files.companions.clear();
    let text = refusal(&files);
    assert!(
        text.contains("\"my data.bin\"") && text.contains("multipart") && text.contains("command line"),
        "{text}"
    );
    // What only says how large decompression would be need not be there.
    let json = text_with_fallback();
    assert!(
        refusal(&FileSet::single("a.gltf", json)).contains("holds geometry"),
        "it is not needed, but asked for"
    );
}

fn text_with_fallback() -> String {
    let mark = r#","uri":"gone.bin","extensions":{"EXT_meshopt_compression":{"fallback":true}}"#;
    square_draft().json(&one(PLAIN), mark)
}

#[test]
fn a_fresh_asset_holds_what_other_formats_gave() {
    let mut geometry = open(&square_draft().glb(&one(PLAIN))).geometry;
    geometry.primitives[0].name = "say \"hi\"".into();
    geometry.primitives[0].has_normals = true;
    geometry.normals = vec![Vec3::ZERO, Vec3::Z * 2.0, Vec3::Z, Vec3::Z];
    for format in [Format::GLB, Format::GLTF] {
        let written =
            super::super::fresh::build(&NeutralModel::from_geometry(geometry.clone()), format).expect("writable");
        let read = open(&again(&written));
        assert_eq!(read.positions, geometry.positions);
        assert_eq!(read.triangles, geometry.triangles);
        assert_eq!(
            read.normals,
            [Vec3::Z; 4],
            "unit length, and the surface's where there was none"
        );
        assert_eq!(read.primitives[0].name, "say \"hi\"");
        assert_eq!(json(&written)["asset"]["generator"], "pliant");
    }
    geometry.triangles.clear();
    geometry.primitives[0].index_count = 0;
    assert!(super::super::fresh::build(&NeutralModel::from_geometry(geometry.clone()), Format::GLB).is_err());
}
