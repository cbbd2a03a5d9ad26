//! Quads and polygons between OBJ, PLY and OFF, and through edits: faces keep their corners, in their order.

use crate::support::data::data_path;
use glam::{DAffine3, DVec3};
use pliant::asset::{
    BaseModel, EditedModel, FileSet, Format, Limits, Model, PrimitiveRun, VertexBlends, write_edited_model,
};
use proptest::prelude::*;
use std::fmt::Write as _;

/// The corners of every face, as vertices counted from 0.
type FaceList = Vec<Vec<u32>>;

fn read(name: &str, bytes: impl Into<bytes::Bytes>) -> Model {
    let read = Model::read(FileSet::single(name, bytes), None, &Limits::default());
    read.unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// The faces of a file, by readers of their own.
fn faces_of(format: Format, bytes: &[u8]) -> FaceList {
    match format.name() {
        "obj" => obj_faces(&String::from_utf8_lossy(bytes)),
        "off" => off_faces(&String::from_utf8_lossy(bytes)),
        _ => ply_faces(bytes),
    }
}

fn obj_faces(text: &str) -> FaceList {
    let mut vertices = 0i64;
    let mut faces = FaceList::new();
    // A backslash continues a line.
    for line in text.replace("\\\r\n", " ").replace("\\\n", " ").lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => vertices += 1,
            Some("f") => {
                let corner = |word: &str| {
                    let first = word.split('/').next().unwrap_or_default();
                    let number: i64 = first.parse().expect("an index");
                    (if number < 0 { vertices + number } else { number - 1 }) as u32
                };
                faces.push(words.map(corner).collect());
            }
            _ => {}
        }
    }
    faces
}

fn off_faces(text: &str) -> FaceList {
    let lines: Vec<&str> = text
        .lines()
        .map(|line| line.split('#').next().unwrap_or_default().trim())
        .filter(|line| !line.is_empty())
        .collect();
    let numbers = |line: &str| -> Vec<u32> { line.split_whitespace().map_while(|w| w.parse().ok()).collect() };
    let counts = numbers(lines[1]);
    let faces = lines[2 + counts[0] as usize..].iter().take(counts[1] as usize);
    faces
        .map(|line| {
            let row = numbers(line);
            row[1..=row[0] as usize].to_vec()
        })
        .collect()
}

/// Of a binary little-endian file with vertices, then faces whose first property is the list of corners.
fn ply_faces(bytes: &[u8]) -> FaceList {
    let end = bytes.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
    let header = String::from_utf8_lossy(&bytes[..end]).into_owned();
    assert!(header.contains("binary_little_endian"), "{header}");
    let size = |name: &str| match name {
        "char" | "uchar" | "int8" | "uint8" => 1,
        "short" | "ushort" | "int16" | "uint16" => 2,
        "double" | "float64" => 8,
        _ => 4,
    };
    let (mut rows, mut stride, mut count_size, mut in_faces) = ([0usize; 2], 0, 1, false);
    let mut after = Vec::new();
    for line in header.lines() {
        match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["element", name, count] => {
                in_faces = name == "face";
                rows[usize::from(in_faces)] = count.parse().expect("a count");
            }
            ["property", "list", count, _, "vertex_indices" | "vertex_index"] => count_size = size(count),
            ["property", "list", count, item, _] => after.push((size(count), size(item))),
            ["property", kind, _] if !in_faces => stride += size(kind),
            _ => {}
        }
    }
    let mut at = end + rows[0] * stride;
    let mut take = |bytes_taken: usize| {
        let value = bytes[at..at + bytes_taken]
            .iter()
            .rev()
            .fold(0u64, |v, b| v << 8 | u64::from(*b));
        at += bytes_taken;
        value as u32
    };
    let mut faces = FaceList::new();
    for _ in 0..rows[1] {
        let count = take(count_size);
        faces.push((0..count).map(|_| take(4)).collect());
        for &(count, item) in &after {
            for _ in 0..take(count) {
                take(item);
            }
        }
    }
    faces
}

/// A model's faces after it went OBJ → PLY → OFF → OBJ, or straight to one; all must be those that it came with.
fn check_chain(name: &str, model: &Model) {
    let wanted: FaceList = {
        let own = faces_of(model.format, &model.files.main);
        own.into_iter().filter(|face| face.len() >= 3).collect()
    };
    let mut here = model.clone();
    for format in [
        Format::PLY,
        Format::OFF,
        Format::OBJ,
        Format::OFF,
        Format::PLY,
        Format::OBJ,
    ] {
        let written = here.write(&here.positions, format).expect("writable");
        let seen = faces_of(format, &written.main);
        assert!(
            seen == wanted,
            "{name}: {} faces became {} in {format}",
            wanted.len(),
            seen.len()
        );
        let again = read(&format!("again.{format}"), written.main);
        assert_eq!(again.positions, model.positions, "{name} in {format}");
        assert_eq!(again.triangles, model.triangles, "{name} in {format}");
        here = again;
    }
}

