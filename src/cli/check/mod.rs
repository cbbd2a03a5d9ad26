//! `pliant check`: runs a suite of jobs and compares each result with the one that was stored.

mod animated;
mod http;
mod local;
mod remote;
mod run;
mod suite;
mod targets;

use super::failure::CliFailure;
use super::input_files::AllowedFolders;
use super::output_files::OutputPermission;
use super::stage_spinner::StageSpinner;
use super::threads::ThreadArgs;
use crate::check::CaseStatus;
use crate::check::report::{self, SuiteReport};
use clap::Args;
use http::{HttpClient, ServerAddress};
use run::{CheckPlan, run_all_cases};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Arguments of `pliant check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// The suite: a folder of *.case.json files
    suite: PathBuf,
    /// Store the results as goldens instead of comparing with them, and print what that changes
    #[arg(long, conflicts_with = "server")]
    bless: bool,
    /// Run the cases on this server instead of in process, such as http://127.0.0.1:7411
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// Sent to the server as a bearer token
    #[arg(long, value_name = "TOKEN", env = "PLIANT_TOKEN", hide_env_values = true)]
    token: Option<String>,
    /// Authorities that may sign the server's certificate, in PEM, in place of the machine's
    #[arg(long, value_name = "FILE", requires = "server")]
    ca: Option<PathBuf>,
    /// A case whose data is absent fails instead of being skipped
    #[arg(long)]
    no_skip: bool,
    /// The folder of the models that cases name as data:
    #[arg(long, value_name = "FOLDER", env = "PLIANT_DATA")]
    data: Option<PathBuf>,
    #[command(flatten)]
    allowed: AllowedFolders,
    /// Print the report as JSON on stdout
    #[arg(long)]
    json: bool,
    /// Write the report as JUnit XML
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
    /// Write the report as a page with pictures
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    #[command(flatten)]
    permission: OutputPermission,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// Runs the command.
pub(super) fn run_check(args: &CheckArgs) -> Result<(), CliFailure> {
    let named = [("--junit", &args.junit), ("--html", &args.html)];
    let reports = named.map(|(option, path)| path.as_deref().map(|path| (option, path)));
    let reports: Vec<(&str, &Path)> = reports.into_iter().flatten().collect();
    for (_, path) in &reports {
        args.permission.check_target(path)?;
    }
    let threads = args.threads.start_pool()?.threads();
    let server = args
        .server
        .as_deref()
        .map(|url| ServerAddress::new(url, args.token.as_deref(), args.ca.as_deref()));
    let server = server.transpose().map_err(CliFailure::Input)?;
    let data = args.data.as_deref().filter(|d| !d.as_os_str().is_empty());
    let suite = suite::load_suite(&args.suite, data, &args.allowed)?;
    targets::check_targets(&reports, &suite, args.permission, args.bless)?;
    let suite::LoadedSuite { cases, notes, .. } = suite;
    if let Some(address) = &server {
        let client = HttpClient::new(address).map_err(CliFailure::Input)?;
        remote::ask_limits(&client).map_err(|e| CliFailure::Input(format!("the server cannot be used: {e}")))?;
    }
    let plan = CheckPlan {
        server: server.as_ref(),
        bless: args.bless,
        skip_fails: args.no_skip,
        pictures: args.html.is_some(),
    };
    let spinner = StageSpinner::new(args.json);
    let done = run_all_cases(&cases, &plan, threads, &spinner)?;
    spinner.finish();

    let name = args.suite.canonicalize().ok();
    let name = name
        .as_deref()
        .and_then(|p| p.file_name())
        .unwrap_or(args.suite.as_os_str());
    let report = SuiteReport {
        suite: name.to_string_lossy().into_owned(),
        how: if server.is_some() {
            "on a server".into()
        } else {
            "in process".into()
        },
        cases: done.iter().map(|d| d.report.clone()).collect(),
    };
    let width = report.cases.iter().map(|c| c.name.len()).max().unwrap_or_default();
    notes.iter().for_each(|note| eprintln!("note: {note}"));
    for (case, done) in cases.iter().zip(&done) {
        // Written first: what is told as stored is stored.
        if let Some(golden) = &done.golden {
            let replace = args.permission.for_goldens();
            replace.write_file(&case.golden_path, golden.as_bytes())?;
        }
        eprintln!("{}", report::case_line(&done.report, width));
        done.changes.iter().for_each(|change| eprintln!("         {change}"));
        done.report
            .notes
            .iter()
            .for_each(|note| eprintln!("         note: {note}"));
    }
    eprintln!("{}", report::summary_line(&report));
    if let Some(path) = &args.junit {
        let text = report::junit_report(&report).map_err(CliFailure::Internal)?;
        args.permission.write_file(path, &text)?;
    }
    if let Some(path) = &args.html {
        args.permission
            .write_file(path, report::html_report(&report).as_bytes())?;
    }
    if args.json {
        let text = serde_json::to_string_pretty(&report::json_report(&report))
            .map_err(|e| CliFailure::Internal(e.to_string()))?;
        writeln!(std::io::stdout(), "{text}")
            .map_err(|e| CliFailure::Internal(format!("cannot write to stdout: {e}")))?;
    }
    let failed: Vec<&str> = (report.cases.iter())
        .filter(|c| c.verdict.status == CaseStatus::Failed)
        .map(|c| c.name.as_str())
        .collect();
    match failed.as_slice() {
        [] => Ok(()),
        names => {
            let some = names.iter().take(10).copied().collect::<Vec<_>>().join(", ");
            let more = if names.len() > 10 { ", …" } else { "" };
            let text = format!("{} of {} cases failed: {some}{more}", names.len(), report.cases.len());
            Err(CliFailure::Check(text))
        }
    }
}
