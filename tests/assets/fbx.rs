//! FBX files, which become GLBs. Their figures stand in the files that the tests make themselves.

use crate::support::bench::largest_distance;
use crate::support::data::{data_folder, files_below};
use crate::support::fbx_text::{CUBE, CUBE_FACES, FbxText, bar, cube, shaped_cube};
use crate::support::gltf_parsed::{Parsed, parse};
use crate::support::khronos;
use crate::support::shapes::bounds;
use crate::support::skinning::{ClipTime, clip_length, draw, list};
use glam::DVec3;
use pliant::asset::{Error, FileSet, Format, Limits, Model, missing_companions};
use proptest::prelude::*;
use std::collections::BTreeMap;

fn read(text: impl Into<Vec<u8>>) -> Result<Model, Error> {
    Model::read(FileSet::single("model.fbx", text.into()), None, &Limits::default())
}

fn parsed(model: &Model) -> Parsed {
    parse(&model.files.main, &BTreeMap::new())
}

fn assert_near(seen: DVec3, wanted: DVec3) {
    assert!((seen - wanted).length() < 1e-6, "{seen} is not {wanted}");
}

#[test]
fn a_cube_comes_in_metres_with_its_faces_normals_coordinates_colours_and_materials() {
    let model = read(cube().text()).expect("a model");
    assert_eq!(model.format, Format::GLB);
    let (low, high) = bounds(&model.positions);
    assert_near(low, DVec3::new(-1.0, 0.5, -1.0));
    assert_near(high, DVec3::new(1.0, 2.5, 1.0));
    assert_eq!((model.triangles.len(), model.positions.len()), (12, 24));
    // The faces look outwards, and the normals with them.
    let middle = (low + high) / 2.0;
    for t in &model.triangles {
        let [a, b, c] = t.map(|v| model.positions[v as usize]);
        let normal = (b - a).cross(c - a).normalize();
        assert!(normal.dot((a + b + c) / 3.0 - middle) > 0.9);
        assert_near(model.normals[t[0] as usize].as_dvec3(), normal);
    }
    let json = parsed(&model).json;
    let attributes = &json["meshes"][0]["primitives"][0]["attributes"];
    for name in ["POSITION", "NORMAL", "TEXCOORD_0", "TEXCOORD_1", "COLOR_0"] {
        assert!(attributes[name].is_number(), "{name} of {attributes}");
    }
    let materials = &json["materials"];
    assert_eq!(materials[0]["name"], "red");
    let colour = |i: usize, k: usize| {
        let factor = &materials[i]["pbrMetallicRoughness"]["baseColorFactor"];
        factor[k].as_f64().expect("a number")
    };
    assert!((colour(0, 0) - 0.8).abs() < 1e-6 && (colour(1, 2) - 0.9).abs() < 1e-6);
    assert!(
        (colour(1, 3) - 0.5).abs() < 1e-6,
        "half of the light goes through the glass"
    );
    assert_eq!(materials[1]["alphaMode"], "BLEND");
    let codes: Vec<&str> = model.warnings.iter().map(|w| w.0.as_str()).collect();
    assert_eq!(codes, ["fbx-as-glb"]);
}

#[test]
fn texture_coordinates_count_from_the_upper_left() {
    let model = read(cube().text()).expect("a model");
    let look = model.drawn().expect("readable").look;
    // The first corner of the floor: u 0, v 0 from below.
    let at = model.triangles[0][0] as usize;
    let uv = if look.uv.is_empty() { [0.0, 1.0] } else { look.uv[at] };
    assert_eq!(uv, [0.0, 1.0]);
    let obj = model.write(&model.positions, Format::OBJ).expect("writable").main;
    let obj = String::from_utf8(obj).expect("text");
    assert!(obj.contains("vt 0 0\n") && obj.contains("vt 1 1\n"), "{obj}");
    assert!(look.colours.iter().any(|c| c[0] == 0.5) && look.materials.len() == 2);
}

