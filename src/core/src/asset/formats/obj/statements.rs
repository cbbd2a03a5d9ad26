//! What an OBJ text holds beyond positions and triangles, read again when it is needed.
//!
//! Corners of faces, the words of lines, and what separates them.
//!
//! Texture coordinates of an OBJ for formats that divide no vertices: by vertex where all corners agree, else by corner.

use super::super::polygons::Polygons;
use super::super::text::{TextLexer, TextStyle, TextToken, integer, number};
use crate::asset::Model;
use crate::asset::edited::{EditedModel, PrimitiveRun, TriangleOrigins};
use crate::asset::geometry::unit_or_zero;
use crate::asset::vertex_attributes::{AttributeKeys, hash_bytes, hash_numbers, normal_key};
use crate::mesh::mix_bits;
use glam::{DVec3, Vec3};
use std::collections::BTreeMap;

/// Marks a corner without texture coordinates.
pub(super) const NO_TEXTURE: u32 = u32::MAX;

/// What holds for a face, as the statements above it say; each as its whole line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct FaceState<'a> {
    pub object: Option<&'a [u8]>,
    pub group: Option<&'a [u8]>,
    pub smoothing: Option<&'a [u8]>,
    pub material: Option<&'a [u8]>,
}

/// The statements of a text.
pub(super) struct ObjStatements<'a> {
    /// Comments before the first statement.
    pub head: &'a [u8],
    /// `mtllib` lines.
    pub libraries: Vec<&'a [u8]>,
    /// The numbers of each `vt` line, as text.
    pub textures: Vec<&'a [u8]>,
    /// The numbers of each `vn` line, as text, and as unit vectors; zero where a line gives none.
    pub normals: Vec<(&'a [u8], Vec3)>,
    /// Numbers after the coordinates of `v` lines: so many per vertex, for all vertices; empty unless every line has as
    /// many.
    pub more: Vec<f64>,
    pub more_lanes: usize,
    /// For each triangle corner, in the order of the geometry, its texture coordinates and normal.
    pub corner_textures: Vec<u32>,
    pub corner_normals: Vec<u32>,
    /// For each triangle what holds for it.
    pub states: Vec<FaceState<'a>>,
}

/// Reads the statements of a text that was read before, whose vertices rest at `positions`.
pub(super) fn read<'a>(bytes: &'a [u8], positions: &[DVec3]) -> ObjStatements<'a> {
    let mut reader = StatementReader {
        bytes,
        lexer: TextLexer::new(bytes, STYLE),
        out: ObjStatements {
            head: &[],
            libraries: Vec::new(),
            textures: Vec::new(),
            normals: Vec::new(),
            more: Vec::new(),
            more_lanes: 0,
            corner_textures: Vec::new(),
            corner_normals: Vec::new(),
            states: Vec::new(),
        },
        vertices: 0,
        uneven: false,
        state: FaceState::default(),
        faces: Polygons::default(),
        corners: Vec::new(),
        face_states: Vec::new(),
    };
    reader.read_statements();
    reader.finish(positions)
}

struct StatementReader<'a> {
    bytes: &'a [u8],
    lexer: TextLexer<'a>,
    out: ObjStatements<'a>,
    vertices: u32,
    /// Not every vertex has as many numbers.
    uneven: bool,
    state: FaceState<'a>,
    faces: Polygons,
    /// Texture coordinates and normal of each corner in `faces`.
    corners: Vec<[u32; 2]>,
    face_states: Vec<(FaceState<'a>, usize)>,
}

impl<'a> StatementReader<'a> {
    fn read_statements(&mut self) {
        let mut first = true;
        while let Some(keyword) = self.lexer.token() {
            if std::mem::take(&mut first) {
                self.out.head = &self.bytes[..keyword.start];
            }
            match self.lexer.text(keyword) {
                b"v" => self.read_vertex(),
                b"vt" => {
                    let words = self.lexer.rest_of_line();
                    self.out.textures.push(&self.bytes[words]);
                }
                b"vn" => {
                    let words = self.lexer.rest_of_line();
                    let text = &self.bytes[words];
                    let numbers = parse_numbers(text);
                    let at = |i: usize| numbers.get(i).copied().unwrap_or(f64::NAN);
                    self.out
                        .normals
                        .push((text, unit_or_zero(DVec3::new(at(0), at(1), at(2)))));
                }
                b"f" => self.read_face(),
                word @ (b"o" | b"g" | b"s" | b"usemtl" | b"mtllib") => {
                    let line = &self.bytes[keyword.start..self.lexer.rest_of_line().end.max(keyword.end)];
                    match word {
                        b"o" => self.state.object = Some(line),
                        b"g" => self.state.group = Some(line),
                        b"s" => self.state.smoothing = Some(line),
                        b"usemtl" => self.state.material = Some(line),
                        _ => self.out.libraries.push(line),
                    }
                }
                _ => {}
            }
            self.lexer.end_line();
        }
    }

