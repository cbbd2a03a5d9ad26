//! OBJ out after edits of the topology, and what an edited OBJ gives to other formats.

use super::super::text::{NumberPrecision, push_number};
use super::foreign::{ForeignBases, WrittenLines};
use super::library::{MaterialLibrary, read_libraries};
use super::read::{ObjNotes, has_no_number, read_statements};
use super::statements::{
    CornerAttributes, FaceState, NO_TEXTURE, ObjElement, ObjStatements, TextureCoordinate, divide_corners, name_in,
    object_numbers, parse_numbers, printable, push_corner, push_line, push_numbers,
};
use crate::codec::EditedOutput;
use crate::edited::{EditedModel, FollowedLines, PrimitiveRun, RunFaces, TriangleOrigins};
use crate::files::counted;
use crate::look::NamedMaterial;
use crate::neutral::{RunAttributes, RunPart};
use crate::vertex_attributes::{AttributeKeys, hash_bytes, hash_numbers, normal_key};
use crate::{Error, Model, WrittenFiles, WrittenWarning};
use glam::{DVec3, Vec3};
use pliant_mesh::mix_bits;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A text of the edited model. Vertices are in the order of the blends; faces are in order within each
/// object; those of more than three corners that the edit left alone stay whole. Other bases follow with their texture coordinates, normals and material names.
pub(super) fn write_edited(output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
    let EditedOutput { edited, positions, .. } = *output;
    let all = edited.read_bases(|model, _: &ObjNotes| Ok(read_statements(&model.files.main)))?;
    let mut out = Vec::new();
    if let Some(Some(first)) = all.first() {
        out.extend_from_slice(first.head);
    }
    let mut libraries: Vec<&[u8]> = Vec::new();
    for line in all.iter().flatten().flat_map(|s| &s.libraries) {
        if !libraries.contains(line) {
            libraries.push(line);
            out.extend_from_slice(line);
            out.push(b'\n');
        }
    }
    let foreign = ForeignBases::of_output(output, &all)?;
    let mut companions = foreign.write_library(&mut out);
    for run in edited.runs {
        write_vertices(
            &mut out,
            edited,
            run,
            positions,
            all.get(run.base as usize).and_then(Option::as_ref),
        );
    }
    let name_line = |name: &&str| format!("usemtl {}", printable(name)).into_bytes();
    let cap_lines: Vec<Vec<u8>> = edited.cap_materials().iter().map(name_line).collect();
    let mut faces = EditedFaces::default();
    for run in edited.runs.iter().filter(|r| r.triangle_count > 0) {
        if let Some(Some(statements)) = all.get(run.base as usize) {
            let mut parted = divide_corners(edited, run, positions, statements);
            if let Some(line) = edited.cap_number(run).and_then(|cap| cap_lines.get(cap)) {
                parted.take_cap(edited.cap_uv(run), line);
            }
            faces.add_run(&mut out, run, parted, statements, (output.run_faces)(run).as_ref());
        }
    }
    let mut lost = LostElements::default();
    for (base, statements) in (0u32..).zip(&all) {
        if let Some(statements) = statements.as_ref().filter(|s| !s.elements.is_empty()) {
            let own = edited.runs.iter().filter(|run| run.base == base);
            faces.add_elements(
                base as usize,
                statements,
                &FollowedLines::of_runs(edited, own),
                &mut lost,
            );
        }
    }
    faces.write_faces(&mut out);
    for (base, neutral) in &foreign.bases {
        foreign.write_base(&mut out, output, *base, neutral, &mut faces.written);
    }
    // Libraries and pictures of every base; where two have one name, the first base's.
    let mut hidden: Vec<String> = Vec::new();
    for base in edited
        .bases
        .iter()
        .zip(&all)
        .filter_map(|(base, own)| own.as_ref().map(|_| base))
    {
        for (name, bytes) in &base.model.files.companions {
            let there = companions.entry(name.clone()).or_insert_with(|| bytes.to_vec());
            if there.as_slice() != &bytes[..] {
                hidden.push(format!("the {name} of a merged model, which the first one has too"));
            }
        }
    }
    let of_others = counted(
        lost.vertices,
        "vertex of lines and points",
        "vertices of lines and points",
    );
    let lost: Vec<String> = [counted(lost.lines, "line", "lines"), of_others]
        .into_iter()
        .flatten()
        .collect();
    let hidden = WrittenWarning::left_out(&hidden, output.format, "after the merge ");
    let left_out = WrittenWarning::left_out(&lost, output.format, "after the edit ")
        .into_iter()
        .chain(hidden);
    Ok(WrittenFiles {
        main: out,
        companions,
        warnings: left_out.collect(),
        ..WrittenFiles::default()
    })
}

