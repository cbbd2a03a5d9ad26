//! OBJ in: positions, faces and the normals that they name; and on request what else the text holds.
//!
//! How `vn` lines follow a deformation.
//!
//! A `vn` line may serve corners at many vertices, which a deformation turns differently. A *pair* is a `vn` line as used
//! at one vertex; pairs are what shades. A line whose pairs still agree is rewritten; where they part, the line serves
//! the first of them and the others get new lines.

use super::super::polygons::Polygons;
use super::super::text::{TextLexer, TextToken, number, refuse_utf16, shown};
use super::statements::{
    FaceCorner, FaceState, NO_NORMAL, NO_TEXTURE, ObjElement, ObjStatements, STYLE, parse_numbers, resolve,
};
use crate::edited::FaceOutlines;
use crate::files::{ReadWatch, check_main_size};
use crate::format::{FormatDetails, Recognition};
use crate::geometry::unit_or_zero;
use crate::model::FileNotes;
use crate::{Error, Format, Geometry, Limits};
use glam::{DVec3, Vec3};
use pliant_exec::progress::Silent;
use pliant_mesh::shading;
use std::collections::{BTreeMap, BTreeSet};

/// The format, by what it is known.
pub(in super::super) const FORMAT: Format = Format::new(&FormatDetails {
    name: "obj",
    aliases: &[],
    media_types: &["model/obj"],
    recognise,
});

/// What the writers have to remember of a file.
#[derive(Debug)]
pub(super) struct ObjNotes {
    /// Present when a face uses a `vn` line.
    pub normals: Option<NormalLines>,
    /// Faces of more than three corners.
    pub outlines: FaceOutlines,
    /// What other formats do not take.
    pub beyond: BeyondFaces,
}

/// How many statements there are that draw something else than faces.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BeyondFaces {
    pub lines: usize,
    pub points: usize,
    /// Curves and surfaces of any kind.
    pub curves: usize,
    /// Groups and objects by different names, and different smoothing groups; 0 where all is one.
    pub groups: usize,
    pub smoothings: usize,
}

/// How many names are counted at most.
const MOST_NAMES: usize = 4096;

/// Takes note of a name; answers how many different ones there are, or 0 where there is one alone.
fn count_names<'a>(names: &mut BTreeSet<&'a [u8]>, name: &'a [u8]) -> usize {
    if names.len() < MOST_NAMES {
        names.insert(name.trim_ascii());
    }
    if names.len() > 1 { names.len() } else { 0 }
}

impl FileNotes for ObjNotes {
    fn bytes_held(&self) -> u64 {
        self.normals.as_ref().map_or(0, NormalLines::bytes_held) + self.outlines.bytes_held()
    }
}

/// OBJ has no signature; its first keyword identifies it.
fn recognise(bytes: &[u8]) -> Recognition {
    const KEYWORDS: [&[u8]; 9] = [b"v", b"vn", b"vt", b"f", b"o", b"g", b"s", b"mtllib", b"usemtl"];
    let first_word = bytes
        .split(|&b| b == b'\n' || b == b'\r')
        .map(|line| line.trim_ascii())
        .find(|line| !line.is_empty() && !line.starts_with(b"#"))
        .and_then(|line| line.split(|b| b.is_ascii_whitespace()).next());
    Recognition::words(first_word.is_some_and(|word| KEYWORDS.contains(&word)))
}

/// Reads an OBJ file.
pub(super) fn read(bytes: &[u8], watch: &ReadWatch<'_>) -> Result<(Geometry, ObjNotes), Error> {
    check_main_size(bytes)?;
    refuse_utf16(bytes, FORMAT)?;
    let mut reader = ObjReader::new(bytes, watch.clone());
    reader.read_statements()?;
    reader.finish()
}

fn malformed(line: u32, problem: impl Into<String>) -> Error {
    Error::malformed(FORMAT, format!("line {line}"), problem)
}

