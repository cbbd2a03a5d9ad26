//! The volume graph of a mesh: surface, shell and lattice (Zhou et al. 2005; the lattice interval is calibrated on the
//! node counts in the paper's tables).

use super::assemble::{Inner, NO_SHELL, assemble};
use super::lattice::{self, Grid, Nodes};
use super::nearest::nearest_vertices;
use super::shell::{Shell, Site, shell};
use super::solid::Parts;
use super::winding::WindingTree;
use super::{Error, Graph, Stats, Weights};
use crate::mesh::{Adjacency, Mesh, mean_edge_length, signed_volume};
use crate::pool::Pool;
use crate::progress::{Progress, check};

/// How a volume graph is built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VolumeOptions {
    /// Side of a lattice cell; by default the mean edge length or what gives 1.2 lattice nodes for each vertex,
    /// whichever is larger. Widened when the graph would have more than `max_nodes` nodes.
    pub interval: Option<f64>,
    /// Neighbours of a lattice node: 14 (default), or 8 in the other of the two cubic grids only.
    pub valence: u32,
    /// How far the shell is moved inwards; by default the mean edge length. Less where there is less room.
    pub shell_offset: Option<f64>,
    /// Weights of the mesh's edges.
    pub weights: Weights,
    /// Most nodes that the graph may have.
    pub max_nodes: usize,
}

impl Default for VolumeOptions {
    fn default() -> Self {
        Self {
            interval: None,
            valence: 14,
            shell_offset: None,
            weights: Weights::Uniform,
            max_nodes: 50_000_000,
        }
    }
}

/// Lattice nodes wanted for each vertex; with the shell this makes 3.1 nodes per vertex, as in the paper's tables.
const LATTICE_PER_VERTEX: f64 = 1.2;
/// Lattice nodes lie deeper than this many shell offsets.
const DEPTH: f64 = 1.25;
/// Winding numbers are asked this many mean edge lengths beside the surface.
const BESIDE: f64 = 1.0 / 64.0;
/// Cells along the longest side of the box when the volume has to be sampled.
const SAMPLES_ALONG: f64 = 32.0;

/// About how many nodes the volume graph of `mesh` will have, without building anything.
pub fn estimate_nodes(mesh: &Mesh) -> usize {
    let vertices = mesh.positions.len();
    2 * vertices + (LATTICE_PER_VERTEX * vertices as f64).ceil() as usize
}

/// Builds the volume graph of `mesh`; `None` when it encloses nothing, and a surface graph is all there is.
///
/// The inside is where the generalised winding number is further from 0 than ½, so meshes with holes have one too, and
/// parts that overlap share one lattice. Parts that are mere sheets enclose nothing and keep their mesh edges. Time is `n log n`, most of it spent near the surface.
///
/// # Errors
/// [`Error`] when an option makes no sense, when surface and shell alone exceed `max_nodes`, or when the work was
/// given up.
pub fn volume(
    mesh: &Mesh,
    options: &VolumeOptions,
    pool: &Pool,
    progress: &dyn Progress,
) -> Result<Option<Graph>, Error> {
    for (option, value) in [("interval", options.interval), ("shell offset", options.shell_offset)] {
        if let Some(seen) = value.filter(|v| !(*v > 0.0 && v.is_finite())) {
            return Err(Error::Length { option, seen });
        }
    }
    if !matches!(options.valence, 8 | 14) {
        return Err(Error::Valence { seen: options.valence });
    }
    let surface = mesh.positions.len();
    let limit = options.max_nodes.min(u32::MAX as usize / 32);
    let room_beyond = |nodes: usize| {
        limit.checked_sub(nodes).ok_or(Error::TooManyNodes {
            nodes,
            limit: options.max_nodes,
            surface,
        })
    };
    room_beyond(surface)?;
    check(progress)?;

    progress.report("graph", 0.0);
    let adjacency = Adjacency::build(surface, &mesh.triangles);
    let mean_edge = mean_edge_length(&mesh.positions, &adjacency.edges);
    let diagonal = mesh.bounds().diagonal();
    if !(mean_edge > diagonal * 1e-12 && mean_edge.is_finite()) {
        return Ok(None);
    }
    let tree = WindingTree::build(&mesh.positions, &mesh.triangles, pool);
    progress.report("graph", 0.1);
    let step = mean_edge * BESIDE;
    let parts = Parts::sort(mesh, &adjacency, &tree, step, pool, progress)?;
    if !parts.solid.contains(&true) {
        return Ok(None);
    }
    let solid_triangles = if parts.solid.contains(&false) {
        parts.solid_triangles(mesh)
    } else {
        Vec::new()
    };
    let some = (!solid_triangles.is_empty()).then(|| WindingTree::build(&mesh.positions, &solid_triangles, pool));
    let solid = some.as_ref().unwrap_or(&tree);
    let inward = parts.inward(mesh, &adjacency, solid, step, pool, progress)?;
    let site = Site {
        mesh,
        adjacency: &adjacency,
        surface: &tree,
        solid,
        balanced: parts.is_balanced(&adjacency),
        pool,
        progress,
    };

    progress.report("graph", 0.2);
    let offset = options.shell_offset.unwrap_or(mean_edge);
    let shell = shell(&site, &inward, offset)?;
    let shell_nodes = shell.iter().flatten().count();
    let room = room_beyond(surface + shell_nodes)?;

    progress.report("graph", 0.5);
    let volume = enclosed_volume(&site, &parts)?;
    if shell_nodes == 0 && volume == 0.0 {
        return Ok(None);
    }
    let calibrated = libm::cbrt(2.0 * volume / (LATTICE_PER_VERTEX * surface as f64));
    let wanted = options.interval.unwrap_or(mean_edge.max(calibrated));
    let (grid, nodes) = fitting_lattice(&site, wanted, DEPTH * offset, volume, room)?;
    if shell_nodes == 0 && nodes.keys.is_empty() {
        return Ok(None);
    }

    progress.report("graph", 0.7);
    let stats = Stats {
        shell_nodes,
        lattice_nodes: nodes.keys.len(),
        interval: grid.interval,
        shell_offset: offset,
        enclosed_volume: volume,
        component_has_volume: Vec::new(),
    };
    let inner = inner(&site, shell, &grid, &nodes, options.valence)?;
    let most_edges = 3 * adjacency.edges.len() + shell_nodes + inner.edges.len();
    if most_edges > u32::MAX as usize / 2 {
        return Err(Error::TooManyEdges {
            edges: most_edges,
            limit: u32::MAX as usize / 2,
        });
    }
    progress.report("graph", 0.9);
    let graph = assemble(mesh, &adjacency, inner, options.weights, stats);
    check(progress)?;
    progress.report("graph", 1.0);
    Ok(Some(graph))
}

