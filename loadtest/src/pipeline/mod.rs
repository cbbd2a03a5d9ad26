//! The whole pipeline, timed stage by stage: from a model to its first frame, and from an edit to the next frame.

pub(crate) mod edits;
pub(crate) mod first_frame;
pub(crate) mod frame;
pub(crate) mod wire;

use crate::failure::LoadtestFailure;
use crate::models::{DragScene, FARTHEST_POSE, MOST_SUBDIVISIONS, read_job_file, read_model_file, subdivide_model};
use glam::DVec3;
use pliant::asset::FileSet;
use pliant::batch::pose_steps;
use pliant::engine::{Deformer, DeformerLimits, HandlePoses};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Progress;
use pliant::wire::frames::{Frame, FrameOutput, encode};
use pliant::wire::{self as schema, pb};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Bytes of a frame's part, as servers send them.
const PART: usize = 256 << 10;

/// The model of a command, and the threads that it is measured on.
#[derive(Debug, clap::Args)]
pub(crate) struct MeasuredModel {
    /// Model file: glb or gltf with embedded buffers, obj, ply, off or stl
    #[arg(value_name = "MODEL")]
    path: PathBuf,
    /// Number of subdivisions of every triangle into four beforehand, not timed
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=i64::from(MOST_SUBDIVISIONS)))]
    subdivide: u8,
    /// Threads; 0 means one per core
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u16).range(0..=1024))]
    threads: u16,
}

impl MeasuredModel {
    fn pool(&self) -> Result<Pool, LoadtestFailure> {
        Ok(Pool::new(usize::from(self.threads))?)
    }

    /// The model's file, subdivided.
    fn files(&self) -> Result<FileSet, LoadtestFailure> {
        subdivide_model(read_model_file(&self.path)?, self.subdivide)
    }

    fn scene(&self) -> Result<DragScene, LoadtestFailure> {
        DragScene::load(Some(&self.path))
    }

    /// A failure that names the model.
    fn refusal(&self, problem: impl std::fmt::Display) -> LoadtestFailure {
        LoadtestFailure::Usage(format!("{}: {problem}", self.path.display()))
    }

    /// The job of this file; without one, the ends of the model as handles, one of them as far from rest as it gets.
    fn job(&self, file: Option<&Path>) -> Result<pb::Job, LoadtestFailure> {
        match file {
            Some(path) => read_job_file(path),
            None => Ok(self.scene()?.job(Some(FARTHEST_POSE))),
        }
    }
}

/// Opens a model as a job asks for it, without its handles.
pub(crate) fn open_for_job(files: FileSet, job: &pb::Job, exec: &Exec<'_>) -> Result<Deformer, schema::Error> {
    let options = schema::open_options(&job.create.clone().unwrap_or_default())?;
    Ok(Deformer::open(files, &options, &DeformerLimits::default(), exec)?)
}

/// Sets a job's handles; returns the poses after its last step.
pub(crate) fn set_job_handles(
    deformer: &mut Deformer,
    job: &pb::Job,
    exec: &Exec<'_>,
) -> Result<HandlePoses, schema::Error> {
    let request = pb::SetHandlesRequest {
        handles: job.handles.clone(),
        symmetry_plane: job.symmetry_plane.clone(),
        region_of_interest: job.region_of_interest.clone(),
        ..Default::default()
    };
    deformer.set_handles(schema::handle_set(&request)?, exec)?;
    let mut poses = deformer.initial_poses();
    for pose in pose_steps(job)? {
        poses = schema::change_poses(deformer, &poses, &pose)?;
    }
    Ok(poses)
}

/// Makes the parts of a frame, 32-bit positions; returns the bytes of their data.
fn encode_positions(positions: Arc<Vec<DVec3>>) -> usize {
    let parts = encode(Frame {
        positions,
        output: FrameOutput::default(),
        part_bytes: PART,
        ..Frame::default()
    });
    std::hint::black_box(parts.map(|part| part.data.len()).sum())
}

/// Clocks passes.
pub(crate) struct PassClock {
    start: Instant,
    passes: Mutex<ClockedPasses>,
}

