//! Lattice nodes around an edit: which stay, which places get new ones, and the edges of both.

use crate::graph::error::Error;
use crate::graph::mesh_graph::MeshGraph;
use crate::graph::parallel::map;
use crate::graph::recipe::InteriorRecipe;
use crate::graph::resample::change::GraphBefore;
use crate::graph::resample::change::{ChangedPoints, MeshChange, NewEdge, NodeNumbers};
use crate::graph::resample::edges::{EdgeFinder, TAKEN};
use crate::graph::resample::grid::{NodeTable, ZoneGrid, ZoneNode};
use crate::graph::resample::local::LocalMesh;
use crate::graph::resample::places::{ShellCopies, ShellSite};
use crate::graph::resample::zone::{CORE, NEAR, RIM};
use crate::graph::volume::neighbours::LatticeKey;
use crate::graph::volume::shell::walk;
use crate::mesh::NONE;
use glam::DVec3;
use rayon::prelude::*;

/// Lattice nodes looked at in one go.
const BLOCK: usize = 1 << 14;
/// A moved node stays as long as it is this part of the wanted depth below the surface.
const SHALLOW: f64 = 0.6;
/// Another vertex is clearly nearer when its squared distance is less than this part of the other's.
const CLEARLY: f64 = 0.9;

/// What an edit does to the lattice.
pub(super) struct InteriorChange {
    /// Old nodes that are no more, rising.
    pub(super) gone: Vec<u32>,
    /// Old nodes whose edges within the lattice have been found again.
    pub(super) again: Vec<u32>,
    /// Those of them whose ties have been as well.
    pub(super) retied: Vec<u32>,
    /// Places of new nodes.
    pub(super) born: Vec<DVec3>,
    /// Edges found.
    pub(super) links: Vec<NewEdge>,
    /// The nearest vertex, by new number, where it changed.
    pub(super) nearest: Vec<(u32, u32)>,
}

