use super::super::text::tests::assert_refused;
use super::body::{PlyEncoding, PlyScalar, push};
use super::build;
use crate::neutral::NeutralModel;
use crate::{Error, FileSet, Format, Limits, Model};
use glam::{DVec3, Vec3};

fn read_bytes(bytes: impl Into<Vec<u8>>) -> Result<Model, Error> {
    Model::read(FileSet::single("test.ply", bytes.into()), None, &Limits::default())
}

/// A tetrahedron with everything that a reader may stumble over: an element before the vertices, properties in odd
/// order and of several types, lists among the vertices' properties, faces with more than indices.
fn awkward(encoding: PlyEncoding, real: &str) -> Vec<u8> {
    let format = match encoding {
        PlyEncoding::Ascii => "ascii",
        PlyEncoding::Little => "binary_little_endian",
        PlyEncoding::Big => "binary_big_endian",
    };
    let mut out = format!(
        "ply\nformat {format} 1.0\ncomment x y z\nelement camera 2\nproperty short a\nproperty list uchar float b\n\
         obj_info n\nelement empty 4000000000\nelement vertex 4\nproperty uchar red\nproperty {real} z\nproperty {real} x\n\
         property list int8 uint16 extra\nproperty float32 nx\nproperty float nz\nproperty float ny\nproperty {real} y\n\
         element face 3\nproperty char flag\nproperty list uint8 int vertex_indices\nproperty double area\nend_header\n"
    )
    .into_bytes();
    let real = PlyScalar::from_name(real.as_bytes()).expect("a type");
    let mut put = |numbers: &[(f64, PlyScalar)]| {
        for &(value, scalar) in numbers {
            push(&mut out, value, scalar, encoding);
            if encoding == PlyEncoding::Ascii {
                out.extend_from_slice(b"  ");
            }
        }
        if encoding == PlyEncoding::Ascii {
            out.extend_from_slice(b"\r\n");
        }
    };
    for row in [&[2.0, 0.5, 1.5][..], &[0.0]] {
        put(&[(-7.0, PlyScalar::I16), (row[0], PlyScalar::U8)]);
        put(&row[1..].iter().map(|&v| (v, PlyScalar::F32)).collect::<Vec<_>>());
    }
    for [x, y, z] in [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
        put(&[
            (200.0, PlyScalar::U8),
            (z, real),
            (x, real),
            (1.0, PlyScalar::I8),
            (65535.0, PlyScalar::U16),
        ]);
        put(&[
            (0.0, PlyScalar::F32),
            (1.0, PlyScalar::F32),
            (0.0, PlyScalar::F32),
            (y, real),
        ]);
    }
    for face in [&[0.0, 2.0, 1.0][..], &[0.0, 1.0, 3.0], &[1.0, 2.0, 3.0]] {
        put(&[(-1.0, PlyScalar::I8), (face.len() as f64, PlyScalar::U8)]);
        put(&face.iter().map(|&v| (v, PlyScalar::I32)).collect::<Vec<_>>());
        put(&[(0.25, PlyScalar::F64)]);
    }
    out
}

const ENCODINGS: [PlyEncoding; 3] = [PlyEncoding::Ascii, PlyEncoding::Little, PlyEncoding::Big];

#[test]
fn every_layout_reads_alike() {
    for encoding in ENCODINGS {
        for real in ["float", "double", "float64", "char", "uint16", "int"] {
            let model = read_bytes(awkward(encoding, real)).unwrap_or_else(|e| panic!("{encoding:?} {real}: {e}"));
            assert_eq!(model.positions, [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z]);
            assert_eq!(model.triangles, [[0, 2, 1], [0, 1, 3], [1, 2, 3]]);
            assert_eq!(model.normals, [Vec3::Z; 4]);
            assert!(model.primitives[0].has_normals);
        }
    }
}