/// Reads the statements that the mesh needs.
pub(super) struct ObjReader<'a> {
    bytes: &'a [u8],
    lexer: TextLexer<'a>,
    watch: ReadWatch<'a>,
    positions: Vec<DVec3>,
    /// Unit normals of the `vn` lines, zero where a line gives none.
    pub normals: Vec<Vec3>,
    texture_count: u32,
    pub faces: Polygons,
    /// The normal of each corner in `faces`.
    pub corner_normals: Vec<u32>,
    /// What else the text says, where that is asked for.
    kept: Option<KeptStatements<'a>>,
    /// The largest indices that faces name, with their lines: vertex, texture coordinate, normal.
    largest: [(u32, u32); 3],
    small_faces: Occurrences,
    bad_normals: Occurrences,
    bad_coordinates: Occurrences,
    /// The largest vertex that lines and points name, with its line; words that name none.
    largest_drawn: (u32, u32),
    bad_drawn: Occurrences,
    beyond: BeyondFaces,
    /// The statements of groups and objects, and of smoothing groups.
    names: [BTreeSet<&'a [u8]>; 2],
}

/// How often something was seen, and on which line first.
#[derive(Debug, Clone, Copy, Default)]
struct Occurrences {
    count: u32,
    line: u32,
}

impl Occurrences {
    fn count_on_line(&mut self, line: u32) {
        if self.count == 0 {
            self.line = line;
        }
        self.count += 1;
    }
}

impl<'a> ObjReader<'a> {
    pub fn new(bytes: &'a [u8], watch: ReadWatch<'a>) -> Self {
        Self {
            bytes,
            lexer: TextLexer::new(bytes, STYLE),
            watch,
            positions: Vec::new(),
            normals: Vec::new(),
            texture_count: 0,
            faces: Polygons::default(),
            corner_normals: Vec::new(),
            kept: None,
            largest: [(0, 0); 3],
            small_faces: Occurrences::default(),
            bad_normals: Occurrences::default(),
            bad_coordinates: Occurrences::default(),
            largest_drawn: (0, 0),
            bad_drawn: Occurrences::default(),
            beyond: BeyondFaces::default(),
            names: Default::default(),
        }
    }

    /// Reads all statements.
    pub fn read_statements(&mut self) -> Result<(), Error> {
        let mut statements = 0;
        while let Some(keyword) = self.lexer.token() {
            self.watch.check_at(statements)?;
            if let Some(kept) = self.kept.as_mut().filter(|_| statements == 0) {
                kept.out.head = &self.bytes[..keyword.start];
            }
            statements += 1;
            match self.lexer.text(keyword) {
                b"v" => {
                    let words = self.read_triple(keyword)?;
                    let position = self.lexer.position(words);
                    let position = position.map_err(|(line, problem)| malformed(line, problem))?;
                    self.positions.push(position);
                    self.watch.check_vertices(self.positions.len() as u64)?;
                    if let Some(kept) = &mut self.kept {
                        let more = parse_numbers(&self.bytes[self.lexer.rest_of_line()]);
                        kept.keep_numbers(more, self.positions.len() == 1);
                    }
                }
                b"vn" => self.read_normal(keyword)?,
                b"vt" => {
                    self.texture_count += 1;
                    let words = &self.bytes[self.lexer.rest_of_line()];
                    if has_no_number(words) {
                        self.bad_coordinates.count_on_line(keyword.line);
                    }
                    if let Some(kept) = &mut self.kept {
                        kept.out.textures.push(words);
                    }
                }
                b"f" => self.read_face(keyword)?,
                word @ (b"o" | b"g" | b"s" | b"usemtl" | b"mtllib") => {
                    let statement = &self.bytes[keyword.start..self.lexer.rest_of_line().end];
                    match word {
                        b"o" | b"g" => self.beyond.groups = count_names(&mut self.names[0], statement),
                        b"s" => self.beyond.smoothings = count_names(&mut self.names[1], statement),
                        _ => {}
                    }
                    if let Some(kept) = &mut self.kept {
                        kept.keep_line(word, statement);
                    }
                }
                b"l" => {
                    self.beyond.lines += 1;
                    self.read_element(keyword);
                }
                b"p" => {
                    self.beyond.points += 1;
                    self.read_element(keyword);
                }
                b"curv" | b"surf" => self.beyond.curves += 1,
                _ => {}
            }
            self.lexer.end_line();
        }
        Ok(())
    }

