//! Edges around an edit: of the lattice, and among vertices and their copies.

use crate::graph::mesh_graph::{CotangentScale, InteriorRecipe};
use crate::graph::parallel::map;
use crate::graph::resample::change::{GraphBefore, MeshChange, NewEdge, NodeNumbers};
use crate::graph::resample::hull;
use crate::graph::resample::zone::{ChangeZone, LocalMesh, NEAR};
use crate::graph::volume::caps::FaceColumns;
use crate::graph::volume::lattice_grid::{CERTAIN, LAST, LatticeKey, directions, key, place, toward};
use crate::graph::volume::shell::{copy, has_room};
use crate::graph::volume::solid::{normal, sample, turn};
use crate::query::{TriangleBvh, VisitBudget, VisitCount};
use crate::{Error, NONE};
use glam::DVec3;

/// A place of the grid is taken by a moved node no further than this, in intervals.
pub(super) const TAKEN: f64 = 0.6;

/// An edge to a node that is gone goes to another no further from it than this, in intervals.
const INSTEAD: f64 = 0.75;

/// What one node's edges turned out to be.
#[derive(Default)]
pub(super) struct FoundEdges {
    pub(super) links: Vec<NewEdge>,
    /// Ways that lead out of the lattice: from which node, and whereto.
    pub(super) leaving: Vec<(u32, DVec3)>,
}

/// Finds edges of nodes near an edit.
pub(super) struct EdgeFinder<'a> {
    pub(super) old: &'a GraphBefore<'a>,
    pub(super) inside: &'a InteriorRecipe,
    /// The first old lattice node.
    pub(super) first: usize,
    pub(super) nodes: &'a [ZoneNode],
    /// How many of them are old; these rise.
    pub(super) kept: usize,
    pub(super) gone: &'a [u32],
    pub(super) grid: &'a ZoneGrid,
    pub(super) table: &'a NodeTable,
    pub(super) surface: &'a TriangleBvh<'a>,
    /// What is looked at without asking any structure.
    pub(super) looked: &'a VisitCount,
}

impl EdgeFinder<'_> {
    /// The edges of a node, and its ways out of the lattice.
    pub(super) fn find_edges(&self, index: u32) -> FoundEdges {
        let node = &self.nodes[index as usize];
        let mut edges = FoundEdges::default();
        if let Some(key) = node.key {
            self.along_grid(index, key, &mut edges);
        }
        if node.number < self.old.nodes() as u32 {
            self.as_before(index, &mut edges);
        }
        edges
    }

    /// Edges in the directions of the grid.
    fn along_grid(&self, index: u32, key: LatticeKey, edges: &mut FoundEdges) {
        let node = &self.nodes[index as usize];
        for direction in directions(self.inside.valence) {
            let there = toward(key, direction);
            if let Some(other) = self.table.fixed_node(there) {
                let partner = &self.nodes[other];
                // An edge between two nodes that are looked at is found from its smaller key.
                if partner.again && there < key {
                    continue;
                }
                let ends = if key < there { [node, partner] } else { [partner, node] };
                self.join_nodes(ends, index, other as u32, edges);
                continue;
            }
            let end = self.grid.position(there);
            match self
                .table
                .nearest_node(self.nodes, self.grid, end, TAKEN * self.inside.interval, false)
            {
                Some(other) => self.join_nodes([node, &self.nodes[other]], index, other as u32, edges),
                None => edges.leaving.push((index, end)),
            }
        }
    }

    /// Edges that an old node had to moved ones, or as a moved one.
    fn as_before(&self, index: u32, edges: &mut FoundEdges) {
        let node = &self.nodes[index as usize];
        for &m in self.old.row(node.number).iter().filter(|&&m| m as usize >= self.first) {
            if let Ok(other) = self.nodes[..self.kept].binary_search_by_key(&m, |n| n.number) {
                let partner = &self.nodes[other];
                let fixed = node.key.is_some() && partner.key.is_some();
                if !(fixed || partner.again && m < node.number) {
                    self.join_nodes([node, partner], index, other as u32, edges);
                }
            } else if self.gone.binary_search(&m).is_err() {
                // Beyond the faces looked at nothing changed.
                edges.links.push(NewEdge::new(node.number, m));
            } else if node.key.is_none() {
                let end = self.old.positions[m as usize];
                let within = INSTEAD * self.inside.interval;
                match self.table.nearest_node(self.nodes, self.grid, end, within, true) {
                    Some(other) if other != index as usize => {
                        self.join_nodes([node, &self.nodes[other]], index, other as u32, edges);
                    }
                    _ => edges.leaving.push((index, end)),
                }
            }
        }
    }

    /// Joins two nodes that see each other; else each that is looked at is to be tied to what stands between.
    fn join_nodes(&self, [a, b]: [&ZoneNode; 2], index: u32, other: u32, edges: &mut FoundEdges) {
        let clear = (a.clearance + b.clearance) * CERTAIN > a.at.distance(b.at);
        if clear || self.surface.first_hit(a.at, b.at, None).is_none() {
            edges.links.push(NewEdge::new(a.number, b.number));
            return;
        }
        edges.leaving.push((index, self.nodes[other as usize].at));
        if self.nodes[other as usize].again {
            edges.leaving.push((other, self.nodes[index as usize].at));
        }
    }

    /// The vertex of `local` nearest to where the way from a node to `end` leaves the inside.
    pub(super) fn crossed_vertex(&self, local: &LocalMesh, node: u32, end: DVec3) -> Option<u32> {
        let node = &self.nodes[node as usize];
        let way = end - node.at;
        // No face reaches into the clear ball around a node.
        let clear = node.clearance * CERTAIN / way.length();
        if clear >= 1.0 {
            return None;
        }
        let hit = self.surface.first_hit(node.at + way * clear, end, None)?;
        Some(local.walk(hit.vertex, hit.point, self.looked))
    }

    /// The vertex of `local` nearest to `end`, if it is as near as that of an end left out as too near to the surface
    /// can be.
    pub(super) fn vertex_beside(&self, local: &LocalMesh, end: DVec3) -> Option<u32> {
        let within = 1.5 * (self.inside.depth + self.inside.interval);
        let near = self.surface.closest_point_within(end, within)?;
        Some(local.walk(near.vertex, near.point, self.looked))
    }
}

