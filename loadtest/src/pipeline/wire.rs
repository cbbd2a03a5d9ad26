//! `loadtest wire`: what a frame of a drag takes on its way from positions to a socket, encoding by encoding.

use super::{open_for_job, set_job_handles};
use crate::failure::LoadtestFailure;
use crate::measurements::{Measurements, median, time_once};
use crate::models::{DragScene, read_model_file};
use glam::DVec3;
use pliant::engine::{Shader, Shading, SolveMode};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::frames::{Frame, FrameEncoding, FrameOutput, SentSteps, encode_next};
use pliant::wire::pb::deform_response::Message as Response;
use pliant::wire::{self, DeformOptions, pb};
use prost::Message as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Bytes of a frame's part, as servers send them.
const PART: usize = 1 << 20;

/// Frames before those that are counted.
const WARM_UP: u64 = 8;

const ENCODINGS: [(&str, FrameEncoding); 4] = [
    ("F32", FrameEncoding::F32),
    ("U16", FrameEncoding::U16),
    ("MESHOPT", FrameEncoding::Meshopt),
    ("DELTA", FrameEncoding::Delta),
];

/// Arguments of `loadtest wire`.
#[derive(Debug, clap::Args)]
pub(crate) struct WireArgs {
    /// Model file: glb or gltf with embedded buffers, obj, ply, off, stl or 3mf
    model: PathBuf,
    /// Frames to measure; a swing there and back is 120
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    frames: u64,
    /// Fraction of the diagonal: frames with changes only leave out vertices that moved less
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0)]
    changed: f64,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

/// One way of sending frames, and what it took.
#[derive(Default)]
struct WireRow {
    name: String,
    output: FrameOutput,
    /// Seconds of each frame, sorted.
    seconds: Vec<f64>,
    bytes: usize,
    /// What its reader holds.
    sent: SentSteps,
    /// Frames that stood for themselves.
    keys: usize,
}

impl WireRow {
    fn bytes_a_frame(&self) -> f64 {
        self.bytes as f64 / self.seconds.len().max(1) as f64
    }
}

/// The shapes of a drag, with their normals, and the length of the model's diagonal.
struct DraggedShapes {
    shapes: Vec<(Arc<Vec<DVec3>>, Arc<Shading>)>,
    diagonal: f64,
}

pub(crate) fn run_wire(args: &WireArgs) -> Result<(), LoadtestFailure> {
    let dragged = drag(args)?;
    let mut rows = Vec::new();
    for changed_only in [None, Some(args.changed)] {
        for normals in [false, true] {
            for (name, encoding) in ENCODINGS {
                if encoding == FrameEncoding::Delta && changed_only.is_some() {
                    continue;
                }
                let suffix = |on: bool, text: &'static str| if on { text } else { "" };
                let name = format!(
                    "{name}{}{}",
                    suffix(normals, " normals"),
                    suffix(changed_only.is_some(), " changed")
                );
                let output = FrameOutput {
                    normals,
                    changed_only,
                    encoding,
                    ..FrameOutput::default()
                };
                rows.push(WireRow {
                    name,
                    output,
                    ..WireRow::default()
                });
            }
        }
    }
    // Frame by frame through all rows, so that what disturbs the machine disturbs all of them.
    for pair in dragged.shapes.windows(2) {
        let [(before, _), (positions, shading)] = pair else {
            continue;
        };
        for row in &mut rows {
            let selected = (row.output.changed_only).map(|part| moved(positions, before, part * dragged.diagonal));
            let request = Frame {
                positions: Arc::clone(positions),
                shading: row.output.normals.then(|| Arc::clone(shading)),
                output: row.output,
                selected,
                part_bytes: PART,
                ..Frame::default()
            };
            let sent = std::mem::take(&mut row.sent);
            let ((bytes, is_key, sent), seconds) = time_once(|| send(request, sent));
            row.sent = sent;
            row.keys += usize::from(is_key);
            row.bytes += bytes;
            row.seconds.push(seconds);
        }
    }
    rows.iter_mut().for_each(|row| row.seconds.sort_by(f64::total_cmp));
    for (name, prediction) in PREDICTIONS {
        rows.push(predicted(name, &dragged.shapes, prediction));
    }
    let vertices = dragged.shapes.first().map_or(0, |(p, _)| p.len());
    if args.json {
        println!("{}", measurements(&args.model, vertices, &rows).to_json());
    } else {
        print!("{}", table(&args.model, vertices, &rows));
    }
    Ok(())
}

/// Makes every message of a frame as it is handed to a connection; answers their bytes, whether it stands for itself, and what the
/// reader holds then.
fn send(request: Frame, sent: SentSteps) -> (usize, bool, SentSteps) {
    let mut parts = encode_next(request, sent);
    let (mut bytes, mut is_key) = (0, true);
    while let Some(part) = parts.next_part() {
        is_key &=
            !matches!(part.message(), Some(Response::Frame(head)) if head.encoding() == pb::frame::Encoding::Delta);
        bytes += std::hint::black_box(part.encode_to_vec()).len();
    }
    (bytes, is_key, parts.into_sent())
}

/// A place in steps of a box that stays the same over a drag.
type StepPlaces = Vec<[i32; 3]>;

/// Predicts a number from its values in the last two frames.
type Prediction = fn([i32; 2]) -> i32;

