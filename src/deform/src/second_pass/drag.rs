//! Poses of a drag: both passes on the solver's rows, in the order in which memory holds them.
//!
//! One pass over the rows blends each node's frame and carries its place along with the handles; the solver makes right-hand
//! sides and residuals from the frames as it goes and iterates; then places and frames of the surface are taken out, and nothing
//! is done for nodes inside. Single precision is enough for poses that are shown and then forgotten: what is asked for more
//! exactly than that takes the way of `solve.rs`.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::field_terms::FieldTerms;
use crate::first_pass::blend::{LocalFrame, PoseBlend};
use crate::first_pass::quick_frames::{NodeFrames, QuickFrames};
use crate::handles::motion::moved_by;
use crate::handles::ownership::UNHELD;
use crate::handles::system::HandleSystem;
use crate::pose::{FirstPass, SolutionExtent, SolveStart, SolveUpdate, SolvedNodes};
use crate::rotation::Transform;
use crate::second_pass::equations::ScatteredPose;
use crate::second_pass::state::{DragRows, NO_NODE, SolveState};
use crate::solve::{PoseSolve, SolveTally};
use glam::{DAffine3, DVec3, Mat3};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_solver::{Lanes, SolveControl, SolveStats, prefetch};
use rayon::prelude::*;

/// Tolerances below this one need right-hand sides in double precision.
pub(super) const SINGLE_TOLERANCE: f64 = 1e-5;
/// The same for missing displacements, as a fraction of the diagonal.
pub(super) const SINGLE_ERROR: f64 = 1e-5;
/// Rows that one piece of work handles.
const PIECE: usize = 4096;
/// Rows, and nodes, that memory is asked for before they are needed.
const AHEAD: usize = 24;

impl HandleSystem {
    /// Solves on where the last pose of a drag has left much of what it was allowed to leave, so that the next one has less to do.
    /// Does nothing elsewhere.
    ///
    /// # Errors
    /// [`Error::Solver`], [`Error::Cancelled`]; `state` stays usable after either.
    pub fn settle_drag(&self, body: &DeformableBody, state: &mut SolveState, exec: &Exec<'_>) -> Result<(), Error> {
        if !state.is_worth_settling() {
            return Ok(());
        }
        let SolveState { rows, workspace, .. } = &mut *state;
        let settled = (self.positions.system).settle_pose(&body.hierarchy, &mut rows.pose, workspace, exec);
        let settled = settled.map_err(Error::from);
        if matches!(settled, Err(Error::Solver(_))) {
            state.forget();
        }
        settled
    }
}

impl PoseSolve<'_> {
    /// Whether a pose may take this way.
    pub(crate) fn can_drag(&self) -> bool {
        let Self { handles, request, .. } = *self;
        request.start == SolveStart::Warm
            && request.steps() == 0
            && matches!(request.first_pass, FirstPass::Harmonic)
            && handles.rigid.is_none()
            && handles.positions.system.can_solve_poses()
            && request.quality.tolerance.is_none_or(|t| t >= SINGLE_TOLERANCE)
            && request.quality.max_error.is_none_or(|e| e >= SINGLE_ERROR)
    }

    /// Solves a pose from the last solution.
    ///
    /// # Errors
    /// [`Error::Solver`] where numbers left the range of single precision, [`Error::Cancelled`]. The state has then to forget.
    pub(crate) fn drag(
        &self,
        state: &mut SolveState,
        watch: &mut dyn FnMut(&SolveUpdate<'_>) -> bool,
    ) -> Result<SolvedNodes, Error> {
        let Self {
            handles,
            body,
            request,
            moved_parts,
            exec,
        } = *self;
        exec.progress.begin_pass("blend");
        if !state.rows.is_newest() {
            state.begin_drag(body, request.transforms.len());
            state.rows.take_over(body, handles, &mut state.x, exec.pool);
            state.extra = Vec::new();
            state.release_start();
        }
        let center = state.rows.mean_of_held(body, request.transforms);
        let pass = RowPass {
            frames: QuickFrames::new(PoseBlend::new(body, handles, request.transforms, None)),
            motions: handles.motions(body, &state.transforms, request.transforms),
            maps: request.transforms.iter().map(Transform::map).collect(),
            centers: [state.rows.center, center],
            handles,
            body,
        };
        pass.run(&mut state.rows, exec.pool);
        state.rows.center = center;
        state.transforms.clear();
        state.transforms.extend_from_slice(request.transforms);
        fill_scattered(handles, body, request.transforms, &mut state.rows);

        exec.progress.begin_pass("load");
        let mut tally = SolveTally {
            iterations: 0,
            refined: 0,
            center,
            watch,
            stopped: false,
        };
        let stats = self.solve_rows(state, &mut tally)?;

        exec.progress.begin_pass("place");
        let nodes = match request.extent {
            // Loose parts follow nodes inside as well.
            SolutionExtent::Positions | SolutionExtent::Surface if handles.parts.is_empty() => body.graph.surface,
            _ => body.nodes(),
        };
        let placement = handles.placement(body, moved_parts, request.transforms, center);
        let rows = &state.rows;
        let at = |node: usize| rows.pose.x[rows.row_of[node] as usize];
        let (mut positions, mut frames) = std::mem::take(&mut state.spare);
        exec.pool.install(|| {
            let all = (0..nodes).into_par_iter().with_min_len(PIECE);
            let placed = all.map(|node| {
                if let Some(&later) = rows.row_of.get(node + AHEAD) {
                    prefetch(&rows.pose.x, later as usize);
                }
                placement.of(node, &at(node)[..3])
            });
            placed.collect_into_vec(&mut positions);
        });
        if let Some(node) = positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::Solver(format!("node {node} left the range of numbers")));
        }
        handles.parts.place(body, &mut positions);
        match request.extent {
            SolutionExtent::Positions => frames.clear(),
            _ => rows.copy_frames(&mut frames, nodes, exec.pool),
        }
        Ok(SolvedNodes {
            frames,
            positions,
            stats: self.stats(&stats, stats.iterations, 0),
        })
    }

    fn solve_rows(&self, state: &mut SolveState, tally: &mut SolveTally<'_>) -> Result<SolveStats, Error> {
        let SolveState { rows, workspace, .. } = state;
        rows.pose.remember = true;
        let stats = self
            .handles
            .positions
            .system
            .pose_equations(&self.body.hierarchy)
            .solve(&mut rows.pose, self.criteria(), workspace, self.exec, &mut |done| {
                self.report_cycle(done, 0, tally);
                match tally.stopped {
                    true => SolveControl::Stop,
                    false => SolveControl::Continue,
                }
            })?;
        Ok(stats)
    }
}

