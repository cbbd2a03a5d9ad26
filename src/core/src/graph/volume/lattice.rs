//! The lattice: nodes of a body-centred cubic grid that lie deep enough inside, and the edges between them.

use crate::graph::error::Error;
use crate::graph::parallel::{map, map_along};
use crate::graph::volume::lattice_grid::{CERTAIN, LatticeGrid, LatticeNodes, TooFine};
use crate::graph::volume::neighbours;
use crate::graph::volume::neighbours::{LatticeKey, LatticeRow, NONE, directions, toward};
use crate::graph::volume::shell::VolumeSite;
use crate::graph::volume::{octree, scan};
use crate::mesh::query::SurfacePoint;
use rayon::prelude::*;

/// All nodes of `grid` that lie inside, deeper than `depth`: inside the hull, or inside soups. At most `limit`
/// of them, else `Err(TooFine)` inside.
pub(in crate::graph) fn nodes(
    site: &VolumeSite,
    grid: &LatticeGrid,
    depth: f64,
    limit: usize,
) -> Result<Result<LatticeNodes, TooFine>, Error> {
    let mut nodes = match site.hull {
        None => LatticeNodes::default(),
        Some(hull) => match scan::nodes(site, hull.bvh(), grid, depth, limit)? {
            Ok(nodes) => nodes,
            Err(too_fine) => return Ok(Err(too_fine)),
        },
    };
    if let Some(soup) = site.large_soup() {
        match octree::nodes(site, soup, grid, depth, limit)? {
            Ok(more) => nodes = merged(nodes, more),
            Err(too_fine) => return Ok(Err(too_fine)),
        }
    }
    let excess = nodes.keys.len() as f64 / limit.max(1) as f64;
    if excess > 1.0 {
        return Ok(Err(TooFine::by(libm::cbrt(excess))));
    }
    Ok(Ok(nodes))
}

/// Both together, each node once.
fn merged(a: LatticeNodes, b: LatticeNodes) -> LatticeNodes {
    if a.keys.is_empty() {
        return b;
    }
    let mut both = LatticeNodes {
        keys: Vec::with_capacity(a.keys.len() + b.keys.len()),
        clearance: Vec::with_capacity(a.keys.len() + b.keys.len()),
    };
    let mut left = a.keys.into_iter().zip(a.clearance).peekable();
    let mut right = b.keys.into_iter().zip(b.clearance).peekable();
    loop {
        let next = match (left.peek(), right.peek()) {
            (Some(l), Some(r)) if l.0 == r.0 => {
                let one = left.next();
                let other = right.next();
                one.zip(other).map(|(l, r)| (l.0, l.1.max(r.1)))
            }
            (Some(l), Some(r)) if r.0 < l.0 => right.next(),
            (Some(_), _) => left.next(),
            (None, _) => right.next(),
        };
        let Some((key, clearance)) = next else {
            return both;
        };
        both.keys.push(key);
        both.clearance.push(clearance);
    }
}

/// Edges of the lattice.
pub(in crate::graph) struct LatticeEdges {
    /// For each node its neighbours in the lattice.
    pub(in crate::graph) rows: Vec<LatticeRow>,
    /// Lattice node and the mesh vertex whose shell copy it is tied to. Each connected part of the lattice has some.
    pub(in crate::graph) ties: Vec<[u32; 2]>,
}

/// Joins neighbours that see each other. Where a lattice edge leads out of the lattice or through the surface, the node
/// is tied to the vertex nearest to the place where the edge leaves.
pub(in crate::graph) fn edges(
    site: &VolumeSite,
    grid: &LatticeGrid,
    nodes: &LatticeNodes,
    valence: u32,
) -> Result<LatticeEdges, Error> {
    let mut rows = neighbours::rows(&nodes.keys, valence, site.exec.pool);
    let at = |i: u32| grid.position(nodes.keys[i as usize]);
    // Edges that triangles may cross, each once.
    let doubtful = |i: u32, j: u32| {
        let clear = nodes.clearance[i as usize] + nodes.clearance[j as usize];
        clear * CERTAIN <= at(i).distance(at(j))
    };
    let asked: Vec<[u32; 2]> = site.exec.pool.install(|| {
        let from = (0..rows.len() as u32).into_par_iter().with_min_len(1024);
        let edges = from.flat_map_iter(|i| rows[i as usize].into_iter().map(move |j| [i, j]));
        edges.filter(|&[i, j]| j != NONE && i < j && doubtful(i, j)).collect()
    });
    let blocked = map(&asked, site.exec, |&[i, j]| {
        site.surface.first_hit(at(i), at(j), None).is_some()
    })?;
    let mut leaving: Vec<(u32, LatticeKey)> = site.exec.pool.install(|| {
        let from = (0..rows.len() as u32).into_par_iter().with_min_len(1024);
        let missing = from.flat_map_iter(|i| {
            let row = rows[i as usize];
            let out = directions(valence).filter(move |&d| row[d] == NONE);
            out.map(move |d| (i, toward(nodes.keys[i as usize], d)))
        });
        missing.collect()
    });
    for (&[i, j], _) in asked.iter().zip(&blocked).filter(|e| *e.1) {
        for (from, to) in [(i, j), (j, i)] {
            leaving.push((from, nodes.keys[to as usize]));
            rows[from as usize]
                .iter_mut()
                .filter(|n| **n == to)
                .for_each(|n| *n = NONE);
        }
    }
    // No triangle reaches into the clear ball around a node, so the way to look at begins where it ends.
    let crossed = map(&leaving, site.exec, |&(i, end)| {
        let (p, q) = (at(i), grid.position(end));
        let start = p + (q - p) * (nodes.clearance[i as usize] * CERTAIN / p.distance(q)).min(1.0);
        let hit = site.surface.first_hit(start, q, None)?;
        Some(site.walk(hit.vertex, hit.point))
    })?;
    // Several edges lead to the same place too near to the surface; its nearest point is looked up once.
    let unmet = leaving.iter().zip(&crossed).filter(|e| e.1.is_none());
    let mut ends: Vec<LatticeKey> = unmet.map(|e| e.0.1).collect();
    site.exec.pool.install(|| ends.par_sort_unstable());
    ends.dedup();
    let nearest = map_along(&ends, site.exec, |&end, before: Option<&Option<SurfacePoint>>| {
        let p = grid.position(end);
        let within = before
            .copied()
            .flatten()
            .map_or(f64::INFINITY, |b| b.point.distance(p) * (1.0 + 1e-9));
        site.surface.closest_point_within(p, within)
    })?;
    let ends = &ends;
    let vertices = leaving.iter().zip(crossed).map(|(&(_, end), crossed)| {
        crossed.or_else(|| {
            ends.binary_search(&end)
                .ok()
                .and_then(|at| nearest[at])
                .map(|near| site.walk(near.vertex, near.point))
        })
    });
    let mut ties: Vec<[u32; 2]> = leaving
        .iter()
        .zip(vertices)
        .filter_map(|(&(i, _), v)| Some([i, v?]))
        .collect();
    site.exec.pool.install(|| ties.par_sort_unstable());
    ties.dedup();
    Ok(LatticeEdges { rows, ties })
}
