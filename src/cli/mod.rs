//! People and scripts at a terminal: arguments, progress, exit codes.
//!
//! Exit codes: 0 done, 1 a check failed, 2 bad input or usage, 3 internal, 130 stopped by a signal. The last line of stderr says why. With
//! `--json` stdout carries exactly one JSON document, that of a failure too.

mod animate;
mod audit;
mod check;
mod deform;
mod drawing;
mod examples;
mod fit;
mod health;
mod input_files;
mod inspect;
mod mcp;
mod output_files;
mod parser_process;
mod render;
mod result_args;
mod rig;
pub mod serve;
mod store;
mod terminal;
mod token;
mod transfer;
mod wrap;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Parser, Subcommand};
use std::process::ExitCode;
use terminal::CliFailure;

/// Deforms large meshes: a headless service, and the same engine in process.
#[derive(Debug, Parser)]
#[command(name = "pliant", version, about, propagate_version = true, after_help = examples::PLIANT)]
struct PliantArgs {
    #[command(subcommand)]
    command: PliantCommand,
}

#[derive(Debug, Subcommand)]
enum PliantCommand {
    /// Run the server
    #[command(after_help = examples::SERVE)]
    Serve(serve::ServeArgs),
    /// Deform a model with a job file, without a server
    #[command(after_help = examples::DEFORM)]
    Deform(deform::DeformArgs),
    /// Show model statistics and mesh warnings
    #[command(after_help = examples::INSPECT)]
    Inspect(inspect::InspectArgs),
    /// Run a suite of jobs and compare each result with its golden
    #[command(after_help = examples::CHECK)]
    Check(check::CheckArgs),
    /// Play a clip on a model and solve every frame
    #[command(after_help = examples::ANIMATE)]
    Animate(Box<animate::AnimateArgs>),
    /// Find the bones of a model and map the joints of a clip to them
    #[command(after_help = examples::RIG)]
    Rig(rig::RigArgs),
    /// Bind a model to the bones of a rig
    #[command(after_help = examples::SKIN)]
    Skin(rig::SkinArgs),
    /// Wrap a model onto a scan or another model; topology, UVs, rig and morph targets stay
    #[command(after_help = examples::WRAP)]
    Wrap(wrap::WrapArgs),
    /// Bring blend shapes or a pose of a model to another one, which keeps its vertices, UVs, rig and materials
    #[command(after_help = examples::TRANSFER)]
    Transfer(transfer::TransferArgs),
    /// Put an outfit of a body on another body, outside of it; UVs, rig and materials stay
    #[command(after_help = examples::FIT)]
    Fit(fit::FitArgs),
    /// Draw a model as a PNG picture, optionally beside an earlier state
    #[command(after_help = examples::RENDER)]
    Render(render::RenderArgs),
    /// Write a built-in model or recording to a file
    #[command(after_help = examples::SAMPLE)]
    Sample(examples::SampleArgs),
    /// Let an agent use pliant: the Model Context Protocol over stdin and stdout
    #[command(after_help = examples::MCP)]
    Mcp(mcp::McpArgs),
    /// Create an access token
    #[command(after_help = examples::TOKEN)]
    Token(token::TokenArgs),
    /// Check, list, export and prune stored sessions
    #[command(after_help = examples::STORE)]
    Store(store::StoreArgs),
    /// Check whether a server is ready
    #[command(after_help = examples::HEALTH)]
    Health(health::HealthArgs),
    /// Show the audit log of a server
    #[command(after_help = examples::AUDIT)]
    Audit(audit::AuditArgs),
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    if parser_process::is_called() {
        return parser_process::answer();
    }
    let args = match PliantArgs::try_parse() {
        Ok(args) => args,
        Err(e) => return answer_usage(&e),
    };
    let result = match args.command {
        PliantCommand::Serve(args) => serve::run_serve(args),
        PliantCommand::Deform(args) => deform::run_deform(&args),
        PliantCommand::Inspect(args) => inspect::run_inspect(&args),
        PliantCommand::Check(args) => check::run_check(&args),
        PliantCommand::Animate(args) => animate::run_animate(&args),
        PliantCommand::Rig(args) => rig::run_rig(&args),
        PliantCommand::Skin(args) => rig::run_skin(&args),
        PliantCommand::Wrap(args) => wrap::run_wrap(&args),
        PliantCommand::Transfer(args) => transfer::run_transfer(&args),
        PliantCommand::Fit(args) => fit::run_fit(&args),
        PliantCommand::Render(args) => render::run_render(&args),
        PliantCommand::Sample(args) => examples::run_sample(&args),
        PliantCommand::Mcp(args) => mcp::run_mcp(&args),
        PliantCommand::Token(args) => token::run_token(&args),
        PliantCommand::Store(args) => store::run_store(&args),
        PliantCommand::Audit(args) => audit::run_audit(&args),
        PliantCommand::Health(args) => health::run_health(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report_and_exit(),
    }
}

/// Answers arguments that begin no command: with what was asked for, or with what is wrong and where the arguments are listed.
fn answer_usage(problem: &clap::Error) -> ExitCode {
    if !problem.use_stderr() {
        // Help and version are answers, not failures.
        let _ = problem.print();
        return ExitCode::SUCCESS;
    }
    if problem.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        let _ = problem.print();
        return CliFailure::Input("no command is named; see above".into()).report_and_exit();
    }
    let hint = match problem.get(ContextKind::InvalidArg) {
        Some(ContextValue::String(argument)) => hint_for(argument),
        _ => None,
    };
    CliFailure::Input(usage_reason(&problem.to_string(), hint)).report_and_exit()
}

