use super::super::text::tests::assert_refused;
use super::*;
use crate::{CapLooks, FileSet, Limits, Model, PrimitiveRun, VertexBlends};
use glam::Vec3;

fn read_bytes(bytes: impl Into<Vec<u8>>) -> Result<Model, Error> {
    Model::read(
        FileSet::single("test.stl", bytes.into()),
        Some(Format::STL),
        &Limits::default(),
    )
}

/// Two facets, with a header that looks like text and attributes that say something.
fn binary() -> Vec<u8> {
    let mut bytes = b"solid but binary".to_vec();
    bytes.resize(80, b'x');
    bytes.extend(2u32.to_le_bytes());
    for (i, facet) in [
        [[0., 0., 9.], [0., 0., 0.], [1., 0., 0.], [0., 1., 0.]],
        [[0., 0., 9.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]],
    ]
    .iter()
    .enumerate()
    {
        bytes.extend(facet.iter().flatten().flat_map(|v: &f32| v.to_le_bytes()));
        bytes.extend([0xab, i as u8]);
    }
    bytes
}

const TEXT: &str = "solid a name with vertex and facet\r\n  FACET NORMAL 0 0 9\r\n    outer loop\r\n      vertex 0.0 0.0 0.0\r\n\
    \t\tVERTEX 1 0 0\r\n      vertex 0 1e0 0\r\n    endloop\r\n  endfacet\r\nfacet normal 0 0 1\nouter loop\nvertex 1 0 0\n\
    vertex 1 1 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a name\nsolid two\nendsolid";

#[test]
fn both_kinds_keep_facets_that_did_not_move() {
    let model = read_bytes(binary()).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((model.positions.len(), model.triangles.len()), (6, 2));
    let mut moved = model.positions.clone();
    moved[4].z = 1.0;
    let out = model.write(&moved, FORMAT).expect("writable").main;
    let old = binary();
    assert_eq!(out[..HEADER + FACET], old[..HEADER + FACET]);
    assert_eq!(out[out.len() - 2..], old[old.len() - 2..]);
    let normal = read_vector(&out[HEADER + FACET..], 0);
    assert!(
        (normal - DVec3::new(-1.0, -1.0, 1.0).normalize()).length() < 1e-6,
        "{normal}"
    );
    assert_eq!(read_bytes(out).expect("valid").positions, moved);

    let model = read_bytes(TEXT).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(model.positions[2], DVec3::Y);
    assert_eq!(
        model.write(&model.positions, FORMAT).expect("writable").main,
        TEXT.as_bytes()
    );
    moved[4].z = 0.1;
    let out = String::from_utf8(model.write(&moved, FORMAT).expect("writable").main).expect("text");
    let (head, tail) = TEXT.split_at(TEXT.find("facet normal 0 0 1").expect("there"));
    assert!(out.starts_with(head) && out.contains("\nvertex 1 1 0.1\n"), "{out}");
    assert!(out.ends_with(&tail[tail.find("endloop").expect("there")..]));
    assert_eq!(read_bytes(out).expect("valid").positions, moved);
}

#[test]
fn what_is_wrong_is_named_with_its_place() {
    let nan = {
        let mut bytes = binary();
        bytes[HEADER + FACET + 12..HEADER + FACET + 16].copy_from_slice(&f32::NAN.to_le_bytes());
        bytes
    };
    let cut = [b"SOLAR", &binary()[5..150]].concat();
    for (bytes, place, phrase) in [
        (b"short".to_vec(), "byte 0", "5 bytes"),
        (cut, "byte 80", "2 facets are declared, the file holds 1"),
        (nan, "facet 1", "corner 0"),
        (
            b"solid\nfacet normal 0 0 1\nouter\nvertex 0 0 0".to_vec(),
            "line 4",
            "`vertex` where `loop`",
        ),
        (
            b"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0".to_vec(),
            "line 4",
            "ends inside a vertex",
        ),
        (
            b"solid\nfacet\nouter loop\nvertex 0 0 a\nvertex 0 0 0 vertex 0 0 0 endloop endfacet".to_vec(),
            "line 4",
            "`a` is not a number",
        ),
        (b"solid\nfacets".to_vec(), "line 2", "`facets` where `facet`"),
    ] {
        assert_refused(read_bytes(bytes.clone()), place, phrase, &bytes);
    }
    assert!(matches!(
        read_bytes("solid nothing\nendsolid\n"),
        Err(Error::NoMesh { .. })
    ));
}

