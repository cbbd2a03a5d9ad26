//! A model with a rig and a clip on it, as the command line would have them.

use crate::failure::LoadtestFailure;
use crate::models::{read_model_file, subdivide_model, write_ply};
use glam::DVec3;
use pliant::asset::{FileSet, Limits, Model};
use pliant::engine::{
    ANIMATION_QUALITY, AnimatedFrame, Animation, Deformer, DeformerLimits, FrameTimes, OpenOptions, Quality, bind_model,
};
use pliant::exec::Exec;
use pliant::motion::bvh::{ClipLimits, read_bvh};
use pliant::motion::rig::{DriveOptions, MotionRig, RigDriver, RigidMotion};
use pliant::motion::{BoneInfluences, MotionClip};
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire;
use serde_json::{Value, json};
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
        read_with(&self.data.join("bvh").join(name), |text| {
            read_bvh(text, &ClipLimits::default())
        })
    }

    /// Reads a rig.
    pub fn rig(&self, name: &str) -> Result<MotionRig, LoadtestFailure> {
        read_with(&self.rigs.join(name), wire::rig_from_json)
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

/// Reads a file; errors name it.
fn read_with<T, E: std::fmt::Display>(
    path: &Path,
    read: impl FnOnce(&[u8]) -> Result<T, E>,
) -> Result<T, LoadtestFailure> {
    let failed = |e: &dyn std::fmt::Display| LoadtestFailure::Server(format!("{}: {e}", path.display()));
    read(&std::fs::read(path).map_err(|e| failed(&e))?).map_err(|e| failed(&e))
}

/// Opens a model as the command line does.
pub(super) fn open(files: FileSet, pool: &Pool) -> Result<Deformer, LoadtestFailure> {
    let exec = Exec::new(pool, &Silent);
    Ok(Deformer::open(
        files,
        &OpenOptions::default(),
        &DeformerLimits::default(),
        &exec,
    )?)
}

/// The scanned horse as its rig was made for it: y up, its head to +z, one unit long, its trunk in the plane x = 0, its outside
/// outside. The scan has z up, lies a little beside that plane, and is inside out.
fn turned_horse(files: FileSet) -> Result<FileSet, LoadtestFailure> {
    const SCALE: f64 = 5.4496;
    const BESIDE: f64 = 0.0147;
    let model = Model::read(files, None, &Limits::default())?;
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
    pub fn animation(&self, times: FrameTimes, refine: Option<u32>, pool: &Pool) -> Result<Animation, LoadtestFailure> {
        let options = DriveOptions {
            start: times.start,
            ..Default::default()
        };
        let driver = RigDriver::new(&self.rig, self.clip.clone(), &options)?;
        let quality = Quality {
            refine,
            ..ANIMATION_QUALITY
        };
        let exec = Exec::new(pool, &Silent);
        Ok((self.deformer).animation(self.rig.clone(), driver, times, &quality, &exec)?)
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
    Ok(animation.solve(&[range], pool.threads(), &|| 0.0, &exec, &mut take_solved)?)
}

/// A measured number.
#[derive(Debug, Clone)]
pub(super) struct MotionFigure {
    row: u8,
    what: String,
    value: f64,
    unit: &'static str,
    /// Must, and aim.
    bounds: [Option<f64>; 2],
    /// Whether more is better.
    is_floor: bool,
}

/// A number of a row without bounds, for comparison.
pub(super) fn figure(row: u8, what: impl Into<String>, value: f64, unit: &'static str) -> MotionFigure {
    MotionFigure {
        row,
        what: what.into(),
        value,
        unit,
        bounds: [None, None],
        is_floor: false,
    }
}

impl MotionFigure {
    /// The number with upper bounds on its magnitude.
    pub fn at_most(self, must: f64, aim: impl Into<Option<f64>>) -> Self {
        let bounds = [Some(must), aim.into()];
        Self { bounds, ..self }
    }

    /// The number with lower bounds.
    pub fn at_least(self, must: f64, aim: impl Into<Option<f64>>) -> Self {
        let is_floor = true;
        Self {
            is_floor,
            ..self.at_most(must, aim)
        }
    }

    fn reaches(&self, bound: Option<f64>) -> Option<bool> {
        bound.map(|bound| match self.is_floor {
            true => self.value >= bound,
            false => self.value.abs() <= bound,
        })
    }

    fn verdict(&self) -> &'static str {
        match self.bounds.map(|bound| self.reaches(bound)) {
            [_, Some(true)] => "aim",
            [Some(true), _] => "must",
            [Some(false), _] => "SHORT",
            _ => "",
        }
    }

    /// Whether it is not what it must be.
    pub fn is_short(&self) -> bool {
        self.reaches(self.bounds[0]) == Some(false)
    }

    /// A line of the table.
    pub fn line(&self) -> String {
        let bound = |bound: Option<f64>| bound.map_or_else(|| "-".to_owned(), |bound| number(bound, self.unit));
        let [must, aim] = self.bounds.map(bound);
        let value = number(self.value, self.unit);
        format!(
            "{:>2}  {:<58} {value:>12} {must:>10} {aim:>10}  {}",
            self.row,
            self.what,
            self.verdict()
        )
    }

    /// The same for programs.
    pub fn json(&self) -> Value {
        let [must, aim] = self.bounds;
        json!({"row": self.row, "what": self.what, "value": self.value, "unit": self.unit, "must": must, "aim": aim,
            "verdict": self.verdict()})
    }
}

/// A number with three digits and its unit.
fn number(value: f64, unit: &str) -> String {
    let digits = match value.abs() {
        v if v == 0.0 || v >= 100.0 => 0,
        v if v >= 10.0 => 1,
        v if v >= 1.0 => 2,
        v if v >= 0.01 => 3,
        _ => return format!("{value:.1e}{unit}"),
    };
    format!("{value:.digits$}{unit}")
}

/// Bones that a vertex follows.
const INFLUENCES: usize = 4;

/// Weights for a stage's model and rig.
pub(super) fn bind(stage: &MotionStage, pool: &Pool) -> Result<Vec<BoneInfluences>, LoadtestFailure> {
    let exec = Exec::new(pool, &Silent);
    let bound = bind_model(stage.deformer.model(), &stage.rig, INFLUENCES, &exec);
    Ok(bound?.influences)
}

/// Where vertices are when each follows its bones.
pub(super) fn skinned(rest: &[DVec3], influences: &[BoneInfluences], bones: &[RigidMotion]) -> Vec<DVec3> {
    let pairs = rest.iter().zip(influences);
    pairs.map(|(p, own)| own.blend(|bone| bones[bone].place(*p))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_held_against_their_bounds() {
        let verdict = |value: f64| figure(1, "v", value, " %").at_most(2.5, 1.5).verdict();
        assert_eq!([verdict(-1.0), verdict(2.0), verdict(-2.6)], ["aim", "must", "SHORT"]);
        let rate = |value: f64| figure(5, "f", value, "").at_least(8.0, None);
        assert_eq!([rate(9.0).verdict(), rate(7.0).verdict()], ["must", "SHORT"]);
        assert!(rate(7.0).is_short() && !figure(3, "t", 9.0, "").is_short());
        let line = rate(0.0123).line();
        assert!(line.starts_with(" 5  f ") && line.contains("0.012"), "{line}");
        assert_eq!(number(-12.34, " %"), "-12.3 %");
    }
}
