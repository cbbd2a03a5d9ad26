//! Object File Format (OFF) with its optional colours, normals and texture coordinates.
//!
//! Each vertex and each face begins a line of its own; what follows the numbers that the mesh needs (colours, texture
//! coordinates) is kept unread.

mod read;

pub(super) use read::FORMAT;

use super::text::{NumberPrecision, TextLexer, integer, number, push_number, push_triple};
use crate::codec::{EditedOutput, FormatCodec, PatchedOutput, ReadFile, patch_text_file};
use crate::edited::{CarriedAttributes, EditedModel, FaceOutlines, PrimitiveRun, RunFaces, TriangleOrigins};
use crate::files::ReadWatch;
use crate::neutral::{HeldLooks, NeutralModel, RunAttributes};
use crate::vertex_attributes::{AttributeKeys, hash_bytes};
use crate::{Error, FileSet, Format, Model, WrittenFiles};
use glam::Vec3;
use pliant_mesh::NONE;
use read::{OffNotes, STYLE, read_count, read_header};
use std::sync::Arc;

/// Reads and writes OFF.
pub(super) struct OffCodec;

impl FormatCodec for OffCodec {
    fn patches_files_of(&self, format: Format) -> bool {
        format == FORMAT
    }

    fn read(&self, files: &FileSet, _: Format, watch: &ReadWatch<'_>) -> Result<ReadFile, Error> {
        read::read(&files.main, watch).map(|(geometry, notes)| (geometry, Arc::new(notes) as _))
    }

    fn patch_positions(&self, output: &PatchedOutput<'_>) -> Result<WrittenFiles, Error> {
        patch_text_file(output, read::patch)
    }

    fn build(&self, neutral: &NeutralModel, _: Format) -> Result<WrittenFiles, Error> {
        Ok(WrittenFiles::single(read::build(neutral)))
    }

    fn held_looks(&self) -> HeldLooks {
        HeldLooks {
            colours: true,
            ..HeldLooks::NONE
        }
    }

    fn write_edited(&self, output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
        write_edited(output).map(WrittenFiles::single)
    }

    fn face_outlines<'a>(&self, model: &'a Model) -> Option<&'a FaceOutlines> {
        model.notes::<read::OffNotes>().map(|notes| &notes.outlines)
    }

    fn run_attributes(&self, edited: &EditedModel<'_>, runs: &[&PrimitiveRun]) -> Result<Vec<RunAttributes>, Error> {
        run_attributes(edited, runs)
    }

    fn distinguish_vertices(&self, model: &Model, keys: &mut AttributeKeys<'_>) -> Result<(), Error> {
        distinguish_vertices(model, keys)
    }
}

/// What an OFF text holds beyond positions and triangles.
#[derive(Default)]
struct OffAttributes<'a> {
    /// Comments above the keyword, and the keyword.
    head: &'a [u8],
    has_normals: bool,
    /// Numbers after the coordinates (and the normal) of every vertex, so many for each; empty unless all have as many.
    more: Vec<f64>,
    lanes: usize,
    /// All of them are whole.
    whole: bool,
    /// For each triangle what follows the corners of its face, such as a colour.
    of_triangle: Vec<&'a [u8]>,
}

/// Reads what the text of a model that was read before holds beyond its geometry.
fn read_attributes<'a>(model: &'a Model, notes: &OffNotes) -> Result<OffAttributes<'a>, Error> {
    let bytes = &model.files.main[..];
    let mut lexer = TextLexer::new(bytes, STYLE);
    let start = lexer.at();
    read_header(&mut lexer)?;
    let mut rest = OffAttributes {
        head: &bytes[start..lexer.at()],
        has_normals: notes.has_normals,
        whole: true,
        ..OffAttributes::default()
    };
    let (vertices, _) = read_count(&mut lexer, "vertices")?;
    let (faces, _) = read_count(&mut lexer, "faces")?;
    lexer.end_line();
    let mut even = true;
    for vertex in 0..vertices {
        for _ in 0..if notes.has_normals { 6 } else { 3 } {
            lexer.token();
        }
        let before = rest.more.len();
        while let Some(word) = lexer.token_on_line() {
            let text = lexer.text(word);
            rest.whole &= integer(text).is_some();
            rest.more.extend(number(text).filter(|v| v.is_finite()));
        }
        let lanes = rest.more.len() - before;
        even &= vertex == 0 || lanes == rest.lanes;
        rest.lanes = lanes;
        lexer.end_line();
    }
    if !even || rest.lanes == 0 {
        (rest.more, rest.lanes) = (Vec::new(), 0);
    }
    for face in 0..faces {
        let (corners, _) = read_count(&mut lexer, &format!("corners of face {face}"))?;
        for _ in 0..corners {
            lexer.token();
        }
        let place = lexer.rest_of_line();
        let triangles = usize::try_from(corners).unwrap_or(0).saturating_sub(2);
        rest.of_triangle
            .extend(std::iter::repeat_n(&bytes[place], triangles.min(bytes.len())));
        lexer.end_line();
    }
    Ok(rest)
}

