//! A set of handles on a body: who holds which node, the first-pass fields and the constrained systems.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::fields::{HarmonicFields, solve_fields};
use crate::handles::free_parts::FreeParts;
use crate::handles::ownership::{HandleConstraint, HandleSetup, NodeOwnership, UNHELD};
use crate::handles::pulled_places::PulledPlaces;
use crate::handles::stiff::StiffParts;
use crate::rotation::Transform;
use crate::shares::SparseShares;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_solver::{Constraints, LinearSystem};
use std::sync::OnceLock;

/// A system with the nodes that it takes as given.
pub(crate) struct ConstrainedSystem {
    pub fixed: Vec<bool>,
    pub system: LinearSystem,
}

/// Handles on a body, ready for any number of poses.
pub struct HandleSystem {
    pub(crate) setup: HandleSetup,
    pub(crate) position: NodeOwnership,
    pub(crate) rotation: NodeOwnership,
    /// Fields of the handles that constrain rotation.
    pub(crate) rotation_fields: HarmonicFields,
    /// What rotations are blended with instead, when a handle is small.
    pub(crate) blending_fields: Option<HarmonicFields>,
    /// Fields of those that constrain scale; `None` when they are the same as for rotation.
    pub(crate) scale_fields: Option<HarmonicFields>,
    pub(crate) positions: ConstrainedSystem,
    /// With rigid regions that nothing holds hard: the system in which they are given too.
    pub(crate) rigid: Option<ConstrainedSystem>,
    pub(crate) parts: FreeParts,
    /// Parts that move as rigid bodies.
    pub(crate) stiff: StiffParts,
    /// Where holds with targets want the nodes that they pull.
    pub(crate) places: PulledPlaces,
    /// The fields that rotations are blended with, node by node; made when first asked for.
    sparse: OnceLock<SparseShares>,
    /// Iterations that the fields took, for reports.
    pub field_iterations: usize,
}

impl HandleSystem {
    /// Solves the first-pass fields and prepares the second pass (paper sections 2.1 and 4). Reports the stages
    /// "fields" and "constrain".
    ///
    /// # Errors
    /// [`Error::NoPosition`], [`Error::FreePart`], [`Error::Solver`], [`Error::Cancelled`].
    pub fn build(body: &DeformableBody, setup: HandleSetup, exec: &Exec<'_>) -> Result<Self, Error> {
        exec.progress.report("fields", 0.0);
        let nodes = body.nodes();
        let position = NodeOwnership::settle(&setup, nodes, |h| h.position);
        // Mostly all of them constrain the same handles.
        let like = |a: &NodeOwnership,
                    same: &dyn Fn(&HandleConstraint) -> bool,
                    constrains: fn(&HandleConstraint) -> bool| match setup.handles.iter().all(same) {
            true => a.clone(),
            false => NodeOwnership::settle(&setup, nodes, constrains),
        };
        let rotation = like(&position, &|h| h.rotation == h.position, |h| h.rotation);
        let scale = like(&rotation, &|h| h.scale == h.rotation, |h| h.scale);
        let (covered, parts) = settle_parts(body, &setup, &position)?;

        let holds = setup.handles.len();
        let (rotation_fields, system) = solve_fields(body, &rotation, holds, exec)?;
        let blending_fields = rotation_fields.around_small(body, &rotation, exec.pool);
        let shared = scale.same_as(&rotation);
        let scale_fields = match shared {
            true => None,
            false => Some(solve_fields(body, &scale, holds, exec)?.0),
        };
        let field_iterations = rotation_fields.iterations + scale_fields.as_ref().map_or(0, |fields| fields.iterations);

        // What holds rotations mostly holds positions too, and then both have one system.
        let system = system.filter(|_| position.same_as(&rotation));
        let PositionSystems {
            positions,
            rigid,
            stiff,
        } = PositionSystems::make(body, &setup, &position, &covered, system, exec)?;
        Ok(Self {
            setup,
            position,
            rotation,
            rotation_fields,
            blending_fields,
            scale_fields,
            positions,
            rigid,
            parts,
            stiff,
            places: PulledPlaces::default(),
            sparse: OnceLock::new(),
            field_iterations,
        })
    }

