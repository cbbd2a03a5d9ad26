//! What an OBJ text holds beyond positions and triangles, and how it is divided among the corners of an edited run.

use super::super::text::{NumberPrecision, TextLexer, TextStyle, TextToken, integer, number, push_number, push_triple};
use crate::edited::{CarriedAttributes, EditedModel, PrimitiveRun, TriangleOrigins, VertexBlends};
use crate::geometry::unit_or_zero;
use glam::{DMat3, DVec3, Vec3};
use pliant_mesh::{NONE, shading};
use std::collections::BTreeMap;
use std::io::Write as _;

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
    /// Lines and points.
    pub elements: Vec<ObjElement<'a>>,
}

/// A line or points.
pub(super) struct ObjElement<'a> {
    /// What holds for it.
    pub state: FaceState<'a>,
    /// `l` or `p`.
    pub keyword: u8,
    /// Its vertices, counted from 0.
    pub vertices: Vec<u32>,
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

/// A line of three numbers behind a keyword.
pub(super) fn push_line(out: &mut Vec<u8>, keyword: &[u8], values: DVec3, precision: NumberPrecision, newline: &[u8]) {
    out.extend_from_slice(keyword);
    push_triple(out, values, precision);
    out.extend_from_slice(newline);
}

/// A corner of a face, with a blank before it.
pub(super) fn push_corner(out: &mut Vec<u8>, vertex: u64, texture: Option<u64>, normal: Option<u64>) {
    let result = match (texture, normal) {
        (None, None) => write!(out, " {vertex}"),
        (Some(texture), None) => write!(out, " {vertex}/{texture}"),
        (None, Some(normal)) => write!(out, " {vertex}//{normal}"),
        (Some(texture), Some(normal)) => write!(out, " {vertex}/{texture}/{normal}"),
    };
    debug_assert!(result.is_ok(), "writing to memory does not fail");
}

/// Numbers with blanks between them.
pub(super) fn push_numbers(out: &mut Vec<u8>, numbers: &[f64]) {
    for (i, &value) in numbers.iter().enumerate() {
        if i > 0 {
            out.push(b' ');
        }
        push_number(out, value, NumberPrecision::Single);
    }
}

/// Old lines and weights; the same line twice counts twice.
type LineMix = Vec<(u32, f64)>;

/// A run with what its corners have.
pub(super) struct CornerAttributes<'a> {
    /// Triangles over the run's vertices, from 0.
    pub triangles: Vec<[u32; 3]>,
    /// For each triangle the place of its corners' coordinates in `textures`; `None` where one has none.
    pub corner_textures: Vec<Option<[u32; 3]>>,
    pub textures: Vec<TextureCoordinate<'a>>,
    /// The same for normals.
    pub corner_normals: Vec<Option<[u32; 3]>>,
    pub normals: Vec<CornerNormal<'a>>,
    /// For each triangle what holds for it.
    pub states: Vec<FaceState<'a>>,
}

impl<'a> CornerAttributes<'a> {
    /// Gives the run of a cap its own texture coordinates, one per vertex, and the line that names its material.
    pub fn take_cap(&mut self, uv: &[[f32; 2]], material: &'a [u8]) {
        let coordinates = uv.iter().map(|[u, v]| vec![f64::from(*u), 1.0 - f64::from(*v)]);
        self.textures = coordinates.map(TextureCoordinate::New).collect();
        self.corner_textures = self.triangles.iter().map(|t| Some(*t)).collect();
        self.states.iter_mut().for_each(|state| state.material = Some(material));
    }
}

/// Texture coordinates.
pub(super) enum TextureCoordinate<'a> {
    /// The words of an old line.
    Old(&'a [u8]),
    /// Blended ones.
    New(Vec<f64>),
}

impl TextureCoordinate<'_> {
    pub fn numbers(&self) -> Vec<f64> {
        match self {
            Self::Old(text) => parse_numbers(text),
            Self::New(numbers) => numbers.clone(),
        }
    }
}