/// `v` lines, with the numbers after the coordinates blended.
fn write_vertices(
    out: &mut Vec<u8>,
    edited: &EditedModel<'_>,
    run: &PrimitiveRun,
    positions: &[DVec3],
    of: Option<&ObjStatements<'_>>,
) {
    let lanes = of.map_or(0, |s| s.more_lanes);
    for vertex in run.vertices() {
        push_line(out, b"v ", positions[vertex], NumberPrecision::Double, b"");
        for lane in 0..lanes {
            let old = |v: u32| {
                of.and_then(|s| s.more.get(v as usize * lanes + lane))
                    .copied()
                    .unwrap_or(0.0)
            };
            out.push(b' ');
            push_number(out, edited.blended(vertex, old), NumberPrecision::Single);
        }
        out.push(b'\n');
    }
}

/// One face to be written: its object and whether it has a material, by which faces are grouped; then its text.
struct EditedFace<'a> {
    order: (usize, usize, bool),
    state: FaceState<'a>,
    text: Vec<u8>,
}

#[derive(Default)]
struct EditedFaces<'a> {
    list: Vec<EditedFace<'a>>,
    bases: usize,
    written: WrittenLines,
}

/// What of lines and points an edit has taken.
#[derive(Default)]
struct LostElements {
    /// Lines of which less than two vertices are left.
    lines: usize,
    /// Vertices of other lines, and of points.
    vertices: usize,
}

/// Lines that follow each other, or points.
struct ElementChain<'e, 'a> {
    /// The first of them.
    element: &'e ObjElement<'a>,
    /// The vertices of all.
    vertices: Vec<u32>,
    /// How many there are.
    count: usize,
}

/// Lines and points, where lines one after the other that meet at a vertex which is gone are one line.
fn chained<'e, 'a>(elements: &'e [ObjElement<'a>], followed: &FollowedLines) -> Vec<ElementChain<'e, 'a>> {
    let mut chains: Vec<ElementChain<'e, 'a>> = Vec::new();
    for element in elements {
        let joint = element.vertices.first().filter(|v| followed.vertex(**v).is_none());
        match chains.last_mut() {
            Some(last)
                if joint.is_some()
                    && last.vertices.last() == joint
                    && [last.element.keyword, element.keyword] == [b'l'; 2]
                    && last.element.state == element.state =>
            {
                last.vertices.extend(&element.vertices[1..]);
                last.count += 1;
            }
            _ => chains.push(ElementChain {
                element,
                vertices: element.vertices.clone(),
                count: 1,
            }),
        }
    }
    chains
}

