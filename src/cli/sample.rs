//! `pliant sample`: a built-in model or recording as a file, for trying things where none is at hand.

use super::failure::CliFailure;
use super::output_files::{OutputPermission, holds_bytes};
use crate::asset::sample::{BuiltInModel, BuiltInRecording, body_glb};
use clap::Args;
use std::path::PathBuf;

/// Arguments of `pliant sample`.
#[derive(Debug, Args)]
pub struct SampleArgs {
    /// creature: one closed mesh; figure: a person with a skeleton, clips, levels of detail, a hull and sockets; body: the figure's
    /// body only; boxing, ballet, twist: BVH recordings, twist of a hand that turns over
    #[arg(default_value = "creature", value_parser = parse_name)]
    name: BuiltInFile,
    /// Output file: .glb for a model, .bvh for a recording
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    permission: OutputPermission,
}

/// What is built in.
#[derive(Debug, Clone, Copy)]
enum BuiltInFile {
    Model(BuiltInModel),
    /// The figure's body.
    Body,
    Recording(BuiltInRecording),
}

fn parse_name(text: &str) -> Result<BuiltInFile, String> {
    let model = BuiltInModel::from_name(text).map(BuiltInFile::Model);
    let body = (text == "body").then_some(BuiltInFile::Body);
    let recording = BuiltInRecording::from_name(text).map(BuiltInFile::Recording);
    model.or(body).or(recording).ok_or_else(|| {
        let recordings = BuiltInRecording::ALL.map(BuiltInRecording::recording_name).join(", ");
        format!(
            "expected one of: {}, body, {recordings}",
            BuiltInModel::ALL.map(BuiltInModel::name).join(", ")
        )
    })
}

/// Runs the command.
pub(super) fn run_sample(args: &SampleArgs) -> Result<(), CliFailure> {
    let (ending, what) = match args.name {
        BuiltInFile::Model(_) | BuiltInFile::Body => ("glb", "model"),
        BuiltInFile::Recording(_) => ("bvh", "recording"),
    };
    if !args.output.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending)) {
        let problem = format!("a built-in {what} is written as {ending}; use a .{ending} file name");
        return Err(CliFailure::Input(format!("{}: {problem}", args.output.display())));
    }
    let bytes = match args.name {
        BuiltInFile::Model(model) => model.glb().to_vec(),
        BuiltInFile::Body => body_glb().to_vec(),
        BuiltInFile::Recording(recording) => recording.bvh_text().into_bytes(),
    };
    if holds_bytes(&args.output, &bytes) {
        return Ok(());
    }
    args.permission.write_file(&args.output, &bytes)
}
