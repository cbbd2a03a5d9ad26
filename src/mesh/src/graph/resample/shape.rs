//! Follows an edit of a mesh whose interior nodes follow its shape.
//!
//! A local edit leaves the thickness of a part, and so its lattice, about as it was: the lattice stays. Its nodes that are outside
//! now are gone, and so are edges through new faces. New vertices are tied to the nearest of the nodes that the surface there was
//! tied to, as firmly for each unit of area as it was.

use crate::graph::resample::ResampledGraph;
use crate::graph::resample::change::{ChangedPoints, GraphBefore, GraphEdit, MeshChange, NewEdge, NodeNumbers};
use crate::graph::resample::edges;
use crate::graph::resample::rows::write_rows;
use crate::graph::resample::zone::{self, EnclosingFaces, LocalFaces, LocalMesh};
use crate::graph::winding::WindingTree;
use crate::query::TriangleBvh;
use crate::{Adjacency, Components, Error, NONE, signed_volume, sorted_set};
use glam::DVec3;
use pliant_exec::Exec;

/// A part may grow by the room of so many lattice nodes; with more it gets new ones.
const MOST_GROWN: f64 = 4.0;
/// A vertex further from the lattice than this many intervals wants nodes of its own.
const FARTHEST: f64 = 3.5;
/// Pairs of vertices and nodes whose distances are compared, at most.
const MOST_COMPARED: usize = 1 << 24;

/// The graph after an edit; `None` where a new one has to be built.
pub(super) fn resample_shape(
    old: &GraphBefore<'_>,
    change: &MeshChange,
    points: &ChangedPoints,
    exec: &Exec<'_>,
) -> Result<Option<ResampledGraph>, Error> {
    let found = zone::find_local(change, points, None, exec.pool);
    let everywhere = EnclosingFaces {
        before: &|_| true,
        now: &|_| true,
        lost_loops: &[],
        new_loops: &[],
    };
    let between = LocalFaces::between_surfaces(old, change, points, &everywhere, &found);
    let local = LocalMesh::gather_faces(change, points, &found, None, exec.pool);
    exec.check()?;
    // Only what is closed says which nodes are outside now.
    if !Adjacency::build(between.positions.len(), &between.triangles).is_balanced() {
        return Ok(None);
    }
    let edited = EditSite {
        old,
        change,
        points,
        local: &local,
        interval: old.recipe.shape_interval.unwrap_or(0.0),
    };
    let around = SurfaceBefore::of(&edited);
    if around.has_struts(old) {
        return Ok(None);
    }
    let gained = signed_volume(&between.positions, &between.triangles) * around.turn(&edited);
    if gained > MOST_GROWN * 0.5 * edited.interval.powi(3) {
        return Ok(None);
    }
    let lattice = edited.judge_lattice(&around, &between, exec);
    let Some(ties) = edited.find_ties(&around, &lattice.gone) else {
        return Ok(None);
    };
    exec.check()?;
    let Some(nearest) = edited.find_nearest(&lattice.gone) else {
        return Ok(None);
    };
    exec.check()?;
    let numbers = NodeNumbers::from_change(old, change, points);
    let name = |v: u32| numbers.point_number(change, v);
    let copies = edges::without_copies(&local);
    let mut links = copies.find_links(&local, |v| name(local.points[v as usize]), old.recipe.cotangents);
    links.extend(ties.into_iter().map(|(node, v, weight)| NewEdge {
        ends: [node, name(v)],
        weight,
    }));
    links.extend(lattice.links);
    let outer = copies
        .refound_vertices()
        .map(|v| change.old_from_new[local.points[v as usize] as usize]);
    let mut gone = points.gone.clone();
    gone.extend(lattice.gone);
    let graph_edit = GraphEdit {
        old,
        change,
        points,
        numbers: &numbers,
        gone,
        outer: outer.filter(|&o| o != NONE).collect(),
        lattice: lattice.parted,
        untied: Vec::new(),
        links,
        placed: Vec::new(),
        nearest,
    };
    let mut stats = old.stats.clone();
    stats.enclosed_volume = (stats.enclosed_volume + gained).max(0.0);
    let (mut resampled, _) = write_rows(&graph_edit, stats, old.recipe.clone(), exec.pool);
    mark_struts(old, &mut resampled);
    // A piece of the lattice that nothing ties to the surface any more is for a new graph.
    let graph = &resampled.graph;
    let loose = graph.components > 1 && {
        let with_surface = graph.component[..graph.surface]
            .iter()
            .max()
            .map_or(0, |&c| c as usize + 1);
        graph.components > with_surface
    };
    Ok((!loose).then_some(resampled))
}

