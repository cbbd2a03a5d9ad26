//! Lattice nodes around an edit: which stay, which places get new ones, and the edges of both.

use crate::graph::mesh_graph::{InteriorRecipe, MeshGraph};
use crate::graph::parallel::map;
use crate::graph::resample::change::{ChangedPoints, GraphBefore, MeshChange, NewEdge, NodeNumbers};
use crate::graph::resample::edges::{EdgeFinder, NodeTable, ShellCopies, ShellSite, TAKEN, ZoneGrid, ZoneNode};
use crate::graph::resample::zone::{CORE, LocalMesh, NEAR, RIM};
use crate::graph::volume::lattice_grid::LatticeKey;
use crate::query::VisitCount;
use crate::{Error, NONE};
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

/// An edit whose points and shell have been followed already.
pub(super) struct EditedShell<'a> {
    pub(super) old: &'a GraphBefore<'a>,
    pub(super) change: &'a MeshChange<'a>,
    pub(super) points: &'a ChangedPoints,
    pub(super) copies: &'a ShellCopies,
    /// By old surface node: its old shell node, or [`NONE`].
    pub(super) old_shell: &'a [u32],
}

/// Follows an edit. `None` when no vertex is left to tie nodes to, or there is too much to look at.
pub(super) fn follow_interior(
    site: &ShellSite,
    inside: &InteriorRecipe,
    edited: &EditedShell<'_>,
    numbers: &mut NodeNumbers,
) -> Result<Option<InteriorChange>, Error> {
    let lattice = LatticeUpdate {
        site,
        inside,
        edited,
        first: edited.old.surface + edited.old.stats.shell_nodes,
        grid: ZoneGrid::around_zone(inside, site.zone),
    };
    let seen = lattice.find_affected_nodes();
    let (mut nodes, gone) = lattice.judge_nodes(&seen)?;
    let kept = nodes.len();
    let mut table = lattice.tabulate_nodes(&nodes);
    let Some(born) = lattice.fill_free_places(&mut nodes, &mut table, numbers)? else {
        return Ok(None);
    };

    let finder = EdgeFinder {
        old: edited.old,
        inside,
        first: lattice.first,
        nodes: &nodes[..],
        kept,
        gone: &gone,
        grid: &lattice.grid,
        table: &table,
        surface: site.surface,
        looked: site.looked,
    };
    let again: Vec<u32> = (0u32..).zip(&nodes).filter(|n| n.1.again).map(|n| n.0).collect();
    let found = map(&again, site.budget, |&node| finder.find_edges(node))?;
    let mut links: Vec<NewEdge> = Vec::new();
    let mut leaving: Vec<(u32, DVec3)> = Vec::new();
    for mut edges in found {
        links.append(&mut edges.links);
        leaving.append(&mut edges.leaving);
    }
    let ties = lattice.find_ties(&finder, &leaving)?;
    let node_of = |v: u32| lattice.surface_or_shell_node(numbers, v);
    links.extend(
        ties.iter()
            .map(|&(n, v)| NewEdge::new(nodes[n as usize].number, node_of(v))),
    );
    let Some(adopted) = lattice.tie_orphans(&nodes[..kept], &gone)? else {
        return Ok(None);
    };
    links.extend(adopted.into_iter().map(|(m, v)| NewEdge::new(m, node_of(v))));

    // The nearest vertex of nodes that are new, near the edit, or have lost theirs.
    let mut asked = lattice.ask_near_edit(&nodes, &again, &ties, numbers);
    let far = seen.iter().filter(|s| s.2 && gone.binary_search(&s.0).is_err());
    let far = far.filter(|s| find_node(&nodes[..kept], s.0).is_none_or(|at| !nodes[at].again));
    asked.extend(far.map(|s| {
        let (at, nearest) = (
            edited.old.positions[s.0 as usize],
            edited.old.nearest_surface[s.0 as usize],
        );
        (s.0, at, lattice.local_vertex_instead(nearest))
    }));
    let local = site.local;
    let nearest = map(&asked, site.budget, |&(_, p, start)| {
        let start = start.or_else(|| site.surface.closest_vertex(p, None))?;
        Some(local.points[local.walk(start, p, site.looked) as usize])
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

/// A node near the edit or far from it: its number, the zone's marks where it lies, and whether its nearest vertex is lost.
type AffectedNode = (u32, u8, bool);

/// A node that looks for its nearest vertex: its number, its place, and a local vertex to start from.
type VertexSearch = (u32, DVec3, Option<u32>);

/// The index of an old node among `nodes`, which rise.
fn find_node(nodes: &[ZoneNode], number: u32) -> Option<usize> {
    nodes.binary_search_by_key(&number, |n| n.number).ok()
}

/// The stages of following the lattice through an edit.
struct LatticeUpdate<'a> {
    site: &'a ShellSite<'a>,
    inside: &'a InteriorRecipe,
    edited: &'a EditedShell<'a>,
    /// The first old lattice node.
    first: usize,
    grid: ZoneGrid,
}

impl LatticeUpdate<'_> {
    /// Looks at all nodes once: finds those near the edit, and those whose nearest vertex is gone or moved.
    fn find_affected_nodes(&self) -> Vec<AffectedNode> {
        let EditedShell {
            old, change, points, ..
        } = *self.edited;
        let bounds = self.site.zone.bounds();
        let mut lost = vec![false; old.surface];
        points.gone.iter().for_each(|&o| lost[o as usize] = true);
        change
            .moved
            .iter()
            .for_each(|&p| lost[change.old_from_new[p as usize] as usize] = true);
        let lost = |node: usize| lost[old.nearest_surface[node] as usize];
        let marks = |p: DVec3| {
            let there = p.cmpge(bounds.min).all() && p.cmple(bounds.max).all();
            if there {
                self.site.zone.marks_at(p) & (CORE | RIM)
            } else {
                0
            }
        };
        self.site.budget.exec.pool.install(|| {
            let all = (self.first..old.nodes()).into_par_iter().with_min_len(BLOCK);
            let found = all.map(|node| (node as u32, marks(old.positions[node]), lost(node)));
            found.filter(|s| s.1 != 0 || s.2).collect()
        })
    }

    /// How far the surface is away, as far as it matters.
    fn surface_distance(&self, p: DVec3) -> f64 {
        let reach = self.inside.depth.max(0.501 * self.inside.interval) * 1.001;
        let closest = self.site.surface.closest_point_within(p, reach);
        closest.map_or(reach, |near| near.distance)
    }

    /// Decides which of the nodes near the edit stay, and which are gone; both rise.
    fn judge_nodes(&self, seen: &[AffectedNode]) -> Result<(Vec<ZoneNode>, Vec<u32>), Error> {
        let old = self.edited.old;
        let near: Vec<(u32, u8)> = seen.iter().filter(|s| s.1 != 0).map(|s| (s.0, s.1)).collect();
        let judged: Vec<Option<ZoneNode>> = map(&near, self.site.budget, |&(number, marks)| {
            let at = old.positions[number as usize];
            let key = self.grid.key_at(at);
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
                self.inside.depth
            } else {
                SHALLOW * self.inside.depth
            };
            if !self.site.columns.contains(at) {
                return None;
            }
            let clearance = self.surface_distance(at);
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
        for &g in &gone {
            for &m in old.row(g).iter().filter(|&&m| m as usize >= self.first) {
                if let Some(at) = find_node(&nodes, m) {
                    nodes[at].again = true;
                }
            }
        }
        Ok((nodes, gone))
    }

    /// Sorts nodes by their places on the grid.
    fn tabulate_nodes(&self, nodes: &[ZoneNode]) -> NodeTable {
        let mut table = NodeTable {
            fixed: Vec::new(),
            adrift: Vec::new(),
        };
        for (index, node) in (0u32..).zip(nodes) {
            match node.key {
                Some(key) => table.fixed.push((key, index)),
                None => table
                    .adrift
                    .extend(self.grid.nearest_key(node.at).map(|key| (key, index))),
            }
        }
        table.fixed.sort_unstable();
        table.adrift.sort_unstable();
        table
    }

    /// Gives free places of the grid that are deep enough inside new nodes, and answers where these are. `None` where that is
    /// more than a new graph would look at.
    fn fill_free_places(
        &self,
        nodes: &mut Vec<ZoneNode>,
        table: &mut NodeTable,
        numbers: &mut NodeNumbers,
    ) -> Result<Option<Vec<DVec3>>, Error> {
        let (grid, inside, zone) = (&self.grid, self.inside, self.site.zone);
        // Where all nodes are in their places, only those near the change can have become free.
        let mark = if table.adrift.is_empty() { NEAR } else { CORE };
        if zone.lattice_count(mark) > 4 * self.edited.old.nodes() + (1 << 16) {
            return Ok(None);
        }
        let cells = zone.lattice_cells(mark);
        let free: Vec<[Option<(LatticeKey, f64)>; 2]> = map(&cells, self.site.budget, |&cell| {
            [false, true].map(|in_b| {
                let key = grid.cell_key(cell, in_b)?;
                let p = grid.position(key);
                let taken = || {
                    table
                        .nearest_node(nodes, grid, p, TAKEN * inside.interval, false)
                        .is_some()
                };
                if table.fixed_node(key).is_some() || taken() || !self.site.columns.contains(p) {
                    return None;
                }
                let clearance = self.surface_distance(p);
                (clearance > inside.depth).then_some((key, clearance))
            })
        })?;
        let mut free: Vec<(LatticeKey, f64)> = free.into_iter().flatten().flatten().collect();
        free.sort_unstable_by_key(|f| f.0);
        let born: Vec<DVec3> = free.iter().map(|f| grid.position(f.0)).collect();
        for ((key, clearance), &at) in free.into_iter().zip(&born) {
            table.fixed.push((key, nodes.len() as u32));
            nodes.push(ZoneNode {
                number: numbers.add_lattice_node(),
                at,
                key: Some(key),
                clearance,
                again: true,
            });
        }
        table.fixed.sort_unstable();
        Ok(Some(born))
    }

    /// Finds the local vertices that nodes are tied to where their edges leave the lattice, as sorted (index of the node,
    /// vertex).
    fn find_ties(&self, finder: &EdgeFinder<'_>, leaving: &[(u32, DVec3)]) -> Result<Vec<(u32, u32)>, Error> {
        let (local, budget) = (self.site.local, self.site.budget);
        let crossed = map(leaving, budget, |&(node, end)| finder.crossed_vertex(local, node, end))?;
        // Several edges lead to the same place; its nearest point is looked up once.
        let bits = |p: DVec3| p.to_array().map(f64::to_bits);
        let unmet = leaving.iter().zip(&crossed).filter(|l| l.1.is_none());
        let mut ends: Vec<[u64; 3]> = unmet.map(|l| bits(l.0.1)).collect();
        ends.sort_unstable();
        ends.dedup();
        let beside = map(&ends, budget, |&end| {
            finder.vertex_beside(local, DVec3::from_array(end.map(f64::from_bits)))
        })?;
        let mut ties: Vec<(u32, u32)> = Vec::with_capacity(leaving.len());
        for (&(node, end), crossed) in leaving.iter().zip(crossed) {
            let vertex = crossed.or_else(|| ends.binary_search(&bits(end)).ok().and_then(|at| beside[at]));
            ties.extend(vertex.map(|v| (node, v)));
        }
        ties.sort_unstable();
        ties.dedup();
        Ok(ties)
    }

    /// The node that ties to a local vertex end at: its shell node, or else the vertex itself.
    fn surface_or_shell_node(&self, numbers: &NodeNumbers, v: u32) -> u32 {
        match self.edited.copies.node[v as usize] {
            NONE => numbers.point_number(self.edited.change, self.site.local.points[v as usize]),
            copy => copy,
        }
    }

    /// The local vertex that takes the place of an old one: itself, or the one nearest to where it was.
    fn local_vertex_instead(&self, o: u32) -> Option<u32> {
        match self.edited.points.new_from_old[o as usize] {
            NONE => (self.site.surface).closest_vertex(self.edited.old.positions[o as usize], None),
            new => self.site.local.find_local(new),
        }
    }

    /// Ties what was tied to a vertex or copy that is gone to the vertex nearest to where that was, as (old node, local
    /// vertex). `None` where there is no such vertex.
    fn tie_orphans(&self, kept: &[ZoneNode], gone: &[u32]) -> Result<Option<Vec<(u32, u32)>>, Error> {
        let EditedShell {
            old,
            points,
            copies,
            old_shell,
            ..
        } = *self.edited;
        let retied = |number: u32| find_node(kept, number).is_some_and(|at| kept[at].again && kept[at].key.is_some());
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
            let tied = old.row(g).iter().filter(|&&m| m as usize >= self.first);
            orphans.extend(
                tied.filter(|&&m| gone.binary_search(&m).is_err() && !retied(m))
                    .map(|&m| (m, g)),
            );
        }
        let parents = map(&orphans, self.site.budget, |&(_, g)| {
            self.local_vertex_instead(old.nearest_surface[g as usize])
        })?;
        let adopted = orphans
            .into_iter()
            .zip(parents)
            .map(|((m, _), parent)| Some((m, parent?)));
        Ok(adopted.collect())
    }

    /// Collects the nodes whose edges were found again, to look for their nearest vertices.
    fn ask_near_edit(
        &self,
        nodes: &[ZoneNode],
        again: &[u32],
        ties: &[(u32, u32)],
        numbers: &NodeNumbers,
    ) -> Vec<VertexSearch> {
        let local = self.site.local;
        let mut asked = Vec::new();
        for &n in again {
            let node = &nodes[n as usize];
            let from = ties.partition_point(|t| t.0 < n);
            let own = ties[from..].iter().take_while(|t| t.0 == n).map(|t| t.1);
            let before = (node.number < numbers.old).then(|| self.edited.old.nearest_surface[node.number as usize]);
            let before = before
                .map(|o| self.edited.points.new_from_old[o as usize])
                .filter(|&new| new != NONE);
            // A vertex beyond the faces looked at is as near as it was.
            if before.is_some_and(|new| local.find_local(new).is_none()) {
                continue;
            }
            let known = own.chain(before.and_then(|new| local.find_local(new)));
            let distance = |v: u32| local.positions[v as usize].distance_squared(node.at);
            let start = known.reduce(|a, b| if distance(b) < distance(a) { b } else { a });
            asked.push((node.number, node.at, start));
        }
        asked
    }
}

/// Takes nearest vertices that changed on to nodes that they are clearly nearer to than those they have: a surface that
/// was pushed in comes near to nodes whose own surroundings did not change.
pub(super) fn spread_nearest(graph: &mut MeshGraph, local: &LocalMesh, asked: Vec<u32>) {
    let first = graph.surface + graph.stats.shell_nodes;
    let mut waiting = asked;
    let mut next = 0;
    while let Some(&node) = waiting.get(next) {
        next += 1;
        let Some(start) = local.find_local(graph.nearest_surface[node as usize]) else {
            continue;
        };
        for entry in graph.entries(node) {
            let other = graph.neighbours[entry] as usize;
            if other < first {
                continue;
            }
            let p = graph.positions[other];
            let own = graph.positions[graph.nearest_surface[other] as usize].distance_squared(p);
            if local.positions[start as usize].distance_squared(p) >= own {
                continue;
            }
            let vertex = local.walk(start, p, &VisitCount::default());
            if local.positions[vertex as usize].distance_squared(p) < CLEARLY * own {
                graph.nearest_surface[other] = local.points[vertex as usize];
                waiting.push(other as u32);
            }
        }
    }
}
