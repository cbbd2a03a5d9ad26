//! The frames of an animation, block by block, and sums over them.

use crate::deform::{
    FaceChanges, FirstPass, FitOrder, PoseRequest, Quality, SolutionExtent, SolveStart, SolveState, SolvedNodes,
    Transform, unfold_faces,
};
use crate::engine::animation::parted_frames::MovingFrame;
use crate::engine::animation::prepare::{Animation, BLOCK_FRAMES};
use crate::engine::error::Error;
use crate::engine::facts::QualityReport;
use crate::engine::quality::FrameQuality;
use crate::engine::settings::Contact;
use crate::engine::solve::ShapeTransfer;
use crate::exec::Exec;
use crate::mesh::count_crossings;
use crate::mesh::rotation::log_rotation;
use crate::motion::rig::{RigPose, RigidMotion};
use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::mpsc;

/// How often frame 0 is fitted where others go on from it.
const FIRST_FITS: u32 = 32;
/// How often the frame is that any other block goes on from.
const LEAD_FITS: u32 = 4;
/// How many frames before its own a block goes on from; these are carried along and not given away. A block that began at its
/// own first frame would show where: what is carried forgets half of where it began in some six frames, and is 0.25 % of the
/// diagonal (root mean square) from what 32 fits come to. With these it is 0.02 % (`loadtest motion --only 4`).
const LEAD_FRAMES: usize = 30;
/// How often the frames are fitted that go on from the one before.
const CARRIED_FITS: u32 = 1;
/// How many bytes of frames may wait for their turn.
const HELD_BYTES: usize = 1 << 30;

/// Solved frames, numbered from 0, that can be read again.
pub trait FrameSource {
    /// Why one cannot be read again.
    type Failure: From<Error>;

    /// How many there are.
    fn count(&self) -> usize;

    /// What the root bone does in a frame.
    fn root(&self, frame: usize) -> RigidMotion;

    /// Where the vertices are in a frame.
    ///
    /// # Errors
    /// When it cannot be read again.
    fn positions(&mut self, frame: usize) -> Result<Vec<Vec3>, Self::Failure>;
}

/// A solved frame.
#[derive(Debug, Clone)]
pub struct AnimatedFrame {
    /// Its number in the animation.
    pub index: usize,
    /// When it is, in seconds of the clip.
    pub seconds: f64,
    /// What the root bone does.
    pub root: RigidMotion,
    /// One per render vertex, model space, as the root bone sees it.
    pub positions: Vec<DVec3>,
    /// Cycles of the solver.
    pub cycles: usize,
    /// Relative residual, largest over coordinates.
    pub residual: f64,
    /// Estimated largest missing displacement, as a fraction of the diagonal.
    pub max_error: f64,
    /// How far it is from the rest shape.
    pub quality: FrameQuality,
}

impl AnimatedFrame {
    /// Moves positions along with the root bone.
    pub fn bake_root(&mut self) {
        let root = std::mem::replace(&mut self.root, RigidMotion::IDENTITY);
        self.positions.iter_mut().for_each(|p| *p = root.place(*p));
    }
}

/// Goes through the frames of a range one by one, and keeps what each leaves to the next. It begins where the block of the
/// first one does, or some frames before it, and so does every block that it comes to.
#[derive(Default)]
pub struct FrameCursor {
    next: usize,
    /// The first frame of the block that the next one belongs to, or leads to.
    block: usize,
    /// How many frames before its first a block begins.
    lead: usize,
    wanted: Range<usize>,
    state: SolveState,
}

impl FrameCursor {
    fn over(wanted: Range<usize>, lead: usize) -> Self {
        let block = wanted.start - wanted.start % BLOCK_FRAMES;
        Self {
            next: block.saturating_sub(lead),
            block,
            lead,
            wanted,
            state: SolveState::default(),
        }
    }

    /// The number of the frame that is solved next; `None` at the end.
    pub fn next_index(&self) -> Option<usize> {
        (self.next.max(self.block) < self.wanted.end).then_some(self.next)
    }

    /// How much is done of the frames that lead to one that is wanted, between 0 and 1; `None` where the next is wanted itself.
    pub fn lead_progress(&self) -> Option<f32> {
        let goal = self.block.max(self.wanted.start);
        let begin = self.begin();
        (self.next < goal).then(|| (self.next - begin) as f32 / (goal - begin) as f32)
    }

    fn begin(&self) -> usize {
        self.block.saturating_sub(self.lead)
    }