/// Parts that have struts only have an inside as well.
fn mark_struts(old: &GraphBefore<'_>, resampled: &mut ResampledGraph) {
    if old.stats.struts == 0 {
        return;
    }
    let graph = &mut resampled.graph;
    for (node, &o) in resampled.old_from_new[..graph.surface].iter().enumerate() {
        if o != NONE && old.stats.component_has_volume[old.component[o as usize] as usize] {
            graph.stats.component_has_volume[graph.component[node] as usize] = true;
        }
    }
}

/// An edit of a mesh, and the faces around it.
struct EditSite<'a> {
    old: &'a GraphBefore<'a>,
    change: &'a MeshChange<'a>,
    points: &'a ChangedPoints,
    local: &'a LocalMesh,
    /// Side of the smallest cell.
    interval: f64,
}

/// A vertex as it was before the edit.
struct VertexBefore {
    /// By old number.
    vertex: u32,
    /// A third of the area of its faces.
    area: f64,
    /// The sum of their normals, by area.
    normal: DVec3,
    is_gone: bool,
}

/// The surface that an edit changes as it was: the vertices that are gone, and those whose faces changed.
struct SurfaceBefore {
    /// Rising.
    vertices: Vec<VertexBefore>,
    /// The edges of the mesh from each of them, sorted.
    edges: Vec<[u32; 2]>,
}

impl SurfaceBefore {
    fn of(edited: &EditSite<'_>) -> Self {
        let EditSite {
            old,
            change,
            points,
            local,
            ..
        } = edited;
        let kept = (0u32..).zip(&local.fan_changed).filter(|k| *k.1);
        let kept = kept
            .map(|(v, _)| change.old_from_new[local.points[v as usize] as usize])
            .filter(|&o| o != NONE);
        let mut vertices: Vec<VertexBefore> = (points.gone.iter().map(|&o| (o, true)))
            .chain(kept.map(|o| (o, false)))
            .map(|(vertex, is_gone)| VertexBefore {
                vertex,
                is_gone,
                area: 0.0,
                normal: DVec3::ZERO,
            })
            .collect();
        vertices.sort_unstable_by_key(|v| v.vertex);
        let mut added: Vec<[u32; 3]> = change.added.iter().map(|&t| change.triangles[t as usize]).collect();
        added.sort_unstable();
        let stayed = (local.triangles.iter().map(|t| t.map(|v| local.points[v as usize])))
            .filter(|t| added.binary_search(t).is_err())
            .map(|t| t.map(|v| change.old_from_new[v as usize]))
            .filter(|t| !t.contains(&NONE));
        let mut edges = Vec::new();
        for t in change.removed.iter().copied().chain(stayed) {
            let [a, b, c] = t.map(|o| old.positions[o as usize]);
            let normal = (b - a).cross(c - a);
            for (k, &o) in t.iter().enumerate() {
                if let Ok(at) = vertices.binary_search_by_key(&o, |v| v.vertex) {
                    vertices[at].area += normal.length() / 6.0;
                    vertices[at].normal += normal;
                    edges.extend([[o, t[(k + 1) % 3]], [o, t[(k + 2) % 3]]]);
                }
            }
        }
        Self {
            vertices,
            edges: sorted_set(edges),
        }
    }

    /// Whether any of the vertices has an edge to another one beside those of the mesh.
    fn has_struts(&self, old: &GraphBefore<'_>) -> bool {
        old.stats.struts > 0
            && self.vertices.iter().any(|v| {
                let around = old.row(v.vertex).iter().filter(|&&w| (w as usize) < old.surface);
                around
                    .into_iter()
                    .any(|&w| self.edges.binary_search(&[v.vertex, w]).is_err())
            })
    }

    /// The ties of all of them: the vertex, by index, the lattice node, and the weight.
    fn ties<'a>(&'a self, old: &'a GraphBefore<'_>) -> impl Iterator<Item = (&'a VertexBefore, u32, f64)> + 'a {
        self.vertices.iter().flat_map(move |v| {
            let entries = old
                .entries(v.vertex)
                .filter(|&e| old.neighbours[e] as usize >= old.surface);
            entries.map(move |e| (v, old.neighbours[e], f64::from(old.weight(e))))
        })
    }

    /// 1, or −1 where normals lead inwards, to the lattice.
    fn turn(&self, edited: &EditSite<'_>) -> f64 {
        let old = edited.old;
        let inwards = self.ties(old).map(|(v, node, _)| {
            let way = old.positions[node as usize] - old.positions[v.vertex as usize];
            way.normalize_or_zero().dot(v.normal)
        });
        if inwards.sum::<f64>() > 0.0 { -1.0 } else { 1.0 }
    }
}

