//! OBJ out after edits of the topology, and what an edited OBJ gives to other formats.

use super::parted::{Parted, Texture, part};
use super::statements::{State, Statements, name_in, object_numbers, read};
use super::write::push_line;
use crate::asset::model::Source;
use crate::asset::plain::{self, Extras, Seamed};
use crate::asset::remade::{Remade, Run};
use crate::asset::text::{Precision, push_number};
use crate::asset::{Error, Format};
use glam::DVec3;
use std::collections::BTreeMap;
use std::io::Write as _;

/// The statements of each base that is an OBJ.
fn all_statements<'a>(remade: &Remade<'a>) -> Vec<Option<Statements<'a>>> {
    let one = |base: &crate::asset::remade::Base<'a>| {
        let model = base.model;
        matches!(model.source, Source::Obj(_)).then(|| read(&model.files.main, &model.geometry.positions))
    };
    remade.bases.iter().map(one).collect()
}

/// A text of the edited model. Vertices are in the order of the recipes; faces are triangles, in order within each
/// object. Other bases follow with their texture coordinates, normals and material names.
pub(in crate::asset) fn write_remade(remade: &Remade<'_>, positions: &[DVec3]) -> Result<Vec<u8>, Error> {
    let all = all_statements(remade);
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
    for run in remade.runs {
        vertices(
            &mut out,
            remade,
            run,
            positions,
            all.get(run.base as usize).and_then(Option::as_ref),
        );
    }
    let mut faces = Faces::default();
    for run in remade.runs.iter().filter(|r| r.triangle_count > 0) {
        if let Some(Some(statements)) = all.get(run.base as usize) {
            faces.add(&mut out, run, part(remade, run, positions, statements), statements);
        }
    }
    faces.write(&mut out);
    for base in (0..remade.bases.len()).filter(|&b| all[b].is_none()) {
        foreign(&mut out, remade, base, positions, &mut faces)?;
    }
    Ok(out)
}

/// `v` lines, with the numbers after the coordinates blended.
fn vertices(out: &mut Vec<u8>, remade: &Remade<'_>, run: &Run, positions: &[DVec3], of: Option<&Statements<'_>>) {
    let lanes = of.map_or(0, |s| s.more_lanes);
    for vertex in run.vertices() {
        push_line(out, b"v ", positions[vertex], Precision::Double, b"");
        for lane in 0..lanes {
            let old = |v: u32| {
                of.and_then(|s| s.more.get(v as usize * lanes + lane))
                    .copied()
                    .unwrap_or(0.0)
            };
            let value: f64 = remade.recipe(vertex).iter().map(|(v, weight)| old(v) * weight).sum();
            out.push(b' ');
            push_number(out, value, Precision::Single);
        }
        out.push(b'\n');
    }
}

/// One face to be written: its object and whether it has a material, by which faces are grouped; then its text.
struct Face<'a> {
    order: (usize, usize, bool),
    state: State<'a>,
    text: String,
}

#[derive(Default)]
struct Faces<'a> {
    list: Vec<Face<'a>>,
    bases: usize,
    /// `vt` and `vn` lines written so far.
    textures: u64,
    normals: u64,
}

