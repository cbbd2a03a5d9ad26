//! OFF in: the header, positions, normals and faces.
//!
//! OFF out: the uploaded text with the changed numbers replaced, or a fresh text.

use super::super::polygons::Polygons;
use super::super::text::{NumberPrecision, TextLexer, TextPatch, TextStyle, integer, push_triple, refuse_utf16, shown};
use crate::edited::FaceOutlines;
use crate::files::{ReadWatch, check_main_size};
use crate::format::{FormatDetails, Recognition};
use crate::geometry::unit_or_zero;
use crate::model::FileNotes;
use crate::neutral::NeutralModel;
use crate::{Error, Format, Geometry};
use glam::{DVec3, Vec3};
use pliant_mesh::shading;

/// The format, by what it is known.
pub(in super::super) const FORMAT: Format = Format::new(&FormatDetails {
    name: "off",
    aliases: &[],
    media_types: &["model/off"],
    recognise,
});

/// What the writers have to remember of a file.
#[derive(Debug)]
pub(super) struct OffNotes {
    /// Offset of the first vertex.
    pub vertices_at: u32,
    /// Whether three numbers of a normal follow each position.
    pub has_normals: bool,
    /// Faces of more than three corners.
    pub outlines: FaceOutlines,
}

impl FileNotes for OffNotes {
    fn bytes_held(&self) -> u64 {
        self.outlines.bytes_held()
    }
}

fn recognise(bytes: &[u8]) -> Recognition {
    let text = bytes.trim_ascii_start();
    let word = text.split(|b| b.is_ascii_whitespace()).next().unwrap_or_default();
    // ST, C, N, 4 and n may stand before OFF: texture coordinates, colours, normals, dimensions.
    let is_keyword = |(prefix, _): (&[u8], usize)| prefix.iter().all(|b| b"STCN4n".contains(b));
    Recognition::words(keyword_of(word).is_some_and(is_keyword))
}

/// What stands before `OFF` or `off` in a word, and how long both are. The number of vertices may follow without a blank.
fn keyword_of(word: &[u8]) -> Option<(&[u8], usize)> {
    let at = word.windows(3).position(|three| three == b"OFF" || three == b"off")?;
    word[at + 3..]
        .iter()
        .all(u8::is_ascii_digit)
        .then_some((&word[..at], at + 3))
}

pub(super) const STYLE: TextStyle = TextStyle {
    comments: true,
    continuation: false,
};

fn malformed(line: u32, problem: impl Into<String>) -> Error {
    Error::malformed(FORMAT, format!("line {line}"), problem)
}

/// Reads an OFF file.
pub(super) fn read(bytes: &[u8], watch: &ReadWatch<'_>) -> Result<(Geometry, OffNotes), Error> {
    check_main_size(bytes)?;
    refuse_utf16(bytes, FORMAT)?;
    let mut lexer = TextLexer::new(bytes, STYLE);
    let has_normals = read_header(&mut lexer)?;
    let (vertex_count, vertex_line) = read_count(&mut lexer, "vertices")?;
    let (face_count, face_line) = read_count(&mut lexer, "faces")?;
    lexer.end_line();
    watch.check_vertices(vertex_count)?;
    watch.check_triangles(face_count)?;
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
        watch.check_at(i as usize)?;
        positions.push(read_triple(&mut lexer, &format_args!("vertex {i}"))?);
        if has_normals {
            normals.push(read_normal(&mut lexer, i)?);
        }
        lexer.end_line();
    }
    let mut faces = Polygons::default();
    for i in 0..face_count {
        watch.check_at(i as usize)?;
        read_face(&mut lexer, i, vertex_count, &mut faces, watch)?;
    }
    let (geometry, outlines) = faces.into_geometry(positions, normals, watch)?;
    Ok((
        geometry,
        OffNotes {
            vertices_at,
            has_normals,
            outlines,
        },
    ))
}

/// Reads the keyword, which may be missing, and says whether vertices have normals.
pub(super) fn read_header(lexer: &mut TextLexer<'_>) -> Result<bool, Error> {
    let mut ahead = lexer.clone();
    let Some(token) = ahead.token() else {
        return Err(malformed(lexer.line(), "the file is empty; the keyword OFF is needed"));
    };
    let word = lexer.text(token);
    let Some((prefix, length)) = keyword_of(word) else {
        if integer(word).is_some() {
            return Ok(false);
        }
        return Err(malformed(
            token.line,
            format!("{} where the keyword OFF is needed", shown(word)),
        ));
    };
    let unsupported =
        |problem: &str, hint: &str| Error::unsupported(FORMAT, format!("line {}", token.line), problem, hint);
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
    lexer.go_back_to(token.start + length);
    if ahead.token_on_line().is_some_and(|t| ahead.text(t) == b"BINARY") {
        return Err(unsupported("binary OFF", "write it as text, or as PLY or GLB"));
    }
    Ok(rest.contains(&b'N'))
}