/// Passes with seconds.
#[derive(Default)]
struct ClockedPasses {
    /// The one under way, and when it began.
    current: Option<(&'static str, f64)>,
    /// Those before it, in the order in which they first began, and how long they took.
    done: Vec<(&'static str, f64)>,
}

impl PassClock {
    /// Creates a clock on which nothing runs.
    pub(crate) fn new() -> Self {
        Self {
            start: Instant::now(),
            passes: Mutex::default(),
        }
    }

    fn switch_to(&self, next: Option<&'static str>) {
        let now = self.start.elapsed().as_secs_f64();
        let mut passes = self.passes.lock().unwrap_or_else(PoisonError::into_inner);
        let ClockedPasses { current, done } = &mut *passes;
        if let Some((pass, begun)) = current.take() {
            match done.iter_mut().find(|(name, _)| *name == pass) {
                Some((_, seconds)) => *seconds += now - begun,
                None => done.push((pass, now - begun)),
            }
        }
        *current = next.map(|pass| (pass, now));
    }

    /// Ends the pass under way. Returns the seconds of every pass since the last time, in the order in which they first began.
    pub(crate) fn take(&self) -> Vec<(&'static str, f64)> {
        self.switch_to(None);
        let mut passes = self.passes.lock().unwrap_or_else(PoisonError::into_inner);
        std::mem::take(&mut passes.done)
    }
}

impl Progress for PassClock {
    fn begin_pass(&self, pass: &'static str) {
        self.switch_to(Some(pass));
    }
}

/// The parts in the order in which they run: the fraction of the work that is reported when each begins, its name, and what
/// it is.
pub(crate) const GRAPH_STAGES: [(f32, &str, &str); 5] = [
    (0.0, "sort", "edges, and the faces by cells"),
    (0.1, "inside", "which parts enclose space, and which way leads in"),
    (
        0.2,
        "lattice",
        "nodes inside (of the paper's graph with a shell), their edges and ties",
    ),
    (0.6, "struts", "across what is too thin for the lattice"),
    (0.9, "rows", "all edges of all nodes"),
];

/// Adds up the milliseconds of the parts of building graphs.
pub(crate) struct GraphStageClock<'a> {
    now_ms: Box<dyn Fn() -> f64 + Send + Sync + 'a>,
    times: Mutex<GraphStageTimes>,
}

#[derive(Default)]
struct GraphStageTimes {
    /// The part under way and when it began.
    open: Option<(usize, f64)>,
    ms: [f64; GRAPH_STAGES.len()],
}

impl<'a> GraphStageClock<'a> {
    /// Creates an idle clock; `now_ms` returns milliseconds since any fixed moment.
    pub(crate) fn new(now_ms: impl Fn() -> f64 + Send + Sync + 'a) -> Self {
        Self {
            now_ms: Box::new(now_ms),
            times: Mutex::default(),
        }
    }

    /// The milliseconds of each part so far.
    pub(crate) fn stage_ms(&self) -> [f64; GRAPH_STAGES.len()] {
        self.times.lock().unwrap_or_else(PoisonError::into_inner).ms
    }
}

impl Progress for GraphStageClock<'_> {
    fn cancelled(&self) -> bool {
        false
    }

    fn report(&self, stage: &'static str, fraction: f32) {
        let now_ms = (self.now_ms)();
        let mut times = self.times.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((part, since)) = times.open.take() {
            times.ms[part] += now_ms - since;
        }
        if stage == "graph" && fraction < 1.0 {
            let begun = GRAPH_STAGES.iter().rposition(|s| s.0 <= fraction);
            times.open = begun.map(|part| (part, now_ms));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU32;
    use std::sync::atomic::Ordering::Relaxed;

    #[test]
    fn parts_of_several_graphs_add_up_and_other_stages_do_not_count() {
        let ticks = AtomicU32::new(0);
        let clock = GraphStageClock::new(|| f64::from(ticks.fetch_add(1, Relaxed)));
        let reports = [
            ("mesh", 0.5),
            ("graph", 0.0),
            ("graph", 0.1),
            ("graph", 1.0),
            ("graph", 0.1),
            ("graph", 0.9),
            ("hierarchy", 0.0),
            ("hierarchy", 0.5),
        ];
        reports
            .iter()
            .for_each(|(stage, fraction)| clock.report(stage, *fraction));
        assert_eq!(clock.stage_ms(), [1.0, 2.0, 0.0, 0.0, 1.0]);
    }
}