/// A normal, with the words of its line where it is an old one.
pub(super) struct CornerNormal<'a> {
    pub value: Vec3,
    pub old: Option<&'a [u8]>,
}

/// A vertex and the old lines that it is blended from, by which corners are the same.
type CornerKey = (u32, [u32; VertexBlends::MAX_SOURCES]);

fn corner_key(vertex: u32, mix: &LineMix) -> CornerKey {
    let mut lines = [u32::MAX; VertexBlends::MAX_SOURCES];
    lines.iter_mut().zip(mix).for_each(|(to, (line, _))| *to = *line);
    // One line alone is the same at every vertex for coordinates, but normals turn with the vertex.
    (vertex, lines)
}

/// Parts a run. `statements` are its base's.
pub(super) fn divide_corners<'a>(
    edited: &EditedModel<'_>,
    run: &PrimitiveRun,
    positions: &[DVec3],
    statements: &ObjStatements<'a>,
) -> CornerAttributes<'a> {
    let old = &edited.base(run).model.geometry.triangles;
    let complete = statements.states.len() == old.len();
    let triangles = edited.local_triangles(run);
    let origins = TriangleOrigins::new(edited, run, old);
    let mut parted = CornerAttributes {
        corner_textures: vec![None; triangles.len()],
        textures: Vec::new(),
        corner_normals: vec![None; triangles.len()],
        normals: Vec::new(),
        states: Vec::new(),
        triangles,
    };
    let state_of = |&origin: &u32| statements.states.get(origin as usize).copied().unwrap_or_default();
    parted.states = origins.old_triangles().iter().map(state_of).collect();
    if !complete {
        return parted;
    }
    let has = |lines: &[u32]| lines.iter().any(|&line| line != u32::MAX);
    let seam = &statements.corner_textures;
    let mut texture_numbers: BTreeMap<CornerKey, u32> = BTreeMap::new();
    let mut shade_numbers: BTreeMap<CornerKey, u32> = BTreeMap::new();
    let mut shades: Vec<(u32, LineMix)> = Vec::new();
    let mut corner_shades = vec![[NONE; 3]; parted.triangles.len()];
    let (has_textures, has_normals) = (has(seam), has(&statements.corner_normals));
    for (i, triangle) in parted.triangles.clone().into_iter().enumerate() {
        if !has_textures && !has_normals {
            break;
        }
        let corners: [LineMix; 3] = std::array::from_fn(|k| origins.corner(i, k, seam));
        let mix = |k: usize, lines: &[u32], none: u32| -> Option<LineMix> {
            let mix: LineMix = corners[k]
                .iter()
                .map(|&(c, w)| (lines[c as usize], w))
                .filter(|m| m.0 != none)
                .collect();
            let first = mix.first()?.0;
            let one = mix.iter().all(|m| m.0 == first);
            Some(if one { vec![(first, 1.0)] } else { mix })
        };
        let textures: [Option<LineMix>; 3] = std::array::from_fn(|k| mix(k, seam, NO_TEXTURE));
        if let [Some(a), Some(b), Some(c)] = textures {
            let mut number = |k: usize, mix: LineMix| {
                let vertex = if mix.len() == 1 { NONE } else { triangle[k] };
                *texture_numbers.entry(corner_key(vertex, &mix)).or_insert_with(|| {
                    parted.textures.push(blend_texture(&mix, statements));
                    parted.textures.len() as u32 - 1
                })
            };
            parted.corner_textures[i] = Some([number(0, a), number(1, b), number(2, c)]);
        }
        let normals: [Option<LineMix>; 3] = std::array::from_fn(|k| mix(k, &statements.corner_normals, NO_NORMAL));
        if let [Some(a), Some(b), Some(c)] = normals {
            let mut number = |k: usize, mix: LineMix| {
                *shade_numbers.entry(corner_key(triangle[k], &mix)).or_insert_with(|| {
                    shades.push((triangle[k], mix));
                    shades.len() as u32 - 1
                })
            };
            corner_shades[i] = [number(0, a), number(1, b), number(2, c)];
            parted.corner_normals[i] = Some(corner_shades[i]);
        }
    }
    if !shades.is_empty() {
        let shading = RunShading {
            triangles: &parted.triangles,
            shades: &shades,
            corner_shades,
        };
        parted.normals = carry_normals(edited, run, positions, shading, statements);
    }
    parted
}

