//! `pliant animate`: a clip drives a model, frame by frame.
//!
//! This file reads arguments and runs; [`output`] names the outputs. [`numbered`] writes each frame as a model. For one file,
//! [`gathered`] collects frames in a partial file, so that a stopped animation can go on, and then writes a point cache or a GLB
//! ([`crate::engine::Animation::write_clip`] makes it). [`pictures`] draws frames as [`picture_args`] says, with the shapes of
//! another method if asked.

mod gathered;
mod numbered;
mod output;
mod picture_args;
mod pictures;
mod play;

use super::deform::describe_change;
use super::input_files::{in_file, read_file, read_model};
use super::terminal::{CliFailure, ComputeArgs, print_json, raised_on_stop, say};
use crate::asset::{FileSet, Model};
use crate::deform::EdgeWeights;
use crate::engine::{
    ANIMATION_QUALITY, AnimatedFrame, Animation, AnimationLimits, ClipRequest, ClipSource, Contact, Deformer,
    DeformerLimits, FrameChoice, OpenOptions, Quality, left_out_passengers,
};
use crate::exec::Exec;
use crate::motion::bvh::ClipLimits;
use crate::motion::rig::MotionRig;
use crate::progress::Silent;
use crate::wire::{Error, pb};
use crate::{engine, wire};
use clap::{Args, ValueEnum};
use output::{AnimationOutputArgs, RootRule};
use play::{FramesBar, PlayedAnimation, frame_totals, play};
use sha2::{Digest as _, Sha256};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

/// Most frames of an animation.
const MOST_FRAMES: usize = 1_000_000;

/// Arguments of `pliant animate`.
#[derive(Debug, Args)]
pub struct AnimateArgs {
    /// Model file: glb (or vrm), gltf, obj, ply, off, stl, 3mf, fbx, splat or spz
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
    /// Keep feet where they stand [default: of a recording whose legs drive the rig]
    #[arg(long, value_name = "BOOL")]
    plant_feet: Option<bool>,
    /// Count pairs of triangles that cross in each frame, and those that do not cross in the rest pose
    #[arg(long)]
    self_intersections: bool,
    /// What frames do about surfaces that the clip pushes through each other
    #[arg(long, value_enum, default_value_t = ContactChoice::Ignore)]
    contact: ContactChoice,
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
    compute: ComputeArgs,
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

/// What frames do about surfaces that cross.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ContactChoice {
    /// They cross.
    Ignore,
    /// They are moved apart, and pairs that still cross are counted.
    Avoid,
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
    clip: ClipSource,
    /// What identifies these sources: lines of a name and a value.
    identity: String,
}

/// Runs the command.
pub(in crate::cli) fn run_animate(args: &AnimateArgs) -> Result<(), CliFailure> {
    let quality = args.quality()?;
    let scale = args.scale()?;
    let frames = args.frame_choice()?;
    let output = args.output.output()?;
    let pool = args.compute.threads.start_pool()?;
    let sources = args.sources()?;
    output.spare_companions_of(&args.model, &sources.files)?;
    let spinner = args.compute.show_stages(args.json);
    let exec = Exec::new(&pool, &spinner);
    let clock = Instant::now();
    let millis = || clock.elapsed().as_secs_f64() * 1e3;
    let deformer = args.open(sources.files.clone(), &exec)?;
    let request = ClipRequest {
        clip: sources.clip,
        rig: sources.rig,
        frames,
        scale,
        plant_feet: args.plant_feet,
        quality,
        counts_crossings: args.counts_crossings(),
        contact: match args.contact {
            ContactChoice::Ignore => Contact::Ignored,
            ContactChoice::Avoid => Contact::Avoided { clearance: None },
        },
    };
    let limits = AnimationLimits {
        clip: ClipLimits::default(),
        frames: MOST_FRAMES,
        vertices: u64::MAX,
    };
    // What is refused here is refused before any file is begun.
    let prepared = Animation::prepare(&deformer, &request, &limits, &exec);
    let animation = prepared.map_err(|error| args.failure_of(error))?;
    let identity = sources.identity + &output.identity() + &identity_of_frames(&animation);
    // Frames are taken while others are solved: on the threads that solve, taking one would wait for the end of a block.
    let taking = args.compute.threads.start_pool()?;
    let mut taker = output.begin(PlayedAnimation {
        deformer: &deformer,
        animation: &animation,
        model: &args.model,
        files: &sources.files,
        identity: &identity,
        permission: output.permission,
        exec: Exec::new(&taking, &Silent),
    })?;
    let missing = taker.missing();
    let ready = millis();
    spinner.finish();
    let stop = raised_on_stop()?;
    let bar = FramesBar::new(
        &args.compute,
        args.json,
        missing.iter().map(ExactSizeIterator::len).sum(),
        Arc::clone(&stop),
    );
    let watched = Exec::new(&pool, &bar);
    let bakes_root = output.root == RootRule::Baked;
    let mut take = |frame: &AnimatedFrame, report: &pb::animation_report::FrameReport| {
        bar.step();
        taker.take(frame, report)
    };
    let played = play(&animation, &missing, bakes_root, &watched, &millis, &mut take);
    bar.finish();
    let finished = played.and_then(|mut report| taker.finish(&mut report, &watched).map(|()| report));
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
        say!("{} -> {place}", args.model.display());
    }
    Ok(())
}

