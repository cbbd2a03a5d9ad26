//! What both kinds of interior need: how much room there is, how much is enclosed, a lattice that fits, and the graph of it all.
//!
//! Nodes that have been placed get their numbers, their edges and their vertices.
//!
//! The mesh vertex nearest to each lattice node: nodes tied to the surface begin with what they are tied to. The others take the best of their neighbours' answers, in sweeps forwards
//! and backwards over the lattice (a vector distance transform, Danielsson 1980), and then walk along the mesh while
//! that leads nearer. The answer is the nearest vertex or one almost as near, in time linear in the lattice, and it is
//! found without leaving the body that the node lies in.

use crate::graph::assemble::{InteriorNodes, assemble};
use crate::graph::mesh_graph::{GraphStats, InteriorRecipe, MeshGraph};
use crate::graph::parallel::map;
use crate::graph::volume::VolumeOptions;
use crate::graph::volume::caps::missing;
use crate::graph::volume::lattice::{LatticeBody, LatticeEdges, LatticeExit, octree_nodes};
use crate::graph::volume::lattice_grid::{LatticeGrid, LatticeKey, LatticeNodes, LatticeRow, NONE, in_b, rising};
use crate::graph::volume::shell::{ShellNodes, VolumeSite};
use crate::graph::volume::solid::PartKind;
use crate::graph::volume::{lattice, scan};
use crate::{Adjacency, Error, Mesh, signed_volume};
use glam::DVec3;
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// Cells along the longest side of the box when the volume has to be sampled.
const SAMPLES_ALONG: f64 = 32.0;
/// The same for a hull, whose rows are measured by their length.
const ROWS_ALONG: f64 = 64.0;

/// How many nodes there may be.
pub(in crate::graph) struct NodeRoom {
    limit: usize,
    wanted: usize,
    surface: usize,
}

impl NodeRoom {
    pub(in crate::graph) fn of(mesh: &Mesh, options: &VolumeOptions) -> Self {
        Self {
            limit: options.max_nodes.min(u32::MAX as usize / 32),
            wanted: options.max_nodes,
            surface: mesh.positions.len(),
        }
    }

    /// How many more there may be than `nodes`.
    pub(in crate::graph) fn beyond(&self, nodes: usize) -> Result<usize, Error> {
        self.limit.checked_sub(nodes).ok_or(Error::TooManyNodes {
            nodes,
            limit: self.wanted,
            surface: self.surface,
        })
    }
}

/// What is known of a mesh before interior nodes are placed.
pub(in crate::graph) struct SiteFacts {
    pub(in crate::graph) mean_edge: f64,
    /// All vertices in the order in which they are best looked at.
    pub(in crate::graph) order: Vec<u32>,
    /// For each vertex which way leads inwards.
    pub(in crate::graph) inward: Vec<DVec3>,
    /// For each part 1, −1 when its normals were turned, or 0 when it has no inside.
    pub(in crate::graph) turns: Vec<f64>,
}

/// Joins the nodes that have been placed to a graph.
pub(in crate::graph) fn join_nodes(
    site: &VolumeSite,
    inner: InteriorNodes,
    options: &VolumeOptions,
) -> Result<MeshGraph, Error> {
    let exec = site.exec;
    check_edge_count(site.adjacency, &inner)?;
    exec.progress.report("graph", 0.9);
    let parts = &site.parts.components;
    let graph = assemble(
        site.mesh,
        site.adjacency,
        parts,
        inner,
        options.weights,
        Some(exec.pool),
    );
    exec.check()?;
    exec.progress.report("graph", 1.0);
    Ok(graph)
}

/// Refuses more edges than can be numbered.
fn check_edge_count(adjacency: &Adjacency, inner: &InteriorNodes) -> Result<(), Error> {
    let edges =
        3 * adjacency.edges.len() + inner.copies + 7 * inner.lattice.len() + inner.ties.len() + inner.struts.len();
    let limit = u32::MAX as usize / 2;
    match edges > limit {
        true => Err(Error::TooManyEdges { edges, limit }),
        false => Ok(()),
    }
}

/// Volumes of the inside.
pub(in crate::graph) struct EnclosedVolume {
    pub(in crate::graph) whole: f64,
    pub(in crate::graph) by_soups: f64,
}

/// Volume of the inside: measured for one part, else sampled, because parts may overlap or nest.
pub(in crate::graph) fn enclosed_volume(site: &VolumeSite) -> Result<EnclosedVolume, Error> {
    let mesh = site.mesh;
    let mut volume = 0.0;
    if let Some(hull) = site.hull {
        let measured = signed_volume(hull.positions, hull.faces).abs();
        if site.parts.components.count == 1 {
            volume = measured;
        } else if let Some(grid) = LatticeGrid::around(&mesh.bounds(), longest_side(mesh) / ROWS_ALONG) {
            let sampled = scan::volume(site, hull, &grid)?.unwrap_or(0.0);
            let measured_fits = sampled == 0.0 || (measured - sampled).abs() <= 0.1 * measured;
            volume = if measured_fits { measured } else { sampled };
        }
    }
    let mut by_soups = 0.0;
    if let Some(soup) = site.large_soup() {
        let interval = longest_side(mesh) / SAMPLES_ALONG;
        if let Some(grid) = LatticeGrid::around(&mesh.bounds(), interval) {
            // The limit is beyond what a grid of this size holds.
            if let Ok(nodes) = octree_nodes(site, soup, &grid, 0.0, 1 << 20)? {
                by_soups = nodes.keys.len() as f64 * (interval * interval * interval) * 0.5;
            }
        }
    }
    Ok(EnclosedVolume {
        whole: volume + by_soups,
        by_soups,
    })
}

/// The longest side of the box around a mesh.
fn longest_side(mesh: &Mesh) -> f64 {
    mesh.bounds().size().max_element()
}

/// The lattice inside `body` of the wanted interval, or of the narrowest wider one tried that has at most `room` nodes. Its nodes
/// lie deeper than `depth` of the interval.
pub(in crate::graph) fn fitting_lattice(
    site: &VolumeSite,
    body: LatticeBody,
    wanted: f64,
    depth: impl Fn(f64) -> f64,
    [volume, room]: [f64; 2],
) -> Result<(LatticeGrid, LatticeNodes), Error> {
    let bounds = &body.bounds;
    let longest = bounds.size().max_element();
    // Half of what the volume would hold: nodes near the surface are left out.
    let by_count = libm::cbrt(volume / room.max(1.0));
    let mut interval = wanted.max(longest * 1e-6).max(by_count);
    // Beyond the box's size there is nothing to place.
    while interval < 2.0 * longest {
        let factor = match LatticeGrid::around(bounds, interval) {
            Some(grid) => match lattice::nodes(site, body, &grid, depth(interval), room as usize)? {
                Ok(nodes) => return Ok((grid, nodes)),
                Err(too_fine) => too_fine.factor,
            },
            None => 1.25,
        };
        interval *= factor * 1.02;
    }
    match LatticeGrid::around(bounds, interval) {
        Some(grid) => Ok((grid, LatticeNodes::default())),
        None => Err(Error::invalid(
            "interval",
            format!("is {interval}, it must be a positive finite length"),
        )),
    }
}

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
fn leave_out_thin(
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
        (0..count).for_each(|node| take_best(&edges.rows, &mut nearest, &mut spots, node, at(node)));
        (0..count)
            .rev()
            .for_each(|node| take_best(&edges.rows, &mut nearest, &mut spots, node, at(node)));
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
fn take_best(rows: &[LatticeRow], nearest: &mut [u32], spots: &mut [DVec3], node: u32, p: DVec3) {
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
