use super::read::build;
use crate::asset::neutral::NeutralModel;
use crate::asset::{Error, FileSet, Format, Limits, Model};
use glam::{DVec3, Vec3};

fn read_text(text: &str) -> Result<Model, Error> {
    Model::read(
        FileSet::single("test.off", text.as_bytes().to_vec()),
        Some(Format::OFF),
        &Limits::default(),
    )
}

const COLOURED: &str = "CNOFF # colours\r\n# a comment\r\n4 3 0\r\n\r\n0 0 0  0 0 1  255 0 0 255\r\n1 0 0  0 0 1  .5 .5 .5 1\r\n\
    1. 1 0  0 0 2  0 0 0 0 # here\r\n0 1 0  0 0 1 0 0 0 0\r\n4 0 1 2 3 255 0 0\r\n2 0 1\r\n3 0 1 \r\n 2\r\ntrailing words";

#[test]
fn colours_comments_and_layout_stay_to_the_byte() {
    let model = read_text(COLOURED).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(model.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
    assert_eq!(model.normals, [Vec3::Z; 4]);
    let same = model.write(&model.positions, Format::OFF).expect("writable");
    assert_eq!(same.main, COLOURED.as_bytes());
    let moved: Vec<_> = model.positions.iter().map(|p| DVec3::new(p.x, p.y, p.x)).collect();
    let out = String::from_utf8(model.write(&moved, Format::OFF).expect("writable").main).expect("text");
    assert!(
        out.starts_with(
            "CNOFF # colours\r\n# a comment\r\n4 3 0\r\n\r\n0 0 0  -0.70710677 0 0.70710677  255 0 0 255\r\n"
        ),
        "{out}"
    );
    assert!(out.ends_with("0 0 0 0 # here\r\n0 1 0  -0.70710677 0 0.70710677 0 0 0 0\r\n4 0 1 2 3 255 0 0\r\n2 0 1\r\n3 0 1 \r\n 2\r\ntrailing words"));
    assert_eq!(read_text(&out).expect("still valid").positions, moved);
}

#[test]
fn counts_may_stand_beside_the_keyword_or_without_one() {
    let body = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2";
    for head in [
        "OFF 3 1 0\n",
        "OFF\n3 1\n",
        "OFF\n3 1 3 # none\n",
        "3 1 0\n",
        "STOFF\n3 1 0\n",
        "COFF 3 1 0\n",
    ] {
        assert_eq!(
            read_text(&format!("{head}{body}"))
                .unwrap_or_else(|e| panic!("{head}: {e}"))
                .triangles
                .len(),
            1
        );
    }
}

#[test]
fn other_kinds_are_refused_with_a_hint() {
    for text in ["4OFF\n3 1 0\n", "nOFF\n2\n3 1 0\n", "OFF BINARY\n\0\0\0\0", "ST4nOFF\n"] {
        assert!(matches!(read_text(text), Err(Error::Unsupported { .. })), "{text}");
    }
}

#[test]
fn what_is_wrong_is_named_with_its_line() {
    let points = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n";
    for (text, line, phrase) in [
        ("", 1, "the file is empty"),
        ("HELLO", 1, "`HELLO` where the keyword"),
        ("OFF\nx 1 0\n", 2, "`x` where the number of vertices"),
        ("OFF\n3 -1 0\n", 2, "`-1` where the number of faces"),
        ("OFF\n3 1 0\n0 0 0\n", 2, "take 20 bytes at least, 7 are left"),
        ("OFF\n3 1 0\n0 0 0 9\n1 0 0 9999\n0 1", 5, "ends inside vertex 2"),
        (&format!("{points}3 0 1 3"), 6, "names vertex `3`; there are 3"),
        (&format!("{points}3 0 1 -1"), 6, "names vertex `-1`"),
        (&format!("{points}900 0 1 2"), 6, "declares 900 corners"),
        (&format!("{points}4 0 1 2     "), 6, "ends inside face 0"),
        (
            &format!("{}3 0 1 2", points.replace("1 0 0", "1 NaN 0")),
            4,
            "vertex 1: coordinate `NaN` is not finite",
        ),
    ] {
        match read_text(text) {
            Err(Error::Malformed { place, problem, .. }) => {
                assert!(
                    place == format!("line {line}") && problem.contains(phrase),
                    "{text}\n{place}: {problem}"
                );
            }
            other => panic!("{text}: {other:?}"),
        }
    }
}

#[test]
fn a_fresh_file_reads_back() {
    let geometry = read_text(COLOURED).expect("valid").geometry;
    let text = String::from_utf8(build(&NeutralModel::from_geometry(geometry.clone()))).expect("text");
    assert_eq!(read_text(&text).expect("valid").geometry, geometry);
}
