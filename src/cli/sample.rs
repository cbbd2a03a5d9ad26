//! `pliant sample`: a built-in model as a file, for trying things where no model is at hand.

use super::failure::CliFailure;
use super::output_files::OutputPermission;
use crate::asset::sample::BuiltInModel;
use clap::Args;
use std::path::PathBuf;

/// Arguments of `pliant sample`.
#[derive(Debug, Args)]
pub struct SampleArgs {
    /// creature: one closed mesh; figure: a person with a skeleton, clips, levels of detail, a hull and sockets
    #[arg(default_value = "creature", value_parser = parse_name)]
    name: BuiltInModel,
    /// Where to write it, a glb file
    #[arg(short, long, value_name = "MODEL")]
    output: PathBuf,
    #[command(flatten)]
    permission: OutputPermission,
}

fn parse_name(text: &str) -> Result<BuiltInModel, String> {
    BuiltInModel::from_name(text).ok_or_else(|| format!("there is {}", BuiltInModel::name_list()))
}

/// Runs the command.
pub(super) fn run_sample(args: &SampleArgs) -> Result<(), CliFailure> {
    if !args.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb")) {
        let problem = "a built-in model is written as glb, its extension must say so";
        return Err(CliFailure::Input(format!("{}: {problem}", args.output.display())));
    }
    args.permission.check_target(&args.output)?;
    args.permission.write_file(&args.output, &args.name.glb())
}
