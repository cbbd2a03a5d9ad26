//! Graphs for meshes whose parts touch but do not belong together, such as the halves of a cut.
//!
//! A volume graph of touching parts shares one lattice, which ties them. Here every part gets a graph of its own.

use crate::exec::Exec;
use crate::graph::error::Error;
use crate::graph::mesh_graph::{GraphStats, MeshGraph};
use crate::graph::recipe::GraphRecipe;
use crate::graph::surface::surface;
use crate::graph::volume::build::volume;
use crate::graph::volume::options::VolumeOptions;
use crate::mesh::{Components, Mesh};

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
        let row = g.offsets[node as usize] as usize..g.offsets[node as usize + 1] as usize;
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
    use crate::asset::shapes;
    use crate::mesh::Weld;
    use crate::pool::Pool;
    use crate::progress::Silent;
    use glam::DVec3;

    #[test]
    fn touching_parts_are_not_tied() {
        let (positions, triangles) = shapes::box_with_cells(DVec3::splat(1.0), [6, 6, 6]);
        let count = positions.len() as u32;
        let mut both = positions.clone();
        both.extend(positions.iter().map(|p| *p + DVec3::X));
        let mut faces = triangles.clone();
        faces.extend(triangles.iter().map(|t| t.map(|v| v + count)));
        // Two boxes that share a side, told apart by number.
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