fn print_summary(report: &pb::AnimationReport, is_open: bool) {
    let ready = report.build_ms.get("prepare").copied().unwrap_or_default();
    let totals = report.totals.unwrap_or_default();
    for warning in &report.warnings {
        say!("warning: {warning}");
    }
    let mut volume = describe_change(is_open, totals.volume_change_mean);
    if !is_open {
        let worst = describe_change(is_open, totals.volume_change_worst);
        volume += &format!(", at worst {worst}");
    }
    for foot in &report.feet {
        say!(
            "{} stands in {} frames, {} times; it slides by {:.2} % of the height a frame, {:.2} % as recorded",
            foot.bone,
            foot.planted_frames,
            foot.contacts.len(),
            100.0 * foot.drift_after,
            100.0 * foot.drift_before
        );
    }
    if let Some((mean, frames)) = totals.new_self_intersections_mean.zip(totals.crossing_frames) {
        let worst = totals.new_self_intersections_worst.unwrap_or_default();
        let place = (totals.worst_crossing_frame).map_or_else(String::new, |frame| format!(" in frame {frame}"));
        say!(
            "{mean:.1} pairs of triangles cross in a frame that do not in the rest pose, at worst {worst}{place}; {frames} frames have some"
        );
    }
    say!(
        "{} frames, {:.1} a second after {:.0} ms; volume {volume}; {:.1} triangles flipped a frame, at worst {}",
        totals.frames,
        totals.frames_per_second,
        ready,
        totals.flipped_triangles_mean,
        totals.flipped_triangles_worst
    );
}

/// What identifies the requested frames: a line of a name and a value.
fn identity_of_frames(animation: &Animation) -> String {
    let (range, times) = (animation.range(), animation.times());
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
        Ok(opened?)
    }

    /// Reads the files that are named.
    fn sources(&self) -> Result<AnimationSources, CliFailure> {
        let mut identity = format!("pliant {}\n", env!("CARGO_PKG_VERSION"));
        if self.weights == SurfaceWeights::Uniform {
            identity += "weights uniform\n";
        }
        if let Some(plant_feet) = self.plant_feet {
            identity += &format!("plant feet {plant_feet}\n");
        }
        if self.counts_crossings() {
            identity += "crossings are counted\n";
        }
        if self.contact == ContactChoice::Avoid {
            identity += "contact avoid\n";
        }
        let mut rig = None;
        if let Some(path) = &self.rig {
            let text = read_file(path)?;
            rig = Some(wire::rig_from_json(&text).map_err(|e| in_file(path, e))?);
            identity += &format!("rig {}\n", digest_of([&text[..]]));
        }
        let clip = match (&self.bvh, &self.clip) {
            (Some(path), _) => {
                let bytes = read_file(path)?;
                identity += &format!("clip {}\n", digest_of([&bytes[..]]));
                let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
                ClipSource::Bvh {
                    name: name.unwrap_or_default(),
                    bytes: bytes.into(),
                }
            }
            (None, Some(name)) => {
                identity += &format!("clip {}\n", name.escape_debug());
                ClipSource::OfModel(name.clone())
            }
            (None, None) => return Err(CliFailure::Input("give a clip, --bvh FILE or --clip NAME".into())),
        };
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
            clip,
            identity,
        })
    }

    fn counts_crossings(&self) -> bool {
        self.self_intersections || self.contact == ContactChoice::Avoid
    }

    fn quality(&self) -> Result<Quality, CliFailure> {
        let refine = match self.refine.as_str() {
            "carried" => None,
            text => match text.parse::<u32>() {
                Ok(steps) if steps <= 32 => Some(steps),
                _ => {
                    let problem = format!("--refine is \"{text}\", allowed are carried and 0 to 32");
                    return Err(CliFailure::Input(problem));
                }
            },
        };
        let mut quality = Quality {
            refine,
            ..ANIMATION_QUALITY
        };
        if let Some(tolerance) = self.tolerance {
            if !(tolerance.is_finite() && (1e-12..1.0).contains(&tolerance)) {
                let problem = format!("--tolerance is {tolerance}, allowed is 1e-12 up to 1");
                return Err(CliFailure::Input(problem));
            }
            quality.tolerance = Some(tolerance);
            quality.max_error = None;
        }
        Ok(quality)
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

    /// Which frames are wanted.
    fn frame_choice(&self) -> Result<FrameChoice, CliFailure> {
        if let Some(fps) = self
            .fps
            .filter(|fps| !(fps.is_finite() && *fps > 0.0 && *fps <= FrameChoice::FASTEST))
        {
            let fastest = FrameChoice::FASTEST;
            let problem = format!("--fps is {fps}, a number above 0 and up to {fastest} is needed");
            return Err(CliFailure::Input(problem));
        }
        let mut choice = FrameChoice {
            fps: self.fps,
            skip_first: match self.skip_first {
                SkipFirst::Auto => None,
                SkipFirst::Yes => Some(true),
                SkipFirst::No => Some(false),
            },
            ..Default::default()
        };
        if let Some(text) = &self.frames {
            let parts = text.split_once(':');
            let parts = parts.and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
            let Some((first, count)) = parts else {
                let problem = format!("--frames is \"{text}\", FIRST:COUNT is needed, such as 0:100");
                return Err(CliFailure::Input(problem));
            };
            (choice.first, choice.count) = (first, Some(count));
        }
        Ok(choice)
    }

    /// Why an animation cannot be prepared, by the names of the arguments.
    fn failure_of(&self, error: engine::Error) -> CliFailure {
        match (error, &self.bvh, &self.frames) {
            (engine::Error::Clip(e), Some(path), _) => CliFailure::Input(format!("{}: {e}", path.display())),
            (engine::Error::NoSuchFrames { frames, .. }, _, Some(text)) => CliFailure::Input(format!(
                "--frames is \"{text}\", the animation has {frames} frames, counted from 0"
            )),
            (engine::Error::TooLarge { what, seen, limit }, ..) if what == Animation::FRAMES => {
                CliFailure::Input(format!("{seen} frames are asked for, at most {limit} are allowed"))
            }
            (error, ..) => error.into(),
        }
    }
}
