//! Texture coordinates that are no numbers.

use crate::support::recipes;
use pliant::asset::{FileSet, Format, Limits, Model};
use recipes::{Edited, read_back};

/// A triangle whose second corner has no texture coordinate that is a number, as glTF.
fn triangle_without_coordinates() -> String {
    use base64::Engine as _;
    let positions = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let coordinates = [0.25f32, 0.5, f32::NAN, 0.5, 0.75, f32::INFINITY];
    let bytes: Vec<u8> = positions
        .iter()
        .chain(&coordinates)
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let uri = base64::engine::general_purpose::STANDARD.encode(&bytes);
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}}}}]}}],
        "buffers":[{{"byteLength":60,"uri":"data:application/octet-stream;base64,{uri}"}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":24}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}},
        {{"bufferView":1,"componentType":5126,"count":3,"type":"VEC2"}}]}}"#
    )
}

#[test]
fn texture_coordinates_that_are_no_numbers_are_reported_and_never_written_again() {
    let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.25 0.5\nvt nan 0.5\nvt 0.75 -inf\nf 1/1 2/2 3/3\n";
    let sources = [("a.gltf", triangle_without_coordinates()), ("a.obj", obj.to_owned())];
    for (name, text) in sources {
        let model = Model::read(FileSet::single(name, text), None, &Limits::default()).expect("readable");
        let reported = |model: &Model| {
            let mut warnings = model.warnings.iter();
            warnings.any(|(code, ..)| code == "bad-texture-coordinate")
        };
        assert!(reported(&model), "{name}: {:?}", model.warnings);
        for format in [Format::GLB, Format::GLTF, Format::OBJ, Format::PLY] {
            let patched = format == model.format || (name == "a.gltf" && format == Format::GLB);
            let written = match patched {
                // What is only patched keeps every byte, so an edited model it has to be.
                true => Edited::of(&model, true).write(&model, format),
                false => model.write(&model.positions, format),
            };
            let written = written.unwrap_or_else(|e| panic!("{name} as {format}: {e}"));
            let again = read_back(&written, format);
            assert!(!reported(&again), "{name} as {format}");
            let text = String::from_utf8_lossy(&written.main).to_ascii_lowercase();
            let is_text = [Format::OBJ, Format::PLY].contains(&format);
            assert!(
                !is_text || !(text.contains("nan") || text.contains("inf ")),
                "{name} as {format}: {text}"
            );
        }
    }
}

#[test]
fn what_would_collapse_into_nothing_is_not_written() {
    let far = "v 1e9 1e9 1e9\nv 1000000001 1e9 1e9\nv 1e9 1000000001 1e9\nf 1 2 3\n";
    let model = Model::read(FileSet::single("far.obj", far), None, &Limits::default()).expect("readable");
    for written in [
        model.write(&model.positions, Format::STL),
        Edited::of(&model, true).write(&model, Format::STL),
    ] {
        let refused = written.expect_err("nobody could open it again").to_string();
        assert!(
            refused.contains("collapses") && refused.contains("write obj, ply or off"),
            "{refused}"
        );
    }
    // A glTF has small numbers below a node that stands there.
    for format in [Format::GLB, Format::GLTF] {
        let written = model.write(&model.positions, format).expect("numbers of its own size");
        let again = read_back(&written, format);
        let off = again
            .positions
            .iter()
            .zip(&model.positions)
            .map(|(a, b)| a.distance(*b));
        assert!(off.fold(0.0, f64::max) < 1e-6, "{format}");
    }
    for format in [Format::OBJ, Format::PLY, Format::OFF, Format::GLB, Format::GLTF] {
        let written = Edited::of(&model, true)
            .write(&model, format)
            .expect("double precision");
        assert_eq!(read_back(&written, format).triangles.len(), 4, "{format}");
    }
}