    /// Looks at a line or points, and keeps them where that is asked for, with the vertices that there are.
    fn read_element(&mut self, keyword: TextToken) {
        let count = self.positions.len() as u32;
        let mut vertices = Vec::new();
        while let Some(word) = self.lexer.token_on_line() {
            let vertex = FaceCorner::parse(&self.lexer, word).and_then(|corner| resolve(corner.vertex, count));
            match vertex {
                Some(vertex) if self.kept.is_some() => vertices.push(vertex),
                Some(vertex) if vertex < self.largest_drawn.0 => {}
                Some(vertex) => self.largest_drawn = (vertex, keyword.line),
                None => self.bad_drawn.count_on_line(keyword.line),
            }
        }
        let word = self.lexer.text(keyword)[0];
        if let Some(kept) = &mut self.kept {
            kept.out.elements.push(ObjElement {
                state: kept.state,
                keyword: word,
                vertices,
            });
        }
    }

    fn read_triple(&mut self, keyword: TextToken) -> Result<[TextToken; 3], Error> {
        self.lexer.three_on_line().map_err(|count| {
            let word = String::from_utf8_lossy(self.lexer.text(keyword)).into_owned();
            malformed(keyword.line, format!("`{word}` with {count} numbers; three are needed"))
        })
    }

    /// Exports of degenerate faces often have non-finite normals; these stay in the file and are not used.
    fn read_normal(&mut self, keyword: TextToken) -> Result<(), Error> {
        let words = self.read_triple(keyword)?;
        let normal = self.lexer.numbers(words).map_err(|word| {
            let seen = shown(self.lexer.text(word));
            malformed(word.line, format!("{seen} is not a number; a normal needs three"))
        })?;
        if !normal.is_finite() {
            self.bad_normals.count_on_line(keyword.line);
        }
        let unit = unit_or_zero(normal);
        self.normals.push(unit);
        if let Some(kept) = &mut self.kept {
            let text = &self.bytes[words[0].start..self.lexer.rest_of_line().end];
            kept.out.normals.push((text, unit));
        }
        Ok(())
    }

    /// How many vertices, texture coordinates and normals there are so far.
    fn line_counts(&self) -> [u32; 3] {
        [
            self.positions.len() as u32,
            self.texture_count,
            self.normals.len() as u32,
        ]
    }

    fn read_face(&mut self, keyword: TextToken) -> Result<(), Error> {
        let first = self.faces.corners.len();
        while let Some(word) = self.lexer.token_on_line() {
            let Some(corner) = FaceCorner::parse(&self.lexer, word) else {
                let seen = shown(self.lexer.text(word));
                return Err(malformed(
                    word.line,
                    format!("{seen} is not a corner; allowed are v, v/vt, v//vn and v/vt/vn"),
                ));
            };
            let counts = self.line_counts();
            let indices = [Some(corner.vertex), corner.texture, corner.normal];
            let mut places = [None; 3];
            for i in 0..3 {
                let Some(index) = indices[i] else { continue };
                let Some(place) = resolve(index, counts[i]) else {
                    let what = KINDS[i];
                    let count = counts[i];
                    let problem =
                        format!("{what} index {index}; allowed are 1 to their number, or -1 to -{count} here");
                    return Err(malformed(word.line, problem));
                };
                if place >= self.largest[i].0 {
                    self.largest[i] = (place, word.line);
                }
                places[i] = Some(place);
            }
            let [Some(vertex), texture, normal] = places else {
                continue;
            };
            self.faces.corners.push(vertex);
            self.corner_normals.push(normal.unwrap_or(NO_NORMAL));
            if let Some(kept) = &mut self.kept {
                kept.corner_textures.push(texture.unwrap_or(NO_TEXTURE));
            }
        }
        let count = self.faces.corners.len() - first;
        if count < 3 {
            self.small_faces.count_on_line(keyword.line);
        }
        self.faces.end_face();
        self.corner_normals.truncate(self.faces.corners.len());
        if let Some(kept) = &mut self.kept {
            kept.corner_textures.truncate(self.faces.corners.len());
            if count >= 3 {
                kept.face_states.push((kept.state, count - 2));
            }
        }
        self.watch.check_triangles(self.faces.triangle_count())
    }

