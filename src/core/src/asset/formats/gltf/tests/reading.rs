//! Where vertices are in the world, and which triangles there are.

use super::*;
use glam::{Vec3, Vec4};

fn square(node: &str, more: &str) -> FileSet {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.points(&[[1.0, 0.0, 0.0]; 4]);
    let tangents: Vec<u8> = [0.0, 0.0, 1.0, 1.0_f32].iter().flat_map(|v| v.to_le_bytes()).collect();
    let view = draft.view(&tangents.repeat(4), "");
    draft.accessor(view, 5126, 4, "VEC4", "");
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
    assert_eq!(
        f32::from_le_bytes(stored[96 + 12..96 + 16].try_into().expect("four")),
        1.0,
        "stored handedness"
    );
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
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.indices(&CORNERS);
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
        [6, 6, 6],
        "lines and points are not rows, stitches are not triangles"
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
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.indices(&CORNERS);
    let body = one(r#"{"attributes":{"POSITION":0},"indices":1}"#);
    let with = |asset: &str, more: &str| {
        let uri = format!(r#","uri":"{}""#, crate::asset::formats::gltf::uri::embed(&draft.bin));
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
fn instances_on_the_gpu_are_told_of_and_their_data_is_left_alone() {
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