/// The parser's message in one line: what is wrong, what may have been meant, and the command that lists the arguments.
fn usage_reason(message: &str, hint: Option<&str>) -> String {
    let mut paragraphs = message.split("\n\n").map(str::trim);
    let first = paragraphs.next().unwrap_or_default().trim_start_matches("error: ");
    let mut parts = vec![first.lines().map(str::trim).collect::<Vec<&str>>().join(" ")];
    let mut see = None;
    for paragraph in paragraphs {
        if let Some(usage) = paragraph.strip_prefix("Usage: ") {
            let is_name = |word: &&str| word.starts_with(|c: char| c.is_ascii_lowercase());
            let command: Vec<&str> = usage.split_whitespace().take_while(is_name).collect();
            see = Some(format!("see {} --help", command.join(" ")));
        }
        let tips = paragraph.lines().filter_map(|line| line.trim().strip_prefix("tip: "));
        parts.extend(tips.map(str::to_owned));
    }
    parts.extend(hint.map(str::to_owned));
    parts.extend(see);
    parts.join("; ")
}

/// What an argument means here that other programs take.
fn hint_for(argument: &str) -> Option<&'static str> {
    let name = argument.split('=').next().unwrap_or_default();
    match name {
        "--port" | "--host" | "--bind" | "--address" | "-p" => {
            Some("the server's address and port are --listen ADDRESS:PORT")
        }
        "--out" | "--outfile" => Some("the output is -o FILE"),
        _ if !name.starts_with('-') && name.ends_with(".json") => {
            Some("a job is named by --job FILE, a rig by --rig FILE")
        }
        _ if !name.starts_with('-') && name.ends_with(".bvh") => Some("a clip is named by --bvh FILE"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reason_has_the_tip_the_hint_and_the_command() {
        let message = "error: unrecognized subcommand 'defrom'\n\n  tip: a similar subcommand exists: 'deform'\n\nUsage: pliant <COMMAND>\n\nFor more";
        assert_eq!(
            usage_reason(message, Some("try it")),
            "unrecognized subcommand 'defrom'; a similar subcommand exists: 'deform'; try it; see pliant --help"
        );
    }
}
