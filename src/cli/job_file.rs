//! Job files from disk, with the models that they name.

use super::failure::CliFailure;
use super::input_files::{AllowedFolders, LARGEST, NamedFiles, folder_of, read_file};
use super::model_files::in_file;
use crate::asset::Format;
use crate::session::SessionConfig;
use crate::wire::{self, pb};
use bytes::Bytes;
use std::collections::BTreeMap;
use std::path::Path;

/// Reads a job file and the models that it names, which lie beside it or in folders that are allowed.
pub(super) fn read_job(path: &Path, allowed: &AllowedFolders) -> Result<pb::Job, CliFailure> {
    let text = read_file(path)?;
    job_from_text(&text, path, &NamedFiles::new(folder_of(path), allowed)?)
}

/// Reads a job from the text of its file, and the models that it names.
pub(super) fn job_from_text(text: &[u8], path: &Path, files: &NamedFiles) -> Result<pb::Job, CliFailure> {
    let mut job: pb::Job = wire::json::from_json(text).map_err(|e| in_file(path, e))?;
    read_named_models(&mut job, "", files).map_err(|e| e.in_place(path.display()))?;
    Ok(job)
}

/// Puts the models in that a job names by file. `place` stands before the names of fields where one is wrong.
pub(super) fn read_named_models(job: &mut pb::Job, place: &str, files: &NamedFiles) -> Result<(), CliFailure> {
    use pb::edit_request::{Operation, merge};
    use pb::passenger::{Passenger, file};
    let mut models = NamedModels {
        files,
        read: BTreeMap::new(),
        bytes: 0,
    };
    for (k, step) in job.steps.iter_mut().enumerate() {
        let Some(pb::step::Step::Edit(edit)) = &mut step.step else {
            continue;
        };
        let Some(Operation::Merge(merge)) = &mut edit.operation else {
            continue;
        };
        if let Some(merge::Source::File(name)) = &merge.source {
            let bytes = models.read_once(name, || format!("{place}steps[{k}].merge.file"))?;
            tell_format(&mut merge.format, name);
            merge.source = Some(merge::Source::Model(bytes));
        }
    }
    let passengers = job.create.iter_mut().flat_map(|create| &mut create.passengers);
    for (k, passenger) in passengers.enumerate() {
        let Some(Passenger::File(file)) = &mut passenger.passenger else {
            continue;
        };
        if let Some(file::Source::File(name)) = &file.source {
            let bytes = models.read_once(name, || format!("{place}passengers[{k}].file.file"))?;
            tell_format(&mut file.format, name);
            file.source = Some(file::Source::Model(bytes));
        }
    }
    Ok(())
}

/// Models of a job, each read once whatever the number of steps that name it.
struct NamedModels<'a> {
    files: &'a NamedFiles,
    read: BTreeMap<String, Bytes>,
    bytes: u64,
}

impl NamedModels<'_> {
    fn read_once(&mut self, name: &str, field: impl Fn() -> String) -> Result<Bytes, CliFailure> {
        if let Some(bytes) = self.read.get(name) {
            return Ok(bytes.clone());
        }
        let read = self.files.read_named(name, largest_named());
        let bytes: Bytes = read.map_err(|e| CliFailure::from(e).in_place(field()))?.into();
        self.bytes = self.bytes.saturating_add(bytes.len() as u64);
        if self.bytes > LARGEST {
            let problem = format!("the files that the job names have more than {LARGEST} bytes together");
            return Err(CliFailure::Input(problem).in_place(field()));
        }
        self.read.insert(name.to_owned(), bytes.clone());
        Ok(bytes)
    }
}

/// Largest file that a job or a suite names: a server's default limit of one upload.
pub(super) fn largest_named() -> u64 {
    SessionConfig::default().upload_bytes
}

/// Takes the format from a file's name, unless the job says it.
fn tell_format(format: &mut String, name: &str) {
    if format.is_empty() {
        let told = Format::from_file_name(name);
        *format = told.map_or_else(String::new, |f| f.name().to_owned());
    }
}