#[test]
fn bytes_after_the_last_facet_are_kept() {
    let mut bytes = binary();
    bytes[..5].copy_from_slice(b"SOLAR");
    bytes.extend(b"more");
    let model = read_bytes(bytes.clone()).expect("valid");
    assert_eq!(model.warnings.len(), 1);
    let moved: Vec<_> = model.positions.iter().map(|p| *p * 2.0).collect();
    assert!(model.write(&moved, FORMAT).expect("writable").main.ends_with(b"more"));
}

#[test]
fn a_fresh_file_has_a_facet_for_each_triangle() {
    let geometry = read_bytes(TEXT).expect("valid").geometry;
    let reread = read_bytes(facets_file(&geometry.triangles, &geometry.positions).expect("fits")).expect("valid");
    assert_eq!(reread.positions, geometry.positions);
    assert_eq!(
        read_vector(
            &facets_file(&geometry.triangles, &geometry.positions).expect("fits")[HEADER..],
            0
        )
        .as_vec3(),
        Vec3::Z
    );
    let far = [DVec3::splat(1e39)];
    assert!(matches!(
        facets_file(&geometry.triangles, &far),
        Err(Error::Unwritable { .. })
    ));
}

#[test]
fn words_of_other_programs_are_read() {
    let others = TEXT
        .replace("endloop", "end loop")
        .replace("endfacet", "END FACET")
        .replace("facet normal", "color 0.5 0.5 0.5\nfacet normal")
        .replace("outer loop\nvertex", "color 1 0 0\nouter loop\ncolor 0 0 1\nvertex");
    let model = read_bytes(format!("\u{feff}{others}")).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(model.positions, read_bytes(TEXT).expect("valid").positions);
    let codes: Vec<&str> = model.warnings.iter().map(|w| w.0.as_str()).collect();
    assert_eq!(codes, ["colours-skipped"]);
    assert!(model.warnings[0].1.starts_with("3 lines"), "{:?}", model.warnings);
    let moved: Vec<DVec3> = model.positions.iter().map(|p| *p + DVec3::Z).collect();
    let out = String::from_utf8(model.write(&moved, FORMAT).expect("writable").main).expect("text");
    assert_eq!(out.matches("color").count(), 3, "{out}");
    assert_eq!(read_bytes(out).expect("valid").positions, moved);

    let comma = TEXT.replace("1e0", "1,0");
    assert_refused(
        read_bytes(comma.clone()),
        "line 6",
        "`1,0` has a decimal comma",
        comma.as_bytes(),
    );
}

#[test]
fn what_facets_do_not_hold_is_said_with_an_edit_and_without() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 9 9 9\nf 1 2 3\nf 2 4 3\nl 1 2\n";
    let model = Model::read(FileSet::single("one.obj", text), None, &Limits::default()).expect("readable");
    let said = |written: &WrittenFiles| -> Vec<String> {
        let left_out = written.warnings.iter().filter(|w| w.code == "left-out");
        left_out.map(|w| w.message.clone()).collect()
    };
    let mut expected = [
        "the stl file has not: 1 line",
        "the stl file has not: 1 point in no triangle",
    ];
    expected.sort_unstable();
    let mut whole = said(&model.write(&model.positions, Format::STL).expect("writable"));
    whole.sort_unstable();
    assert_eq!(whole, expected);

    let runs = [PrimitiveRun {
        base: 0,
        primitive: 0,
        first_vertex: 0,
        vertex_count: 5,
        first_triangle: 0,
        triangle_count: 2,
    }];
    let edited = EditedModel {
        bases: &[BaseModel {
            model: &model,
            world_from_model: glam::DAffine3::IDENTITY,
        }],
        runs: &runs,
        blends: &VertexBlends::identity(5),
        triangles: &model.triangles,
        origins: &[],
        bare: &[],
        caps: CapLooks::default(),
    };
    let written = crate::write_edited_model(&edited, &model.positions, Format::STL).expect("writable");
    let mut after = said(&written);
    after.sort_unstable();
    assert_eq!(after, expected);
}

#[test]
fn comments_and_blank_lines_may_stand_above_a_solid() {
    let facet =
        "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n";
    for head in ["", "\n\n  ", "# made by hand\n\n; or not\n// at all\n"] {
        let text = format!("{head}solid a\n{facet}");
        let read = Model::read(FileSet::single("part.stl", text), None, &Limits::default());
        assert_eq!(read.expect(head).triangles.len(), 1, "{head:?}");
    }
}
