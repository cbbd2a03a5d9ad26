use super::super::text::tests::assert_refused;
use super::build;
use super::read::ObjReader;
use crate::files::ReadWatch;
use crate::neutral::NeutralModel;
use crate::{Error, FileSet, Format, Limits, Model, WrittenFiles};
use glam::{DQuat, DVec3, Vec3};
use pliant_exec::progress::Silent;
use pliant_mesh::shading;
use proptest::prelude::*;
use std::collections::BTreeMap;

fn model(text: &str) -> Model {
    Model::read(
        FileSet::single("test.obj", text.as_bytes().to_vec()),
        Some(Format::OBJ),
        &Limits::default(),
    )
    .unwrap_or_else(|e| panic!("{e}"))
}

fn written(model: &Model, positions: &[DVec3]) -> String {
    let out = model.write(positions, Format::OBJ).unwrap_or_else(|e| panic!("{e}"));
    String::from_utf8(out.main).expect("text stays text")
}

/// The normal that each corner of each face names, after reading.
fn corner_normals(text: &str) -> Vec<Vec3> {
    named_corners(text).into_iter().map(|corner| corner.2).collect()
}

const AWKWARD: &str = "\u{feff}# made by hand \\\r\nmtllib a b.mtl\r\no cube #1\r\nv 0 0 0 1.0\r\n\tv\t1.50 0e0 -0 0.1 0.2 0.3 # colour\r\n\
    v 1 \\\r\n  1 0\r\n\r\nv 0 1. +0 1 .5 .5 .5\r\nvt 0 0\r\nvp 0.5\r\ncurv 0 1 -1 -2\r\n  g left  side\r\nusemtl red\r\ns off\r\n\
    f 1/1 2/1 -2/-1 4/1 # quad\r\nl 1 2\r\np 3\r\nf 1 \\\r\n3 4\r\nwhatever\r\n";

#[test]
fn what_a_deformation_does_not_touch_stays_to_the_byte() {
    let model = model(AWKWARD);
    assert_eq!(model.positions.len(), 4);
    assert_eq!(model.positions[1].to_array(), [1.5, 0.0, 0.0]);
    assert_eq!(model.triangles, [[0, 1, 2], [0, 2, 3], [0, 2, 3]]);
    assert_eq!(written(&model, &model.positions), AWKWARD);

    let mut moved = model.positions.clone();
    moved[1].x = 0.1 + 0.2;
    moved[2] = DVec3::new(-1e-30, 1.0, 7.0);
    let expected = AWKWARD
        .replace("1.50", "0.30000000000000004")
        .replace("v 1 \\\r\n  1 0", "v -1e-30 \\\r\n  1 7");
    assert_eq!(written(&model, &moved), expected);
}

#[test]
fn all_ways_to_write_a_corner_mean_the_same() {
    let points = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\n";
    for face in [
        "1 2 3",
        "1/1 2/1 3/1",
        "1//1 2//1 3//1",
        "1/1/1 2/1/1 3/1/1",
        "-3/-1/-1 -2//-1 3/1/",
        "1/ 2// 3",
    ] {
        assert_eq!(model(&format!("{points}f {face}")).triangles, [[0, 1, 2]], "{face}");
    }
    assert_eq!(
        model("f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0").triangles,
        [[0, 1, 2]],
        "faces may come first"
    );
}

