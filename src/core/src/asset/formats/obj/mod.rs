//! Wavefront OBJ: reading, editing in place, and building.
//!
//! A render vertex is a `v` line, in file order, whether a face uses it or not. Lines that the mesh does not need
//! (materials, groups, curves, whatever is unknown) are never interpreted, so they survive untouched.

mod edited;
mod library;
mod parted;
mod read;
mod statements;
#[cfg(test)]
mod tests;
mod write;

pub(super) use read::FORMAT;

use crate::asset::codec::{EditedOutput, FormatCodec, ReadFile, patch_text_file, share_notes};
use crate::asset::edited::{EditedModel, FaceOutlines, PrimitiveRun};
use crate::asset::files::ReadWatch;
use crate::asset::neutral::{NeutralModel, RunAttributes, SeamPart};
use crate::asset::vertex_attributes::AttributeKeys;
use crate::asset::{Error, FileSet, Format, Model, ShapeFollowers, WrittenFiles};
use glam::DVec3;

/// Reads and writes OBJ.
pub(super) struct ObjCodec;

impl FormatCodec for ObjCodec {
    fn patches_files_of(&self, format: Format) -> bool {
        format == FORMAT
    }

    fn read(&self, files: &FileSet, _: Format, watch: &ReadWatch<'_>) -> Result<ReadFile, Error> {
        let (mut geometry, notes) = read::read(&files.main, watch)?;
        library::warn_of_missing(files, &mut geometry);
        Ok(share_notes((geometry, notes)))
    }

    fn companion_names(&self, files: &FileSet, _: Format) -> Vec<String> {
        library::companion_names(files)
    }

    fn patch_positions(
        &self,
        model: &Model,
        positions: &[DVec3],
        format: Format,
        _: &ShapeFollowers<'_>,
    ) -> Result<WrittenFiles, Error> {
        patch_text_file(model, positions, format, write::patch)
    }

    fn build(&self, neutral: &NeutralModel, _: Format) -> Result<WrittenFiles, Error> {
        Ok(write::build(neutral))
    }

    fn write_edited(&self, output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
        edited::write_edited(output)
    }

    fn face_outlines<'a>(&self, model: &'a Model) -> Option<&'a FaceOutlines> {
        model.notes::<read::ObjNotes>().map(|notes| &notes.outlines)
    }

    fn run_attributes(&self, edited: &EditedModel<'_>, runs: &[&PrimitiveRun]) -> Result<Vec<RunAttributes>, Error> {
        Ok(edited::run_attributes(edited, runs))
    }

    fn seam_parts(
        &self,
        edited: &EditedModel<'_>,
        run: &PrimitiveRun,
        positions: &[DVec3],
    ) -> Result<Option<Vec<SeamPart>>, Error> {
        Ok(Some(edited::seam_parts(edited, run, positions)))
    }

    fn tell_apart(&self, model: &Model, keys: &mut AttributeKeys<'_>) -> Result<(), Error> {
        edited::tell_apart(model, keys);
        Ok(())
    }
}
