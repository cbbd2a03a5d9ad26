//! `pliant animate`: a clip drives a model, frame by frame.

use super::frames_bar::FramesBar;
use super::output::{AnimationOutputArgs, RootRule};
use super::taken_frames::PlayedAnimation;
use crate::asset::{FileSet, Model};
use crate::batch::{AnimationOrder, ClipSource, frame_totals, left_out_passengers, moving_clip, play, prepare};
use crate::cli::deform::describe_change;
use crate::cli::failure::CliFailure;
use crate::cli::input_files::read_file;
use crate::cli::json_output::print_json;
use crate::cli::model_files::{in_file, read_model};
use crate::cli::stage_spinner::StageSpinner;
use crate::cli::stop_signals::raised_on_stop;
use crate::cli::threads::ThreadArgs;
use crate::deform::EdgeWeights;
use crate::engine::{
    AnimatedFrame, AnimationRefinement, AnimationSettings, Deformer, DeformerLimits, FrameChoice, FrameTimes,
    OpenOptions,
};
use crate::exec::Exec;
use crate::motion::MotionClip;
use crate::motion::bvh::{ClipLimits, read_bvh};
use crate::motion::rig::MotionRig;
use crate::progress::Silent;
use crate::wire::{self, Error, pb};
use clap::{Args, ValueEnum};
use sha2::{Digest as _, Sha256};
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

/// Most frames of an animation.
const MOST_FRAMES: usize = 1_000_000;

/// Arguments of `pliant animate`.
#[derive(Debug, Args)]
pub struct AnimateArgs {
    /// Model file: glb, gltf, obj, ply, off, stl or fbx
    model: PathBuf,
    /// Clip file (BVH)
    #[arg(long, conflicts_with = "clip")]
    bvh: Option<PathBuf>,
    /// Clip of the model file, by name or by number from 0
    #[arg(long)]
    clip: Option<String>,
    /// Rig file: the bones that the clip's joints drive [default: the model's skin for --clip, the result of `pliant rig` for --bvh]
    #[arg(long)]
    rig: Option<PathBuf>,
    #[command(flatten)]
    output: AnimationOutputArgs,
    /// Frames per second [default: the clip's]
    #[arg(long)]
    fps: Option<f64>,
    /// Frames to solve
    #[arg(long, value_name = "FIRST:COUNT")]
    frames: Option<String>,
    /// Skip the first frame, often a T-pose
    #[arg(long, value_enum, default_value_t = SkipFirst::Auto)]
    skip_first: SkipFirst,
    /// Rotation refinements of each frame: carried, or 0 to 32
    #[arg(long, default_value = "carried")]
    refine: String,
    /// Model units for one unit of the clip: auto, or a number
    #[arg(long, default_value = "auto")]
    scale: String,
    /// Relative residual to reach
    #[arg(long)]
    tolerance: Option<f64>,
    /// Edge weights of the surface
    #[arg(long, value_enum, default_value_t = SurfaceWeights::Cotangent)]
    weights: SurfaceWeights,
    /// Print a report as JSON on stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    threads: ThreadArgs,
}

/// Whether the first frame is left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SkipFirst {
    /// Skip it if it is far from the second.
    Auto,
    /// Always.
    Yes,
    /// Never.
    No,
}

/// Weights of the edges of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SurfaceWeights {
    /// From the angles opposite the edge.
    Cotangent,
    /// All equal, as in the paper.
    Uniform,
}

/// What an animation is made of, as files say it.
struct AnimationSources {
    files: FileSet,
    rig: Option<MotionRig>,
    /// A recorded clip.
    recorded: Option<MotionClip>,
    /// What identifies these sources: lines of a name and a value.
    identity: String,
}