/// A text of the edited model with the kinds of numbers that the first base has. Faces that the edit
/// left alone stay whole, others are triangles; they have the colour of the face that they lie on.
fn write_edited(output: &EditedOutput<'_>) -> Result<Vec<u8>, Error> {
    let EditedOutput { edited, positions, .. } = *output;
    let of_bases = edited.read_bases(read_attributes)?;
    let Some(Some(first)) = of_bases.first() else {
        return Err(Error::unwritable(FORMAT, "the first base is not OFF"));
    };
    let mut out = first.head.to_vec();
    if out.is_empty() {
        out.extend_from_slice(b"OFF");
    }
    let run_faces: Vec<Option<RunFaces>> = edited.runs.iter().map(output.run_faces).collect();
    let count = |(run, faces): (&PrimitiveRun, &Option<RunFaces>)| {
        faces.as_ref().map_or(run.triangle_count as usize, RunFaces::face_count)
    };
    let faces: usize = edited.runs.iter().zip(&run_faces).map(count).sum();
    out.extend(format!("\n{} {faces} 0\n", positions.len()).bytes());
    for run in edited.runs {
        let normals = if first.has_normals {
            CarriedAttributes::new(edited, run, positions).normals()
        } else {
            Vec::new()
        };
        let own = of_bases
            .get(run.base as usize)
            .and_then(Option::as_ref)
            .filter(|r| r.lanes == first.lanes);
        for (i, vertex) in run.vertices().enumerate() {
            push_triple(&mut out, positions[vertex], NumberPrecision::Double);
            if first.has_normals {
                out.push(b' ');
                let normal = normals.get(i).copied().unwrap_or(Vec3::Z);
                push_triple(&mut out, normal.as_dvec3(), NumberPrecision::Single);
            }
            for lane in 0..first.lanes {
                // What another format leaves open is white.
                let white = if first.whole { 255.0 } else { 1.0 };
                let value = own.map_or(white, |own| own.blended(edited, vertex, lane));
                out.push(b' ');
                let value = if first.whole { value.round() } else { value };
                push_number(&mut out, value, NumberPrecision::Single);
            }
            out.push(b'\n');
        }
    }
    for (run, faces) in edited.runs.iter().zip(&run_faces).filter(|(r, _)| r.triangle_count > 0) {
        let old = &edited.base(run).model.geometry.triangles;
        let own = of_bases.get(run.base as usize).and_then(Option::as_ref);
        let own = own.filter(|own| own.of_triangle.len() == old.len() && own.of_triangle.iter().any(|t| !t.is_empty()));
        let origins = own.map(|_| TriangleOrigins::new(edited, run, old));
        let triangles = &edited.triangles[run.triangles()];
        RunFaces::each_or_triangles(faces.as_ref(), triangles.len(), |corners| {
            out.extend(corners.len().to_string().bytes());
            for &corner in corners {
                let vertex = triangles[corner as usize / 3][corner as usize % 3];
                out.extend(format!(" {vertex}").bytes());
            }
            let first = corners[0] as usize / 3;
            let origin = origins.as_ref().map_or(NONE, |o| o.old_triangles()[first]);
            let more = own
                .and_then(|own| own.of_triangle.get(origin as usize))
                .copied()
                .unwrap_or(&[]);
            if !more.is_empty() {
                out.push(b' ');
                out.extend_from_slice(more);
            }
            out.push(b'\n');
        });
    }
    Ok(out)
}

impl OffAttributes<'_> {
    /// A number after the coordinates of a new vertex.
    fn blended(&self, edited: &EditedModel<'_>, vertex: usize, lane: usize) -> f64 {
        let number_of = |v: u32| self.more.get(v as usize * self.lanes + lane).copied();
        edited.blended(vertex, |v| number_of(v).unwrap_or(0.0))
    }
}

/// The numbers after the coordinates of vertices, and what follows the corners of faces.
fn distinguish_vertices(model: &Model, keys: &mut AttributeKeys<'_>) -> Result<(), Error> {
    let rest = read_attributes(model, model.notes_or_refuse(FORMAT)?)?;
    for (i, number) in rest.more.iter().enumerate() {
        keys.add(i / rest.lanes, number.to_bits());
    }
    let triangles = &model.geometry.triangles;
    if rest.of_triangle.len() == triangles.len() && rest.of_triangle.iter().any(|more| !more.is_empty()) {
        for (t, more) in triangles.iter().zip(&rest.of_triangle) {
            t.iter().for_each(|&v| keys.add_of_corner(v, hash_bytes(more)));
        }
    }
    Ok(())
}

/// Colours of the vertices of runs.
fn run_attributes(edited: &EditedModel<'_>, runs: &[&PrimitiveRun]) -> Result<Vec<RunAttributes>, Error> {
    let model = runs.first().map(|run| edited.base(run).model);
    let Some((model, notes)) = model.and_then(|model| Some((model, model.notes::<OffNotes>()?))) else {
        return Ok(Vec::new());
    };
    let rest = read_attributes(model, notes)?;
    let word = rest.head.rsplit(|b| b.is_ascii_whitespace()).next().unwrap_or_default();
    let has_colours = word.contains(&b'C') && !word.starts_with(b"ST") && (3..=4).contains(&rest.lanes);
    let full = if rest.whole { 255.0 } else { 1.0 };
    let colour = |vertex: usize| {
        let lane = |lane: usize| {
            if lane < rest.lanes {
                rest.blended(edited, vertex, lane) / full
            } else {
                1.0
            }
        };
        [0, 1, 2, 3].map(|l| (lane(l) as f32).clamp(0.0, 1.0))
    };
    let one = |run: &&PrimitiveRun| RunAttributes {
        colours: if has_colours {
            run.vertices().map(colour).collect()
        } else {
            Vec::new()
        },
        ..RunAttributes::default()
    };
    Ok(runs.iter().map(one).collect())
}
