//! Ties put into the rows of a graph, and taken out of them.

use crate::exec::Exec;
use crate::graph::error::Error;
use crate::graph::mesh_graph::MeshGraph;
use crate::graph::ties::find::{TieSite, find_anchors};
use crate::graph::ties::options::{TieFamilies, TieOptions};
use crate::graph::ties::part_ties::{PartTies, TieAnchor, TieReach, UntiedGraph};
use crate::mesh::{Components, Mesh};
use crate::pool::Pool;
use rayon::prelude::*;

/// Rows written in one go.
const BLOCK: usize = 1 << 12;

/// Ties the parts of `mesh` to each other in its graph, which has no ties yet. Meshes of one part, and of parts out of each
/// other's reach, keep the bits of their graph.
///
/// Each vertex searches up to three other families and compares a bounded number of triangles, so that time and memory
/// stay in proportion to the mesh whatever lies in one place. The result depends on the arguments alone.
///
/// # Errors
/// [`Error::Length`] for a distance that is none, [`Error::Cancelled`].
pub fn tie_parts(graph: MeshGraph, mesh: &Mesh, options: &TieOptions, exec: &Exec<'_>) -> Result<MeshGraph, Error> {
    if let Some(seen) = options.distance.filter(|d| !(*d > 0.0 && d.is_finite())) {
        let option = "tie distance";
        return Err(Error::Length { option, seen });
    }
    if options.families == TieFamilies::One {
        return Ok(graph);
    }
    let parts = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
    let Some(families) = options.family_of_vertex(&parts).filter(|_| parts.count > 1) else {
        return Ok(graph);
    };
    let reach = TieReach::from_options(options, &mesh.bounds());
    let site = TieSite {
        graph: &graph,
        triangles: &mesh.triangles,
        families,
        reach,
    };
    let all: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    let anchors = find_anchors(&site, &all, exec)?;
    if anchors.is_empty() {
        return Ok(graph);
    }
    let edges = TieEdges::from_anchors(&anchors, graph.surface, exec.pool);
    Ok(insert_ties(graph, anchors, &edges, reach, exec.pool))
}

/// Edges that tie vertices, in both directions.
pub(super) struct TieEdges {
    /// Where the edges of each vertex start; one entry more than vertices.
    offsets: Vec<u32>,
    /// The other end and the weight, by rising other end.
    entries: Vec<(u32, f32)>,
}

impl TieEdges {
    /// Of two ties between the same vertices the firmer one counts.
    pub(super) fn from_anchors(anchors: &[TieAnchor], surface: usize, pool: &Pool) -> Self {
        let both = |a: &TieAnchor| {
            let vertex = a.vertex;
            let edges = a.corners.into_iter().zip(a.weights).filter(|e| e.1 > 0.0);
            edges.flat_map(move |(corner, weight)| [(vertex, corner, weight), (corner, vertex, weight)])
        };
        let mut edges: Vec<(u32, u32, f32)> = anchors.iter().flat_map(both).collect();
        let key = |e: &(u32, u32, f32)| (u64::from(e.0) << 32 | u64::from(e.1), !e.2.to_bits());
        pool.install(|| edges.par_sort_unstable_by_key(key));
        edges.dedup_by_key(|e| (e.0, e.1));
        let mut offsets = vec![0u32; surface + 1];
        edges.iter().for_each(|e| offsets[e.0 as usize + 1] += 1);
        for v in 0..surface {
            offsets[v + 1] += offsets[v];
        }
        Self {
            offsets,
            entries: edges.into_iter().map(|(_, to, weight)| (to, weight)).collect(),
        }
    }

    /// The ties of a node.
    pub(super) fn tie_row(&self, node: usize) -> &[(u32, f32)] {
        match self.offsets.get(node + 1) {
            Some(&end) => &self.entries[self.offsets[node] as usize..end as usize],
            None => &[],
        }
    }

    /// How many edges there are, each counted once.
    pub(super) fn edge_count(&self) -> usize {
        self.entries.len() / 2
    }
}

/// The rows of a graph.
struct WrittenRows {
    offsets: Vec<u32>,
    neighbours: Vec<u32>,
    weights: Vec<f32>,
}

impl WrittenRows {
    /// Writes `nodes` rows: how long each is, then what stands in it.
    fn write_rows(
        nodes: usize,
        length: impl Fn(usize) -> usize + Sync,
        fill: impl Fn(usize, &mut [u32], &mut [f32]) + Sync,
        pool: &Pool,
    ) -> Self {
        let mut offsets = Vec::with_capacity(nodes + 1);
        offsets.push(0u32);
        for node in 0..nodes {
            offsets.push(offsets[node] + length(node) as u32);
        }
        let total = offsets[nodes] as usize;
        let (mut neighbours, mut weights) = (vec![0u32; total], vec![0f32; total]);
        let mut blocks = Vec::with_capacity(nodes.div_ceil(BLOCK));
        let (mut rest, mut lighter) = (neighbours.as_mut_slice(), weights.as_mut_slice());
        for from in (0..nodes).step_by(BLOCK) {
            let to = (from + BLOCK).min(nodes);
            let count = (offsets[to] - offsets[from]) as usize;
            let (own, after) = std::mem::take(&mut rest).split_at_mut(count);
            let (own_weights, after_weights) = std::mem::take(&mut lighter).split_at_mut(count);
            (rest, lighter) = (after, after_weights);
            blocks.push((from..to, own, own_weights));
        }
        pool.install(|| {
            blocks.into_par_iter().for_each(|(range, neighbours, weights)| {
                let start = offsets[range.start];
                for node in range {
                    let row = (offsets[node] - start) as usize..(offsets[node + 1] - start) as usize;
                    fill(node, &mut neighbours[row.clone()], &mut weights[row]);
                }
            });
        });
        Self {
            offsets,
            neighbours,
            weights,
        }
    }
}

