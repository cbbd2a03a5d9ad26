//! Stereolithography (STL), binary and text.
//!
//! Facets share no vertices: there are three render vertices for each facet, in file order. The solver welds them. The
//! facet normal is redundant; it is recomputed for facets that moved. An edited text file stays text with its solids;
//! an edited binary file keeps its header and facet attributes.

#[cfg(test)]
mod tests;

use super::text::{
    NumberPrecision, TextLexer, TextPatch, TextStyle, TextToken, newline_of, push_triple, shown, without_mark,
};
use crate::codec::{EditedOutput, FormatCodec, PatchedOutput, ReadFile};
use crate::edited::{BaseModel, EditedModel, TriangleOrigins};
use crate::files::{ReadWatch, check_main_size, counted};
use crate::format::{FormatDetails, Recognition};
use crate::model::{FileNotes, is_same};
use crate::neutral::{HeldLooks, NeutralModel};
use crate::vertex_attributes::AttributeKeys;
use crate::{Error, FileSet, Format, Geometry, Model, Primitive, WrittenFiles, WrittenWarning};
use glam::DVec3;
use pliant_mesh::{BoundingBox, NONE};
use std::ops::Range;
use std::sync::Arc;

/// The format, by what it is known.
pub(super) const FORMAT: Format = Format::new(&FormatDetails {
    name: "stl",
    aliases: &[],
    media_types: &[
        "model/stl",
        "model/x.stl-binary",
        "model/x.stl-ascii",
        "application/sla",
    ],
    recognise,
});

/// Reads and writes STL.
pub(super) struct StlCodec;

impl FormatCodec for StlCodec {
    fn patches_files_of(&self, format: Format) -> bool {
        format == FORMAT
    }

    fn read(&self, files: &FileSet, _: Format, watch: &ReadWatch<'_>) -> Result<ReadFile, Error> {
        read(&files.main, watch).map(|(geometry, notes)| (geometry, Arc::new(notes) as _))
    }

    fn patch_positions(&self, output: &PatchedOutput<'_>) -> Result<WrittenFiles, Error> {
        let rounded = is_binary(output.model).then(|| WrittenWarning::rounded(output.positions, FORMAT));
        Ok(WrittenFiles {
            warnings: rounded.flatten().into_iter().collect(),
            ..WrittenFiles::single(patch(output.model, output.positions)?)
        })
    }

    fn single_origin(&self, _: &BoundingBox) -> Option<DVec3> {
        Some(DVec3::ZERO)
    }

    fn held_looks(&self) -> HeldLooks {
        HeldLooks::NONE
    }

    fn build(&self, neutral: &NeutralModel, _: Format) -> Result<WrittenFiles, Error> {
        let geometry = &neutral.geometry;
        let (triangles, positions) = (&geometry.triangles, &geometry.positions);
        let parts = geometry.primitives.iter().map(|own| (own, own.vertices()));
        let bare = bare_points(parts, triangles, positions.len()).into_iter();
        Ok(WrittenFiles {
            warnings: bare.chain(WrittenWarning::rounded(positions, FORMAT)).collect(),
            ..WrittenFiles::single(facets_file(triangles, positions)?)
        })
    }

    fn edits(&self, _: Format) -> bool {
        true
    }

    fn write_edited(&self, output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
        let EditedOutput { edited, positions, .. } = *output;
        let first = edited.bases.first().map(|base| base.model);
        let text = first.filter(|model| is_text(model));
        let rounded = WrittenWarning::rounded(positions, FORMAT).filter(|_| text.is_none());
        let written = match text {
            Some(first) => write_edited_text(edited, positions, newline_of(&first.files.main)),
            None => write_edited_binary(edited, positions),
        };
        let parts = edited.runs.iter().map(|run| (edited.primitive(run), run.vertices()));
        let mut written = WrittenFiles::single(written?);
        written
            .warnings
            .extend(bare_points(parts, edited.triangles, positions.len()));
        written.warnings.extend(rounded);
        Ok(written)
    }

