//! Parts of the graph that move as rigid bodies, wherever a solve has them: no handle says so, and nothing pulls at them.

use crate::body::DeformableBody;
use crate::handles::ownership::{NodeOwnership, StiffNodes, UNHELD};
use glam::{DMat3, DQuat, DVec3};
use pliant_exec::pool::Pool;
use pliant_mesh::rotation::{fit_rotation, outer_product};

/// The parts of a set of handles, those left out that hard handles hold any node of.
#[derive(Debug, Clone, Default)]
pub(crate) struct StiffParts {
    /// By node: its part, or [`UNHELD`].
    pub part_of: Vec<u32>,
    /// The nodes, part by part, and where each part's begin; one more at the end.
    nodes: Vec<u32>,
    first: Vec<u32>,
    /// Edges that leave a part, likewise: node, other end, weight.
    border: Vec<(u32, u32, f32)>,
    first_border: Vec<u32>,
    bodies: Vec<RestBody>,
    /// Between 0 and 1: how far a part is rigid.
    pub strength: f64,
}

/// A part in the rest pose, solving coordinates; each node has a mass of 1.
#[derive(Debug, Clone, Copy)]
struct RestBody {
    center: DVec3,
    /// The inverse of its inertia about the centre; 0 about axes that nothing turns about.
    mobility: DMat3,
}

/// Where a part is, in coordinates around some centre.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PartPlace {
    pub center: DVec3,
    pub turn: DQuat,
}

/// A force with a torque on a part, or a motion with a turn of it.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Wrench {
    pub straight: DVec3,
    pub turn: DVec3,
}

impl StiffParts {
    /// The parts of `asked` that are free to move: no node of theirs is held hard, or in a component without a position.
    pub fn settle(body: &DeformableBody, asked: &StiffNodes, position: &NodeOwnership, covered: &[bool]) -> Self {
        let count = asked
            .part_of
            .iter()
            .filter(|k| **k != UNHELD)
            .max()
            .map_or(0, |k| *k as usize + 1);
        let mut sizes = vec![0u32; count];
        let mut is_free = vec![true; count];
        for (node, &part) in asked.part_of.iter().enumerate().filter(|(_, k)| **k != UNHELD) {
            sizes[part as usize] += 1;
            let moves = position.hard[node] == UNHELD && covered[body.graph.component[node] as usize];
            is_free[part as usize] &= moves;
        }
        let mut number = vec![UNHELD; count];
        let mut parts = 0;
        for part in (0..count).filter(|&k| is_free[k] && sizes[k] > 1) {
            number[part] = parts;
            parts += 1;
        }
        if parts == 0 {
            return Self::default();
        }
        let part_of: Vec<u32> = (asked.part_of.iter())
            .map(|&k| if k == UNHELD { UNHELD } else { number[k as usize] })
            .collect();
        let mut found = Self {
            first: vec![0; parts as usize + 1],
            strength: asked.strength,
            ..Self::default()
        };
        part_of
            .iter()
            .filter(|k| **k != UNHELD)
            .for_each(|&k| found.first[k as usize + 1] += 1);
        (0..parts as usize).for_each(|k| found.first[k + 1] += found.first[k]);
        let mut next = found.first.clone();
        found.nodes = vec![0; found.first[parts as usize] as usize];
        for (node, &part) in (0u32..).zip(&part_of).filter(|(_, k)| **k != UNHELD) {
            found.nodes[next[part as usize] as usize] = node;
            next[part as usize] += 1;
        }
        found.part_of = part_of;
        for part in 0..parts as usize {
            found.first_border.push(found.border.len() as u32);
            found.bodies.push(RestBody::of(body, found.nodes_of(part)));
            for k in found.first[part]..found.first[part + 1] {
                let node = found.nodes[k as usize];
                let leaving = body
                    .edges(node as usize)
                    .filter(|(j, _)| found.part_of[*j] != part as u32);
                found.border.extend(leaving.map(|(j, w)| (node, j as u32, w as f32)));
            }
        }
        found.first_border.push(found.border.len() as u32);
        found
    }