/// A node that is left, or a new one.
pub(super) struct ZoneNode {
    /// As in [`NodeNumbers`].
    pub(super) number: u32,
    pub(super) at: DVec3,
    /// Its place in the grid, unless it was moved.
    pub(super) key: Option<LatticeKey>,
    /// No face is nearer.
    pub(super) clearance: f64,
    /// Whether its edges are found again.
    pub(super) again: bool,
}

/// The grid around a zone, with keys of its own.
pub(super) struct ZoneGrid {
    origin: DVec3,
    interval: f64,
    /// Coordinates of the place that would have the key (0, 0, 0).
    base: [i64; 3],
}

impl ZoneGrid {
    pub(super) fn around_zone(inside: &InteriorRecipe, zone: &ChangeZone) -> Self {
        Self {
            origin: inside.origin,
            interval: inside.interval,
            base: zone.first_cell().map(|c| c - 4),
        }
    }

    pub(super) fn position(&self, key: LatticeKey) -> DVec3 {
        let base = DVec3::from_array(self.base.map(|b| b as f64));
        // Whole and half numbers: the same bits as with the keys of the whole lattice.
        self.origin + (place(key) + base) * self.interval
    }

    pub(super) fn cell_key(&self, cell: [i64; 3], in_b: bool) -> Option<LatticeKey> {
        let mut at = [0u32; 3];
        for axis in 0..3 {
            let own = cell[axis] - self.base[axis];
            at[axis] = u32::try_from(own).ok().filter(|&c| (1..=LAST).contains(&c))?;
        }
        Some(key(at, in_b))
    }

    /// The key of the place nearest to `p` in grid A.
    pub(super) fn nearest_key(&self, p: DVec3) -> Option<LatticeKey> {
        let cell = ((p - self.origin) / self.interval).round().to_array();
        self.cell_key(cell.map(|c| c as i64), false)
    }

    /// The key of a node that is where the grid puts it.
    pub(super) fn key_at(&self, p: DVec3) -> Option<LatticeKey> {
        let unit = (p - self.origin) / self.interval;
        let found = [(0.0, false), (0.5, true)].map(|(shift, in_b)| {
            let cell = (unit - DVec3::splat(shift)).round().to_array();
            self.cell_key(cell.map(|c| c as i64), in_b)
                .filter(|&key| self.position(key) == p)
        });
        found[0].or(found[1])
    }
}

/// Nodes by place.
pub(super) struct NodeTable {
    /// Unmoved nodes by key.
    pub(super) fixed: Vec<(LatticeKey, u32)>,
    /// Moved nodes by the nearest place of grid A.
    pub(super) adrift: Vec<(LatticeKey, u32)>,
}