#[test]
fn what_is_wrong_is_named_with_its_line() {
    let points = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    for (tail, line, phrase) in [
        ("f 1 2 0", 4, "vertex index 0"),
        ("f 1 2 4", 4, "vertex index 4; the file has 3"),
        ("f 1 2 -4", 4, "vertex index -4"),
        ("f 1 2 9999999999999", 4, "9999999999999"),
        ("f 1 2 99999999999999999999999", 4, "is not a corner"),
        ("f 1/1 2/1 3/1", 4, "texture coordinate index 1; the file has 0"),
        ("vn 0 0 1\nf 1//1 2//2 3//1", 5, "normal index 2; the file has 1"),
        ("f 1/2/3/4 2 3", 4, "`1/2/3/4` is not a corner"),
        ("f a b c", 4, "`a` is not a corner"),
        ("\nv 1 2\nf 1 2 3", 5, "`v` with 2 numbers"),
        ("v nan 0 0\nf 1 2 3", 4, "`nan` is not finite"),
        ("v 0 1e999 0\nf 1 2 3", 4, "`1e999` is not finite"),
        ("v 0 0 x\nf 1 2 3", 4, "`x` is not a number"),
        ("vn 0 0\nf 1 2 3", 4, "`vn` with 2 numbers"),
    ] {
        let files = FileSet::single("", format!("{points}{tail}"));
        let read = Model::read(files, Some(Format::OBJ), &Limits::default());
        assert_refused(read, &format!("line {line}"), phrase, tail.as_bytes());
    }
    for text in ["", "v 0 0 0\nv 1 0 0\nl 1 2\n", "v 0 0 0\nv 1 1 1\nf 1 2\n"] {
        let error = Model::read(FileSet::single("", text), Some(Format::OBJ), &Limits::default()).unwrap_err();
        assert!(matches!(error, Error::NoMesh { .. }), "{text}: {error}");
    }
}

#[test]
fn limits_are_kept() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3 4\n";
    let read = |limits: Limits| Model::read(FileSet::single("a.obj", text), None, &limits);
    let vertices = Limits {
        vertices: 3,
        ..Limits::default()
    };
    assert_eq!(
        read(vertices).unwrap_err(),
        Error::TooLarge {
            what: "vertices",
            seen: 4,
            limit: 3
        }
    );
    let triangles = Limits {
        triangles: 1,
        ..Limits::default()
    };
    assert_eq!(
        read(triangles).unwrap_err(),
        Error::TooLarge {
            what: "triangles",
            seen: 2,
            limit: 1
        }
    );
}

#[test]
fn normals_are_given_by_vertex_only_where_they_are_unique() {
    let points = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 5\nvn 0 0 2\nvn 1 0 0\nvn nan 0 0\n";
    let unique = model(&format!("{points}f 1//1 2//1 3//1"));
    assert!(unique.primitives[0].has_normals);
    assert_eq!(unique.normals, [Vec3::Z, Vec3::Z, Vec3::Z, Vec3::ZERO]);
    assert_eq!(
        unique.warnings.len(),
        1,
        "the normal that is not a number is reported: {:?}",
        unique.warnings
    );
    for faces in [
        "f 1//1 2//1 3//1\nf 1//2 3//1 4//1",
        "f 1//1 2//1 3//1\nf 1 3 4",
        "f 1 2 3",
    ] {
        let model = model(&format!("{points}{faces}"));
        assert!(!model.primitives[0].has_normals && model.normals.is_empty(), "{faces}");
    }
}

/// A strip of quads, bent from flat, whose one `vn` line serves all corners.
fn strip(cells: u32, normal_index: &dyn Fn(u32) -> String) -> String {
    let mut text: String = (0..=cells).map(|i| format!("v {i} 0 0\nv {i} 1 0\n")).collect();
    text += "vn 0 0 1\n";
    for i in 0..cells {
        let corner = |v: u32| format!(" {v}//{}", normal_index(v));
        text += &format!(
            "f{}{}{}{}\n",
            corner(2 * i + 1),
            corner(2 * i + 3),
            corner(2 * i + 4),
            corner(2 * i + 2)
        );
    }
    text
}

fn bend(p: DVec3) -> DVec3 {
    let (sin, cos) = libm::sincos(p.x * 0.2);
    DVec3::new(5.0 * sin, p.y, 5.0 - 5.0 * cos)
}