/// Runs the command.
pub(in crate::cli) fn run_animate(args: &AnimateArgs) -> Result<(), CliFailure> {
    let settings = args.settings()?;
    let scale = args.scale()?;
    let output = args.output.output()?;
    let pool = args.threads.start_pool()?;
    let AnimationSources {
        files,
        rig,
        recorded,
        identity,
    } = args.sources()?;
    output.spare_companions_of(&args.model, &files)?;
    let spinner = StageSpinner::new(args.json);
    let exec = Exec::new(&pool, &spinner);
    let clock = Instant::now();
    let millis = || clock.elapsed().as_secs_f64() * 1e3;
    let deformer = args.open(files.clone(), &exec)?;
    let source = match (recorded, &args.clip) {
        (Some(clip), _) => ClipSource::Recorded(clip),
        (None, Some(name)) => ClipSource::OfModel(name),
        (None, None) => return Err(CliFailure::Input("give a clip, --bvh FILE or --clip NAME".into())),
    };
    let moving = moving_clip(&deformer, source, rig.as_ref(), &exec)?;
    let times = args.times(&moving.clip)?;
    let range = args.range(&times)?;
    let clip = args.clip_name(&moving.clip);
    let identity = identity + &output.identity() + &identity_of_frames(&range, &times);
    // Frames are taken while others are solved: on the threads that solve, taking one would wait for the end of a block.
    let taking = args.threads.start_pool()?;
    let quiet = Exec::new(&taking, &Silent);
    let own = moving.own;
    let mut order = AnimationOrder {
        times,
        ranges: vec![range.clone()],
        settings,
        blocks_at_once: pool.threads(),
        bakes_root: output.root == RootRule::Baked,
    };
    // What is refused here is refused before any file is begun.
    let animation = prepare(&deformer, moving, scale, &order, &exec)?;
    let mut taker = output.begin(PlayedAnimation {
        deformer: &deformer,
        animation: &animation,
        model: &args.model,
        files: &files,
        clip: &clip,
        own,
        times,
        range,
        identity: &identity,
        permission: output.permission,
        exec: quiet,
    })?;
    order.ranges = taker.missing();
    let ready = millis();
    spinner.finish();
    let stop = raised_on_stop()?;
    let bar = FramesBar::new(
        args.json,
        order.ranges.iter().map(ExactSizeIterator::len).sum(),
        Arc::clone(&stop),
    );
    let watched = Exec::new(&pool, &bar);
    let mut take = |frame: &AnimatedFrame, told: &pb::animation_report::FrameReport| -> Result<(), CliFailure> {
        bar.step();
        taker.take(frame, told)
    };
    let played = play(&animation, &order, &watched, &millis, &mut take);
    bar.finish();
    let finished = played.and_then(|mut report| taker.finish(&mut report, &animation, &watched).map(|()| report));
    let mut report = match finished {
        Err(CliFailure::Stopped(_)) => return Err(CliFailure::Stopped(taker.stop())),
        finished => finished?,
    };
    let ended = report.totals.unwrap_or_default();
    report.totals = Some(pb::animation_report::Totals {
        frames_per_second: ended.frames_per_second,
        ..frame_totals(&report.frames, ended.ms)
    });
    report.build_ms.insert("prepare".into(), ready);
    if args.json {
        return print_json(&report);
    }
    print_summary(&report, !deformer.report().closed);
    if let Some(place) = output.place() {
        eprintln!("{} -> {place}", args.model.display());
    }
    Ok(())
}

fn print_summary(report: &pb::AnimationReport, is_open: bool) {
    let ready = report.build_ms.get("prepare").copied().unwrap_or_default();
    let totals = report.totals.unwrap_or_default();
    for warning in &report.warnings {
        eprintln!("warning: {warning}");
    }
    let mut volume = describe_change(is_open, totals.volume_change_mean);
    if !is_open {
        let worst = describe_change(is_open, totals.volume_change_worst);
        volume += &format!(", at worst {worst}");
    }
    eprintln!(
        "{} frames, {:.1} a second after {:.0} ms; volume {volume}; {:.1} triangles flipped a frame, at worst {}",
        totals.frames, totals.frames_per_second, ready, totals.flipped_triangles_mean, totals.flipped_triangles_worst
    );
}

/// What identifies the requested frames: a line of a name and a value.
fn identity_of_frames(range: &Range<usize>, times: &FrameTimes) -> String {
    let (start, count) = (range.start, range.len());
    format!(
        "frames {start}:{count} of {} from {:?} at {:?}\n",
        times.count, times.start, times.rate
    )
}

