//! What one solve of a pose leaves to the next.

use crate::deform::body::DeformableBody;
use crate::deform::first_pass::frame::{LocalFrame, LocalRotation};
use crate::deform::second_pass::drag_rows::DragRows;
use crate::deform::transform::Transform;
use crate::solver::Workspace;
use glam::DVec3;

/// What a solve keeps for the next one: the last solution and scratch memory.
#[derive(Default)]
pub struct SolveState {
    /// Solving coordinates by node; empty before the first solve.
    pub(in crate::deform) x: Vec<f64>,
    /// Where the handles were for `x`.
    pub(in crate::deform) transforms: Vec<Transform>,
    /// What refinement had added to the first pass's rotations in `x`; empty when it had not been asked for.
    pub(in crate::deform) extra: Vec<LocalRotation>,
    pub(in crate::deform) rhs: Vec<f64>,
    pub(in crate::deform) workspace: Workspace,
    /// The last solution in the order of the solver's rows, where a drag keeps it.
    pub(in crate::deform) rows: DragRows,
    /// Memory for the positions and frames of the next pose of a drag.
    pub(in crate::deform) spare: (Vec<DVec3>, Vec<LocalFrame>),
}

impl SolveState {
    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        (self.x.capacity() + self.rhs.capacity()) * 8
            + self.extra.capacity() * 16
            + self.spare.0.capacity() * size_of::<DVec3>()
            + self.spare.1.capacity() * size_of::<LocalFrame>()
            + self.workspace.byte_size()
            + self.rows.byte_size()
    }

    /// Where there is no last solution the rest shape is one, with all handles in the rest pose.
    pub(in crate::deform) fn begin(&mut self, body: &DeformableBody, holds: usize) {
        self.rows.hand_over(body, &mut self.x);
        if self.x.len() != body.nodes() * 3 {
            self.x.clear();
            self.x
                .extend((0..body.nodes()).flat_map(|node| body.rest(node).to_array()));
            self.extra.clear();
            self.transforms = vec![Transform::IDENTITY; holds];
        }
    }

    /// The same for a drag, which takes the rest shape itself where there is nothing else.
    pub(in crate::deform) fn begin_drag(&mut self, body: &DeformableBody, holds: usize) {
        if self.x.len() != body.nodes() * 3 {
            self.x.clear();
            self.extra.clear();
            self.transforms = vec![Transform::IDENTITY; holds];
        }
    }

    /// Whether [`HandleSystem::settle_drag`](crate::deform::HandleSystem::settle_drag) has something to do.
    pub fn is_worth_settling(&self) -> bool {
        self.rows.is_newest() && self.rows.pose.is_worth_settling()
    }

    /// Takes back positions and frames of a pose that is not needed any more, as memory for the next one.
    pub fn recycle(&mut self, positions: Vec<DVec3>, frames: Vec<LocalFrame>) {
        self.spare = (positions, frames);
    }

    /// Gives memory back that only a solve from nothing needs.
    pub fn release_start(&mut self) {
        self.rhs = Vec::new();
        self.workspace.release_start();
        self.rows.release();
    }

    /// Drops what refinement had added to the first pass's rotations, so that the next solve fits them again.
    pub fn forget_fits(&mut self) {
        self.extra.clear();
    }

    /// Whether nothing was solved with it.
    pub fn is_empty(&self) -> bool {
        self.byte_size() == 0
    }

    /// Drops all but memory, as other handles need.
    pub fn begin_anew(&mut self) {
        self.forget();
        self.transforms.clear();
        self.rhs.clear();
    }

    /// Lets go of the last solution.
    pub(in crate::deform) fn forget(&mut self) {
        self.rows.let_go();
        self.x.clear();
        self.extra.clear();
    }
}
