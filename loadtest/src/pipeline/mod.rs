//! The whole pipeline, timed stage by stage: from a model to its first frame, and from an edit to the next frame.

pub(crate) mod edits;
pub(crate) mod first_frame;
pub(crate) mod frame;
mod points;
pub(crate) mod wire;

use crate::failure::LoadtestFailure;
use crate::models::{DragScene, FARTHEST_POSE, MOST_SUBDIVISIONS, read_job_file, read_model_file, subdivide_model};
use glam::DVec3;
use pliant::asset::FileSet;
use pliant::batch::{handles_request, pose_steps};
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
    /// Model file: glb or gltf with embedded buffers, obj, ply, off, stl or 3mf
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
    Deformer::open(files, &options, &DeformerLimits::default(), exec)
}

/// Sets a job's handles; returns the poses after its last step.
pub(crate) fn set_job_handles(
    deformer: &mut Deformer,
    job: &pb::Job,
    exec: &Exec<'_>,
) -> Result<HandlePoses, schema::Error> {
    deformer.set_handles(schema::handle_set(&handles_request(job))?, exec)?;
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

/// The parts of building a graph in the order in which they run: the fraction of the work that is reported when each begins, its
/// name, and what it is.
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

/// Clocks passes of a solve, and the parts of building graphs.
pub(crate) struct PassClock<'a> {
    /// Seconds since any fixed moment.
    now: Box<dyn Fn() -> f64 + Send + Sync + 'a>,
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

impl<'a> PassClock<'a> {
    /// Creates a clock on which nothing runs.
    pub(crate) fn new() -> Self {
        let start = Instant::now();
        Self::with_clock(move || start.elapsed().as_secs_f64())
    }

    fn with_clock(now: impl Fn() -> f64 + Send + Sync + 'a) -> Self {
        Self {
            now: Box::new(now),
            passes: Mutex::default(),
        }
    }

    fn switch_to(&self, next: Option<&'static str>) {
        let now = (self.now)();
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

    fn is_building(&self) -> bool {
        let passes = self.passes.lock().unwrap_or_else(PoisonError::into_inner);
        let current = passes.current.map(|(pass, _)| pass);
        GRAPH_STAGES.iter().any(|stage| current == Some(stage.1))
    }
}

impl Progress for PassClock<'_> {
    fn begin_pass(&self, pass: &'static str) {
        self.switch_to(Some(pass));
    }

    fn report(&self, stage: &'static str, fraction: f32) {
        let is_graph = stage == "graph" && fraction < 1.0;
        if is_graph || self.is_building() {
            let part = GRAPH_STAGES.iter().rev().find(|s| is_graph && s.0 <= fraction);
            self.switch_to(part.map(|s| s.1));
        }
    }
}

/// The seconds of a pass; 0 of one that did not run.
pub(crate) fn seconds_of(passes: &[(&'static str, f64)], name: &str) -> f64 {
    passes.iter().find(|(pass, _)| *pass == name).map_or(0.0, |p| p.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU32;
    use std::sync::atomic::Ordering::Relaxed;

    #[test]
    fn parts_of_several_graphs_add_up_and_other_stages_do_not_count() {
        let ticks = AtomicU32::new(0);
        let clock = PassClock::with_clock(|| f64::from(ticks.load(Relaxed)));
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
        for (stage, fraction) in reports {
            clock.report(stage, fraction);
            ticks.fetch_add(1, Relaxed);
        }
        let passes = clock.take();
        let seconds = GRAPH_STAGES.map(|stage| seconds_of(&passes, stage.1));
        assert_eq!(seconds, [1.0, 2.0, 0.0, 0.0, 1.0]);
    }
}
