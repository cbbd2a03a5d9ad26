//! Connected parts in which no handle holds a position.
//!
//! Equation (8) is singular on such a part, so it never reaches the solver: its nodes are taken as given and placed
//! afterwards, by policy.

use crate::body::DeformableBody;
use crate::error::Error;
use glam::{DMat3, DQuat, DVec3};
use pliant_mesh::query::NearestPoints;
use pliant_mesh::rotation::{fit_rotation, outer_product};

/// What happens to parts without a position constraint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FreePartPolicy {
    /// The part moves rigidly with the nodes nearest to it of parts that have one.
    #[default]
    Follow,
    /// The part stays in the rest pose.
    Hold,
    /// Such a part is refused.
    Free,
}

/// A loose part and the nodes that it follows, with their weights.
#[derive(Debug, Clone)]
struct FollowingPart {
    nodes: Vec<u32>,
    leaders: Vec<(u32, f64)>,
}

/// Vertices of a loose part that look for the node nearest to them.
const LOOKING: usize = 1024;
/// Nodes that a loose part follows, at most.
const LEADERS: usize = 16;
/// Leaders further away than the nearest by this much of the part's size weigh half.
const NEAR: f64 = 0.1;
/// What the identity weighs in a fit of rotations, so that it breaks ties where leaders lie in a line.
const TIE: f64 = 1e-9;

/// The parts to be placed after a solve.
#[derive(Debug, Clone, Default)]
pub(crate) struct FreeParts {
    followers: Vec<FollowingPart>,
}

impl FreeParts {
    /// Finds the parts that `covered` (by component) leaves out, and their leaders.
    pub fn settle(body: &DeformableBody, covered: &[bool], policy: FreePartPolicy) -> Result<Self, Error> {
        let loose: Vec<usize> = (0..covered.len()).filter(|&c| !covered[c]).collect();
        if loose.is_empty() || policy == FreePartPolicy::Hold {
            return Ok(Self::default());
        }
        if policy == FreePartPolicy::Free {
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
        let tree = NearestPoints::new(held.map(|i| (body.rest(i), i as u32)));
        let followers = nodes
            .into_iter()
            .filter_map(|nodes| {
                let leaders = find_leaders(body, &tree, &nodes);
                (!leaders.is_empty()).then_some(FollowingPart { nodes, leaders })
            })
            .collect();
        Ok(Self { followers })
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.followers.is_empty()
    }

    /// Places the followers: `positions` (model space, by node) hold the solution elsewhere.
    pub fn place(&self, body: &DeformableBody, positions: &mut [DVec3]) {
        let rest = &body.graph.positions;
        for follower in &self.followers {
            let Some((from, to, turn)) = rigid_motion(body, &follower.leaders, positions) else {
                continue;
            };
            for &n in &follower.nodes {
                positions[n as usize] = to + turn * (rest[n as usize] - from);
            }
        }
    }
}

/// The nodes of `tree` that a part with these `nodes` follows: those nearest to places all over its surface, each
/// weighing the less the further away it is.
fn find_leaders(body: &DeformableBody, tree: &NearestPoints, nodes: &[u32]) -> Vec<(u32, f64)> {
    let at = |n: u32| body.rest(n as usize);
    let count = nodes.partition_point(|n| (*n as usize) < body.graph.surface);
    let looking = nodes[..count].iter().step_by(count.div_ceil(LOOKING).max(1));
    let mut found: Vec<(u32, f64)> = looking.filter_map(|&n| tree.nearest(at(n))).collect();
    found.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    let Some(&(_, nearest)) = found.first() else {
        return found;
    };
    let vertices = || nodes[..count].iter().map(|&n| at(n));
    let low = vertices().fold(DVec3::INFINITY, DVec3::min);
    let high = vertices().fold(DVec3::NEG_INFINITY, DVec3::max);
    // Squares of lengths, all of them. The least keeps weights finite where a part is a point on another.
    let size = (high - low).length_squared();
    let half = nearest + NEAR * NEAR * size + f64::MIN_POSITIVE;
    // The nearest is one of them; the others are spread over all that were found.
    found.dedup_by_key(|f| f.0);
    let step = found.len().div_ceil(LEADERS);
    let mut chosen: Vec<(u32, f64)> = found
        .into_iter()
        .step_by(step.max(1))
        .map(|(n, square)| (n, half / (half + (square - nearest))))
        .collect();
    chosen.sort_by_key(|c| c.0);
    chosen.dedup_by_key(|c| c.0);
    chosen
}

/// The rigid motion of weighted nodes and their neighbours: a place, where it has gone, and the turn about it. `None` where
/// none of them has moved.
fn rigid_motion(body: &DeformableBody, leaders: &[(u32, f64)], positions: &[DVec3]) -> Option<(DVec3, DVec3, DQuat)> {
    let rest = &body.graph.positions;
    let mut moved = false;
    let (mut from, mut shift, mut total) = (DVec3::ZERO, DVec3::ZERO, 0.0);
    for &(n, weight) in leaders {
        let n = n as usize;
        moved |= positions[n] != rest[n] || body.edges(n).any(|(j, _)| positions[j] != rest[j]);
        from += rest[n] * weight;
        shift += (positions[n] - rest[n]) * weight;
        total += weight;
    }
    if !moved || total <= 0.0 {
        return None;
    }
    let from = from / total;
    let to = from + shift / total;
    let mut covariance = DMat3::ZERO;
    for &(n, weight) in leaders {
        let n = n as usize;
        for (j, w) in body.edges(n) {
            let (x, p) = (positions[j] - positions[n], rest[j] - rest[n]);
            covariance += outer_product(x / body.unit, p / body.unit) * (w * weight);
        }
        covariance += outer_product((positions[n] - to) / body.unit, (rest[n] - from) / body.unit) * weight;
    }
    let size = covariance.x_axis.length() + covariance.y_axis.length() + covariance.z_axis.length();
    let turn = fit_rotation(covariance + DMat3::IDENTITY * (size * TIE));
    Some((from, to, turn))
}