impl<'a> EditedFaces<'a> {
    /// Writes the coordinates and normals of a run, and takes note of its faces.
    fn add_run(
        &mut self,
        out: &mut Vec<u8>,
        run: &PrimitiveRun,
        parted: CornerAttributes<'a>,
        statements: &ObjStatements<'a>,
        faces: Option<&RunFaces>,
    ) {
        for texture in &parted.textures {
            out.extend_from_slice(b"vt ");
            match texture {
                TextureCoordinate::Old(text) if !has_no_number(text) => out.extend_from_slice(text),
                TextureCoordinate::Old(_) => out.extend_from_slice(b"0 0"),
                TextureCoordinate::New(numbers) => {
                    let finite = numbers.iter().map(|v| if v.is_finite() { *v } else { 0.0 });
                    push_numbers(out, &finite.collect::<Vec<f64>>());
                }
            }
            out.push(b'\n');
        }
        // Corners that turned alike share a line, as they did before.
        let mut lines: BTreeMap<[u32; 3], u64> = BTreeMap::new();
        let mut line_of = Vec::with_capacity(parted.normals.len());
        let first_normal = self.written.normals;
        for normal in &parted.normals {
            let bits = normal.value.to_array().map(f32::to_bits);
            let next = first_normal + lines.len() as u64 + 1;
            let line = *lines.entry(bits).or_insert(next);
            if line == next {
                match normal.old {
                    Some(text) => {
                        out.extend_from_slice(b"vn ");
                        out.extend_from_slice(text);
                        out.push(b'\n');
                    }
                    None => push_line(out, b"vn ", normal.value.as_dvec3(), NumberPrecision::Single, b"\n"),
                }
            }
            line_of.push(line);
        }
        let objects = object_numbers(&statements.states);
        RunFaces::each_or_triangles(faces, parted.triangles.len(), |corners| {
            let mut text = b"f".to_vec();
            for &corner in corners {
                let (i, k) = (corner as usize / 3, corner as usize % 3);
                let vertex = u64::from(parted.triangles[i][k]) + u64::from(run.first_vertex) + 1;
                let texture = parted.corner_textures[i].map(|t| self.written.textures + u64::from(t[k]) + 1);
                let normal = parted.corner_normals[i].map(|n| line_of[n[k] as usize]);
                push_corner(&mut text, vertex, texture, normal);
            }
            let state = parted.states[corners[0] as usize / 3];
            let object = objects.get(&state.object).copied().unwrap_or(0);
            self.list.push(EditedFace {
                order: (run.base as usize, object, state.material.is_some()),
                state,
                text,
            });
        });
        self.bases = self.bases.max(run.base as usize);
        self.written.textures += parted.textures.len() as u64;
        self.written.normals += lines.len() as u64;
    }

    /// Takes note of lines and points, and of what of them is gone.
    fn add_elements(
        &mut self,
        base: usize,
        statements: &ObjStatements<'a>,
        followed: &FollowedLines,
        lost: &mut LostElements,
    ) {
        let objects = object_numbers(&statements.states);
        for ElementChain {
            element,
            vertices,
            count,
        } in chained(&statements.elements, followed)
        {
            let (pieces, gone) = match element.keyword {
                b'l' => followed.line(&vertices),
                _ => {
                    let there: Vec<u32> = vertices.iter().filter_map(|v| followed.vertex(*v)).collect();
                    let gone = vertices.len() - there.len();
                    (if there.is_empty() { Vec::new() } else { vec![there] }, gone)
                }
            };
            match (element.keyword, pieces.is_empty()) {
                (b'l', true) => lost.lines += count,
                _ => lost.vertices += gone,
            }
            let state = element.state;
            for piece in pieces {
                let numbers: String = piece.iter().map(|v| format!(" {}", u64::from(*v) + 1)).collect();
                self.list.push(EditedFace {
                    order: (
                        base,
                        objects.get(&state.object).copied().unwrap_or(objects.len()),
                        state.material.is_some(),
                    ),
                    state,
                    text: [&[element.keyword], numbers.as_bytes()].concat(),
                });
            }
        }
    }

    fn write_faces(&mut self, out: &mut Vec<u8>) {
        // An object that is named twice would be two objects to many readers.
        self.list.sort_by_key(|face| face.order);
        let mut last = FaceState::default();
        let line = |out: &mut Vec<u8>, now: Option<&[u8]>, before: Option<&[u8]>, none: &[u8]| {
            if now != before {
                out.extend_from_slice(now.unwrap_or(none));
                if now.is_some() || !none.is_empty() {
                    out.push(b'\n');
                }
            }
        };
        for face in &self.list {
            let FaceState {
                object,
                group,
                smoothing,
                material,
            } = face.state;
            line(out, object, last.object, b"");
            line(out, group, last.group, b"g");
            line(out, smoothing, last.smoothing, b"s off");
            line(out, material, last.material, b"");
            last = face.state;
            out.extend_from_slice(&face.text);
            out.push(b'\n');
        }
    }
}

