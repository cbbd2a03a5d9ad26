//! Wavefront OBJ: reading, editing in place, and building.
//!
//! A render vertex is a `v` line, in file order, whether a face uses it or not. Lines that the mesh does not need
//! (materials, groups, curves, whatever is unknown) are never interpreted, so they survive untouched.

mod edited;
#[cfg(test)]
mod edited_tests;
mod foreign;
mod library;
mod read;
mod statements;
#[cfg(test)]
mod tests;

pub(super) use read::FORMAT;

use super::text::{NumberPrecision, TextLexer, TextPatch, newline_of, push_triple};
use crate::codec::{EditedOutput, FormatCodec, PatchedOutput, ReadFile, patch_text_file};
use crate::edited::{EditedModel, FaceOutlines, PrimitiveRun};
use crate::files::{ReadWatch, counted};
use crate::look::NamedMaterial;
use crate::model::position_bits;
use crate::neutral::{NeutralModel, NeutralPrimitive, RunAttributes, RunPart};
use crate::vertex_attributes::AttributeKeys;
use crate::{Error, FileSet, Format, Geometry, Model, WrittenFiles};
use glam::{DVec3, Vec3};
use library::write_library;
use read::{BeyondFaces, NormalLines, NormalPlan, ObjNotes};
use statements::{FaceCorner, STYLE, printable, push_corner, push_line, push_numbers, resolve};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Reads and writes OBJ.
pub(super) struct ObjCodec;

impl FormatCodec for ObjCodec {
    fn patches_files_of(&self, format: Format) -> bool {
        format == FORMAT
    }

    fn read(&self, files: &FileSet, _: Format, watch: &ReadWatch<'_>) -> Result<ReadFile, Error> {
        let (mut geometry, notes) = read::read(&files.main, watch)?;
        library::warn_of_missing(files, &mut geometry);
        Ok((geometry, Arc::new(notes) as _))
    }

    fn companion_names(&self, files: &FileSet, _: Format) -> Vec<String> {
        library::companion_names(files)
    }

    fn patch_positions(&self, output: &PatchedOutput<'_>) -> Result<WrittenFiles, Error> {
        patch_text_file(output, patch)
    }

    fn build(&self, neutral: &NeutralModel, _: Format) -> Result<WrittenFiles, Error> {
        Ok(build(neutral))
    }

    fn write_edited(&self, output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
        edited::write_edited(output)
    }

    fn face_outlines<'a>(&self, model: &'a Model) -> Option<&'a FaceOutlines> {
        model.notes::<read::ObjNotes>().map(|notes| &notes.outlines)
    }

    fn segments(&self, model: &Model) -> Result<Vec<[u32; 2]>, Error> {
        let statements = read::read_statements(&model.files.main);
        let lines = statements.elements.iter().filter(|element| element.keyword == b'l');
        Ok(lines
            .flat_map(|line| line.vertices.windows(2).map(|pair| [pair[0], pair[1]]))
            .collect())
    }

    fn run_attributes(&self, edited: &EditedModel<'_>, runs: &[&PrimitiveRun]) -> Result<Vec<RunAttributes>, Error> {
        Ok(edited::run_attributes(edited, runs))
    }

    fn beyond_conversion(&self, model: &Model, is_merged: bool) -> Result<Vec<String>, Error> {
        let BeyondFaces {
            lines,
            points,
            curves,
            groups,
            smoothings,
        } = model.notes_or_refuse::<ObjNotes>(FORMAT)?.beyond;
        let drawn = [
            counted(groups, "group", "groups and objects"),
            counted(smoothings, "smoothing group", "smoothing groups"),
            counted(lines, "line", "lines"),
            counted(points, "statement of points", "statements of points"),
        ];
        let of_other = drawn.into_iter().filter(|_| !is_merged);
        let curves = counted(curves, "curve or surface", "curves and surfaces");
        Ok(of_other.chain([curves]).flatten().collect())
    }

    fn seam_parts(
        &self,
        edited: &EditedModel<'_>,
        run: &PrimitiveRun,
        positions: &[DVec3],
    ) -> Result<Option<Vec<RunPart>>, Error> {
        Ok(Some(edited::seam_parts(edited, run, positions)))
    }

    fn distinguish_vertices(&self, model: &Model, keys: &mut AttributeKeys<'_>) -> Result<(), Error> {
        edited::distinguish_vertices(model, keys);
        Ok(())
    }
}

