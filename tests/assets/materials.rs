//! What surfaces are drawn with, between formats: base colours and pictures of OBJ libraries and glTF materials, texture
//! coordinates by corner, colours of vertices.

use crate::support::data::data_folder;
use crate::support::gltf_sets::file_set;
use crate::support::recipes;
use pliant::asset::{FileSet, Format, Limits, Model, WrittenFiles, missing_companions};
use serde_json::{Value, json};

const PICTURE: &[u8] = b"\x89PNG\r\n\x1a\n not a picture that anybody looks at";

/// Two squares that share an edge and have a material each; coordinates part at that edge.
const OBJ: &str = "mtllib my things.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\n\
vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 0.5 0.25\nusemtl red paint\nf 1/1 2/2 3/3 4/4\nusemtl glass\nf 2/5 5/2 6/3 3/4\n";

const LIBRARY: &str = "# by hand\nnewmtl red paint\nKa 1 1 1\nKd 0.8 0.1 0.05\nmap_Kd -s 1 1 1 -clamp on textures\\red paint.png\n\
map_Bump -bm 0.5 bump.png\nnewmtl glass\nKd 0.2 0.3 0.4\nd 0.25\nnewmtl nobody\nKd 1 1 1\nmap_Kd ../secret.png\n";

fn obj_files() -> FileSet {
    let mut files = FileSet::single("folder/two squares.obj", OBJ);
    files.companions.insert("my things.mtl".into(), LIBRARY.into());
    files.companions.insert("textures/red paint.png".into(), PICTURE.into());
    files
}

fn read(files: FileSet) -> Model {
    let name = files.name.clone();
    Model::read(files, None, &Limits::default()).unwrap_or_else(|e| panic!("{name}: {e}"))
}

fn again(format: Format, written: WrittenFiles) -> Model {
    read(recipes::file_set(&format!("again.{format}"), written))
}

fn write(model: &Model, format: Format) -> WrittenFiles {
    model.write(&model.positions, format).expect("writable")
}

/// JSON and binary chunk of a GLB.
fn glb_parts(written: &WrittenFiles) -> (Value, Vec<u8>) {
    let length = u32::from_le_bytes(written.main[12..16].try_into().expect("four bytes")) as usize;
    let json = serde_json::from_slice(&written.main[20..20 + length]).expect("JSON");
    (json, written.main[28 + length..].to_vec())
}

fn image_bytes(document: &Value, bin: &[u8], image: usize) -> Vec<u8> {
    let view = &document["bufferViews"][document["images"][image]["bufferView"].as_u64().expect("a view") as usize];
    let first = view["byteOffset"].as_u64().unwrap_or(0) as usize;
    bin[first..first + view["byteLength"].as_u64().expect("a length") as usize].to_vec()
}

#[test]
fn an_obj_names_its_library_and_the_library_its_pictures() {
    let mut files = FileSet::single("two.obj", OBJ);
    assert!(missing_companions(&files).contains(&"my things.mtl".to_owned()));
    files.companions.insert("my things.mtl".into(), LIBRARY.into());
    let named = missing_companions(&files);
    for wanted in ["textures/red paint.png", "bump.png"] {
        assert!(named.contains(&wanted.to_owned()), "{named:?}");
    }
    assert!(named.iter().all(|name| !name.contains("secret")), "{named:?}");
}