    /// What it was built from.
    pub fn setup(&self) -> &HandleSetup {
        &self.setup
    }

    /// Nodes that handles hold in place, or that move with a part in which no handle lies.
    pub(crate) fn held_nodes(&self) -> &[bool] {
        &self.rigid.as_ref().unwrap_or(&self.positions).fixed
    }

    /// Which handles hold the positions of which nodes.
    pub fn position_owners(&self) -> &NodeOwnership {
        &self.position
    }

    /// Which handles hold the rotations of which nodes.
    pub fn rotation_owners(&self) -> &NodeOwnership {
        &self.rotation
    }

    /// The system that positions are solved with.
    pub fn position_system(&self) -> &LinearSystem {
        &self.positions.system
    }

    /// By handle, the joint between it and what is free, which it turns about by default. `None` for a handle that constrains no
    /// rotation, or around which nothing is free.
    pub fn joints(&self, body: &DeformableBody, pool: &Pool) -> Vec<Option<DVec3>> {
        let regions: Vec<&[u32]> = self.setup.handles.iter().map(|hold| &hold.nodes[..]).collect();
        self.rotation_fields.joints(&regions, &body.graph, pool)
    }

    /// Number of handles.
    pub fn handle_count(&self) -> usize {
        self.setup.handles.len()
    }

    /// Makes ready what [`crate::FirstPass::WeightedSum`] blends with, which else the first pose does that asks for it.
    pub fn prepare_shares(&self, pool: &Pool) {
        self.sparse_shares(pool);
    }

    /// The fields that rotations are blended with, node by node.
    pub(crate) fn sparse_shares(&self, pool: &Pool) -> &SparseShares {
        self.sparse.get_or_init(|| {
            let fields = self.blending_fields.as_ref().unwrap_or(&self.rotation_fields);
            fields.largest_shares(self.position.hard.len(), pool)
        })
    }

    /// The fields of the handles that constrain rotation.
    pub fn rotation_fields(&self) -> &HarmonicFields {
        &self.rotation_fields
    }

    /// Whether places are asked for beside the transforms of handles.
    pub fn has_targets(&self) -> bool {
        self.places.has_targets()
    }

    /// By node: whether its position is given (held hard, frozen, or in a part that is placed by policy).
    pub fn given(&self) -> &[bool] {
        &self.positions.fixed
    }

    /// The hold that has a node hard in place; `None` where none has, and on nodes that may not move at all.
    pub fn hard_holder(&self, node: usize) -> Option<usize> {
        let holder = *self.position.hard.get(node)?;
        (holder != UNHELD && (holder as usize) < self.handle_count()).then_some(holder as usize)
    }

    /// By node: extra diagonal of soft handles, in units of edge weights; `None` without soft handles.
    pub fn stiffness(&self) -> Option<Vec<f64>> {
        self.position.stiffness()
    }

    /// By hold: how many of the body's surface nodes it constrains in place, after overlaps are settled.
    pub fn count_held_surface_nodes(&self, body: &DeformableBody) -> Vec<usize> {
        let mut count = vec![0; self.handle_count() + 1];
        self.position.hard[..body.graph.surface]
            .iter()
            .filter(|&&k| k != UNHELD)
            .for_each(|&k| count[k as usize] += 1);
        self.position
            .soft
            .iter()
            .filter(|s| (s.0 as usize) < body.graph.surface)
            .for_each(|s| count[s.1 as usize] += 1);
        count.truncate(self.handle_count());
        count
    }