    fn read_vertex(&mut self) {
        let words = self.lexer.rest_of_line();
        let numbers = parse_numbers(&self.bytes[words]);
        let more = numbers.get(3..).unwrap_or(&[]);
        if self.vertices == 0 {
            self.out.more_lanes = more.len();
        }
        self.uneven |= more.len() != self.out.more_lanes || more.iter().any(|v| !v.is_finite());
        if !self.uneven {
            self.out.more.extend_from_slice(more);
        }
        self.vertices += 1;
    }

    fn read_face(&mut self) {
        let first = self.faces.corners.len();
        let counts = [
            self.vertices,
            self.out.textures.len() as u32,
            self.out.normals.len() as u32,
        ];
        while let Some(word) = self.lexer.token_on_line() {
            let Some(corner) = FaceCorner::parse(&self.lexer, word) else {
                continue;
            };
            let Some(vertex) = resolve(corner.vertex, counts[0]) else {
                continue;
            };
            let texture = corner.texture.and_then(|t| resolve(t, counts[1])).unwrap_or(NO_TEXTURE);
            let normal = corner.normal.and_then(|n| resolve(n, counts[2])).unwrap_or(NO_NORMAL);
            self.faces.corners.push(vertex);
            self.corners.push([texture, normal]);
        }
        let count = self.faces.corners.len() - first;
        self.faces.end_face();
        self.corners.truncate(self.faces.corners.len());
        if count >= 3 {
            self.face_states.push((self.state, count - 2));
        }
    }

    fn finish(mut self, positions: &[DVec3]) -> ObjStatements<'a> {
        if self.uneven || self.vertices as usize != positions.len() {
            (self.out.more, self.out.more_lanes) = (Vec::new(), 0);
        }
        let known = |corner: &u32| (*corner as usize) < positions.len();
        if !self.faces.corners.iter().all(known) {
            return self.out;
        }
        let Ok((slots, _)) = self.faces.triangulate(positions, || Ok(())) else {
            return self.out;
        };
        let (textures, normals) = (self.out.textures.len() as u32, self.out.normals.len() as u32);
        for slot in slots.into_iter().flatten() {
            let [texture, normal] = self.corners[slot as usize];
            self.out
                .corner_textures
                .push(if texture < textures { texture } else { NO_TEXTURE });
            self.out
                .corner_normals
                .push(if normal < normals { normal } else { NO_NORMAL });
        }
        for (state, count) in self.face_states {
            self.out.states.extend(std::iter::repeat_n(state, count));
        }
        self.out
    }
}

/// The numbers after the coordinates of vertices; and of each corner its texture coordinates, its normal where vertices have
/// none of their own, and the statements that hold for its face.
pub(super) fn tell_apart(model: &Model, keys: &mut AttributeKeys<'_>) {
    let geometry = &model.geometry;
    let read = read(&model.files.main, &geometry.positions);
    for (i, number) in read.more.iter().enumerate() {
        keys.add(i / read.more_lanes, number.to_bits());
    }
    if read.states.len() != geometry.triangles.len() {
        return;
    }
    let of_line = |text: &&[u8]| hash_numbers(&parse_numbers(text));
    let textures: Vec<u64> = read.textures.iter().map(of_line).collect();
    let of_state = |state: &FaceState<'_>| {
        let lines = [state.object, state.group, state.smoothing, state.material];
        lines
            .iter()
            .fold(1, |hash, line| mix_bits(hash, line.map_or(0, hash_bytes)))
    };
    let mut state = (read.states.first(), read.states.first().map_or(0, of_state));
    for (i, t) in geometry.triangles.iter().enumerate() {
        if state.0 != read.states.get(i) {
            state = (read.states.get(i), of_state(&read.states[i]));
        }
        for (k, &v) in t.iter().enumerate() {
            let texture = read
                .corner_textures
                .get(3 * i + k)
                .and_then(|&t| textures.get(t as usize));
            let mut key = mix_bits(state.1, texture.copied().unwrap_or(0));
            if geometry.normals.is_empty() {
                let normal = read
                    .corner_normals
                    .get(3 * i + k)
                    .and_then(|&n| read.normals.get(n as usize));
                key = mix_bits(key, normal.map_or(0, |n| normal_key(n.1)));
            }
            keys.add_of_corner(v, key);
        }
    }
}

/// The numbers of a line; words that are none end it.
pub(super) fn parse_numbers(text: &[u8]) -> Vec<f64> {
    let mut lexer = TextLexer::new(text, STYLE);
    std::iter::from_fn(|| lexer.token())
        .map_while(|t| number(&text[t.range()]))
        .collect()
}

/// The objects in the order in which faces first name them.
pub(super) fn object_numbers<'a>(states: &[FaceState<'a>]) -> BTreeMap<Option<&'a [u8]>, usize> {
    let mut numbers = BTreeMap::new();
    for state in states {
        let next = numbers.len();
        numbers.entry(state.object).or_insert(next);
    }
    numbers
}

/// The name in a line such as `usemtl name`.
pub(super) fn name_in(line: &[u8]) -> String {
    let start = line.iter().position(|b| b.is_ascii_whitespace()).unwrap_or(line.len());
    String::from_utf8_lossy(line[start..].trim_ascii()).into_owned()
}