#[test]
fn a_normal_that_many_vertices_share_is_parted_where_they_turn_differently() {
    for index in [&|_: u32| "1".to_string() as String, &|_: u32| "-1".to_string()] as [&dyn Fn(u32) -> String; 2] {
        let text = strip(5, index) + "vn 0 1 0\nv 9 9 9\nf 1//2 2//-1 13//-1\n";
        let model = model(&text);
        let mut moved: Vec<_> = model.positions.iter().map(|&p| bend(p)).collect();
        moved[12] = model.positions[12];
        let out = written(&model, &moved);
        let reread = self::model(&out);
        assert_eq!((&reread.positions, &reread.triangles), (&moved, &model.triangles));

        // What the corners should shade with, worked out from triangles that share vertices within the strip only.
        let strip_triangles = &model.triangles[..10];
        let gradients = shading::gradients(&model.positions, &moved, strip_triangles, strip_triangles, 13);
        let seen = corner_normals(&out);
        for (face, corners) in [[0, 2, 3, 1], [2, 4, 5, 3], [4, 6, 7, 5], [6, 8, 9, 7], [8, 10, 11, 9]]
            .iter()
            .enumerate()
        {
            for (k, &v) in corners.iter().enumerate() {
                let expected = shading::carry_normal(gradients[v].as_ref().expect("moved"), Vec3::Z);
                assert!(
                    (seen[face * 4 + k] - expected).length() < 2e-6,
                    "face {face} corner {k}:\n{out}"
                );
            }
        }
        assert_eq!(seen.len(), 23);
        // Two vertices of a rib turn alike up to rounding at the triangles around them, so lines are added, not one each corner.
        let lines = out.lines().filter(|l| l.starts_with("vn ")).count();
        assert!((3..=13).contains(&lines), "{lines} normals");
        assert_eq!(out.lines().filter(|l| l.starts_with('f')).count(), 6);
    }
}

#[test]
fn a_rigid_motion_rewrites_normals_in_place() {
    let text = strip(4, &|_| "1".into());
    let model = model(&text);
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 1.0);
    let moved: Vec<_> = model.positions.iter().map(|&p| turn * p).collect();
    let out = written(&model, &moved);
    assert_eq!(out.lines().count(), text.lines().count());
    assert!(
        out.lines()
            .zip(text.lines())
            .all(|(new, old)| !old.starts_with('f') || new == old)
    );
    let expected = (turn * DVec3::Z).as_vec3();
    assert!(corner_normals(&out).iter().all(|n| (*n - expected).length() < 1e-6));
}

#[test]
fn a_fresh_file_keeps_names_normals_and_order() {
    let mut geometry = model("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 1\nvn 0 0 1\nf 1//1 2//1 3//1\nf 1//1 2//1 4//1")
        .geometry
        .clone();
    geometry.primitives = ["a\nb", ""]
        .map(|name| crate::Primitive {
            name: name.into(),
            vertex_count: 2,
            index_count: 3,
            has_normals: true,
            ..Default::default()
        })
        .to_vec();
    let text = String::from_utf8(build(&NeutralModel::from_geometry(geometry.clone())).main).expect("text");
    assert!(
        text.contains("o a b\nf 1//1 2//2 3//3\no \nf 1//1 2//2 4//4\n"),
        "{text}"
    );
    let reread = model(&text);
    assert_eq!(
        (&reread.positions, &reread.normals, &reread.triangles),
        (&geometry.positions, &geometry.normals, &geometry.triangles)
    );
}

/// A model as a GLB, read again, with the vertex of the source that its file says each vertex is.
fn as_glb(model: &Model) -> (Model, Vec<u32>) {
    let written = model.write(&model.positions, Format::GLB).expect("writable").main;
    let length = u32::from_le_bytes(written[12..16].try_into().expect("four bytes")) as usize;
    let json: serde_json::Value = serde_json::from_slice(&written[20..20 + length]).expect("JSON");
    let glb = Model::read(FileSet::single("x.glb", written), None, &Limits::default()).expect("valid");
    let mut sources = Vec::new();
    for (mesh, own) in json["meshes"].as_array().expect("meshes").iter().zip(&glb.primitives) {
        match mesh["extras"]["sourceVertices"].as_array() {
            None => sources.extend(own.vertices().map(|v| v as u32)),
            Some(runs) => {
                for run in runs {
                    let [first, count] = [0, 1].map(|k| run[k].as_u64().expect("a number") as u32);
                    sources.extend(first..first + count);
                }
            }
        }
    }
    (glb, sources)
}