impl<'a> Faces<'a> {
    /// Writes the coordinates and normals of a run, and takes note of its faces.
    fn add(&mut self, out: &mut Vec<u8>, run: &Run, parted: Parted<'a>, statements: &Statements<'a>) {
        for texture in &parted.textures {
            out.extend_from_slice(b"vt ");
            match texture {
                Texture::Old(text) => out.extend_from_slice(text),
                Texture::New(numbers) => push_numbers(out, numbers),
            }
            out.push(b'\n');
        }
        // Corners that turned alike share a line, as they did before.
        let mut lines: BTreeMap<[u32; 3], u64> = BTreeMap::new();
        let mut line_of = Vec::with_capacity(parted.normals.len());
        let first_normal = self.normals;
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
                    None => push_line(out, b"vn ", normal.value.as_dvec3(), Precision::Single, b"\n"),
                }
            }
            line_of.push(line);
        }
        let objects = object_numbers(&statements.states);
        for (i, triangle) in parted.triangles.iter().enumerate() {
            let mut text = String::from("f");
            for k in 0..3 {
                let vertex = u64::from(triangle[k]) + u64::from(run.first_vertex) + 1;
                let texture = parted.corner_textures[i].map(|t| self.textures + u64::from(t[k]) + 1);
                let normal = parted.corner_normals[i].map(|n| line_of[n[k] as usize]);
                text += &corner(vertex, texture, normal);
            }
            let state = parted.states[i];
            let object = objects.get(&state.object).copied().unwrap_or(0);
            self.list.push(Face {
                order: (run.base as usize, object, state.material.is_some()),
                state,
                text,
            });
        }
        self.bases = self.bases.max(run.base as usize);
        self.textures += parted.textures.len() as u64;
        self.normals += lines.len() as u64;
    }

    fn write(&mut self, out: &mut Vec<u8>) {
        // An object that is named twice would be two objects to many readers.
        self.list.sort_by_key(|face| face.order);
        let mut last = State::default();
        let line = |out: &mut Vec<u8>, now: Option<&[u8]>, before: Option<&[u8]>, none: &[u8]| {
            if now != before {
                out.extend_from_slice(now.unwrap_or(none));
                if now.is_some() || !none.is_empty() {
                    out.push(b'\n');
                }
            }
        };
        for face in &self.list {
            let State {
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
            out.extend_from_slice(face.text.as_bytes());
            out.push(b'\n');
        }
    }
}

fn corner(vertex: u64, texture: Option<u64>, normal: Option<u64>) -> String {
    match (texture, normal) {
        (None, None) => format!(" {vertex}"),
        (Some(texture), None) => format!(" {vertex}/{texture}"),
        (None, Some(normal)) => format!(" {vertex}//{normal}"),
        (Some(texture), Some(normal)) => format!(" {vertex}/{texture}/{normal}"),
    }
}

fn push_numbers(out: &mut Vec<u8>, numbers: &[f64]) {
    for (i, &value) in numbers.iter().enumerate() {
        if i > 0 {
            out.push(b' ');
        }
        push_number(out, value, Precision::Single);
    }
}

/// A base of another format: its vertices stand already.
fn foreign(
    out: &mut Vec<u8>,
    remade: &Remade<'_>,
    base: usize,
    positions: &[DVec3],
    faces: &mut Faces<'_>,
) -> Result<(), Error> {
    let plain = plain::of_base(remade, base, positions, Format::Obj)?;
    let runs = remade
        .runs
        .iter()
        .filter(|r| r.base as usize == base && r.triangle_count > 0);
    let mut triangles = plain.geometry.triangles_of_primitives();
    for (run, part) in runs.zip(&plain.parts) {
        let Some((primitive, triangles)) = triangles.next() else {
            break;
        };
        let range = primitive.first_vertex as usize..primitive.first_vertex as usize + primitive.vertex_count as usize;
        if part.has_uv {
            for [u, v] in &plain.uv[range.clone()] {
                out.extend_from_slice(b"vt ");
                push_numbers(out, &[f64::from(*u), 1.0 - f64::from(*v)]);
                out.push(b'\n');
            }
        }
        if primitive.has_normals {
            for normal in &plain.geometry.normals[range.clone()] {
                push_line(out, b"vn ", normal.as_dvec3(), Precision::Single, b"\n");
            }
        }
        let mut name = super::write::printable(&primitive.name);
        if name.is_empty() {
            name = format!("merged{base}");
        }
        out.extend(format!("o {name}\n").bytes());
        if let Some(material) = &part.material {
            out.extend(format!("usemtl {}\n", super::write::printable(material)).bytes());
        }
        for triangle in triangles {
            out.push(b'f');
            for &v in triangle {
                let local = u64::from(v - primitive.first_vertex) + 1;
                let texture = part.has_uv.then_some(faces.textures + local);
                let normal = primitive.has_normals.then_some(faces.normals + local);
                let text = corner(local + u64::from(run.first_vertex), texture, normal);
                let result = out.write_all(text.as_bytes());
                debug_assert!(result.is_ok(), "writing to memory does not fail");
            }
            out.push(b'\n');
        }
        faces.textures += if part.has_uv { range.len() as u64 } else { 0 };
        faces.normals += if primitive.has_normals { range.len() as u64 } else { 0 };
    }
    Ok(())
}

