//! One shard of a suite: its cases, found by the suite alone or by the times of a former run.

use super::suite::LoadedCase;
use crate::check::report::{ShardFacts, read_report};
use crate::check::{Shard, digest_texts, measured_costs, split_cases, split_digest};
use crate::cli::failure::CliFailure;
use crate::cli::input_files::read_file;
use crate::session::store::build_identity;
use std::collections::BTreeMap;
use std::path::Path;

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