    fn finish(self) -> Result<(Geometry, ObjNotes), Error> {
        let counts = self.line_counts();
        for (i, (place, line)) in self.largest.into_iter().enumerate() {
            if line > 0 && place >= counts[i] {
                let (what, count) = (KINDS[i], counts[i]);
                let seen = u64::from(place) + 1;
                return Err(malformed(line, format!("{what} index {seen}; the file has {count}")));
            }
        }
        let (slots, crude) = self.faces.triangulate(&self.positions, || self.watch.check())?;
        let outlines = self.faces.find_outlines(&slots);
        let triangles: Vec<_> = slots
            .iter()
            .map(|t| t.map(|s| self.faces.corners[s as usize]))
            .collect();
        let has_normals = self.corner_normals.iter().any(|&line| line != NO_NORMAL);
        let normals =
            has_normals.then(|| NormalLines::new(self.normals, &self.faces.corners, &self.corner_normals, &slots));
        let per_vertex = normals
            .as_ref()
            .and_then(|n| n.per_vertex(self.positions.len()))
            .unwrap_or_default();
        let mut bad_drawn = self.bad_drawn;
        if self.largest_drawn.0 as usize >= self.positions.len() && self.largest_drawn.1 > 0 {
            bad_drawn.count_on_line(self.largest_drawn.1);
        }
        let mut geometry = Geometry::from_one_mesh(self.positions, per_vertex, triangles);
        let mut warn = |code: &str, seen: Occurrences, what: &str| {
            if seen.count > 0 {
                geometry.warn(code, format!("{} {what}", seen.count), format!("line {}", seen.line));
            }
        };
        warn(
            "face-too-small",
            self.small_faces,
            "faces with less than three corners are kept but not deformed",
        );
        warn(
            "normal-not-finite",
            self.bad_normals,
            "normals that are not finite are kept as they are",
        );
        warn(
            "bad-texture-coordinate",
            self.bad_coordinates,
            "texture coordinates are not finite; where they are rewritten they become 0",
        );
        warn(
            "bad-line-index",
            bad_drawn,
            "indices of lines or points name no vertex; an edit leaves them out",
        );
        geometry.warn_about_crude_polygons(crude);
        let notes = ObjNotes {
            normals,
            outlines,
            beyond: self.beyond,
        };
        Ok((geometry, notes))
    }
}

/// Reads what a text that was read before holds beyond positions and triangles.
pub(super) fn read_statements(bytes: &[u8]) -> ObjStatements<'_> {
    let mut reader = ObjReader::new(bytes, ReadWatch::new(&Limits::UNLIMITED, &Silent, 0));
    reader.kept = Some(KeptStatements::default());
    match reader.read_statements() {
        Ok(()) => reader.finish_statements(),
        // The text was read before, and so has no mistakes.
        Err(_) => ObjStatements::default(),
    }
}

