//! Stanford PLY, text and binary: reading, editing in place, and building.
//!
//! Needed of a file are the numbers x, y and z of element `vertex`, and `vertex_indices` (or `vertex_index`) of element
//! `face` or `tristrips`. Whatever else it holds is stepped over and survives.

pub(super) mod body;
mod edges;
mod edited;
mod read;
#[cfg(test)]
mod tests;

pub(super) use read::FORMAT;

use super::text::TextPatch;
use crate::codec::{EditedOutput, FormatCodec, PatchedOutput, ReadFile};
use crate::edited::{EditedModel, FaceOutlines, PrimitiveRun};
use crate::files::ReadWatch;
use crate::neutral::{HeldLooks, NeutralModel, RunAttributes};
use crate::vertex_attributes::AttributeKeys;
use crate::{Error, FileSet, Format, Geometry, Model, WrittenFiles};
use body::{PlyBody, PlyEncoding, PlyScalar, push};
use glam::DVec3;
use pliant_mesh::shading;
use read::{PlyNotes, VertexRole, stored_types};
use std::io::Write as _;
use std::sync::Arc;

/// Reads and writes PLY.
pub(super) struct PlyCodec;

impl FormatCodec for PlyCodec {
    fn patches_files_of(&self, format: Format) -> bool {
        format == FORMAT
    }

    fn read(&self, files: &FileSet, _: Format, watch: &ReadWatch<'_>) -> Result<ReadFile, Error> {
        read::read(&files.main, watch).map(|(geometry, notes)| (geometry, Arc::new(notes) as _))
    }

    fn patch_positions(&self, output: &PatchedOutput<'_>) -> Result<WrittenFiles, Error> {
        let model = output.model;
        let notes = model.notes_or_refuse(output.format)?;
        patch(&model.files.main, notes, &model.geometry, output.positions).map(WrittenFiles::single)
    }

    fn build(&self, neutral: &NeutralModel, _: Format) -> Result<WrittenFiles, Error> {
        Ok(WrittenFiles::single(build(neutral)))
    }

    fn held_looks(&self) -> HeldLooks {
        HeldLooks {
            materials: false,
            ..HeldLooks::ALL
        }
    }

    fn write_edited(&self, output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
        edited::write_edited(output)
    }

    fn beyond_conversion(&self, model: &Model, _: bool) -> Result<Vec<String>, Error> {
        Ok(model.notes_or_refuse::<PlyNotes>(FORMAT)?.beyond.clone())
    }

    fn face_outlines<'a>(&self, model: &'a Model) -> Option<&'a FaceOutlines> {
        model.notes::<read::PlyNotes>().map(|notes| &notes.outlines)
    }

    fn segments(&self, model: &Model) -> Result<Vec<[u32; 2]>, Error> {
        edges::segments(model)
    }

    fn run_attributes(&self, edited: &EditedModel<'_>, runs: &[&PrimitiveRun]) -> Result<Vec<RunAttributes>, Error> {
        edited::run_attributes(edited, runs)
    }

    fn distinguish_vertices(&self, model: &Model, keys: &mut AttributeKeys<'_>) -> Result<(), Error> {
        edited::distinguish_vertices(model, keys)
    }
}