    /// Which solid a facet is of, or its attribute.
    fn distinguish_vertices(&self, model: &Model, keys: &mut AttributeKeys<'_>) -> Result<(), Error> {
        let of_facet = if is_text(model) {
            read_solids(model)?.of_facet.into_iter().map(u64::from).collect()
        } else {
            facets_of(model)
                .map(|facet| u64::from(facet[48]) | u64::from(facet[49]) << 8)
                .collect::<Vec<_>>()
        };
        for (facet, value) in of_facet.into_iter().enumerate() {
            (3 * facet..3 * facet + 3).for_each(|v| keys.add(v, value));
        }
        Ok(())
    }
}

/// Says how many vertices are in no facet. Those of primitives of points or lines are named by these.
fn bare_points<'p>(
    parts: impl Iterator<Item = (&'p Primitive, Range<usize>)>,
    triangles: &[[u32; 3]],
    count: usize,
) -> Option<WrittenWarning> {
    let mut bare = vec![false; count];
    for (primitive, vertices) in parts {
        bare[vertices].fill(!(primitive.is_passenger && primitive.index_count == 0));
    }
    triangles.as_flattened().iter().for_each(|v| bare[*v as usize] = false);
    let bare = counted(
        bare.iter().filter(|b| **b).count(),
        "point in no triangle",
        "points in no triangle",
    );
    WrittenWarning::left_out(bare.as_slice(), FORMAT, "")
}

/// What the writers have to remember of a file.
#[derive(Debug)]
struct StlNotes {
    binary: bool,
}

impl FileNotes for StlNotes {}

fn recognise(bytes: &[u8]) -> Recognition {
    // A binary file says nothing but its triangle count, which must fit the length exactly.
    Recognition::mark(is_as_long_as_binary(bytes)).max(Recognition::words(begins_a_solid(bytes)))
}

fn begins_a_solid(bytes: &[u8]) -> bool {
    let mut rest = without_mark(bytes).trim_ascii_start();
    while begins_a_comment(rest) {
        let line = rest.split(|b| matches!(b, b'\n' | b'\r')).next().unwrap_or_default();
        rest = rest[line.len()..].trim_ascii_start();
    }
    let word = rest.get(..5);
    word.is_some_and(|word| word.eq_ignore_ascii_case(b"solid"))
}

/// Some programs write comments above a solid.
fn begins_a_comment(line: &[u8]) -> bool {
    [&b"#"[..], b"//", b";"].iter().any(|mark| line.starts_with(mark))
}

/// How long a binary file of so many facets is.
fn binary_length(facets: u64) -> u64 {
    HEADER as u64 + facets * FACET as u64
}

/// Bytes before the first facet of a binary file, and of each facet.
const HEADER: usize = 84;
const FACET: usize = 50;

const STYLE: TextStyle = TextStyle {
    comments: false,
    continuation: false,
};