/// What is kept of a text beyond positions and triangles while it is read.
#[derive(Default)]
struct KeptStatements<'a> {
    out: ObjStatements<'a>,
    /// Not every vertex has as many numbers.
    uneven: bool,
    state: FaceState<'a>,
    /// The texture coordinates of each corner of the faces.
    corner_textures: Vec<u32>,
    /// For each face what holds for it, and how many triangles it gives.
    face_states: Vec<(FaceState<'a>, usize)>,
}

impl<'a> KeptStatements<'a> {
    /// Keeps the numbers after the coordinates of a vertex.
    fn keep_numbers(&mut self, more: Vec<f64>, is_first: bool) {
        if is_first {
            self.out.more_lanes = more.len();
        }
        self.uneven |= more.len() != self.out.more_lanes || more.iter().any(|v| !v.is_finite());
        if !self.uneven {
            self.out.more.extend(more);
        }
    }

    /// Keeps a line that holds for the faces below it, or names libraries.
    fn keep_line(&mut self, keyword: &[u8], line: &'a [u8]) {
        match keyword {
            b"o" => self.state.object = Some(line),
            b"g" => self.state.group = Some(line),
            b"s" => self.state.smoothing = Some(line),
            b"usemtl" => self.state.material = Some(line),
            _ => self.out.libraries.push(line),
        }
    }
}

impl<'a> ObjReader<'a> {
    fn finish_statements(self) -> ObjStatements<'a> {
        let kept = self.kept.unwrap_or_default();
        let mut out = kept.out;
        if kept.uneven {
            (out.more, out.more_lanes) = (Vec::new(), 0);
        }
        let is_known = |&corner: &u32| (corner as usize) < self.positions.len();
        if !self.faces.corners.iter().all(is_known) {
            return out;
        }
        let Ok((slots, _)) = self.faces.triangulate(&self.positions, || Ok(())) else {
            return out;
        };
        let (textures, normals) = (out.textures.len() as u32, out.normals.len() as u32);
        for slot in slots.into_iter().flatten() {
            let (texture, normal) = (kept.corner_textures[slot as usize], self.corner_normals[slot as usize]);
            out.corner_textures
                .push(if texture < textures { texture } else { NO_TEXTURE });
            out.corner_normals
                .push(if normal < normals { normal } else { NO_NORMAL });
        }
        for (state, count) in kept.face_states {
            out.states.extend(std::iter::repeat_n(state, count));
        }
        out
    }
}

/// Whether one of the numbers of a text is infinite or none at all.
pub(super) fn has_no_number(text: &[u8]) -> bool {
    let mut words = text.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
    // Only words with such a letter can be meant; the others are read where they are needed.
    words.any(|word| word.iter().any(|b| b"nNiI".contains(b)) && number(word).is_some_and(|v| !v.is_finite()))
}

const KINDS: [&str; 3] = ["vertex", "texture coordinate", "normal"];

/// The normals of a file and who uses them.
#[derive(Debug, Clone)]
pub(super) struct NormalLines {
    /// Unit normal of each `vn` line, zero where the line gives none.
    values: Vec<Vec3>,
    /// Each used (normal, vertex), ascending.
    pairs: Vec<[u32; 2]>,
    /// The pair of each triangle corner; `pairs.len()` for corners without a normal.
    corners: Vec<[u32; 3]>,
}

/// What becomes of the `vn` lines.
pub(super) struct NormalPlan {
    /// The new value of each line that is rewritten.
    pub rewritten: Vec<Option<Vec3>>,
    /// Lines to add.
    pub added: Vec<Vec3>,
    /// For each pair the line it uses now; lines to add count on from the existing ones.
    line_of_pair: Vec<u32>,
}