#[test]
fn a_glb_keeps_the_order_of_vertices_and_triangles() {
    // Faces name vertices from the last to the first, and vertex 2 is in none.
    let plain = model("v 0 0 0\nv 1 0 0\nv 9 9 9\nv 0 1 0\nv 1 1 1\nf 5 4 2\nf 4 1 2\n");
    let (glb, sources) = as_glb(&plain);
    assert_eq!((&glb.positions, &glb.triangles), (&plain.positions, &plain.triangles));
    assert_eq!(sources, [0, 1, 2, 3, 4]);
    let ends = "property list uchar int vertex_indices\nend_header\n";
    let ply = format!(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n{ends}\
         0 0 0\n1 0 0\n0 1 0\n1 1 1\n3 3 2 1\n3 2 0 1\n"
    );
    let off = "OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n1 1 1\n3 3 2 1\n3 2 0 1\n";
    for (name, text) in [("a.ply", ply.as_str()), ("a.off", off)] {
        let read = Model::read(FileSet::single(name, text.to_owned()), None, &Limits::default()).expect("a model");
        let (glb, _) = as_glb(&read);
        assert_eq!(
            (&glb.positions, &glb.triangles),
            (&read.positions, &read.triangles),
            "{name}"
        );
    }
}

#[test]
fn copies_at_seams_follow_the_vertices_and_the_file_says_of_what() {
    let corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 1\nvt 0 0\nvt 1 0\nvt 0 1\nvt .5 .5\nvt 1 0\n";
    // Vertex 3 has another coordinate in the second face; that of vertex 2 is written twice.
    let seam = model(&format!("{corners}f 4/1 3/3 2/2\nf 3/4 1/1 2/5\n"));
    let (glb, sources) = as_glb(&seam);
    assert_eq!((glb.positions.len(), &glb.positions[..4]), (5, &seam.positions[..]));
    assert_eq!(
        (sources.as_slice(), glb.triangles.as_slice()),
        (&[0, 1, 2, 3, 2][..], &[[3, 2, 1], [4, 0, 1]][..])
    );

    // One part for each material, each in the order of the file.
    let parted = model(&format!(
        "{corners}usemtl b\nf 4 3 2\nusemtl a\nf 3 1 2\nusemtl b\nf 1 4 2\n"
    ));
    let (glb, sources) = as_glb(&parted);
    assert_eq!(sources, [0, 1, 2, 3, 0, 1, 2]);
    assert_eq!(glb.triangles, [[3, 2, 1], [0, 3, 1], [6, 4, 5]]);
    let drawn = parted.drawn().expect("drawable");
    assert_eq!((drawn.vertices, drawn.triangles), (sources.clone(), vec![0, 2, 1]));
    for (place, &source) in glb.positions.iter().zip(&sources) {
        assert_eq!(*place, parted.positions[source as usize]);
    }
}

/// A face as vertex and normal, each an index that is written absolute, or relative to what stands above.
type RandomFace = [(prop::sample::Index, prop::sample::Index, bool); 3];

