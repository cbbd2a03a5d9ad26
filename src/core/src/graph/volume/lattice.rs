//! The lattice: nodes of a body-centred cubic grid that lie deep enough inside, and the edges between them.

use crate::graph::error::Error;
use crate::graph::parallel::{map, map_along};
use crate::graph::volume::caps::HullFaces;
use crate::graph::volume::lattice_grid::{CERTAIN, LatticeGrid, LatticeNodes, TooFine};
use crate::graph::volume::near_surface::RoomQueries;
use crate::graph::volume::neighbours;
use crate::graph::volume::neighbours::{LatticeKey, LatticeRow, NONE, directions, toward};
use crate::graph::volume::shell::VolumeSite;
use crate::graph::volume::{octree, scan};
use crate::graph::winding::tree::WindingTree;
use crate::mesh::BoundingBox;
use crate::mesh::query::closest_point::closest_point_on_triangle;
use crate::mesh::query::{SurfacePoint, corner_near};
use glam::DVec3;
use rayon::prelude::*;

/// Nodes whose ties are found in one go.
const NODES: usize = 32;

/// What lattice nodes lie inside of.
#[derive(Clone, Copy)]
pub(in crate::graph) struct LatticeBody<'a> {
    /// A closed surface, if there is one.
    pub(in crate::graph) hull: Option<HullFaces<'a>>,
    /// Soups, if there are any.
    pub(in crate::graph) soup: Option<&'a WindingTree<'a>>,
    /// The box around both.
    pub(in crate::graph) bounds: BoundingBox,
}

/// All nodes of `grid` that lie inside `body`, deeper than `depth` below the whole surface. At most `limit` of them, else
/// `Err(TooFine)` inside.
pub(in crate::graph) fn nodes(
    site: &VolumeSite,
    body: LatticeBody,
    grid: &LatticeGrid,
    depth: f64,
    limit: usize,
) -> Result<Result<LatticeNodes, TooFine>, Error> {
    let mut nodes = match body.hull {
        None => LatticeNodes::default(),
        Some(hull) => match scan::nodes(site, hull, grid, depth, limit)? {
            Ok(nodes) => nodes,
            Err(too_fine) => return Ok(Err(too_fine)),
        },
    };
    if let Some(soup) = body.soup {
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

/// Where an edge of the grid leaves the lattice.
#[derive(Clone, Copy)]
pub(in crate::graph) struct LatticeExit {
    pub(in crate::graph) node: u32,
    /// The place on the surface where the edge goes through it, or the nearest one to where it leaves, and its triangle.
    pub(in crate::graph) point: DVec3,
    pub(in crate::graph) triangle: u32,
    /// The mesh vertex nearest to that place.
    pub(in crate::graph) vertex: u32,
}

/// Edges of the lattice.
pub(in crate::graph) struct LatticeEdges {
    /// For each node its neighbours in the lattice.
    pub(in crate::graph) rows: Vec<LatticeRow>,
    /// Where others leave; each connected part of the lattice has some.
    pub(in crate::graph) exits: Vec<LatticeExit>,
}

/// Joins neighbours that see each other, and finds where edges lead out of the lattice or through the surface.
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
        let mut found = FoundExits::default();
        let mut hints = [0; 14];
        for i in first..last {
            for d in directions(valence).filter(|&d| rows[i as usize][d] == NONE) {
                let end = toward(nodes.keys[i as usize], d);
                let near = nodes.shallow.find_key(end, &mut hints[d]);
                match left_at(site, grid, nodes, (i, end), near) {
                    Some(exit) => found.exits.push(exit),
                    None => found.unmet.push((i, end)),
                }
            }
        }
        found
    })?;
    let mut exits = Vec::with_capacity(found.iter().map(|f| f.exits.len()).sum());
    found.iter().for_each(|f| exits.extend_from_slice(&f.exits));
    let unmet: Vec<(u32, LatticeKey)> = found.into_iter().flat_map(|f| f.unmet).collect();
    if !unmet.is_empty() {
        exits.extend(nearest_exits(site, grid, &unmet)?);
    }
    Ok(LatticeEdges { rows, exits })
}

/// Where edges of some nodes leave, and edges for which no place was found where they do.
#[derive(Default)]
struct FoundExits {
    exits: Vec<LatticeExit>,
    unmet: Vec<(u32, LatticeKey)>,
}

/// Where the edge from a node to the grid's node `end`, which stands at `near` among those near to the surface, leaves the
/// lattice or goes through the surface.
fn left_at(
    site: &VolumeSite,
    grid: &LatticeGrid,
    nodes: &LatticeNodes,
    (node, end): (u32, LatticeKey),
    near: Option<usize>,
) -> Option<LatticeExit> {
    let (p, q) = (grid.position(nodes.keys[node as usize]), grid.position(end));
    let (length, clear) = (p.distance(q), nodes.clearance[node as usize] * CERTAIN);
    let exit = |vertex: u32, point: DVec3, triangle: u32| LatticeExit {
        node,
        point,
        triangle,
        vertex: site.walk(vertex, point),
    };
    // No triangle reaches into the clear balls around both ends. Where they overlap none is crossed; else the way to look at
    // begins where the first one ends.
    let joined = near.is_some_and(|k| clear + nodes.shallow.squares[k].sqrt() * CERTAIN > length);
    if !joined {
        let start = p + (q - p) * (clear / length).min(1.0);
        if let Some(hit) = site.surface.first_hit(start, q) {
            return Some(exit(hit.vertex, hit.point, hit.triangle));
        }
    }
    let triangle = nodes.shallow.triangles[near?];
    let face = site.mesh.triangles[triangle as usize];
    let corners = face.map(|v| site.mesh.positions[v as usize]);
    let vertex = corner_near(&site.mesh.positions, face, q);
    Some(exit(vertex, closest_point_on_triangle(q, corners), triangle))
}

/// Exits of edges that leave the lattice for a place of which nothing is known: at the point of the surface nearest to it.
fn nearest_exits(
    site: &VolumeSite,
    grid: &LatticeGrid,
    unmet: &[(u32, LatticeKey)],
) -> Result<Vec<LatticeExit>, Error> {
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
    let exit = |&(node, end): &(u32, LatticeKey)| {
        let near = ends.binary_search(&end).ok().and_then(|at| nearest[at])?;
        Some(LatticeExit {
            node,
            point: near.point,
            triangle: near.triangle,
            vertex: site.walk(near.vertex, near.point),
        })
    };
    Ok(unmet.iter().filter_map(exit).collect())
}
