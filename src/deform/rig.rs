//! A set of handles on a body: who holds which node, the first-pass fields and the constrained systems.

use super::fields::{self, Fields};
use super::parts::{Parts, Policy};
use super::{Body, Error, KeptFields, Restart, Transform};
use crate::exec::Exec;
use crate::pool::Pool;
use crate::solver::{Constraints, System};
use glam::DVec3;
use std::sync::Arc;

/// In an owner list: nobody holds the node.
pub(super) const NOBODY: u32 = u32::MAX;

/// One handle, resolved to graph nodes.
#[derive(Debug, Clone, Default)]
pub struct Hold {
    /// The nodes of its region, rising.
    pub nodes: Vec<u32>,
    /// For a soft handle: nodes that it pulls with their weight, 0 to 1, rising; its region with weight 1 (or the
    /// region's own weights) and the falloff around it. Empty for a hard one.
    pub pulls: Vec<(u32, f64)>,
    /// `None` for a hard handle, else the stiffness in units of edge weights.
    pub stiffness: Option<f64>,
    /// Whether it constrains positions.
    pub position: bool,
    /// Whether it constrains rotations.
    pub rotation: bool,
    /// Whether it constrains scale.
    pub scale: bool,
    /// Whether its region keeps its shape whatever moves it.
    pub rigid: bool,
}

/// What a [`Rig`] is built from.
#[derive(Debug, Clone, Default)]
pub struct Rigging {
    /// The handles; where hard ones overlap, the later one holds.
    pub holds: Vec<Hold>,
    /// Nodes that nothing may move (outside the region of interest), by node; empty = none. They win over every handle.
    pub frozen: Vec<bool>,
    /// What happens to parts without a position constraint.
    pub policy: Policy,
}

/// Who constrains one kind of quantity, node by node.
#[derive(Debug, Clone, Default)]
pub(super) struct Ownership {
    /// By node: the hard holder, or [`NOBODY`].
    pub hard: Arc<Vec<u32>>,
    /// Soft pulls (node, hold, stiffness) on nodes without a hard holder, by node then hold.
    pub soft: Vec<(u32, u32, f64)>,
}

impl Ownership {
    /// Settles overlaps for the holds that `constrains` says: of those whose region contains a node the last one has it,
    /// hard or soft; falloff never takes a node from a hard holder, and pulls of several falloffs add up.
    fn settle(rigging: &Rigging, nodes: usize, constrains: impl Fn(&Hold) -> bool) -> Self {
        let frozen_holder = rigging.holds.len() as u32;
        let mut core = vec![NOBODY; nodes];
        for (k, hold) in rigging.holds.iter().enumerate().filter(|(_, h)| constrains(h)) {
            hold.nodes.iter().for_each(|&n| core[n as usize] = k as u32);
        }
        for (owner, _) in core.iter_mut().zip(&rigging.frozen).filter(|(_, frozen)| **frozen) {
            *owner = frozen_holder;
        }
        let is_hard = |k: u32| k == frozen_holder || rigging.holds[k as usize].stiffness.is_none();
        let mut soft = Vec::new();
        for (k, hold) in rigging.holds.iter().enumerate().filter(|(_, h)| constrains(h)) {
            let Some(stiffness) = hold.stiffness else { continue };
            let mut in_core = hold.nodes.iter().copied().peekable();
            for &(node, weight) in &hold.pulls {
                while in_core.peek().is_some_and(|&c| c < node) {
                    in_core.next();
                }
                let mine = in_core.peek() == Some(&node);
                let owner = core[node as usize];
                let allowed = owner == NOBODY || owner == k as u32 || (!mine && !is_hard(owner));
                if allowed && weight > 0.0 {
                    soft.push((node, k as u32, stiffness * weight));
                }
            }
        }
        soft.sort_by_key(|&(node, hold, _)| (node, hold));
        let hard = core
            .into_iter()
            .map(|k| if k != NOBODY && is_hard(k) { k } else { NOBODY })
            .collect();
        Self {
            hard: Arc::new(hard),
            soft,
        }
    }

    /// Which holds constrain any node; the frozen surroundings come last.
    pub fn active(&self, holds: usize) -> Vec<bool> {
        let mut active = vec![false; holds + 1];
        self.hard
            .iter()
            .filter(|&&k| k != NOBODY)
            .for_each(|&k| active[k as usize] = true);
        self.soft.iter().for_each(|&(_, k, _)| active[k as usize] = true);
        active
    }

