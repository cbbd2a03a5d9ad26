//! Object File Format (OFF) with its optional colours, normals and texture coordinates.
//!
//! Each vertex and each face begins a line of its own; what follows the numbers that the mesh needs (colours, texture
//! coordinates) is kept unread.

mod edited;
mod read;
#[cfg(test)]
mod tests;

pub(super) use read::FORMAT;

use crate::asset::codec::{EditedOutput, FormatCodec, ReadFile, patch_text_file, share_notes};
use crate::asset::edited::{EditedModel, FaceOutlines, PrimitiveRun};
use crate::asset::files::ReadWatch;
use crate::asset::neutral::{NeutralModel, RunAttributes};
use crate::asset::vertex_attributes::AttributeKeys;
use crate::asset::{Error, FileSet, Format, Model, ShapeFollowers, WrittenFiles};
use glam::DVec3;

/// Reads and writes OFF.
pub(super) struct OffCodec;

impl FormatCodec for OffCodec {
    fn patches_files_of(&self, format: Format) -> bool {
        format == FORMAT
    }

    fn read(&self, files: &FileSet, _: Format, watch: &ReadWatch<'_>) -> Result<ReadFile, Error> {
        read::read(&files.main, watch).map(share_notes)
    }

    fn patch_positions(
        &self,
        model: &Model,
        positions: &[DVec3],
        format: Format,
        _: &ShapeFollowers<'_>,
    ) -> Result<WrittenFiles, Error> {
        patch_text_file(model, positions, format, read::patch)
    }

    fn build(&self, neutral: &NeutralModel, _: Format) -> Result<WrittenFiles, Error> {
        Ok(WrittenFiles::single(read::build(neutral)))
    }

    fn write_edited(&self, output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
        edited::write_edited(output).map(WrittenFiles::single)
    }

    fn face_outlines<'a>(&self, model: &'a Model) -> Option<&'a FaceOutlines> {
        model.notes::<read::OffNotes>().map(|notes| &notes.outlines)
    }

    fn run_attributes(&self, edited: &EditedModel<'_>, runs: &[&PrimitiveRun]) -> Result<Vec<RunAttributes>, Error> {
        edited::run_attributes(edited, runs)
    }

    fn tell_apart(&self, model: &Model, keys: &mut AttributeKeys<'_>) -> Result<(), Error> {
        edited::tell_apart(model, keys)
    }
}
