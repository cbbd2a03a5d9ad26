//! Materials, pictures and texture coordinates that are not as the standard wants them.

use super::*;

const PAINT: &str =
    r#"{"name":"paint","pbrMetallicRoughness":{"baseColorFactor":[0.5,0.25,0.125,1],"baseColorTexture":{"index":0}}}"#;

/// The square with one material and one picture.
fn painted(material: &str, image: &str) -> Model {
    let mut draft = square_draft();
    draft.elements(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], "VEC2", "");
    let primitive = one(r#"{"attributes":{"POSITION":0,"TEXCOORD_0":2},"indices":1,"material":0}"#);
    let mut files = draft.glb(&format!(
        r#"{primitive},"materials":[{material}],"textures":[{{"source":0}}],"images":[{{"uri":"{image}"}}]"#
    ));
    files.companions.insert("wood.png".into(), "png".into());
    open(&files)
}

/// The library of materials that goes with the model as OBJ.
fn library(model: &Model) -> String {
    let written = model.write(&model.positions, Format::OBJ).expect("writable");
    let mut libraries = written.companions.iter().filter(|(name, _)| name.ends_with(".mtl"));
    let (_, bytes) = libraries.next().expect("a library");
    String::from_utf8(bytes.clone()).expect("text")
}

#[test]
fn one_odd_field_leaves_the_rest_of_a_material_as_it_is() {
    let first = |member: &str| PAINT.replacen('{', &format!("{{{member},"), 1);
    let beside_index = |member: &str| PAINT.replace(r#""index":0"#, &format!(r#""index":0,{member}"#));
    let name = |json: &str| PAINT.replace(r#""paint""#, json);
    let cases = [
        (PAINT.to_owned(), "paint"),
        (PAINT.replace("0.125,1]", "0.125]"), "paint"),
        (first(r#""alphaMode":null"#), "paint"),
        (first(r#""alphaCutoff":"0.3""#), "paint"),
        (first(r#""extensions":null"#), "paint"),
        (first(r#""name":"twice""#), "paint"),
        (first(r#""normalTexture":{}"#), "paint"),
        (first(r#""normalTexture":{"index":-1}"#), "paint"),
        (first(r#""occlusionTexture":"x""#), "paint"),
        (beside_index(r#""texCoord":-1"#), "paint"),
        (
            beside_index(r#""extensions":{"KHR_texture_transform":{"offset":[1]}}"#),
            "paint",
        ),
        (name("null"), "material_0"),
        (name("7"), "material_0"),
    ];
    for (material, name) in cases {
        let text = library(&painted(&material, "wood.png"));
        for line in [&format!("newmtl {name}"), "Kd 0.5 0.25 0.125", "map_Kd wood.png"] {
            assert!(text.lines().any(|l| l == line), "{material}: no {line:?} in {text}");
        }
    }
    for normals in ["{}", r#""x""#, r#"{"index":-1}"#] {
        let model = painted(&first(&format!(r#""normalTexture":{normals}"#)), "wood.png");
        let look = model.drawn().expect("readable").look;
        let material = &look.materials[0];
        assert_eq!(
            (material.name.as_str(), material.factor),
            ("paint", [0.5, 0.25, 0.125, 1.0]),
            "{normals}"
        );
        assert!(material.texture.is_some(), "{normals}");
    }
}

#[test]
fn white_space_beside_the_base64_of_a_picture_is_no_fault() {
    for payload in ["AAEC", " AAEC", "AAEC\\n", "\\r\\n\\tAAEC "] {
        let model = painted(PAINT, &format!("data:image/png;base64,{payload}"));
        let look = model.drawn().expect("readable").look;
        assert_eq!(look.images, [Ok(vec![0, 1, 2].into())], "{payload:?}");
    }
}

#[test]
fn attributes_in_a_buffer_without_bytes_do_not_fail_a_read() {
    let mut draft = square_draft();
    draft.views.push(r#"{"buffer":1,"byteLength":64}"#.into());
    draft.accessor(2, 5126, 4, "VEC2", "");
    draft.accessor(2, 5121, 4, "VEC4", "");
    draft.accessor(2, 5126, 4, "VEC4", "");
    let warnings = |attributes: &str, node: &str| {
        let primitive = format!(r#"{{"attributes":{{"POSITION":0,{attributes}}},"indices":1}}"#);
        let body = one(&primitive).replace(r#"{"mesh":0}"#, node);
        let body = format!(r#"{body},"skins":[{{"joints":[0]}}]"#);
        let json = draft.json(&body, r#"},{"byteLength":64"#);
        let glb = container::join(&json, Some(&draft.bin), &[], GLB_FAULT).expect("small");
        let model = open(&FileSet::single("draft.glb", glb));
        assert_eq!(model.positions[2], DVec3::new(1.0, 1.0, 0.0));
        let codes = model.geometry.warnings.iter().map(|w| w.0.clone());
        codes.collect::<Vec<String>>()
    };
    assert!(warnings(r#""TEXCOORD_0":2"#, r#"{"mesh":0}"#).is_empty());
    let by_joints = warnings(r#""JOINTS_0":3,"WEIGHTS_0":4"#, r#"{"mesh":0,"skin":0}"#);
    assert_eq!(by_joints, ["skin-not-applied"]);
}