/// Reads an STL file.
fn read(bytes: &[u8], watch: &ReadWatch<'_>) -> Result<(Geometry, StlNotes), Error> {
    check_main_size(bytes)?;
    let declared = declared_facets(bytes);
    // Some programs begin binary files with the word `solid` too; the length identifies them.
    let binary = is_as_long_as_binary(bytes) || !begins_a_solid(bytes);
    let mut positions = Vec::new();
    let (mut extra, mut colours) = (0, 0);
    if binary {
        let count = declared.ok_or_else(|| {
            Error::malformed(
                FORMAT,
                "byte 0",
                format!("{} bytes; a binary file has at least {HEADER}", bytes.len()),
            )
        })?;
        let room = (bytes.len() - HEADER) / FACET;
        if count > room as u64 {
            let problem = format!("{count} facets are declared, the file holds {room}");
            return Err(Error::malformed(FORMAT, "byte 80", problem));
        }
        extra = bytes.len() - HEADER - count as usize * FACET;
        watch.check_vertices(count * 3)?;
        watch.check_triangles(count)?;
        positions.reserve_exact(count as usize * 3);
        for (i, facet) in bytes[HEADER..].chunks_exact(FACET).take(count as usize).enumerate() {
            watch.check_at(i)?;
            for corner in 0..3 {
                let position = read_vector(facet, corner + 1);
                if !position.is_finite() {
                    let problem = format!("corner {corner} is {position}; finite coordinates are needed");
                    return Err(Error::malformed(FORMAT, format!("facet {i}"), problem));
                }
                positions.push(position);
            }
        }
    } else {
        let mut facets = FacetReader::new(bytes);
        while let Some((_, corners)) = facets.next()? {
            for words in corners {
                positions.push(facets.read_position(words)?);
            }
            watch.check_vertices(positions.len() as u64)?;
            watch.check_at(positions.len() / 3)?;
        }
        colours = facets.colours;
    }
    let triangles = (0..positions.len() as u32 / 3)
        .map(|i| [3 * i, 3 * i + 1, 3 * i + 2])
        .collect();
    let mut geometry = Geometry::from_one_mesh(positions, Vec::new(), triangles);
    if extra > 0 {
        let place = format!("byte {}", bytes.len() - extra);
        geometry.warn(
            "trailing-bytes",
            format!("{extra} bytes after the last facet are kept as they are"),
            place,
        );
    }
    if colours > 0 {
        let message = format!("{colours} lines `color` are not read; they stay in the text until an edit rewrites it");
        geometry.warn("colours-skipped", message, "");
    }
    Ok((geometry, StlNotes { binary }))
}

fn declared_facets(bytes: &[u8]) -> Option<u64> {
    let count: [u8; 4] = bytes.get(HEADER - 4..HEADER)?.try_into().ok()?;
    Some(u64::from(u32::from_le_bytes(count)))
}

/// Vector 0 of a binary facet is the normal, 1 to 3 are the corners.
fn read_vector(facet: &[u8], index: usize) -> DVec3 {
    let number = |i: usize| {
        let at = index * 12 + i * 4;
        f64::from(f32::from_le_bytes([
            facet[at],
            facet[at + 1],
            facet[at + 2],
            facet[at + 3],
        ]))
    };
    DVec3::new(number(0), number(1), number(2))
}

fn push_vector(out: &mut [u8], index: usize, value: DVec3) {
    for (i, number) in value.as_vec3().to_array().into_iter().enumerate() {
        let at = index * 12 + i * 4;
        out[at..at + 4].copy_from_slice(&number.to_le_bytes());
    }
}

/// The facets of a text file.
struct FacetReader<'a> {
    lexer: TextLexer<'a>,
    /// Names of the solids so far, empty where one has none.
    solids: Vec<&'a [u8]>,
    /// How many lines gave a colour.
    colours: usize,
}

/// The words of a facet's normal (absent where the file leaves them out) and of its corners.
type FacetWords = (Option<[TextToken; 3]>, [[TextToken; 3]; 3]);

