//! From shell, lattice and ties to the rows of a [`MeshGraph`].
//!
//! Every row can be written on its own, already rising: a vertex's neighbours on the mesh come before their shell
//! copies, and these before the lattice. So rows are counted, then filled, both in parallel.
//!
//! The graph of a mesh alone.

use crate::graph::mesh_graph::{self, EdgeWeights, GraphRecipe, GraphStats, MeshGraph};
use crate::graph::volume::lattice_grid::{LatticeRow, NONE};
use crate::graph::volume::spread::Strut;
use crate::{Adjacency, Components, Lists, Mesh};
use glam::DVec3;
use pliant_exec::pool::Pool;
use rayon::prelude::*;
use std::ops::Range;

/// Nodes and edges beyond the mesh's own.
#[derive(Default)]
pub(super) struct InteriorNodes {
    /// For each vertex, the node number of its shell copy, or [`NONE`]; empty without a shell.
    pub(super) shell: Vec<u32>,
    /// Number of shell nodes.
    pub(super) copies: usize,
    /// Positions of shell nodes, then lattice nodes.
    pub(super) positions: Vec<DVec3>,
    /// The solver vertex of each of them.
    pub(super) nearest_surface: Vec<u32>,
    /// For each lattice node its neighbours in the lattice, counted from the first lattice node, rising up to the first
    /// [`NONE`].
    pub(super) lattice: Vec<LatticeRow>,
    /// Lattice node, counted from the first one, and the surface or shell node that it is tied to; rising, each once.
    pub(super) ties: Vec<[u32; 2]>,
    /// What they weigh; empty where all ties and edges of the lattice weigh 1.
    pub(super) tie_weights: Vec<f32>,
    /// Edges between vertices that are none of the mesh; rising, each once.
    pub(super) struts: Vec<Strut>,
    /// For each lattice node what its edges within the lattice weigh, the same for all that are joined; empty as `tie_weights`.
    pub(super) lattice_weights: Vec<f32>,
    /// What edits need to know of how these nodes were placed.
    pub(super) recipe: GraphRecipe,
    /// Facts about them; [`assemble`] adds which components have any.
    pub(super) stats: GraphStats,
}

impl InteriorNodes {
    /// Nodes of the shell alone, numbered after the `surface` vertices.
    pub(super) fn with_copies(surface: u32, shell: &[Option<DVec3>]) -> Self {
        let mut inner = Self {
            shell: vec![NONE; shell.len()],
            ..Self::default()
        };
        for (v, copy) in (0u32..).zip(shell) {
            if let Some(p) = copy {
                inner.shell[v as usize] = surface + inner.positions.len() as u32;
                inner.positions.push(*p);
                inner.nearest_surface.push(v);
            }
        }
        inner.copies = inner.positions.len();
        inner
    }
}

/// Rows handled in one go.
const BLOCK: usize = 1 << 12;

/// What rows are made from.
struct GraphRows<'a> {
    adjacency: &'a Adjacency,
    inner: &'a InteriorNodes,
    surface: usize,
    /// Shell nodes' vertices come first in `nearest_surface`.
    first_lattice: usize,
    /// For each neighbour of each vertex on the mesh, whether the vertex is joined to the copy of that neighbour.
    diagonals: Vec<bool>,
    /// The numbers of ties by lattice node and by what they are tied to.
    from_lattice: Lists,
    to_lattice: Lists,
    /// The numbers of struts by vertex, in the order of their other ends.
    struts: Lists,
}

