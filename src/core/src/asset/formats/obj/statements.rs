//! What an OBJ text holds beyond positions and triangles, read again when it is needed.
//!
//! Corners of faces, the words of lines, and what separates them.
//!
//! Texture coordinates of an OBJ for formats that divide no vertices: by vertex where all corners agree, else by corner.

use super::super::text::{TextLexer, TextStyle, TextToken, integer, number};
use glam::Vec3;
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
#[derive(Default)]
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
