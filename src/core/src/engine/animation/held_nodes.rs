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
    let mut facts = Vec::with_capacity(handles.len());
    for (k, (handle, reach)) in handles.iter().zip(&reaches).enumerate() {
        let mut widened = 1.0;
        if held[k].len() < FEWEST {
            let holders = &mut holders[usize::from(!reach.is_place)];
            let free = (0u32..)
                .zip(&graph.positions)
                .filter(|(node, _)| holders[*node as usize].is_none());
            let mut near: Vec<(f64, u32)> = free.map(|(node, p)| (reach.distance(*p), node)).collect();
            near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let missing = FEWEST - held[k].len();
            let mut step = 0;
            let farthest = near.get(missing - 1).map_or(f64::INFINITY, |n| n.0);
            while step < STEPS && widened * reach.radius < farthest {
                step += 1;
                widened *= GROWTH;
            }
            let taken = near.iter().take_while(|n| n.0 <= widened * reach.radius).take(missing);
            for &(_, node) in taken {
                holders[node as usize] = Some(k);
                held[k].push(node);
            }
            held[k].sort_unstable();
        }
        facts.push(RigHandleFacts {
            name: handle.name.clone(),
            nodes: held[k].len(),
            widened,
        });
    }
    let constraints = held.into_iter().zip(&reaches).map(|(nodes, reach)| HandleConstraint {
        nodes,
        position: reach.is_place,
        rotation: !reach.is_place,
        ..Default::default()
    });
    (constraints.collect(), facts)
}
