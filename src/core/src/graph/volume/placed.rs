//! Nodes that have been placed get their numbers, their edges and their vertices.

use crate::graph::assemble::InteriorNodes;
use crate::graph::error::Error;
use crate::graph::mesh_graph::GraphStats;
use crate::graph::recipe::InteriorRecipe;
use crate::graph::volume::caps::missing;
use crate::graph::volume::lattice;
use crate::graph::volume::lattice_grid::{LatticeGrid, LatticeNodes};
use crate::graph::volume::nearest::nearest_vertices;
use crate::graph::volume::neighbours::{LatticeKey, LatticeRow, NONE, in_b, rising};
use crate::graph::volume::shell::{ShellNodes, VolumeSite};
use crate::graph::volume::solid::PartKind;
use crate::pool::Pool;
use rayon::prelude::*;

/// Shell and lattice before anything joins them.
pub(in crate::graph) struct PlacedNodes {
    pub(in crate::graph) shell: ShellNodes,
    /// For each part how far its copies were to be moved.
    pub(in crate::graph) offsets: Vec<f64>,
    /// For each part 1, −1 when its normals were turned, or 0 when it has no inside.
    pub(in crate::graph) turns: Vec<f64>,
    pub(in crate::graph) grid: LatticeGrid,
    pub(in crate::graph) nodes: LatticeNodes,
    /// Lattice nodes lie deeper than this.
    pub(in crate::graph) depth: f64,
    /// What is known of the graph so far.
    pub(in crate::graph) stats: GraphStats,
}

/// Numbers shell and lattice nodes after the surface and collects their edges; `None` when there are no nodes.
pub(in crate::graph) fn interior_nodes(
    site: &VolumeSite,
    placed: PlacedNodes,
    valence: u32,
) -> Result<Option<InteriorNodes>, Error> {
    let PlacedNodes {
        mut shell, grid, nodes, ..
    } = placed;
    let surface = site.mesh.positions.len() as u32;
    let edges = lattice::edges(site, &grid, &nodes, valence)?;
    let mut ties: Vec<[u32; 2]> = edges.exits.iter().map(|e| [e.node, e.vertex]).collect();
    site.exec.pool.install(|| ties.par_sort_unstable());
    ties.dedup();
    let keeps = leave_out_thin(site, &mut shell, &placed.offsets, ties.iter().map(|t| t[1]));
    let mut inner = InteriorNodes::with_copies(surface, &shell);
    inner.positions.extend(nodes.keys.iter().map(|&k| grid.position(k)));
    inner
        .nearest_surface
        .extend(nearest_vertices(site, &grid, &nodes, &edges)?);
    inner.ties = ties;
    for [_, to] in &mut inner.ties {
        let copy = inner.shell[*to as usize];
        *to = if copy == NONE { *to } else { copy };
    }
    // Copies stand in the order of their vertices, so ties stay sorted where each vertex has one.
    if !inner.ties.is_sorted() {
        site.exec.pool.install(|| inner.ties.par_sort_unstable());
    }
    inner.lattice = edges.rows;
    sort_rows(&mut inner.lattice, &nodes.keys, site.exec.pool);
    if inner.positions.is_empty() {
        return Ok(None);
    }
    let reach = part_reaches(site, &placed.offsets, &placed.turns, &keeps);
    inner.recipe.inside = Some(record_interior(site, &reach, &grid, valence, placed.depth));
    inner.stats = GraphStats {
        shell_nodes: inner.copies,
        ..placed.stats
    };
    Ok(Some(inner))
}

/// Brings the neighbours of each node to the front of its row, rising.
pub(in crate::graph) fn sort_rows(rows: &mut [LatticeRow], keys: &[LatticeKey], pool: &Pool) {
    let order = rising();
    pool.install(|| {
        let rows = rows.par_iter_mut().zip(keys).with_min_len(1024);
        rows.for_each(|(row, &key)| {
            let mut sorted = [NONE; 14];
            let there = order[usize::from(in_b(key))]
                .iter()
                .map(|&d| row[d])
                .filter(|&n| n != NONE);
            sorted.iter_mut().zip(there).for_each(|(slot, n)| *slot = n);
            *row = sorted;
        });
    });
}

/// Takes the copies away from parts without lattice in which most vertices have no room for a copy at a quarter of the
/// offset or more: copies so near to the surface keep nothing from collapsing, and the part is no more than a sheet.
/// Answers which parts keep theirs.
///
/// `tied` are the vertices with ties to it.
pub(in crate::graph) fn leave_out_thin(
    site: &VolumeSite,
    shell: &mut ShellNodes,
    offsets: &[f64],
    tied: impl Iterator<Item = u32>,
) -> Vec<bool> {
    let components = &site.parts.components;
    let part = |v: u32| components.of_vertex[v as usize] as usize;
    // By part: vertices, and those with room.
    let mut count = vec![(0usize, 0usize); components.count];
    for (v, copy) in (0u32..).zip(shell.iter()) {
        let roomy = copy.is_some_and(|p| p.distance(site.mesh.positions[v as usize]) > offsets[part(v)] * 0.24);
        count[part(v)].0 += 1;
        count[part(v)].1 += usize::from(roomy);
    }
    let mut keeps: Vec<bool> = count.into_iter().map(|(all, roomy)| roomy * 2 >= all).collect();
    tied.for_each(|v| keeps[part(v)] = true);
    for (v, copy) in (0u32..).zip(shell.iter_mut()) {
        if !keeps[part(v)] {
            *copy = None;
        }
    }
    keeps
}

/// How far copies of each part were moved inwards: negative where the part is wound inside out, 0 where it has none.
fn part_reaches(site: &VolumeSite, offsets: &[f64], turns: &[f64], keeps: &[bool]) -> Vec<f32> {
    let kinds = site.parts.kinds.iter().enumerate();
    kinds
        .map(|(part, &kind)| {
            let encloses = kind != PartKind::Sheet && keeps[part];
            if encloses {
                (offsets[part] * turns[part]) as f32
            } else {
                0.0
            }
        })
        .collect()
}

/// Records what edits need to know of how interior nodes were placed; `reach` is by part.
fn record_interior(site: &VolumeSite, reach: &[f32], grid: &LatticeGrid, valence: u32, depth: f64) -> InteriorRecipe {
    let parts = site.parts;
    let enclosing = |v: u32| reach[parts.components.of_vertex[v as usize] as usize] != 0.0;
    let edges = site.adjacency.edges.iter();
    let mut open: Vec<[u32; 2]> = edges.filter(|e| enclosing(e.vertices[0])).flat_map(missing).collect();
    open.sort_unstable();
    InteriorRecipe {
        origin: grid.origin,
        interval: grid.interval,
        valence,
        depth,
        soups: parts.kinds.contains(&PartKind::Soup),
        reach: parts
            .components
            .of_vertex
            .iter()
            .map(|&part| reach[part as usize])
            .collect(),
        open,
    }
}
