//! Object File Format (OFF) with its optional colours, normals and texture coordinates.
//!
//! Each vertex and each face begins a line of its own; what follows the numbers that the mesh needs (colours, texture
//! coordinates) is kept unread.

mod remade;

pub(super) use remade::{extras, write_remade};

use super::files::check_main_size;
use super::geometry::unit_or_zero;
use super::polygons::Polygons;
use super::text::{Lexer, Patch, Precision, Style, Token, coordinate, integer, number, push_triple, shown};
use super::{Error, Format, Geometry, Limits};
use crate::mesh::shading;
use glam::{DVec3, Vec3};
use std::io::Write as _;

/// What the writer must know beyond the file and the geometry.
#[derive(Debug, Clone)]
pub struct Source {
    /// Offset of the first vertex.
    vertices_at: u32,
    /// Whether three numbers of a normal follow each position.
    has_normals: bool,
}

const STYLE: Style = Style {
    comments: true,
    continuation: false,
};

fn malformed(line: u32, problem: impl Into<String>) -> Error {
    Error::malformed(Format::Off, format!("line {line}"), problem)
}

/// Reads an OFF file.
pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<(Geometry, Source), Error> {
    check_main_size(bytes)?;
    let mut lexer = Lexer::new(bytes, STYLE);
    let has_normals = header(&mut lexer)?;
    let (vertex_count, vertex_line) = count(&mut lexer, "vertices")?;
    let (face_count, face_line) = count(&mut lexer, "faces")?;
    lexer.end_line();
    limits.check_vertices(vertex_count)?;
    limits.check_triangles(face_count)?;
    // A vertex takes three digits, each with a blank or a line end; a face, a digit and a line end.
    let (left, needed) = (lexer.bytes_left() as u64 + 1, vertex_count * 6 + face_count * 2);
    if needed > left {
        let line = vertex_line.max(face_line);
        let problem =
            format!("{vertex_count} vertices and {face_count} faces take {needed} bytes at least, {left} are left");
        return Err(malformed(line, problem));
    }
    let vertices_at = lexer.at() as u32;
    let mut positions = Vec::with_capacity(vertex_count as usize);
    let mut normals = Vec::with_capacity(if has_normals { vertex_count as usize } else { 0 });
    for i in 0..vertex_count {
        positions.push(triple(&mut lexer, &format_args!("vertex {i}"))?);
        if has_normals {
            normals.push(normal(&mut lexer, i)?);
        }
        lexer.end_line();
    }
    let mut faces = Polygons::default();
    for i in 0..face_count {
        face(&mut lexer, i, vertex_count, &mut faces, limits)?;
    }
    let (slots, crude) = faces.triangulate(&positions);
    let triangles = slots.iter().map(|t| t.map(|s| faces.corners[s as usize])).collect();
    let mut geometry = Geometry::of_one_mesh(positions, normals, triangles);
    geometry.warn_of_crude_polygons(crude);
    Ok((
        geometry,
        Source {
            vertices_at,
            has_normals,
        },
    ))
}

/// Reads the keyword, which may be missing, and says whether vertices have normals.
fn header(lexer: &mut Lexer<'_>) -> Result<bool, Error> {
    let mut ahead = lexer.clone();
    let Some(token) = ahead.token() else {
        return Err(malformed(lexer.line(), "the file is empty; the keyword OFF is needed"));
    };
    let word = lexer.text(token);
    let Some(prefix) = word.strip_suffix(b"OFF") else {
        if integer(word).is_some() {
            return Ok(false);
        }
        return Err(malformed(
            token.line,
            format!("{} where the keyword OFF is needed", shown(word)),
        ));
    };
    let unsupported = |problem: &str, hint: &str| Error::Unsupported {
        format: Format::Off,
        place: format!("line {}", token.line),
        problem: problem.into(),
        hint: hint.into(),
    };
    let rest = prefix.strip_prefix(b"ST").unwrap_or(prefix);
    if rest.iter().any(|b| b"4n".contains(b)) {
        return Err(unsupported(
            "coordinates that are not three-dimensional",
            "write the mesh with x, y and z only",
        ));
    }
    if !rest.iter().all(|b| b"CN".contains(b)) {
        return Err(malformed(
            token.line,
            format!("{} where the keyword OFF is needed", shown(word)),
        ));
    }
    *lexer = ahead.clone();
    if ahead.token_on_line().is_some_and(|t| ahead.text(t) == b"BINARY") {
        return Err(unsupported("binary OFF", "write it as text, or as PLY or GLB"));
    }
    Ok(rest.contains(&b'N'))
}

fn count(lexer: &mut Lexer<'_>, what: &str) -> Result<(u64, u32), Error> {
    let Some(token) = lexer.token() else {
        return Err(malformed(
            lexer.line(),
            format!("the file ends where the number of {what} is needed"),
        ));
    };
    let word = lexer.text(token);
    let number = integer(word)
        .and_then(|n| u64::try_from(n).ok())
        .filter(|&n| n <= u64::from(u32::MAX));
    let problem = || {
        format!(
            "{} where the number of {what} is needed, 0 to {}",
            shown(word),
            u32::MAX
        )
    };
    number
        .map(|n| (n, token.line))
        .ok_or_else(|| malformed(token.line, problem()))
}

fn words(lexer: &mut Lexer<'_>) -> Option<[Token; 3]> {
    Some([lexer.token()?, lexer.token()?, lexer.token()?])
}

