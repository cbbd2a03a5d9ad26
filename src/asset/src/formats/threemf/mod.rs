//! 3D Manufacturing Format (3MF): what printers are given, a package of XML.
//!
//! A shape that changes alone is patched: numbers of vertices that moved are rewritten in their part, every other part of the package is
//! copied as it is packed. After an edit, and where one mesh is used at several places that moved apart, objects are written again, one for
//! each use, and everything else of the model part stays as written.
//!
//! [`package`] reads and writes archives, [`part`] the XML of a part, [`scene`] follows what is built, [`looks`] has materials and colours,
//! [`patch`] and [`write`] write models of this format, [`build`] others.

mod build;
mod identities;
mod looks;
mod model_text;
mod package;
mod part;
mod patch;
mod scene;
#[cfg(test)]
mod tests;
mod words;
mod write;

pub(super) use package::FORMAT;

use crate::codec::{EditedOutput, FormatCodec, PatchedOutput, ReadFile};
use crate::edited::{EditedModel, PrimitiveRun};
use crate::files::{ReadWatch, counted};
use crate::neutral::{NeutralModel, RunPart};
use crate::vertex_attributes::{AttributeKeys, hash_numbers};
use crate::{Error, FileSet, Format, Model, WrittenFiles};
use glam::DVec3;
use looks::UseProperties;
use scene::PrintNotes;
use std::sync::Arc;

/// Reads and writes 3MF.
pub(super) struct ThreeMfCodec;

impl FormatCodec for ThreeMfCodec {
    fn patches_files_of(&self, format: Format) -> bool {
        format == FORMAT
    }

    fn read(&self, files: &FileSet, _: Format, watch: &ReadWatch<'_>) -> Result<ReadFile, Error> {
        scene::read(files, watch).map(|(geometry, notes)| (geometry, Arc::new(notes) as _))
    }

    fn patch_positions(&self, output: &PatchedOutput<'_>) -> Result<WrittenFiles, Error> {
        patch::patch(output.model, output.positions)
    }

    fn build(&self, neutral: &NeutralModel, _: Format) -> Result<WrittenFiles, Error> {
        build::build(neutral)
    }

    fn write_edited(&self, output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
        write::write_edited(output)
    }

    fn beyond_conversion(&self, model: &Model, _: bool) -> Result<Vec<String>, Error> {
        let notes: &PrintNotes = model.notes_or_refuse(FORMAT)?;
        let parts = &notes.scene.parts;
        let meshes = parts.iter().flat_map(|part| part.objects.values());
        let painted = meshes
            .filter_map(|object| object.mesh.as_ref())
            .map(|mesh| mesh.painted)
            .sum();
        let metadata = parts.iter().map(|part| part.metadata.len()).sum();
        let counts = [
            counted(metadata, "entry of metadata", "entries of metadata"),
            counted(
                painted,
                "triangle with paint of a slicer",
                "triangles with paint of a slicer",
            ),
        ];
        let foreign = parts
            .iter()
            .flat_map(|part| &part.foreign)
            .map(|name| format!("`{name}`"));
        Ok(counts.into_iter().flatten().chain(foreign).collect())
    }

    fn unit_of(&self, model: &Model) -> Option<(String, f64)> {
        let notes: &PrintNotes = model.notes()?;
        let unit = notes.scene.parts.first()?.unit.as_str();
        let metres = match unit {
            "micron" => 1e-6,
            "millimeter" => 1e-3,
            "centimeter" => 1e-2,
            "inch" => 0.0254,
            "foot" => 0.3048,
            _ => 1.0,
        };
        Some((unit.to_owned(), metres))
    }

    fn divides_by_look(&self) -> bool {
        true
    }

    fn divides_at_seams(&self) -> bool {
        true
    }

    fn seam_parts(
        &self,
        edited: &EditedModel<'_>,
        run: &PrimitiveRun,
        _: &[DVec3],
    ) -> Result<Option<Vec<RunPart>>, Error> {
        Ok(looks::seam_parts(edited, run))
    }

    fn distinguish_vertices(&self, model: &Model, keys: &mut AttributeKeys<'_>) -> Result<(), Error> {
        let notes: &PrintNotes = model.notes_or_refuse(FORMAT)?;
        let mut triangle = 0;
        for primitive in 0..model.geometry.primitives.len() as u32 {
            let Some(properties) = UseProperties::new(notes, model, primitive) else {
                continue;
            };
            let count = model.geometry.primitives[primitive as usize].index_count / 3;
            for t in triangle..triangle + count {
                let Some((_, group, places)) = properties.of_triangle(t) else {
                    continue;
                };
                for (vertex, place) in model.geometry.triangles[t as usize].into_iter().zip(places) {
                    keys.add_of_corner(vertex, hash_numbers(&[f64::from(group), f64::from(place)]));
                }
            }
            triangle += count;
        }
        Ok(())
    }
}
