//! The volume graph of a mesh: surface, shell and lattice (Zhou et al. 2005; the lattice interval is calibrated on the
//! node counts in the paper's tables).

use crate::exec::Exec;
use crate::graph::assemble::{InteriorNodes, assemble};
use crate::graph::error::Error;
use crate::graph::mesh_graph::{GraphStats, MeshGraph};
use crate::graph::volume::caps::{ClosedHull, HullFaces};
use crate::graph::volume::inward::inward_directions;
use crate::graph::volume::lattice;
use crate::graph::volume::lattice::LatticeBody;
use crate::graph::volume::lattice_grid::{LatticeGrid, LatticeNodes};
use crate::graph::volume::near_surface::NearSurface;
use crate::graph::volume::placed::{PlacedNodes, interior_nodes};
use crate::graph::volume::principal_axes::PrincipalAxes;
use crate::graph::volume::shape::{most_lattice_nodes, shape_interior};
use crate::graph::volume::shell::{InsideHull, VolumeSite, shell};
use crate::graph::volume::solid::{ClassifiedParts, PartKind};
use crate::graph::volume::{octree, scan};
use crate::graph::weights::EdgeWeights;
use crate::graph::winding::tree::WindingTree;
use crate::mesh::query::{VisitBudget, VisitCount};
use crate::mesh::{Adjacency, Mesh, mean_edge_length, signed_volume};
use glam::DVec3;
use std::sync::OnceLock;

/// What interior nodes follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum InteriorKind {
    /// The shape: a lattice whose interval follows the thickness of each part, whatever its triangles, along the principal
    /// axes of the mesh. Places too thin for it have struts across.
    #[default]
    Shape,
    /// The triangles, as in the paper: a copy of each vertex, and a lattice about as dense as the mesh, along the axes of the
    /// file.
    Paper,
}

/// How a volume graph is built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VolumeOptions {
    /// What interior nodes follow.
    pub kind: InteriorKind,
    /// Side of a lattice cell. By default, of kind [`InteriorKind::Shape`], half of volume ÷ area of each part; of kind
    /// [`InteriorKind::Paper`] the mean edge length or what gives 1.2 lattice nodes for each vertex, whichever is larger.
    /// Widened when the graph would have more than `max_nodes` nodes.
    pub interval: Option<f64>,
    /// Neighbours of a lattice node: 14 (default), or 8 in the other of the two cubic grids only.
    pub valence: u32,
    /// Of kind [`InteriorKind::Paper`], how far the shell is moved inwards; by default the mean edge length, of the mesh or of the part, whichever is
    /// less. Less where there is less room.
    pub shell_offset: Option<f64>,
    /// Weights of the mesh's edges.
    pub weights: EdgeWeights,
    /// Most nodes that the graph may have.
    pub max_nodes: usize,
}