/// Follows an edit. `None` when no vertex is left to tie nodes to, or there is too much to look at.
pub(super) fn follow(
    site: &ShellSite,
    old: &GraphBefore<'_>,
    inside: &InteriorRecipe,
    change: &MeshChange,
    points: &ChangedPoints,
    copies: &ShellCopies,
    old_shell: &[u32],
    numbers: &mut NodeNumbers,
) -> Result<Option<InteriorChange>, Error> {
    let ShellSite {
        local,
        surface,
        zone,
        columns,
        exec,
    } = *site;
    let first = old.surface + old.stats.shell_nodes;
    let grid = ZoneGrid::around(inside, zone);
    let bounds = zone.bounds();
    // One look at all nodes: those near the edit, and those whose nearest vertex is gone or moved.
    let mut lost = vec![false; old.surface];
    points.gone.iter().for_each(|&o| lost[o as usize] = true);
    change
        .moved
        .iter()
        .for_each(|&p| lost[change.old_from_new[p as usize] as usize] = true);
    let lost = |node: usize| lost[old.nearest_surface[node] as usize];
    let marks = |p: DVec3| {
        let there = p.cmpge(bounds.min).all() && p.cmple(bounds.max).all();
        if there { zone.marks(p) & (CORE | RIM) } else { 0 }
    };
    let seen: Vec<(u32, u8, bool)> = exec.pool.install(|| {
        let all = (first..old.nodes()).into_par_iter().with_min_len(BLOCK);
        let found = all.map(|node| (node as u32, marks(old.positions[node]), lost(node)));
        found.filter(|s| s.1 != 0 || s.2).collect()
    });

    // Which of those near stay.
    let reach = inside.depth.max(0.501 * inside.interval) * 1.001;
    let clear = |p: DVec3| {
        surface
            .closest_point_within(p, reach)
            .map_or(reach, |near| near.distance)
    };
    let near: Vec<(u32, u8)> = seen.iter().filter(|s| s.1 != 0).map(|s| (s.0, s.1)).collect();
    let judged: Vec<Option<ZoneNode>> = map(&near, exec, |&(number, marks)| {
        let at = old.positions[number as usize];
        let key = grid.key_at(at);
        if marks & CORE == 0 {
            return Some(ZoneNode {
                number,
                at,
                key,
                clearance: 0.0,
                again: false,
            });
        }
        let depth = if key.is_some() {
            inside.depth
        } else {
            SHALLOW * inside.depth
        };
        if !columns.contains(at) {
            return None;
        }
        let clearance = clear(at);
        (clearance > depth).then_some(ZoneNode {
            number,
            at,
            key,
            clearance,
            again: true,
        })
    })?;
    let gone: Vec<u32> = near
        .iter()
        .zip(&judged)
        .filter(|j| j.1.is_none())
        .map(|j| j.0.0)
        .collect();
    let mut nodes: Vec<ZoneNode> = judged.into_iter().flatten().collect();
    let find = |nodes: &[ZoneNode], number: u32| nodes.binary_search_by_key(&number, |n| n.number).ok();
    for &g in &gone {
        for &m in old.row(g).iter().filter(|&&m| m as usize >= first) {
            if let Some(at) = find(&nodes, m) {
                nodes[at].again = true;
            }
        }
    }
    let kept = nodes.len();

    let mut table = NodeTable {
        fixed: Vec::new(),
        adrift: Vec::new(),
    };
    for (index, node) in (0u32..).zip(&nodes) {
        match node.key {
            Some(key) => table.fixed.push((key, index)),
            None => table.adrift.extend(grid.near(node.at).map(|key| (key, index))),
        }
    }
    table.fixed.sort_unstable();
    table.adrift.sort_unstable();

    // Where all nodes are in their places, only those near the change can have become free.
    let mark = if table.adrift.is_empty() { NEAR } else { CORE };
    // Where that is more than a new graph would look at, one is built.
    if zone.lattice_count(mark) > 4 * old.nodes() + (1 << 16) {
        return Ok(None);
    }
    let cells = zone.lattice_cells(mark);
    let free: Vec<[Option<(LatticeKey, f64)>; 2]> = map(&cells, exec, |&cell| {
        [false, true].map(|in_b| {
            let key = grid.key(cell, in_b)?;
            let p = grid.position(key);
            let taken = || {
                table
                    .nearest(&nodes, &grid, p, TAKEN * inside.interval, false)
                    .is_some()
            };
            if table.fixed(key).is_some() || taken() || !columns.contains(p) {
                return None;
            }
            let clearance = clear(p);
            (clearance > inside.depth).then_some((key, clearance))
        })
    })?;
    let mut free: Vec<(LatticeKey, f64)> = free.into_iter().flatten().flatten().collect();
    free.sort_unstable_by_key(|f| f.0);
    let born: Vec<DVec3> = free.iter().map(|f| grid.position(f.0)).collect();
    for ((key, clearance), &at) in free.into_iter().zip(&born) {
        table.fixed.push((key, nodes.len() as u32));
        nodes.push(ZoneNode {
            number: numbers.lattice(),
            at,
            key: Some(key),
            clearance,
            again: true,
        });
    }
    table.fixed.sort_unstable();

    let finder = EdgeFinder {
        old,
        inside,
        first,
        nodes: &nodes[..],
        kept,
        gone: &gone,
        grid: &grid,
        table: &table,
        surface,
    };
    let again: Vec<u32> = (0u32..).zip(&nodes).filter(|n| n.1.again).map(|n| n.0).collect();
    let found = map(&again, exec, |&node| finder.edges(node))?;
    let mut links: Vec<NewEdge> = Vec::new();
    let mut leaving: Vec<(u32, DVec3)> = Vec::new();
    for mut edges in found {
        links.append(&mut edges.links);
        leaving.append(&mut edges.leaving);
    }

    // Where edges leave the lattice, their nodes are tied to the surface.
    let crossed = map(&leaving, exec, |&(node, end)| finder.crossed(local, node, end))?;
    // Several edges lead to the same place; its nearest point is looked up once.
    let bits = |p: DVec3| p.to_array().map(f64::to_bits);
    let unmet = leaving.iter().zip(&crossed).filter(|l| l.1.is_none());
    let mut ends: Vec<[u64; 3]> = unmet.map(|l| bits(l.0.1)).collect();
    ends.sort_unstable();
    ends.dedup();
    let beside = map(&ends, exec, |&end| {
        finder.beside(local, DVec3::from_array(end.map(f64::from_bits)))
    })?;
    let mut ties: Vec<(u32, u32)> = Vec::with_capacity(leaving.len());
    for (&(node, end), crossed) in leaving.iter().zip(crossed) {
        let vertex = crossed.or_else(|| ends.binary_search(&bits(end)).ok().and_then(|at| beside[at]));
        ties.extend(vertex.map(|v| (node, v)));
    }
    ties.sort_unstable();
    ties.dedup();
    let node_of = |v: u32| match copies.node[v as usize] {
        NONE => numbers.point(change, local.points[v as usize]),
        copy => copy,
    };
    links.extend(
        ties.iter()
            .map(|&(n, v)| NewEdge::new(nodes[n as usize].number, node_of(v))),
    );

    // What was tied to a vertex or copy that is gone is tied to the vertex nearest to where it was.
    let retied =
        |number: u32| find(&nodes[..kept], number).is_some_and(|at| nodes[at].again && nodes[at].key.is_some());
    let mut orphans: Vec<(u32, u32)> = Vec::new();
    let copies_gone = points
        .gone
        .iter()
        .map(|&o| old_shell[o as usize])
        .filter(|&s| s != NONE);
    for g in points
        .gone
        .iter()
        .copied()
        .chain(copies_gone)
        .chain(copies.lost.iter().copied())
    {
        let tied = old.row(g).iter().filter(|&&m| m as usize >= first);
        orphans.extend(
            tied.filter(|&&m| gone.binary_search(&m).is_err() && !retied(m))
                .map(|&m| (m, g)),
        );
    }
    let instead = |o: u32| match points.new_from_old[o as usize] {
        NONE => surface.closest_vertex(old.positions[o as usize], None),
        new => local.find(new),
    };
    let parents = map(&orphans, exec, |&(_, g)| instead(old.nearest_surface[g as usize]))?;
    for (&(m, _), parent) in orphans.iter().zip(parents) {
        match parent {
            Some(v) => links.push(NewEdge::new(m, node_of(v))),
            None => return Ok(None),
        }
    }

    // The nearest vertex of nodes that are new, near the edit, or have lost theirs.
    let mut asked: Vec<(u32, DVec3, Option<u32>)> = Vec::new();
    for &n in &again {
        let node = &nodes[n as usize];
        let from = ties.partition_point(|t| t.0 < n);
        let own = ties[from..].iter().take_while(|t| t.0 == n).map(|t| t.1);
        let before = (node.number < numbers.old).then(|| old.nearest_surface[node.number as usize]);
        let before = before
            .map(|o| points.new_from_old[o as usize])
            .filter(|&new| new != NONE);
        // A vertex beyond the faces looked at is as near as it was.
        if before.is_some_and(|new| local.find(new).is_none()) {
            continue;
        }
        let known = own.chain(before.and_then(|new| local.find(new)));
        let distance = |v: u32| local.positions[v as usize].distance_squared(node.at);
        let start = known.reduce(|a, b| if distance(b) < distance(a) { b } else { a });
        asked.push((node.number, node.at, start));
    }
    let far = seen.iter().filter(|s| s.2 && gone.binary_search(&s.0).is_err());
    let far = far.filter(|s| find(&nodes[..kept], s.0).is_none_or(|at| !nodes[at].again));
    asked.extend(far.map(|s| {
        (
            s.0,
            old.positions[s.0 as usize],
            instead(old.nearest_surface[s.0 as usize]),
        )
    }));
    let nearest = map(&asked, exec, |&(_, p, start)| {
        let start = start.or_else(|| surface.closest_vertex(p, None))?;
        Some(local.points[walk(&local.positions, &local.adjacency, start, p) as usize])
    })?;
    if nearest.contains(&None) {
        return Ok(None);
    }
    let old_again = || nodes[..kept].iter().filter(|n| n.again);
    Ok(Some(InteriorChange {
        again: old_again().map(|n| n.number).collect(),
        retied: old_again().filter(|n| n.key.is_some()).map(|n| n.number).collect(),
        nearest: asked.iter().zip(nearest).filter_map(|(a, v)| Some((a.0, v?))).collect(),
        gone,
        born,
        links,
    }))
}

/// Takes nearest vertices that changed on to nodes that they are clearly nearer to than those they have: a surface that
/// was pushed in comes near to nodes whose own surroundings did not change.
pub(super) fn spread_nearest(graph: &mut MeshGraph, local: &LocalMesh, asked: Vec<u32>) {
    let first = graph.surface + graph.stats.shell_nodes;
    let mut waiting = asked;
    let mut next = 0;
    while let Some(&node) = waiting.get(next) {
        next += 1;
        let Some(start) = local.find(graph.nearest_surface[node as usize]) else {
            continue;
        };
        let row = graph.offsets[node as usize] as usize..graph.offsets[node as usize + 1] as usize;
        for entry in row {
            let other = graph.neighbours[entry] as usize;
            if other < first {
                continue;
            }
            let p = graph.positions[other];
            let own = graph.positions[graph.nearest_surface[other] as usize].distance_squared(p);
            if local.positions[start as usize].distance_squared(p) >= own {
                continue;
            }
            let vertex = walk(&local.positions, &local.adjacency, start, p);
            if local.positions[vertex as usize].distance_squared(p) < CLEARLY * own {
                graph.nearest_surface[other] = local.points[vertex as usize];
                waiting.push(other as u32);
            }
        }
    }
}