impl<'a> FacetReader<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self {
            lexer: TextLexer::new(bytes, STYLE),
            solids: Vec::new(),
            colours: 0,
        }
    }

    /// The next word that is neither of a comment nor of a line that gives a colour, as some programs write them between and in
    /// facets.
    fn word(&mut self) -> Option<TextToken> {
        loop {
            let token = self.lexer.token()?;
            let text = self.lexer.text(token);
            let is_colour = text.eq_ignore_ascii_case(b"color");
            if !is_colour && !begins_a_comment(text) {
                return Some(token);
            }
            self.colours += usize::from(is_colour);
            self.lexer.end_line();
        }
    }

    fn next(&mut self) -> Result<Option<FacetWords>, Error> {
        while let Some(token) = self.word() {
            let word = self.lexer.text(token);
            if word.eq_ignore_ascii_case(b"solid") {
                let name = self.lexer.rest_of_line();
                self.solids.push(self.lexer.bytes_at(name));
            } else if word.eq_ignore_ascii_case(b"endsolid") {
                self.lexer.end_line();
            } else if word.eq_ignore_ascii_case(b"facet") {
                let normal = self.read_normal();
                self.expect_word(b"outer")?;
                self.expect_word(b"loop")?;
                let corners = [self.read_vertex()?, self.read_vertex()?, self.read_vertex()?];
                self.expect_end(b"endloop", b"loop")?;
                self.expect_end(b"endfacet", b"facet")?;
                return Ok(Some((normal, corners)));
            } else {
                let problem = format!("{} where `facet` or `endsolid` is needed", shown(word));
                return Err(malformed(token.line, problem));
            }
        }
        Ok(None)
    }

    fn read_normal(&mut self) -> Option<[TextToken; 3]> {
        let keyword = self.lexer.token_on_line()?;
        if !self.lexer.text(keyword).eq_ignore_ascii_case(b"normal") {
            return None;
        }
        self.lexer.three_on_line().ok()
    }

    fn read_vertex(&mut self) -> Result<[TextToken; 3], Error> {
        self.expect_word(b"vertex")?;
        let words = self.lexer.three_tokens();
        words.ok_or_else(|| malformed(self.lexer.line(), "the file ends inside a vertex"))
    }

    /// One word, or `end` and the other.
    fn expect_end(&mut self, one: &[u8], other: &[u8]) -> Result<(), Error> {
        let mut ahead = self.lexer.clone();
        match ahead.token().map(|token| ahead.text(token)) {
            Some(word) if word.eq_ignore_ascii_case(b"end") => {
                self.lexer = ahead;
                self.expect_word(other)
            }
            _ => self.expect_word(one),
        }
    }

    fn expect_word(&mut self, keyword: &[u8]) -> Result<(), Error> {
        let needed = String::from_utf8_lossy(keyword);
        let Some(token) = self.word() else {
            return Err(malformed(
                self.lexer.line(),
                format!("the file ends where `{needed}` is needed"),
            ));
        };
        let word = self.lexer.text(token);
        if word.eq_ignore_ascii_case(keyword) {
            return Ok(());
        }
        Err(malformed(
            token.line,
            format!("{} where `{needed}` is needed", shown(word)),
        ))
    }

    fn read_position(&self, words: [TextToken; 3]) -> Result<DVec3, Error> {
        let position = self.lexer.position(words);
        position.map_err(|(line, problem)| malformed(line, problem))
    }
}

fn malformed(line: u32, problem: impl Into<String>) -> Error {
    Error::malformed(FORMAT, format!("line {line}"), problem)
}

/// Whether a model came as a binary STL.
fn is_binary(model: &Model) -> bool {
    model.notes::<StlNotes>().is_some_and(|notes| notes.binary)
}

/// Whether a model came as a text STL.
fn is_text(model: &Model) -> bool {
    model.notes::<StlNotes>().is_some_and(|notes| !notes.binary)
}

/// The bytes of the facets of a binary file.
fn facets_of(model: &Model) -> impl Iterator<Item = &[u8; FACET]> {
    let facets = model.files.main.get(HEADER..).unwrap_or_default();
    facets.as_chunks().0.iter().take(model.geometry.triangles.len())
}

/// The solids of a text.
#[derive(Default)]
struct Solids<'a> {
    names: Vec<&'a [u8]>,
    /// For each facet its solid.
    of_facet: Vec<u32>,
}

fn read_solids(model: &Model) -> Result<Solids<'_>, Error> {
    let mut reader = FacetReader::new(&model.files.main);
    let mut of_facet = Vec::with_capacity(model.geometry.triangles.len());
    while reader.next()?.is_some() {
        of_facet.push((reader.solids.len() as u32).saturating_sub(1));
    }
    Ok(Solids {
        names: reader.solids,
        of_facet,
    })
}

