//! `pliant check --merge`: the reports of shards, read and joined.

use crate::check::report::{SuiteReport, merge_reports, read_report};
use crate::cli::failure::CliFailure;
use crate::cli::input_files::read_file;
use std::fs;
use std::path::{Path, PathBuf};

/// How the names of reports in a folder end.
const SUFFIX: &str = ".json";

/// Reads reports, or folders of them, and joins them.
///
/// # Errors
/// What cannot be read, or why the reports do not belong together.
pub(super) fn merge_files(named: &[PathBuf]) -> Result<SuiteReport, CliFailure> {
    let mut files = Vec::new();
    for path in named {
        match path.is_dir() {
            true => files.extend(reports_in(path)?),
            false => files.push(path.clone()),
        }
    }
    let read = |path: &PathBuf| {
        let file = path.display().to_string();
        let report = read_report(&file, &read_file(path)?);
        report
            .map(|report| (file, report))
            .map_err(|e| CliFailure::Input(format!("{e}; --merge reads what --shard K/N --report FILE writes")))
    };
    let reports: Vec<(String, SuiteReport)> = files.iter().map(read).collect::<Result<_, _>>()?;
    merge_reports(reports).map_err(CliFailure::Input)
}

/// Lists the reports in a folder, in the order of their names.
fn reports_in(folder: &Path) -> Result<Vec<PathBuf>, CliFailure> {
    let unreadable = |e: std::io::Error| CliFailure::Input(format!("cannot read {}: {e}", folder.display()));
    let entries = fs::read_dir(folder).map_err(unreadable)?;
    let paths: Vec<PathBuf> = entries
        .map(|entry| entry.map(|e| e.path()))
        .collect::<Result<_, _>>()
        .map_err(unreadable)?;
    let is_report = |path: &PathBuf| path.to_string_lossy().ends_with(SUFFIX);
    let mut reports: Vec<PathBuf> = paths.into_iter().filter(is_report).collect();
    reports.sort();
    if reports.is_empty() {
        let problem = format!("holds no report; the name of one ends with {SUFFIX}");
        return Err(CliFailure::Input(format!("the folder {} {problem}", folder.display())));
    }
    Ok(reports)
}
