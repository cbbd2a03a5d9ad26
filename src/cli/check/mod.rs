//! `pliant check`: runs a suite of jobs, or a shard of it, and compares each result with the one that was stored; joins the reports of
//! shards.

mod http;
mod remote;
mod report_output;
mod run;
mod shards;
mod suite;

use super::failure::CliFailure;
use super::input_files::AllowedFolders;
use super::terminal::StageSpinner;
use super::terminal::ThreadArgs;
use crate::check::Shard;
use crate::check::report::{CaseReport, SuiteReport};
use clap::Args;
use http::{HttpClient, ServerAddress};
use report_output::ReportArgs;
use run::{CheckPlan, run_all_cases};
use std::path::{Path, PathBuf};

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
    /// Folder of the models that cases name as data:
    #[arg(long, value_name = "FOLDER", env = "PLIANT_DATA")]
    data: Option<PathBuf>,
    #[command(flatten)]
    allowed: AllowedFolders,
    #[command(flatten)]
    output: ReportArgs,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// Runs the command.
pub(super) fn run_check(args: &CheckArgs) -> Result<(), CliFailure> {
    args.output.check_targets()?;
    match &args.suite {
        Some(suite) => check_suite(suite, args),
        None => join_shards(args),
    }
}

/// Joins the reports of shards.
fn join_shards(args: &CheckArgs) -> Result<(), CliFailure> {
    let mut report = shards::merge_files(&args.merge)?;
    if !args.output.times {
        report.cases.iter_mut().for_each(|c| c.milliseconds = None);
    }
    // A case that ended in a result has pictures, or a note that says why not.
    let bare = |c: &&CaseReport| !c.digest.is_empty() && c.pictures.is_empty() && c.notes.is_empty();
    let bare = report.cases.iter().filter(bare).count();
    if args.output.wants_pictures() && bare > 0 {
        eprintln!("note: {bare} cases have no pictures; run the shards with --pictures to include them");
    }
    args.output.write(&report, |_| Ok(Vec::new()))
}

/// Runs a suite, or a shard of it.
fn check_suite(suite: &Path, args: &CheckArgs) -> Result<(), CliFailure> {
    let threads = args.threads.start_pool()?.threads();
    let server = args
        .server
        .as_deref()
        .map(|url| ServerAddress::new(url, args.token.as_deref(), args.ca.as_deref()));
    let server = server.transpose().map_err(CliFailure::Input)?;
    let data = args.data.as_deref().filter(|d| !d.as_os_str().is_empty());
    let loaded = suite::load_suite(suite, data, &args.allowed, &args.chosen)?;
    report_output::check_targets(&args.output.reports(), &loaded, args.output.permission, args.bless)?;
    let suite::LoadedSuite { mut cases, notes, .. } = loaded;
    let shard = args
        .shard
        .map(|shard| shards::take_shard(&mut cases, shard, args.costs.as_deref()));
    let shard = shard.transpose()?;
    if let Some(address) = &server {
        let client = HttpClient::new(address).map_err(CliFailure::Input)?;
        remote::ask_limits(&client).map_err(|e| CliFailure::Input(format!("the server cannot be used: {e}")))?;
    }
    let plan = CheckPlan {
        server: server.as_ref(),
        bless: args.bless,
        skip_fails: args.no_skip,
        pictures: args.output.wants_pictures(),
        times: args.output.times,
    };
    let spinner = StageSpinner::new(args.output.json);
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
