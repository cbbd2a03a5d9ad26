//! Connected parts in which no handle holds a position.
//!
//! Equation (8) is singular on such a part, so it never reaches the solver: its nodes are taken as given and placed
//! afterwards, by policy.

use super::fit::{outer, rotation_of};
use super::{Body, Error, NearestPoints};
use glam::{DMat3, DQuat, DVec3};

/// What happens to parts without a position constraint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Policy {
    /// The part moves rigidly with the nearest node of a part that has one.
    #[default]
    Follow,
    /// The part stays at rest.
    Hold,
    /// Such a part is refused.
    Free,
}

/// A loose part and the node that it follows.
#[derive(Debug, Clone)]
struct Follower {
    nodes: Vec<u32>,
    leader: u32,
}

/// The parts to be placed after a solve.
#[derive(Debug, Clone, Default)]
pub(super) struct Parts {
    followers: Vec<Follower>,
}

impl Parts {
    /// Finds the parts that `covered` (by component) leaves out, and their leaders.
    pub fn settle(body: &Body, covered: &[bool], policy: Policy) -> Result<Self, Error> {
        let loose: Vec<usize> = (0..covered.len()).filter(|&c| !covered[c]).collect();
        if loose.is_empty() || policy == Policy::Hold {
            return Ok(Self::default());
        }
        if policy == Policy::Free {
            let part = loose[0];
            let node = body
                .graph
                .component
                .iter()
                .position(|&c| c as usize == part)
                .unwrap_or(0);
            let p = body.graph.positions[node];
            return Err(Error::FreePart {
                part,
                place: format!("({}, {}, {})", p.x, p.y, p.z),
            });
        }
        let mut number = vec![usize::MAX; covered.len()];
        loose.iter().enumerate().for_each(|(k, &c)| number[c] = k);
        let mut nodes = vec![Vec::new(); loose.len()];
        for (node, &c) in body
            .graph
            .component
            .iter()
            .enumerate()
            .filter(|(_, c)| !covered[**c as usize])
        {
            nodes[number[c as usize]].push(node as u32);
        }
        let held = (0..body.graph.surface).filter(|&i| covered[body.graph.component[i] as usize]);
        let tree = NearestPoints::new(held.map(|i| (DVec3::from_array(body.rest[i]), i as u32)));
        let followers = nodes
            .into_iter()
            .filter_map(|nodes| {
                let near = |&n: &u32| tree.nearest(DVec3::from_array(body.rest[n as usize]));
                let candidates = nodes
                    .iter()
                    .filter(|n| (**n as usize) < body.graph.surface)
                    .filter_map(near);
                let (leader, _) = candidates.reduce(|best, next| if next.1 < best.1 { next } else { best })?;
                Some(Follower { nodes, leader })
            })
            .collect();
        Ok(Self { followers })
    }

    /// Places the followers: `positions` (model space, by node) hold the solution elsewhere.
    pub fn place(&self, body: &Body, positions: &mut [DVec3]) {
        for follower in &self.followers {
            let leader = follower.leader as usize;
            let rest = body.graph.positions[leader];
            let now = positions[leader];
            let turn = local_rotation(body, leader, positions);
            if now == rest && turn == DQuat::IDENTITY {
                continue;
            }
            for &n in &follower.nodes {
                positions[n as usize] = now + turn * (body.graph.positions[n as usize] - rest);
            }
        }
    }
}

/// How the neighbourhood of a node has turned; exactly the identity where it has not moved.
fn local_rotation(body: &Body, node: usize, positions: &[DVec3]) -> DQuat {
    let rest = &body.graph.positions;
    let mut covariance = DMat3::ZERO;
    let mut moved = positions[node] != rest[node];
    for (j, w) in body.edges(node) {
        moved |= positions[j] != rest[j];
        let (x, p) = (
            (positions[j] - positions[node]) / body.unit,
            (rest[j] - rest[node]) / body.unit,
        );
        covariance += outer(x, p) * w;
    }
    if moved {
        rotation_of(covariance)
    } else {
        DQuat::IDENTITY
    }
}
