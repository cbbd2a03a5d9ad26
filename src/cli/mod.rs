//! People and scripts at a terminal: arguments, progress, exit codes.
//!
//! Exit codes: 0 done, 1 a check failed, 2 bad input or usage, 3 internal. The last line of stderr says why. With
//! `--json` stdout carries exactly one JSON document.

mod animate;
mod audit;
mod check;
mod cutaway;
mod deform;
mod failure;
mod input_files;
mod inspect;
mod job_file;
mod json_output;
mod model_files;
mod output_files;
mod render;
mod rig;
mod sample;
pub mod serve;
mod skin;
mod stage_spinner;
mod store;
mod threads;
mod token;

use clap::{Parser, Subcommand};
use failure::CliFailure;
use std::process::ExitCode;

/// Bends large meshes: a headless deformation service, and the same engine in process.
#[derive(Debug, Parser)]
#[command(name = "pliant", version, about, propagate_version = true)]
struct PliantArgs {
    #[command(subcommand)]
    command: PliantCommand,
}

#[derive(Debug, Subcommand)]
enum PliantCommand {
    /// Run the server
    Serve(serve::ServeArgs),
    /// Deform a model with a job file, in process
    Deform(deform::DeformArgs),
    /// Tell what the solver sees in a model
    Inspect(inspect::InspectArgs),
    /// Run a suite of jobs and compare each result with the one that was stored
    Check(check::CheckArgs),
    /// Play a clip on a model, every frame solved
    Animate(Box<animate::AnimateArgs>),
    /// Find where the bones of a model lie, and which joints of a clip turn them
    Rig(rig::RigArgs),
    /// Bind a model to the bones of a rig
    Skin(skin::SkinArgs),
    /// Draw a model, maybe beside what it was, as a png
    Render(render::RenderArgs),
    /// Write a built-in model to a file
    Sample(sample::SampleArgs),
    /// Make a token by which a server knows who asks
    Token(token::TokenArgs),
    /// Check, list, export and prune sessions that a server kept
    Store(store::StoreArgs),
    /// Tell who opened, changed and took away what on a server
    Audit(audit::AuditArgs),
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    let args = match PliantArgs::try_parse() {
        Ok(args) => args,
        Err(e) => {
            let _ = e.print();
            if !e.use_stderr() {
                // Help and version are answers, not failures.
                return ExitCode::SUCCESS;
            }
            return CliFailure::Input(usage_reason(&e.to_string())).report_and_exit();
        }
    };
    let result = match args.command {
        PliantCommand::Serve(args) => serve::run_serve(args),
        PliantCommand::Deform(args) => deform::run_deform(&args),
        PliantCommand::Inspect(args) => inspect::run_inspect(&args),
        PliantCommand::Check(args) => check::run_check(&args),
        PliantCommand::Animate(args) => animate::run_animate(&args),
        PliantCommand::Rig(args) => rig::run_rig(&args),
        PliantCommand::Skin(args) => skin::run_skin(&args),
        PliantCommand::Render(args) => render::run_render(&args),
        PliantCommand::Sample(args) => sample::run_sample(&args),
        PliantCommand::Token(args) => token::run_token(&args),
        PliantCommand::Store(args) => store::run_store(&args),
        PliantCommand::Audit(args) => audit::run_audit(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report_and_exit(),
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