fn blend_texture<'a>(mix: &LineMix, statements: &ObjStatements<'a>) -> TextureCoordinate<'a> {
    if let [(line, _)] = mix.as_slice() {
        return TextureCoordinate::Old(statements.textures[*line as usize]);
    }
    let total: f64 = mix.iter().map(|m| m.1).sum();
    let mut sum: Vec<f64> = Vec::new();
    for &(line, weight) in mix {
        let numbers = parse_numbers(statements.textures[line as usize]);
        sum.resize(sum.len().max(numbers.len()), 0.0);
        let finite = numbers.iter().map(|v| if v.is_finite() { *v } else { 0.0 });
        sum.iter_mut().zip(finite).for_each(|(to, v)| *to += v * weight / total);
    }
    TextureCoordinate::New(sum)
}

/// The shading vertices of a run: what has one normal.
struct RunShading<'a> {
    /// Triangles over the run's vertices, from 0.
    triangles: &'a [[u32; 3]],
    /// The vertex and the blended old normals of each shading vertex.
    shades: &'a [(u32, LineMix)],
    /// The shading vertex of each corner.
    corner_shades: Vec<[u32; 3]>,
}

/// The normals of shading vertices after all edits and deformations.
fn carry_normals<'a>(
    edited: &EditedModel<'_>,
    run: &PrimitiveRun,
    positions: &[DVec3],
    shading: RunShading<'_>,
    statements: &ObjStatements<'a>,
) -> Vec<CornerNormal<'a>> {
    let RunShading {
        triangles,
        shades,
        mut corner_shades,
    } = shading;
    let none = shades.len() as u32;
    corner_shades
        .iter_mut()
        .flatten()
        .for_each(|shade| *shade = (*shade).min(none));
    let now = &positions[run.vertices()];
    let before = CarriedAttributes::before(edited, run);
    let gradients = shading::gradients(&before, now, triangles, &corner_shades, shades.len() + 1);
    let smooth = shading::smooth_normals(now, triangles);
    let placing = &edited.base(run).world_from_model.matrix3;
    let world_from_normal = shading::cofactor(placing) * if placing.determinant() < 0.0 { -1.0 } else { 1.0 };
    let one = |(i, (vertex, mix)): (usize, &(u32, LineMix))| {
        let vertex = *vertex as usize;
        let authored = match mix.as_slice() {
            [(line, _)] => statements.normals[*line as usize].1,
            _ => unit_or_zero(
                mix.iter()
                    .map(|&(n, w)| statements.normals[n as usize].1.as_dvec3() * w)
                    .sum(),
            ),
        };
        let placed = if *placing == DMat3::IDENTITY {
            authored
        } else {
            unit_or_zero(world_from_normal * authored.as_dvec3())
        };
        let bare = edited.is_bare(run.first_vertex as usize + vertex);
        if placed == Vec3::ZERO || bare {
            return CornerNormal {
                value: smooth[vertex],
                old: None,
            };
        }
        let value = gradients[i]
            .as_ref()
            .map_or(placed, |g| shading::carry_normal(g, placed));
        let stays = mix.len() == 1 && (value - authored).abs().max_element() <= 1e-6;
        CornerNormal {
            value,
            old: stays.then(|| statements.normals[mix[0].0 as usize].0),
        }
    };
    shades.iter().enumerate().map(one).collect()
}
