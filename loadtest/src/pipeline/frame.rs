//! `loadtest frame`: one frame of a drag followed through, pass by pass, beside what the machine could do at best.

use super::points::PointScene;
use super::{MeasuredModel, PassClock, encode_positions, open_for_job, seconds_of, set_job_handles};
use crate::failure::LoadtestFailure;
use crate::measurements::{Measurements, median, time_once};
use crate::models::DragScene;
use pliant::engine::{Deformer, SolveMode, SolveSettings};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::{self, DeformOptions, pb};
use std::path::Path;

/// Frames before those that are counted.
const WARM_UP: u64 = 8;

/// The passes in the order in which they run, and what they do.
const PASSES: [(&str, &str); 12] = [
    (
        "blend",
        "every node's frame, and its place taken along with the handles",
    ),
    ("carry", "double precision alone: the last shape taken along"),
    ("equations", "double precision alone: the right-hand side"),
    ("load", "ties and soft pulls, the vectors of the cycles"),
    ("residual", "right-hand side and residual"),
    ("recall", "what earlier poses came to, taken out and kept"),
    ("cycles", "multigrid"),
    ("correct", "the correction added"),
    ("store", "double precision alone: out of the solver's order"),
    ("place", "surface nodes to their positions"),
    ("settle", "thin faces"),
    ("render", "render vertices, and what rides along"),
];

/// Arguments of `loadtest frame`.
#[derive(Debug, clap::Args)]
pub(crate) struct FrameArgs {
    #[command(flatten)]
    model: MeasuredModel,
    /// Frames to measure; a swing there and back is 120
    #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    frames: u64,
    /// Relative residual to reach
    #[arg(long, value_name = "TOLERANCE")]
    tolerance: Option<f64>,
    /// Largest error to reach, as a fraction of the diagonal
    #[arg(long, value_name = "ERROR")]
    max_error: Option<f64>,
    /// Point handles spread over the model that all move, in place of its two ends
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    handles: Option<u32>,
    /// Ask for gradients: what rides along turns and stretches too
    #[arg(long)]
    gradients: bool,
    /// Print one JSON document on stdout
    #[arg(long)]
    json: bool,
}

/// What was measured.
#[derive(Default)]
struct FrameRun {
    vertices: usize,
    nodes: usize,
    /// Nodes that are vertices of the surface.
    surface: usize,
    /// Neighbours of all nodes together.
    neighbours: usize,
    held_bytes: u64,
    /// Handles, seconds of setting them, and bytes that are held with them.
    handles: usize,
    set_handles: f64,
    handle_bytes: u64,
    /// Seconds of the first frame.
    first: f64,
    cycles: f64,
    /// Seconds of each pass, of encoding, and of whole frames; sorted.
    passes: [Vec<f64>; PASSES.len()],
    encode: Vec<f64>,
    frames: Vec<f64>,
    /// Seconds of working ahead, after frames that are worth it; sorted.
    ahead: Vec<f64>,
    /// Bytes a second that the machine reads at best.
    bandwidth: f64,
}

pub(crate) fn run_frame(args: &FrameArgs) -> Result<(), LoadtestFailure> {
    let pool = args.model.pool()?;
    let files = args.model.files()?;
    let ends = args.model.scene()?;
    let deformer = open_for_job(files, &ends.job(None), &Exec::new(&pool, &Silent)).map_err(LoadtestFailure::usage)?;
    let scene = match args.handles {
        None => FrameScene::Ends(ends),
        Some(count) => FrameScene::Points(PointScene::spread(deformer.rest(), count as usize)),
    };
    let run = drag_frames(deformer, &scene, args, &pool).map_err(LoadtestFailure::usage)?;
    if args.json {
        println!("{}", run.measurements(&args.model.path, &pool).to_json());
    } else {
        print!("{}", run.table(&args.model.path, &pool));
    }
    Ok(())
}

/// What moves.
enum FrameScene {
    /// One end of the model.
    Ends(DragScene),
    /// Points all over it.
    Points(PointScene),
}

impl FrameScene {
    fn job(&self) -> pb::Job {
        match self {
            Self::Ends(scene) => scene.job(None),
            Self::Points(scene) => scene.job(),
        }
    }