proptest! {
    /// However faces, vertices and normals are mixed and counted, each corner ends up with the normal that its own
    /// vertex and `vn` line give, and everything else stays.
    #[test]
    fn every_corner_shades_with_its_own_carried_normal(
        blocks in prop::collection::vec(prop::collection::vec(any::<RandomFace>(), 0..4), 1..4),
        motion in prop::collection::vec([-2i8..3, -2i8..3, -2i8..3], 12),
    ) {
        // Three blocks of vertices, normals and faces; absolute indices may point ahead.
        let total = blocks.len() * 4;
        let mut text = String::new();
        for (b, faces) in blocks.iter().enumerate() {
            for i in 0..4 {
                let k = (b * 4 + i) as f64;
                text += &format!("v {} {} {}\nvn {} 1 {}\n", (k * 1.7) % 3.0, (k * 2.3) % 4.1, (k * 0.9) % 2.3, k - 3.0, i);
            }
            for face in faces {
                text += "f";
                for (vertex, normal, relative) in face {
                    let above = (b + 1) * 4;
                    if *relative {
                        text += &format!(" -{}//-{}", vertex.index(above) + 1, normal.index(above) + 1);
                    } else {
                        text += &format!(" {}//{}", vertex.index(total) + 1, normal.index(total) + 1);
                    }
                }
                text += "\n";
            }
        }
        let Ok(model) = Model::read(FileSet::single("", text.clone()), Some(Format::OBJ), &Limits::default()) else {
            return Ok(());
        };
        let moved: Vec<_> = (model.positions.iter().zip(motion.iter().cycle()))
            .map(|(p, m)| *p + DVec3::from_array(m.map(f64::from)) * 0.3)
            .collect();
        let out = written(&model, &moved);
        let reread = self::model(&out);
        prop_assert_eq!(&reread.positions, &moved);
        prop_assert_eq!(&reread.triangles, &model.triangles);

        let (old, new) = (named_corners(&text), named_corners(&out));
        let mut ids = BTreeMap::new();
        let corners: Vec<[u32; 3]> = old
            .chunks_exact(3)
            .map(|t| [0, 1, 2].map(|k| {
                let count = ids.len() as u32;
                *ids.entry((t[k].0, t[k].1)).or_insert(count)
            }))
            .collect();
        let gradients = shading::gradients(&model.positions, &moved, &model.triangles, &corners, ids.len());
        for (corner, (before, after)) in old.iter().zip(&new).enumerate() {
            let gradient = &gradients[corners[corner / 3][corner % 3] as usize];
            let wanted = gradient.as_ref().map_or(before.2, |g| shading::carry_normal(g, before.2));
            prop_assert_eq!(before.0, after.0);
            prop_assert!((after.2 - wanted).length() < 4e-6, "corner {}: {} not {}\n{}\n{}", corner, after.2, wanted, text, out);
        }
    }
}

/// Vertex, number of the `vn` line, and normal of each face corner.
fn named_corners(text: &str) -> Vec<(u32, u32, Vec3)> {
    let limits = Limits::default();
    let mut reader = ObjReader::new(text.as_bytes(), ReadWatch::new(&limits, &Silent, 0));
    reader.read_statements().unwrap_or_else(|e| panic!("{e}"));
    let corner = |(&v, &n): (&u32, &u32)| (v, n, reader.normals[n as usize]);
    reader
        .faces
        .corners
        .iter()
        .zip(&reader.corner_normals)
        .map(corner)
        .collect()
}