    /// Which components hold any constraint.
    pub fn covered(&self, body: &Body) -> Vec<bool> {
        let mut covered = vec![false; body.graph.components];
        for (node, _) in self.hard.iter().enumerate().filter(|(_, k)| **k != NOBODY) {
            covered[body.graph.component[node] as usize] = true;
        }
        for &(node, ..) in &self.soft {
            covered[body.graph.component[node as usize] as usize] = true;
        }
        covered
    }

    /// Extra diagonal by node, `None` without soft pulls.
    pub fn stiffness(&self) -> Option<Vec<f64>> {
        if self.soft.is_empty() {
            return None;
        }
        let mut sum = vec![0.0; self.hard.len()];
        self.soft.iter().for_each(|&(node, _, s)| sum[node as usize] += s);
        Some(sum)
    }

    fn bytes(&self) -> usize {
        self.hard.capacity() * 4 + self.soft.capacity() * 24
    }

    fn same_as(&self, other: &Self) -> bool {
        self.hard == other.hard && self.soft == other.soft
    }
}

/// A system with the nodes that it takes as given.
pub(super) struct Constrained {
    pub fixed: Vec<bool>,
    pub system: System,
}

/// Handles on a body, ready for any number of poses.
pub struct Rig {
    pub(super) rigging: Arc<Rigging>,
    pub(super) position: Ownership,
    pub(super) rotation: Ownership,
    /// Fields of the handles that constrain rotation.
    pub(super) rotation_fields: Arc<Fields>,
    /// What rotations are blended with instead, when a handle is small.
    pub(super) blending_fields: Option<Fields>,
    /// Fields of those that constrain scale; `None` when they are the same as for rotation.
    pub(super) scale_fields: Option<Arc<Fields>>,
    pub(super) positions: Constrained,
    /// With rigid regions that nothing holds hard: the system in which they are given too.
    pub(super) rigid: Option<Constrained>,
    pub(super) parts: Parts,
    /// Iterations that the fields took, for reports.
    pub field_iterations: usize,
}

impl Rig {
    /// Solves the first-pass fields and prepares the second pass (paper sections 2.1 and 4). Reports the stages
    /// "fields" and "constrain".
    ///
    /// # Errors
    /// [`Error::NoPosition`], [`Error::FreePart`], [`Error::Solver`], [`Error::Cancelled`].
    pub fn build(body: &Body, rigging: Rigging, exec: &Exec<'_>) -> Result<Self, Error> {
        Self::restart(body, rigging, None, exec)
    }

    /// As [`Rig::build`], with fields that begin from those of the same holds before an edit.
    ///
    /// # Errors
    /// As [`Rig::build`].
    pub fn restart(
        body: &Body,
        rigging: Rigging,
        restart: Option<&Restart<'_>>,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        exec.progress.report("fields", 0.0);
        let nodes = body.nodes();
        let position = Ownership::settle(&rigging, nodes, |h| h.position);
        // Mostly all of them constrain the same handles.
        let like = |a: &Ownership, same: &dyn Fn(&Hold) -> bool, constrains: fn(&Hold) -> bool| match rigging
            .holds
            .iter()
            .all(same)
        {
            true => a.clone(),
            false => Ownership::settle(&rigging, nodes, constrains),
        };
        let rotation = like(&position, &|h| h.rotation == h.position, |h| h.rotation);
        let scale = like(&rotation, &|h| h.scale == h.rotation, |h| h.scale);
        let covered = position.covered(body);
        if !covered.contains(&true) {
            return Err(Error::NoPosition);
        }
        let parts = Parts::settle(body, &covered, rigging.policy)?;

        let holds = rigging.holds.len();
        let begin = restart.map(|r| (r, r.before.rotation.as_ref()));
        let (rotation_fields, system) = fields::solve(body, &rotation, holds, begin, exec)?;
        let blending_fields = rotation_fields.around_small(body, &rotation, exec.pool);
        let shared = scale.same_as(&rotation);
        let scale_fields = match shared {
            true => None,
            false => {
                let begin = restart.and_then(|r| Some((r, r.before.scale.as_deref()?)));
                Some(fields::solve(body, &scale, holds, begin, exec)?.0)
            }
        };
        let field_iterations = rotation_fields.iterations + scale_fields.as_ref().map_or(0, |fields| fields.iterations);

        exec.progress.report("constrain", 0.0);
        let fixed: Vec<bool> = (0..nodes)
            .map(|i| position.hard[i] != NOBODY || !covered[body.graph.component[i] as usize])
            .collect();
        let stiffness = position.stiffness();
        // What holds rotations mostly holds positions too, and then both have one system.
        let positions = match system.filter(|_| position.same_as(&rotation)) {
            Some(system) => Constrained { fixed, system },
            None => constrained(body, fixed, stiffness.as_deref(), exec.pool)?,
        };
        let loose: Vec<&Hold> = rigging
            .holds
            .iter()
            .filter(|h| h.rigid && !(h.position && h.stiffness.is_none()))
            .collect();
        let rigid = if loose.is_empty() {
            None
        } else {
            let mut fixed = positions.fixed.clone();
            loose
                .iter()
                .flat_map(|h| &h.nodes)
                .for_each(|&n| fixed[n as usize] = true);
            Some(constrained(body, fixed, stiffness.as_deref(), exec.pool)?)
        };
        Ok(Self {
            rigging: Arc::new(rigging),
            position,
            rotation,
            rotation_fields: Arc::new(rotation_fields),
            blending_fields,
            scale_fields: scale_fields.map(Arc::new),
            positions,
            rigid,
            parts,
            field_iterations,
        })
    }