/// A grid of `cells` quads in a wavy plane.
fn grid(cells: u32) -> String {
    let mut text = String::from("# a grid\n");
    for y in 0..=cells {
        for x in 0..=cells {
            let z = 0.1 * f64::from((3 * x + 5 * y) % 7);
            writeln!(text, "v {x} {y} {z}").expect("memory");
        }
    }
    for y in 0..cells {
        for x in 0..cells {
            let a = y * (cells + 1) + x + 1;
            writeln!(text, "f {a} {} {} {}", a + 1, a + cells + 2, a + cells + 1).expect("memory");
        }
    }
    text
}

#[test]
fn real_models_keep_their_quads() {
    for name in [
        "horse_quad.obj",
        "beast.obj",
        "LeePerrySmith.obj",
        "spot_control_mesh.obj",
        "suzanne.obj",
    ] {
        let Some(path) = data_path("quads of a real model", &format!("meshes/{name}")) else {
            return;
        };
        let model = read(name, std::fs::read(path).expect("a file"));
        check_chain(name, &model);
    }
}

#[test]
fn a_grid_with_coordinates_and_normals_keeps_its_quads() {
    check_chain("grid", &read("grid.obj", grid(6)));
    let mut dressed = grid(2).replace("f ", "f");
    dressed = dressed
        .lines()
        .map(|line| match line.strip_prefix('f') {
            Some(corners) => {
                let corners: Vec<String> = corners.split(' ').map(|c| format!("{c}/{c}/1")).collect();
                format!("f {}\n", corners.join(" "))
            }
            None => format!("{line}\n"),
        })
        .collect();
    let coordinates: String = (0..9).map(|i| format!("vt {} {}\n", i % 3, i / 3)).collect();
    let text = dressed.replacen("f ", &format!("{coordinates}vn 0 0 1\nf "), 1);
    check_chain("a dressed grid", &read("dressed.obj", text));
}

#[test]
fn a_face_of_three_hundred_corners_survives_a_type_that_counts_to_255() {
    let mut text = String::new();
    for i in 0..300 {
        let (sin, cos) = libm::sincos(f64::from(i) * std::f64::consts::TAU / 300.0);
        writeln!(text, "v {cos} {sin} 0").expect("memory");
    }
    let corners: Vec<String> = (1..=300).map(|i| i.to_string()).collect();
    check_chain("a disk", &read("disk.obj", format!("{text}f {}\n", corners.join(" "))));
}

/// An edited model that has lost some of its triangles.
fn without_triangles(model: &Model, lost: &[bool], format: Format) -> Vec<u8> {
    let kept = || (0..model.triangles.len()).filter(|&t| !lost[t]);
    let triangles: Vec<[u32; 3]> = kept().map(|t| model.triangles[t]).collect();
    let origins: Vec<u32> = kept().map(|t| t as u32).collect();
    let count = model.positions.len() as u32;
    let edited = EditedModel {
        bases: &[BaseModel {
            model,
            world_from_model: DAffine3::IDENTITY,
        }],
        runs: &[PrimitiveRun {
            base: 0,
            primitive: 0,
            first_vertex: 0,
            vertex_count: count,
            first_triangle: 0,
            triangle_count: triangles.len() as u32,
        }],
        blends: &VertexBlends::identity(count),
        triangles: &triangles,
        origins: &origins,
        bare: &[],
        caps: Default::default(),
    };
    write_edited_model(&edited, &model.positions, format)
        .expect("writable")
        .main
}

#[test]
fn an_edit_leaves_the_quads_alone_that_it_does_not_touch() {
    let obj = read("grid.obj", grid(5));
    for format in [Format::OBJ, Format::PLY, Format::OFF] {
        let model = match format.name() {
            "obj" => obj.clone(),
            _ => read(
                &format!("grid.{format}"),
                obj.write(&obj.positions, format).expect("writable").main,
            ),
        };
        let quads = faces_of(format, &model.files.main);
        // One triangle of the quad 3, and both of the quad 7.
        let mut lost = vec![false; model.triangles.len()];
        [6, 14, 15].into_iter().for_each(|t| lost[t] = true);
        let mut wanted = quads.clone();
        wanted[3] = model.triangles[7].to_vec();
        wanted.remove(7);
        for to in [Format::OBJ, Format::PLY, Format::OFF] {
            let seen = faces_of(to, &without_triangles(&model, &lost, to));
            assert_eq!(seen, wanted, "{format} to {to}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Faces of any number of corners, flat or not, convex or not, with corners that repeat: what one format says, all say.
    #[test]
    fn any_faces_keep_their_corners(
        points in prop::collection::vec((-4i32..5, -4i32..5, -2i32..3), 3..14),
        faces in prop::collection::vec(prop::collection::vec(0usize..14, 1..8), 1..12),
    ) {
        let mut text = String::new();
        for (x, y, z) in &points {
            writeln!(text, "v {x} {y} {z}").expect("memory");
        }
        let mut any = false;
        for face in &faces {
            let corners: Vec<String> = face.iter().map(|c| (c % points.len() + 1).to_string()).collect();
            any |= corners.len() >= 3;
            writeln!(text, "f {}", corners.join(" ")).expect("memory");
        }
        prop_assume!(any);
        let model = read("any.obj", text);
        prop_assert!(model.positions.iter().all(|p| *p == p.round() && *p != DVec3::NAN));
        check_chain("any", &model);
    }
}
