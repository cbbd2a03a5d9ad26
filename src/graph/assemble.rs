//! From lists of edges to a [`Graph`].

use super::{Graph, Stats, Weights, weights};
use crate::mesh::{Adjacency, Components, Mesh};
use glam::DVec3;

/// Nodes and edges beyond the mesh's own.
#[derive(Default)]
pub(super) struct Inner {
    /// For each vertex, the node number of its shell copy, or [`NO_SHELL`]; empty without a shell.
    pub(super) shell: Vec<u32>,
    /// Positions of shell nodes, then lattice nodes.
    pub(super) positions: Vec<DVec3>,
    /// The solver vertex of each of them.
    pub(super) nearest_surface: Vec<u32>,
    /// Lattice edges and ties, in node numbers; repeats are allowed.
    pub(super) edges: Vec<[u32; 2]>,
}

/// In [`Inner::shell`]: no room inside for a copy.
pub(super) const NO_SHELL: u32 = u32::MAX;

impl Inner {
    fn shell_of(&self, vertex: u32) -> Option<u32> {
        self.shell.get(vertex as usize).copied().filter(|&s| s != NO_SHELL)
    }
}

/// Puts mesh, shell and lattice together. `stats.component_has_volume` is filled in here.
pub(super) fn assemble(
    mesh: &Mesh,
    adjacency: &Adjacency,
    inner: Inner,
    weighting: Weights,
    mut stats: Stats,
) -> Graph {
    let surface = mesh.positions.len();
    let nodes = surface + inner.positions.len();
    let mut positions = Vec::with_capacity(nodes);
    positions.extend_from_slice(&mesh.positions);
    positions.extend_from_slice(&inner.positions);
    let each = |edge: &mut dyn FnMut(u32, u32)| each_edge(adjacency, &inner, &positions, edge);

    let mut offsets = vec![0u32; nodes + 1];
    each(&mut |a, b| {
        offsets[a as usize + 1] += 1;
        offsets[b as usize + 1] += 1;
    });
    for i in 0..nodes {
        offsets[i + 1] += offsets[i];
    }
    let mut next = offsets.clone();
    let mut neighbours = vec![0u32; offsets[nodes] as usize];
    each(&mut |a, b| {
        for (from, to) in [(a, b), (b, a)] {
            neighbours[next[from as usize] as usize] = to;
            next[from as usize] += 1;
        }
    });
    drop(next);
    sort_rows(&mut offsets, &mut neighbours);

    let rows = offsets.windows(2).zip(0u32..);
    let pairs = rows.flat_map(|(w, i)| neighbours[w[0] as usize..w[1] as usize].iter().map(move |&j| (i, j)));
    let components = Components::of_edges(nodes, pairs.filter(|(i, j)| i < j));
    stats.component_has_volume = vec![false; components.count];
    components.of_vertex[surface..]
        .iter()
        .for_each(|&c| stats.component_has_volume[c as usize] = true);

    let weights = match weighting {
        Weights::Uniform => None,
        Weights::Cotangent => {
            let of_edge = weights::cotangents(&mesh.positions, &mesh.triangles, adjacency);
            Some(spread(&offsets, &neighbours, adjacency, &of_edge))
        }
    };
    let mut nearest_surface: Vec<u32> = (0..surface as u32).collect();
    nearest_surface.extend_from_slice(&inner.nearest_surface);
    Graph {
        offsets,
        neighbours,
        weights,
        positions,
        surface,
        nearest_surface,
        component: components.of_vertex,
        components: components.count,
        stats,
    }
}

/// Calls `edge` for every edge: the mesh's; the shell's, as the mesh's; vertex to shell copy; the shorter diagonal of
/// each prism side (the only one there is when one end has no copy); lattice edges and ties.
fn each_edge(adjacency: &Adjacency, inner: &Inner, positions: &[DVec3], edge: &mut dyn FnMut(u32, u32)) {
    let length = |a: u32, b: u32| positions[a as usize].distance_squared(positions[b as usize]);
    for e in &adjacency.edges {
        let [u, v] = e.vertices;
        edge(u, v);
        match (inner.shell_of(u), inner.shell_of(v)) {
            (Some(su), Some(sv)) => {
                edge(su, sv);
                if length(u, sv) <= length(v, su) {
                    edge(u, sv)
                } else {
                    edge(v, su)
                }
            }
            (Some(su), None) => edge(v, su),
            (None, Some(sv)) => edge(u, sv),
            (None, None) => {}
        }
    }
    for v in 0..inner.shell.len() as u32 {
        if let Some(s) = inner.shell_of(v) {
            edge(v, s);
        }
    }
    inner.edges.iter().for_each(|&[a, b]| edge(a, b));
}

/// Sorts each row and drops repeats, closing the gaps.
fn sort_rows(offsets: &mut [u32], neighbours: &mut Vec<u32>) {
    let mut end = 0;
    let mut start = 0;
    for i in 0..offsets.len() - 1 {
        let stop = offsets[i + 1] as usize;
        neighbours[start..stop].sort_unstable();
        let first = end;
        for k in start..stop {
            if end == first || neighbours[end - 1] != neighbours[k] {
                neighbours[end] = neighbours[k];
                end += 1;
            }
        }
        start = stop;
        offsets[i + 1] = end as u32;
    }
    neighbours.truncate(end);
    neighbours.shrink_to_fit();
}

/// Weights of mesh edges brought to both of their entries; all other entries are 1.
fn spread(offsets: &[u32], neighbours: &[u32], adjacency: &Adjacency, of_edge: &[f32]) -> Vec<f32> {
    let mut weights = vec![1.0; neighbours.len()];
    for (e, &w) in adjacency.edges.iter().zip(of_edge) {
        let [a, b] = e.vertices;
        for (from, to) in [(a, b), (b, a)] {
            let start = offsets[from as usize] as usize;
            if let Ok(k) = neighbours[start..offsets[from as usize + 1] as usize].binary_search(&to) {
                weights[start + k] = w;
            }
        }
    }
    weights
}
