//! `pliant check`: runs a suite of jobs, or a shard of it, and compares each result with the one that was stored; joins the reports of
//! shards.
//!
//! The output for a suite, a shard, or merged shards: the same lines, files and exit code.
//!
//! One shard of a suite, and the reports of all shards as that of the whole.

mod new_case;
mod remote;
mod run;
mod suite;

use super::input_files::{AllowedFolders, folder_of, read_file, read_model};
use super::output_files::{OutputPermission, is_same_target, spare_companions};
use super::terminal::{CliFailure, ComputeArgs, pretty_text, print_text, say};
use crate::check::report::{CaseReport, ShardFacts, SuiteReport, merge_reports, read_report};
use crate::check::{CaseStatus, Shard, digest_texts, measured_costs, report, split_cases, split_digest};
use crate::session::store::build_identity;
use clap::{ArgGroup, Args};
use new_case::{NewCaseArgs, take_back};
use remote::{HttpClient, ServerAddress};
use run::{CheckPlan, run_all_cases};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use suite::{LoadedCase, LoadedSuite};

/// Arguments of `pliant check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Suite: a folder of *.case.json files
    #[arg(required_unless_present = "merge")]
    suite: Option<PathBuf>,
    /// Store the results as the new goldens and print the changes
    #[arg(long, conflicts_with = "server")]
    bless: bool,
    /// Run only this case, and with --bless store only its golden; repeatable, * stands for any letters
    #[arg(long = "case", value_name = "NAME", conflicts_with = "shard")]
    chosen: Vec<String>,
    /// Run only this part of the suite, such as 3/8; if K begins at 0, write K+1/N
    #[arg(long, value_name = "K/N", conflicts_with = "bless")]
    shard: Option<Shard>,
    /// Split by the times in this report of an earlier run with --times, not by the sizes of goldens and models
    #[arg(long, value_name = "REPORT", requires = "shard")]
    costs: Option<PathBuf>,
    /// Join the reports of all shards, or those in a folder, into the report of the whole suite
    #[arg(
        long,
        value_name = "REPORT",
        num_args = 1..,
        conflicts_with_all = ["suite", "bless", "chosen", "shard", "costs", "server", "no_skip", "folders"]
    )]
    merge: Vec<PathBuf>,
    /// URL of a server to run the cases on, such as http://127.0.0.1:7411 [default: in process]
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// Access token for the server
    #[arg(long, value_name = "TOKEN", env = "PLIANT_TOKEN", hide_env_values = true)]
    token: Option<String>,
    /// CA certificates (PEM) to trust instead of the system's
    #[arg(long, value_name = "FILE", requires = "server")]
    ca: Option<PathBuf>,
    /// Fail a case without its data instead of skipping it
    #[arg(long)]
    no_skip: bool,
    #[command(flatten)]
    new_case: NewCaseArgs,
    /// Folder of the models that cases name as data:
    #[arg(long, value_name = "FOLDER", env = "PLIANT_DATA")]
    data: Option<PathBuf>,
    #[command(flatten)]
    allowed: AllowedFolders,
    #[command(flatten)]
    output: ReportArgs,
    #[command(flatten)]
    compute: ComputeArgs,
}

pub(super) fn run_check(args: &CheckArgs) -> Result<(), CliFailure> {
    args.output.check_targets()?;
    match (&args.suite, &args.new_case.new) {
        (Some(suite), Some(name)) => {
            let path = args.new_case.write(suite, name)?;
            let started = check_suite(suite, args, std::slice::from_ref(name), true);
            started.inspect_err(|_| take_back(&path))
        }
        (Some(suite), None) => check_suite(suite, args, &args.chosen, args.bless),
        (None, _) => join_shards(args),
    }
}