impl GraphRows<'_> {
    fn shell_of(&self, vertex: u32) -> Option<u32> {
        self.inner.shell.get(vertex as usize).copied().filter(|&s| s != NONE)
    }

    /// The neighbours of a vertex on the mesh, and for each whether the vertex is joined to its copy. The copy of the vertex
    /// is joined to the others: of the diagonals of each prism side there is one.
    fn around(&self, v: u32) -> impl Iterator<Item = (u32, bool)> {
        let neighbours = &self.adjacency.neighbours;
        let row = neighbours.offsets()[v as usize] as usize..neighbours.offsets()[v as usize + 1] as usize;
        let joined = self.diagonals.get(row.clone()).unwrap_or_default();
        let all = neighbours.items()[row].iter().copied();
        all.zip(joined.iter().copied())
    }

    /// Number of neighbours of `node`.
    fn row_length(&self, node: usize) -> u32 {
        if node >= self.first_lattice {
            let n = node - self.first_lattice;
            let within = self.inner.lattice[n].iter().filter(|&&n| n != NONE).count();
            return (self.from_lattice.of(n as u32).len() + within) as u32;
        }
        let ties = self.to_lattice.of(node as u32).len();
        let row = if node < self.surface {
            let v = node as u32;
            let joined = self.around(v).filter(|w| w.1).count();
            let own = self.adjacency.neighbours.of(v).len() + self.struts.of(v).len();
            own + joined + usize::from(self.shell_of(v).is_some())
        } else {
            let v = self.inner.nearest_surface[node - self.surface];
            let joined = self
                .around(v)
                .map(|(w, is_joined)| usize::from(!is_joined) + usize::from(self.shell_of(w).is_some()));
            1 + joined.sum::<usize>()
        };
        (row + ties) as u32
    }

    /// Calls `put` for the neighbours of `node`, rising, each with what the edge weighs where the mesh's edges weigh 1.
    fn each(&self, node: usize, mut put: impl FnMut(u32, f32)) {
        let put = &mut put;
        let first = self.first_lattice as u32;
        if node < self.surface {
            let v = node as u32;
            let mut struts = self.struts_of(v).peekable();
            for &w in self.adjacency.neighbours.of(v) {
                while let Some((to, weight)) = struts.next_if(|s| s.0 < w) {
                    put(to, weight);
                }
                put(w, 1.0);
            }
            struts.for_each(|(to, weight)| put(to, weight));
            let mut own = self.shell_of(v);
            for (w, _) in self.around(v).filter(|w| w.1) {
                if w > v {
                    own.take().into_iter().for_each(|s| put(s, 1.0));
                }
                self.shell_of(w).into_iter().for_each(|s| put(s, 1.0));
            }
            own.into_iter().for_each(|s| put(s, 1.0));
            self.ties_of(self.to_lattice.of(v))
                .for_each(|([n, _], w)| put(first + n, w));
        } else if node < self.first_lattice {
            let v = self.inner.nearest_surface[node - self.surface];
            let mut own = Some(v);
            for (w, _) in self.around(v).filter(|w| !w.1) {
                if w > v {
                    own.take().into_iter().for_each(|v| put(v, 1.0));
                }
                put(w, 1.0);
            }
            own.into_iter().for_each(|v| put(v, 1.0));
            let around = self.adjacency.neighbours.of(v).iter();
            around.filter_map(|&w| self.shell_of(w)).for_each(|s| put(s, 1.0));
            self.ties_of(self.to_lattice.of(node as u32))
                .for_each(|([n, _], w)| put(first + n, w));
        } else {
            let n = node - self.first_lattice;
            self.ties_of(self.from_lattice.of(n as u32))
                .for_each(|([_, to], w)| put(to, w));
            let weight = self.inner.lattice_weights.get(n).copied().unwrap_or(1.0);
            let row = self.inner.lattice[n].iter();
            row.take_while(|&&n| n != NONE).for_each(|&n| put(first + n, weight));
        }
    }

    /// Some ties with their weights.
    fn ties_of(&self, numbers: &[u32]) -> impl Iterator<Item = ([u32; 2], f32)> {
        let tie = |&tie: &u32| {
            let weight = self.inner.tie_weights.get(tie as usize).copied();
            (self.inner.ties[tie as usize], weight.unwrap_or(1.0))
        };
        numbers.iter().map(tie)
    }

    /// The other ends of a vertex's struts, rising, with their weights.
    fn struts_of(&self, v: u32) -> impl Iterator<Item = (u32, f32)> {
        let numbers = self.struts.of(v).iter();
        numbers.map(move |&strut| {
            let ([a, b], weight) = self.inner.struts[strut as usize];
            (if a == v { b } else { a }, weight)
        })
    }

    /// The weights of all rows, where edges of the mesh weigh 1.
    fn weigh_rows(&self, offsets: &[u32], nodes: usize) -> Vec<f32> {
        let mut weights = vec![1f32; offsets[nodes] as usize];
        write_rows(offsets, &mut weights, |node, row| {
            let mut slots = row.iter_mut();
            self.each(node, |_, weight| {
                slots.next().into_iter().for_each(|slot| *slot = weight)
            });
        });
        weights
    }
}

/// Blocks of [`BLOCK`] nodes, each with the entries of its rows.
pub(super) fn row_blocks<'a, T>(offsets: &[u32], entries: &'a mut [T]) -> Vec<(Range<usize>, &'a mut [T])> {
    let nodes = offsets.len() - 1;
    let mut blocks = Vec::with_capacity(nodes.div_ceil(BLOCK));
    let mut rest = entries;
    for from in (0..nodes).step_by(BLOCK) {
        let to = (from + BLOCK).min(nodes);
        let (block, after) = rest.split_at_mut((offsets[to] - offsets[from]) as usize);
        blocks.push((from..to, block));
        rest = after;
    }
    blocks
}