#[test]
fn pictures_lie_where_their_options_say_in_every_format() {
    let text = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n";
    let mut files = FileSet::single("a.obj", text);
    let library = "newmtl m\nmap_Kd -s 2 0.5 1 -o 0.25 0.1 my picture.png\n";
    files.companions.insert("a.mtl".into(), library.into());
    files
        .companions
        .insert("my picture.png".into(), b"\x89PNG".to_vec().into());
    let model = Model::read(files, None, &Limits::default()).expect("valid");
    let seen = |model: &Model| model.drawn().expect("a look").look.uv;
    // From the lower left: (0, 0) is at (0.25, 0.1), (1, 0) at (2.25, 0.1), (0, 1) at (0.25, 0.6).
    let placed = [[0.25, 0.9], [2.25, 0.9], [0.25, 0.4]];
    let is_near = |seen: &[[f32; 2]]| {
        let pairs = seen.as_flattened().iter().zip(placed.as_flattened());
        seen.len() == 3 && pairs.into_iter().all(|(a, b): (&f32, &f32)| (a - b).abs() < 1e-6)
    };
    assert!(is_near(&seen(&model)), "{:?}", seen(&model));
    let read = |written: WrittenFiles, name: &str| {
        Model::read(written.into_files(name), None, &Limits::default()).expect("valid")
    };
    let written = model.write(&model.positions, Format::GLTF).expect("writable");
    let json = String::from_utf8(written.main.clone()).expect("text");
    let as_gltf = read(written.clone(), "a.gltf");
    assert!(is_near(&seen(&as_gltf)), "{:?}", seen(&as_gltf));

    // The same by the extension of glTF, and back.
    let plain = r#""baseColorTexture":{"index":0"#;
    assert!(json.contains(plain), "{json}");
    let transform = r#","extensions":{"KHR_texture_transform":{"offset":[0.5,0.25],"scale":[2,3],"rotation":0.5}}"#;
    let json = json.replace(plain, &format!("{plain}{transform}"));
    let moved = read(
        WrittenFiles {
            main: json.into_bytes(),
            ..written
        },
        "a.gltf",
    );
    let drawn = seen(&moved);
    assert!(!is_near(&drawn));
    let back = read(moved.write(&moved.positions, Format::OBJ).expect("writable"), "b.obj");
    for (a, b) in seen(&back).as_flattened().iter().zip(drawn.as_flattened()) {
        assert!((a - b).abs() < 1e-6, "{:?} {drawn:?}", seen(&back));
    }
}

#[test]
fn libraries_of_wide_letters_are_read_and_statements_without_a_name_place_nothing() {
    let text = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n";
    let library = "newmtl m\r\nKd 0.25 0.5 1\r\nmap_Kd -o 0.5 0.5\r\n";
    let pairs: Vec<u16> = library.encode_utf16().collect();
    let fours: Vec<u32> = library.chars().map(u32::from).collect();
    let little = |mark: bool| {
        [
            if mark { &b"\xff\xfe"[..] } else { b"" },
            &pairs.iter().flat_map(|u| u.to_le_bytes()).collect::<Vec<_>>(),
        ]
        .concat()
    };
    let big = [
        &b"\xfe\xff"[..],
        &pairs.iter().flat_map(|u| u.to_be_bytes()).collect::<Vec<_>>(),
    ]
    .concat();
    let wide = [
        &b"\xff\xfe\0\0"[..],
        &fours.iter().flat_map(|u| u.to_le_bytes()).collect::<Vec<_>>(),
    ]
    .concat();
    for bytes in [library.as_bytes().to_vec(), little(true), little(false), big, wide] {
        let mut files = FileSet::single("a.obj", text);
        files.companions.insert("a.mtl".into(), bytes.clone().into());
        let model = Model::read(files, None, &Limits::default()).expect("valid");
        let look = model.drawn().expect("a look").look;
        assert_eq!(look.materials[0].factor, [0.25, 0.5, 1.0, 1.0], "{bytes:?}");
        assert!(look.uv.first().is_none_or(|uv| *uv == [0.0, 1.0]), "{:?}", look.uv);
    }
    let wild = "newmtl m\nmap_Kd -s 1e9 1 a.png\n";
    assert!(codes_of(text, Some(wild)).contains(&"placing-ignored".to_owned()));
    let usual = "newmtl m\nmap_Kd -s 9 1 a.png\n";
    assert!(!codes_of(text, Some(usual)).contains(&"placing-ignored".to_owned()));
}

/// The codes of what a text and its library are warned of.
fn codes_of(text: &str, library: Option<&str>) -> Vec<String> {
    let mut files = FileSet::single("test.obj", text.to_owned());
    let library = library.map(|text| ("a.mtl".to_owned(), text.to_owned().into()));
    files.companions.extend(library);
    let read = Model::read(files, None, &Limits::default()).expect("readable");
    read.warnings.iter().map(|w| w.0.clone()).collect()
}

