//! What one solve leaves to the next.
//!
//! A drag keeps its last solution in the order of the solver's rows, with what finds a node in it.

use crate::body::DeformableBody;
use crate::border_frames::BorderFrames;
use crate::contact::ContactMemory;
use crate::first_pass::blend::{LocalFrame, LocalRotation};
use crate::handles::ownership::UNHELD;
use crate::handles::system::HandleSystem;
use crate::rotation::Transform;
use crate::second_pass::turn_steps::TurnSteps;
use crate::volume_scales::VolumeScales;
use glam::DVec3;
use pliant_exec::pool::Pool;
use pliant_solver::{PoseRows, Workspace};

/// What a solve keeps for the next one: the last solution and scratch memory.
#[derive(Default)]
pub struct SolveState {
    /// Solving coordinates by node; empty before the first solve.
    pub(crate) x: Vec<f64>,
    /// Where the handles were for `x`.
    pub(crate) transforms: Vec<Transform>,
    /// What refinement had added to the first pass's rotations in `x`; empty when it had not been asked for.
    pub(crate) extra: Vec<LocalRotation>,
    pub(crate) rhs: Vec<f64>,
    pub(crate) workspace: Workspace,
    /// The scales that keep the volume in the last pose that was fitted.
    pub(crate) volume: VolumeScales,
    /// What takes the strain from the edges of hard handles in the last pose that was fitted.
    pub(crate) borders: BorderFrames,
    /// The last solution in the order of the solver's rows, where a drag keeps it.
    pub(crate) rows: DragRows,
    /// Memory for the positions and frames of the next pose of a drag.
    pub(crate) spare: (Vec<DVec3>, Vec<LocalFrame>),
    /// What was learnt of turns that are not given.
    pub(crate) turning: TurnSteps,
    /// What was learnt of surfaces that cross.
    pub(crate) contact: ContactMemory,
}

impl SolveState {
    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        (self.x.capacity() + self.rhs.capacity()) * 8
            + self.extra.capacity() * 16
            + self.volume.byte_size()
            + self.borders.byte_size()
            + self.spare.0.capacity() * size_of::<DVec3>()
            + self.spare.1.capacity() * size_of::<LocalFrame>()
            + self.workspace.byte_size()
            + self.rows.byte_size()
            + self.turning.byte_size()
            + self.contact.byte_size()
    }

    /// Where there is no last solution the rest shape is one, with all handles in the rest pose.
    pub(crate) fn begin(&mut self, body: &DeformableBody, holds: usize) {
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
    pub(crate) fn begin_drag(&mut self, body: &DeformableBody, holds: usize) {
        if self.x.len() != body.nodes() * 3 {
            self.x.clear();
            self.extra.clear();
            self.transforms = vec![Transform::IDENTITY; holds];
        }
    }

    /// Whether [`HandleSystem::settle_drag`](crate::HandleSystem::settle_drag) has something to do.
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

    /// Puts other scales in the place of those that keep the volume in the last pose that was fitted, and returns these.
    pub fn exchange_volume(&mut self, scales: VolumeScales) -> VolumeScales {
        std::mem::replace(&mut self.volume, scales)
    }

    /// Drops what refinement had added to the first pass's rotations, so that the next solve fits them again.
    pub fn forget_fits(&mut self) {
        self.extra.clear();
    }

    /// What fits have added to the first pass's rotations in the last solution, by node; empty where none were asked for.
    pub fn added_turns(&self) -> &[LocalRotation] {
        &self.extra
    }

    /// Replaces what fits have added to the first pass's rotations.
    pub fn set_added_turns(&mut self, turns: Vec<LocalRotation>) {
        self.extra = turns;
    }

    /// Takes the last solution out, for [`SolveState::put_back`] after other poses were solved; memory stays.
    pub fn take_solution(&mut self) -> Self {
        Self {
            x: std::mem::take(&mut self.x),
            transforms: std::mem::take(&mut self.transforms),
            extra: std::mem::take(&mut self.extra),
            volume: std::mem::take(&mut self.volume),
            borders: std::mem::take(&mut self.borders),
            ..Self::default()
        }
    }

    /// Puts back what [`SolveState::take_solution`] has taken out.
    pub fn put_back(&mut self, kept: Self) {
        self.x = kept.x;
        self.transforms = kept.transforms;
        self.extra = kept.extra;
        self.volume = kept.volume;
        self.borders = kept.borders;
    }

    /// What frames leave to each other about surfaces that cross.
    pub fn contact(&mut self) -> &mut ContactMemory {
        &mut self.contact
    }

    /// Whether nothing was solved with it.
    pub fn is_empty(&self) -> bool {
        self.byte_size() == 0
    }

    /// Drops all but memory, as other handles need.
    pub fn reset(&mut self) {
        self.forget();
        self.transforms.clear();
        self.turning.clear();
        self.contact.forget();
        self.rhs.clear();
    }

    /// Lets go of the last solution: the next solve starts from the rest shape.
    pub fn forget(&mut self) {
        self.rows.let_go();
        self.x.clear();
        self.extra.clear();
    }
}

