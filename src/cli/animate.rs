//! `pliant animate`: a clip drives a model, frame by frame.

use super::failure::CliFailure;
use super::json_output::print_json;
use super::model_files::{output_format, read_file, read_model};
use super::output_files::OutputPermission;
use super::stage_spinner::StageSpinner;
use super::threads::ThreadArgs;
use crate::batch::{AnimationOrder, play, prepare};
use crate::engine::{AnimatedFrame, AnimationRefinement, AnimationSettings, DeformerLimits, FrameTimes, OpenOptions};
use crate::exec::Exec;
use crate::motion::MotionClip;
use crate::motion::bvh::{ClipLimits, read_bvh};
use crate::motion::rig::{DriveOptions, MotionRig, RigDriver};
use crate::wire::{self, Error};
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::time::Instant;

/// Arguments of `pliant animate`.
#[derive(Debug, Args)]
pub struct AnimateArgs {
    /// The model: glb, gltf, obj, ply, off, stl or fbx
    model: PathBuf,
    /// The clip, a BVH file
    #[arg(long)]
    bvh: PathBuf,
    /// Which bones of the model the clip's joints drive
    #[arg(long)]
    rig: PathBuf,
    /// Where to write: a folder of numbered models when it ends in a slash
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// Frames a second; the clip's own unless given
    #[arg(long)]
    fps: Option<f64>,
    /// Which frames, as FIRST:COUNT
    #[arg(long, value_name = "FIRST:COUNT")]
    frames: Option<String>,
    /// Whether the first frame, often a T-pose, is left out
    #[arg(long, value_enum, default_value_t = SkipFirst::Auto)]
    skip_first: SkipFirst,
    /// How often rotations are fitted in a frame: carried, or 0 to 32
    #[arg(long, default_value = "carried")]
    refine: String,
    /// Model units for one unit of the clip: auto, or a number
    #[arg(long, default_value = "auto")]
    scale: String,
    /// Relative residual to reach
    #[arg(long)]
    tolerance: Option<f64>,
    #[command(flatten)]
    permission: OutputPermission,
    /// Print a report as JSON on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// Whether the first frame is left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SkipFirst {
    /// Where it is far from the second.
    Auto,
    /// Always.
    Yes,
    /// Never.
    No,
}

/// Runs the command.
pub(super) fn run_animate(args: &AnimateArgs) -> Result<(), CliFailure> {
    let pool = args.threads.start_pool()?;
    let rig = wire::rig_from_json(&read_file(&args.rig)?).map_err(|e| in_file(&args.rig, e))?;
    let clip = read_bvh(&read_file(&args.bvh)?, &ClipLimits::default());
    let clip = clip.map_err(|e| CliFailure::Input(format!("{}: {e}", args.bvh.display())))?;
    let order = read_order(args, rig, clip, pool.threads())?;
    let files = read_model(&args.model)?;
    let spinner = StageSpinner::new(args.json);
    let exec = Exec::new(&pool, &spinner);
    let clock = Instant::now();
    let millis = || clock.elapsed().as_secs_f64() * 1e3;
    let options = OpenOptions::default();
    let (deformer, animation) = prepare(files, &options, &order, &DeformerLimits::default(), &exec)?;
    let ready = millis();
    let mut write = |frame: &AnimatedFrame| -> Result<(), CliFailure> {
        let Some(folder) = &args.output else { return Ok(()) };
        let path = folder.join(format!("frame_{:05}.obj", frame.index));
        let written = deformer
            .write(&frame.positions, output_format(&path)?)
            .map_err(Error::from)?;
        args.permission.write_file(&path, &written.main)
    };
    let mut report = play(&deformer, &animation, &order, &exec, &millis, &mut write)?;
    spinner.finish();
    report.build_ms.insert("prepare".into(), ready);
    if args.json {
        return print_json(&report);
    }
    let totals = report.totals.clone().unwrap_or_default();
    for warning in &report.warnings {
        eprintln!("warning: {warning}");
    }
    eprintln!(
        "{} frames, {:.1} a second after {:.0} ms; volume {:+.2} %, at worst {:+.2} %; {:.1} triangles flipped a frame, at worst {}",
        totals.frames,
        totals.frames_per_second,
        ready,
        100.0 * totals.volume_change_mean,
        100.0 * totals.volume_change_worst,
        totals.flipped_triangles_mean,
        totals.flipped_triangles_worst
    );
    Ok(())
}

fn in_file(path: &std::path::Path, e: Error) -> CliFailure {
    match CliFailure::from(e) {
        CliFailure::Input(text) => CliFailure::Input(format!("{}: {text}", path.display())),
        other => other,
    }
}

fn read_order(
    args: &AnimateArgs,
    rig: MotionRig,
    clip: MotionClip,
    threads: usize,
) -> Result<AnimationOrder, CliFailure> {
    let input = |problem: String| CliFailure::Input(problem);
    let recorded = clip.recorded;
    let rate = match (args.fps, recorded) {
        (Some(fps), _) if fps.is_finite() && fps > 0.0 && fps <= 1e4 => fps,
        (Some(fps), _) => {
            return Err(input(format!(
                "--fps is {fps}, a number above 0 and up to 10000 is needed"
            )));
        }
        (None, Some(recorded)) => 1.0 / recorded.interval,
        (None, None) => 30.0,
    };
    let skips = match args.skip_first {
        SkipFirst::Yes => true,
        SkipFirst::No => false,
        SkipFirst::Auto => clip.begins_apart(),
    };
    let start = if skips {
        recorded.map_or(0.0, |r| r.interval)
    } else {
        0.0
    };
    let times = FrameTimes::between(start, clip.duration, rate);
    let range = match &args.frames {
        None => 0..times.count,
        Some(text) => {
            let parts = text
                .split_once(':')
                .and_then(|(a, b)| Some((a.parse::<usize>().ok()?, b.parse::<usize>().ok()?)));
            let Some((first, count)) = parts else {
                return Err(input(format!(
                    "--frames is \"{text}\", FIRST:COUNT is needed, such as 0:100"
                )));
            };
            if first >= times.count || count == 0 {
                let problem = format!(
                    "--frames is \"{text}\", the animation has {} frames, counted from 0",
                    times.count
                );
                return Err(input(problem));
            }
            first..first.saturating_add(count).min(times.count)
        }
    };
    let refinement = match args.refine.as_str() {
        "carried" => AnimationRefinement::Carried,
        text => match text.parse::<u32>() {
            Ok(steps) if steps <= 32 => AnimationRefinement::Steps(steps),
            _ => {
                return Err(input(format!(
                    "--refine is \"{text}\", allowed are carried and 0 to 32"
                )));
            }
        },
    };
    let scale = match args.scale.as_str() {
        "auto" => None,
        text => match text.parse::<f64>() {
            Ok(scale) if scale.is_finite() && scale > 0.0 => Some(scale),
            _ => {
                return Err(input(format!(
                    "--scale is \"{text}\", allowed are auto and numbers above 0"
                )));
            }
        },
    };
    let options = DriveOptions {
        scale,
        reference: None,
        start,
    };
    let driver = RigDriver::new(&rig, clip, &options).map_err(Error::from)?;
    let mut settings = AnimationSettings {
        refinement,
        ..Default::default()
    };
    if let Some(tolerance) = args.tolerance {
        settings.tolerance = Some(tolerance);
        settings.max_error = None;
    }
    Ok(AnimationOrder {
        rig,
        driver,
        times,
        range,
        settings,
        blocks_at_once: threads,
        bakes_root: true,
    })
}