impl Default for VolumeOptions {
    fn default() -> Self {
        Self {
            kind: InteriorKind::Shape,
            interval: None,
            valence: 14,
            shell_offset: None,
            weights: EdgeWeights::Uniform,
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
/// The same for a hull, whose rows are measured by their length.
const ROWS_ALONG: f64 = 64.0;

/// What queries about one vertex and the interior nodes that belong to it may look at on average. Where faces are of about one size
/// they look at a small part of it; where large flat faces lie between small ones, as in machines, at much more.
const VISITS_PER_VERTEX: u64 = 4096;
/// The same for any mesh.
const LEAST_VISITS: u64 = 1 << 24;

/// What the queries of one graph of a mesh with so many vertices may look at in all.
pub(in crate::graph) fn most_visits(vertices: usize) -> u64 {
    LEAST_VISITS + VISITS_PER_VERTEX * vertices as u64
}

/// About how many nodes the volume graph of `mesh` will have at most, without building anything.
pub fn estimate_nodes(mesh: &Mesh, kind: InteriorKind) -> usize {
    let vertices = mesh.positions.len();
    match kind {
        InteriorKind::Shape => vertices + most_lattice_nodes(vertices) as usize,
        InteriorKind::Paper => 2 * vertices + (LATTICE_PER_VERTEX * vertices as f64).ceil() as usize,
    }
}

/// Builds the volume graph of `mesh`; `None` when it encloses nothing, and a surface graph is all there is.
///
/// The inside is where the generalised winding number is further from 0 than ½, so meshes with holes have one too, and
/// parts that overlap share one lattice. Parts that are mere sheets, or too thin for a shell, keep their mesh edges only.
/// Time is `n log n`, most of it spent near the surface.
///
/// ```
/// use glam::DVec3;
/// use pliant_core::asset::shapes::box_with_cells;
/// use pliant_core::exec::Exec;
/// use pliant_core::graph::{VolumeOptions, volume};
/// use pliant_core::mesh::{Mesh, Weld};
/// use pliant_core::pool::Pool;
/// use pliant_core::progress::Silent;
///
/// let (positions, triangles) = box_with_cells(DVec3::ONE, [6, 6, 6]);
/// let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a box");
/// let pool = Pool::new(1).expect("a thread");
/// let graph = volume(&mesh, &VolumeOptions::default(), &Exec::new(&pool, &Silent))?.expect("a box has an inside");
/// assert_eq!(graph.surface, mesh.positions.len());
/// assert!(graph.stats.lattice_nodes > 0 && graph.nodes() > graph.surface);
/// # Ok::<(), pliant_core::graph::Error>(())
/// ```
///
/// # Errors
/// [`Error`] when an option makes no sense, when surface and shell alone exceed `max_nodes`, or when the work was
/// given up.
pub fn volume(mesh: &Mesh, options: &VolumeOptions, exec: &Exec<'_>) -> Result<Option<MeshGraph>, Error> {
    check_options(options)?;
    let room = NodeRoom::of(mesh, options);
    room.beyond(mesh.positions.len())?;
    exec.check()?;
    exec.progress.report("graph", 0.0);
    match options.kind {
        InteriorKind::Paper => on_site(mesh, options, exec, |site, found| {
            paper_interior(site, found, options, &room)
        }),
        InteriorKind::Shape => {
            let axes = PrincipalAxes::of_surface(mesh);
            let turned = axes.turn_mesh(mesh);
            let place = |site: &VolumeSite, found: SiteFacts| shape_interior(site, found, options, &room);
            let graph = on_site(turned.as_ref().unwrap_or(mesh), options, exec, place)?;
            Ok(graph.map(|graph| axes.turn_back(graph, mesh)))
        }
    }
}

/// How many nodes there may be.
pub(in crate::graph) struct NodeRoom {
    limit: usize,
    wanted: usize,
    surface: usize,
}

impl NodeRoom {
    fn of(mesh: &Mesh, options: &VolumeOptions) -> Self {
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

/// Finds out what of a mesh encloses space, and has `place` place nodes there. `None` when nothing does.
fn on_site(
    mesh: &Mesh,
    options: &VolumeOptions,
    exec: &Exec<'_>,
    place: impl FnOnce(&VolumeSite, SiteFacts) -> Result<Option<MeshGraph>, Error>,
) -> Result<Option<MeshGraph>, Error> {
    let surface = mesh.positions.len();
    let (adjacency, mut near) = exec.pool.install(|| {
        let adjacency = || Adjacency::build(surface, &mesh.triangles);
        rayon::join(adjacency, || NearSurface::sort(mesh, exec.pool))
    });
    let mean_edge = mean_edge_length(&mesh.positions, &adjacency.edges);
    let diagonal = mesh.bounds().diagonal();
    if !(mean_edge > diagonal * 1e-12 && mean_edge.is_finite()) {
        return Ok(None);
    }
    let offset = options.shell_offset.unwrap_or(mean_edge);
    near.prepare_for(offset.max(options.interval.unwrap_or(0.0)));
    let near = near;
    exec.progress.report("graph", 0.1);
    let step = mean_edge * BESIDE;
    let seen_nearby = || near.visits();
    let sorting = VisitBudget::new(most_visits(surface), &seen_nearby, exec);
    let mut parts = ClassifiedParts::sort(mesh, &adjacency, &near, step, &sorting)?;
    let mut closed = parts.hull(mesh, &adjacency);
    if let Some(hull) = &closed
        && parts.doubt(near.tree(), hull, &sorting)?
    {
        closed = parts.hull(mesh, &adjacency);
    }
    let soup = parts.soup(mesh);
    let build = |positions, faces| WindingTree::build(positions, faces, exec.pool);
    let soup_tree = soup.as_ref().map(|faces| build(&mesh.positions, faces));
    let hull = (closed.as_ref().map(ClosedHull::as_faces))
        .or_else(|| parts.all(PartKind::Closed).then(|| HullFaces::of_mesh(mesh)));
    let hull_tree: OnceLock<WindingTree<'_>> = OnceLock::new();
    let tree_of_hull = || match &closed {
        Some(closed) => hull_tree.get_or_init(|| build(&closed.positions, &closed.faces)),
        None => near.tree(),
    };
    let inside_hull = InsideHull::of_faces(hull, tree_of_hull, exec.pool);
    let looked = VisitCount::default();
    let seen = || {
        let trees = [hull_tree.get(), soup_tree.as_ref()].into_iter().flatten();
        let in_trees: u64 = trees.map(|tree| tree.bvh().visits.total()).sum();
        near.visits() + inside_hull.visits() + in_trees + looked.total()
    };
    let budget = VisitBudget::new(most_visits(surface), &seen, exec);
    let site = VolumeSite {
        mesh,
        adjacency: &adjacency,
        surface: &near,
        hull,
        inside_hull: &inside_hull,
        soup: soup_tree
            .as_ref()
            .or_else(|| parts.all(PartKind::Soup).then(|| near.tree())),
        parts: &parts,
        exec,
        budget: &budget,
        looked: &looked,
    };
    if site.hull.is_none() && site.soup.is_none() {
        return Ok(None);
    }
    let order = site.vertices_in_space_order();
    let (inward, turns) = inward_directions(&site, &order, step)?;

    let facts = SiteFacts {
        mean_edge,
        order,
        inward,
        turns,
    };
    place(&site, facts)
}

/// Places a copy of each vertex and a lattice as dense as the mesh.
fn paper_interior(
    site: &VolumeSite,
    facts: SiteFacts,
    options: &VolumeOptions,
    room: &NodeRoom,
) -> Result<Option<MeshGraph>, Error> {
    let surface = site.mesh.positions.len();
    let SiteFacts { mean_edge, turns, .. } = facts;
    let offset = options.shell_offset.unwrap_or(mean_edge);
    site.exec.progress.report("graph", 0.2);
    let offsets = shell_offsets(site, options.shell_offset, mean_edge);
    let shell = shell(site, facts.order, &facts.inward, &offsets)?;
    let shell_nodes = shell.iter().flatten().count();
    let room = room.beyond(surface + shell_nodes)?;

    site.exec.progress.report("graph", 0.5);
    let volume = enclosed_volume(site)?.whole;
    if shell_nodes == 0 && volume == 0.0 {
        return Ok(None);
    }
    let calibrated = libm::cbrt(2.0 * volume / (LATTICE_PER_VERTEX * surface as f64));
    let wanted = options.interval.unwrap_or(mean_edge.max(calibrated));
    let body = LatticeBody {
        hull: site.hull,
        soup: site.large_soup(),
        bounds: site.mesh.bounds(),
    };
    let deep = |_: f64| DEPTH * offset;
    let (grid, nodes) = fitting_lattice(site, body, wanted, deep, [volume, room as f64])?;
    if shell_nodes == 0 && nodes.keys.is_empty() {
        return Ok(None);
    }
    let stats = GraphStats {
        lattice_nodes: nodes.keys.len(),
        interval: grid.interval,
        wanted_interval: wanted,
        shell_offset: offset,
        enclosed_volume: volume,
        ..GraphStats::default()
    };
    let placed = PlacedNodes {
        shell,
        offsets,
        turns,
        grid,
        nodes,
        depth: DEPTH * offset,
        stats,
    };
    let inner = interior_nodes(site, placed, options.valence)?;
    inner.map_or(Ok(None), |inner| join_nodes(site, inner, options).map(Some))
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

/// Refuses options that make no sense.
fn check_options(options: &VolumeOptions) -> Result<(), Error> {
    for (option, value) in [("interval", options.interval), ("shell offset", options.shell_offset)] {
        if let Some(seen) = value.filter(|v| !(*v > 0.0 && v.is_finite())) {
            return Err(Error::Length { option, seen });
        }
    }
    if !matches!(options.valence, 8 | 14) {
        return Err(Error::Valence { seen: options.valence });
    }
    Ok(())
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

/// How far the copies of each part are moved: as wanted, or by the mean edge length of the mesh. Parts of a finer mesh
/// than the rest have no room for that, and a finer shell.
pub(in crate::graph) fn shell_offsets(site: &VolumeSite, wanted: Option<f64>, mean_edge: f64) -> Vec<f64> {
    let components = &site.parts.components;
    let Some(wanted) = wanted else {
        let mut sums = vec![(0.0f64, 0usize); components.count];
        for e in &site.adjacency.edges {
            let [a, b] = e.vertices.map(|v| site.mesh.positions[v as usize]);
            let sum = &mut sums[components.of_vertex[e.vertices[0] as usize] as usize];
            *sum = (sum.0 + a.distance(b), sum.1 + 1);
        }
        let mean = |(length, edges): (f64, usize)| length / edges.max(1) as f64;
        // One part has the mean to the bit.
        return match components.count {
            1 => vec![mean_edge],
            _ => sums.into_iter().map(|sum| mean(sum).min(mean_edge)).collect(),
        };
    };
    vec![wanted; components.count]
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