#[test]
fn materials_of_a_library_become_those_of_a_gltf_and_come_back() {
    let model = read(obj_files());
    let glb = write(&model, Format::GLB);
    assert!(glb.companions.is_empty());
    let (document, bin) = glb_parts(&glb);
    let floats = |value: &Value| -> Vec<f64> {
        let list = value.as_array().expect("numbers").iter();
        list.map(|v| (v.as_f64().expect("a number") * 1e6).round() / 1e6)
            .collect()
    };
    let [red, glass] = [&document["materials"][0], &document["materials"][1]];
    assert_eq!((&red["name"], &glass["name"]), (&json!("red paint"), &json!("glass")));
    assert_eq!(
        floats(&red["pbrMetallicRoughness"]["baseColorFactor"]),
        [0.8, 0.1, 0.05, 1.0]
    );
    assert_eq!(
        floats(&glass["pbrMetallicRoughness"]["baseColorFactor"]),
        [0.2, 0.3, 0.4, 0.25]
    );
    assert_eq!(
        (&red["alphaMode"], &glass["alphaMode"]),
        (&Value::Null, &json!("BLEND"))
    );
    assert_eq!(red["pbrMetallicRoughness"]["baseColorTexture"]["index"], 0);
    assert_eq!(document["images"][0]["mimeType"], "image/png");
    assert_eq!(image_bytes(&document, &bin, 0), PICTURE);

    let obj = write(&again(Format::GLB, glb), Format::OBJ);
    let text = String::from_utf8(obj.main.clone()).expect("text");
    assert!(
        text.contains("mtllib again.mtl\n") && text.contains("usemtl red paint\n"),
        "{text}"
    );
    let library = String::from_utf8(obj.companions["again.mtl"].clone()).expect("text");
    for wanted in [
        "newmtl red paint\nKd 0.8 0.1 0.05\nd 1\nmap_Kd ",
        "newmtl glass\nKd 0.2 0.3 0.4\nd 0.25\n",
    ] {
        assert!(library.contains(wanted), "{library}");
    }
    let pictures = obj.companions.iter().filter(|(n, _)| n.ends_with(".png"));
    let pictures: Vec<&Vec<u8>> = pictures.map(|(_, b)| b).collect();
    assert_eq!(pictures, [PICTURE]);
    // And once more: the same colours and the same picture.
    let (back, bin) = glb_parts(&write(&again(Format::OBJ, obj), Format::GLB));
    assert_eq!(back["materials"], document["materials"]);
    assert_eq!(image_bytes(&back, &bin, 0), PICTURE);
}

#[test]
fn a_picture_of_normals_goes_along_and_one_of_heights_is_reported() {
    let library = LIBRARY.replace("map_Bump", "norm normals.png\nmap_Bump");
    let mut files = obj_files();
    files
        .companions
        .insert("my things.mtl".into(), library.into_bytes().into());
    let normals = [PICTURE, b" of normals"].concat();
    files.companions.insert("normals.png".into(), normals.clone().into());
    let reported = |model: &Model, code: &str| {
        let mut warnings = model.warnings.iter();
        warnings.find(|w| w.0 == code).map(|w| w.1.clone())
    };
    assert!(reported(&read(files.clone()), "image-missing").is_some_and(|text| text.contains("bump.png")));
    assert_eq!(
        reported(&read(files.clone()), "bump-map"),
        None,
        "what is missing is reported as that"
    );
    files.companions.insert("bump.png".into(), PICTURE.into());
    let model = read(files);
    let text = reported(&model, "bump-map").expect("a warning");
    assert!(
        text.contains("bump.png") && text.contains("norm") && !text.contains("normals.png"),
        "{text}"
    );

    let glb = write(&model, Format::GLB);
    let (document, bin) = glb_parts(&glb);
    let material = &document["materials"][0];
    assert_eq!(material["pbrMetallicRoughness"]["baseColorTexture"]["index"], 0);
    assert_eq!(material["normalTexture"]["index"], 1);
    assert_eq!(image_bytes(&document, &bin, 1), normals);
    assert_eq!(
        document["images"].as_array().map(Vec::len),
        Some(2),
        "no picture of heights"
    );

    let obj = write(&again(Format::GLB, glb), Format::OBJ);
    let library = String::from_utf8(obj.companions["again.mtl"].clone()).expect("text");
    let name = library
        .lines()
        .find_map(|line| line.strip_prefix("norm "))
        .unwrap_or_else(|| panic!("{library}"));
    assert_eq!(obj.companions[name], normals);
    let (back, _) = glb_parts(&write(&again(Format::OBJ, obj), Format::GLB));
    assert_eq!(back["materials"], document["materials"]);
}