impl NodeTable {
    pub(super) fn fixed_node(&self, key: LatticeKey) -> Option<usize> {
        self.fixed
            .binary_search_by_key(&key, |f| f.0)
            .ok()
            .map(|at| self.fixed[at].1 as usize)
    }

    /// The nearest node within less than an interval of `p` among the moved ones, or among all.
    pub(super) fn nearest_node(
        &self,
        nodes: &[ZoneNode],
        grid: &ZoneGrid,
        p: DVec3,
        within: f64,
        all: bool,
    ) -> Option<usize> {
        if self.adrift.is_empty() && !all {
            return None;
        }
        let middle = grid.nearest_key(p)?;
        let mut best: Option<(f64, u32)> = None;
        let mut offer = |node: u32| {
            let found = (nodes[node as usize].at.distance_squared(p), node);
            if found.0 <= within * within && best.is_none_or(|b| found < b) {
                best = Some(found);
            }
        };
        let (low, one) = (
            toward(toward(toward(middle, 1), 3), 5),
            [toward(0, 0), toward(0, 2), toward(0, 4)],
        );
        for z in 0..3 {
            for y in 0..3 {
                let first = low + y * one[1] + z * one[2];
                let from = self.adrift.partition_point(|a| a.0 < first);
                let row = self.adrift[from..].iter().take_while(|a| a.0 < first + 3);
                row.for_each(|a| offer(a.1));
                for place in (0..3).map(|x| first + x).filter(|_| all) {
                    [place, toward(place, 13)]
                        .into_iter()
                        .filter_map(|k| self.fixed_node(k))
                        .for_each(|n| offer(n as u32));
                }
            }
        }
        best.map(|b| b.1 as usize)
    }
}

/// Places no further apart than this part of an offset are the same.
const SAME: f64 = 1e-6;

/// The copies of the vertices of a [`LocalMesh`] mesh.
pub(super) struct ShellCopies {
    /// For each vertex its shell node: an old number, or one from [`NodeNumbers::shell`] on; or [`NONE`].
    pub(super) node: Vec<u32>,
    /// Where each of them is; anything without a copy.
    at: Vec<DVec3>,
    /// For each vertex whether edges among it, its neighbours and their copies have to be found again.
    again: Vec<bool>,
    /// Old shell nodes that are no more, though their vertices are.
    pub(super) lost: Vec<u32>,
    /// Old shell nodes with a new place.
    pub(super) moved: Vec<(u32, DVec3)>,
    /// New shell nodes: vertex by new number, and place.
    pub(super) born: Vec<(u32, DVec3)>,
}

/// What copies are placed by.
pub(super) struct ShellSite<'a> {
    pub(super) local: &'a LocalMesh,
    pub(super) surface: &'a TriangleBvh<'a>,
    pub(super) zone: &'a ChangeZone,
    pub(super) columns: &'a FaceColumns<'a>,
    /// What queries may look at in all.
    pub(super) budget: &'a VisitBudget<'a>,
    /// What is looked at without asking any structure.
    pub(super) looked: &'a VisitCount,
}

/// Which way copies of new parts go: turns the reach of those that are wound inside out.
pub(super) fn orient_parts(site: &ShellSite, parts: &[Vec<u32>], reach: &mut [f32]) {
    for part in parts {
        let members: Vec<u32> = part.iter().filter_map(|&p| site.local.find_local(p)).collect();
        let (mut ahead, mut behind) = (0, 0);
        for v in sample(members, 1, |_| 0) {
            let local = site.local;
            let step = f64::from(reach[local.points[v as usize] as usize]) * hull::BESIDE;
            let inward = -normal(&local.positions, &local.triangles, &local.adjacency, v) * step;
            let p = local.positions[v as usize];
            ahead += usize::from(site.columns.contains(p + inward));
            behind += usize::from(site.columns.contains(p - inward));
        }
        let turn = turn(ahead, behind) as f32;
        part.iter().for_each(|&p| reach[p as usize] *= turn);
    }
}

