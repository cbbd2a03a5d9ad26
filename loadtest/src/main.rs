//! Loads a pliant server on loopback, and measures the solver and the pipeline.
//!
//! `loadtest stream` drags a handle of a model at a steady rate over gRPC, from one client or several, and keeps a ledger:
//! every pose that was sent must come back as a final frame, as an error, or in the `superseded` of a frame ([`load`]).
//! `commits` measures what it costs that commits outlive the server ([`commits`]).
//! `export-system` and `solver` measure the solver alone ([`solver`]), `pipeline` and `edits` measure everything up to a
//! frame ([`pipeline`]). `contact` measures poses in which surfaces cross ([`contact`]), `motion` what animations are to show
//! ([`motion`]). `sheet` and `figures` draw what deforming does to models ([`contact_sheet`], [`paper_figures`]).
//!
//! Exit codes: 0 the ledger balances, 1 it does not or the server or solver failed, 2 usage.

mod commits;
mod contact;
mod contact_sheet;
mod failure;
mod load;
mod measurements;
mod models;
mod motion;
mod paper_figures;
mod pipeline;
mod solver;

use clap::{Parser, Subcommand};
use failure::LoadtestFailure;
use std::process::ExitCode;

/// Loads a pliant server on loopback, and measures the solver and the pipeline.
#[derive(Debug, Parser)]
#[command(name = "loadtest", version)]
struct LoadtestArgs {
    #[command(subcommand)]
    command: LoadtestCommand,
}

#[derive(Debug, Subcommand)]
enum LoadtestCommand {
    /// Drag a handle at a steady rate and measure what comes back
    Stream(load::StreamArgs),
    /// Commit and drag on servers that keep sessions in memory, in SQLite and in PostgreSQL, side by side
    Commits(commits::CommitsArgs),
    /// Open, drag, edit and close sessions repeatedly, and check whether the server's memory grows
    Soak(load::soak::SoakArgs),
    #[command(name = load::server::SERVER_COMMAND, hide = true)]
    OwnServer(load::server::OwnServerArgs),
    /// Write the second-pass system of a pose as files that any solver can read
    ExportSystem(solver::export::ExportArgs),
    /// Solve an exported system and report the times
    Solver(solver::SolverArgs),
    /// Time every stage from a model's file to the first frame
    Pipeline(pipeline::first_frame::PipelineArgs),
    /// Measure the gain and the cost of rotation refinements
    Energy(pipeline::first_frame::EnergyArgs),
    /// Measure one frame of a drag, pass by pass
    Frame(pipeline::frame::FrameArgs),
    /// Measure frames from positions to message bytes, per encoding
    Wire(pipeline::wire::WireArgs),
    /// Edit a region of a model and time everything up to the next frame, repaired and rebuilt
    Edits(pipeline::edits::EditsArgs),
    /// Commit poses in which surfaces cross, without and with contact avoided
    Contact(contact::ContactArgs),
    /// Measure clips on models, row by row, against their targets
    Motion(motion::MotionArgs),
    /// Deform every model of a folder and draw them in one picture
    Sheet(contact_sheet::SheetArgs),
    /// Draw the paper's figures 2 and 3: every first pass, and the deformation of space, side by side
    Figures(paper_figures::FiguresArgs),
}

fn main() -> ExitCode {
    let outcome = match &LoadtestArgs::parse().command {
        LoadtestCommand::Stream(args) => load::stream::run_stream(args),
        LoadtestCommand::Commits(args) => commits::run_commits(args),
        LoadtestCommand::Soak(args) => load::soak::run_soak(args),
        LoadtestCommand::OwnServer(args) => load::server::run_own_server(args),
        LoadtestCommand::ExportSystem(args) => solver::export::run_export(args),
        LoadtestCommand::Solver(args) => solver::run_solver(args),
        LoadtestCommand::Pipeline(args) => pipeline::first_frame::run_pipeline(args),
        LoadtestCommand::Energy(args) => pipeline::first_frame::run_energy(args),
        LoadtestCommand::Frame(args) => pipeline::frame::run_frame(args),
        LoadtestCommand::Wire(args) => pipeline::wire::run_wire(args),
        LoadtestCommand::Edits(args) => pipeline::edits::run_edits(args),
        LoadtestCommand::Contact(args) => contact::run_contact(args),
        LoadtestCommand::Motion(args) => motion::run_motion(args),
        LoadtestCommand::Sheet(args) => contact_sheet::run_sheet(args),
        LoadtestCommand::Figures(args) => paper_figures::run_figures(args),
    };
    let (text, code) = match outcome {
        Ok(()) => return ExitCode::SUCCESS,
        Err(LoadtestFailure::Server(text)) => (text, 1),
        Err(LoadtestFailure::Usage(text)) => (text, 2),
    };
    eprintln!("loadtest: {text}");
    ExitCode::from(code)
}
