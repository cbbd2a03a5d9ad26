//! From the solver's coordinates to positions: unmoved nodes keep their bits, handles set the nodes they hold, loose
//! parts are placed, rigid regions keep their shape.

use crate::deform::body::DeformableBody;
use crate::deform::first_pass::frame::{LocalFrame, pack_frame};
use crate::deform::handles::ownership::NOBODY;
use crate::deform::handles::system::HandleSystem;
use crate::deform::rotation::fit::fit_rigid_motion;
use crate::deform::transform::Transform;
use crate::mesh::rotation::exp_rotation;
use crate::pool::Pool;
use glam::DVec3;
use rayon::prelude::*;

/// Brings nodes from solving coordinates around `center` to model space.
pub(in crate::deform) struct NodePlacement<'a, M> {
    rig: &'a HandleSystem,
    body: &'a DeformableBody,
    moved_parts: &'a [bool],
    /// By hold: from rest to where the pose has it, model space.
    maps: Vec<M>,
    center: DVec3,
}

impl<M: Fn(DVec3) -> DVec3> NodePlacement<'_, M> {
    /// The position of a node that was solved to `x`.
    pub fn of(&self, node: usize, x: &[f64]) -> DVec3 {
        let Self { rig, body, .. } = *self;
        let rest = body.graph.positions[node];
        if !self.moved_parts[body.graph.component[node] as usize] {
            return rest;
        }
        match rig.position.hard[node] {
            NOBODY if rig.positions.fixed[node] => rest,
            NOBODY => body.model_from_solving(DVec3::from_slice(x) + self.center),
            k => self.maps.get(k as usize).map_or(rest, |map| map(rest)),
        }
    }
}

impl HandleSystem {
    /// By component: whether any hold that has moved has a say in it.
    pub(in crate::deform) fn moved_parts(&self, body: &DeformableBody, transforms: &[Transform]) -> Vec<bool> {
        let mut moved = vec![false; body.graph.components];
        for (hold, _) in self
            .setup
            .handles
            .iter()
            .zip(transforms)
            .filter(|(_, t)| !t.is_identity())
        {
            let nodes = hold.nodes.iter().copied().chain(hold.pulls.iter().map(|p| p.0));
            nodes.for_each(|n| moved[body.graph.component[n as usize] as usize] = true);
        }
        moved
    }

    /// Model-space positions of all nodes from solving coordinates around `center`: nodes of unmoved parts and
    /// nodes held by handles are exact, loose parts are placed.
    pub(in crate::deform) fn place(
        &self,
        body: &DeformableBody,
        moved_parts: &[bool],
        (transforms, center): (&[Transform], DVec3),
        x: &[f64],
        pool: &Pool,
    ) -> Vec<DVec3> {
        let placement = self.placement(body, moved_parts, transforms, center);
        let mut positions: Vec<DVec3> = pool.install(|| {
            let nodes = x.as_chunks::<3>().0.par_iter().enumerate().with_min_len(4096);
            nodes.map(|(node, x)| placement.of(node, x)).collect()
        });
        self.parts.place(body, &mut positions);
        positions
    }

    /// Where single nodes are, loose parts aside.
    pub(in crate::deform) fn placement<'a>(
        &'a self,
        body: &'a DeformableBody,
        moved_parts: &'a [bool],
        transforms: &[Transform],
        center: DVec3,
    ) -> NodePlacement<'a, impl Fn(DVec3) -> DVec3 + Send + Sync + use<>> {
        NodePlacement {
            rig: self,
            body,
            moved_parts,
            maps: transforms.iter().map(Transform::map).collect(),
            center,
        }
    }

    /// Replaces the solution on rigid regions that no hard handle puts in place by the rigid motion that fits it best. Where the
    /// handle gives the rotation, only the translation is fitted. The `frames` of the region, where there are any, turn with it,
    /// so that what lies around follows.
    pub(in crate::deform) fn make_regions_rigid(
        &self,
        body: &DeformableBody,
        transforms: &[Transform],
        frames: &mut [LocalFrame],
        x: &mut [f64],
    ) {
        let holds = self.setup.handles.iter().zip(transforms);
        for (hold, transform) in holds.filter(|(hold, _)| hold.is_loosely_rigid()) {
            let at = |n: &u32| DVec3::from_slice(&x[*n as usize * 3..*n as usize * 3 + 3]);
            let rest: Vec<_> = hold.nodes.iter().map(|n| body.rest(*n as usize)).collect();
            let now: Vec<_> = hold.nodes.iter().map(at).collect();
            let fitted = fit_rigid_motion(&rest, &now);
            let motion = match hold.rotation && hold.stiffness.is_none() {
                true => Transform {
                    rotation: transform.rotation,
                    ..fitted
                },
                false => fitted,
            };
            let (map, frame) = (motion.map(), pack_frame(exp_rotation(motion.rotation), None));
            for (n, p) in hold.nodes.iter().zip(&rest) {
                let n = *n as usize;
                if self.position.hard[n] == NOBODY {
                    x[n * 3..n * 3 + 3].copy_from_slice(&map(*p).to_array());
                    if let Some(own) = frames.get_mut(n) {
                        *own = frame;
                    }
                }
            }
        }
    }
}
