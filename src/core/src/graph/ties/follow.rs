//! Ties after an edit of the mesh: those around the edit are found again, all others stay.

use crate::exec::Exec;
use crate::graph::error::Error;
use crate::graph::mesh_graph::MeshGraph;
use crate::graph::resample::{MeshChange, ResampledGraph, resample};
use crate::graph::ties::find::{TieSite, find_anchors};
use crate::graph::ties::insert::{TieEdges, insert_ties, without_ties};
use crate::graph::ties::options::{LOOSE, TieFamilies, TieOptions};
use crate::graph::ties::part_ties::{TieAnchor, TieReach};
use crate::mesh::query::TriangleBvh;
use crate::mesh::{BoundingBox, Components, NONE};
use glam::DVec3;
use rayon::prelude::*;

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
