//! Models and jobs from disk.

use crate::failure::LoadtestFailure;
use pliant::asset::FileSet;
use pliant::wire;
use pliant::wire::pb;
use std::path::Path;

/// Reads a model of one file.
pub(crate) fn read_model_file(path: &Path) -> Result<FileSet, LoadtestFailure> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(FileSet::single(name, read_file(path)?))
}

/// Reads a job.
pub(crate) fn read_job_file(path: &Path) -> Result<pb::Job, LoadtestFailure> {
    wire::json::from_json(&read_file(path)?).map_err(|e| LoadtestFailure::Usage(format!("{}: {e}", path.display())))
}

fn read_file(path: &Path) -> Result<Vec<u8>, LoadtestFailure> {
    std::fs::read(path).map_err(|e| LoadtestFailure::Usage(format!("cannot read {}: {e}", path.display())))
}
