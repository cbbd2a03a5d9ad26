//! Command lines to begin with, at the end of each command's `--help`.
//!
//! `pliant sample`: a built-in model or recording as a file, for trying things where none is at hand.

use super::output_files::{OutputPermission, check_ending, holds_bytes};
use super::terminal::CliFailure;
use crate::asset::sample::{BuiltInModel, BuiltInRecording, body_glb};
use clap::Args;
use std::path::PathBuf;

/// `pliant --help`.
pub(super) const PLIANT: &str = "\
Examples:
  pliant sample -o creature.glb                       a model to try things with
  pliant inspect creature.glb                         its statistics and warnings
  pliant serve                                        a server; its viewer is at http://127.0.0.1:7411
  pliant deform model.glb --job job.json -o bent.glb   a model deformed without a server";

/// `pliant serve --help`.
pub(super) const SERVE: &str = "\
Examples:
  pliant serve                                        for this machine only, sessions in memory
  pliant serve --listen 0.0.0.0:7411 --config pliant.toml
  pliant serve --data-dir sessions                    sessions outlive the server
  PLIANT_MEMORY_BYTES=2GiB pliant serve               any key as an environment variable";

/// `pliant deform --help`.
pub(super) const DEFORM: &str = "\
Examples:
  pliant deform model.glb --job job.json -o bent.glb
  pliant deform scan.ply --job job.json -o bent.obj --json
  pliant deform model.glb --job job.json -o bent.glb --steps steps --force";

/// `pliant inspect --help`.
pub(super) const INSPECT: &str = "\
Examples:
  pliant inspect model.glb
  pliant inspect model.glb --json";

/// `pliant check --help`.
pub(super) const CHECK: &str = "\
Examples:
  pliant check suite                                  compare every case with its golden
  pliant check suite --html report.html --junit report.xml
  pliant check suite --new bend --model models/bar.obj --job jobs/bend.json
  pliant check suite --bless                          store the results as goldens
  pliant check suite --case bend --case 'twist*'      only these cases
  pliant check suite --shard 3/8 --report shards/3.json
  pliant check --merge shards --html report.html      the report of one run of all shards
  pliant check suite --server https://pliant.example.com --token SECRET";

/// `pliant animate --help`.
pub(super) const ANIMATE: &str = "\
Examples:
  pliant animate figure.glb --clip 0 -o walk.glb      a clip of the model file
  pliant animate figure.glb --bvh walk.bvh -o walk.glb      a BVH recording, with an automatic rig
  pliant animate model.obj --bvh walk.bvh --rig rig.json -o walk.glb
  pliant animate model.obj --bvh walk.bvh --rig rig.json -o frames --frames 0:120 --fps 30";

/// `pliant rig --help`.
pub(super) const RIG: &str = "\
Examples:
  pliant rig model.obj --bvh walk.bvh -o rig.json --picture rig.png
  pliant rig model.obj --preset mixamo -o rig.json --at lElbow=0.4,1.2,0";

/// `pliant skin --help`.
pub(super) const SKIN: &str = "\
Examples:
  pliant skin model.obj --rig rig.json -o skinned.glb
  pliant skin model.obj --rig rig.json -o skinned.glb --influences 8";

/// `pliant wrap --help`.
pub(super) const WRAP: &str = "\
Examples:
  pliant wrap body.glb scan.ply -o wrapped.glb        placed by the shapes
  pliant wrap head.glb scan.obj --landmarks landmarks.json -o wrapped.glb --picture wrapped.png
  pliant wrap head.glb scan.obj --landmarks landmarks.json -o wrapped.glb --report report.json";

/// `pliant transfer --help`.
pub(super) const TRANSFER: &str = "\
Examples:
  pliant transfer head.glb other.glb -o other-shapes.glb --landmarks landmarks.json --picture shapes.png
  pliant transfer body.obj other.glb --shape posed.obj -o other-posed.glb";

/// `pliant fit --help`.
pub(super) const FIT: &str = "\
Examples:
  pliant fit vest.glb body.glb other-body.glb -o other-vest.glb
  pliant fit vest.glb body.glb other-body.glb -o other-vest.glb --landmarks landmarks.json --clearance 0.004
  pliant fit vest.glb body.glb other-body.glb -o other-vest.glb --picture vests.png --view three-quarter";

/// `pliant render --help`.
pub(super) const RENDER: &str = "\
Examples:
  pliant render bent.glb -o bent.png
  pliant render bent.glb --before model.glb -o both.png --marks 3
  pliant render figure.glb -o head.png --primitive head --primitive eyes
  pliant render bent.glb -o around.png --turntable 8 --size 400x400
  pliant render old.glb new.glb -o sides.png --view front,side,three-quarter
  pliant render bent.glb --before model.glb --color crossings -o crossing.png --close-up worst";

/// `pliant sample --help`.
pub(super) const SAMPLE: &str = "\
Examples:
  pliant sample -o creature.glb
  pliant sample figure -o figure.glb
  pliant sample boxing -o boxing.bvh";

/// `pliant mcp --help`.
pub(super) const MCP: &str = "\
Examples:
  pliant mcp --root models";

/// `pliant token --help`.
pub(super) const TOKEN: &str = "\
Examples:
  pliant token studio
  pliant token studio --name build-machine --expires 2030-01-31";

/// `pliant store --help`.
pub(super) const STORE: &str = "\
Examples:
  pliant store list --data-dir sessions
  pliant store check --data-dir sessions --replay
  pliant store export ID shape.glb --data-dir sessions
  pliant store prune --data-dir sessions --unused-for 90d --dry-run";

/// `pliant health --help`.
pub(super) const HEALTH: &str = "\
Examples:
  pliant health                                       the server of this machine
  pliant health --config pliant.toml                  the server with this configuration
  pliant health https://pliant.example.com --live";

/// `pliant audit --help`.
pub(super) const AUDIT: &str = "\
Examples:
  pliant audit --data-dir sessions --since 12h
  pliant audit --data-dir sessions --tenant studio
  pliant audit --config pliant.toml                   the server with this configuration";

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

pub(super) fn run_sample(args: &SampleArgs) -> Result<(), CliFailure> {
    let (ending, what) = match args.name {
        BuiltInFile::Model(_) | BuiltInFile::Body => ("glb", "a built-in model"),
        BuiltInFile::Recording(_) => ("bvh", "a built-in recording"),
    };
    check_ending(&args.output, ending, what)?;
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

#[cfg(test)]
mod tests {
    use crate::cli::PliantArgs;
    use clap::{CommandFactory as _, Parser as _};

    /// The command of an example, without assignments before it and the text beside it.
    fn words(line: &str) -> Vec<&str> {
        let line = line.trim();
        let command = line.split_once("   ").map_or(line, |(command, _)| command);
        command
            .split_whitespace()
            .skip_while(|word| word.contains('='))
            .collect()
    }

    #[test]
    fn every_command_shows_examples_that_it_takes() {
        let mut shown = 0;
        let main = PliantArgs::command();
        for command in [&main].into_iter().chain(main.get_subcommands()) {
            let name = command.get_name();
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            let examples: Vec<&str> = help.lines().skip(1).collect();
            assert!(help.starts_with("Examples:\n") && !examples.is_empty(), "{name}");
            for example in examples {
                let words = words(example);
                assert!(name == "pliant" || words[1] == name, "{example}");
                if let Err(problem) = PliantArgs::try_parse_from(words) {
                    panic!("{example}: {problem}");
                }
                shown += 1;
            }
        }
        assert!(shown > 30, "{shown}");
    }
}
