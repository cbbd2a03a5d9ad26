//! One shard of a suite, and the reports of all shards as that of the whole.

use super::suite::LoadedCase;
use crate::check::report::{ShardFacts, SuiteReport, merge_reports, read_report};
use crate::check::{Shard, digest_texts, measured_costs, split_cases, split_digest};
use crate::cli::failure::CliFailure;
use crate::cli::input_files::read_file;
use crate::session::store::build_identity;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Leaves the cases of a shard, and says what it is a part of. `costs` is the report that times of a former run stand in.
///
/// # Errors
/// What is wrong with that report.
pub(super) fn take_shard(
    cases: &mut Vec<LoadedCase>,
    shard: Shard,
    costs: Option<&Path>,
) -> Result<ShardFacts, CliFailure> {
    let estimates: Vec<(&str, u64)> = cases
        .iter()
        .map(|c| (c.case.name.as_str(), c.work().estimate_cost()))
        .collect();
    let costs = match costs {
        None => estimates,
        Some(path) => {
            let measured = measured_costs(&estimates, &timed_cases(path)?).ok_or_else(|| {
                let problem =
                    "holds the time of no case of this suite; a run with --times writes times into its report";
                CliFailure::Input(format!("--costs {} {problem}", path.display()))
            })?;
            estimates.iter().map(|(name, _)| *name).zip(measured).collect()
        }
    };
    let numbers = split_cases(&costs, shard.of());
    let split: Vec<(&str, u32)> = costs
        .iter()
        .map(|(name, _)| *name)
        .zip(numbers.iter().copied())
        .collect();
    let parts = cases
        .iter()
        .flat_map(|c| [c.case.name.as_bytes(), c.content.as_bytes()]);
    let facts = ShardFacts {
        shard,
        cases: cases.len(),
        suite: digest_texts(parts),
        split: split_digest(&split, shard.of()),
        build: format!("{} {}", env!("CARGO_PKG_VERSION"), build_identity()),
    };
    let mut numbers = numbers.into_iter();
    cases.retain(|_| numbers.next() == Some(shard.number()));
    Ok(facts)
}

/// The microseconds that cases took, by a report.
fn timed_cases(path: &Path) -> Result<BTreeMap<String, u64>, CliFailure> {
    let report = read_report(&path.display().to_string(), &read_file(path)?);
    let report = report.map_err(|e| CliFailure::Input(format!("--costs {e}")))?;
    let timed = report.cases.into_iter().filter_map(|case| {
        // A cast of what is too large is the largest.
        let took = (case.milliseconds? * 1000.0).round() as u64;
        Some((case.name, took))
    });
    Ok(timed.collect())
}

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