#[test]
fn only_what_moved_is_rewritten_in_its_own_type() {
    for encoding in ENCODINGS {
        for real in ["float", "double"] {
            let bytes = awkward(encoding, real);
            let model = read_bytes(bytes.clone()).expect("valid");
            let mut moved = model.positions.clone();
            moved[3] = DVec3::new(0.1, 0.0, -2.5);
            let out = model.write(&moved, Format::PLY).expect("writable").main;
            let reread = read_bytes(out.clone()).expect("still valid");
            let rounded = if real == "float" {
                moved[3].as_vec3().as_dvec3()
            } else {
                moved[3]
            };
            assert_eq!(reread.positions[..3], model.positions[..3]);
            assert_eq!(reread.positions[3], rounded);
            assert_eq!(reread.triangles, model.triangles);
            // Vertices of the faces that moved turn; all four do here except what only the first face uses: none.
            assert_ne!(reread.normals[1], model.normals[1]);
            if encoding != PlyEncoding::Ascii {
                assert_eq!(out.len(), bytes.len());
                let header = bytes.windows(10).position(|w| w == b"end_header").expect("a header");
                assert_eq!(out[..header], bytes[..header]);
            } else {
                let words = |b: &[u8]| String::from_utf8_lossy(b).split_whitespace().count();
                assert_eq!(words(&out), words(&bytes));
            }
        }
    }
}

#[test]
fn whole_number_coordinates_become_doubles_only_when_they_must() {
    for encoding in ENCODINGS {
        let bytes = awkward(encoding, "char");
        let model = read_bytes(bytes.clone()).expect("valid");
        let mut moved = model.positions.clone();
        moved[2].y = -5.0;
        let out = model.write(&moved, Format::PLY).expect("writable").main;
        assert!(!String::from_utf8_lossy(&out).contains("property double x"));
        assert_eq!(read_bytes(out).expect("valid").positions, moved);
        moved[2].y = 0.3;
        moved[1].z = 1e300;
        let out = model.write(&moved, Format::PLY).expect("writable").main;
        let text = String::from_utf8_lossy(&out).into_owned();
        assert!(text.contains("property char x") && text.contains("property double y\n") && text.contains("double z"));
        let reread = read_bytes(out).expect("valid");
        assert_eq!((&reread.positions, &reread.triangles), (&moved, &model.triangles));
    }
}

#[test]
fn floats_refuse_what_they_cannot_hold() {
    let model = read_bytes(awkward(PlyEncoding::Little, "float")).expect("valid");
    let mut moved = model.positions.clone();
    moved[1].x = 1e39;
    let error = model.write(&moved, Format::PLY).unwrap_err();
    assert!(error.to_string().contains("vertex 1"), "{error}");
}

const HEAD: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n";
const BODY: &str = "0 0 0 1 0 0 0 1 0 1 1 0\n";

#[test]
fn strips_become_triangles_that_face_one_way() {
    let text = format!(
        "{HEAD}element tristrips 1\nproperty list int int vertex_indices\nend_header\n{BODY}9 0 1 2 3 -1 3 2 2 0\n"
    );
    let model = read_bytes(text).expect("valid");
    assert_eq!(model.triangles, [[0, 1, 2], [2, 1, 3]]);
    let text =
        format!("{HEAD}element tristrips 1\nproperty list int int vertex_index\nend_header\n{BODY}6 0 1 1 2 3 -1");
    assert_eq!(
        read_bytes(text).expect("valid").triangles,
        [[1, 2, 3]],
        "a repeated vertex turns the strip"
    );
}

#[test]
fn polygons_and_small_faces_are_understood() {
    let text = format!(
        "{HEAD}element face 3\nproperty list uchar int vertex_index\nend_header\n{BODY}4 0 1 3 2 2 0 1 3 0 1 2"
    );
    assert_eq!(
        read_bytes(text).expect("valid").triangles,
        [[0, 1, 3], [0, 3, 2], [0, 1, 2]]
    );
}

#[test]
fn a_body_may_begin_with_a_byte_that_looks_like_a_line_end() {
    for newline in ["\n", "\r", "\r\n"] {
        let head = HEAD
            .replace("ascii", "binary_little_endian")
            .replace("property float", "property uchar");
        let head = head + "element face 1\nproperty list uchar uchar vertex_index\nend_header\n";
        let mut bytes = head.replace('\n', newline).into_bytes();
        bytes.extend([10, 13, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 3, 0, 1, 2]);
        let model = read_bytes(bytes).unwrap_or_else(|e| panic!("{newline:?}: {e}"));
        assert_eq!(model.positions[0].to_array(), [10.0, 13.0, 0.0]);
    }
}

