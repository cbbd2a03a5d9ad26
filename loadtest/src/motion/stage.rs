//! A model with a rig and a clip on it, as the command line would have them.

use crate::failure::LoadtestFailure;
use crate::shared::input_files::read_model_file;
use crate::shared::subdivide::{subdivide_model, write_ply};
use glam::DVec3;
use pliant::asset::{FileSet, Limits, Model};
use pliant::engine::{
    AnimatedFrame, Animation, AnimationRefinement, AnimationSettings, Deformer, DeformerLimits, FrameTimes, OpenOptions,
};
use pliant::exec::Exec;
use pliant::motion::MotionClip;
use pliant::motion::bvh::{ClipLimits, read_bvh};
use pliant::motion::rig::{DriveOptions, MotionRig, RigDriver};
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

/// Where models, clips and rigs lie; what is not there is `None`.
pub(super) struct MotionFolders<'a> {
    /// Models and clips.
    pub data: &'a Path,
    /// Rigs.
    pub rigs: &'a Path,
}

/// A model, a rig and a clip.
pub(super) struct MotionStage {
    pub deformer: Deformer,
    pub rig: MotionRig,
    pub clip: MotionClip,
}

/// Anything that goes wrong in between.
pub(super) fn failed(e: impl std::fmt::Display) -> LoadtestFailure {
    LoadtestFailure::Server(e.to_string())
}

impl MotionFolders<'_> {
    /// Which of these files are missing, in words; `None` where all are there.
    pub fn missing(&self, data: &[&str], rigs: &[&str]) -> Option<String> {
        let data = data.iter().map(|name| (self.data.join(name), *name));
        let rigs = rigs.iter().map(|name| (self.rigs.join(name), *name));
        let absent: Vec<&str> = data
            .chain(rigs)
            .filter(|(path, _)| !path.is_file())
            .map(|(_, name)| name)
            .collect();
        (!absent.is_empty()).then(|| format!("{} is not there", absent.join(", ")))
    }

    /// Reads a clip.
    pub fn clip(&self, name: &str) -> Result<MotionClip, LoadtestFailure> {
        let path = self.data.join("bvh").join(name);
        let text = std::fs::read(&path).map_err(|e| failed(format!("{}: {e}", path.display())))?;
        read_bvh(&text, &ClipLimits::default()).map_err(|e| failed(format!("{}: {e}", path.display())))
    }

    /// Reads a rig.
    pub fn rig(&self, name: &str) -> Result<MotionRig, LoadtestFailure> {
        let path = self.rigs.join(name);
        let text = std::fs::read(&path).map_err(|e| failed(format!("{}: {e}", path.display())))?;
        wire::rig_from_json(&text).map_err(|e| failed(format!("{}: {e}", path.display())))
    }

    /// Opens a model of the folder with a rig and a clip, its triangles cut into four so many times.
    pub fn stage(&self, [model, rig, clip]: [&str; 3], cuts: u8, pool: &Pool) -> Result<MotionStage, LoadtestFailure> {
        let files = read_model_file(&self.data.join("meshes").join(model))?;
        let files = match model {
            "horse.ply" => turned_horse(files)?,
            _ => subdivide_model(files, cuts)?,
        };
        Ok(MotionStage {
            deformer: open(files, pool)?,
            rig: self.rig(rig)?,
            clip: self.clip(clip)?,
        })
    }
}

/// Opens a model as the command line does.
pub(super) fn open(files: FileSet, pool: &Pool) -> Result<Deformer, LoadtestFailure> {
    let exec = Exec::new(pool, &Silent);
    Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), &exec).map_err(failed)
}

/// The scanned horse as its rig was made for it: y up, its head to +z, one unit long, its trunk in the plane x = 0, its outside
/// outside. The scan has z up, lies a little beside that plane, and is inside out.
fn turned_horse(files: FileSet) -> Result<FileSet, LoadtestFailure> {
    const SCALE: f64 = 5.4496;
    const BESIDE: f64 = 0.0147;
    let model = Model::read(files, None, &Limits::default()).map_err(failed)?;
    let turned = |p: &DVec3| DVec3::new(BESIDE - p.x, p.z, p.y) * SCALE;
    let positions: Vec<DVec3> = model.positions.iter().map(turned).collect();
    let mut triangles = model.triangles.clone();
    let at = |v: u32| positions[v as usize];
    let volume: f64 = triangles.iter().map(|[a, b, c]| at(*a).dot(at(*b).cross(at(*c)))).sum();
    if volume < 0.0 {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    Ok(FileSet::single("horse.ply", write_ply(&positions, &triangles)))
}

impl MotionStage {
    /// When its frames are, a first one that is a pose of its own left out; as many as `most` at most.
    pub fn times(&self, rate: f64, most: usize) -> FrameTimes {
        let skipped = self.clip.recorded.filter(|_| self.clip.begins_apart());
        let start = skipped.map_or(0.0, |r| r.interval);
        let mut times = FrameTimes::between(start, self.clip.duration, rate);
        times.count = times.count.min(most);
        times
    }

    /// Prepares frames at these times.
    pub fn animation(
        &self,
        times: FrameTimes,
        refinement: AnimationRefinement,
        pool: &Pool,
    ) -> Result<Animation, LoadtestFailure> {
        let options = DriveOptions {
            start: times.start,
            ..Default::default()
        };
        let driver = RigDriver::new(&self.rig, self.clip.clone(), &options).map_err(failed)?;
        let settings = AnimationSettings {
            refinement,
            ..Default::default()
        };
        let exec = Exec::new(pool, &Silent);
        let animation = self
            .deformer
            .animation(self.rig.clone(), driver, times, &settings, &exec);
        animation.map_err(failed)
    }
}

/// Solves frames, as many blocks at the same time as there are threads, and gives them to `take` in their order.
pub(super) fn solve(
    animation: &Animation,
    range: Range<usize>,
    pool: &Pool,
    take: &mut dyn FnMut(AnimatedFrame),
) -> Result<(), LoadtestFailure> {
    let exec = Exec::new(pool, &Silent);
    let (mut next, mut early) = (range.start, BTreeMap::new());
    let mut take_solved = |frame: AnimatedFrame, _| {
        early.insert(frame.index, frame);
        while let Some(frame) = early.remove(&next) {
            take(frame);
            next += 1;
        }
        true
    };
    let solved = animation.solve(&[range], pool.threads(), &|| 0.0, &exec, &mut take_solved);
    solved.map_err(failed)
}
