//! Frames of an animation whose surfaces are kept from crossing.
//!
//! A frame goes on from what the one before has displaced, as in a drag. Where it crosses and is far from the one before, poses between
//! both are solved and parted first. The first frame of a block is reached from the rest pose in the same way. So what a frame becomes
//! depends on its block alone. How nodes are solved does not depend on any of this, so that frames that do not cross keep their bits.

use crate::deform::{MovingSurface, SolveStart, SolveState};
use crate::engine::animation::prepare::Animation;
use crate::engine::contact::{admit_memory, part_moving_surface};
use crate::engine::error::Error;
use crate::engine::settings::HeldBeside;
use crate::exec::Exec;
use crate::motion::rig::RigPose;
use glam::DVec3;

/// How often the displacement of a frame is improved.
const UPDATES: usize = 16;
/// By how many radians a bone turns against the one that it hangs on from one parted pose to the next,
const LARGEST_TURN: f64 = std::f64::consts::PI / 36.0;
/// unless there would be more of them.
const MOST_STEPS: usize = 36;
/// How often rotations are fitted in a pose between frames.
const STEP_FITS: u32 = 1;

/// A frame and the way to it.
pub(super) struct MovingFrame<'a> {
    /// When the frame before is, in seconds of the clip; `None` where the way begins in the rest pose.
    pub(super) begin: Option<f64>,
    /// When it is.
    pub(super) end: f64,
    /// What it is.
    pub(super) pose: &'a RigPose,
}

impl Animation {
    /// Moves surfaces apart among the `positions` of a frame, where they cross; returns whether it has. `state` has what the frame before
    /// has left.
    pub(super) fn part_frame(
        &self,
        frame: &MovingFrame<'_>,
        positions: &mut [DVec3],
        state: &mut SolveState,
        exec: &Exec<'_>,
    ) -> Result<bool, Error> {
        let surface = MovingSurface {
            mesh: &self.derived.mesh,
            held: self.system.given(),
            updates: UPDATES,
        };
        // Poses on the way have a state of their own.
        let held = 2 * state.byte_size() as u64;
        let beside = HeldBeside::within(held, self.memory_bytes, exec.progress);
        admit_memory(&surface, state.contact(), &beside)?;
        let turn = frame.pose.largest_turn(&self.pose_on_way(frame, 0.0), &self.rig);
        let steps = ((turn / LARGEST_TURN).ceil() as usize).min(MOST_STEPS);
        if steps > 1 && state.contact().would_part(&surface, positions, exec)? {
            // The way is solved beside the frames, which keep what they go on from.
            let mut aside = SolveState::default();
            std::mem::swap(aside.contact(), state.contact());
            for step in 1..steps {
                let pose = self.pose_on_way(frame, step as f64 / steps as f64);
                let start = if step == 1 { SolveStart::Fresh } else { SolveStart::Warm };
                let mut solution = self.solve_pose(&pose, start, STEP_FITS, &mut aside, exec)?.solution;
                self.settle_faces(&mut solution, exec);
                let nodes = &mut solution.positions;
                part_moving_surface(&surface, aside.contact(), &beside, nodes, exec.pool)?;
            }
            std::mem::swap(aside.contact(), state.contact());
        }
        part_moving_surface(&surface, state.contact(), &beside, positions, exec.pool)
    }

    /// The pose after a part of the way to a frame.
    fn pose_on_way(&self, frame: &MovingFrame<'_>, part: f64) -> RigPose {
        match frame.begin {
            Some(begin) => self.driver.pose_at(begin + (frame.end - begin) * part),
            None => frame.pose.part_way(&self.rig, part),
        }
    }
}
