//! Which nodes of the graph the handles of a rig hold.

use crate::deform::HandleConstraint;
use crate::exec::Exec;
use crate::graph::MeshGraph;
use crate::mesh::query::closest_point::closest_point_on_segment;
use crate::motion::rig::{RigHandle, RigHandleShape};
use crate::progress::Cancelled;
use glam::DVec3;
use rayon::prelude::*;

/// The fewest nodes of a handle.
const FEWEST: usize = 8;
/// By what the radius of a handle with fewer nodes grows, and how often at most.
const GROWTH: f64 = 1.25;
const STEPS: i32 = 24;
/// Nodes between two looks at the progress.
const RUN: u32 = 4096;
/// A holder keeps so many nodes when others have none.
const SPARED: usize = 2;

/// What a handle of a rig came to hold.
#[derive(Debug, Clone, PartialEq)]
pub struct RigHandleFacts {
    /// Its name.
    pub name: String,
    /// Graph nodes that it holds.
    pub nodes: usize,
    /// How many times its radius is that of the recipe, so that it holds enough nodes.
    pub widened: f64,
}

/// A handle that looks for nodes: its kind, and how far away a node is in radii.
struct Reach {
    is_place: bool,
    ends: [DVec3; 2],
    radius: f64,
}

impl Reach {
    fn of(handle: &RigHandle) -> Self {
        match handle.shape {
            RigHandleShape::Cylinder { from, to, radius } => Self {
                is_place: false,
                ends: [from, to],
                radius,
            },
            RigHandleShape::Sphere { center, radius } => Self {
                is_place: true,
                ends: [center; 2],
                radius,
            },
        }
    }

    fn distance(&self, point: DVec3) -> f64 {
        let [from, to] = self.ends;
        closest_point_on_segment(point, from, to).distance(point)
    }
}

/// The constraints that rig handles make: each node is held by the handle of a kind that is nearest to it in radii, among those
/// that reach it. A handle with too few nodes is widened until it has enough, taking none from others. Each handle looks at each
/// node.
///
/// # Errors
/// [`Cancelled`].
pub(super) fn hold_nodes(
    handles: &[RigHandle],
    graph: &MeshGraph,
    exec: &Exec<'_>,
) -> Result<(Vec<HandleConstraint>, Vec<RigHandleFacts>), Cancelled> {
    let reaches: Vec<Reach> = handles.iter().map(Reach::of).collect();
    let mut held: Vec<Vec<u32>> = vec![Vec::new(); handles.len()];
    let holders_of_kind = |is_place: bool| {
        let holder = |point: &DVec3| {
            exec.check()?;
            let near = reaches.iter().enumerate().filter(|r| r.1.is_place == is_place);
            let near = near.map(|(k, r)| (r.distance(*point) / r.radius, k));
            let nearest = near.filter(|n| n.0 <= 1.0).min_by(|a, b| a.0.total_cmp(&b.0));
            Ok(nearest.map(|n| n.1))
        };
        let nodes = graph.positions.par_iter().with_min_len(1024);
        nodes.map(holder).collect::<Result<Vec<Option<usize>>, Cancelled>>()
    };
    let mut holders = exec
        .pool
        .install(|| Ok::<_, Cancelled>([holders_of_kind(true)?, holders_of_kind(false)?]))?;
    for holders in &holders {
        for (node, holder) in (0u32..).zip(holders) {
            if let Some(holder) = holder {
                held[*holder].push(node);
            }
        }
    }
    let mut widened = vec![1.0; handles.len()];
    for k in 0..handles.len() {
        let holders = &mut holders[usize::from(!reaches[k].is_place)];
        widened[k] = widen(k, &reaches[k], graph, holders, &mut held, exec)?;
    }
    for k in 0..handles.len() {
        if held[k].is_empty() {
            let holders = &mut holders[usize::from(!reaches[k].is_place)];
            widened[k] = take_one(k, &reaches[k], graph, holders, &mut held, exec)?;
        }
    }
    held.iter_mut().for_each(|nodes| nodes.sort_unstable());
    let facts = handles
        .iter()
        .zip(&held)
        .zip(widened)
        .map(|((handle, nodes), widened)| RigHandleFacts {
            name: handle.name.clone(),
            nodes: nodes.len(),
            widened,
        });
    let facts = facts.collect();
    let constraints = held.into_iter().zip(&reaches).map(|(nodes, reach)| HandleConstraint {
        nodes,
        position: reach.is_place,
        rotation: !reach.is_place,
        ..Default::default()
    });
    Ok((constraints.collect(), facts))
}

/// The `count` nodes that are nearest to a handle, of those that it may hold, with their distances, nearest first.
fn nearest_nodes(
    reach: &Reach,
    graph: &MeshGraph,
    count: usize,
    may: impl Fn(u32) -> bool,
    exec: &Exec<'_>,
) -> Result<Vec<(f64, u32)>, Cancelled> {
    let order = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    let mut near: Vec<(f64, u32)> = Vec::with_capacity(count + 1);
    for (node, p) in (0u32..).zip(&graph.positions) {
        if node.is_multiple_of(RUN) {
            exec.check()?;
        }
        if may(node) {
            let found = (reach.distance(*p), node);
            let place = near.partition_point(|n| order(n, &found).is_lt());
            if place < count {
                near.insert(place, found);
                near.truncate(count);
            }
        }
    }
    Ok(near)
}

/// Widens a handle with too few nodes until it has enough free nodes; returns by how much.
fn widen(
    handle: usize,
    reach: &Reach,
    graph: &MeshGraph,
    holders: &mut [Option<usize>],
    held: &mut [Vec<u32>],
    exec: &Exec<'_>,
) -> Result<f64, Cancelled> {
    let mut widened = 1.0;
    if held[handle].len() >= FEWEST {
        return Ok(widened);
    }
    let missing = FEWEST - held[handle].len();
    let is_free = |node: u32| holders[node as usize].is_none();
    let near = nearest_nodes(reach, graph, missing, is_free, exec)?;
    let farthest = near.last().map_or(0.0, |n| n.0);
    let mut step = 0;
    while step < STEPS && widened * reach.radius < farthest {
        step += 1;
        widened *= GROWTH;
    }
    let taken = near.iter().take_while(|n| n.0 <= widened * reach.radius);
    for &(_, node) in taken {
        holders[node as usize] = Some(handle);
        held[handle].push(node);
    }
    Ok(widened)
}

/// Gives a handle that found nothing free the node nearest to it, of a holder that can spare one; answers by how much it was
/// widened.
fn take_one(
    handle: usize,
    reach: &Reach,
    graph: &MeshGraph,
    holders: &mut [Option<usize>],
    held: &mut [Vec<u32>],
    exec: &Exec<'_>,
) -> Result<f64, Cancelled> {
    let can_spare = |node: u32| holders[node as usize].is_some_and(|k| held[k].len() > SPARED);
    let farthest = reach.radius * libm::pow(GROWTH, f64::from(STEPS));
    let near = nearest_nodes(reach, graph, 1, can_spare, exec)?;
    let Some(&(distance, node)) = near.first().filter(|n| n.0 <= farthest) else {
        return Ok(1.0);
    };
    if let Some(before) = holders[node as usize].replace(handle) {
        held[before].retain(|n| *n != node);
    }
    held[handle].push(node);
    Ok((distance / reach.radius).max(1.0))
}