/// Digests parts to a hexadecimal text.
fn digest_of<'a>(parts: impl IntoIterator<Item = &'a [u8]>) -> String {
    let mut hasher = Sha256::new();
    for part in parts {
        hasher.update((part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    let bytes = hasher.finalize();
    bytes.iter().take(16).map(|byte| format!("{byte:02x}")).collect()
}

impl AnimateArgs {
    /// Opens the model. Where it has a skin, what has none is not solved.
    fn open(&self, files: FileSet, exec: &Exec<'_>) -> Result<Deformer, CliFailure> {
        let limits = DeformerLimits::default();
        exec.progress.report("read", 0.0);
        let model = Model::read(files, None, &limits.model).map_err(Error::from)?;
        let mut options = OpenOptions {
            passengers: left_out_passengers(&model)?,
            ..Default::default()
        };
        options.body.graph.weights = match self.weights {
            SurfaceWeights::Cotangent => EdgeWeights::Cotangent,
            SurfaceWeights::Uniform => EdgeWeights::Uniform,
        };
        let opened = Deformer::of_model(model, &options, &limits, exec);
        Ok(opened.map_err(Error::from)?)
    }

    /// Reads the files that are named.
    fn sources(&self) -> Result<AnimationSources, CliFailure> {
        let mut identity = format!("pliant {}\n", env!("CARGO_PKG_VERSION"));
        if self.weights == SurfaceWeights::Uniform {
            identity += "weights uniform\n";
        }
        let mut rig = None;
        if let Some(path) = &self.rig {
            let text = read_file(path)?;
            rig = Some(wire::rig_from_json(&text).map_err(|e| in_file(path, e))?);
            identity += &format!("rig {}\n", digest_of([&text[..]]));
        }
        let mut recorded = None;
        if let Some(path) = &self.bvh {
            let text = read_file(path)?;
            let clip = read_bvh(&text, &ClipLimits::default());
            recorded = Some(clip.map_err(|e| CliFailure::Input(format!("{}: {e}", path.display())))?);
            identity += &format!("clip {}\n", digest_of([&text[..]]));
        }
        if let Some(name) = &self.clip {
            identity += &format!("clip {}\n", name.escape_debug());
        }
        let files = read_model(&self.model)?;
        let companions = files
            .companions
            .iter()
            .flat_map(|(name, bytes)| [name.as_bytes(), &bytes[..]]);
        let digest = digest_of([&files.main[..]].into_iter().chain(companions));
        let tolerance = self.tolerance.map_or_else(|| "usual".to_owned(), |t| format!("{t:?}"));
        identity += &format!(
            "model {digest}\nrefine {}\nscale {}\ntolerance {tolerance}\n",
            self.refine, self.scale
        );
        Ok(AnimationSources {
            files,
            rig,
            recorded,
            identity,
        })
    }

    /// What the clip is called in what is written.
    fn clip_name(&self, clip: &MotionClip) -> String {
        let stem = self.bvh.as_ref().and_then(|path| path.file_stem());
        let stem = stem.map(|stem| stem.to_string_lossy().into_owned());
        stem.filter(|_| clip.name.is_empty())
            .unwrap_or_else(|| clip.name.clone())
    }

    fn settings(&self) -> Result<AnimationSettings, CliFailure> {
        let refinement = match self.refine.as_str() {
            "carried" => AnimationRefinement::Carried,
            text => match text.parse::<u32>() {
                Ok(steps) if steps <= 32 => AnimationRefinement::Steps(steps),
                _ => {
                    let problem = format!("--refine is \"{text}\", allowed are carried and 0 to 32");
                    return Err(CliFailure::Input(problem));
                }
            },
        };
        let mut settings = AnimationSettings {
            refinement,
            ..Default::default()
        };
        if let Some(tolerance) = self.tolerance {
            if !(tolerance.is_finite() && (1e-12..1.0).contains(&tolerance)) {
                let problem = format!("--tolerance is {tolerance}, allowed is 1e-12 up to 1");
                return Err(CliFailure::Input(problem));
            }
            settings.tolerance = Some(tolerance);
            settings.max_error = None;
        }
        Ok(settings)
    }

    fn scale(&self) -> Result<Option<f64>, CliFailure> {
        match self.scale.as_str() {
            "auto" => Ok(None),
            text => match text.parse::<f64>() {
                Ok(scale) if MotionRig::SCALES.contains(&scale) => Ok(Some(scale)),
                _ => {
                    let problem = format!("--scale is \"{text}\", allowed are auto and numbers from 1e-12 to 1e12");
                    Err(CliFailure::Input(problem))
                }
            },
        }
    }

    /// When the frames of a clip are.
    fn times(&self, clip: &MotionClip) -> Result<FrameTimes, CliFailure> {
        if let Some(fps) = self
            .fps
            .filter(|fps| !(fps.is_finite() && *fps > 0.0 && *fps <= FrameChoice::FASTEST))
        {
            let fastest = FrameChoice::FASTEST;
            let problem = format!("--fps is {fps}, a number above 0 and up to {fastest} is needed");
            return Err(CliFailure::Input(problem));
        }
        let choice = FrameChoice {
            fps: self.fps,
            skip_first: match self.skip_first {
                SkipFirst::Auto => None,
                SkipFirst::Yes => Some(true),
                SkipFirst::No => Some(false),
            },
            ..Default::default()
        };
        let times = choice.times(clip);
        if times.count > MOST_FRAMES {
            let problem = format!(
                "{} frames are asked for, at most {MOST_FRAMES} are allowed",
                times.count
            );
            return Err(CliFailure::Input(problem));
        }
        Ok(times)
    }

    fn range(&self, times: &FrameTimes) -> Result<Range<usize>, CliFailure> {
        let Some(text) = &self.frames else {
            return Ok(0..times.count);
        };
        let parts = text.split_once(':');
        let parts = parts.and_then(|(a, b)| Some((a.parse::<usize>().ok()?, b.parse::<usize>().ok()?)));
        let Some((first, count)) = parts else {
            let problem = format!("--frames is \"{text}\", FIRST:COUNT is needed, such as 0:100");
            return Err(CliFailure::Input(problem));
        };
        if first >= times.count || count == 0 {
            let problem = format!(
                "--frames is \"{text}\", the animation has {} frames, counted from 0",
                times.count
            );
            return Err(CliFailure::Input(problem));
        }
        Ok(first..first.saturating_add(count).min(times.count))
    }
}