/// The uploaded text with the vertices at `positions`.
fn patch(bytes: &[u8], notes: &ObjNotes, rest: &Geometry, positions: &[DVec3]) -> Vec<u8> {
    let shading = notes.normals.as_ref().map(|normals| {
        (
            normals,
            normals.plan_changes(&rest.positions, positions, &rest.triangles),
        )
    });
    let insertion = shading
        .as_ref()
        .and_then(|(normals, plan)| insertion_place(bytes, normals, plan));
    let mut lexer = TextLexer::new(bytes, STYLE);
    let mut patch = TextPatch::new(bytes);
    let (mut vertices, mut normal_lines) = (0u32, 0u32);
    while let Some(keyword) = lexer.token() {
        if let (Some(place), Some((_, plan))) = (&insertion, &shading)
            && place.offset == keyword.start
        {
            insert(&mut patch, place, plan, newline_of(bytes));
        }
        match lexer.text(keyword) {
            b"v" => {
                let (old, new) = (rest.positions[vertices as usize], positions[vertices as usize]);
                if position_bits(old) != position_bits(new)
                    && let Ok(words) = lexer.three_on_line()
                {
                    patch.replace_changed(words, old, new, NumberPrecision::Double);
                }
                vertices += 1;
            }
            b"vn" => {
                let new = shading
                    .as_ref()
                    .and_then(|(_, plan)| plan.rewritten[normal_lines as usize]);
                if let (Some(new), Ok(words)) = (new, lexer.three_on_line()) {
                    let place = words[0].start..words[2].end;
                    push_triple(patch.replace(place), new.as_dvec3(), NumberPrecision::Single);
                }
                normal_lines += 1;
            }
            b"f" => {
                if let (Some(place), Some((normals, plan))) = (&insertion, &shading) {
                    while let Some(word) = lexer.token_on_line() {
                        let Some(corner) = FaceCorner::parse(&lexer, word) else {
                            continue;
                        };
                        let renumbered = place.renumber(normals, plan, corner, [vertices, normal_lines], keyword.start);
                        if let Some(index) = renumbered {
                            let out = patch.replace(corner.normal_token.range());
                            out.extend_from_slice(index.to_string().as_bytes());
                        }
                    }
                }
            }
            _ => {}
        }
        lexer.end_line();
    }
    patch.finish()
}

/// Where new `vn` lines go: before the first face that uses one, because some readers look up normals at once.
struct NormalInsertion {
    offset: usize,
    /// `vn` lines above.
    lines_above: u32,
    /// `vn` lines in the whole uploaded file.
    lines: u32,
    added: u32,
}

impl NormalInsertion {
    /// The number that a corner must now give for its normal, counted from 1, if what is written there is no longer right.
    fn renumber(
        &self,
        normals: &NormalLines,
        plan: &NormalPlan,
        corner: FaceCorner,
        [vertices, normal_lines]: [u32; 2],
        face_offset: usize,
    ) -> Option<u32> {
        let (vertex, old) = (
            resolve(corner.vertex, vertices)?,
            resolve(corner.normal?, normal_lines)?,
        );
        let line = normals.line_of(plan, old, vertex);
        let wanted = if line >= self.lines {
            self.lines_above + (line - self.lines)
        } else if line >= self.lines_above {
            line + self.added
        } else {
            line
        };
        let lines_now = normal_lines + if face_offset >= self.offset { self.added } else { 0 };
        (resolve(corner.normal?, lines_now) != Some(wanted)).then_some(wanted + 1)
    }
}

fn insertion_place(bytes: &[u8], normals: &NormalLines, plan: &NormalPlan) -> Option<NormalInsertion> {
    if plan.added.is_empty() {
        return None;
    }
    let lines = plan.rewritten.len() as u32;
    let mut lexer = TextLexer::new(bytes, STYLE);
    let (mut vertices, mut normal_lines) = (0u32, 0u32);
    while let Some(keyword) = lexer.token() {
        match lexer.text(keyword) {
            b"v" => vertices += 1,
            b"vn" => normal_lines += 1,
            b"f" => {
                while let Some(word) = lexer.token_on_line() {
                    let Some(corner) = FaceCorner::parse(&lexer, word) else {
                        continue;
                    };
                    let vertex = resolve(corner.vertex, vertices);
                    let normal = corner.normal.and_then(|n| resolve(n, normal_lines));
                    if let (Some(vertex), Some(normal)) = (vertex, normal)
                        && normals.line_of(plan, normal, vertex) >= lines
                    {
                        let added = plan.added.len() as u32;
                        return Some(NormalInsertion {
                            offset: keyword.start,
                            lines_above: normal_lines,
                            lines,
                            added,
                        });
                    }
                }
            }
            _ => {}
        }
        lexer.end_line();
    }
    None
}

fn insert(patch: &mut TextPatch<'_>, place: &NormalInsertion, plan: &NormalPlan, newline: &[u8]) {
    let out = patch.replace(place.offset..place.offset);
    for normal in &plan.added {
        push_line(out, b"vn ", normal.as_dvec3(), NumberPrecision::Single, newline);
    }
}