/// The graph with ties.
pub(super) fn insert_ties(
    graph: MeshGraph,
    anchors: Vec<TieAnchor>,
    edges: &TieEdges,
    reach: TieReach,
    pool: &Pool,
) -> MeshGraph {
    let row = |node: usize| graph.offsets[node] as usize..graph.offsets[node + 1] as usize;
    let weight = |entry: usize| graph.weights.as_ref().map_or(1.0, |w| w[entry]);
    let length = |node: usize| row(node).len() + edges.tie_row(node).len();
    let fill = |node: usize, neighbours: &mut [u32], weights: &mut [f32]| {
        let mut ties = edges.tie_row(node).iter().peekable();
        let mut slots = neighbours.iter_mut().zip(weights);
        let mut put = |to: u32, w: f32| {
            if let Some((neighbour, weight)) = slots.next() {
                (*neighbour, *weight) = (to, w);
            }
        };
        for entry in row(node) {
            let next = graph.neighbours[entry];
            while let Some(&(to, w)) = ties.next_if(|tie| tie.0 < next) {
                put(to, w);
            }
            put(next, weight(entry));
        }
        ties.for_each(|&(to, w)| put(to, w));
    };
    let rows = WrittenRows::write_rows(graph.nodes(), length, fill, pool);
    let tied = joined_components(&graph, &anchors);
    let mut has_volume = vec![false; tied.count];
    for (&whole, &has) in tied.of_vertex.iter().zip(&graph.stats.component_has_volume) {
        has_volume[whole as usize] |= has;
    }
    let component: Vec<u32> = graph.component.iter().map(|&c| tied.of_vertex[c as usize]).collect();
    let mut stats = graph.stats;
    let untied = UntiedGraph {
        component: graph.component,
        components: graph.components,
        component_has_volume: std::mem::replace(&mut stats.component_has_volume, has_volume),
        weighted: graph.weights.is_some(),
    };
    MeshGraph {
        offsets: rows.offsets,
        neighbours: rows.neighbours,
        weights: Some(rows.weights),
        component,
        components: tied.count,
        stats,
        ties: Some(PartTies {
            anchors,
            edges: edges.edge_count(),
            reach,
            untied,
        }),
        positions: graph.positions,
        surface: graph.surface,
        nearest_surface: graph.nearest_surface,
        recipe: graph.recipe,
    }
}

/// Components of the graph without ties, joined by them. They are numbered by their smallest nodes, and so are what they
/// become.
fn joined_components(graph: &MeshGraph, anchors: &[TieAnchor]) -> Components {
    let of = |v: u32| graph.component[v as usize];
    let joined = anchors
        .iter()
        .flat_map(|a| a.weighted_corners().map(|(corner, _)| (of(a.vertex), of(corner))));
    Components::of_edges(graph.components, joined)
}

/// The graph as it was without its ties.
pub(super) fn without_ties(graph: &MeshGraph, ties: &PartTies, edges: &TieEdges, pool: &Pool) -> MeshGraph {
    let row = |node: usize| graph.offsets[node] as usize..graph.offsets[node + 1] as usize;
    let length = |node: usize| row(node).len() - edges.tie_row(node).len();
    let fill = |node: usize, neighbours: &mut [u32], weights: &mut [f32]| {
        let mut ties = edges.tie_row(node).iter().peekable();
        let mut slots = neighbours.iter_mut().zip(weights);
        for entry in row(node) {
            let to = graph.neighbours[entry];
            if ties.next_if(|tie| tie.0 == to).is_some() {
                continue;
            }
            if let Some((neighbour, weight)) = slots.next() {
                (*neighbour, *weight) = (to, graph.weights.as_ref().map_or(1.0, |w| w[entry]));
            }
        }
    };
    let rows = WrittenRows::write_rows(graph.nodes(), length, fill, pool);
    let untied = &ties.untied;
    let mut stats = graph.stats.clone();
    stats.component_has_volume.clone_from(&untied.component_has_volume);
    MeshGraph {
        offsets: rows.offsets,
        neighbours: rows.neighbours,
        weights: untied.weighted.then_some(rows.weights),
        component: untied.component.clone(),
        components: untied.components,
        stats,
        ties: None,
        positions: graph.positions.clone(),
        surface: graph.surface,
        nearest_surface: graph.nearest_surface.clone(),
        recipe: graph.recipe.clone(),
    }
}
