//! Which vertices are tied to which triangles, and how firmly.

use crate::exec::Exec;
use crate::graph::mesh_graph::MeshGraph;
use crate::graph::parallel::map_few;
use crate::graph::ties::options::TieOptions;
use crate::graph::ties::part_ties::{TieAnchor, TieReach};
use crate::graph::ties::part_tree::{NearPlace, PartTree};
use crate::mesh::BoundingBox;
use crate::progress::Cancelled;
use rayon::prelude::*;

/// The shortest and the longest reach that is chosen, as parts of the diagonal.
const REACH: [f64; 2] = [0.005, 0.02];
/// The reach that is chosen, in mean lengths of the edges around.
const REACH_IN_EDGES: f64 = 0.5;
/// What a tie weighs at the end of its reach,
const LIGHTEST: f64 = 1.0;
/// and what it weighs more where parts touch: some three times what all other edges of a vertex weigh together. With more,
/// those would count as weak when the hierarchy is built.
const FIRMNESS: f64 = 47.0;
/// Corners with a smaller share in a place get no edge.
const LEAST_SHARE: f64 = 0.05;
/// Vertices in one piece of work.
const RUN: usize = 1024;

/// The surface that ties are looked for on.
#[derive(Clone, Copy)]
pub(super) struct TieSite<'a> {
    /// The graph without ties. Its first rows have the lengths of edges.
    pub(super) graph: &'a MeshGraph,
    /// Triangles that ties may lead to.
    pub(super) triangles: &'a [[u32; 3]],
    /// The family of each vertex, or [`LOOSE`](super::options::LOOSE).
    pub(super) families: &'a [u32],
    pub(super) reach: TieReach,
}

impl TieReach {
    /// The reach on a mesh within `bounds`.
    pub(super) fn from_options(options: &TieOptions, bounds: &BoundingBox) -> Self {
        let diagonal = bounds.diagonal();
        match options.distance {
            Some(distance) => Self {
                least: distance,
                most: distance,
            },
            None => Self {
                least: REACH[0] * diagonal,
                most: REACH[1] * diagonal,
            },
        }
    }
}

/// Finds what ties the vertices `asked`, which rise, to other parts.
pub(super) fn find_anchors(site: &TieSite, asked: &[u32], exec: &Exec<'_>) -> Result<Vec<TieAnchor>, Cancelled> {
    let surface = &site.graph.positions[..site.graph.surface];
    let tree = PartTree::build_tree(surface, site.triangles, site.families, exec.pool);
    let asked = in_space_order(&tree, asked, surface.len());
    let mut anchors: Vec<TieAnchor> = Vec::new();
    // Some runs at a time, with a look at the progress in between.
    for runs in asked.chunks(64 * RUN) {
        let runs: Vec<&[u32]> = runs.chunks(RUN).collect();
        let found = map_few(&runs, exec, |run| {
            let (mut anchors, mut places) = (Vec::new(), Vec::new());
            for &vertex in *run {
                exec.check()?;
                let reach = reach_of(site, vertex);
                tree.nearest_places(vertex, surface[vertex as usize], reach, &mut places);
                anchors.extend(places.iter().map(|place| anchor_at(site, vertex, place, reach)));
            }
            Ok::<_, Cancelled>(anchors)
        })?;
        found.into_iter().for_each(|found| anchors.extend(found));
    }
    // Those of one vertex lie next to each other and stay in their order.
    exec.pool.install(|| anchors.par_sort_by_key(|a| a.vertex));
    Ok(anchors)
}

/// The vertices `asked` in the order of the tree, so that one search finds in the cache what the last one read; those without
/// triangles last.
fn in_space_order(tree: &PartTree, asked: &[u32], vertices: usize) -> Vec<u32> {
    let mut waiting = vec![false; vertices];
    asked.iter().for_each(|&v| waiting[v as usize] = true);
    let mut order = tree.vertices_in_space_order();
    order.retain(|&v| std::mem::replace(&mut waiting[v as usize], false));
    order.extend(asked.iter().copied().filter(|&v| waiting[v as usize]));
    order
}

/// How far a vertex looks for other parts.
pub(super) fn reach_of(site: &TieSite, vertex: u32) -> f64 {
    let TieReach { least, most } = site.reach;
    if least == most {
        return most;
    }
    let graph = site.graph;
    let at = |v: u32| graph.positions[v as usize];
    let around = graph.row(vertex).iter().take_while(|&&w| (w as usize) < graph.surface);
    let (length, edges) = around.fold((0.0, 0usize), |sum, &w| (sum.0 + at(vertex).distance(at(w)), sum.1 + 1));
    (REACH_IN_EDGES * length / edges.max(1) as f64).clamp(least, most)
}

/// The tie of a vertex to a place.
fn anchor_at(site: &TieSite, vertex: u32, place: &NearPlace, reach: f64) -> TieAnchor {
    let away = if reach > 0.0 {
        (place.square.sqrt() / reach).min(1.0)
    } else {
        0.0
    };
    let weight = LIGHTEST + FIRMNESS * (1.0 - away) * (1.0 - away);
    let shares = place.shares.map(|s| if s < LEAST_SHARE { 0.0 } else { s });
    let sum: f64 = shares.iter().sum();
    TieAnchor {
        vertex,
        corners: site.triangles[place.triangle as usize],
        weights: shares.map(|s| (weight * s / sum) as f32),
    }
}