/// The uploaded file with the vertices at `positions`. Coordinates become doubles where they must.
fn patch(bytes: &[u8], notes: &PlyNotes, rest: &Geometry, positions: &[DVec3]) -> Result<Vec<u8>, Error> {
    let properties = &notes.vertex.properties;
    let stored = stored_types(notes, positions)?;
    let triangles = &rest.triangles;
    let gradients = notes
        .normal
        .map(|_| shading::gradients_of_all(&rest.positions, positions, triangles, 0..positions.len()));
    let mut patch = TextPatch::new(bytes);
    for (property, &scalar) in properties.iter().zip(&stored) {
        if property.scalar != scalar {
            patch.replace(property.type_place.clone()).extend_from_slice(b"double");
        }
    }
    let mut body = PlyBody::starting_at(bytes, notes.encoding, notes.vertices_at.0, notes.vertices_at.1);
    for (i, (&old, &new)) in rest.positions.iter().zip(positions).enumerate() {
        let gradient = gradients.as_ref().and_then(|g| g[i].as_ref());
        let normal = gradient.map(|g| shading::carry_normal(g, rest.normals[i]));
        for (j, (property, &scalar)) in properties.iter().zip(&stored).enumerate() {
            let (old, new) = match (notes.role(j), normal) {
                (Some(VertexRole::Position(axis)), _) => (old[axis], new[axis]),
                (Some(VertexRole::Normal(axis)), Some(normal)) => {
                    (f64::from(rest.normals[i][axis]), f64::from(normal[axis]))
                }
                _ => {
                    body.skip_property(property)?;
                    continue;
                }
            };
            let place = body.skip_number(property.scalar)?;
            let same = match scalar {
                PlyScalar::F32 => (old as f32).to_bits() == (new as f32).to_bits(),
                _ => old.to_bits() == new.to_bits(),
            };
            let retyped = property.scalar != scalar && notes.encoding != PlyEncoding::Ascii;
            if !same || retyped {
                push(patch.replace(place), new, scalar, notes.encoding);
            }
        }
    }
    Ok(patch.finish())
}

/// A fresh binary file with double coordinates, polygons as they were, normals where every vertex has one, and colours and texture coordinates
/// where any has some.
fn build(neutral: &NeutralModel) -> Vec<u8> {
    let NeutralModel {
        geometry, uv, colours, ..
    } = neutral;
    let with_normals = geometry.all_have_normals();
    let mut out = b"ply\nformat binary_little_endian 1.0\ncomment pliant\n".to_vec();
    let floats = |names: &[&str]| {
        names
            .iter()
            .map(|n| format!("property float {n}\n"))
            .collect::<String>()
    };
    let normals = if with_normals {
        floats(&["nx", "ny", "nz"])
    } else {
        String::new()
    };
    let coordinates = if uv.is_empty() {
        String::new()
    } else {
        floats(&["s", "t"])
    };
    let bytes = if colours.is_empty() {
        ""
    } else {
        "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n"
    };
    let mut most_corners = 3;
    for own in neutral.primitives() {
        own.each_face(|corners| most_corners = most_corners.max(corners.len()));
    }
    let with_corners = !neutral.corner_uv.is_empty();
    let is_small = most_corners * if with_corners { 2 } else { 1 } <= usize::from(u8::MAX);
    let count_type = if is_small { "uchar" } else { "uint" };
    let corners = if with_corners {
        format!("property list {count_type} float texcoord\n")
    } else {
        String::new()
    };
    let result = write!(
        out,
        "element vertex {}\nproperty double x\nproperty double y\nproperty double z\n{normals}{coordinates}{bytes}\
         element face {}\nproperty list {count_type} uint vertex_indices\n{corners}end_header\n",
        geometry.positions.len(),
        neutral.primitives().map(|own| own.face_count()).sum::<usize>()
    );
    debug_assert!(result.is_ok(), "writing to memory does not fail");
    for (i, position) in geometry.positions.iter().enumerate() {
        out.extend(position.to_array().into_iter().flat_map(f64::to_le_bytes));
        if with_normals {
            out.extend(geometry.normals[i].to_array().into_iter().flat_map(f32::to_le_bytes));
        }
        if let Some([u, v]) = uv.get(i) {
            out.extend([*u, 1.0 - v].into_iter().flat_map(f32::to_le_bytes));
        }
        if let Some(colour) = colours.get(i) {
            out.extend(colour.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8));
        }
    }
    for own in neutral.primitives() {
        own.each_face(|corners| {
            let count = |out: &mut Vec<u8>, number: usize| {
                let bytes = (number as u32).to_le_bytes();
                out.extend_from_slice(if is_small { &bytes[..1] } else { &bytes });
            };
            count(&mut out, corners.len());
            out.extend(corners.iter().flat_map(|&c| own.vertex_at(c).to_le_bytes()));
            if with_corners {
                count(&mut out, 2 * corners.len());
                let at = |c: &u32| neutral.uv_at(&own, *c).map_or([0.0; 2], |[u, v]| [u, 1.0 - v]);
                out.extend(corners.iter().flat_map(at).flat_map(f32::to_le_bytes));
            }
        });
    }
    out
}