    fn pose_number(&self, seq: u64) -> pb::Pose {
        match self {
            Self::Ends(scene) => scene.pose_number(seq),
            Self::Points(scene) => scene.pose_number(seq),
        }
    }
}

/// Swings one end of the model, or all points, and measures every frame.
fn drag_frames(
    mut deformer: Deformer,
    scene: &FrameScene,
    args: &FrameArgs,
    pool: &Pool,
) -> Result<FrameRun, wire::Error> {
    let options = pb::Options {
        tolerance: args.tolerance.unwrap_or(0.0),
        max_error: args.max_error.unwrap_or(0.0),
        ..Default::default()
    };
    let settings = SolveSettings {
        gradients: args.gradients,
        ..DeformOptions::check(&options, "options", u32::MAX)?.solve
    };
    let clock = PassClock::new();
    let (job, without) = (scene.job(), deformer.byte_size());
    let exec = Exec::new(pool, &Silent);
    let (poses, set_handles) = time_once(|| set_job_handles(&mut deformer, &job, &exec));
    let mut poses = poses?;
    let mut run = FrameRun {
        handles: job.handles.len(),
        set_handles,
        handle_bytes: deformer.byte_size() - without,
        vertices: deformer.rest().len(),
        nodes: deformer.body().nodes(),
        surface: deformer.body().graph.surface,
        neighbours: deformer.body().graph.neighbours.len(),
        bandwidth: measure_bandwidth(pool),
        ..FrameRun::default()
    };
    for seq in 1..=WARM_UP + args.frames {
        poses = wire::change_poses(&deformer, &poses, &scene.pose_number(seq))?;
        let exec = Exec::new(pool, &clock);
        let (solved, solve) = time_once(|| deformer.solve(&poses, &settings, SolveMode::Drag, &exec, &mut |_| true));
        let (solved, passes) = (solved?, clock.take());
        let (_, encode) = time_once(|| encode_positions(solved.positions));
        let is_ahead = deformer.is_worth_settling();
        let (settled, settle) = time_once(|| deformer.settle(&Exec::new(pool, &Silent)));
        settled?;
        if seq == 1 {
            run.first = solve;
        }
        if seq > WARM_UP {
            run.cycles += f64::from(solved.stats.cycles) / args.frames as f64;
            (run.passes.iter_mut().zip(&PASSES)).for_each(|(all, pass)| all.push(seconds_of(&passes, pass.0)));
            run.encode.push(encode);
            run.frames.push(solve + encode);
            if is_ahead {
                run.ahead.push(settle);
            }
        }
    }
    run.held_bytes = deformer.byte_size();
    run.sort();
    Ok(run)
}

/// Bytes a second of reading memory in order with as many threads, of the best of a few passes over what no cache holds.
fn measure_bandwidth(pool: &Pool) -> f64 {
    const WORDS: usize = 32 << 20;
    let words = vec![1u64; WORDS];
    let share = WORDS.div_ceil(pool.threads());
    let pass = || {
        std::thread::scope(|scope| {
            for part in words.chunks(share) {
                scope.spawn(|| std::hint::black_box(part.iter().fold(0, |a, b| a ^ b)));
            }
        });
    };
    (0..5)
        .map(|_| (WORDS * 8) as f64 / time_once(pass).1)
        .fold(0.0, f64::max)
}

/// The 99th percentile.
fn p99(sorted: &[f64]) -> f64 {
    let last = sorted.len().saturating_sub(1);
    sorted.get((last as f64 * 0.99) as usize).copied().unwrap_or(0.0)
}

impl FrameRun {
    fn sort(&mut self) {
        let all = (self.passes.iter_mut()).chain([&mut self.encode, &mut self.frames, &mut self.ahead]);
        all.for_each(|seconds| seconds.sort_by(f64::total_cmp));
    }

