//! The mesh vertex nearest to each lattice node.
//!
//! Nodes tied to the surface begin with what they are tied to. The others take the best of their neighbours' answers, in sweeps forwards
//! and backwards over the lattice (a vector distance transform, Danielsson 1980), and then walk along the mesh while
//! that leads nearer. The answer is the nearest vertex or one almost as near, in time linear in the lattice, and it is
//! found without leaving the body that the node lies in.

use crate::graph::error::Error;
use crate::graph::parallel::map;
use crate::graph::volume::lattice::LatticeEdges;
use crate::graph::volume::lattice_grid::{LatticeGrid, LatticeNodes};
use crate::graph::volume::neighbours::{LatticeRow, NONE};
use crate::graph::volume::shell::VolumeSite;
use glam::DVec3;

/// Sweeps there and back.
const ROUNDS: usize = 1;
/// No vertex known yet.
const UNKNOWN: u32 = u32::MAX;

/// A solver vertex for each node.
pub(in crate::graph) fn nearest_vertices(
    site: &VolumeSite,
    grid: &LatticeGrid,
    nodes: &LatticeNodes,
    edges: &LatticeEdges,
) -> Result<Vec<u32>, Error> {
    let at = |node: u32| grid.position(nodes.keys[node as usize]);
    let mut nearest = vec![UNKNOWN; nodes.keys.len()];
    let distance = |node: u32, v: u32| site.mesh.positions[v as usize].distance_squared(at(node));
    for &[node, vertex] in &edges.ties {
        let best = &mut nearest[node as usize];
        if *best == UNKNOWN || distance(node, vertex) < distance(node, *best) {
            *best = vertex;
        }
    }
    let count = nodes.keys.len() as u32;
    let mut unknown = usize::MAX;
    for round in 0.. {
        (0..count).for_each(|node| take_best(site, &edges.rows, &mut nearest, node, at(node)));
        (0..count)
            .rev()
            .for_each(|node| take_best(site, &edges.rows, &mut nearest, node, at(node)));
        // Winding passages need more rounds to be reached at all.
        let left = nearest.iter().filter(|&&v| v == UNKNOWN).count();
        if round + 1 >= ROUNDS && (left == 0 || left == unknown) {
            break;
        }
        unknown = left;
    }

    let starts: Vec<(u32, u32)> = (0..count).zip(nearest).collect();
    let walked = map(&starts, site.exec, |&(node, start)| {
        let p = at(node);
        let start = match start {
            UNKNOWN => site.surface.closest_vertex(p, None).unwrap_or(0),
            start => start,
        };
        site.walk(start, p)
    })?;
    Ok(walked)
}

/// Takes over the answer of a neighbour that is better than the node's own.
fn take_best(site: &VolumeSite, rows: &[LatticeRow], nearest: &mut [u32], node: u32, p: DVec3) {
    let distance = |v: u32| site.mesh.positions[v as usize].distance_squared(p);
    let mut own = nearest[node as usize];
    let mut best = if own == UNKNOWN { f64::INFINITY } else { distance(own) };
    for other in rows[node as usize].into_iter().filter(|&n| n != NONE) {
        let candidate = nearest[other as usize];
        if candidate != UNKNOWN && candidate != own && distance(candidate) < best {
            best = distance(candidate);
            own = candidate;
        }
    }
    nearest[node as usize] = own;
}