/// A fresh text: one object for each primitive, normals where every vertex has one, texture coordinates where the
/// primitive has them, colours behind the coordinates where any primitive has some, polygons as they were, and materials
/// in a library beside it where more than their names is known.
fn build(neutral: &NeutralModel) -> WrittenFiles {
    let NeutralModel { geometry, colours, .. } = neutral;
    let mut written = WrittenFiles::single(b"# pliant\n".to_vec());
    let out = &mut written.main;
    let materials = named_materials(neutral);
    if materials.iter().any(|(_, material)| material.look.is_some()) {
        let stem = if neutral.stem.is_empty() {
            "model"
        } else {
            &neutral.stem
        };
        out.extend(format!("mtllib {stem}.mtl\n").bytes());
        let (library, pictures) = write_library(&materials);
        written.companions = pictures;
        written.companions.insert(format!("{stem}.mtl"), library);
    }
    for (i, &position) in geometry.positions.iter().enumerate() {
        push_line(out, b"v ", position, NumberPrecision::Double, b"");
        if let Some([r, g, b, _]) = colours.get(i) {
            out.push(b' ');
            push_triple(out, Vec3::new(*r, *g, *b).as_dvec3(), NumberPrecision::Single);
        }
        out.push(b'\n');
    }
    let mut textures = TextureLines::default();
    for own in neutral.primitives() {
        textures.add_primitive(out, neutral, &own);
    }
    let with_normals = geometry.all_have_normals();
    if with_normals {
        for &normal in &geometry.normals {
            let normal: Vec3 = normal;
            push_line(out, b"vn ", normal.as_dvec3(), NumberPrecision::Single, b"\n");
        }
    }
    for own in neutral.primitives() {
        if geometry.primitives.len() > 1 || !own.primitive.name.is_empty() {
            out.extend(format!("o {}\n", printable(&own.primitive.name)).bytes());
        }
        let material = own.attributes.material.as_ref();
        if let Some((name, _)) = material.and_then(|m| materials.iter().find(|(_, known)| known == m)) {
            out.extend(format!("usemtl {name}\n").bytes());
        }
        own.each_face(|corners| {
            out.push(b'f');
            for &corner in corners {
                let v = own.vertex_at(corner);
                let number = u64::from(v) + 1;
                let texture = textures.line_number(neutral, &own, corner);
                push_corner(out, number, texture, with_normals.then_some(number));
            }
            out.push(b'\n');
        });
    }
    written
}

/// The materials of a model, each under a name of its own.
fn named_materials(neutral: &NeutralModel) -> Vec<(String, Arc<NamedMaterial>)> {
    let mut named: Vec<(String, Arc<NamedMaterial>)> = Vec::new();
    for material in neutral.attributes.iter().filter_map(|a| a.material.as_ref()) {
        if named.iter().any(|(_, known)| known == material) {
            continue;
        }
        let plain = printable(&material.name);
        let mut name = plain.clone();
        while named.iter().any(|(known, _)| *known == name) {
            name = format!("{plain}.{}", named.len());
        }
        named.push((name, Arc::clone(material)));
    }
    named
}

/// The `vt` lines of a fresh text: one for each vertex, or one for each pair of numbers where corners have them.
#[derive(Default)]
struct TextureLines {
    count: u64,
    /// For each vertex the number of its line, 0 without one.
    of_vertex: Vec<u64>,
    of_pair: BTreeMap<[u32; 2], u64>,
}

impl TextureLines {
    fn add_primitive(&mut self, out: &mut Vec<u8>, neutral: &NeutralModel, own: &NeutralPrimitive<'_>) {
        let mut push = |[u, v]: [f32; 2]| {
            out.extend_from_slice(b"vt ");
            push_numbers(out, &[f64::from(u), f64::from(1.0 - v)]);
            out.push(b'\n');
        };
        if own.attributes.has_corner_uv {
            let corners = 0..3 * own.triangles.len() as u32;
            for pair in corners.filter_map(|corner| neutral.uv_at(own, corner)) {
                let next = self.count + 1;
                if *self.of_pair.entry(pair.map(f32::to_bits)).or_insert(next) == next {
                    self.count = next;
                    push(pair);
                }
            }
        } else if own.attributes.has_uv {
            self.of_vertex.resize(own.vertices.start, 0);
            for pair in neutral.uv.get(own.vertices.clone()).unwrap_or(&[]) {
                self.count += 1;
                self.of_vertex.push(self.count);
                push(*pair);
            }
        }
    }

    /// The number of the line of a corner.
    fn line_number(&self, neutral: &NeutralModel, own: &NeutralPrimitive<'_>, corner: u32) -> Option<u64> {
        if own.attributes.has_corner_uv {
            let pair = neutral.uv_at(own, corner)?;
            return self.of_pair.get(&pair.map(f32::to_bits)).copied();
        }
        let number = self.of_vertex.get(own.vertex_at(corner) as usize).copied();
        number.filter(|n| own.attributes.has_uv && *n > 0)
    }
}
