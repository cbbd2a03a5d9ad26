//! The mesh vertex nearest to each lattice node.
//!
//! Nodes tied to the surface begin with what they are tied to. The others take the best of their neighbours' answers, in sweeps forwards
//! and backwards over the lattice (a vector distance transform, Danielsson 1980), and then walk along the mesh while
//! that leads nearer. The answer is the nearest vertex or one almost as near, in time linear in the lattice, and it is
//! found without leaving the body that the node lies in.

use crate::graph::error::Error;
use crate::graph::parallel::map;
use crate::graph::volume::lattice::{LatticeEdges, LatticeExit};
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
    for &LatticeExit { node, vertex, .. } in &edges.exits {
        let best = &mut nearest[node as usize];
        if *best == UNKNOWN || distance(node, vertex) < distance(node, *best) {
            *best = vertex;
        }
    }
    // Where the vertices are, next to where they are asked for.
    let spot = |v: u32| {
        if v == UNKNOWN {
            DVec3::INFINITY
        } else {
            site.mesh.positions[v as usize]
        }
    };
    let mut spots: Vec<DVec3> = nearest.iter().map(|&v| spot(v)).collect();
    let count = nodes.keys.len() as u32;
    let mut unknown = usize::MAX;
    for round in 0.. {
        (0..count).for_each(|node| take_best(&edges.rows, (&mut nearest, &mut spots), node, at(node)));
        (0..count)
            .rev()
            .for_each(|node| take_best(&edges.rows, (&mut nearest, &mut spots), node, at(node)));
        // Winding passages need more rounds to be reached at all.
        let left = nearest.iter().filter(|&&v| v == UNKNOWN).count();
        if round + 1 >= ROUNDS && (left == 0 || left == unknown) {
            break;
        }
        unknown = left;
    }

    if nearest.contains(&UNKNOWN) {
        site.surface.tree();
    }
    let starts: Vec<(u32, u32)> = (0..count).zip(nearest).collect();
    let walked = map(&starts, site.budget, |&(node, start)| {
        let p = at(node);
        let start = match start {
            UNKNOWN => site.surface.tree().bvh().closest_vertex(p, None).unwrap_or(0),
            start => start,
        };
        site.walk(start, p)
    })?;
    Ok(walked)
}

/// Takes over the answer of a neighbour that is better than the node's own.
fn take_best(rows: &[LatticeRow], (nearest, spots): (&mut [u32], &mut [DVec3]), node: u32, p: DVec3) {
    let mut own = nearest[node as usize];
    let mut spot = spots[node as usize];
    // What is not known is infinitely far away.
    let mut best = spot.distance_squared(p);
    for other in rows[node as usize].into_iter().filter(|&n| n != NONE) {
        let candidate = nearest[other as usize];
        if candidate != own {
            let there = spots[other as usize];
            let square = there.distance_squared(p);
            if square < best {
                (own, spot, best) = (candidate, there, square);
            }
        }
    }
    nearest[node as usize] = own;
    spots[node as usize] = spot;
}