/// Predictions other than the last frame: the frame before it, or the linear extrapolation of the two.
const PREDICTIONS: [(&str, Prediction); 2] = [
    ("MESHOPT minus earlier", |[earlier, _]| earlier),
    ("MESHOPT minus led to", |[earlier, last]| 2 * last - earlier),
];

/// What frames would take if MESHOPT coded their differences from a prediction. No server sends them.
fn predicted(name: &str, shapes: &[(Arc<Vec<DVec3>>, Arc<Shading>)], prediction: fn([i32; 2]) -> i32) -> WireRow {
    let points = || shapes.iter().flat_map(|(positions, _)| positions.iter());
    let low = points().fold(DVec3::INFINITY, |a, &b| a.min(b));
    let span = points().fold(DVec3::NEG_INFINITY, |a, &b| a.max(b)) - low;
    let steps = |positions: &[DVec3]| -> StepPlaces {
        let step = |p: &DVec3| ((*p - low) / span * 65535.0).round().to_array().map(|x| x as i32);
        positions.iter().map(step).collect()
    };
    let mut row = WireRow {
        name: name.to_owned(),
        ..WireRow::default()
    };
    let mut earlier = shapes.first().map(|(p, _)| steps(p)).unwrap_or_default();
    let mut last = earlier.clone();
    for (positions, _) in shapes.iter().skip(1) {
        let ((now, coded), seconds) = time_once(|| {
            let now = steps(positions);
            let differs = |v: usize| {
                let of = |k: usize| (now[v][k] - prediction([earlier[v][k], last[v][k]])) as u16;
                [of(0), of(1), of(2), 0]
            };
            let differences: Vec<[u16; 4]> = (0..now.len()).map(differs).collect();
            let coded = meshopt::encode_vertex_buffer(&differences).map_or(0, |coded| coded.len());
            (now, coded)
        });
        row.bytes += coded;
        row.seconds.push(seconds);
        earlier = std::mem::replace(&mut last, now);
    }
    row.seconds.sort_by(f64::total_cmp);
    row
}

/// Vertices further than `distance` from where they were, both as 32-bit floats.
fn moved(positions: &[DVec3], before: &[DVec3], distance: f64) -> Vec<u32> {
    let far = |(a, b): (&DVec3, &DVec3)| (a.as_vec3().as_dvec3() - b.as_vec3().as_dvec3()).length() > distance;
    let all = (0u32..).zip(positions.iter().zip(before));
    all.filter(|(_, pair)| far(*pair)).map(|(v, _)| v).collect()
}

/// Swings one end of the model and keeps every shape.
fn drag(args: &WireArgs) -> Result<DraggedShapes, LoadtestFailure> {
    let pool = Pool::new(0)?;
    let exec = Exec::new(&pool, &Silent);
    let scene = DragScene::load(Some(&args.model))?;
    let (job, files) = (scene.job(None), read_model_file(&args.model)?);
    let mut deformer = open_for_job(files, &job, &exec).map_err(LoadtestFailure::usage)?;
    let mut poses = set_job_handles(&mut deformer, &job, &exec).map_err(LoadtestFailure::usage)?;
    let settings =
        DeformOptions::check(&pb::Options::default(), "options", u32::MAX).map_err(LoadtestFailure::usage)?;
    let shader = Shader::from_geometry(deformer.geometry(), deformer.rest());
    let mut shapes = Vec::new();
    for seq in 1..=WARM_UP + args.frames {
        poses = wire::change_poses(&deformer, &poses, &scene.pose_number(seq)).map_err(LoadtestFailure::usage)?;
        let solved = deformer.solve(&poses, &settings.solve, SolveMode::Drag, &exec, &mut |_| true);
        let positions = solved.map_err(LoadtestFailure::usage)?.positions;
        // Each frame goes out beside the one before.
        if seq >= WARM_UP {
            let shading = Arc::new(shader.shade(&positions));
            shapes.push((positions, shading));
        }
    }
    let diagonal = deformer.diagonal();
    Ok(DraggedShapes { shapes, diagonal })
}

fn measurements(model: &Path, vertices: usize, rows: &[WireRow]) -> Measurements {
    let mut m = Measurements::of_model(model);
    m.set_value("vertices", vertices);
    for row in rows {
        let name = row.name.to_lowercase().replace(' ', "_");
        m.set_number(&format!("{name}_s"), median(&row.seconds));
        m.set_number(&format!("{name}_bytes"), row.bytes_a_frame());
        if row.output.encoding == FrameEncoding::Delta {
            m.set_value(&format!("{name}_key_frames"), row.keys);
        }
    }
    m
}

fn table(model: &Path, vertices: usize, rows: &[WireRow]) -> String {
    let frames = rows.first().map_or(0, |row| row.seconds.len());
    let mut text = format!(
        "{}: {vertices} vertices; medians of {frames} frames of a drag, from positions to the bytes of messages\n",
        model.display()
    );
    for row in rows {
        let bytes = row.bytes_a_frame();
        text += &format!(
            "{:<24} {:>8.3} ms {:>9.1} KiB a frame {:>6.2} bytes a vertex{}\n",
            row.name,
            median(&row.seconds) * 1e3,
            bytes / 1024.0,
            bytes / vertices.max(1) as f64,
            if row.output.encoding == FrameEncoding::Delta {
                format!("  {} key frames", row.keys)
            } else {
                String::new()
            }
        );
    }
    text
}