/// Ties and soft pulls, which reach few nodes.
pub(super) fn fill_scattered(
    handles: &HandleSystem,
    body: &DeformableBody,
    transforms: &[Transform],
    rows: &mut DragRows,
) {
    if !handles.has_scattered(body) {
        return;
    }
    let center = rows.center;
    let DragRows { pose, row_of, .. } = rows;
    let rows = &pose.rows;
    pose.more.clear();
    pose.more.resize(rows.len(), Lanes::ZERO);
    let frame = |node: usize| Mat3::from_cols_array(&rows[row_of[node] as usize].map()).as_dmat3();
    let more = &mut pose.more;
    let at = |node: usize| DVec3::from_slice(&pose.x[row_of[node] as usize][..3]);
    let scattered = ScatteredPose {
        transforms,
        center,
        frame,
        at,
    };
    handles.add_scattered(body, &scattered, &mut |node, by| {
        let row = &mut more[row_of[node] as usize].0;
        let by = by.as_vec3();
        (0..3).for_each(|c| row[c] += by[c]);
    });
}

/// The pass before the solve: frames, and places carried along with the handles.
struct RowPass<'a, M> {
    frames: QuickFrames<'a>,
    motions: FieldTerms<'a, DAffine3>,
    /// By hold: from rest to where the pose has it, model space.
    maps: Vec<M>,
    /// What places are relative to, before and after.
    centers: [DVec3; 2],
    handles: &'a HandleSystem,
    body: &'a DeformableBody,
}

impl<M: Fn(DVec3) -> DVec3 + Send + Sync> RowPass<'_, M> {
    fn run(&self, rows: &mut DragRows, pool: &Pool) {
        let vertices = self.body.hierarchy.row_vertices();
        rows.pose.place_rows(pool, NodeFrames::default, |block, row, frame, x| {
            if let Some(&later) = vertices.get(row + AHEAD).filter(|later| **later != NO_NODE) {
                self.prefetch(later as usize);
            }
            let node = vertices[row];
            if node == NO_NODE {
                return;
            }
            let node = node as usize;
            frame.set_map_columns(&self.frames.of_row(row, vertices, block));
            let place = self.place_of(node, DVec3::new(x[0], x[1], x[2]));
            (x[0], x[1], x[2]) = place.into();
        });
    }

    /// Asks memory for what the pass reads of a node: rows follow a curve through space, nodes do not.
    #[inline]
    fn prefetch(&self, node: usize) {
        self.frames.prefetch(node);
        self.motions.prefetch(node);
        prefetch(&self.handles.positions.fixed, node);
    }

    /// Where a node is when the solve begins.
    fn place_of(&self, node: usize, before: DVec3) -> DVec3 {
        let [from, to] = self.centers;
        if self.handles.positions.fixed[node] {
            let k = self.handles.position.hard[node];
            return match self.maps.get(k as usize).filter(|_| k != UNHELD) {
                Some(map) => self.body.solving_from_model(map(self.body.graph.positions[node])) - to,
                None => self.body.rest(node) - to,
            };
        }
        let here = before + from;
        let mut moved = DVec3::ZERO;
        (self.motions).each_at(node, |share, map| moved += moved_by(map, share, here));
        here + moved - to
    }
}

impl DragRows {
    /// Replaces `out` by the frames of the first `nodes` nodes.
    fn copy_frames(&self, out: &mut Vec<LocalFrame>, nodes: usize, pool: &Pool) {
        pool.install(|| {
            let rows = self.row_of[..nodes].par_iter().with_min_len(PIECE);
            let frames = rows.map(|&row| self.pose.rows[row as usize].map());
            frames.collect_into_vec(out);
        });
    }
}
