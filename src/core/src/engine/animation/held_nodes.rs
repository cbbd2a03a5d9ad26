//! Which nodes of the graph the handles of a rig hold.

use crate::deform::HandleConstraint;
use crate::graph::MeshGraph;
use crate::mesh::query::closest_point::closest_point_on_segment;
use crate::motion::rig::{RigHandle, RigHandleShape};
use crate::pool::Pool;
use glam::DVec3;
use rayon::prelude::*;

/// The fewest nodes of a handle.
const FEWEST: usize = 8;
/// By what the radius of a handle with fewer nodes grows, and how often at most.
const GROWTH: f64 = 1.25;
const STEPS: i32 = 24;
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
/// that reach it. A handle with too few nodes is widened until it has enough, taking none from others.
pub(super) fn hold_nodes(
    handles: &[RigHandle],
    graph: &MeshGraph,
    pool: &Pool,
) -> (Vec<HandleConstraint>, Vec<RigHandleFacts>) {
    let reaches: Vec<Reach> = handles.iter().map(Reach::of).collect();
    let mut held: Vec<Vec<u32>> = vec![Vec::new(); handles.len()];
    let mut holders = [true, false].map(|is_place| {
        let holder = |point: &DVec3| {
            let near = reaches.iter().enumerate().filter(|r| r.1.is_place == is_place);
            let near = near.map(|(k, r)| (r.distance(*point) / r.radius, k));
            let nearest = near.filter(|n| n.0 <= 1.0).min_by(|a, b| a.0.total_cmp(&b.0));
            nearest.map(|n| n.1)
        };
        pool.install(|| {
            graph
                .positions
                .par_iter()
                .with_min_len(1024)
                .map(holder)
                .collect::<Vec<Option<usize>>>()
        })
    });
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
        widened[k] = widen(k, &reaches[k], graph, holders, &mut held);
    }
    for k in 0..handles.len() {
        if held[k].is_empty() {
            let holders = &mut holders[usize::from(!reaches[k].is_place)];
            widened[k] = take_one(k, &reaches[k], graph, holders, &mut held);
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
    (constraints.collect(), facts)
}

/// Nodes with their distances from a handle, nearest first.
fn by_distance(reach: &Reach, graph: &MeshGraph, may: impl Fn(u32) -> bool) -> Vec<(f64, u32)> {
    let nodes = (0u32..).zip(&graph.positions).filter(|(node, _)| may(*node));
    let mut near: Vec<(f64, u32)> = nodes.map(|(node, p)| (reach.distance(*p), node)).collect();
    near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    near
}

/// Widens a handle with too few nodes until it has enough of those that nobody holds; answers by how much.
fn widen(handle: usize, reach: &Reach, graph: &MeshGraph, holders: &mut [Option<usize>], held: &mut [Vec<u32>]) -> f64 {
    let mut widened = 1.0;
    if held[handle].len() >= FEWEST {
        return widened;
    }
    let near = by_distance(reach, graph, |node| holders[node as usize].is_none());
    let missing = FEWEST - held[handle].len();
    let farthest = near.get(missing - 1).or(near.last()).map_or(0.0, |n| n.0);
    let mut step = 0;
    while step < STEPS && widened * reach.radius < farthest {
        step += 1;
        widened *= GROWTH;
    }
    let taken = near.iter().take_while(|n| n.0 <= widened * reach.radius).take(missing);
    for &(_, node) in taken {
        holders[node as usize] = Some(handle);
        held[handle].push(node);
    }
    widened
}

/// Gives a handle that found nothing free the node nearest to it, of a holder that can spare one; answers by how much it was
/// widened.
fn take_one(
    handle: usize,
    reach: &Reach,
    graph: &MeshGraph,
    holders: &mut [Option<usize>],
    held: &mut [Vec<u32>],
) -> f64 {
    let can_spare = |node: u32| holders[node as usize].is_some_and(|k| held[k].len() > SPARED);
    let farthest = reach.radius * libm::pow(GROWTH, f64::from(STEPS));
    let near = by_distance(reach, graph, can_spare);
    let Some(&(distance, node)) = near.first().filter(|n| n.0 <= farthest) else {
        return 1.0;
    };
    if let Some(before) = holders[node as usize].replace(handle) {
        held[before].retain(|n| *n != node);
    }
    held[handle].push(node);
    (distance / reach.radius).max(1.0)
}