/// Joins the reports of shards.
fn join_shards(args: &CheckArgs) -> Result<(), CliFailure> {
    let mut report = merge_files(&args.merge)?;
    if !args.output.times {
        report.cases.iter_mut().for_each(|c| c.milliseconds = None);
    }
    // A case that ended in a result has pictures, or a note that says why not.
    let bare = |c: &&CaseReport| !c.digest.is_empty() && c.pictures.is_empty() && c.notes.is_empty();
    let bare = report.cases.iter().filter(bare).count();
    if args.output.wants_pictures() && bare > 0 {
        say!("note: {bare} cases have no pictures; run the shards with --pictures to include them");
    }
    args.output.write(&report, |_| Ok(Vec::new()))
}

/// Runs a suite, the `chosen` cases of it, or a shard; stores the results where it is to `bless` them.
fn check_suite(suite: &Path, args: &CheckArgs, chosen: &[String], bless: bool) -> Result<(), CliFailure> {
    let threads = args.compute.threads.start_pool()?.threads();
    let server = args
        .server
        .as_deref()
        .map(|url| ServerAddress::new(url, args.token.as_deref(), args.ca.as_deref()));
    let server = server.transpose().map_err(CliFailure::Input)?;
    let data = args.data.as_deref().filter(|d| !d.as_os_str().is_empty());
    let loaded = suite::load_suite(suite, data, &args.allowed, chosen)?;
    check_targets(&args.output.reports(), &loaded, args.output.permission, bless)?;
    let suite::LoadedSuite { mut cases, notes, .. } = loaded;
    let shard = args
        .shard
        .map(|shard| take_shard(&mut cases, shard, args.costs.as_deref()));
    let shard = shard.transpose()?;
    if let Some(address) = &server {
        let client = HttpClient::new(address).map_err(CliFailure::Input)?;
        remote::ask_limits(&client).map_err(|e| CliFailure::Input(format!("the server cannot be used: {e}")))?;
    }
    let plan = CheckPlan {
        server: server.as_ref(),
        bless,
        skip_fails: args.no_skip,
        pictures: args.output.wants_pictures(),
        times: args.output.times,
    };
    let spinner = args.compute.show_stages(args.output.json);
    let done = run_all_cases(&cases, &plan, threads, &spinner)?;
    spinner.finish();

    let name = suite.canonicalize().ok();
    let name = name.as_deref().and_then(|p| p.file_name()).unwrap_or(suite.as_os_str());
    let report = SuiteReport {
        suite: name.to_string_lossy().into_owned(),
        how: if server.is_some() {
            "on a server".into()
        } else {
            "in process".into()
        },
        notes,
        shard,
        cases: done.iter().map(|d| d.report.clone()).collect(),
    };
    args.output.write(&report, |k| {
        // Written first, so that a golden that is reported as stored is stored.
        if let Some(golden) = &done[k].golden {
            let replace = args.output.permission.for_goldens();
            replace.write_file(&cases[k].golden_path, golden.as_bytes())?;
        }
        Ok(done[k].changes.clone())
    })
}

/// Most failed cases that the last line names.
const NAMED: usize = 10;

/// Where a report goes, and what it holds.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("document").args(["json", "report"]).multiple(true))]
struct ReportArgs {
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
        report.notes.iter().for_each(|note| say!("{}", report::note_line(note)));
        for (k, case) in report.cases.iter().enumerate() {
            let lines = before_case(k)?;
            say!("{}", report::case_line(case, width));
            lines.iter().for_each(|line| say!("         {line}"));
            let notes = case.notes.iter().map(|note| report::note_line(note));
            notes.for_each(|note| say!("         {note}"));
        }
        say!("{}", report::summary_line(report));
        self.write_files(report)?;
        let Some(text) = failure_text(report) else {
            return Ok(());
        };
        match self.exit_zero {
            true => {
                say!("{text}");
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
        .filter(|c| c.status == CaseStatus::Failed)
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
fn check_targets(
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

/// Leaves the cases of a shard, and says what it is a part of. `costs` is the report that times of a former run stand in.
///
/// # Errors
/// What is wrong with that report.
fn take_shard(cases: &mut Vec<LoadedCase>, shard: Shard, costs: Option<&Path>) -> Result<ShardFacts, CliFailure> {
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
        number: shard.number(),
        of: shard.of(),
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
fn merge_files(named: &[PathBuf]) -> Result<SuiteReport, CliFailure> {
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