#[test]
fn normals_on_other_coordinates_than_the_colours_do_not_go_to_an_obj() {
    let (mut document, bin) = {
        let mut files = obj_files();
        let library = LIBRARY.replace("map_Bump -bm 0.5 bump.png", "norm textures/red paint.png");
        files
            .companions
            .insert("my things.mtl".into(), library.into_bytes().into());
        glb_parts(&write(&read(files), Format::GLB))
    };
    let library = |document: &Value| {
        let mut document = document.clone();
        let uri = format!("data:application/octet-stream;base64,{}", base64_of(&bin));
        document["buffers"][0]["uri"] = uri.into();
        let model = read(FileSet::single("a.gltf", document.to_string()));
        let obj = write(&model, Format::OBJ);
        let library = obj
            .companions
            .values()
            .find(|b| b.starts_with(b"# pliant"))
            .expect("a library");
        String::from_utf8(library.clone()).expect("text")
    };
    assert!(library(&document).contains("\nnorm "));
    document["materials"][0]["normalTexture"]["texCoord"] = 1.into();
    assert!(!library(&document).contains("\nnorm "));
}

fn base64_of(bytes: &[u8]) -> String {
    use base64::Engine as _;
    base64::engine::general_purpose::STANDARD.encode(bytes)
}

#[test]
fn libraries_and_pictures_of_an_obj_stay_beside_it() {
    let model = read(obj_files());
    let mut moved = model.positions.clone();
    moved[4].z = 0.5;
    let written = model.write(&moved, Format::OBJ).expect("writable");
    assert_eq!(written.companions["my things.mtl"], LIBRARY.as_bytes());
    assert_eq!(written.companions["textures/red paint.png"], PICTURE);
}

#[test]
fn a_library_that_is_missing_or_broken_leaves_the_names() {
    for library in [
        None,
        Some(""),
        Some("newmtl"),
        Some("Kd 1 1 1\nnewmtl red paint\nKd a b\nd nan\nmap_Kd\n-s -s\n\0\u{fffd}"),
    ] {
        let mut files = FileSet::single("two.obj", OBJ);
        if let Some(text) = library {
            files.companions.insert("my things.mtl".into(), text.into());
        }
        let (document, _) = glb_parts(&write(&read(files), Format::GLB));
        assert_eq!(document["materials"][0]["name"], "red paint");
        assert_eq!(document["materials"].as_array().map(Vec::len), Some(2));
    }
}

#[test]
fn coordinates_that_part_at_a_seam_survive_in_a_ply() {
    let model = read(obj_files());
    let ply = write(&model, Format::PLY);
    let header = String::from_utf8_lossy(&ply.main[..400]).into_owned();
    assert!(
        header.contains("element vertex 6\n") && header.contains(" float texcoord\n"),
        "{header}"
    );
    let obj = String::from_utf8(write(&again(Format::PLY, ply), Format::OBJ).main).expect("text");
    let pairs = |text: &str| -> Vec<Vec<String>> {
        let lines: Vec<&str> = text.lines().filter_map(|l| l.strip_prefix("vt ")).collect();
        let faces = text.lines().filter_map(|l| l.strip_prefix("f "));
        let corner = |word: &str| {
            let mut numbers = word.split('/');
            let vertex = numbers.next().expect("a vertex").to_owned();
            let line: usize = numbers.next().expect("a coordinate").parse().expect("a number");
            format!("{vertex}: {}", lines[line - 1])
        };
        faces.map(|face| face.split(' ').map(corner).collect()).collect()
    };
    assert_eq!(pairs(&obj), pairs(OBJ));
    // Without a seam they belong to vertices, which more programs read.
    let plain = OBJ.replace("2/5 5/2 6/3 3/4", "2/2 5/5 6/1 3/3");
    let ply = write(&read(FileSet::single("plain.obj", plain.clone())), Format::PLY);
    let header = String::from_utf8_lossy(&ply.main[..400]).into_owned();
    assert!(
        header.contains("property float s\n") && !header.contains("texcoord"),
        "{header}"
    );
    let obj = String::from_utf8(write(&again(Format::PLY, ply), Format::OBJ).main).expect("text");
    assert_eq!(pairs(&obj), pairs(&plain));
}