    /// Moves on; answers whether the frame left behind is wanted.
    fn advance(&mut self) -> bool {
        let is_wanted = self.next >= self.block.max(self.wanted.start);
        self.next += 1;
        if self.next == self.block + BLOCK_FRAMES {
            self.block = self.next;
            self.next = self.begin();
        }
        is_wanted
    }

    /// Bytes held.
    pub fn byte_size(&self) -> u64 {
        self.state.byte_size() as u64
    }
}

impl Animation {
    /// Solves the frames of some ranges, some blocks in parallel. Each solved frame goes to `take` at once, with the
    /// milliseconds that it took by the clock `millis`; `take` returns `false` to stop. Frames of a block come in
    /// order, those of parallel blocks in any order. Progress is reported as the stage `frames`; it counts frames that
    /// only lead to others as well. Call it from outside the pool.
    ///
    /// # Errors
    /// [`Error::Cancelled`], after `take` got all frames solved until then; [`Error::Internal`] for a defect.
    pub fn solve(
        &self,
        ranges: &[Range<usize>],
        blocks_at_once: usize,
        millis: &(dyn Fn() -> f64 + Sync),
        exec: &Exec<'_>,
        take: &mut dyn FnMut(AnimatedFrame, f64) -> bool,
    ) -> Result<(), Error> {
        let parts = self.parts_in_blocks(ranges);
        let steps: usize = parts
            .iter()
            .map(|part| part.end - self.cursor(part.clone()).begin())
            .sum();
        let mut done = 0;
        let mut give = |step: SolvedStep| {
            done += 1;
            exec.progress.report("frames", done as f32 / steps as f32);
            step.is_none_or(|(frame, ms)| take(frame, ms))
        };
        let block_bytes = BLOCK_FRAMES * size_of::<DVec3>() * self.derived.topology().rest.len();
        let at_once = blocks_at_once.min(HELD_BYTES / block_bytes.max(1)).max(1);
        for wave in parts.chunks(at_once) {
            let goes_on = match wave {
                [part] => self.solve_part(part.clone(), millis, exec, &mut give)?,
                _ => self.solve_wave(wave, millis, exec, &mut give)?,
            };
            if !goes_on {
                break;
            }
        }
        Ok(())
    }

    /// Ranges, as far as there are frames, cut where blocks begin.
    fn parts_in_blocks(&self, ranges: &[Range<usize>]) -> Vec<Range<usize>> {
        let mut parts = Vec::new();
        for range in ranges {
            let (mut start, end) = (range.start, range.end.min(self.times.count));
            while start < end {
                let next = (start - start % BLOCK_FRAMES + BLOCK_FRAMES).min(end);
                parts.push(start..next);
                start = next;
            }
        }
        parts
    }

    /// Solves parts of different blocks at the same time; answers whether `give` wants more. Frames go to the thread that asked,
    /// because a thread of the pool that gave one itself could take up another block while it does.
    fn solve_wave(
        &self,
        wave: &[Range<usize>],
        millis: &(dyn Fn() -> f64 + Sync),
        exec: &Exec<'_>,
        give: &mut dyn FnMut(SolvedStep) -> bool,
    ) -> Result<bool, Error> {
        let (send, steps) = mpsc::channel();
        let mut solved = Ok(());
        let result = &mut solved;
        let work = move || {
            let solve = |part: &Range<usize>| {
                let mut send = |step| send.send(step).is_ok();
                self.solve_part(part.clone(), millis, exec, &mut send).map(drop)
            };
            *result = wave.par_iter().with_max_len(1).try_for_each(solve);
        };
        let goes_on = exec.pool.run_beside(work, || steps.into_iter().all(give));
        solved.map(|()| goes_on)
    }