#[test]
fn what_is_wrong_is_named_with_its_place() {
    let face = "element face 1\nproperty list uchar int vertex_index\nend_header\n";
    for (text, place, phrase) in [
        ("ply\nend_header\n".to_string(), "line 2", "names no format"),
        ("ply\nformat ascii 1.0\n".into(), "line 3", "ends inside the header"),
        ("ply\nformat funny 1.0\n".into(), "line 2", "`funny`"),
        (
            "ply\nformat ascii 1.0\nproperty int x\n".into(),
            "line 3",
            "before any element",
        ),
        (
            "ply\nformat ascii 1.0\nelement vertex -1\n".into(),
            "line 3",
            "`-1` rows",
        ),
        (
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\n".into(),
            "line 4",
            "`quad`",
        ),
        (
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty list float int x\n".into(),
            "line 4",
            "whole-number",
        ),
        (
            "ply\nformat ascii 1.0\nend_header\n".into(),
            "header",
            "no element `vertex`",
        ),
        (
            "ply\nformat ascii 1.0\nelement vertex 0\nproperty int x\nend_header\n".into(),
            "header",
            "x, y and z",
        ),
        (
            format!("{HEAD}{face}0 0 0"),
            "line 10",
            "4 rows of `vertex` take 24 bytes at least",
        ),
        (
            format!("{HEAD}{face}{BODY}3 0 1 4"),
            "line 11",
            "names vertex 4; there are 4",
        ),
        (format!("{HEAD}{face}{BODY}3 0 1 -1"), "line 11", "names vertex -1"),
        (format!("{HEAD}{face}{BODY}9 0 1 1"), "line 11", "a list of 9 items"),
        (format!("{HEAD}{face}{BODY}3 0 1.0 1"), "line 11", "`1.0` does not fit"),
        (
            format!("{HEAD}{face}{}", BODY.replace("1 1 0", "1 inf 0")),
            "line 10",
            "`inf` is not finite",
        ),
        (
            format!("{HEAD}{face}{}", BODY.replace("1 1 0", "1 1e39 0")),
            "line 10",
            "not finite",
        ),
    ] {
        assert_refused(read_bytes(text.clone()), place, phrase, text.as_bytes());
    }
    let text = format!("{HEAD}end_header\n{BODY}");
    assert!(matches!(read_bytes(text), Err(Error::NoMesh { .. })));
    let text = HEAD.replace("vertex 4", "vertex 4294967295") + face;
    assert!(matches!(
        read_bytes(text),
        Err(Error::TooLarge { what: "vertices", .. })
    ));
}

#[test]
fn a_fresh_file_reads_back() {
    let geometry = read_bytes(awkward(PlyEncoding::Ascii, "double"))
        .expect("valid")
        .geometry;
    let reread = read_bytes(build(&NeutralModel::from_geometry(geometry.clone()))).expect("valid");
    assert_eq!(reread.geometry, geometry);
}

#[test]
fn edges_that_name_no_vertex_are_told() {
    let text = |edge: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
             property list uchar int vertex_indices\nelement edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n\
             0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n{edge}\n"
        )
    };
    for (edge, is_told) in [("0 2", false), ("0 3", true), ("-1 2", true)] {
        let read = read_bytes(text(edge)).expect("readable");
        assert_eq!(read.warnings.iter().any(|w| w.0 == "bad-line-index"), is_told, "{edge}");
    }
}

#[test]
fn a_header_line_of_old_blender_is_skipped() {
    let text = "ply\nformat ascii 1.0\nCreated by Blender3D 247 - www.blender.org, source file: \nelement vertex 3\n\
                property float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar uint vertex_indices\n\
                end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let model = Model::read(FileSet::single("old.ply", text), None, &Limits::default()).expect("readable");
    assert_eq!((model.positions.len(), model.triangles.len()), (3, 1));
}