#[test]
fn units_and_axes_are_those_of_gltf() {
    // Z up, in inches: what lies along z stands up.
    let mut file = FbxText::with_axes(2.54, [2, 1, 0]);
    let tall = CUBE.map(|[x, y, z]| [x, z, y * 2.0]);
    let faces: Vec<Vec<i64>> = CUBE_FACES.iter().map(|f| f.iter().rev().copied().collect()).collect();
    let faces: Vec<&[i64]> = faces.iter().map(Vec::as_slice).collect();
    file.node(200, "Mesh", "box", [0.; 3], 0)
        .mesh(100, 200, &tall, &faces, "");
    let (low, high) = bounds(&read(file.text()).expect("a model").positions);
    assert_near(low, DVec3::new(-2.54, 0.0, -2.54));
    assert_near(high, DVec3::new(2.54, 10.16, 2.54));
}

#[test]
fn a_skin_stands_where_its_bones_stand_and_its_clip_turns_it() {
    let model = read(bar().text()).expect("a model");
    let file = parsed(&model);
    assert_eq!(
        file.json["skins"].as_array().map(Vec::len),
        Some(1),
        "{:?}",
        model.warnings
    );
    let (low, high) = bounds(&model.positions);
    // The lowest ring hangs on no bone and stays; the top goes with the upper bone, 40 cm to the side.
    assert_near(low, DVec3::new(-0.1, 0.0, -0.1));
    assert_near(high, DVec3::new(0.5, 3.0, 0.1));
    // A quarter of the weight takes a quarter of the way.
    let second = model.positions.iter().filter(|p| (p.y - 1.0).abs() < 1e-6);
    let least = second.fold(f64::INFINITY, |x, p| x.min(p.x));
    assert!((least - 0.0).abs() < 1e-6, "{least}");
    // What is read is what a plain player draws.
    let drawn: Vec<DVec3> = draw(&file, None, &[])
        .expect("plain")
        .into_iter()
        .flat_map(|d| d.positions)
        .collect();
    assert!(largest_distance(&drawn, &model.positions) < 1e-6);
    // The clip ends with the upper bone turned by a right angle about its own place.
    let animation = &file.json["animations"][0];
    assert_eq!(animation["name"], "wave");
    let mut channels = list(&animation["channels"]).iter();
    let rotation = channels.find(|c| c["target"]["path"] == "rotation").expect("it turns");
    let node = rotation["target"]["node"].as_u64().expect("a node") as usize;
    assert_eq!(file.json["nodes"][node]["name"], "upper");
    assert!((clip_length(&file, 0) - 1.0).abs() < 1e-6);
    let end = draw(&file, Some(ClipTime { clip: 0, seconds: 1.0 }), &[]).expect("plain");
    let (low, high) = bounds(&end[0].positions);
    // What stood 150 cm above the bone now lies 150 cm to its side.
    assert!(
        (low.x - (0.4 - 1.5)).abs() < 1e-5 && (high.y - 1.6).abs() < 1e-5,
        "{low} {high}"
    );
}

#[test]
fn joints_have_a_root_in_common_where_vertices_have_no_weights() {
    let mut files = vec![("bar".to_owned(), bar().text().into_bytes())];
    if let Some(data) = data_folder("FBX files of the data") {
        let fbx = files_below(&data, |path| path.extension().is_some_and(|e| e == "fbx"));
        files.extend(
            fbx.iter()
                .enumerate()
                .map(|(n, path)| (n.to_string(), std::fs::read(path).expect("a file"))),
        );
    }
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("fbx");
    let mut stored = Vec::new();
    for (name, bytes) in files {
        let model = read(bytes).expect("a model");
        let nodes = list(&parsed(&model).json["nodes"]).to_vec();
        for skin in list(&parsed(&model).json["skins"]) {
            let above = |node: u64| {
                (0..)
                    .zip(&nodes)
                    .find(|(_, n)| list(&n["children"]).contains(&node.into()))
                    .map(|(n, _)| n)
            };
            let root = |joint: u64| std::iter::successors(Some(joint), |node| above(*node)).last();
            let mut roots: Vec<_> = list(&skin["joints"])
                .iter()
                .map(|j| root(j.as_u64().expect("a node")))
                .collect();
            roots.dedup();
            assert_eq!(roots.len(), 1, "{name}: {roots:?}");
        }
        let at = folder.join(name).with_extension("glb");
        khronos::store(&model.write(&model.positions, Format::GLB).expect("writable"), &at);
        stored.push(at);
    }
    // The node of a mesh is a joint itself there, so that it cannot be a root.
    if let Some(found) = khronos::validate(&stored) {
        let errors: Vec<_> = found
            .iter()
            .filter(|(_, codes)| codes.iter().any(|code| !code.starts_with("NODE_SKINNED_MESH")))
            .collect();
        assert!(errors.is_empty(), "{errors:#?}");
    }
}

