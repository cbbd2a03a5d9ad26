//! The mesh vertex nearest to each lattice node.
//!
//! Nodes tied to the surface look theirs up. The others take the best of their neighbours' answers, in sweeps forwards
//! and backwards over the lattice (a vector distance transform, Danielsson 1980), and then walk along the mesh while
//! that leads nearer. The answer is the nearest vertex or one almost as near, in time linear in the lattice, and it is
//! found without leaving the body that the node lies in.

use super::Error;
use super::lattice::{Edges, Grid, Nodes};
use super::parallel::{map, map_along};
use super::shell::Site;
use crate::mesh::Lists;
use glam::DVec3;

/// Sweeps there and back.
const ROUNDS: usize = 2;
/// No vertex known yet.
const UNKNOWN: u32 = u32::MAX;

/// A solver vertex for each node.
pub(super) fn nearest_vertices(site: &Site, grid: &Grid, nodes: &Nodes, edges: &Edges) -> Result<Vec<u32>, Error> {
    let at = |node: u32| grid.position(nodes.keys[node as usize]);
    let mut tied: Vec<u32> = edges.ties.iter().map(|t| t[0]).collect();
    tied.dedup();
    let found = map_along(&tied, site.pool, site.progress, |&node, before: Option<&u32>| {
        site.surface.closest_vertex(at(node), before.copied()).unwrap_or(0)
    })?;
    let mut nearest = vec![UNKNOWN; nodes.keys.len()];
    for (&node, vertex) in tied.iter().zip(found) {
        nearest[node as usize] = vertex;
    }

    let around = Lists::gather(nodes.keys.len(), || {
        edges.lattice.iter().flat_map(|&[a, b]| [(a, b), (b, a)])
    });
    let count = nodes.keys.len() as u32;
    let mut unknown = usize::MAX;
    for round in 0.. {
        (0..count).for_each(|node| take_best(site, &around, &mut nearest, node, at(node)));
        (0..count)
            .rev()
            .for_each(|node| take_best(site, &around, &mut nearest, node, at(node)));
        // Winding passages need more rounds to be reached at all.
        let left = nearest.iter().filter(|&&v| v == UNKNOWN).count();
        if round + 1 >= ROUNDS && (left == 0 || left == unknown) {
            break;
        }
        unknown = left;
    }

    let starts: Vec<(u32, u32)> = (0..count).zip(nearest).collect();
    let walked = map(&starts, site.pool, site.progress, |&(node, start)| {
        let p = at(node);
        let mut here = if start == UNKNOWN {
            site.surface.closest_vertex(p, None).unwrap_or(0)
        } else {
            start
        };
        loop {
            let distance = |v: u32| site.mesh.positions[v as usize].distance_squared(p);
            let nearer = |a: u32, b: u32| if distance(b) < distance(a) { b } else { a };
            let next = site.adjacency.neighbours.of(here).iter().copied().fold(here, nearer);
            if next == here {
                return here;
            }
            here = next;
        }
    })?;
    Ok(walked)
}

/// Takes over the answer of a neighbour that is better than the node's own.
fn take_best(site: &Site, around: &Lists, nearest: &mut [u32], node: u32, p: DVec3) {
    let distance = |v: u32| site.mesh.positions[v as usize].distance_squared(p);
    let mut own = nearest[node as usize];
    let mut best = if own == UNKNOWN { f64::INFINITY } else { distance(own) };
    for &other in around.of(node) {
        let candidate = nearest[other as usize];
        if candidate != UNKNOWN && candidate != own && distance(candidate) < best {
            best = distance(candidate);
            own = candidate;
        }
    }
    nearest[node as usize] = own;
}