#[test]
fn coordinates_by_corner_of_a_ply_are_those_of_vertices_in_a_glb() {
    let header = "ply\nformat ascii 1.0\nelement vertex 7\nproperty float x\nproperty float y\nproperty float z\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 2\n\
        property list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n";
    let vertices =
        "0 0 0 255 0 0\n1 0 0 0 255 0\n1 1 0 0 0 255\n0 1 0 255 0 0\n2 0 0 255 0 0\n2 1 0 255 0 0\n9 9 9 0 0 0\n";
    let seamed = "4 0 1 2 3 8 0 0 1 0 1 1 0 1\n4 1 4 5 2 8 0.5 0.25 1 0.25 1 0.75 0.5 0.75\n";
    // Places, colours and coordinates of the corners of all triangles, by way of a GLB.
    let by_way_of_a_glb = |faces: &str| {
        let model = read(FileSet::single("two.ply", format!("{header}{vertices}{faces}")));
        let glb = again(Format::GLB, write(&model, Format::GLB));
        let obj = String::from_utf8(write(&glb, Format::OBJ).main).expect("text");
        let lines = |of: &str| -> Vec<&str> { obj.lines().filter_map(|l| l.strip_prefix(of)).collect() };
        let (places, coordinates) = (lines("v "), lines("vt "));
        let corner = |word: &str| {
            let numbers: Vec<usize> = word.split('/').take(2).map(|n| n.parse().expect("a number")).collect();
            format!("{} | {}", places[numbers[0] - 1], coordinates[numbers[1] - 1])
        };
        let triangles: Vec<Vec<String>> = (lines("f ").iter())
            .map(|face| face.split(' ').map(corner).collect())
            .collect();
        (glb.positions.len(), triangles)
    };
    let (count, triangles) = by_way_of_a_glb(seamed);
    let first = [
        "0 0 0 1 0 0 | 0 0",
        "1 0 0 0 1 0 | 1 0",
        "1 1 0 0 0 1 | 1 1",
        "0 1 0 1 0 0 | 0 1",
    ];
    let second = [
        "1 0 0 0 1 0 | 0.5 0.25",
        "2 0 0 1 0 0 | 1 0.25",
        "2 1 0 1 0 0 | 1 0.75",
        "1 1 0 0 0 1 | 0.5 0.75",
    ];
    let wanted = [first, second].map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).concat();
    assert_eq!(triangles, wanted);
    assert_eq!(
        count, 9,
        "the two vertices at the seam are there twice, the others once"
    );
    // Where all corners of a vertex agree, no vertex is copied.
    let (count, triangles) = by_way_of_a_glb(
        &seamed
            .replace("0.5 0.25 1", "1 0 1")
            .replace("0.75 0.5 0.75", "0.75 1 1"),
    );
    assert_eq!((count, triangles[3][2].as_str()), (7, "1 1 0 0 0 1 | 1 1"));
}

#[test]
fn colours_of_vertices_go_everywhere() {
    let text = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n";
    let mut here = read(FileSet::single("colours.obj", text));
    for format in [Format::OFF, Format::PLY, Format::GLB, Format::OFF, Format::OBJ] {
        let written = write(&here, format);
        if format == Format::OFF {
            assert!(
                written.main.starts_with(b"COFF"),
                "{}",
                String::from_utf8_lossy(&written.main)
            );
        }
        here = again(format, written);
    }
    let back = String::from_utf8(here.files.main.to_vec()).expect("text");
    assert!(
        back.ends_with("v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n"),
        "{back}"
    );
}

#[test]
fn a_real_model_keeps_its_base_colour_from_gltf_to_obj_and_back() {
    let Some(data) = data_folder("materials of real models") else {
        return;
    };
    for name in [
        "gltf/WaterBottle_separate/WaterBottle.gltf",
        "gltf/BoomBox_separate/BoomBox.gltf",
        "gltf/Duck.glb",
    ] {
        let model = read(file_set(&data.join(name)));
        let obj = write(&model, Format::OBJ);
        let picture = obj.companions.iter().find(|(n, _)| !n.ends_with(".mtl"));
        let picture = picture
            .unwrap_or_else(|| panic!("{name}: {:?}", obj.companions.keys()))
            .1
            .clone();
        let (document, bin) = glb_parts(&write(&again(Format::OBJ, obj), Format::GLB));
        assert_eq!(
            document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["index"], 0,
            "{name}"
        );
        assert!(image_bytes(&document, &bin, 0) == picture, "{name}");
        assert!(
            document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"].is_number(),
            "{name}"
        );
    }
}