/// Colours and the first material of runs, for formats that know no corners.
pub(in crate::asset) fn extras(remade: &Remade<'_>, runs: &[&Run]) -> Result<Vec<Extras>, Error> {
    let Some(first) = runs.first() else {
        return Ok(Vec::new());
    };
    let model = remade.base(first).model;
    let statements = read(&model.files.main, &model.geometry.positions);
    let lanes = statements.more_lanes;
    let colour = |vertex: usize| {
        let mut colour = [0.0, 0.0, 0.0, 1.0];
        for (v, weight) in remade.recipe(vertex).iter() {
            for lane in 0..3 {
                let old = statements.more.get(v as usize * lanes + lane).copied().unwrap_or(0.0);
                colour[lane] += old * weight;
            }
        }
        colour.map(|c| (c as f32).clamp(0.0, 1.0))
    };
    let one = |run: &&Run| Extras {
        uv: Vec::new(),
        colours: if lanes == 3 {
            run.vertices().map(colour).collect()
        } else {
            Vec::new()
        },
        material: statements.states.first().and_then(|s| s.material).map(name_in),
    };
    Ok(runs.iter().map(one).collect())
}

/// A run with its vertices parted where texture coordinates, normals or materials part, one for each material.
pub(in crate::asset) fn seamed(remade: &Remade<'_>, run: &Run, positions: &[DVec3]) -> Result<Vec<Seamed>, Error> {
    let model = remade.base(run).model;
    let statements = read(&model.files.main, &model.geometry.positions);
    let parted = part(remade, run, positions, &statements);
    let mut of_material: BTreeMap<Option<&[u8]>, Vec<usize>> = BTreeMap::new();
    for (i, state) in parted.states.iter().enumerate() {
        of_material.entry(state.material).or_default().push(i);
    }
    // In the order in which the text first uses them.
    let mut groups: Vec<_> = of_material.into_iter().collect();
    groups.sort_by_key(|(_, triangles)| triangles.first().copied());
    let one = |(material, triangles): (Option<&[u8]>, Vec<usize>)| {
        let with_uv = triangles.iter().any(|&t| parted.corner_textures[t].is_some());
        let with_normals = triangles.iter().any(|&t| parted.corner_normals[t].is_some());
        let mut seamed = Seamed {
            material: material.map(name_in),
            ..Seamed::default()
        };
        let mut known: BTreeMap<(u32, u32, u32), u32> = BTreeMap::new();
        for t in triangles {
            let corner = |k: usize| {
                let texture = parted.corner_textures[t].map_or(u32::MAX, |c| c[k]);
                let normal = parted.corner_normals[t].map_or(u32::MAX, |c| c[k]);
                (parted.triangles[t][k], texture, normal)
            };
            let triangle = [0, 1, 2].map(|k| {
                let here = corner(k);
                *known.entry(here).or_insert_with(|| {
                    let (vertex, texture, normal) = here;
                    seamed.copy_of.push(vertex);
                    if with_uv {
                        let numbers = parted
                            .textures
                            .get(texture as usize)
                            .map(Texture::numbers)
                            .unwrap_or_default();
                        let at = |i: usize| numbers.get(i).map_or(0.0, |v| *v as f32);
                        seamed.uv.push([at(0), 1.0 - at(1)]);
                    }
                    if with_normals {
                        let value = parted.normals.get(normal as usize).map(|n| n.value);
                        seamed.normals.push(value.unwrap_or_default());
                    }
                    seamed.copy_of.len() as u32 - 1
                })
            });
            seamed.triangles.push(triangle);
        }
        seamed
    };
    Ok(groups.into_iter().map(one).collect())
}