/// Texture coordinates, colours and the first material of runs, for formats that divide no vertices.
pub(super) fn run_attributes(edited: &EditedModel<'_>, runs: &[&PrimitiveRun]) -> Vec<RunAttributes> {
    let Some(first) = runs.first() else {
        return Vec::new();
    };
    let model = edited.base(first).model;
    let statements = read_statements(&model.files.main);
    let library = read_libraries(&model.files, &statements.libraries);
    let material_of = |line: &[u8]| material_named(&library, line);
    let one = |run: &&PrimitiveRun| RunAttributes {
        colours: colours_of(edited, run, &statements),
        material: statements.states.first().and_then(|s| s.material).map(&material_of),
        ..RunAttributes::default()
    };
    let coordinates = |run: &&PrimitiveRun| -> RunAttributes {
        let mut attributes = one(run);
        add_coordinates(edited, run, &statements, &mut attributes);
        attributes
    };
    runs.iter().map(coordinates).collect()
}

/// The colours of the vertices of a run; none where its base has none.
fn colours_of(edited: &EditedModel<'_>, run: &PrimitiveRun, statements: &ObjStatements<'_>) -> Vec<[f32; 4]> {
    let colour = |vertex: usize| {
        let mut colour = [0.0, 0.0, 0.0, 1.0];
        for (v, weight) in edited.blend(vertex).iter() {
            for (lane, sum) in colour.iter_mut().take(3).enumerate() {
                *sum += statements.more.get(v as usize * 3 + lane).copied().unwrap_or(0.0) * weight;
            }
        }
        colour.map(|c| (c as f32).clamp(0.0, 1.0))
    };
    match statements.more_lanes {
        3 => run.vertices().map(colour).collect(),
        _ => Vec::new(),
    }
}

/// The material that a `usemtl` line names, with what a library says of it.
fn material_named(library: &MaterialLibrary, line: &[u8]) -> Arc<NamedMaterial> {
    let name = name_in(line);
    let known = library.get(&name).cloned();
    known.unwrap_or_else(|| Arc::new(NamedMaterial::of_name(name)))
}

/// A run with its vertices parted where texture coordinates, normals or materials part, one part for each material. Vertices and triangles
/// keep their order; copies of vertices follow. A run of one material has all of its vertices, those that no triangle uses too.
pub(super) fn seam_parts(edited: &EditedModel<'_>, run: &PrimitiveRun, positions: &[DVec3]) -> Vec<RunPart> {
    let model = edited.base(run).model;
    let statements = read_statements(&model.files.main);
    let parted = divide_corners(edited, run, positions, &statements);
    let library = read_libraries(&model.files, &statements.libraries);
    let mut of_material: BTreeMap<Option<&[u8]>, Vec<u32>> = BTreeMap::new();
    for (state, i) in parted.states.iter().zip(0..) {
        of_material.entry(state.material).or_default().push(i);
    }
    // In the order in which the text first uses them.
    let mut groups: Vec<_> = of_material.into_iter().collect();
    groups.sort_by_key(|(_, triangles)| triangles.first().copied());
    let uv: Vec<[f32; 2]> = parted.textures.iter().map(pair_of).collect();
    let colours = colours_of(edited, run, &statements);
    let is_whole = groups.len() == 1;
    let one = |(material, triangles): (Option<&[u8]>, Vec<u32>)| {
        let vertices = if is_whole {
            (0..run.vertex_count).collect()
        } else {
            let corners = triangles.iter().flat_map(|&t| parted.triangles[t as usize]);
            let mut used: Vec<u32> = corners.collect();
            used.sort_unstable();
            used.dedup();
            used
        };
        let mut part = seam_part(&parted, &uv, vertices, triangles);
        part.attributes.material = material.map(|line| material_named(&library, line));
        let own = part.copy_of.iter().filter_map(|v| colours.get(*v as usize).copied());
        part.attributes.colours = own.collect();
        part
    };
    groups.into_iter().map(one).collect()
}

