//! What both kinds of interior need: how much room there is, how much is enclosed, a lattice that fits, and the graph of it all.

use crate::graph::assemble::{InteriorNodes, assemble};
use crate::graph::error::Error;
use crate::graph::mesh_graph::MeshGraph;
use crate::graph::volume::lattice;
use crate::graph::volume::lattice::LatticeBody;
use crate::graph::volume::lattice_grid::{LatticeGrid, LatticeNodes};
use crate::graph::volume::options::VolumeOptions;
use crate::graph::volume::shell::VolumeSite;
use crate::graph::volume::{octree, scan};
use crate::mesh::{Adjacency, Mesh, signed_volume};
use glam::DVec3;

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
            if let Ok(nodes) = octree::nodes(site, soup, &grid, 0.0, 1 << 20)? {
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
    let grid = LatticeGrid::around(bounds, interval).ok_or(Error::Length {
        option: "interval",
        seen: interval,
    })?;
    Ok((grid, LatticeNodes::default()))
}