/// Writes the entries of all rows, many rows at a time.
fn write_rows<T: Send>(offsets: &[u32], entries: &mut [T], write: impl Fn(usize, &mut [T]) + Sync) {
    let blocks = row_blocks(offsets, entries);
    blocks.into_par_iter().for_each(|(range, block)| {
        let start = offsets[range.start];
        for node in range {
            write(
                node,
                &mut block[(offsets[node] - start) as usize..(offsets[node + 1] - start) as usize],
            );
        }
    });
}

/// Puts mesh, shell and lattice together, on the caller's thread without a pool.
pub(super) fn assemble(
    mesh: &Mesh,
    adjacency: &Adjacency,
    parts: &Components,
    mut inner: InteriorNodes,
    weighting: EdgeWeights,
    pool: Option<&Pool>,
) -> MeshGraph {
    let surface = mesh.positions.len();
    let mut recipe = std::mem::take(&mut inner.recipe);
    let mut stats = std::mem::take(&mut inner.stats);
    let nodes = surface + inner.positions.len();
    let mut positions = Vec::with_capacity(nodes);
    positions.extend_from_slice(&mesh.positions);
    positions.extend_from_slice(&inner.positions);
    let first_lattice = surface + inner.copies;
    let diagonals = pool.map_or_else(Vec::new, |pool| {
        pool.install(|| find_diagonals(adjacency, &inner.shell, &positions))
    });
    let rows = GraphRows {
        adjacency,
        inner: &inner,
        surface,
        first_lattice,
        diagonals,
        from_lattice: Lists::gather(inner.lattice.len(), || {
            (0u32..).zip(&inner.ties).map(|(tie, t)| (t[0], tie))
        }),
        to_lattice: Lists::gather(first_lattice, || (0u32..).zip(&inner.ties).map(|(tie, t)| (t[1], tie))),
        struts: Lists::gather(surface, || {
            (0u32..).zip(&inner.struts).flat_map(|(k, s)| s.0.map(|v| (v, k)))
        }),
    };

    let (offsets, neighbours) = match pool {
        Some(pool) => pool.install(|| fill_rows(nodes, &rows)),
        None => filled_alone(nodes, &rows),
    };
    let components = components(&inner, parts, surface);
    stats.component_has_volume = vec![false; components.count];
    components.of_vertex[surface..]
        .iter()
        .for_each(|&c| stats.component_has_volume[c as usize] = true);
    for ([v, _], _) in &inner.struts {
        stats.component_has_volume[components.of_vertex[*v as usize] as usize] = true;
    }
    let found = mesh_graph::cotangents(weighting, &mesh.positions, &mesh.triangles, adjacency);
    let (cotangents, scale) = found.unzip();
    recipe.cotangents = scale;
    let is_weighted = cotangents.is_some() || !inner.lattice_weights.is_empty() || !inner.struts.is_empty();
    let weights = is_weighted.then(|| {
        let mut weights = match pool {
            Some(pool) => pool.install(|| rows.weigh_rows(&offsets, nodes)),
            None => vec![1.0; neighbours.len()],
        };
        if let Some(of_edge) = cotangents {
            spread_weights(&offsets, &neighbours, adjacency, &of_edge, &mut weights);
        }
        weights
    });
    let mut nearest_surface: Vec<u32> = (0..surface as u32).collect();
    nearest_surface.extend_from_slice(&inner.nearest_surface);
    MeshGraph {
        offsets,
        neighbours,
        weights,
        positions,
        surface,
        nearest_surface,
        component: components.of_vertex,
        components: components.count,
        stats,
        recipe,
        ties: None,
    }
}

/// For each neighbour of each vertex, whether the vertex is joined to its copy: the shorter diagonal of each prism side is,
/// the only one there is when one end has no copy.
fn find_diagonals(adjacency: &Adjacency, shell: &[u32], positions: &[DVec3]) -> Vec<bool> {
    let length = |a: u32, b: u32| positions[a as usize].distance_squared(positions[b as usize]);
    let is_joined = |v: u32, w: u32| match [shell[v as usize], shell[w as usize]] {
        [_, NONE] => false,
        [NONE, _] => true,
        [sv, sw] if v < w => length(v, sw) <= length(w, sv),
        [sv, sw] => length(w, sv) > length(v, sw),
    };
    let offsets = adjacency.neighbours.offsets();
    let blocks: Vec<usize> = (0..shell.len()).step_by(BLOCK).collect();
    let found = blocks.into_par_iter().map(|from| {
        let to = (from + BLOCK).min(shell.len());
        let mut joined = Vec::with_capacity((offsets[to] - offsets[from]) as usize);
        for v in from as u32..to as u32 {
            let around = adjacency.neighbours.of(v).iter();
            joined.extend(around.map(|&w| is_joined(v, w)));
        }
        joined
    });
    found.collect::<Vec<_>>().concat()
}

