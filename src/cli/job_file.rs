//! Job files from disk, with the models that they merge.

use super::failure::CliFailure;
use super::model_files::read_file;
use crate::asset::Format;
use crate::wire::{self, pb};
use std::path::Path;

/// Reads a job file and the models that it names.
pub(super) fn read_job(path: &Path) -> Result<pb::Job, CliFailure> {
    let in_job = |e: wire::Error| match CliFailure::from(e) {
        CliFailure::Input(text) => CliFailure::Input(format!("{}: {text}", path.display())),
        other => other,
    };
    let mut job: pb::Job = wire::json::from_json(&read_file(path)?).map_err(in_job)?;
    read_merged_models(&mut job, path)?;
    read_passengers(&mut job, path)?;
    Ok(job)
}

/// Puts the models in that ride along and that a job names by file, relative to the file `beside`.
fn read_passengers(job: &mut pb::Job, beside: &Path) -> Result<(), CliFailure> {
    use pb::passenger::{Passenger, file::Source};
    let passengers = job.create.iter_mut().flat_map(|create| &mut create.passengers);
    for passenger in passengers {
        let Some(Passenger::File(file)) = &mut passenger.passenger else {
            continue;
        };
        if let Some(Source::File(name)) = &file.source {
            let path = beside.with_file_name(name);
            if file.format.is_empty() {
                let told = Format::from_file_name(name);
                file.format = told.map_or_else(String::new, |f| f.name().to_owned());
            }
            file.source = Some(Source::Model(read_file(&path)?.into()));
        }
    }
    Ok(())
}

/// Puts the models in that a job names by file, relative to the file `beside`.
pub(super) fn read_merged_models(job: &mut pb::Job, beside: &Path) -> Result<(), CliFailure> {
    use pb::edit_request::{Operation, merge::Source};
    for step in &mut job.steps {
        let Some(pb::step::Step::Edit(edit)) = &mut step.step else {
            continue;
        };
        let Some(Operation::Merge(merge)) = &mut edit.operation else {
            continue;
        };
        if let Some(Source::File(name)) = &merge.source {
            let path = beside.with_file_name(name);
            if merge.format.is_empty() {
                let told = Format::from_file_name(name);
                merge.format = told.map_or_else(String::new, |f| f.name().to_owned());
            }
            merge.source = Some(Source::Model(read_file(&path)?.into()));
        }
    }
    Ok(())
}
