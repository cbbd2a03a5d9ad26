//! Solving a pose by a displacement of space.

use crate::deform::body::DeformableBody;
use crate::deform::comparison::spatial_rbf::{BUNDLE, RbfSpace, at_rest};
use crate::deform::error::Error;
use crate::deform::handles::free_parts::FreePartPolicy;
use crate::deform::handles::ownership::NOBODY;
use crate::deform::handles::system::HandleSystem;
use crate::deform::second_pass::pose::{PoseMethod, PoseSolution};
use crate::deform::second_pass::state::SolveState;
use crate::deform::transform::Transform;
use crate::exec::Exec;
use glam::DVec3;
use rayon::prelude::*;

/// Solves poses by deforming space, with what it has made of the handles once.
#[derive(Debug, Default)]
pub struct SpatialRbf {
    space: Option<Box<RbfSpace>>,
}

impl SpatialRbf {
    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.space.as_ref().map_or(0, |space| space.byte_size())
    }

    /// Solves a pose by deforming space instead of the graph. Of loose parts only those stay that the policy
    /// [`FreePartPolicy::Hold`] keeps: all others are where space takes them. The result reports how far the interpolant misses
    /// held vertices, which are then put where they belong. `state` forgets the last solution on the graph.
    ///
    /// # Errors
    /// [`Error::Solver`], [`Error::Cancelled`].
    pub fn solve(
        &mut self,
        rig: &HandleSystem,
        body: &DeformableBody,
        transforms: &[Transform],
        state: &mut SolveState,
        exec: &Exec<'_>,
    ) -> Result<PoseSolution, Error> {
        if transforms.iter().all(Transform::is_identity) {
            return Ok(PoseSolution::at_rest(body));
        }
        // The graph's solves start afresh after this one.
        state.forget();
        let space = match self.space.take() {
            Some(space) => space,
            None => Box::new(RbfSpace::new(body, rig, exec)?),
        };
        let space: &RbfSpace = self.space.insert(space);
        let maps: Vec<_> = transforms.iter().map(Transform::map).collect();
        let wanted = |node: usize, hold: u32| match maps.get(hold as usize) {
            Some(map) => body.solving_from_model(map(body.graph.positions[node])) - at_rest(body, node),
            None => DVec3::ZERO,
        };
        let targets: Vec<DVec3> = space
            .centres
            .iter()
            .map(|c| c.pulls.iter().map(|&(k, u)| wanted(c.node as usize, k) * u).sum())
            .collect();
        let displacement = space.interpolate(&targets);
        let mut moves: Vec<DVec3> = Vec::with_capacity(body.nodes());
        // In pieces, so that nobody waits long for a result that is not wanted any more.
        for from in (0..body.nodes()).step_by(1 << 14) {
            exec.check()?;
            let to = body.nodes().min(from + (1 << 14));
            let piece: Vec<[DVec3; BUNDLE]> = exec.pool.install(|| {
                (from..to)
                    .into_par_iter()
                    .step_by(BUNDLE)
                    .with_min_len(16)
                    .map(|i| displacement.at(&std::array::from_fn(|l| at_rest(body, (i + l).min(to - 1)))))
                    .collect()
            });
            moves.extend(piece.into_flattened().into_iter().take(to - from));
        }
        let (mut missed, mut farthest) = (0.0f64, 0.0f64);
        for i in (0..body.graph.surface).filter(|&i| rig.position.hard[i] != NOBODY) {
            let wanted = wanted(i, rig.position.hard[i]);
            missed = missed.max(wanted.distance(moves[i]));
            farthest = farthest.max(wanted.length());
        }
        let mut x: Vec<f64> = moves
            .iter()
            .enumerate()
            .flat_map(|(i, d)| (at_rest(body, i) + *d).to_array())
            .collect();
        rig.make_regions_rigid(body, transforms, &mut [], &mut x);
        let stays = |i: usize| {
            rig.setup.policy == FreePartPolicy::Hold && rig.positions.fixed[i] && rig.position.hard[i] == NOBODY
        };
        let positions: Vec<DVec3> = (0..body.nodes())
            .map(|i| match rig.position.hard[i] {
                NOBODY if stays(i) => body.graph.positions[i],
                NOBODY => body.model_from_solving(DVec3::from_slice(&x[3 * i..3 * i + 3])),
                k => maps
                    .get(k as usize)
                    .map_or(body.graph.positions[i], |map| map(body.graph.positions[i])),
            })
            .collect();
        if let Some(node) = positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::Solver(format!("node {node} left the range of numbers")));
        }
        Ok(PoseSolution {
            positions,
            iterations: 1,
            residual: missed / farthest.max(f64::MIN_POSITIVE),
            max_error: missed * body.unit / body.diagonal,
            method: PoseMethod::SpatialRbf,
            ..PoseSolution::at_rest(body)
        })
    }
}