/// Offsets and neighbours of all rows.
fn fill_rows(nodes: usize, rows: &GraphRows) -> (Vec<u32>, Vec<u32>) {
    let mut offsets = vec![0u32; nodes + 1];
    let counted = offsets[1..].par_iter_mut().enumerate().with_min_len(BLOCK);
    counted.for_each(|(node, count)| *count = rows.row_length(node));
    for i in 0..nodes {
        offsets[i + 1] += offsets[i];
    }
    let mut neighbours = vec![0u32; offsets[nodes] as usize];
    write_rows(&offsets, &mut neighbours, |node, row| {
        let mut slots = row.iter_mut();
        rows.each(node, |neighbour, _| {
            slots.next().into_iter().for_each(|slot| *slot = neighbour)
        });
    });
    (offsets, neighbours)
}

/// As [`fill_rows`], on the caller's thread.
fn filled_alone(nodes: usize, rows: &GraphRows) -> (Vec<u32>, Vec<u32>) {
    let mut offsets = Vec::with_capacity(nodes + 1);
    offsets.push(0);
    let mut neighbours = Vec::new();
    for node in 0..nodes {
        rows.each(node, |neighbour, _| neighbours.push(neighbour));
        offsets.push(neighbours.len() as u32);
    }
    neighbours.shrink_to_fit();
    (offsets, neighbours)
}

/// The components of the graph: parts of the mesh, joined where one lattice is tied to several.
fn components(inner: &InteriorNodes, parts: &Components, surface: usize) -> Components {
    let lattice = parts.count as u32;
    let part = |node: u32| {
        let vertex = match (node as usize).checked_sub(surface) {
            Some(copy) => inner.nearest_surface[copy],
            None => node,
        };
        parts.of_vertex[vertex as usize]
    };
    let within = (0u32..).zip(&inner.lattice).flat_map(|(n, row)| {
        let lower = row.iter().take_while(move |&&m| m < n);
        lower.map(move |&m| (lattice + n, lattice + m))
    });
    let ties = inner.ties.iter().map(|&[n, to]| (lattice + n, part(to)));
    let joined = Components::of_edges(parts.count + inner.lattice.len(), within.chain(ties));
    let mut of_vertex = Vec::with_capacity(surface + inner.positions.len());
    of_vertex.extend(parts.of_vertex.iter().map(|&p| joined.of_vertex[p as usize]));
    of_vertex.extend((0..inner.copies).map(|copy| joined.of_vertex[part((surface + copy) as u32) as usize]));
    of_vertex.extend_from_slice(&joined.of_vertex[parts.count..]);
    Components {
        of_vertex,
        count: joined.count,
    }
}

/// Brings weights of mesh edges to both of their entries.
fn spread_weights(offsets: &[u32], neighbours: &[u32], adjacency: &Adjacency, of_edge: &[f32], weights: &mut [f32]) {
    for (e, &w) in adjacency.edges.iter().zip(of_edge) {
        let [a, b] = e.vertices;
        for (from, to) in [(a, b), (b, a)] {
            let start = offsets[from as usize] as usize;
            if let Ok(k) = neighbours[start..offsets[from as usize + 1] as usize].binary_search(&to) {
                weights[start + k] = w;
            }
        }
    }
}

/// Makes a graph of the mesh's vertices and edges alone, for open surfaces and for callers that want no volume graph.
///
/// ```
/// use glam::DVec3;
/// use pliant_mesh::graph::{EdgeWeights, surface};
/// use pliant_mesh::{Mesh, Weld};
///
/// let positions = [DVec3::ZERO, DVec3::X, DVec3::X + DVec3::Y, DVec3::Y];
/// let square = Mesh::build(&positions, &[[0, 1, 2], [0, 2, 3]], Weld::Exact)?;
/// let graph = surface(&square, EdgeWeights::Uniform);
/// assert_eq!((graph.nodes(), graph.edges()), (4, 5));
/// assert_eq!(graph.row(0), [1, 2, 3]);
/// # Ok::<(), pliant_mesh::Error>(())
/// ```
///
/// Time and memory are linear in the number of triangles.
pub fn surface(mesh: &Mesh, weights: EdgeWeights) -> MeshGraph {
    let adjacency = Adjacency::build(mesh.positions.len(), &mesh.triangles);
    let parts = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
    assemble(mesh, &adjacency, &parts, InteriorNodes::default(), weights, None)
}