    pub fn is_empty(&self) -> bool {
        self.bodies.is_empty()
    }

    pub fn count(&self) -> usize {
        self.bodies.len()
    }

    /// All nodes of parts.
    pub fn all_nodes(&self) -> &[u32] {
        &self.nodes
    }

    pub fn nodes_of(&self, part: usize) -> &[u32] {
        &self.nodes[self.first[part] as usize..self.first[part + 1] as usize]
    }

    /// The edges that leave a part: node, other end, weight.
    pub fn border_of(&self, part: usize) -> &[(u32, u32, f32)] {
        &self.border[self.first_border[part] as usize..self.first_border[part + 1] as usize]
    }

    /// The part of a node.
    pub fn part(&self, node: usize) -> Option<usize> {
        self.part_of.get(node).filter(|k| **k != UNHELD).map(|k| *k as usize)
    }

    /// Where the parts are that fit positions best, three numbers a node.
    pub fn fit(&self, body: &DeformableBody, x: &[f64], pool: &Pool) -> Vec<PartPlace> {
        pool.map(self.count(), 1, |part| {
            let (nodes, rest) = (self.nodes_of(part), self.bodies[part].center);
            let at = |n: u32| DVec3::from_slice(&x[3 * n as usize..3 * n as usize + 3]);
            let center = nodes.iter().map(|&n| at(n)).sum::<DVec3>() / nodes.len() as f64;
            let mut covariance = DMat3::ZERO;
            for &n in nodes {
                covariance += outer_product(at(n) - center, body.rest(n as usize) - rest);
            }
            PartPlace {
                center,
                turn: fit_rotation(covariance),
            }
        })
    }

    /// Where a node of a part is that is at `place`.
    pub fn position(&self, body: &DeformableBody, part: usize, place: &PartPlace, node: usize) -> DVec3 {
        place.center + place.turn * (body.rest(node) - self.bodies[part].center)
    }

    /// The motion that a torque and a force give a part of nodes with a mass of 1 each.
    pub fn moved_by(&self, part: usize, place: &PartPlace, by: Wrench) -> Wrench {
        let turn = DMat3::from_quat(place.turn);
        Wrench {
            straight: by.straight / self.nodes_of(part).len() as f64,
            turn: turn * (self.bodies[part].mobility * (turn.transpose() * by.turn)),
        }
    }

    pub fn byte_size(&self) -> usize {
        4 * (self.part_of.capacity() + self.nodes.capacity() + self.first.capacity() + self.first_border.capacity())
            + 12 * self.border.capacity()
            + self.bodies.capacity() * size_of::<RestBody>()
    }
}

impl RestBody {
    fn of(body: &DeformableBody, nodes: &[u32]) -> Self {
        let center = nodes.iter().map(|&n| body.rest(n as usize)).sum::<DVec3>() / nodes.len() as f64;
        let mut inertia = DMat3::ZERO;
        let mut size = 0.0;
        for &n in nodes {
            let arm = body.rest(n as usize) - center;
            inertia += DMat3::from_diagonal(DVec3::splat(arm.length_squared())) - outer_product(arm, arm);
            size += arm.length_squared();
        }
        // Nodes in a line have no inertia about it; a little keeps the inverse finite.
        let least = DMat3::from_diagonal(DVec3::splat(1e-6 * size));
        let mobility = match size > 0.0 {
            true => (inertia + least).inverse(),
            false => DMat3::ZERO,
        };
        Self { center, mobility }
    }
}

impl std::ops::Mul<f64> for Wrench {
    type Output = Self;

    fn mul(self, by: f64) -> Self {
        Self {
            straight: self.straight * by,
            turn: self.turn * by,
        }
    }
}

impl std::ops::AddAssign for Wrench {
    fn add_assign(&mut self, other: Self) {
        self.straight += other.straight;
        self.turn += other.turn;
    }
}

impl Wrench {
    pub fn dot(&self, other: &Self) -> f64 {
        self.straight.dot(other.straight) + self.turn.dot(other.turn)
    }
}