    /// The surface nodes of each part that moves as a rigid body.
    pub fn stiff_parts<'a>(&'a self, body: &'a DeformableBody) -> impl Iterator<Item = &'a [u32]> + 'a {
        let surface = body.graph.surface as u32;
        (0..self.stiff.count()).map(move |part| {
            let nodes = self.stiff.nodes_of(part);
            &nodes[..nodes.partition_point(|n| *n < surface)]
        })
    }

    /// Largest distance of a surface node that is held hard from where its handle puts it (or from rest, where nothing may
    /// move). `now` returns where a surface node is; `transforms` has one for each hold.
    pub fn largest_misplacement(
        &self,
        body: &DeformableBody,
        transforms: &[Transform],
        now: impl Fn(usize) -> DVec3,
    ) -> f64 {
        let maps: Vec<_> = transforms
            .iter()
            .chain([&Transform::IDENTITY])
            .map(Transform::map)
            .collect();
        let held = self.position.hard[..body.graph.surface].iter().enumerate();
        let distances = held.filter_map(|(node, &holder)| {
            let place = maps.get(holder as usize)?(body.graph.positions[node]);
            Some(place.distance(now(node)))
        });
        distances.fold(0.0, f64::max)
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        let holds: usize = self
            .setup
            .handles
            .iter()
            .map(|h| h.nodes.capacity() * 4 + h.pulls.capacity() * 16)
            .sum();
        holds
            + self.rotation_fields.byte_size()
            + self.blending_fields.as_ref().map_or(0, HarmonicFields::byte_size)
            + self.scale_fields.as_ref().map_or(0, |f| f.byte_size())
            + self.sparse.get().map_or(0, SparseShares::byte_size)
            + self.position.byte_size()
            + self.stiff.byte_size()
            + self.places.byte_size()
            + self.setup.stiff.part_of.capacity() * 4
            + if self.rotation.shares_with(&self.position) {
                0
            } else {
                self.rotation.byte_size()
            }
            + self.positions.fixed.capacity()
            + self.positions.system.byte_size()
            + self
                .rigid
                .as_ref()
                .map_or(0, |r| r.fixed.capacity() + r.system.byte_size())
    }
}

/// Which components hold a constraint of positions, and the parts that do not.
pub(super) fn settle_parts(
    body: &DeformableBody,
    setup: &HandleSetup,
    position: &NodeOwnership,
) -> Result<(Vec<bool>, FreeParts), Error> {
    let covered = position.covered(body);
    if !covered.contains(&true) {
        return Err(Error::NoPosition);
    }
    let parts = FreeParts::settle(body, &covered, setup.policy)?;
    Ok((covered, parts))
}

/// What follows for the second pass from who holds which position.
pub(super) struct PositionSystems {
    pub positions: ConstrainedSystem,
    pub rigid: Option<ConstrainedSystem>,
    pub stiff: StiffParts,
}

impl PositionSystems {
    /// Makes the systems; `ready` is that of the positions, where there is one already. `covered` is by component. Reports the
    /// stage "constrain".
    pub fn make(
        body: &DeformableBody,
        setup: &HandleSetup,
        position: &NodeOwnership,
        covered: &[bool],
        ready: Option<LinearSystem>,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        exec.progress.report("constrain", 0.0);
        let fixed: Vec<bool> = (0..body.nodes())
            .map(|i| position.hard[i] != UNHELD || !covered[body.graph.component[i] as usize])
            .collect();
        let stiffness = position.stiffness();
        let positions = match ready {
            Some(system) => ConstrainedSystem { fixed, system },
            None => ConstrainedSystem::of(body, fixed, stiffness.as_deref(), exec.pool)?,
        };
        let loose: Vec<&HandleConstraint> = setup.handles.iter().filter(|h| h.is_loosely_rigid()).collect();
        let stiff = StiffParts::settle(body, &setup.stiff, position, covered);
        let rigid = if loose.is_empty() && stiff.is_empty() {
            None
        } else {
            let mut fixed = positions.fixed.clone();
            let held = loose.iter().flat_map(|h| &h.nodes);
            held.chain(stiff.all_nodes()).for_each(|&n| fixed[n as usize] = true);
            Some(ConstrainedSystem::of(body, fixed, stiffness.as_deref(), exec.pool)?)
        };
        Ok(Self {
            positions,
            rigid,
            stiff,
        })
    }
}

impl ConstrainedSystem {
    /// The body's Laplacian with some nodes given, and by node a stiffness on the diagonal of others.
    pub fn of(body: &DeformableBody, fixed: Vec<bool>, stiffness: Option<&[f64]>, pool: &Pool) -> Result<Self, Error> {
        let constraints = Constraints {
            fixed: &fixed,
            stiffness,
        };
        let system = body.hierarchy.constrain(&constraints, pool)?;
        Ok(Self { fixed, system })
    }
}