    /// What it was built from.
    pub fn rigging(&self) -> &Rigging {
        &self.rigging
    }

    /// Number of handles.
    pub fn holds(&self) -> usize {
        self.rigging.holds.len()
    }

    /// The fields of the handles that constrain rotation.
    pub fn rotation_fields(&self) -> &Fields {
        &self.rotation_fields
    }

    /// Its fields, to begin those after an edit from.
    pub fn keep_fields(&self) -> KeptFields {
        KeptFields {
            rotation: Arc::clone(&self.rotation_fields),
            scale: self.scale_fields.clone(),
            rigging: Arc::clone(&self.rigging),
        }
    }

    /// By node: whether its position is given (held hard, frozen, or in a part that is placed by policy).
    pub fn given(&self) -> &[bool] {
        &self.positions.fixed
    }

    /// By node: extra diagonal of soft handles, in units of edge weights; `None` without soft handles.
    pub fn stiffness(&self) -> Option<Vec<f64>> {
        self.position.stiffness()
    }

    /// By hold: how many of the body's surface nodes it constrains in place, after overlaps are settled.
    pub fn held_surface_nodes(&self, body: &Body) -> Vec<usize> {
        let mut count = vec![0; self.holds() + 1];
        self.position.hard[..body.graph.surface]
            .iter()
            .filter(|&&k| k != NOBODY)
            .for_each(|&k| count[k as usize] += 1);
        self.position
            .soft
            .iter()
            .filter(|s| (s.0 as usize) < body.graph.surface)
            .for_each(|s| count[s.1 as usize] += 1);
        count.truncate(self.holds());
        count
    }

    /// Largest distance of a surface node that is held hard from where its handle puts it (or from rest, where nothing may
    /// move). `now` tells where a surface node is; `transforms` has one for each hold.
    pub fn misplaced(&self, body: &Body, transforms: &[Transform], now: impl Fn(usize) -> DVec3) -> f64 {
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
    pub fn bytes(&self) -> usize {
        let holds: usize = self
            .rigging
            .holds
            .iter()
            .map(|h| h.nodes.capacity() * 4 + h.pulls.capacity() * 16)
            .sum();
        holds
            + self.rotation_fields.bytes()
            + self.blending_fields.as_ref().map_or(0, Fields::bytes)
            + self.scale_fields.as_ref().map_or(0, |f| f.bytes())
            + self.position.bytes()
            + self.rotation.bytes()
            + self.positions.fixed.capacity()
            + self.positions.system.bytes()
            + self.rigid.as_ref().map_or(0, |r| r.fixed.capacity() + r.system.bytes())
    }
}

fn constrained(body: &Body, fixed: Vec<bool>, stiffness: Option<&[f64]>, pool: &Pool) -> Result<Constrained, Error> {
    let system = body.hierarchy.constrain(
        &Constraints {
            fixed: &fixed,
            stiffness,
        },
        pool,
    )?;
    Ok(Constrained { fixed, system })
}
