//! The volume graph of a mesh: surface, shell and lattice (Zhou et al. 2005; the lattice interval is calibrated on the
//! node counts in the paper's tables).

use crate::exec::Exec;
use crate::graph::error::Error;
use crate::graph::mesh_graph::{GraphStats, MeshGraph};
use crate::graph::volume::lattice::LatticeBody;
use crate::graph::volume::neighbours::NearSurface;
use crate::graph::volume::options::{InteriorKind, VolumeOptions};
use crate::graph::volume::placing::{NodeRoom, SiteFacts, enclosed_volume, fitting_lattice, join_nodes};
use crate::graph::volume::placing::{PlacedNodes, interior_nodes};
use crate::graph::volume::principal_axes::PrincipalAxes;
use crate::graph::volume::shape::{InsideHull, VolumeSite, shell};
use crate::graph::volume::shape::{most_lattice_nodes, shape_interior};
use crate::graph::volume::solid::inward_directions;
use crate::graph::volume::solid::{ClassifiedParts, PartKind};
use crate::graph::volume::thickness::{ClosedHull, HullFaces};
use crate::graph::winding::tree::WindingTree;
use crate::mesh::query::{VisitBudget, VisitCount};
use crate::mesh::{Adjacency, Mesh, mean_edge_length};
use std::sync::OnceLock;

/// Lattice nodes wanted for each vertex; with the shell this makes 3.1 nodes per vertex, as in the paper's tables.
const LATTICE_PER_VERTEX: f64 = 1.2;
/// Lattice nodes lie deeper than this many shell offsets.
const DEPTH: f64 = 1.25;
/// Winding numbers are asked this many mean edge lengths beside the surface.
const BESIDE: f64 = 1.0 / 64.0;

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
    options.check()?;
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

/// How far the copies of each part are moved: as wanted, or by the mean edge length of the mesh. Parts of a finer mesh
/// than the rest have no room for that, and a finer shell.
fn shell_offsets(site: &VolumeSite, wanted: Option<f64>, mean_edge: f64) -> Vec<f64> {
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
