//! The lattice: nodes of a body-centred cubic grid that lie deep enough inside, and the edges between them.

use crate::graph::error::Error;
use crate::graph::parallel::{map, map_along};
use crate::graph::volume::lattice_grid::{CERTAIN, LatticeGrid, LatticeNodes, TooFine};
use crate::graph::volume::near_surface::RoomQueries;
use crate::graph::volume::neighbours;
use crate::graph::volume::neighbours::{LatticeKey, LatticeRow, NONE, directions, toward};
use crate::graph::volume::shell::VolumeSite;
use crate::graph::volume::{octree, scan};
use crate::mesh::query::closest_point::closest_point_on_triangle;
use crate::mesh::query::{SurfacePoint, corner_near};
use rayon::prelude::*;

/// Nodes whose ties are found in one go.
const NODES: usize = 32;

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
        Some(hull) => match scan::nodes(site, hull, grid, depth, limit)? {
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
        shallow: a.shallow,
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
    let blocked = map(&asked, site.budget, |&[i, j]| {
        site.surface.is_way_crossed(at(i), at(j), None)
    })?;
    for (&[i, j], _) in asked.iter().zip(&blocked).filter(|e| *e.1) {
        for (from, to) in [(i, j), (j, i)] {
            let there = rows[from as usize].iter_mut().filter(|n| **n == to);
            there.for_each(|n| *n = NONE);
        }
    }
    let starts: Vec<u32> = (0..rows.len() as u32).step_by(NODES).collect();
    let found = map(&starts, site.budget, |&first| {
        let last = (first + NODES as u32).min(rows.len() as u32);
        let mut found = LatticeTies::default();
        let mut hints = [0; 14];
        for i in first..last {
            let from = found.ties.len();
            for d in directions(valence).filter(|&d| rows[i as usize][d] == NONE) {
                let end = toward(nodes.keys[i as usize], d);
                let near = nodes.shallow.find_key(end, &mut hints[d]);
                match left_at(site, grid, nodes, (i, end), near) {
                    Some(vertex) => found.ties.push([i, vertex]),
                    None => found.unmet.push((i, end)),
                }
            }
            found.ties[from..].sort_unstable();
        }
        found.ties.dedup();
        found
    })?;
    let mut ties = Vec::with_capacity(found.iter().map(|f| f.ties.len()).sum());
    found.iter().for_each(|f| ties.extend_from_slice(&f.ties));
    let unmet: Vec<(u32, LatticeKey)> = found.into_iter().flat_map(|f| f.unmet).collect();
    if !unmet.is_empty() {
        ties.extend(tied_to_nearest(site, grid, &unmet)?);
        site.exec.pool.install(|| ties.par_sort_unstable());
        ties.dedup();
    }
    Ok(LatticeEdges { rows, ties })
}

/// Ties of some nodes, sorted, and edges for which no place was found where they leave.
#[derive(Default)]
struct LatticeTies {
    ties: Vec<[u32; 2]>,
    unmet: Vec<(u32, LatticeKey)>,
}

/// The vertex nearest to the place where the edge from a node to the grid's node `end`, which stands at `near` among those
/// near to the surface, leaves the lattice or goes through the surface.
fn left_at(
    site: &VolumeSite,
    grid: &LatticeGrid,
    nodes: &LatticeNodes,
    (node, end): (u32, LatticeKey),
    near: Option<usize>,
) -> Option<u32> {
    let (p, q) = (grid.position(nodes.keys[node as usize]), grid.position(end));
    let (length, clear) = (p.distance(q), nodes.clearance[node as usize] * CERTAIN);
    // No triangle reaches into the clear balls around both ends. Where they overlap none is crossed; else the way to look at
    // begins where the first one ends.
    let joined = near.is_some_and(|k| clear + nodes.shallow.squares[k].sqrt() * CERTAIN > length);
    if !joined {
        let start = p + (q - p) * (clear / length).min(1.0);
        if let Some(hit) = site.surface.first_hit(start, q) {
            return Some(site.walk(hit.vertex, hit.point));
        }
    }
    let face = site.mesh.triangles[nodes.shallow.triangles[near?] as usize];
    let corners = face.map(|v| site.mesh.positions[v as usize]);
    let vertex = corner_near(&site.mesh.positions, face, q);
    Some(site.walk(vertex, closest_point_on_triangle(q, corners)))
}

/// Ties of edges that leave the lattice for a place of which nothing is known: to the vertex nearest to it.
fn tied_to_nearest(site: &VolumeSite, grid: &LatticeGrid, unmet: &[(u32, LatticeKey)]) -> Result<Vec<[u32; 2]>, Error> {
    // Several edges lead to the same place; its nearest point is looked up once.
    let mut ends: Vec<LatticeKey> = unmet.iter().map(|e| e.1).collect();
    site.exec.pool.install(|| ends.par_sort_unstable());
    ends.dedup();
    let surface = site.surface.tree().bvh();
    let nearest = map_along(&ends, site.budget, |&end, before: Option<&Option<SurfacePoint>>| {
        let p = grid.position(end);
        let within = before
            .copied()
            .flatten()
            .map_or(f64::INFINITY, |b| b.point.distance(p) * (1.0 + 1e-9));
        surface.closest_point_within(p, within)
    })?;
    let vertex = |end: LatticeKey| {
        let near = ends.binary_search(&end).ok().and_then(|at| nearest[at])?;
        Some(site.walk(near.vertex, near.point))
    };
    Ok(unmet.iter().filter_map(|&(i, end)| Some([i, vertex(end)?])).collect())
}