impl NormalLines {
    /// `corner_vertices` and `corner_normals` are the faces' corners, `slots` the triangles as places in them.
    pub fn new(values: Vec<Vec3>, corner_vertices: &[u32], corner_normals: &[u32], slots: &[[u32; 3]]) -> Self {
        let pair_at = |slot: usize| [corner_normals[slot], corner_vertices[slot]];
        let mut pairs: Vec<_> = (0..corner_vertices.len())
            .map(pair_at)
            .filter(|p| p[0] != NO_NORMAL)
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        let corner = |slot: u32| pairs.binary_search(&pair_at(slot as usize)).unwrap_or(pairs.len()) as u32;
        let corners = slots.iter().map(|t| t.map(corner)).collect();
        Self { values, pairs, corners }
    }

    /// The normals by vertex, where every corner of every used vertex names the same; zero for unused vertices.
    pub fn per_vertex(&self, vertex_count: usize) -> Option<Vec<Vec3>> {
        let mut line = vec![NO_NORMAL; vertex_count];
        for &[normal, vertex] in &self.pairs {
            if std::mem::replace(&mut line[vertex as usize], normal) != NO_NORMAL {
                return None;
            }
        }
        let none = self.pairs.len() as u32;
        let complete = !self.corners.iter().flatten().any(|&c| c == none);
        complete.then(|| {
            line.iter()
                .map(|&n| self.values.get(n as usize).copied().unwrap_or(Vec3::ZERO))
                .collect()
        })
    }

    /// Decides which lines change when the vertices move.
    pub fn plan_changes(&self, rest: &[DVec3], deformed: &[DVec3], triangles: &[[u32; 3]]) -> NormalPlan {
        let gradients = shading::gradients(rest, deformed, triangles, &self.corners, self.pairs.len() + 1);
        let mut plan = NormalPlan {
            rewritten: vec![None; self.values.len()],
            added: Vec::new(),
            line_of_pair: self.pairs.iter().map(|p| p[0]).collect(),
        };
        let mut first = 0;
        for run in self.pairs.chunk_by(|a, b| a[0] == b[0]) {
            let line = run[0][0] as usize;
            let authored = self.values[line];
            let carried: Vec<Vec3> = (first..first + run.len())
                .map(|pair| {
                    gradients[pair]
                        .as_ref()
                        .map_or(authored, |g| shading::carry_normal(g, authored))
                })
                .collect();
            self.share_lines(&mut plan, line, first, &carried);
            first += run.len();
        }
        plan
    }

    /// Gives one line's pairs, of which the first is number `first`, lines that hold their new values.
    fn share_lines(&self, plan: &mut NormalPlan, line: usize, first: usize, carried: &[Vec3]) {
        let authored = self.values[line];
        // The line stays as authored if anyone still uses it so.
        let kept = if carried.iter().any(|&n| is_same(n, authored)) {
            authored
        } else {
            carried[0]
        };
        if kept != authored {
            plan.rewritten[line] = Some(kept);
        }
        let mut others = BTreeMap::new();
        for (i, &normal) in carried.iter().enumerate() {
            if !is_same(normal, kept) {
                let bits = normal.to_array().map(f32::to_bits);
                plan.line_of_pair[first + i] = *others.entry(bits).or_insert_with(|| {
                    plan.added.push(normal);
                    (self.values.len() + plan.added.len() - 1) as u32
                });
            }
        }
    }

    pub fn bytes_held(&self) -> u64 {
        let lists = size_of_val(self.values.as_slice())
            + size_of_val(self.pairs.as_slice())
            + size_of_val(self.corners.as_slice());
        lists as u64
    }

    /// The line that a corner uses now.
    pub fn line_of(&self, plan: &NormalPlan, normal: u32, vertex: u32) -> u32 {
        self.pairs
            .binary_search(&[normal, vertex])
            .map_or(normal, |pair| plan.line_of_pair[pair])
    }
}

/// Whether two normals differ by rounding only. Without this a rigid motion would tear shared lines apart.
fn is_same(a: Vec3, b: Vec3) -> bool {
    (a - b).abs().max_element() <= 1e-6
}
