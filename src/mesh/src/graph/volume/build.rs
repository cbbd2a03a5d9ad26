//! The volume graph of a mesh: surface, shell and lattice (Zhou et al. 2005; the lattice interval is calibrated on the
//! node counts in the paper's tables).
//!
//! A volume graph of touching parts shares one lattice, which ties them. Where parts touch but do not belong together, such as
//! the halves of a cut, every part gets a graph of its own.

use crate::graph::assemble::surface;
use crate::graph::mesh_graph::{GraphRecipe, GraphStats, MeshGraph};
use crate::graph::volume::caps::{ClosedHull, HullFaces};
use crate::graph::volume::lattice::LatticeBody;
use crate::graph::volume::lattice_grid::NearSurface;
use crate::graph::volume::placing::{
    NodeRoom, PlacedNodes, SiteFacts, enclosed_volume, fitting_lattice, interior_nodes, join_nodes,
};
use crate::graph::volume::principal_axes::PrincipalAxes;
use crate::graph::volume::shape::{most_lattice_nodes, shape_interior};
use crate::graph::volume::shell::{InsideHull, VolumeSite, inward_directions, shell};
use crate::graph::volume::solid::{ClassifiedParts, PartKind};
use crate::graph::volume::{InteriorKind, VolumeOptions};
use crate::graph::winding::WindingTree;
use crate::query::{VisitBudget, VisitCount};
use crate::{Adjacency, Components, Error, Mesh, mean_edge_length};
use pliant_exec::Exec;
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
/// use pliant_asset::shapes::box_with_cells;
/// use pliant_exec::Exec;
/// use pliant_mesh::graph::{VolumeOptions, volume};
/// use pliant_mesh::{Mesh, Weld};
/// use pliant_exec::pool::Pool;
/// use pliant_exec::progress::Silent;
///
/// let (positions, triangles) = box_with_cells(DVec3::ONE, [6, 6, 6]);
/// let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a box");
/// let pool = Pool::new(1).expect("a thread");
/// let graph = volume(&mesh, &VolumeOptions::default(), &Exec::new(&pool, &Silent))?.expect("a box has an inside");
/// assert_eq!(graph.surface, mesh.positions.len());
/// assert!(graph.stats.lattice_nodes > 0 && graph.nodes() > graph.surface);
/// # Ok::<(), pliant_mesh::Error>(())
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
        // One part has the mean bit for bit.
        return match components.count {
            1 => vec![mean_edge],
            _ => sums.into_iter().map(|sum| mean(sum).min(mean_edge)).collect(),
        };
    };
    vec![wanted; components.count]
}

/// As [`volume`], with nothing that ties one connected part of the mesh to another. Parts without an inside have the edges of
/// the mesh; `None` when no part has one.
///
/// # Errors
/// As [`volume`].
pub fn volume_apart(mesh: &Mesh, options: &VolumeOptions, exec: &Exec<'_>) -> Result<Option<MeshGraph>, Error> {
    let parts = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
    if parts.count < 2 {
        return volume(mesh, options, exec);
    }
    let mut graphs = Vec::with_capacity(parts.count);
    let mut any = false;
    for (points, part) in split_parts(mesh, &parts)? {
        let inner = volume(&part, options, exec)?;
        any |= inner.is_some();
        graphs.push((points, inner.unwrap_or_else(|| surface(&part, options.weights))));
    }
    let nodes: usize = graphs.iter().map(|(_, g)| g.nodes()).sum();
    if nodes > options.max_nodes {
        return Err(Error::TooManyNodes {
            nodes,
            limit: options.max_nodes,
            surface: mesh.positions.len(),
        });
    }
    Ok(any.then(|| unite_graphs(mesh, &graphs)))
}

/// Each part as a mesh of its own, with the numbers that its vertices have in the whole.
fn split_parts(mesh: &Mesh, parts: &Components) -> Result<Vec<(Vec<u32>, Mesh)>, Error> {
    let mut points = vec![Vec::new(); parts.count];
    let mut local = vec![0u32; mesh.positions.len()];
    for (v, &part) in (0u32..).zip(&parts.of_vertex) {
        local[v as usize] = points[part as usize].len() as u32;
        points[part as usize].push(v);
    }
    let mut triangles = vec![Vec::new(); parts.count];
    for t in &mesh.triangles {
        triangles[parts.of_vertex[t[0] as usize] as usize].push(t.map(|v| local[v as usize]));
    }
    let mut all = Vec::with_capacity(parts.count);
    for (points, triangles) in points.into_iter().zip(triangles) {
        let positions: Vec<_> = points.iter().map(|&v| mesh.positions[v as usize]).collect();
        let own = (0..positions.len() as u32).collect();
        // A part is made of triangles that the whole was checked with.
        if let Ok(part) = Mesh::of_points(&positions, &triangles, own, positions.len()) {
            all.push((points, part));
        }
    }
    Ok(all)
}