/// A texture coordinate, counted from the upper left corner of the picture.
fn pair_of(texture: &TextureCoordinate<'_>) -> [f32; 2] {
    let numbers = texture.numbers();
    let at = |i: usize| numbers.get(i).map_or(0.0, |v| *v as f32);
    [at(0), 1.0 - at(1)]
}

/// The part of a run that has these triangles; `vertices` are those that it uses, in rising order. Texture coordinates are compared by
/// value; normals by their line, since two lines of one value may part as the shape changes.
fn seam_part(parted: &CornerAttributes<'_>, all_uv: &[[f32; 2]], vertices: Vec<u32>, triangles: Vec<u32>) -> RunPart {
    let with_uv = triangles.iter().any(|&t| parted.corner_textures[t as usize].is_some());
    let with_normals = triangles.iter().any(|&t| parted.corner_normals[t as usize].is_some());
    let first = vertices.len();
    // What the first corner at each vertex has; other corners get copies.
    let mut taken: Vec<Option<([u32; 2], u32)>> = vec![None; first];
    let mut copies: BTreeMap<(u32, [u32; 2], u32), u32> = BTreeMap::new();
    let mut part = RunPart {
        copy_of: vertices,
        ..RunPart::default()
    };
    if with_uv {
        part.attributes.uv.resize(first, [0.0; 2]);
    }
    if with_normals {
        part.normals.resize(first, Vec3::ZERO);
    }
    for &t in &triangles {
        let t = t as usize;
        let triangle: [u32; 3] = std::array::from_fn(|k| {
            let vertex = parted.triangles[t][k];
            let own = part.copy_of[..first].binary_search(&vertex).unwrap_or_default() as u32;
            let uv = parted.corner_textures[t].and_then(|c| all_uv.get(c[k] as usize).copied());
            let uv = uv.unwrap_or_default();
            let shade = parted.corner_normals[t].map_or(u32::MAX, |c| c[k]);
            let normal = parted.normals.get(shade as usize).map(|n| n.value).unwrap_or_default();
            let here = (uv.map(f32::to_bits), shade);
            let known = taken[own as usize].get_or_insert_with(|| {
                if let Some(place) = part.attributes.uv.get_mut(own as usize) {
                    *place = uv;
                }
                if let Some(place) = part.normals.get_mut(own as usize) {
                    *place = normal;
                }
                here
            });
            if *known == here {
                return own;
            }
            *copies.entry((own, here.0, here.1)).or_insert_with(|| {
                part.copy_of.push(vertex);
                if with_uv {
                    part.attributes.uv.push(uv);
                }
                if with_normals {
                    part.normals.push(normal);
                }
                part.copy_of.len() as u32 - 1
            })
        });
        part.triangles.push(triangle);
    }
    part.source_triangles = triangles;
    part
}

/// The numbers after the coordinates of vertices; and of each corner its texture coordinates, its normal where vertices have
/// none of their own, and the statements that hold for its face.
pub(super) fn distinguish_vertices(model: &Model, keys: &mut AttributeKeys<'_>) {
    let geometry = &model.geometry;
    let read = read_statements(&model.files.main);
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

/// Adds the texture coordinates of a run, counted from the upper left corner of the picture: one for each vertex, or one for
/// each corner of a triangle where corners of a vertex differ. `statements` are those of its base.
fn add_coordinates(
    edited: &EditedModel<'_>,
    run: &PrimitiveRun,
    statements: &ObjStatements<'_>,
    attributes: &mut RunAttributes,
) {
    let old = &edited.base(run).model.geometry.triangles;
    let seam = &statements.corner_textures;
    if seam.len() != 3 * old.len() || seam.iter().all(|&line| line == NO_TEXTURE) {
        return;
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
    match by_vertex(edited, run, &corners) {
        Some(uv) => attributes.uv = uv,
        None => attributes.corner_uv = corners,
    }
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
