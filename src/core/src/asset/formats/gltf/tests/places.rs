//! Buffers in chunks, in text and in files, and the ways between GLB and glTF.

use super::*;
use crate::asset::neutral::NeutralModel;

fn square() -> DocumentDraft {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.indices(&CORNERS);
    draft
}

fn body() -> String {
    one(r#"{"attributes":{"POSITION":0},"indices":1}"#)
}

/// A .gltf whose buffer is the companion "my data.bin", beside one that nobody names.
fn separate() -> FileSet {
    let draft = square();
    let mut files = FileSet::single("a.gltf", draft.json(&body(), r#","uri":"my%20data.bin""#));
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
            square().bin.len(),
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
    let draft = square();
    let uri = super::super::uri::embed(&draft.bin);
    let files = FileSet::single("a.gltf", draft.json(&body(), &format!(r#","uri":"{uri}","name":"b""#)));
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
    let mut main = square().glb(&body()).main.to_vec();
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
    square().json(&body(), mark)
}

#[test]
fn a_fresh_asset_holds_what_other_formats_gave() {
    let mut geometry = open(&square().glb(&body())).geometry;
    geometry.primitives[0].name = "say \"hi\"".into();
    geometry.primitives[0].has_normals = true;
    geometry.normals = vec![glam::Vec3::ZERO, glam::Vec3::Z * 2.0, glam::Vec3::Z, glam::Vec3::Z];
    for format in [Format::GLB, Format::GLTF] {
        let written =
            super::super::fresh::build(&NeutralModel::from_geometry(geometry.clone()), format).expect("writable");
        let read = open(&again(&written));
        assert_eq!(read.positions, geometry.positions);
        assert_eq!(read.triangles, geometry.triangles);
        assert_eq!(
            read.normals,
            [glam::Vec3::Z; 4],
            "unit length, and the surface's where there was none"
        );
        assert_eq!(read.primitives[0].name, "say \"hi\"");
        assert_eq!(json(&written)["asset"]["generator"], "pliant");
    }
    geometry.triangles.clear();
    geometry.primitives[0].index_count = 0;
    assert!(super::super::fresh::build(&NeutralModel::from_geometry(geometry.clone()), Format::GLB).is_err());
}