/// One graph of all: the surfaces in the order of the mesh, then the shells, then the lattices, part after part.
fn unite_graphs(mesh: &Mesh, graphs: &[(Vec<u32>, MeshGraph)]) -> MeshGraph {
    let surface = mesh.positions.len();
    let shells: usize = graphs.iter().map(|(_, g)| g.stats.shell_nodes).sum();
    let (mut next_shell, mut next_lattice) = (surface as u32, (surface + shells) as u32);
    // For each part the number of each of its nodes in the whole; rising, so that rows stay in order.
    let numbers: Vec<Vec<u32>> = (graphs.iter())
        .map(|(points, g)| {
            let mut numbers = points.clone();
            let shell = g.stats.shell_nodes as u32;
            let lattice = (g.nodes() - g.surface) as u32 - shell;
            numbers.extend(next_shell..next_shell + shell);
            numbers.extend(next_lattice..next_lattice + lattice);
            next_shell += shell;
            next_lattice += lattice;
            numbers
        })
        .collect();
    let nodes = next_lattice as usize;
    // Where each node comes from.
    let mut of = vec![(0u32, 0u32); nodes];
    for (part, numbers) in (0u32..).zip(&numbers) {
        for (node, &number) in (0u32..).zip(numbers) {
            of[number as usize] = (part, node);
        }
    }
    let weighted = graphs.iter().any(|(_, g)| g.weights.is_some());
    let mut whole = MeshGraph {
        offsets: Vec::with_capacity(nodes + 1),
        neighbours: Vec::new(),
        weights: weighted.then(Vec::new),
        positions: Vec::with_capacity(nodes),
        surface,
        nearest_surface: Vec::with_capacity(nodes),
        component: Vec::with_capacity(nodes),
        components: graphs.len(),
        stats: GraphStats::default(),
        recipe: GraphRecipe::default(),
        ties: None,
    };
    whole.offsets.push(0);
    for (part, node) in of {
        let (_, g) = &graphs[part as usize];
        let numbers = &numbers[part as usize];
        let row = g.entries(node);
        whole
            .neighbours
            .extend(g.neighbours[row.clone()].iter().map(|&j| numbers[j as usize]));
        if let Some(weights) = &mut whole.weights {
            match &g.weights {
                Some(w) => weights.extend_from_slice(&w[row]),
                None => weights.resize(whole.neighbours.len(), 1.0),
            }
        }
        whole.offsets.push(whole.neighbours.len() as u32);
        whole.positions.push(g.positions[node as usize]);
        whole
            .nearest_surface
            .push(numbers[g.nearest_surface[node as usize] as usize]);
        whole.component.push(part);
    }
    whole.stats = total_stats(graphs);
    whole
}

/// Counts and volumes added up; lengths of the part with the widest lattice.
fn total_stats(graphs: &[(Vec<u32>, MeshGraph)]) -> GraphStats {
    let mut all = GraphStats::default();
    for (_, g) in graphs {
        let s = &g.stats;
        all.shell_nodes += s.shell_nodes;
        all.lattice_nodes += s.lattice_nodes;
        all.struts += s.struts;
        all.interval = all.interval.max(s.interval);
        all.wanted_interval = all.wanted_interval.max(s.wanted_interval);
        all.shell_offset = all.shell_offset.max(s.shell_offset);
        all.enclosed_volume += s.enclosed_volume;
        all.component_has_volume
            .push(s.component_has_volume.first().copied().unwrap_or(false));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Weld;
    use glam::DVec3;
    use pliant_asset::shapes;
    use pliant_exec::pool::Pool;
    use pliant_exec::progress::Silent;

    #[test]
    fn touching_parts_are_not_tied() {
        let (positions, triangles) = shapes::box_with_cells(DVec3::splat(1.0), [6, 6, 6]);
        let count = positions.len() as u32;
        let mut both = positions.clone();
        both.extend(positions.iter().map(|p| *p + DVec3::X));
        let mut faces = triangles.clone();
        faces.extend(triangles.iter().map(|t| t.map(|v| v + count)));
        // Two boxes that share a side, distinguished by number.
        let own: Vec<u32> = (0..2 * count).collect();
        let mesh = Mesh::of_points(&both, &faces, own, both.len()).expect("two boxes");
        let pool = Pool::new(2).expect("threads");
        let options = VolumeOptions::default();
        let graph = volume_apart(&mesh, &options, &Exec::new(&pool, &Silent))
            .expect("fits")
            .expect("inside");
        let alone = Mesh::build(&positions, &triangles, Weld::Exact).expect("a box");
        let alone = volume(&alone, &options, &Exec::new(&pool, &Silent))
            .expect("fits")
            .expect("inside");
        assert_eq!(
            (graph.components, graph.nodes(), graph.edges()),
            (2, 2 * alone.nodes(), 2 * alone.edges())
        );
        for node in 0..graph.nodes() as u32 {
            let part = graph.component[node as usize];
            assert!(graph.row(node).is_sorted());
            assert!(graph.row(node).iter().all(|&j| graph.component[j as usize] == part));
            assert_eq!(graph.component[graph.nearest_surface[node as usize] as usize], part);
        }
    }
}