#[test]
fn a_deformed_skin_is_written_back_through_its_bones() {
    let model = read(bar().text()).expect("a model");
    let positions: Vec<DVec3> = model.positions.iter().map(|p| *p * DVec3::new(1.0, 1.2, 1.0)).collect();
    let written = model.write(&positions, Format::GLB).expect("writable");
    let again = Model::read(FileSet::single("again.glb", written.main), None, &Limits::default()).expect("a model");
    assert!(largest_distance(&again.positions, &positions) < 1e-5);
    let file = parsed(&again);
    assert_eq!(list(&file.json["skins"]).len(), 1);
    assert_eq!(list(&file.json["animations"]).len(), 1);
}

#[test]
fn a_blend_shape_is_a_morph_target() {
    let model = read(shaped_cube().text()).expect("a model");
    let file = parsed(&model);
    assert_eq!(file.json["meshes"][0]["extras"]["targetNames"][0], "peak");
    let shaped = |weight: f64| -> Vec<DVec3> {
        let all = draw(&file, None, &[weight]).expect("plain");
        all.into_iter().flat_map(|d| d.positions).collect()
    };
    assert_near(bounds(&shaped(0.0)).1, DVec3::new(1.0, 2.0, 1.0));
    let peak = shaped(1.0);
    assert_near(bounds(&peak).1, DVec3::new(1.0, 3.0, 1.0));
    assert!(peak.iter().filter(|p| p.y > 2.5).all(|p| p.x > 0.9 && p.z > 0.9));
}

#[test]
fn textures_are_taken_from_beside_the_model_or_from_inside_of_it() {
    let textured = |more: &str| {
        let mut file = cube();
        let body = "Type: \"TextureVideoClip\"\nFileName: \"C:\\\\art\\\\rust.png\"\nRelativeFilename: \"..\\\\art\\\\rust.png\"";
        let video = format!(
            "Type: \"Clip\"\nFilename: \"C:\\\\art\\\\rust.png\"\nRelativeFilename: \"..\\\\art\\\\rust.png\"\n{more}"
        );
        file.object(800, "Texture", "Texture::rust", "", body)
            .object(801, "Video", "Video::rust", "Clip", &video)
            .drive(800, 300, "DiffuseColor")
            .connect(801, 800);
        file.text()
    };
    let mut png = Vec::new();
    let mut encoder = png::Encoder::new(&mut png, 1, 1);
    encoder.set_color(png::ColorType::Rgb);
    encoder
        .write_header()
        .and_then(|mut w| w.write_image_data(&[200, 100, 0]))
        .expect("a picture");
    let mut files = FileSet::single("box.fbx", textured(""));
    assert_eq!(missing_companions(&files), ["rust.png"]);
    let without = Model::read(files.clone(), None, &Limits::default()).expect("a model");
    assert!(
        without
            .warnings
            .iter()
            .any(|w| w.0 == "image-missing" && w.1.contains("rust.png"))
    );
    files.companions.insert("rust.png".into(), png.clone().into());
    let beside = Model::read(files, None, &Limits::default()).expect("a model");
    let content = {
        use base64::Engine as _;
        base64::engine::general_purpose::STANDARD.encode(&png)
    };
    let inside = textured(&format!("Content: , \"{content}\""));
    assert_eq!(missing_companions(&FileSet::single("box.fbx", inside.clone())), [""; 0]);
    for model in [beside, read(inside).expect("a model")] {
        let look = model.drawn().expect("readable").look;
        assert_eq!(look.images.len(), 1);
        assert_eq!(look.images[0].as_deref(), Ok(&png[..]));
    }
}

