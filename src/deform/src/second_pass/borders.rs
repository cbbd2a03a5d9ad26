//! What is free leaves a hard handle in the handle's direction.
//!
//! A handle that holds its nodes gives the fitted shape a boundary that is continuous and nothing more: strain is largest at the very
//! edge of the region, where one side gives way and the other does not, and a ring further it has fallen. So the strain around the
//! edge is measured in the fitted shape, and the pose is solved once more with frames that are strained the other way by as much: all
//! of it on the edge itself, less from ring to ring. Where the band is thin against what is free, the solution then has next to no strain
//! at the edge (its gradient there is the handle's rotation) and little more elsewhere. What is held does not move.

use crate::border_frames::{BorderFrames, linear};
use crate::error::Error;
use crate::handles::ownership::UNHELD;
use crate::pose::FitOrder;
use crate::second_pass::equations::PosedHandles;
use crate::second_pass::refine::RotationFit;
use crate::second_pass::state::SolveState;
use crate::solve::{PoseSolve, SolveTally};
use glam::{DMat3, DVec3};
use pliant_exec::progress::check;
use pliant_solver::{InitialGuess, SolveStats};

/// Rings of edges over which the correction falls from all to nothing.
const RINGS: u8 = 2;
/// In directions that no edge of a node has, strain is taken for none: weight of that against the mean square of its edges.
const UNSEEN: f64 = 0.02;
/// The largest entry of a strain that is taken away in full; of a larger one as much as this, so that no frame collapses.
const MOST: f64 = 0.75;
/// Corrections whose largest entry is below this one are not worth a solve.
const LEAST: f64 = 1e-3;
/// A ring that is not counted.
const BEYOND: u8 = u8::MAX;

impl PoseSolve<'_> {
    /// Whether borders are made smooth: where that is asked for and rotations are fitted to a pose of its own. Stiff parts are
    /// solved for in another way.
    pub(crate) fn smooths_borders(&self) -> bool {
        let request = self.request;
        request.smooth_borders
            && request.steps() > 0
            && request.fits != FitOrder::Carried
            && self.handles.stiff.is_empty()
    }

    /// Solves on from the fitted solution in `state` with frames that take the strain from the edges of hard handles;
    /// `state.borders` has their corrections afterwards. `None` where next to nothing is strained there.
    ///
    /// # Errors
    /// [`Error::Solver`], [`Error::Cancelled`].
    pub(crate) fn smooth_borders(
        &self,
        fit: &RotationFit<'_>,
        posed: &mut PosedHandles,
        state: &mut SolveState,
        tally: &mut SolveTally<'_>,
    ) -> Result<Option<SolveStats>, Error> {
        check(self.exec.progress)?;
        if tally.stopped {
            return Ok(None);
        }
        let (rings, nodes) = self.border_rings(fit);
        let x = &state.x;
        let corrections = self.exec.pool.map(nodes.len(), 256, |k| {
            let node = nodes[k] as usize;
            let strain = self.strain(node, &rings, &linear(&posed.frames[node]), x);
            let part = (MOST / largest_entry(&strain)).min(1.0);
            let by = strain * (part * (f64::from(rings[node]) / f64::from(RINGS) - 1.0));
            (nodes[k], DMat3::IDENTITY + by, largest_entry(&by))
        });
        let finite = corrections.iter().filter(|(_, by, _)| by.is_finite());
        if finite.clone().all(|(.., largest)| *largest < LEAST) {
            return Ok(None);
        }
        state.borders = BorderFrames::new(finite.map(|&(node, by, _)| (node, by)).collect());
        self.assemble(posed, state);
        let start = InitialGuess::Given;
        self.run(&self.handles.positions, start, 0.0, state, tally).map(Some)
    }

    /// By node its ring around what is held hard, which is ring 0 where it has a free neighbour, and the nodes of all rings that are
    /// corrected.
    fn border_rings(&self, fit: &RotationFit<'_>) -> (Vec<u8>, Vec<u32>) {
        let (body, handles) = (self.body, self.handles);
        let is_given = |node: usize| handles.positions.fixed[node];
        let is_free = |node: usize| !is_given(node) && fit.is_open(node);
        let is_held = |node: usize| is_given(node) && handles.rotation.hard[node] != UNHELD;
        let is_edge = |node: usize| is_held(node) && body.edges(node).any(|(other, _)| is_free(other));
        let edge = self.exec.pool.map(body.nodes(), 1024, is_edge);
        let mut rings: Vec<u8> = edge.iter().map(|edge| if *edge { 0 } else { BEYOND }).collect();
        let mut nodes: Vec<u32> = (0u32..)
            .zip(&edge)
            .filter(|(_, edge)| **edge)
            .map(|(node, _)| node)
            .collect();
        let mut first = 0;
        for ring in 1..RINGS {
            let end = nodes.len();
            for k in first..end {
                for (other, _) in body.edges(nodes[k] as usize) {
                    if rings[other] == BEYOND && is_free(other) {
                        rings[other] = ring;
                        nodes.push(other as u32);
                    }
                }
            }
            first = end;
        }
        (rings, nodes)
    }

    /// What the linear map that comes closest to what the edges of a node do is beyond its frame, in the frame's own axes. Of a
    /// node that is held, edges to free ones count.
    fn strain(&self, node: usize, rings: &[u8], frame: &DMat3, x: &[f64]) -> DMat3 {
        let body = self.body;
        let at = |j: usize| DVec3::new(x[3 * j], x[3 * j + 1], x[3 * j + 2]);
        let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
        let (mut now, mut rest) = (DMat3::ZERO, DMat3::ZERO);
        for (other, weight) in body.edges(node) {
            if rings[node] == 0 && rings[other] != 1 {
                continue;
            }
            let edge = body.rest(node) - body.rest(other);
            now += outer((at(node) - at(other)) * weight, edge);
            rest += outer(edge * weight, edge);
        }
        let unseen = (rest.x_axis.x + rest.y_axis.y + rest.z_axis.z) / 3.0 * UNSEEN;
        let map = (now + *frame * unseen) * (rest + DMat3::from_diagonal(DVec3::splat(unseen))).inverse();
        frame.inverse() * map - DMat3::IDENTITY
    }
}

fn largest_entry(map: &DMat3) -> f64 {
    map.to_cols_array().iter().fold(0.0, |most, v| v.abs().max(most))
}
