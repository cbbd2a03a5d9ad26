//! Copies of vertices and the edges among vertices and copies, around an edit.

use crate::graph::error::Error;
use crate::graph::parallel::map;
use crate::graph::resample::change::GraphBefore;
use crate::graph::resample::change::{MeshChange, NewEdge, NodeNumbers};
use crate::graph::resample::hull;
use crate::graph::resample::zone::LocalMesh;
use crate::graph::resample::zone::{ChangeZone, NEAR};
use crate::graph::volume::columns::FaceColumns;
use crate::graph::volume::shell::{copy, has_room};
use crate::graph::volume::solid::{normal, sample, turn};
use crate::graph::weights::CotangentScale;
use crate::mesh::NONE;
use crate::mesh::query::{TriangleBvh, VisitBudget, VisitCount};
use glam::DVec3;

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
        let mut votes = (0, 0);
        for v in sample(members, 1, |_| 0) {
            let local = site.local;
            let step = f64::from(reach[local.points[v as usize] as usize]) * hull::BESIDE;
            let inward = -normal(&local.positions, &local.triangles, &local.adjacency, v) * step;
            let p = local.positions[v as usize];
            votes.0 += usize::from(site.columns.contains(p + inward));
            votes.1 += usize::from(site.columns.contains(p - inward));
        }
        let turn = turn(votes) as f32;
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
    let mut copies = ShellCopies {
        node: vec![NONE; local.points.len()],
        at: vec![DVec3::ZERO; local.points.len()],
        again: local.fan_changed.clone(),
        lost: Vec::new(),
        moved: Vec::new(),
        born: Vec::new(),
    };
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
