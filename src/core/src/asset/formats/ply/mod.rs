//! Stanford PLY, text and binary: reading, editing in place, and building.
//!
//! Needed of a file are the numbers x, y and z of element `vertex`, and `vertex_indices` (or `vertex_index`) of element
//! `face` or `tristrips`. Whatever else it holds is stepped over and survives.

mod body;
mod edited;
mod read;
mod table;
#[cfg(test)]
mod tests;
mod write;

pub(super) use read::FORMAT;

use crate::asset::codec::{EditedOutput, FormatCodec, ReadFile, share_notes};
use crate::asset::edited::{EditedModel, FaceOutlines, PrimitiveRun};
use crate::asset::files::ReadWatch;
use crate::asset::neutral::{NeutralModel, RunAttributes};
use crate::asset::vertex_attributes::AttributeKeys;
use crate::asset::{Error, FileSet, Format, Model, ShapeFollowers, WrittenFiles};
use glam::DVec3;

/// Reads and writes PLY.
pub(super) struct PlyCodec;

impl FormatCodec for PlyCodec {
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
        let notes = model.notes_or_refuse(format)?;
        write::patch(&model.files.main, notes, &model.geometry, positions).map(WrittenFiles::single)
    }

    fn build(&self, neutral: &NeutralModel, _: Format) -> Result<WrittenFiles, Error> {
        Ok(WrittenFiles::single(write::build(neutral)))
    }

    fn write_edited(&self, output: &EditedOutput<'_>) -> Result<WrittenFiles, Error> {
        edited::write_edited(output).map(WrittenFiles::single)
    }

    fn face_outlines<'a>(&self, model: &'a Model) -> Option<&'a FaceOutlines> {
        model.notes::<read::PlyNotes>().map(|notes| &notes.outlines)
    }

    fn run_attributes(&self, edited: &EditedModel<'_>, runs: &[&PrimitiveRun]) -> Result<Vec<RunAttributes>, Error> {
        edited::run_attributes(edited, runs)
    }

    fn tell_apart(&self, model: &Model, keys: &mut AttributeKeys<'_>) -> Result<(), Error> {
        edited::tell_apart(model, keys)
    }
}