/// The uploaded file with the vertices at `positions`.
fn patch(model: &Model, positions: &[DVec3]) -> Result<Vec<u8>, Error> {
    let bytes = &model.files.main[..];
    let facets = model.positions.chunks_exact(3).zip(positions.chunks_exact(3));
    if is_binary(model) {
        check_single(positions)?;
        let mut out = bytes.to_vec();
        for ((old, new), facet) in facets.zip(out[HEADER..].chunks_exact_mut(FACET)) {
            if !is_same(old, new) {
                push_facet(facet, new);
            }
        }
        return Ok(out);
    }
    let mut reader = FacetReader::new(bytes);
    let mut patch = TextPatch::new(bytes);
    for (old, new) in facets {
        let Some((normal, corners)) = reader.next()? else { break };
        if is_same(old, new) {
            continue;
        }
        if let Some(words) = normal {
            let all_new = DVec3::splat(f64::NAN);
            patch.replace_changed(words, all_new, facet_normal(new), NumberPrecision::Single);
        }
        for (i, words) in corners.into_iter().enumerate() {
            patch.replace_changed(words, old[i], new[i], NumberPrecision::Double);
        }
    }
    let mut out = patch.finish();
    if is_as_long_as_binary(&out) {
        out.push(b'\n');
    }
    Ok(out)
}

/// Whether the length is that of a binary file with the count that stands there, which a text may come to by chance; it would
/// then be read as one.
fn is_as_long_as_binary(bytes: &[u8]) -> bool {
    declared_facets(bytes).is_some_and(|count| binary_length(count) == bytes.len() as u64)
}

/// A text of an edited model with the solids of all bases, in order; what comes from other formats is one solid. New facets
/// are of the solid that they lie on.
fn write_edited_text(edited: &EditedModel<'_>, positions: &[DVec3], newline: &[u8]) -> Result<Vec<u8>, Error> {
    let mut out = Vec::new();
    for base in 0..edited.bases.len() as u32 {
        let model = edited.bases[base as usize].model;
        let mut solids = Solids::default();
        if is_text(model) {
            solids = read_solids(model)?;
        }
        if solids.names.is_empty() {
            if edited.runs_with_triangles(base).next().is_none() {
                continue;
            }
            solids.names.push(b"");
        }
        let mut facets: Vec<Vec<[u32; 3]>> = vec![Vec::new(); solids.names.len()];
        for run in edited.runs_with_triangles(base) {
            let triangles = &edited.triangles[run.triangles()];
            if let [all] = facets.as_mut_slice() {
                all.extend(triangles);
                continue;
            }
            let origins = TriangleOrigins::new(edited, run, &model.geometry.triangles);
            for (t, &origin) in triangles.iter().zip(origins.old_triangles()) {
                let solid = solids.of_facet.get(origin as usize).copied().unwrap_or(0);
                facets[solid as usize].push(*t);
            }
        }
        for (name, facets) in solids.names.iter().zip(&facets) {
            push_solid(&mut out, name, newline, facets, positions);
        }
    }
    if is_as_long_as_binary(&out) {
        out.extend_from_slice(newline);
    }
    Ok(out)
}

fn push_solid(out: &mut Vec<u8>, name: &[u8], newline: &[u8], facets: &[[u32; 3]], positions: &[DVec3]) {
    let line = |out: &mut Vec<u8>, words: &[u8], numbers: Option<(DVec3, NumberPrecision)>| {
        out.extend_from_slice(words);
        if let Some((numbers, precision)) = numbers {
            push_triple(out, numbers, precision);
        }
        out.extend_from_slice(newline);
    };
    line(out, [b"solid ", name].concat().trim_ascii_end(), None);
    for facet in facets {
        let corners = facet.map(|v| positions[v as usize]);
        let normal = (facet_normal(&corners), NumberPrecision::Single);
        line(out, b"  facet normal ", Some(normal));
        line(out, b"    outer loop", None);
        for corner in corners {
            line(out, b"      vertex ", Some((corner, NumberPrecision::Double)));
        }
        line(out, b"    endloop", None);
        line(out, b"  endfacet", None);
    }
    line(out, [b"endsolid ", name].concat().trim_ascii_end(), None);
}

