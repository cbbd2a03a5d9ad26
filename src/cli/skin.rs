//! `pliant skin`: a model bound to the bones of a rig, as a glTF that any engine poses.

use super::failure::CliFailure;
use super::input_files::read_file;
use super::input_files::{in_file, read_model};
use super::output_files::OutputPermission;
use super::terminal::StageSpinner;
use super::terminal::ThreadArgs;
use crate::asset::{CarryingJoints, Limits, Model, SkinnedClip};
use crate::cli::terminal::print_value;
use crate::engine::{bind_model, carrying_joints};
use crate::exec::Exec;
use crate::wire::{self, Error};
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;

/// Arguments of `pliant skin`.
#[derive(Debug, Args)]
pub struct SkinArgs {
    /// Model file: glb, gltf, obj, ply, off, stl or fbx
    model: PathBuf,
    /// Rig file of `pliant rig`
    #[arg(long)]
    rig: PathBuf,
    /// Output file of the skinned model (.glb)
    #[arg(short, long, value_name = "MODEL")]
    output: PathBuf,
    #[command(flatten)]
    permission: OutputPermission,
    /// Maximum bone influences per vertex, 1 to 8; many engines take 4
    #[arg(long, value_name = "COUNT", default_value_t = 4)]
    influences: usize,
    /// Print a report as JSON on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// Runs the command.
pub(super) fn run_skin(args: &SkinArgs) -> Result<(), CliFailure> {
    if !args.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb")) {
        let problem = "a skinned model is written as glb; use a .glb file name";
        return Err(CliFailure::Input(format!("{}: {problem}", args.output.display())));
    }
    args.permission.check_target(&args.output)?;
    let pool = args.threads.start_pool()?;
    let rig = wire::rig_from_json(&read_file(&args.rig)?).map_err(|e| in_file(&args.rig, e))?;
    let files = read_model(&args.model)?;
    let spinner = StageSpinner::new(args.json);
    let clock = Instant::now();
    let model = Model::read(files.clone(), None, &Limits::default())
        .map_err(|e| CliFailure::Input(format!("{}: {e}", args.model.display())))?;
    let bound = bind_model(&model, &rig, args.influences, &Exec::new(&pool, &spinner))?;
    let influences: Vec<CarryingJoints> = bound.influences.iter().map(carrying_joints).collect();
    let written = model.write_skinned_clip(&SkinnedClip {
        name: "",
        influences: &influences,
        joints: &bound.joints,
        times: &[],
        frames: &[],
        root: None,
        correctives: None,
        beside: None,
    });
    let written = written.map_err(Error::from)?;
    spinner.finish();
    args.permission
        .write_model(&args.output, &written, &args.model, &files)?;
    let ms = clock.elapsed().as_secs_f64() * 1e3;
    let unweighted = bound
        .influences
        .iter()
        .filter(|own| own.iter().next().is_none())
        .count();
    let most = bound.influences.iter().map(|own| own.iter().count()).max().unwrap_or(0);
    let (vertices, bones) = (influences.len(), bound.joints.len());
    let mut held = vec![0u32; bones];
    bound
        .influences
        .iter()
        .for_each(|own| held[usize::from(own.bones[0])] += 1);
    let idle: Vec<&str> = (bound.joints.iter().zip(&held))
        .filter(|(_, held)| **held == 0)
        .map(|(joint, _)| joint.name.as_str())
        .collect();
    if args.json {
        return print_value(&json!({
            "vertices": vertices,
            "unweighted": unweighted,
            "bones": bones,
            "influences": most,
            "ms": ms,
            "heldByBone": bound.joints.iter().zip(&held).map(|(joint, held)| json!({"bone": joint.name, "vertices": held})).collect::<Vec<_>>(),
            "output": args.output.display().to_string(),
        }));
    }
    if !idle.is_empty() {
        let names = idle.join("\", \"");
        eprintln!("warning: no vertex follows \"{names}\" most");
    }
    eprintln!(
        "{} -> {}: {vertices} vertices on {bones} bones, at most {most} each, {unweighted} without a weight; {ms:.0} ms",
        args.model.display(),
        args.output.display()
    );
    Ok(())
}
