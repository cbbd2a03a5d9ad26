//! Poses of a drag: both passes on the solver's rows, in the order in which memory holds them.
//!
//! One pass over the rows blends each node's frame and carries its place along with the handles; the solver makes right-hand
//! sides and residuals from the frames as it goes and iterates; then places and frames of the surface are taken out, and nothing
//! is done for nodes inside. Single precision is enough for poses that are shown and then forgotten: what is asked for more
//! exactly than that takes the way of `solve.rs`.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::field_terms::FieldTerms;
use crate::first_pass::blend::{IDENTITY_FRAME, LocalFrame, PoseBlend};
use crate::first_pass::quick_frames::{NodeFrames, QuickFrames, SIDE_BY_SIDE};
use crate::handles::ownership::UNHELD;
use crate::handles::system::HandleSystem;
use crate::pose::{FirstPass, SolutionExtent, SolveStart, SolveUpdate, SolvedNodes};
use crate::rotation::Transform;
use crate::second_pass::equations::ScatteredPose;
use crate::second_pass::state::{DragRows, NO_NODE, SolveState};
use crate::solve::{PoseSolve, SolveTally};
use glam::{DVec3, Mat3};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_solver::{Lanes, PlaceRows, PoseRow, SolveControl, SolveStats, prefetch};
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
            motions: (handles.motions(body, &state.transforms, request.transforms))
                .map(|map| [map.x_axis, map.y_axis, map.z_axis, map.translation].map(with_zero)),
            maps: request.transforms.iter().map(Transform::map).collect(),
            centers: [state.rows.center, center],
            handles,
            body,
        };
        state.rows.pose.place_rows(exec.pool, &pass);
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
            SolutionExtent::Surface(_) if handles.parts.is_empty() => body.graph.surface,
            _ => body.nodes(),
        };
        let placement = handles.placement(body, moved_parts, request.transforms, center);
        let rows = &state.rows;
        let (mut positions, mut frames) = std::mem::take(&mut state.spare);
        positions.resize(nodes, DVec3::ZERO);
        exec.pool.install(|| {
            let pieces = positions.par_chunks_mut(PIECE).enumerate();
            pieces.for_each(|(k, piece)| {
                for (node, place) in (k * PIECE..).zip(piece) {
                    if let Some(&later) = rows.row_of.get(node + AHEAD) {
                        prefetch(&rows.pose.x, later as usize);
                    }
                    *place = placement.of(node, &rows.pose.x[rows.row_of[node] as usize][..3]);
                }
            });
        });
        if let Some(node) = positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::Solver(format!("node {node} left the range of numbers")));
        }
        handles.parts.place(body, &mut positions);
        match request.extent {
            SolutionExtent::Surface(framed) => rows.copy_some_frames(&mut frames, nodes, framed),
            SolutionExtent::Graph => rows.copy_frames(&mut frames, exec.pool),
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
    /// How handles moved: the columns of a map and what it adds, each with 0 behind it.
    motions: FieldTerms<'a, [[f64; 4]; 4]>,
    /// By hold: from rest to where the pose has it, model space.
    maps: Vec<M>,
    /// What places are relative to, before and after.
    centers: [DVec3; 2],
    handles: &'a HandleSystem,
    body: &'a DeformableBody,
}

impl<M: Fn(DVec3) -> DVec3 + Send + Sync> PlaceRows for RowPass<'_, M> {
    type Scratch = NodeFrames;

    #[inline(always)]
    fn place(&self, block: &mut NodeFrames, first: usize, rows: &mut [[PoseRow; 4]], x: &mut [[[f64; 4]; 4]]) {
        let nodes = self.body.hierarchy.row_vertices()[first..]
            .as_chunks::<SIDE_BY_SIDE>()
            .0;
        for (k, (rows, x)) in rows.iter_mut().zip(x).enumerate() {
            if let Some(later) = nodes.get(k + AHEAD / SIDE_BY_SIDE) {
                self.prefetch(later);
            }
            let frames = self.frames.of(&nodes[k], block);
            for (row, frame) in rows.iter_mut().zip(frames) {
                row.set_map_columns(frame);
            }
            self.carry(&nodes[k], x);
        }
    }
}

impl<M: Fn(DVec3) -> DVec3 + Send + Sync> RowPass<'_, M> {
    /// Asks memory for what the pass reads of nodes: rows follow a curve through space, nodes do not.
    #[inline(always)]
    fn prefetch(&self, nodes: &[u32; SIDE_BY_SIDE]) {
        self.frames.prefetch(nodes);
        self.motions.prefetch(nodes);
        for &node in nodes {
            if self.is_fixed(node) {
                prefetch(&self.body.graph.positions, node as usize);
            }
        }
    }

    #[inline(always)]
    fn is_fixed(&self, node: u32) -> bool {
        self.handles
            .positions
            .fixed
            .get(node as usize)
            .is_some_and(|&fixed| fixed)
    }

    /// Replaces where nodes were by where they are when the solve begins.
    #[inline(always)]
    fn carry(&self, nodes: &[u32; SIDE_BY_SIDE], x: &mut [[f64; 4]; SIDE_BY_SIDE]) {
        let [from, to] = self.centers.map(with_zero);
        let mut here = *x;
        for here in &mut here {
            *here = lanes(|c| here[c] + from[c]);
        }
        let mut moved = [[0.0; 4]; SIDE_BY_SIDE];
        (self.motions).each_beside(nodes, |lane, share, [a, b, c, shift]| {
            let (share, here) = (f64::from(share), here[lane]);
            let there = lanes(|k| a[k] * here[0] + b[k] * here[1] + c[k] * here[2] + shift[k]);
            moved[lane] = lanes(|k| moved[lane][k] + (there[k] - here[k]) * share);
        });
        for lane in (0..SIDE_BY_SIDE).filter(|lane| nodes[*lane] != NO_NODE) {
            x[lane] = lanes(|c| here[lane][c] + moved[lane][c] - to[c]);
            if self.is_fixed(nodes[lane]) {
                x[lane] = with_zero(self.held_place(nodes[lane] as usize) - self.centers[1]);
            }
        }
    }

    /// Where a node is held, solving coordinates.
    fn held_place(&self, node: usize) -> DVec3 {
        let k = self.handles.position.hard[node];
        match self.maps.get(k as usize).filter(|_| k != UNHELD) {
            Some(map) => self.body.solving_from_model(map(self.body.graph.positions[node])),
            None => self.body.rest(node),
        }
    }
}

#[inline(always)]
fn lanes(value: impl FnMut(usize) -> f64) -> [f64; 4] {
    std::array::from_fn(value)
}

fn with_zero(place: DVec3) -> [f64; 4] {
    [place.x, place.y, place.z, 0.0]
}

impl DragRows {
    /// Replaces `out` by the frames of all nodes.
    fn copy_frames(&self, out: &mut Vec<LocalFrame>, pool: &Pool) {
        pool.install(|| {
            let rows = self.row_of.par_iter().with_min_len(PIECE);
            let frames = rows.map(|&row| self.pose.rows[row as usize].map());
            frames.collect_into_vec(out);
        });
    }

    /// Makes room in `out` for the frames of the first `nodes` nodes and puts those of `framed` there; without any, none.
    fn copy_some_frames(&self, out: &mut Vec<LocalFrame>, nodes: usize, framed: &[u32]) {
        match framed {
            [] => out.clear(),
            _ => out.resize(nodes, IDENTITY_FRAME),
        }
        for &node in framed {
            out[node as usize] = self.pose.rows[self.row_of[node as usize] as usize].map();
        }
    }
}