    /// Solves frames of one block from where it begins; answers whether `give` wants more.
    fn solve_part(
        &self,
        part: Range<usize>,
        millis: &(dyn Fn() -> f64 + Sync),
        exec: &Exec<'_>,
        give: &mut dyn FnMut(SolvedStep) -> bool,
    ) -> Result<bool, Error> {
        let mut cursor = self.cursor(part);
        while cursor.next_index().is_some() {
            let begun = millis();
            let frame = self.solve_next(&mut cursor, exec)?;
            if !give(frame.map(|frame| (frame, millis() - begun))) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// A cursor at the beginning of a range, as far as there are frames.
    pub fn cursor(&self, range: Range<usize>) -> FrameCursor {
        let lead = match self.quality.refine {
            None => LEAD_FRAMES,
            Some(_) => 0,
        };
        FrameCursor::over(range.start..range.end.min(self.times.count), lead)
    }

    /// Solves the frame at a cursor and moves on; `None` for a frame that is not wanted itself but leads to one that is.
    ///
    /// # Errors
    /// [`Error::Cancelled`], after which the cursor is of no more use; [`Error::Internal`] for a defect, also past the end.
    pub fn solve_next(&self, cursor: &mut FrameCursor, exec: &Exec<'_>) -> Result<Option<AnimatedFrame>, Error> {
        exec.check()?;
        let Some(index) = cursor.next_index() else {
            return Err(Error::Internal("the animation has no more frames".into()));
        };
        let is_first = index == cursor.begin();
        if is_first {
            cursor.state = SolveState::default();
        }
        let fits = match index {
            0 => FIRST_FITS,
            _ if is_first => LEAD_FITS,
            _ => CARRIED_FITS,
        };
        let start = if is_first { SolveStart::Fresh } else { SolveStart::Warm };
        let pose = self.driver.pose_at(self.times.at(index));
        let mut posed = self.solve_pose(&pose, start, fits, &mut cursor.state, exec)?;
        let is_wanted = cursor.advance();
        if !is_wanted && self.contact == Contact::Ignored {
            return Ok(None);
        }
        let mut changes = self.settle_faces(&mut posed.solution, exec);
        if self.contact != Contact::Ignored {
            let begin = (!is_first).then(|| self.times.at(index - 1));
            let moving = MovingFrame {
                begin,
                end: self.times.at(index),
                pose: &pose,
            };
            let at = &mut posed.solution.positions;
            if self.part_frame(&moving, at, &mut cursor.state, exec)? {
                let mesh = &self.derived.mesh;
                changes = FaceChanges::find(mesh, &at[..mesh.positions.len()], exec.pool);
            }
        }
        is_wanted.then(|| self.finish(index, posed, &changes, exec)).transpose()
    }

    /// Settles thin parts and folds of where nodes are; returns what the shape does to faces.
    pub(super) fn settle_faces(&self, solution: &mut SolvedNodes, exec: &Exec<'_>) -> FaceChanges {
        let SolvedNodes { positions, frames, .. } = solution;
        let derived = &self.derived;
        derived
            .thin
            .settle(&derived.body, &self.system, frames, positions, exec.pool);
        unfold_faces(&derived.mesh, &derived.surroundings, &self.system, positions, exec.pool)
    }

    /// Solves a pose of the rig. `fits` says how often rotations are fitted, unless the quality does.
    pub(super) fn solve_pose(
        &self,
        pose: &RigPose,
        start: SolveStart,
        fits: u32,
        state: &mut SolveState,
        exec: &Exec<'_>,
    ) -> Result<SolvedPose, Error> {
        let transforms: Vec<Transform> = (self.handles.iter())
            .map(|handle| transform(&handle.motion(&self.rig, pose)))
            .collect();
        let (order, steps) = match self.quality.refine {
            None => (FitOrder::Carried, fits),
            Some(steps) => {
                state.forget_fits();
                (FitOrder::GraphAlone, steps)
            }
        };
        let request = PoseRequest {
            transforms: &transforms,
            quality: Quality {
                refine: Some(steps),
                smoothing: 0.0,
                keeps_volume: false,
                ..self.quality
            },
            start,
            first_pass: FirstPass::WeightedSum,
            fits: order,
            extent: SolutionExtent::Graph,
            smooth_borders: false,
        };
        let body = &self.derived.body;
        let solution = self.system.solve(body, &request, state, exec, &mut |_| true)?;
        Ok(SolvedPose {
            root: pose.root,
            transforms,
            solution,
        })
    }

    /// Makes a frame of where its nodes are: quality is measured, vertices are placed.
    fn finish(
        &self,
        index: usize,
        posed: SolvedPose,
        changes: &FaceChanges,
        exec: &Exec<'_>,
    ) -> Result<AnimatedFrame, Error> {
        let SolvedPose {
            root,
            transforms,
            solution,
        } = posed;
        let seconds = self.times.at(index);
        let derived = &self.derived;
        let surface = &solution.positions[..derived.mesh.positions.len()];
        let mesh = &derived.mesh;
        let mut quality = FrameQuality::measure(mesh, derived.report().closed, surface, changes, exec.pool);
        if self.counts_crossings {
            let counted = count_crossings(surface, &mesh.positions, &mesh.triangles, exec);
            quality.crossings = Some(counted.map_err(|_| Error::Cancelled)?);
        }
        let shape = ShapeTransfer {
            body: &derived.body,
            mesh: &derived.mesh,
            rest: &derived.topology().rest,
            unreferenced: &[],
            riders: derived.riding_vertices(),
            frames: None,
            pool: exec.pool,
        };
        let (mut positions, _) = shape.render(&solution.positions, &solution.frames, &transforms);
        if let Some(beside) = &self.beside {
            let topology = derived.topology();
            beside.shift_skinned(
                seconds,
                &topology.rest,
                &topology.geometry().triangles,
                &mut positions,
                exec,
            )?;
            beside.place_carried(seconds, &root, &mut positions, exec)?;
        }
        Ok(AnimatedFrame {
            index,
            seconds,
            root,
            positions,
            cycles: solution.stats.cycles as usize,
            residual: solution.stats.residual,
            max_error: solution.stats.max_error,
            quality,
        })
    }
}

/// A frame with the milliseconds that it took; `None` for one that only leads to others.
type SolvedStep = Option<(AnimatedFrame, f64)>;

/// A frame whose nodes are placed.
pub(super) struct SolvedPose {
    root: RigidMotion,
    transforms: Vec<Transform>,
    pub(super) solution: SolvedNodes,
}

fn transform(motion: &RigidMotion) -> Transform {
    Transform {
        translation: motion.to - motion.from,
        rotation: log_rotation(motion.rotation),
        log_scale: DMat3::ZERO,
        pivot: motion.from,
    }
}

/// Sums over the frames of an animation, added one by one.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct FrameSums {
    /// How many frames.
    pub frames: usize,
    volume_change: f64,
    flipped_triangles: f64,
    edge_rms: f64,
    /// The change of volume that is farthest from none.
    pub volume_change_worst: f64,
    /// Most triangles that are turned over in one frame.
    pub flipped_triangles_worst: u32,
    /// The largest stretch in any frame.
    pub max_stretch: f64,
    new_self_intersections: Option<f64>,
    /// Most pairs of triangles that cross in one frame and do not in the rest pose; `None` where they are not counted.
    pub new_self_intersections_worst: Option<u32>,
    /// How many frames have such pairs; `None` where they are not counted.
    pub crossing_frames: Option<usize>,
    /// The first of the frames with most such pairs; `None` where no frame has any.
    pub worst_crossing_frame: Option<usize>,
}

impl FrameSums {
    /// Adds the next frame, of which the number is given.
    pub fn add(&mut self, frame: usize, quality: &QualityReport) {
        self.frames += 1;
        self.volume_change += quality.volume_change;
        self.flipped_triangles += f64::from(quality.flipped_triangles);
        self.edge_rms += quality.edge_rms;
        if quality.volume_change.abs() > self.volume_change_worst.abs() {
            self.volume_change_worst = quality.volume_change;
        }
        self.flipped_triangles_worst = self.flipped_triangles_worst.max(quality.flipped_triangles);
        self.max_stretch = self.max_stretch.max(quality.max_stretch);
        if let Some(new) = quality.new_self_intersections {
            *self.new_self_intersections.get_or_insert(0.0) += f64::from(new);
            *self.crossing_frames.get_or_insert(0) += usize::from(new > 0);
            if new > self.new_self_intersections_worst.unwrap_or_default() {
                self.worst_crossing_frame = Some(frame);
            }
            self.new_self_intersections_worst = self.new_self_intersections_worst.max(Some(new));
        }
    }

    fn mean(&self, sum: f64) -> f64 {
        sum / self.frames.max(1) as f64
    }

    /// Mean of the changes of volume.
    pub fn volume_change_mean(&self) -> f64 {
        self.mean(self.volume_change)
    }

    /// Mean number of triangles that are turned over.
    pub fn flipped_triangles_mean(&self) -> f64 {
        self.mean(self.flipped_triangles)
    }

    /// Mean number of pairs of triangles that cross and do not in the rest pose; `None` where they are not counted.
    pub fn new_self_intersections_mean(&self) -> Option<f64> {
        self.new_self_intersections.map(|sum| self.mean(sum))
    }

    /// Mean of the edges' root mean squares.
    pub fn edge_rms_mean(&self) -> f64 {
        self.mean(self.edge_rms)
    }
}
