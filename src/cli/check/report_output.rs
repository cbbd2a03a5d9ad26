//! The output for a suite, a shard, or merged shards: the same lines, files and exit code.

use super::suite::LoadedSuite;
use crate::check::CaseStatus;
use crate::check::report::{self, SuiteReport};
use crate::cli::failure::CliFailure;
use crate::cli::input_files::folder_of;
use crate::cli::input_files::read_model;
use crate::cli::output_files::{OutputPermission, is_same_target, spare_companions};
use crate::cli::terminal::{pretty_text, print_text};
use clap::{ArgGroup, Args};
use std::path::{Path, PathBuf};

/// Most failed cases that the last line names.
const NAMED: usize = 10;

/// Where a report goes, and what it holds.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("document").args(["json", "report"]).multiple(true))]
pub(super) struct ReportArgs {
    /// Print the report as JSON on stdout
    #[arg(long)]
    pub json: bool,
    /// Write the report as JSON, which --merge and --costs read
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
    /// Write the report as JUnit XML
    #[arg(long, value_name = "FILE")]
    pub junit: Option<PathBuf>,
    /// Write the report as a page with pictures
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Put the page's pictures into the JSON report too, for --merge --html
    #[arg(long, requires = "document")]
    pub pictures: bool,
    /// Write the time of each case into JSON and JUnit
    #[arg(long)]
    pub times: bool,
    /// Exit with code 0 even if cases failed; for tools that read the report
    #[arg(long)]
    pub exit_zero: bool,
    #[command(flatten)]
    pub permission: OutputPermission,
}

impl ReportArgs {
    /// The files that reports go to, each with the name of its option.
    pub fn reports(&self) -> Vec<(&'static str, &Path)> {
        let named = [
            ("--report", &self.report),
            ("--junit", &self.junit),
            ("--html", &self.html),
        ];
        let given = named.map(|(option, path)| path.as_deref().map(|path| (option, path)));
        given.into_iter().flatten().collect()
    }

    /// Says why a report may not be written; changes nothing.
    pub fn check_targets(&self) -> Result<(), CliFailure> {
        let reports = self.reports().into_iter();
        reports
            .map(|(_, path)| path)
            .try_for_each(|path| self.permission.check_target(path))
    }

    /// Whether pictures are wanted.
    pub fn wants_pictures(&self) -> bool {
        self.pictures || self.html.is_some()
    }

    /// Prints a line for each case of a report, and writes its files. `before_case` runs before each line and returns
    /// lines to add after it.
    ///
    /// # Errors
    /// A file that cannot be written; that cases failed.
    pub fn write(
        &self,
        report: &SuiteReport,
        mut before_case: impl FnMut(usize) -> Result<Vec<String>, CliFailure>,
    ) -> Result<(), CliFailure> {
        let width = report.cases.iter().map(|c| c.name.len()).max().unwrap_or_default();
        report
            .notes
            .iter()
            .for_each(|note| eprintln!("{}", report::note_line(note)));
        for (k, case) in report.cases.iter().enumerate() {
            let lines = before_case(k)?;
            eprintln!("{}", report::case_line(case, width));
            lines.iter().for_each(|line| eprintln!("         {line}"));
            let notes = case.notes.iter().map(|note| report::note_line(note));
            notes.for_each(|note| eprintln!("         {note}"));
        }
        eprintln!("{}", report::summary_line(report));
        self.write_files(report)?;
        let Some(text) = failure_text(report) else {
            return Ok(());
        };
        match self.exit_zero {
            true => {
                eprintln!("{text}");
                Ok(())
            }
            false => Err(CliFailure::Check(text)),
        }
    }

    fn write_files(&self, report: &SuiteReport) -> Result<(), CliFailure> {
        let write = |path: &PathBuf, bytes: &[u8]| self.permission.write_file(path, bytes);
        if let Some(path) = &self.junit {
            write(path, &report::junit_report(report).map_err(CliFailure::Internal)?)?;
        }
        if let Some(path) = &self.html {
            write(path, report::html_report(report).as_bytes())?;
        }
        if !self.json && self.report.is_none() {
            return Ok(());
        }
        let document = report::json_report(report, self.pictures).map_err(CliFailure::Internal)?;
        let text = pretty_text(&document)?;
        if let Some(path) = &self.report {
            write(path, text.as_bytes())?;
        }
        match self.json {
            true => print_text(&text),
            false => Ok(()),
        }
    }
}

/// Says which cases failed; `None` when none did.
fn failure_text(report: &SuiteReport) -> Option<String> {
    let failed: Vec<&str> = (report.cases.iter())
        .filter(|c| c.verdict.status == CaseStatus::Failed)
        .map(|c| c.name.as_str())
        .collect();
    let some = failed.iter().take(NAMED).copied().collect::<Vec<_>>().join(", ");
    let more = if failed.len() > NAMED { ", …" } else { "" };
    let (count, of) = (failed.len(), report.cases.len());
    (count > 0).then(|| format!("{count} of {of} cases failed: {some}{more}"))
}

/// Refuses reports that would replace a file of the suite or each other, and places where nothing can be written. Each report has the
/// name of its option; `blesses` says that goldens are to be written too.
///
/// # Errors
/// Which path cannot be written, and why.
pub(super) fn check_targets(
    reports: &[(&str, &Path)],
    suite: &LoadedSuite,
    permission: OutputPermission,
    blesses: bool,
) -> Result<(), CliFailure> {
    for (k, (option, path)) in reports.iter().enumerate() {
        let refuse = |problem: String| {
            let text = format!("{option}: cannot write {}: {problem}", path.display());
            Err(CliFailure::Input(text))
        };
        if let Some((other, _)) = reports[..k].iter().find(|(_, there)| is_same_target(there, path)) {
            return refuse(format!("{other} names it too; each report needs a file of its own"));
        }
        let goldens = suite.cases.iter().map(|case| case.golden_path.as_path());
        let mut files = suite.files.iter().map(PathBuf::as_path).chain(goldens);
        if files.any(|file| is_same_target(file, path)) {
            return refuse("it is a file of the suite, which no report replaces; name another file".into());
        }
        spare_models(path, &suite.models).map_err(|e| e.in_place(option))?;
    }
    for (_, path) in reports {
        permission.try_target(path)?;
    }
    if blesses {
        let goldens = permission.for_goldens();
        (suite.cases.iter()).try_for_each(|case| goldens.try_target(&case.golden_path))?;
    }
    Ok(())
}

/// Refuses a report that would replace a file that a model names beside itself.
fn spare_models(report: &Path, models: &[PathBuf]) -> Result<(), CliFailure> {
    // Only a file that is there can be one, and those of a model lie below its folder: no other model is read for it.
    let Ok(report) = report.canonicalize() else {
        return Ok(());
    };
    for model in models {
        let folder = folder_of(model).canonicalize();
        if !folder.is_ok_and(|folder| report.starts_with(folder)) {
            continue;
        }
        // Its case reports a model that cannot be read.
        if let Ok(files) = read_model(model) {
            spare_companions(&report, model, &files)?;
        }
    }
    Ok(())
}