#[test]
fn results_are_no_fbx() {
    let model = read(cube().text()).expect("a model");
    let refused = model
        .write(&model.positions, Format::FBX)
        .expect_err("it is not written");
    assert_eq!(
        refused.to_string(),
        "cannot write fbx: fbx is read, not written; choose glb, gltf, obj, ply, off, stl, 3mf, splat or spz"
    );
    for format in Format::ALL {
        assert!(model.write(&model.positions, format).is_ok(), "{format}");
    }
}

#[test]
fn broken_files_say_what_and_where() {
    let whole = cube().text();
    let error = |text: &str| read(text).expect_err("it is broken").to_string();
    let cut = error(&whole[..whole.len() / 2]);
    assert!(cut.starts_with("fbx: "), "{cut}");
    let mut bare = FbxText::new();
    bare.node(200, "Null", "nothing", [0.; 3], 0);
    for (broken, wanted) in [
        (
            whole.replace("0,1,2,-4", "0,1,2,-400"),
            "fbx: file: is broken: a list, number or index in it cannot be",
        ),
        (
            whole.replace("UVIndex: *24 { a: 0,1,2,3", "UVIndex: *24 { a: 0,1,2,900"),
            "fbx: meshes: an index of a polygon or attribute is out of range of what it counts",
        ),
        (
            bare.text(),
            "fbx: no mesh: 2 nodes, 0 meshes and no polygon that a node shows",
        ),
    ] {
        assert_eq!(error(&broken), wanted);
    }
    let far = error(&whole.replace("100,200,100", "1e300,200,100"));
    assert!(far.contains("fbx: mesh 0 \"mesh\"") || far.contains("finite"), "{far}");
    let limits = Limits {
        triangles: 5,
        ..Limits::default()
    };
    let refused = Model::read(FileSet::single("a.fbx", whole.clone()), None, &limits).expect_err("too many");
    assert_eq!(refused.to_string(), "triangles is 8, at most 5 is allowed");
    let limits = Limits {
        decoded_bytes: 1000,
        ..Limits::default()
    };
    let refused = Model::read(FileSet::single("a.fbx", whole), None, &limits).expect_err("too large");
    assert!(refused.to_string().contains("at most 1000 is allowed"), "{refused}");
    let wrong = Model::read(FileSet::single("a.fbx", "hello"), Some(Format::FBX), &Limits::default());
    assert_eq!(
        wrong.expect_err("no FBX").to_string(),
        "fbx: byte 5: the file ends too early"
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 700, ..ProptestConfig::default() })]

    /// 700 changes of each of three files: bytes replaced, digits often so that numbers stay numbers; pieces copied elsewhere; the end cut off.
    #[test]
    fn broken_files_never_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
        copy in (any::<prop::sample::Index>(), any::<prop::sample::Index>(), 0usize..60),
        cut in any::<prop::sample::Index>(),
        truncate in 0u8..4,
    ) {
        let limits = Limits { vertices: 10_000, triangles: 10_000, decoded_bytes: 20_000_000, ..Limits::default() };
        for (i, file) in [cube(), bar(), shaped_cube()].iter().enumerate() {
            let mut bytes = file.text().into_bytes();
            for (place, value) in &edits {
                let at = place.index(bytes.len());
                bytes[at] = if value % 2 == 0 { b'0' + value % 10 } else { *value };
            }
            let (from, to, length) = (copy.0.index(bytes.len()), copy.1.index(bytes.len()), copy.2);
            let piece = bytes[from..(from + length).min(bytes.len())].to_vec();
            bytes.splice(to..to, piece);
            if truncate == 0 {
                bytes.truncate(cut.index(bytes.len()));
            }
            let Ok(model) = Model::read(FileSet::single("a.fbx", bytes), Some(Format::FBX), &limits) else {
                continue;
            };
            prop_assert!(model.positions.iter().all(|p| p.is_finite()), "file {i}");
            let moved: Vec<DVec3> = model.positions.iter().map(|p| *p * 0.5 + DVec3::X).collect();
            if let Ok(written) = model.write(&moved, Format::GLB) {
                let again = Model::read(FileSet::single("b.glb", written.main), None, &Limits::default());
                prop_assert_eq!(again.map(|m| m.positions.len()), Ok(model.positions.len()));
            }
        }
    }
}