/// Volume of the inside: measured for one closed part, else sampled, because parts may overlap, nest or have holes.
fn enclosed_volume(site: &Site, parts: &Parts) -> Result<f64, Error> {
    let mesh = site.mesh;
    let measured = signed_volume(&mesh.positions, site.solid.triangles()).abs();
    if site.balanced && parts.solid.iter().filter(|&&s| s).count() == 1 {
        return Ok(measured);
    }
    let bounds = mesh.bounds();
    let interval = bounds.size().max_element() / SAMPLES_ALONG;
    let Some(grid) = Grid::around(&bounds, interval) else {
        return Ok(0.0);
    };
    // The limit is beyond what a grid of this size holds.
    let Ok(nodes) = lattice::nodes(site, &grid, 0.0, 1 << 20)? else {
        return Ok(0.0);
    };
    let sampled = nodes.keys.len() as f64 * (interval * interval * interval) * 0.5;
    let measured_fits = site.balanced && (nodes.keys.is_empty() || (measured - sampled).abs() <= 0.1 * measured);
    Ok(if measured_fits { measured } else { sampled })
}

/// The lattice of the wanted interval, or of the narrowest wider one tried that has at most `room` nodes.
fn fitting_lattice(site: &Site, wanted: f64, depth: f64, volume: f64, room: usize) -> Result<(Grid, Nodes), Error> {
    let bounds = site.mesh.bounds();
    let longest = bounds.size().max_element();
    // Half of what the volume would hold: nodes near the surface are left out.
    let by_count = libm::cbrt(volume / room.max(1) as f64);
    let mut interval = wanted.max(longest * 1e-6).max(by_count);
    // Beyond the box's size there is nothing to place.
    while interval < 2.0 * longest {
        let factor = match Grid::around(&bounds, interval) {
            Some(grid) => match lattice::nodes(site, &grid, depth, room)? {
                Ok(nodes) => return Ok((grid, nodes)),
                Err(too_fine) => too_fine.factor,
            },
            None => 1.25,
        };
        interval *= factor * 1.02;
    }
    let grid = Grid::around(&bounds, interval).ok_or(Error::Length {
        option: "interval",
        seen: interval,
    })?;
    Ok((grid, Nodes::default()))
}

/// Numbers shell and lattice nodes after the surface and collects their edges.
fn inner(site: &Site, shell: Shell, grid: &Grid, nodes: &Nodes, valence: u32) -> Result<Inner, Error> {
    let surface = site.mesh.positions.len() as u32;
    let edges = lattice::edges(site, grid, nodes, valence)?;
    let mut inner = Inner {
        shell: vec![NO_SHELL; shell.len()],
        ..Inner::default()
    };
    for (v, copy) in (0u32..).zip(&shell) {
        if let Some(p) = copy {
            inner.shell[v as usize] = surface + inner.positions.len() as u32;
            inner.positions.push(*p);
            inner.nearest_surface.push(v);
        }
    }
    let first = surface + inner.positions.len() as u32;
    inner.positions.extend(nodes.keys.iter().map(|&k| grid.position(k)));
    inner
        .nearest_surface
        .extend(nearest_vertices(site, grid, nodes, &edges)?);
    inner.edges = edges.lattice;
    inner.edges.iter_mut().flatten().for_each(|node| *node += first);
    inner.edges.extend(edges.ties.into_iter().map(|[node, vertex]| {
        let copy = inner.shell[vertex as usize];
        [first + node, if copy == NO_SHELL { vertex } else { copy }]
    }));
    Ok(inner)
}