/// Reads a count, and says on which line it stands.
pub(super) fn read_count(lexer: &mut TextLexer<'_>, what: &str) -> Result<(u64, u32), Error> {
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

fn read_triple(lexer: &mut TextLexer<'_>, what: &dyn std::fmt::Display) -> Result<DVec3, Error> {
    let Some(words) = lexer.three_tokens() else {
        return Err(malformed(lexer.line(), format!("the file ends inside {what}")));
    };
    let position = lexer.position(words);
    position.map_err(|(line, problem)| malformed(line, format!("{what}: {problem}")))
}

/// A normal that is not finite is common in exports of degenerate faces; it counts as none.
fn read_normal(lexer: &mut TextLexer<'_>, vertex: u64) -> Result<Vec3, Error> {
    let Some(words) = lexer.three_tokens() else {
        let problem = format!("the file ends inside the normal of vertex {vertex}");
        return Err(malformed(lexer.line(), problem));
    };
    let normal = lexer.numbers(words).map_err(|word| {
        let seen = shown(lexer.text(word));
        malformed(
            word.line,
            format!("the normal of vertex {vertex} has {seen} for a number"),
        )
    })?;
    Ok(unit_or_zero(normal))
}

fn read_face(
    lexer: &mut TextLexer<'_>,
    face: u64,
    vertex_count: u64,
    faces: &mut Polygons,
    watch: &ReadWatch<'_>,
) -> Result<(), Error> {
    let (corners, line) = read_count(lexer, &format!("corners of face {face}"))?;
    let left = lexer.bytes_left() as u64;
    if corners * 2 > left + 1 {
        return Err(malformed(
            line,
            format!("face {face} declares {corners} corners, {left} bytes are left"),
        ));
    }
    watch.check_triangles(faces.triangle_count() + corners.saturating_sub(2))?;
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
pub(super) fn patch(bytes: &[u8], notes: &OffNotes, rest: &Geometry, positions: &[DVec3]) -> Vec<u8> {
    let all = 0..positions.len();
    let gradients =
        (notes.has_normals).then(|| shading::gradients_of_all(&rest.positions, positions, &rest.triangles, all));
    let mut lexer = TextLexer::starting_at(bytes, notes.vertices_at as usize, 1, STYLE);
    let mut patch = TextPatch::new(bytes);
    for (i, (&old, &new)) in rest.positions.iter().zip(positions).enumerate() {
        if let Some(words) = lexer.three_tokens() {
            patch.replace_changed(words, old, new, NumberPrecision::Double);
        }
        if let Some(gradients) = &gradients
            && let Some(words) = lexer.three_tokens()
            && let Some(gradient) = &gradients[i]
        {
            let (old, new) = (rest.normals[i], shading::carry_normal(gradient, rest.normals[i]));
            patch.replace_changed(words, old.as_dvec3(), new.as_dvec3(), NumberPrecision::Single);
        }
        lexer.end_line();
    }
    patch.finish()
}

/// A fresh text, with normals where every vertex has one, colours where any has some, and polygons as they were.
pub(super) fn build(neutral: &NeutralModel) -> Vec<u8> {
    let geometry = &neutral.geometry;
    let with_normals = geometry.all_have_normals();
    let faces: usize = neutral.primitives().map(|own| own.face_count()).sum();
    let colours = &neutral.colours;
    let keyword = match (colours.is_empty(), with_normals) {
        (true, false) => "OFF",
        (true, true) => "NOFF",
        (false, false) => "COFF",
        (false, true) => "CNOFF",
    };
    let mut out = format!("{keyword}\n{} {faces} 0\n", geometry.positions.len()).into_bytes();
    for (i, &position) in geometry.positions.iter().enumerate() {
        push_triple(&mut out, position, NumberPrecision::Double);
        if with_normals {
            out.push(b' ');
            push_triple(&mut out, geometry.normals[i].as_dvec3(), NumberPrecision::Single);
        }
        for share in colours.get(i).into_iter().flatten() {
            out.extend(format!(" {}", (share.clamp(0.0, 1.0) * 255.0).round()).bytes());
        }
        out.push(b'\n');
    }
    for own in neutral.primitives() {
        own.each_face(|corners| {
            out.extend(corners.len().to_string().bytes());
            for &corner in corners {
                out.extend(format!(" {}", own.vertex_at(corner)).bytes());
            }
            out.push(b'\n');
        });
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::text::tests::assert_refused;
    use crate::{FileSet, Limits, Model};

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
            assert_refused(read_text(text), &format!("line {line}"), phrase, text.as_bytes());
        }
    }

    #[test]
    fn a_fresh_file_reads_back() {
        let geometry = read_text(COLOURED).expect("valid").geometry;
        let text = String::from_utf8(build(&NeutralModel::from_geometry(geometry.clone()))).expect("text");
        assert_eq!(read_text(&text).expect("valid").geometry, geometry);
    }
}
