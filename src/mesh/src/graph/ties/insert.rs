//! Ties put into the rows of a graph, and taken out of them.
//!
//! Ties after an edit of the mesh: those around the edit are found again, all others stay.

use crate::graph::assemble::row_blocks;
use crate::graph::mesh_graph::MeshGraph;
use crate::graph::resample::{MeshChange, ResampledGraph, resample};
use crate::graph::ties::part_ties::{LOOSE, PartTies, TieAnchor, TieFamilies, TieOptions, TieReach, UntiedGraph};
use crate::graph::ties::part_tree::{TieSite, find_anchors};
use crate::query::TriangleBvh;
use crate::{BoundingBox, Components, Error, Mesh, NONE};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use rayon::prelude::*;

/// Ties the parts of `mesh` to each other in its graph, which has no ties yet. Meshes of one part, and of parts out of each
/// other's reach, keep the bits of their graph.
///
/// Each vertex searches up to three other families and compares a bounded number of triangles, so that time and memory
/// stay in proportion to the mesh whatever lies in one place. The result depends on the arguments alone.
///
/// # Errors
/// [`Error::Invalid`] for a distance that is none, [`Error::Cancelled`].
pub fn tie_parts(graph: MeshGraph, mesh: &Mesh, options: &TieOptions, exec: &Exec<'_>) -> Result<MeshGraph, Error> {
    Error::check_length("tie distance", options.distance)?;
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
    fn from_anchors(anchors: &[TieAnchor], surface: usize, pool: &Pool) -> Self {
        let both = |a: &TieAnchor| {
            let vertex = a.vertex;
            let edges = a.weighted_corners();
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
    fn tie_row(&self, node: usize) -> &[(u32, f32)] {
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
        let blocks = row_blocks(&offsets, &mut neighbours).into_par_iter();
        let blocks = blocks.zip(row_blocks(&offsets, &mut weights));
        pool.install(|| {
            blocks.for_each(|((range, neighbours), (_, weights))| {
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
fn insert_ties(graph: MeshGraph, anchors: Vec<TieAnchor>, edges: &TieEdges, reach: TieReach, pool: &Pool) -> MeshGraph {
    let row = |node: usize| graph.entries(node as u32);
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
            put(next, graph.weight(entry));
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
fn without_ties(graph: &MeshGraph, ties: &PartTies, edges: &TieEdges, pool: &Pool) -> MeshGraph {
    let row = |node: usize| graph.entries(node as u32);
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
                (*neighbour, *weight) = (to, graph.weight(entry));
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

/// As [`resample`], for a graph with or without ties. Ties of vertices whose surroundings the edit leaves alone stay as they
/// are; those of others are found again. `None` also where an edit brings the first ties into a graph without any.
///
/// `options` are those that the graph was tied with, with the families of the vertices after the edit; `None` for a graph
/// whose parts are never tied.
///
/// # Errors
/// [`Error::Cancelled`].
///
/// # Panics
/// As [`resample`].
pub fn resample_tied(
    old: &MeshGraph,
    positions: &[DVec3],
    change: &MeshChange,
    options: Option<&TieOptions>,
    exec: &Exec<'_>,
) -> Result<Option<ResampledGraph>, Error> {
    let Some(options) = options else {
        return resample(old, positions, change, exec);
    };
    let before = old.ties.as_ref().map(|ties| {
        let edges = TieEdges::from_anchors(&ties.anchors, old.surface, exec.pool);
        let untied = without_ties(old, ties, &edges, exec.pool);
        (ties, edges, untied)
    });
    let untied = before.as_ref().map_or(old, |b| &b.2);
    let Some(resampled) = resample(untied, positions, change, exec)? else {
        return Ok(None);
    };
    if before.is_none() && options.families == TieFamilies::One {
        return Ok(Some(resampled));
    }
    let parts = Components::of_triangles(change.positions.len(), change.triangles);
    let reach = match &before {
        Some((ties, ..)) => ties.reach,
        None => TieReach::from_options(options, &BoundingBox::of(change.positions)),
    };
    let one = match options.family_of_vertex(&parts) {
        Some(_) => Vec::new(),
        None => vec![LOOSE; change.positions.len()],
    };
    let families = options.family_of_vertex(&parts).unwrap_or(&one);
    let old_anchors = before.as_ref().map_or(&[][..], |b| &b.0.anchors);
    let edit = EditedTies {
        change,
        positions,
        families,
        reach,
    };
    let anchors = edit.anchors_after(old_anchors, &resampled, exec)?;
    let Some((_, old_edges, _)) = before else {
        return Ok(anchors.is_empty().then_some(resampled));
    };
    let edges = TieEdges::from_anchors(&anchors, resampled.graph.surface, exec.pool);
    let mut touched = resampled.touched;
    touched.extend(changed_rows(
        &old_edges,
        &edges,
        &resampled.new_from_old,
        change.old_from_new,
    ));
    touched.sort_unstable();
    touched.dedup();
    Ok(Some(ResampledGraph {
        graph: insert_ties(resampled.graph, anchors, &edges, reach, exec.pool),
        touched,
        ..resampled
    }))
}

/// Vertices whose ties are others than before.
fn changed_rows(before: &TieEdges, after: &TieEdges, new_from_old: &[u32], old_from_new: &[u32]) -> Vec<u32> {
    let changed = |&(v, &o): &(u32, &u32)| {
        let now = after.tie_row(v as usize);
        if o == NONE {
            return !now.is_empty();
        }
        let was = before.tie_row(o as usize);
        let same = |(w, n): (&(u32, f32), &(u32, f32))| new_from_old[w.0 as usize] == n.0 && w.1 == n.1;
        was.len() != now.len() || !was.iter().zip(now).all(same)
    };
    (0u32..).zip(old_from_new).filter(changed).map(|c| c.0).collect()
}

/// An edit, and what ties it has to do with.
struct EditedTies<'a> {
    change: &'a MeshChange<'a>,
    /// All nodes before the edit.
    positions: &'a [DVec3],
    /// By vertex after the edit.
    families: &'a [u32],
    reach: TieReach,
}

impl EditedTies<'_> {
    /// All ties after the edit.
    fn anchors_after(
        &self,
        before: &[TieAnchor],
        resampled: &ResampledGraph,
        exec: &Exec<'_>,
    ) -> Result<Vec<TieAnchor>, Error> {
        let mut asked = self.vertices_beside(exec);
        let new = |o: u32| resampled.new_from_old[o as usize];
        let family = |v: u32| self.families[v as usize];
        let mut kept = Vec::with_capacity(before.len());
        for anchor in before {
            let vertex = new(anchor.vertex);
            let corners = anchor.corners.map(new);
            if vertex == NONE || asked[vertex as usize] {
                continue;
            }
            if corners.contains(&NONE) {
                asked[vertex as usize] = true;
            } else if family(vertex) != family(corners[0]) {
                kept.push(TieAnchor {
                    vertex,
                    corners,
                    ..*anchor
                });
            }
        }
        kept.retain(|a| !asked[a.vertex as usize]);
        let asked: Vec<u32> = (0u32..).zip(&asked).filter(|a| *a.1).map(|a| a.0).collect();
        let near = self.triangles_near(&asked);
        let site = TieSite {
            graph: &resampled.graph,
            triangles: &near,
            families: self.families,
            reach: self.reach,
        };
        let mut anchors = find_anchors(&site, &asked, exec)?;
        anchors.extend(kept);
        anchors.sort_by_key(|a| (a.vertex, a.corners));
        Ok(anchors)
    }

    /// By vertex after the edit: whether a face that came, went or moved lies within reach of it.
    fn vertices_beside(&self, exec: &Exec<'_>) -> Vec<bool> {
        let change = self.change;
        let mut corners: Vec<DVec3> = Vec::new();
        let before = |o: u32| self.positions[o as usize];
        let now = |v: u32| change.positions[v as usize];
        corners.extend(change.removed.iter().flatten().map(|&o| before(o)));
        corners.extend(change.added.iter().flat_map(|&t| change.triangles[t as usize]).map(now));
        if !change.moved.is_empty() {
            let mut moved = vec![false; change.positions.len()];
            change.moved.iter().for_each(|&v| moved[v as usize] = true);
            for t in change.triangles.iter().filter(|t| t.iter().any(|&v| moved[v as usize])) {
                corners.extend(t.map(now));
                if t.iter().all(|&v| change.old_from_new[v as usize] != NONE) {
                    corners.extend(t.map(|v| before(change.old_from_new[v as usize])));
                }
            }
        }
        let faces: Vec<[u32; 3]> = (0..corners.len() as u32 / 3)
            .map(|f| [3 * f, 3 * f + 1, 3 * f + 2])
            .collect();
        if faces.is_empty() {
            return vec![false; change.positions.len()];
        }
        let tree = TriangleBvh::build(&corners, &faces, exec.pool);
        let around = widened_box(&BoundingBox::of(&corners), self.reach.most);
        let beside = |p: &DVec3| box_contains(&around, *p) && tree.closest_point_within(*p, self.reach.most).is_some();
        exec.pool
            .install(|| change.positions.par_iter().with_min_len(1024).map(beside).collect())
    }

    /// The triangles that vertices may be tied to.
    fn triangles_near(&self, asked: &[u32]) -> Vec<[u32; 3]> {
        let at = |v: u32| self.change.positions[v as usize];
        let points: Vec<DVec3> = asked.iter().map(|&v| at(v)).collect();
        if points.is_empty() {
            return Vec::new();
        }
        let around = widened_box(&BoundingBox::of(&points), self.reach.most);
        let near = |t: &&[u32; 3]| {
            let own = BoundingBox::of(&t.map(at));
            own.min.cmple(around.max).all() && around.min.cmple(own.max).all()
        };
        self.change.triangles.iter().filter(near).copied().collect()
    }
}

fn widened_box(bounds: &BoundingBox, by: f64) -> BoundingBox {
    BoundingBox {
        min: bounds.min - DVec3::splat(by),
        max: bounds.max + DVec3::splat(by),
    }
}

fn box_contains(bounds: &BoundingBox, p: DVec3) -> bool {
    bounds.min.cmple(p).all() && p.cmple(bounds.max).all()
}