    fn measurements(&self, model: &Path, pool: &Pool) -> Measurements {
        let mut m = Measurements::of_model(model);
        m.set_value("threads", pool.threads());
        m.set_value("vertices", self.vertices);
        m.set_value("nodes", self.nodes);
        m.set_value("handles", self.handles);
        m.set_number("set_handles_s", self.set_handles);
        m.set_number("handle_bytes_a_node", self.handle_bytes as f64 / self.nodes as f64);
        m.set_number("first_s", self.first);
        m.set_number("cycles", self.cycles);
        for ((pass, _), seconds) in PASSES.iter().zip(&self.passes) {
            m.set_number(&format!("{pass}_s"), median(seconds));
        }
        m.set_number("encode_s", median(&self.encode));
        m.set_number("frame_s", median(&self.frames));
        m.set_number("frame_p99_s", p99(&self.frames));
        m.set_number("ahead", self.ahead.len() as f64 / self.frames.len() as f64);
        m.set_number("ahead_s", median(&self.ahead));
        m.set_number("bytes_a_node", self.held_bytes as f64 / self.nodes as f64);
        m.set_number("bandwidth_GB_s", self.bandwidth / 1e9);
        m
    }

    /// Bytes for each node that a pass has to read and write, each once: what it would move if caches kept all that it meets twice.
    /// `None` for passes of no weight.
    fn needed_bytes(&self, pass: &str) -> Option<f64> {
        let a_node = |all: usize| all as f64 / self.nodes as f64;
        let surface = a_node(self.surface);
        Some(match pass {
            // A field, numbers of node and part; the place, read and written; rest, and the row.
            "blend" => 4.0 + 8.0 + 64.0 + 16.0 + 64.0,
            // The row, rest and its Laplacian; a number for each neighbour; the residual.
            "residual" => 64.0 + 32.0 + 4.0 * a_node(self.neighbours) + 16.0,
            // The residual twice and written; three kept steps twice, their products; the place; the step of this pose.
            "recall" => 48.0 + 3.0 * (16.0 + 32.0) + 64.0 + 32.0,
            // The row's number and place, the position.
            "place" => (4.0 + 32.0 + 24.0) * surface,
            "render" => 48.0 * a_node(self.vertices),
            "encode" => 36.0 * a_node(self.vertices),
            "frame" => {
                let passes = ["blend", "residual", "recall", "place", "render", "encode"];
                passes.iter().filter_map(|pass| self.needed_bytes(pass)).sum()
            }
            _ => return None,
        })
    }

    fn table(&self, model: &Path, pool: &Pool) -> String {
        let whole = median(&self.frames);
        let row = |name: &str, seconds: &[f64], what: &str| {
            let s = median(seconds);
            let needed = self
                .needed_bytes(name)
                .map_or(String::new(), |bytes| format!("{bytes:.0}"));
            format!(
                "{name:<10} {:>8.2} ms {:>8.2} ms {:>4.0} %  {:>7.1} {needed:>7} bytes a node  {what}\n",
                s * 1e3,
                p99(seconds) * 1e3,
                100.0 * s / whole,
                s * self.bandwidth / self.nodes as f64
            )
        };
        let mut text = format!(
            "{}: {} vertices, {} graph nodes, {} threads; medians and 99th percentiles of {} frames of a drag\n",
            model.display(),
            self.vertices,
            self.nodes,
            pool.threads(),
            self.frames.len()
        );
        for ((pass, what), seconds) in PASSES.iter().zip(&self.passes) {
            text += &row(pass, seconds, what);
        }
        text += &row("encode", &self.encode, "the frame's bytes, 32-bit positions");
        text += &row("frame", &self.frames, "all of it");
        text + &format!(
            "{} handles set in {:.1} ms, {:.0} bytes a node, first frame {:.1} ms\n{:.2} cycles a frame, 99th percentile {:.2} ms, {:.0} bytes held a node\n{:.2} times a frame {:.2} ms of working ahead once it is out\nmemory read in order: {:.1} GB/s; the first number of \"bytes a node\" is what it could have read in a pass's time, the second what the pass has to move\n",
            self.handles,
            self.set_handles * 1e3,
            self.handle_bytes as f64 / self.nodes as f64,
            self.first * 1e3,
            self.cycles,
            p99(&self.frames) * 1e3,
            self.held_bytes as f64 / self.nodes as f64,
            self.ahead.len() as f64 / self.frames.len() as f64,
            median(&self.ahead) * 1e3,
            self.bandwidth / 1e9
        )
    }
}