fn triple(lexer: &mut Lexer<'_>, what: &dyn std::fmt::Display) -> Result<DVec3, Error> {
    let Some(words) = words(lexer) else {
        return Err(malformed(lexer.line(), format!("the file ends inside {what}")));
    };
    let mut values = DVec3::ZERO;
    for (i, word) in words.into_iter().enumerate() {
        values[i] = coordinate(lexer.text(word), Precision::Double)
            .map_err(|problem| malformed(word.line, format!("{what}: {problem}")))?;
    }
    Ok(values)
}

/// A normal that is not finite is common in exports of degenerate faces; it counts as none.
fn normal(lexer: &mut Lexer<'_>, vertex: u64) -> Result<Vec3, Error> {
    let Some(words) = words(lexer) else {
        return Err(malformed(
            lexer.line(),
            format!("the file ends inside the normal of vertex {vertex}"),
        ));
    };
    let mut values = DVec3::ZERO;
    for (i, word) in words.into_iter().enumerate() {
        let text = lexer.text(word);
        let problem = || format!("the normal of vertex {vertex} has {} for a number", shown(text));
        values[i] = number(text).ok_or_else(|| malformed(word.line, problem()))?;
    }
    Ok(unit_or_zero(values))
}

fn face(
    lexer: &mut Lexer<'_>,
    face: u64,
    vertex_count: u64,
    faces: &mut Polygons,
    limits: &Limits,
) -> Result<(), Error> {
    let (corners, line) = count(lexer, &format!("corners of face {face}"))?;
    let left = lexer.bytes_left() as u64;
    if corners * 2 > left + 1 {
        return Err(malformed(
            line,
            format!("face {face} declares {corners} corners, {left} bytes are left"),
        ));
    }
    limits.check_triangles(faces.triangle_count() + corners.saturating_sub(2))?;
    for _ in 0..corners {
        let Some(token) = lexer.token() else {
            return Err(malformed(lexer.line(), format!("the file ends inside face {face}")));
        };
        let word = lexer.text(token);
        let vertex = integer(word)
            .and_then(|v| u64::try_from(v).ok())
            .filter(|&v| v < vertex_count);
        let Some(vertex) = vertex else {
            let problem = format!(
                "face {face} names vertex {}; there are {vertex_count}, counted from 0",
                shown(word)
            );
            return Err(malformed(token.line, problem));
        };
        faces.corners.push(vertex as u32);
    }
    faces.end_face();
    lexer.end_line();
    Ok(())
}

/// The uploaded text with the vertices at `positions`.
pub(super) fn write(bytes: &[u8], source: &Source, rest: &Geometry, positions: &[DVec3]) -> Vec<u8> {
    let gradients = source.has_normals.then(|| {
        shading::gradients(
            &rest.positions,
            positions,
            &rest.triangles,
            &rest.triangles,
            positions.len(),
        )
    });
    let mut lexer = Lexer::starting_at(bytes, source.vertices_at as usize, 1, STYLE);
    let mut patch = Patch::new(bytes);
    for (i, (&old, &new)) in rest.positions.iter().zip(positions).enumerate() {
        if let Some(words) = words(&mut lexer) {
            patch.replace_changed(words, old, new, Precision::Double);
        }
        if let Some(gradients) = &gradients
            && let Some(words) = words(&mut lexer)
            && let Some(gradient) = &gradients[i]
        {
            let (old, new) = (rest.normals[i], shading::carry_normal(gradient, rest.normals[i]));
            patch.replace_changed(words, old.as_dvec3(), new.as_dvec3(), Precision::Single);
        }
        lexer.end_line();
    }
    patch.finish()
}

/// A fresh text, with normals where every vertex has one.
pub(super) fn build(geometry: &Geometry) -> Vec<u8> {
    let with_normals = geometry.all_have_normals();
    let mut out = if with_normals {
        b"NOFF\n".to_vec()
    } else {
        b"OFF\n".to_vec()
    };
    let line = |out: &mut Vec<u8>, numbers: [u64; 3], lead: &str| {
        let [a, b, c] = numbers;
        let result = writeln!(out, "{lead}{a} {b} {c}");
        debug_assert!(result.is_ok(), "writing to memory does not fail");
    };
    line(
        &mut out,
        [geometry.positions.len() as u64, geometry.triangles.len() as u64, 0],
        "",
    );
    for (i, &position) in geometry.positions.iter().enumerate() {
        push_triple(&mut out, position, Precision::Double);
        if with_normals {
            out.push(b' ');
            push_triple(&mut out, geometry.normals[i].as_dvec3(), Precision::Single);
        }
        out.push(b'\n');
    }
    for triangle in &geometry.triangles {
        line(&mut out, triangle.map(u64::from), "3 ");
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::{FileSet, Model};

    fn read_text(text: &str) -> Result<Model, Error> {
        Model::read(
            FileSet::single("test.off", text.as_bytes().to_vec()),
            Some(Format::Off),
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
        let same = model.write(&model.positions, Format::Off).expect("writable");
        assert_eq!(same.main, COLOURED.as_bytes());
        let moved: Vec<_> = model.positions.iter().map(|p| DVec3::new(p.x, p.y, p.x)).collect();
        let out = String::from_utf8(model.write(&moved, Format::Off).expect("writable").main).expect("text");
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
        let text = String::from_utf8(build(&geometry)).expect("text");
        assert_eq!(read_text(&text).expect("valid").geometry, geometry);
    }
}