#[test]
fn what_is_not_as_it_should_be_is_said() {
    const FACE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    assert_eq!(
        codes_of(&format!("{FACE}l 1 2\nl 3 -1\np 2\n"), None),
        Vec::<String>::new()
    );
    for line in ["l 1 9", "l 1 0", "p -7", "l a 1"] {
        assert_eq!(codes_of(&format!("{FACE}{line}\n"), None), ["bad-line-index"], "{line}");
    }
    // A vertex that comes after the line is one all the same.
    assert_eq!(codes_of(&format!("{FACE}l 1 4\nv 2 2 2\n"), None), Vec::<String>::new());
    let wide: Vec<u8> = FACE.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let wide = FileSet::single("wide.obj", [b"\xff\xfe".as_slice(), &wide].concat());
    let refused = Model::read(wide, None, &Limits::default())
        .expect_err("UTF-16")
        .to_string();
    assert!(refused.contains("save it as UTF-8"), "{refused}");
    let with_library = format!("mtllib a.mtl\n{FACE}");
    for (library, codes) in [
        (
            "newmtl m\nmap_Kd a b.png -s 2 2 1 -clamp on\nnorm n.png -s 2 2 1\n",
            vec!["image-missing"],
        ),
        (
            "newmtl m\nmap_Kd a.png\nnorm -s 2 2 1 n.png\n",
            vec!["normals-elsewhere", "image-missing"],
        ),
        (
            "newmtl m\nnorm -s 2 2 1 n.png\nnewmtl o\nmap_Kd a.png\n",
            vec!["image-missing"],
        ),
    ] {
        assert_eq!(codes_of(&with_library, Some(library)), codes, "{library}");
    }
}

#[test]
fn options_may_stand_on_either_side_of_a_name() {
    let names = |library: &str| {
        let mut files = FileSet::single("test.obj", "mtllib a.mtl\n");
        files.companions.insert("a.mtl".into(), library.to_owned().into());
        super::library::companion_names(&files)
    };
    for (statement, name) in [
        ("-o 0.5 0 0 wood.png", "wood.png"),
        ("wood.png -o 0.5 0 0", "wood.png"),
        ("my wood - dark.png -s 2 2 -clamp on", "my wood - dark.png"),
        ("-s 2 2 2 wood-s.png", "wood-s.png"),
        ("a -x b.png", "a -x b.png"),
    ] {
        assert_eq!(
            names(&format!("newmtl m\nmap_Kd {statement}\n")),
            ["a.mtl", name],
            "{statement}"
        );
    }
    // A scale that leaves nothing of a picture is none.
    let files = |scale: &str| {
        let text = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n";
        let mut files = FileSet::single("test.obj", text);
        let library = format!("newmtl m\nmap_Kd {scale} a.png\n");
        files.companions.insert("a.mtl".into(), library.into());
        files.companions.insert("a.png".into(), b"picture".to_vec().into());
        let model = Model::read(files, None, &Limits::default()).expect("readable");
        model
            .write(&model.positions.clone(), Format::GLB)
            .expect("written")
            .main
    };
    assert_eq!(files("-s 1e300 1e300"), files(""));
    assert_ne!(files("-s 2 2"), files(""));
}

#[test]
fn groups_that_another_format_has_not_are_counted() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\ng left\ns 1\nf 1 2 3\ng right\ns off\nf 2 4 3\n";
    let told = |text: &str| -> Vec<String> {
        let model =
            Model::read(FileSet::single("two.obj", text.to_owned()), None, &Limits::default()).expect("readable");
        let written = model.write(&model.positions, Format::PLY).expect("written");
        written.warnings.iter().map(|w| w.message.clone()).collect()
    };
    assert_eq!(
        told(text),
        ["the ply file has not: 2 groups and objects, 2 smoothing groups"]
    );
    // One name for all divides nothing.
    let one = text.replace("g right", "g left").replace("s off", "s 1");
    assert!(told(&one).is_empty());
}
