use super::package::{Package, pack};
use crate::files::ReadWatch;
use crate::{FileSet, Format, Limits, Model};
use glam::DVec3;
use pliant_exec::progress::Silent;

const HEAD: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<model unit="inch" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02" xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06" xmlns:s="http://slicer">
<metadata name="Title">Two &amp; more</metadata>"#;
const CORNERS: &str = r#"<vertices>
<vertex x="0" y="0" z="0" s:tag="a"/><vertex x="2" y='0' z="0"/><vertex x="0" y="2.50" z="0"/><vertex  z="2" x="0" y="0" />
</vertices>"#;

fn tetrahedron(marks: [&str; 4]) -> String {
    let [a, b, c, d] = marks;
    format!(
        r#"<mesh>{CORNERS}<triangles><triangle v1="0" v2="2" v3="1"{a}/><triangle v1="0" v2="1" v3="3"{b}/><triangle v1="1" v2="2" v3="3"{c}/><triangle v1="2" v2="0" v3="3"{d}/></triangles></mesh>"#
    )
}

fn package(resources: &str, build: &str, more: &[(&str, &str)]) -> Vec<u8> {
    let model = format!("{HEAD}<resources>{resources}</resources><build>{build}</build></model>");
    let relations = r#"<Relationships xmlns="r"><Relationship Target="/3D/a.model" Id="r" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>"#;
    let mut parts = vec![
        ("_rels/.rels".to_owned(), relations.into()),
        ("3D/a.model".to_owned(), model.into_bytes()),
    ];
    parts.extend(
        more.iter()
            .map(|(name, text)| ((*name).to_owned(), text.as_bytes().to_vec())),
    );
    pack(&parts).expect("a package")
}

fn read(bytes: Vec<u8>) -> Result<Model, crate::Error> {
    Model::read(FileSet::single("a.3mf", bytes), None, &Limits::default())
}

fn part_of(bytes: &[u8], name: &str) -> String {
    let limits = Limits::default();
    let watch = ReadWatch::new(&limits, &Silent, 0);
    let mut package = Package::open(bytes).expect("a package");
    let part = package.part(name, &watch).expect("readable").expect("there");
    String::from_utf8(part).expect("a text")
}

