//! People and scripts at a terminal: arguments, progress, exit codes.
//!
//! Exit codes: 0 done, 1 a check failed, 2 bad input or usage, 3 internal. The last line of stderr says why. With
//! `--json` stdout carries exactly one JSON document.

mod check;
mod deform;
mod files;
mod inspect;
mod job;
mod progress;
mod render;
pub mod serve;

use crate::pool::Pool;
use crate::wire::{Error as JobError, json};
use clap::{Args, Parser, Subcommand};
use std::process::ExitCode;

/// Bends large meshes: a headless deformation service, and the same engine in process.
#[derive(Debug, Parser)]
#[command(name = "pliant", version, about, propagate_version = true)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the server
    Serve(serve::ServeArgs),
    /// Deform a model with a job file, in process
    Deform(deform::DeformArgs),
    /// Tell what the solver sees in a model
    Inspect(inspect::InspectArgs),
    /// Run a suite of jobs and compare each result with the one that was stored
    Check(check::CheckArgs),
    /// Draw a model, maybe beside what it was, as a png
    Render(render::RenderArgs),
}

/// The thread budget of commands that compute in process.
#[derive(Debug, Args)]
struct Threads {
    /// Compute threads; 0 = one for each core
    #[arg(long, env = "PLIANT_THREADS", default_value_t = 0)]
    threads: usize,
}

impl Threads {
    fn pool(&self) -> Result<Pool, Failure> {
        if self.threads > 1024 {
            return Err(Failure::Input(format!(
                "--threads is {}, allowed are 0 to 1024",
                self.threads
            )));
        }
        Pool::new(self.threads).map_err(|e| Failure::Internal(e.to_string()))
    }
}

/// Why a command ends with something other than 0.
#[derive(Debug)]
pub enum Failure {
    /// A check did not hold: exit code 1.
    Check(String),
    /// Bad input or usage: exit code 2.
    Input(String),
    /// A defect or a broken machine: exit code 3.
    Internal(String),
}

impl Failure {
    fn code(&self) -> u8 {
        match self {
            Self::Check(_) => 1,
            Self::Input(_) => 2,
            Self::Internal(_) => 3,
        }
    }

    /// Says why in the last line of stderr.
    fn end(&self) -> ExitCode {
        eprintln!("pliant: {}", self.text());
        ExitCode::from(self.code())
    }

    pub(crate) fn text(&self) -> &str {
        match self {
            Self::Check(text) | Self::Input(text) | Self::Internal(text) => text,
        }
    }
}

impl From<JobError> for Failure {
    fn from(e: JobError) -> Self {
        match e {
            JobError::Internal(_) | JobError::Cancelled => Self::Internal(e.to_string()),
            other => Self::Input(other.to_string()),
        }
    }
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) => {
            let _ = e.print();
            if !e.use_stderr() {
                // Help and version are answers, not failures.
                return ExitCode::SUCCESS;
            }
            return Failure::Input(usage_reason(&e.to_string())).end();
        }
    };
    let result = match cli.command {
        Command::Serve(args) => serve::main(args),
        Command::Deform(args) => deform::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Check(args) => check::run(&args),
        Command::Render(args) => render::run(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.end(),
    }
}

/// What is wrong with the arguments, in one line: the first paragraph of the parser's message.
fn usage_reason(message: &str) -> String {
    let paragraph: Vec<&str> = message
        .lines()
        .take_while(|line| !line.trim().is_empty())
        .map(str::trim)
        .collect();
    paragraph.join(" ").trim_start_matches("error: ").to_owned()
}

/// Prints one JSON document on stdout. A reader that went away is no failure of ours to report twice.
fn print_json<M: prost::Message + prost::Name>(message: &M) -> Result<(), Failure> {
    use std::io::Write as _;
    let value = json::to_json(message)?;
    let text = serde_json::to_string_pretty(&value).map_err(|e| Failure::Internal(e.to_string()))?;
    writeln!(std::io::stdout(), "{text}").map_err(|e| Failure::Internal(format!("cannot write to stdout: {e}")))
}