/// What an edit does to the lattice.
struct LatticeAfter {
    /// Nodes that are outside now, rising.
    gone: Vec<u32>,
    /// Nodes with an edge through a new face.
    parted: Vec<u32>,
    /// The edges that those are left with.
    links: Vec<NewEdge>,
}

/// A tie of a lattice node to a point, by new number.
type FoundTie = (u32, u32, f32);

impl EditSite<'_> {
    /// Which nodes and edges of the lattice the new surface leaves.
    fn judge_lattice(&self, around: &SurfaceBefore, between: &LocalFaces, exec: &Exec<'_>) -> LatticeAfter {
        let old = self.old;
        let turned = WindingTree::build(&between.positions, &between.triangles, exec.pool);
        let first = sorted_set(around.ties(old).map(|tie| tie.1));
        let (mut seen, mut gone) = (vec![false; old.nodes() - old.surface], Vec::new());
        let mut front = first.clone();
        front.iter().for_each(|&n| seen[n as usize - old.surface] = true);
        let inner = |n: u32| old.row(n).iter().copied().filter(|&m| m as usize >= old.surface);
        while let Some(node) = front.pop() {
            if turned.winding_number(old.positions[node as usize]).abs() <= 0.5 {
                continue;
            }
            gone.push(node);
            let next = inner(node).filter(|&m| !std::mem::replace(&mut seen[m as usize - old.surface], true));
            front.extend(next);
        }
        gone.sort_unstable();
        let is_left = |n: u32| gone.binary_search(&n).is_err();
        // Beside those tied to the place an edge may also be cut between nodes around them.
        let near = sorted_set(first.iter().flat_map(|&n| inner(n).chain([n])).filter(|&n| is_left(n)));
        let mut cut: Vec<[u32; 2]> = Vec::new();
        let at = |v: &u32| self.change.positions[*v as usize];
        let faces: Vec<[u32; 3]> = self
            .change
            .added
            .iter()
            .map(|&t| self.change.triangles[t as usize])
            .collect();
        let corners: Vec<DVec3> = faces.as_flattened().iter().map(at).collect();
        let faces: Vec<[u32; 3]> = (0..faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        if !faces.is_empty() {
            let surface = TriangleBvh::build(&corners, &faces, exec.pool);
            let place = |n: u32| old.positions[n as usize];
            for &n in &near {
                let across = inner(n).filter(|&m| is_left(m) && surface.first_hit(place(n), place(m), None).is_some());
                cut.extend(across.map(|m| [n.min(m), n.max(m)]));
            }
        }
        let cut = sorted_set(cut);
        let parted = sorted_set(cut.as_flattened().iter().copied());
        let mut links = Vec::new();
        for &n in &parted {
            let entries = old.entries(n).filter(|&e| old.neighbours[e] as usize >= old.surface);
            for e in entries {
                let m = old.neighbours[e];
                if is_left(m) && cut.binary_search(&[n.min(m), n.max(m)]).is_err() {
                    links.push(NewEdge {
                        ends: [n, m],
                        weight: old.weight(e),
                    });
                }
            }
        }
        LatticeAfter { gone, parted, links }
    }

    /// The ties of new vertices, and of nodes that would be left without any. `None` where the surface has moved away from the
    /// lattice, or new vertices hang together with no old one.
    fn find_ties(&self, around: &SurfaceBefore, gone: &[u32]) -> Option<Vec<FoundTie>> {
        let (old, change, local) = (self.old, self.change, self.local);
        let is_left = |n: u32| gone.binary_search(&n).is_err();
        let known: Vec<(&VertexBefore, u32, f64)> = around.ties(old).filter(|tie| is_left(tie.1)).collect();
        // By node: the weight of its ties here, and the area that shares it.
        let nodes = sorted_set(known.iter().map(|tie| tie.1));
        let index = |n: u32| nodes.binary_search(&n).unwrap_or(0);
        let mut held = vec![(0.0f64, 0.0f64); nodes.len()];
        let mut lost = vec![0.0f64; nodes.len()];
        for shared in known.chunk_by(|a, b| a.0.vertex == b.0.vertex) {
            for &(v, node, weight) in shared {
                let own = &mut held[index(node)];
                *own = (own.0 + weight, own.1 + v.area / shared.len() as f64);
                lost[index(node)] += if v.is_gone { weight } else { 0.0 };
            }
        }
        let place = |n: u32| old.positions[n as usize];
        let fresh: Vec<u32> = (0..local.points.len() as u32)
            .filter(|&v| change.old_from_new[local.points[v as usize] as usize] == NONE)
            .collect();
        if !self.hangs_together() || fresh.len().saturating_mul(nodes.len()) > MOST_COMPARED {
            return None;
        }
        let within = (FARTHEST * self.interval).powi(2);
        let is_near = |v: &u32, n: u32| place(n).distance_squared(local.positions[*v as usize]) <= within;
        let went_away = |tie: &(&VertexBefore, u32, f64)| {
            let now = self.points.new_from_old[tie.0.vertex as usize];
            now != NONE && self.points.moved[now as usize] && {
                let v = local.find_local(now).unwrap_or(0);
                let before = place(tie.1).distance_squared(place(tie.0.vertex));
                !is_near(&v, tie.1) && place(tie.1).distance_squared(local.positions[v as usize]) > 1.5 * before
            }
        };
        if known.iter().any(went_away) {
            return None;
        }
        let mut ties: Vec<FoundTie> = Vec::new();
        let mut is_met = vec![false; nodes.len()];
        let areas = self.areas();
        for v in &fresh {
            let p = local.positions[*v as usize];
            let way = |n: u32| place(n).distance_squared(p);
            let nearest = nodes.iter().copied().reduce(|a, b| if way(b) < way(a) { b } else { a });
            let Some(node) = nearest else {
                continue;
            };
            if !is_near(v, node) {
                return None;
            }
            let (weight, area) = held[index(node)];
            is_met[index(node)] = true;
            let weight = (weight / area * areas[*v as usize]) as f32;
            // A vertex without area has no tie, as in a new graph.
            ties.extend((weight > 0.0 && weight.is_finite()).then_some((node, local.points[*v as usize], weight)));
        }
        let bare = (0..nodes.len()).filter(|&k| lost[k] > 0.0 && !is_met[k] && !self.keeps_ties(nodes[k]));
        for k in bare {
            let way = |v: &u32| place(nodes[k]).distance_squared(local.positions[*v as usize]);
            let all = 0..local.points.len() as u32;
            let v = all.reduce(|a, b| if way(&b) < way(&a) { b } else { a })?;
            ties.push((nodes[k], local.points[v as usize], lost[k] as f32));
        }
        Some(ties)
    }

    /// Whether a lattice node keeps a tie to a vertex that is left.
    fn keeps_ties(&self, node: u32) -> bool {
        let old = self.old;
        let mut tied = old.row(node).iter().take_while(|&&v| (v as usize) < old.surface);
        tied.any(|&v| self.points.new_from_old[v as usize] != NONE)
    }

    /// Whether all new vertices hang together with old ones.
    fn hangs_together(&self) -> bool {
        let groups = Components::of_triangles(self.local.points.len(), &self.local.triangles);
        let mut has_old = vec![false; groups.count];
        for (v, &group) in groups.of_vertex.iter().enumerate() {
            has_old[group as usize] |= self.change.old_from_new[self.local.points[v] as usize] != NONE;
        }
        !has_old.contains(&false)
    }

    /// A third of the area around each vertex of the local mesh.
    fn areas(&self) -> Vec<f64> {
        let mut areas = vec![0.0; self.local.points.len()];
        for t in &self.local.triangles {
            let [a, b, c] = t.map(|v| self.local.positions[v as usize]);
            let third = (b - a).cross(c - a).length() / 6.0;
            t.iter().for_each(|&v| areas[v as usize] += third);
        }
        areas
    }

    /// The nearest vertex, by new number, of lattice nodes that have lost theirs; `None` where there is too much to compare.
    fn find_nearest(&self, gone: &[u32]) -> Option<Vec<(u32, u32)>> {
        let (old, local) = (self.old, self.local);
        let has_lost = |n: &u32| {
            let vertex = old.nearest_surface[*n as usize];
            self.points.new_from_old[vertex as usize] == NONE && gone.binary_search(n).is_err()
        };
        let asked: Vec<u32> = (old.surface as u32..old.nodes() as u32).filter(has_lost).collect();
        if asked.len().saturating_mul(local.points.len()) > MOST_COMPARED {
            return None;
        }
        let nearest = |n: u32| {
            let way = |v: u32| local.positions[v as usize].distance_squared(old.positions[n as usize]);
            let all = 0..local.points.len() as u32;
            let v = all.reduce(|a, b| if way(b) < way(a) { b } else { a })?;
            Some((n, local.points[v as usize]))
        };
        asked.into_iter().map(nearest).collect()
    }
}