/// A row without a node.
pub(super) const NO_NODE: u32 = u32::MAX;

/// Given nodes that one hold has.
#[derive(Debug, Clone, Copy)]
struct HeldNodes {
    hold: usize,
    count: f64,
    /// Their mean rest position, model space.
    mean: DVec3,
}

/// The last solution of a drag, row by row.
#[derive(Debug, Default)]
pub(crate) struct DragRows {
    pub(super) pose: PoseRows,
    /// The row of each node.
    pub(super) row_of: Vec<u32>,
    /// What `pose.x` is relative to, solving coordinates.
    pub(super) center: DVec3,
    held: Vec<HeldNodes>,
    /// Given nodes that no hold moves: how many, and the sum of their rest positions, solving coordinates.
    unmoved: (f64, DVec3),
    /// The last solution is here, and not in the order of nodes.
    is_newest: bool,
}

impl DragRows {
    /// Takes over the last solution, `x` in the order of nodes, which is given up; where that is empty, the rest shape.
    pub(super) fn take_over(&mut self, body: &DeformableBody, handles: &HandleSystem, x: &mut Vec<f64>, pool: &Pool) {
        if self.is_newest {
            return;
        }
        let vertices = body.hierarchy.row_vertices();
        let Self { pose, row_of, .. } = self;
        let rest = |node: usize| body.rest(node).to_array();
        let start = |node: usize| match x.get(3 * node..3 * node + 3) {
            Some(at) => [at[0], at[1], at[2]],
            None => rest(node),
        };
        let find_rows = || {
            row_of.clear();
            row_of.resize(body.nodes(), 0);
            for (row, &node) in vertices.iter().enumerate().filter(|(_, v)| **v != NO_NODE) {
                row_of[node as usize] = row as u32;
            }
        };
        // Finding rows takes one thread; poses have work for the others.
        pool.install(|| rayon::join(|| pose.begin(&body.hierarchy, rest, start, pool), find_rows));
        self.center = DVec3::ZERO;
        self.find_held(body, handles);
        *x = Vec::new();
        self.is_newest = true;
    }

    /// Gives the last solution back in the order of nodes, if it is here.
    pub(crate) fn hand_over(&mut self, body: &DeformableBody, x: &mut Vec<f64>) {
        if !self.is_newest {
            return;
        }
        self.is_newest = false;
        x.clear();
        x.extend(self.row_of.iter().flat_map(|&row| {
            let here = &self.pose.x[row as usize];
            [
                here[0] + self.center.x,
                here[1] + self.center.y,
                here[2] + self.center.z,
            ]
        }));
        debug_assert!(x.len() == body.nodes() * 3);
    }

    /// Whether the last solution is here.
    pub(super) fn is_newest(&self) -> bool {
        self.is_newest
    }

    /// Gives memory back that does not hold the last solution.
    pub(super) fn release(&mut self) {
        if !self.is_newest {
            (self.pose, self.row_of) = (PoseRows::default(), Vec::new());
        }
    }

    /// Forgets the last solution.
    pub(crate) fn let_go(&mut self) {
        self.is_newest = false;
    }

    fn find_held(&mut self, body: &DeformableBody, handles: &HandleSystem) {
        let holds = handles.handle_count();
        let mut held = vec![(0.0, DVec3::ZERO); holds];
        self.unmoved = (0.0, DVec3::ZERO);
        for (node, _) in handles.given().iter().enumerate().filter(|(_, given)| **given) {
            let k = handles.position.hard[node];
            match held.get_mut(k as usize).filter(|_| k != UNHELD) {
                Some((count, sum)) => {
                    *count += 1.0;
                    *sum += body.graph.positions[node];
                }
                None => {
                    self.unmoved.0 += 1.0;
                    self.unmoved.1 += body.rest(node);
                }
            }
        }
        self.held.clear();
        let some = held.into_iter().enumerate().filter(|(_, (count, _))| *count > 0.0);
        self.held.extend(some.map(|(hold, (count, sum))| HeldNodes {
            hold,
            count,
            mean: sum / count,
        }));
    }

    /// The mean of what is held, solving coordinates; the origin where nothing is.
    pub(super) fn mean_of_held(&self, body: &DeformableBody, transforms: &[Transform]) -> DVec3 {
        let (mut count, mut sum) = self.unmoved;
        for held in &self.held {
            let place = transforms.get(held.hold).map_or(held.mean, |t| t.map()(held.mean));
            count += held.count;
            sum += body.solving_from_model(place) * held.count;
        }
        if count > 0.0 { sum / count } else { DVec3::ZERO }
    }

    /// Bytes held on the heap.
    pub(super) fn byte_size(&self) -> usize {
        self.pose.byte_size() + 4 * self.row_of.capacity() + size_of::<HeldNodes>() * self.held.capacity()
    }
}