/// A binary file of an edited model; a binary source keeps its header, and facets the attribute of those they lie on.
fn write_edited_binary(edited: &EditedModel<'_>, positions: &[DVec3]) -> Result<Vec<u8>, Error> {
    let mut out = facets_file(edited.triangles, positions)?;
    let binary = |base: &BaseModel<'_>| is_binary(base.model);
    if let Some(first) = edited.bases.first().filter(|base| binary(base))
        && let Some(header) = first.model.files.main.get(..HEADER)
    {
        // All of it but the count.
        out[..HEADER - 4].copy_from_slice(&header[..HEADER - 4]);
    }
    for run in edited
        .runs
        .iter()
        .filter(|r| r.triangle_count > 0 && binary(edited.base(r)))
    {
        let base = edited.base(run).model;
        let origins = TriangleOrigins::new(edited, run, &base.geometry.triangles);
        for (triangle, &origin) in run.triangles().zip(origins.old_triangles()) {
            let from = HEADER as u64 + u64::from(origin) * FACET as u64 + 48;
            let from = usize::try_from(from).unwrap_or(usize::MAX);
            let attribute = base
                .files
                .main
                .get(from..from.saturating_add(2))
                .filter(|_| origin != NONE);
            if let Some(attribute) = attribute {
                out[HEADER + triangle * FACET + 48..][..2].copy_from_slice(attribute);
            }
        }
    }
    Ok(out)
}

/// A fresh binary file.
fn facets_file(triangles: &[[u32; 3]], positions: &[DVec3]) -> Result<Vec<u8>, Error> {
    check_single(positions)?;
    let count = u32::try_from(triangles.len())
        .map_err(|_| Error::unwritable(FORMAT, format!("{} triangles", triangles.len())))?;
    let mut out = vec![0; HEADER + triangles.len() * FACET];
    out[..6].copy_from_slice(b"pliant");
    out[HEADER - 4..HEADER].copy_from_slice(&count.to_le_bytes());
    for (triangle, facet) in triangles.iter().zip(out[HEADER..].chunks_exact_mut(FACET)) {
        push_facet(facet, &triangle.map(|v| positions[v as usize]));
    }
    Ok(out)
}

fn push_facet(facet: &mut [u8], corners: &[DVec3]) {
    push_vector(facet, 0, facet_normal(corners));
    for (i, &corner) in corners.iter().enumerate() {
        push_vector(facet, i + 1, corner);
    }
}

/// The unit normal by the right-hand rule; zero for a facet without area, as the format asks.
fn facet_normal(corners: &[DVec3]) -> DVec3 {
    let (e1, e2) = (corners[1] - corners[0], corners[2] - corners[0]);
    let size = e1.abs().max(e2.abs()).max_element();
    if !(size > 0.0 && size.is_finite()) {
        return DVec3::ZERO;
    }
    (e1 / size).cross(e2 / size).normalize_or_zero()
}

/// Refuses positions beyond what 32 bits hold.
fn check_single(positions: &[DVec3]) -> Result<(), Error> {
    match positions.iter().position(|p| !p.as_vec3().is_finite()) {
        Some(i) => {
            let problem = format!(
                "the position of vertex {i} is {}, too large for 32-bit numbers",
                positions[i]
            );
            Err(Error::unwritable(FORMAT, problem))
        }
        None => Ok(()),
    }
}