/// A name without what would end its line.
pub(super) fn printable(name: &str) -> String {
    name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// What separates words.
pub(super) const STYLE: TextStyle = TextStyle {
    comments: true,
    continuation: true,
};

/// Marks a corner that names no normal.
pub(super) const NO_NORMAL: u32 = u32::MAX;

/// One corner of a face as written: vertex, texture coordinate and normal, each counted from 1 or from the end.
#[derive(Debug, Clone, Copy)]
pub(super) struct FaceCorner {
    pub vertex: i64,
    pub texture: Option<i64>,
    pub normal: Option<i64>,
    /// Where the number of the normal stands.
    pub normal_token: TextToken,
}

impl FaceCorner {
    /// Reads a corner; `None` when the word is none.
    pub fn parse(lexer: &TextLexer<'_>, token: TextToken) -> Option<Self> {
        let mut end = token.start;
        let mut next = || {
            let start = end;
            let text = lexer.text(TextToken {
                start: start.min(token.end),
                ..token
            });
            let length = text.iter().position(|&b| b == b'/').unwrap_or(text.len());
            end = start + length + 1;
            (
                &text[..length],
                TextToken {
                    start,
                    end: start + length,
                    ..token
                },
            )
        };
        let optional = |text: &[u8]| {
            if text.is_empty() {
                Some(None)
            } else {
                integer(text).map(Some)
            }
        };
        let (vertex, texture, (normal, normal_token)) = (next().0, next().0, next());
        let complete = end > token.end;
        complete.then_some(Self {
            vertex: integer(vertex)?,
            texture: optional(texture)?,
            normal: optional(normal)?,
            normal_token,
        })
    }
}

/// The place in a list of `count` lines so far that a written index means; `None` for 0 and for places before the first.
/// An index past `count` may name a line that is still to come.
pub(super) fn resolve(index: i64, count: u32) -> Option<u32> {
    let place = if index > 0 { index - 1 } else { i64::from(count) + index };
    u32::try_from(place).ok().filter(|_| index != 0)
}

/// The next three words of the line, or how many there were.
pub(super) fn three_words(lexer: &mut TextLexer<'_>) -> Result<[TextToken; 3], usize> {
    let mut words = [TextToken {
        start: 0,
        end: 0,
        line: 0,
    }; 3];
    for i in 0..3 {
        words[i] = lexer.token_on_line().ok_or(i)?;
    }
    Ok(words)
}

/// The texture coordinates of a run, counted from the upper left corner of the picture.
pub(super) enum RunCoordinates {
    None,
    /// One for each vertex.
    OfVertices(Vec<[f32; 2]>),
    /// One for each corner of a triangle.
    OfCorners(Vec<[f32; 2]>),
}

/// Finds the coordinates of a run. `statements` are its base's.
pub(super) fn coordinates_of(
    edited: &EditedModel<'_>,
    run: &PrimitiveRun,
    statements: &ObjStatements<'_>,
) -> RunCoordinates {
    let old = &edited.base(run).model.geometry.triangles;
    let seam = &statements.corner_textures;
    if seam.len() != 3 * old.len() || seam.iter().all(|&line| line == NO_TEXTURE) {
        return RunCoordinates::None;
    }
    let pair = |line: &&[u8]| {
        let numbers = parse_numbers(line);
        let at = |i: usize| numbers.get(i).copied().filter(|v| v.is_finite()).unwrap_or(0.0);
        [at(0), at(1)]
    };
    let lines: Vec<[f64; 2]> = statements.textures.iter().map(pair).collect();
    let origins = TriangleOrigins::new(edited, run, old);
    let mut corners = Vec::with_capacity(3 * run.triangle_count as usize);
    for triangle in 0..run.triangle_count as usize {
        for k in 0..3 {
            let (mut sum, mut total) = ([0.0; 2], 0.0);
            for (corner, weight) in origins.corner(triangle, k, seam) {
                if let Some([u, v]) = lines.get(seam[corner as usize] as usize) {
                    sum = [sum[0] + u * weight, sum[1] + v * weight];
                    total += weight;
                }
            }
            let scale = if total > 0.0 { 1.0 / total } else { 0.0 };
            corners.push([(sum[0] * scale) as f32, (1.0 - sum[1] * scale) as f32]);
        }
    }
    by_vertex(edited, run, &corners).map_or(RunCoordinates::OfCorners(corners), RunCoordinates::OfVertices)
}

/// One coordinate for each vertex, if all of its corners have the same.
fn by_vertex(edited: &EditedModel<'_>, run: &PrimitiveRun, corners: &[[f32; 2]]) -> Option<Vec<[f32; 2]>> {
    let mut of_vertex: Vec<Option<[f32; 2]>> = vec![None; run.vertex_count as usize];
    let vertices = edited.triangles[run.triangles()].as_flattened();
    for (&vertex, &here) in vertices.iter().zip(corners) {
        let known = of_vertex[(vertex - run.first_vertex) as usize].get_or_insert(here);
        if known.map(f32::to_bits) != here.map(f32::to_bits) {
            return None;
        }
    }
    Some(of_vertex.into_iter().map(Option::unwrap_or_default).collect())
}