/// Keeps copies that still have room, places the others again.
pub(super) fn place_copies(
    site: &ShellSite,
    old: &GraphBefore<'_>,
    change: &MeshChange,
    reach: &[f32],
    old_shell: &[u32],
    numbers: &mut NodeNumbers,
) -> Result<ShellCopies, Error> {
    let local = site.local;
    let own_of = |v: u32| {
        let o = change.old_from_new[local.points[v as usize] as usize];
        if o == NONE { NONE } else { old_shell[o as usize] }
    };
    let vertices: Vec<u32> = (0..local.points.len() as u32).collect();
    let placed: Vec<Option<DVec3>> = map(&vertices, site.budget, |&v| {
        let (p, own) = (local.positions[v as usize], own_of(v));
        let reach = f64::from(reach[local.points[v as usize] as usize]);
        let before = (own != NONE).then(|| old.positions[own as usize]);
        if reach == 0.0 {
            return None;
        }
        let changed = local.fan_changed[v as usize];
        if !changed && site.zone.marks_at(p) & NEAR == 0 {
            return before;
        }
        if let Some(at) = before.filter(|_| !changed) {
            let half = 0.5 * (1.0 - 1e-9) * at.distance(p);
            if has_room(site.surface, v, p, p.midpoint(at), at, half) && site.columns.contains(at) {
                return before;
            }
        }
        let inward = -normal(&local.positions, &local.triangles, &local.adjacency, v) * reach.signum();
        if inward == DVec3::ZERO {
            return None;
        }
        let now = copy(site.surface, v, p, inward, reach.abs(), |q| site.columns.contains(q))?;
        // The same faces in another order give the same place but for rounding.
        Some(
            before
                .filter(|at| at.distance(now) <= SAME * reach.abs())
                .unwrap_or(now),
        )
    })?;
    let mut copies = without_copies(local);
    for (v, now) in placed.into_iter().enumerate() {
        let own = own_of(v as u32);
        match (now, own) {
            (None, NONE) => continue,
            (None, own) => copies.lost.push(own),
            (Some(p), NONE) => {
                copies.node[v] = numbers.add_shell_node();
                copies.born.push((local.points[v], p));
            }
            (Some(p), own) => {
                copies.node[v] = own;
                copies.at[v] = p;
                if old.positions[own as usize] == p {
                    continue;
                }
                copies.moved.push((own, p));
            }
        }
        copies.at[v] = now.unwrap_or_default();
        copies.again[v] = true;
    }
    Ok(copies)
}

/// Only the surface: no vertex has a copy.
pub(super) fn without_copies(local: &LocalMesh) -> ShellCopies {
    ShellCopies {
        node: vec![NONE; local.points.len()],
        at: vec![DVec3::ZERO; local.points.len()],
        again: local.fan_changed.clone(),
        lost: Vec::new(),
        moved: Vec::new(),
        born: Vec::new(),
    }
}

impl ShellCopies {
    /// The vertices whose edges are found again.
    pub(super) fn refound_vertices(&self) -> impl Iterator<Item = u32> + '_ {
        (0u32..).zip(&self.again).filter(|a| *a.1).map(|a| a.0)
    }

    /// Edges among these vertices, their neighbours and the copies of both, as [`crate::graph::assemble`] has them. `name`
    /// gives a vertex its number among nodes.
    pub(super) fn find_links(
        &self,
        local: &LocalMesh,
        name: impl Fn(u32) -> u32,
        cotangents: Option<CotangentScale>,
    ) -> Vec<NewEdge> {
        let mut links = Vec::new();
        let copy = |v: u32| self.node[v as usize];
        for v in self.refound_vertices() {
            if copy(v) != NONE {
                links.push(NewEdge::new(name(v), copy(v)));
            }
            for &w in local.adjacency.neighbours.of(v) {
                // An edge between two of them is looked at from its smaller end.
                if w < v && self.again[w as usize] {
                    continue;
                }
                let (a, b) = (v.min(w), v.max(w));
                let weight = cotangents.map_or(1.0, |scale| {
                    scale.of_edge(&local.positions, &local.triangles, &local.adjacency, [a, b])
                });
                links.push(NewEdge {
                    ends: [name(a), name(b)],
                    weight,
                });
                let diagonal =
                    |from: u32, to: u32| local.positions[from as usize].distance_squared(self.at[to as usize]);
                match (copy(a), copy(b)) {
                    (NONE, NONE) => {}
                    (sa, NONE) => links.push(NewEdge::new(name(b), sa)),
                    (NONE, sb) => links.push(NewEdge::new(name(a), sb)),
                    (sa, sb) => {
                        links.push(NewEdge::new(sa, sb));
                        let toward_b = diagonal(a, b) <= diagonal(b, a);
                        links.push(if toward_b {
                            NewEdge::new(name(a), sb)
                        } else {
                            NewEdge::new(name(b), sa)
                        });
                    }
                }
            }
        }
        links
    }
}