fn two_objects() -> Vec<u8> {
    let resources = format!(
        r##"<basematerials id="1"><base name="red" displaycolor="#FF0000"/><base name="blue" displaycolor="#0000FF80"/></basematerials>
<object id="2" name="first" type="model" pid="1" pindex="0">{}</object>
<object id="3" name="pair"><components><component objectid="2" transform="-1 0 0 0 1 0 0 0 1 10 0 0"/></components></object>"##,
        tetrahedron(["", r#" pid="1" p1="1""#, "", r#" s:paint="4""#])
    );
    let thumbnail = ("Metadata/thumbnail.png", "a picture");
    package(
        &resources,
        r#"<item objectid="3" printable="0" transform="1 0 0 0 2 0 0 0 1 0 0 5"/>"#,
        &[thumbnail],
    )
}

#[test]
fn a_pose_rewrites_the_numbers_of_moved_vertices_alone() {
    let bytes = two_objects();
    let model = read(bytes.clone()).expect("readable");
    assert_eq!(model.format, Format::THREE_MF);
    // A mirrored component, then stretched along y and lifted by its item.
    let places = [[10.0, 0.0, 5.0], [8.0, 0.0, 5.0], [10.0, 5.0, 5.0], [10.0, 0.0, 7.0]];
    assert_eq!(model.positions, places.map(DVec3::from_array));
    assert_eq!(
        (model.triangles[0], model.primitives[0].name.as_str()),
        ([0, 1, 2], "first")
    );
    assert!(
        model.warnings.iter().any(|w| w.0 == "unit" && w.1.contains("inch")),
        "{:?}",
        model.warnings
    );

    let mut moved = model.positions.clone();
    moved[2].y = 7.0;
    let written = model.write(&moved, Format::THREE_MF).expect("writable");
    let (before, after) = (part_of(&bytes, "3D/a.model"), part_of(&written.main, "3D/a.model"));
    assert_eq!(after, before.replace(r#"y="2.50""#, r#"y="3.5""#));
    assert_eq!(part_of(&written.main, "Metadata/thumbnail.png"), "a picture");
    assert!(
        written.warnings[0].message.contains("Metadata/thumbnail.png"),
        "{:?}",
        written.warnings
    );
    assert_eq!(read(written.main).expect("readable").positions, moved);
}

#[test]
fn a_part_with_a_byte_order_mark_is_written_as_one_without() {
    let plain = two_objects();
    let marked = |text: &str| {
        let parts = ["_rels/.rels", "3D/a.model"].map(|name| (name.to_owned(), part_of(&plain, name).into_bytes()));
        let [relations, (name, model)] = parts;
        pack(&[relations, (name, [text.as_bytes(), &model].concat())]).expect("a package")
    };
    let shifted = |bytes: Vec<u8>, and_apart: bool| {
        let model = read(bytes).expect("readable");
        let moved: Vec<DVec3> = model
            .positions
            .iter()
            .map(|p| *p + DVec3::new(1.0, 2.0, 3.25))
            .collect();
        let written = match and_apart {
            true => super::write::write_whole(&model, &moved),
            false => model.write(&moved, Format::THREE_MF),
        };
        let written = written.expect("writable").main;
        assert_eq!(read(written.clone()).expect("readable").positions, moved);
        part_of(&written, "3D/a.model")
    };
    for and_apart in [false, true] {
        let expected = shifted(marked(""), and_apart);
        assert_eq!(shifted(marked("\u{feff}"), and_apart), format!("\u{feff}{expected}"));
    }
    let wide = |text: &str| text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
    for mark in ["", "\u{feff}"] {
        let text = wide(&format!("{mark}{}", part_of(&plain, "3D/a.model")));
        let error = read(pack(&[("3D/a.model".to_owned(), text)]).expect("a package")).expect_err("UTF-16");
        assert!(error.to_string().contains("UTF-16"), "{error}");
    }
}

#[test]
fn uses_of_one_mesh_that_move_apart_get_meshes_of_their_own() {
    let resources = format!(
        r#"<object id="7" name="twin" p:UUID="u">{}</object>"#,
        tetrahedron(["", "", "", ""])
    );
    let build = r#"<item objectid="7" p:UUID="i"/><item objectid="7" transform="1 0 0 0 1 0 0 0 1 9 0 0"/>"#;
    let model = read(package(&resources, build, &[])).expect("readable");
    assert_eq!(model.primitives.len(), 2);
    let mut moved = model.positions.clone();
    moved[4].z = -1.0;
    let written = model.write(&moved, Format::THREE_MF).expect("writable");
    let text = part_of(&written.main, "/3d/A.MODEL");
    assert!(
        text.contains("Two &amp; more") && text.matches("<mesh>").count() == 2,
        "{text}"
    );
    assert!(text.contains(r#"<object id="7" name="twin" p:UUID="u">"#), "{text}");
    assert!(text.contains(r#"<item objectid="7" p:UUID="i"/>"#), "{text}");
    // What the production extension wants to have a UUID has one of its own, and the same each time: two objects, two items, the build.
    let uuids: Vec<&str> = text
        .split("p:UUID=\"")
        .skip(1)
        .filter_map(|rest| rest.split('"').next())
        .collect();
    assert_eq!(uuids.len(), 5, "{text}");
    let different: std::collections::BTreeSet<&str> = uuids.iter().copied().collect();
    assert_eq!(different.len(), 5, "{text}");
    let made = uuids
        .iter()
        .filter(|uuid| uuid.len() == 36 && uuid.as_bytes()[14] == b'8');
    assert_eq!(made.count(), 3, "{text}");
    let twice = model.write(&moved, Format::THREE_MF).expect("writable");
    assert_eq!(twice.main, written.main);
    assert!(
        written.warnings.iter().any(|w| w.message.contains("1 mesh shared")),
        "{:?}",
        written.warnings
    );
    let again = read(written.main).expect("readable");
    assert_eq!(
        (again.positions.clone(), again.triangles.clone()),
        (moved, model.triangles.clone())
    );
}

#[test]
fn objects_in_other_parts_are_read_and_written_where_they_are() {
    let inner = format!(
        r#"{HEAD}<resources><object id="1" name="inner">{}</object></resources><build/></model>"#,
        tetrahedron(["", "", "", ""])
    );
    let resources =
        r#"<object id="2"><components><component p:path="/3D/Objects/b.model" objectid="1"/></components></object>"#;
    let model = read(package(
        resources,
        r#"<item objectid="2"/>"#,
        &[("3D/Objects/b.model", &inner)],
    ))
    .expect("readable");
    assert_eq!(model.primitives[0].name, "inner");
    let mut moved = model.positions.clone();
    moved[1].x = 3.0;
    let written = model.write(&moved, Format::THREE_MF).expect("writable");
    assert_eq!(
        part_of(&written.main, "3D/Objects/b.model"),
        inner.replace(r#"x="2""#, r#"x="3""#)
    );
}

#[test]
fn materials_and_colours_go_into_other_formats_and_back() {
    let coloured = r##"<m:colorgroup id="4"><m:color color="#FF0000"/><m:color color="#00FF00"/><m:color color="#0000FF"/></m:colorgroup>"##;
    let resources = format!(
        r#"{coloured}<object id="5" name="bright" pid="4" pindex="0">{}</object>"#,
        tetrahedron([r#" p1="0" p2="1" p3="2""#, "", "", ""])
    );
    for (bytes, looks) in [
        (two_objects(), 2),
        (package(&resources, r#"<item objectid="5"/>"#, &[]), 1),
    ] {
        let model = read(bytes).expect("readable");
        let glb = model.write(&model.positions, Format::GLB).expect("writable");
        let glb = Model::read(FileSet::single("a.glb", glb.main), None, &Limits::default()).expect("readable");
        assert_eq!(glb.primitives.len(), looks);
        let back = glb.write(&glb.positions, Format::THREE_MF).expect("writable");
        let text = part_of(&back.main, "3D/3dmodel.model");
        match looks {
            2 => {
                assert!(
                    text.contains(r##"<base name="red" displaycolor="#FF0000"/>"##),
                    "{text}"
                );
                assert!(
                    text.contains(r##"<base name="blue" displaycolor="#0000FF80"/>"##),
                    "{text}"
                );
            }
            _ => {
                assert!(text.contains(r##"<m:color color="#00FF00"/>"##), "{text}");
                // Four places, though the GLB has copies at borders of colours.
                assert_eq!(text.matches("<vertex ").count(), 4, "{text}");
                assert!(text.contains(r#"unit="meter""#), "{text}");
            }
        }
        assert_eq!(read(back.main).expect("readable").triangles.len(), 4);
    }
}

/// A glTF of several nodes with a mesh of one primitive each, as one node with one mesh of all primitives.
fn as_one_mesh(written: crate::WrittenFiles) -> Model {
    let mut document: serde_json::Value = serde_json::from_slice(&written.main).expect("JSON");
    let meshes = document["meshes"].as_array().expect("meshes");
    let primitives: Vec<_> = meshes.iter().map(|mesh| mesh["primitives"][0].clone()).collect();
    document["meshes"] = serde_json::json!([{ "primitives": primitives }]);
    document["nodes"] = serde_json::json!([{ "mesh": 0 }]);
    document["scenes"] = serde_json::json!([{ "nodes": [0] }]);
    let mut files = FileSet::single("a.gltf", document.to_string());
    files.companions = written
        .companions
        .into_iter()
        .map(|(name, bytes)| (name, bytes.into()))
        .collect();
    Model::read(files, None, &Limits::default()).expect("readable")
}

#[test]
fn a_surface_of_several_materials_is_one_object_and_formats_without_materials_say_so() {
    let object = |material: [&str; 3], library: &str| {
        let [none, red, blue] = material;
        let text = format!(
            "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv .5 .5 1\nvt 0 0\nvt 1 0\nvt 0 1\n{none}f 1/1 3/2 2/3\n{red}f 1/1 2/2 5/3\n\
             f 2/1 3/2 5/3\n{blue}f 3/1 4/2 5/3\n{red}f 4/1 1/2 5/3\nf 1/1 4/2 3/3\n"
        );
        let mut files = FileSet::single("a.obj", text);
        let picture = |shade: u8| vec![0x89, b'P', b'N', b'G', shade].into();
        files.companions = [
            ("a.mtl".to_owned(), library.to_owned().into()),
            ("r.png".to_owned(), picture(1)),
            ("b.png".to_owned(), picture(2)),
        ]
        .into();
        Model::read(files, None, &Limits::default()).expect("readable")
    };
    let materials = ["", "usemtl red\n", "usemtl blue\n"];
    let plain = object(materials, "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n");
    let written = plain.write(&plain.positions, Format::THREE_MF).expect("writable").main;
    let text = part_of(&written, "3D/3dmodel.model");
    // One closed object in the order of the OBJ, and each triangle has the material of its face.
    assert_eq!(
        (text.matches("<object").count(), text.matches("<vertex ").count()),
        (1, 5),
        "{text}"
    );
    let gltf = as_one_mesh(plain.write(&plain.positions, Format::GLTF).expect("writable"));
    assert_eq!(gltf.primitives.len(), 3);
    let from_gltf = gltf.write(&gltf.positions, Format::THREE_MF).expect("writable").main;
    let from_gltf = part_of(&from_gltf, "3D/3dmodel.model");
    assert_eq!(
        (
            from_gltf.matches("<object").count(),
            from_gltf.matches("<vertex ").count()
        ),
        (1, 5),
        "{from_gltf}"
    );
    assert_eq!(from_gltf.matches("<base ").count(), 3, "{from_gltf}");
    let model = read(written).expect("readable");
    assert_eq!(
        (&model.triangles, &model.positions),
        (&plain.triangles, &plain.positions)
    );
    let rows: Vec<&str> = text.split("<base ").skip(1).collect();
    let triangles = text.split("<triangle ").skip(1);
    let of_triangle = triangles.map(|t| t.split("p1=\"").nth(1).and_then(|p| p[..1].parse::<usize>().ok()));
    let colours = of_triangle.map(|place| rows[place.expect("a property")].split('"').nth(3).expect("a colour"));
    let seen: Vec<&str> = colours.collect();
    assert_eq!(seen, ["#FFFFFF", "#FF0000", "#FF0000", "#0000FF", "#FF0000", "#FF0000"]);

    let materials = ["usemtl red\n", "", "usemtl blue\n"];
    let pictured = object(materials, "newmtl red\nmap_Kd r.png\nnewmtl blue\nmap_Kd b.png\n");
    let written = pictured
        .write(&pictured.positions, Format::THREE_MF)
        .expect("writable")
        .main;
    for (name, shade) in [("3D/Textures/1.png", 1), ("3D/Textures/2.png", 2)] {
        let limits = Limits::default();
        let watch = ReadWatch::new(&limits, &Silent, 0);
        let mut package = Package::open(&written).expect("a package");
        let part = package.part(name, &watch).expect("readable").expect("there");
        assert_eq!(part[4], shade, "{name}");
    }
    let lost = |format: Format| {
        let written = pictured.write(&pictured.positions, format).expect("writable");
        let lost = written.warnings.into_iter().filter(|w| w.code == "left-out");
        lost.map(|w| w.message).collect::<Vec<_>>()
    };
    assert_eq!(lost(Format::PLY), ["the ply file has not: 2 materials, 2 pictures"]);
    for format in [Format::OFF, Format::STL] {
        let expected = format!("the {format} file has not: 2 materials, 2 pictures, texture coordinates");
        assert_eq!(lost(format), [expected]);
    }
    assert!(lost(Format::GLB).is_empty() && lost(Format::THREE_MF).is_empty());

    let coloured = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n";
    let coloured = Model::read(FileSet::single("c.obj", coloured), None, &Limits::default()).expect("readable");
    let glb = coloured.write(&coloured.positions, Format::GLB).expect("writable").main;
    let glb = Model::read(FileSet::single("c.glb", glb), None, &Limits::default()).expect("readable");
    let colours = glb.drawn().expect("drawn").look.colours;
    assert_eq!(
        colours,
        [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]]
    );
    let stl = coloured
        .write(&coloured.positions, Format::STL)
        .expect("writable")
        .warnings;
    assert_eq!(stl[0].message, "the stl file has not: colours of vertices");
}

#[test]
fn colours_of_vertices_and_materials_both_show() {
    let object = |colour: &str| {
        let text = format!(
            "mtllib a.mtl\nv 0 0 0 {colour}\nv 1 0 0 1 1 1\nv 0 1 0 1 1 1\nv 0 0 1 1 1 1\nusemtl leaf\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
        );
        let mut files = FileSet::single("a.obj", text);
        files.companions = [("a.mtl".to_owned(), "newmtl leaf\nKd 0 1 0\n".into())].into();
        let model = Model::read(files, None, &Limits::default()).expect("readable");
        let written = model.write(&model.positions, Format::THREE_MF).expect("writable");
        let told: Vec<String> = written.warnings.iter().map(|w| w.message.clone()).collect();
        (part_of(&written.main, "3D/3dmodel.model"), told.concat())
    };
    let (text, told) = object("1 .6 0");
    for colour in ["#009900", "#00FF00"] {
        assert!(text.contains(&format!(r#"<m:color color="{colour}"/>"#)), "{text}");
    }
    assert!(told.contains("materials of vertices with colours"), "{told}");
    // White says nothing, so the material stays what it is.
    let (text, told) = object("1 1 1");
    assert!(
        text.contains(r##"<base name="leaf" displaycolor="#00FF00"/>"##),
        "{text}"
    );
    assert!(told.is_empty(), "{told}");
}

#[test]
fn materials_are_no_texture_coordinates() {
    let model = read(two_objects()).expect("readable");
    for format in [Format::PLY, Format::STL, Format::OFF] {
        let written = model.write(&model.positions, format).expect("writable");
        let told: Vec<&str> = written.warnings.iter().map(|w| w.message.as_str()).collect();
        assert!(
            told.concat().contains("2 materials") && !told.concat().contains("coordinates"),
            "{told:?}"
        );
    }
}

#[test]
fn what_another_program_calls_a_3mf_is_read_or_named() {
    // The preliminary version of 2013, which a program of Windows 8 writes.
    let preliminary = format!(
        r##"<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/2013/01"><resources><color id="0" value="#FF0000"/>
<material id="1" name="red" colorid="0"/><object id="2" materialid="1">{}</object></resources><build><item objectid="2"/></build></model>"##,
        tetrahedron(["", r#" colorid="0""#, "", ""])
    );
    let model = read(pack(&[("3D/a.model".to_owned(), preliminary.clone().into())]).expect("a package"));
    let model = model.expect("readable");
    assert_eq!((model.positions.len(), model.triangles.len()), (4, 4));
    let told = model.warnings.iter().find(|w| w.0 == "extension-not-read");
    assert!(
        told.is_some_and(|w| w.1.contains("color, material")),
        "{:?}",
        model.warnings
    );
    let mut moved = model.positions.clone();
    moved[2].y = 7.0;
    let written = model.write(&moved, Format::THREE_MF).expect("writable");
    assert_eq!(
        part_of(&written.main, "3D/a.model"),
        preliminary.replace(r#"y="2.50""#, r#"y="7""#)
    );

    // What is built has its shape from an extension alone.
    let shape = r#"<object id="1"><b:booleanshape xmlns:b="urn:b" objectid="2"/></object>"#;
    let error = read(package(shape, r#"<item objectid="1"/>"#, &[])).expect_err("no mesh");
    assert!(error.to_string().contains("not read: b:booleanshape"), "{error}");
}

#[test]
fn units_of_a_gltf_and_pictures_that_are_none_are_told() {
    let told = |written: &crate::WrittenFiles| {
        let units = written.warnings.iter().filter(|w| w.code == "unit");
        units.map(|w| w.message.clone()).collect::<Vec<_>>()
    };
    let inches = read(two_objects()).expect("readable");
    let warning = told(&inches.write(&inches.positions, Format::GLB).expect("writable"));
    assert!(warning[0].contains("scale it by 0.0254"), "{warning:?}");
    assert!(told(&inches.write(&inches.positions, Format::OBJ).expect("writable")).is_empty());

    let group = |picture: &str| {
        format!(
            r#"{picture}<m:texture2dgroup id="4" texid="3"><m:tex2coord u="0" v="0"/></m:texture2dgroup><object id="5" pid="4" pindex="0">{}</object>"#,
            tetrahedron(["", "", "", ""])
        )
    };
    let named = r#"<m:texture2d id="3" path="/3D/a.png" contenttype="image/png"/>"#;
    let missing = |picture: &str, parts: &[(&str, &str)]| {
        let model = read(package(&group(picture), r#"<item objectid="5"/>"#, parts)).expect("readable");
        let warning = model.warnings.iter().find(|w| w.0 == "image-missing");
        warning.map(|w| w.1.clone()).unwrap_or_default()
    };
    assert!(missing(named, &[]).ends_with(": /3D/a.png"));
    assert!(missing(named, &[("3D/a.png", "no picture")]).ends_with(": /3D/a.png"));
    assert!(missing("", &[]).ends_with(": resource 3"));
}

#[test]
fn hostile_packages_are_refused_with_a_place() {
    let mesh = tetrahedron(["", "", "", ""]);
    let item = r#"<item objectid="1"/>"#;
    let object = |inner: &str| format!(r#"<object id="1">{inner}</object>"#);
    let refused = |bytes: Vec<u8>, phrase: &str| {
        let error = read(bytes).expect_err(phrase).to_string();
        assert!(error.contains(phrase), "{error} has not {phrase}");
    };
    refused(
        package(&object(&mesh.replace(r#"v3="1""#, r#"v3="4""#)), item, &[]),
        "the object has 4",
    );
    refused(
        package(&object(&mesh.replace(r#"x="2""#, r#"x="2,5""#)), item, &[]),
        "decimal comma",
    );
    refused(
        package(&object(&mesh.replace(r#"x="2""#, r#"x="nan""#)), item, &[]),
        "not finite",
    );
    refused(
        package("", item, &[]),
        "object 1: the object is named and does not exist",
    );
    let looped = object(r#"<components><component objectid="1"/></components>"#);
    refused(package(&looped, item, &[]), "deep in each other");
    let outside = object(r#"<components><component p:path="/../../etc/passwd" objectid="1"/></components>"#);
    refused(package(&outside, item, &[]), "not in the archive");
    let doctype = "<!DOCTYPE model [<!ENTITY a \"aaaa\">]><model/>";
    let parts = [("3D/a.model".to_owned(), doctype.as_bytes().to_vec())];
    refused(pack(&parts).expect("a package"), "a document type is not allowed");
    refused(
        pack(&[("a.txt".to_owned(), b"b.model".to_vec())]).expect("a package"),
        "without the part of a 3D model",
    );

    // Each object uses the next one twice.
    let doubling: String = (1..40).map(|i| format!(r#"<object id="{i}"><components><component objectid="{0}"/><component objectid="{0}"/></components></object>"#, i + 1)).collect();
    refused(
        package(&format!(r#"{doubling}<object id="40">{mesh}</object>"#), item, &[]),
        "used more than 65536 times",
    );

    // Blanks that unpack to more than may be held.
    let bomb = package(&object(&format!("{mesh}{}", " ".repeat(8 << 20))), item, &[]);
    assert!(bomb.len() < 64 << 10);
    let limits = Limits {
        decoded_bytes: 4 << 20,
        ..Limits::default()
    };
    let error = Model::read(FileSet::single("a.3mf", bomb), None, &limits).expect_err("a bomb");
    assert!(
        matches!(error, crate::Error::TooLarge { limit: 4_194_304, .. }),
        "{error}"
    );
}
