//! What of two sheets of a surface is near each other: vertices and faces, edges and edges.

use super::find::{Condition, closest_of_segments};
use super::layers::LayerSides;
use super::region::ContactRegion;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::Mesh;
use pliant_mesh::query::TriangleBvh;
use pliant_mesh::query::closest_point::closest_weights_on_triangle;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How far off what is near may be, median edges.
const REACH: f64 = 0.7;
/// What lies beside each other on the surface is not a contact: only what is nearer than so many times its distance in the rest pose,
const CLOSER: f64 = 0.7;
/// and faces face each other, unless they are layers, where the cosine of the angle between their normals is below this.
const FACING: f64 = 0.5;
/// Surfaces keep this part of their distance in the rest pose, where that is less than the clearance.
const REST_PART: f64 = 0.5;
/// Pairs of faces that are looked at,
const MOST_PAIRS: usize = 1 << 21;
/// and conditions that follow from them; where there are more, the surface is a heap.
const MOST_CONDITIONS: usize = 1 << 18;
/// Faces between two looks at whether the work is still wanted.
const BLOCK: usize = 256;

/// Finds what is near in a region.
pub(super) struct NearSearch<'a> {
    mesh: &'a Mesh,
    region: &'a ContactRegion,
    layers: &'a LayerSides,
    /// By face and corner: whether the face stands for the vertex,
    owns_vertex: Vec<[bool; 3]>,
    /// and for the edge to the next corner.
    owns_edge: Vec<[bool; 3]>,
}

impl<'a> NearSearch<'a> {
    pub fn new(mesh: &'a Mesh, region: &'a ContactRegion, layers: &'a LayerSides) -> Self {
        let mut owns_vertex = vec![[false; 3]; mesh.triangles.len()];
        let mut owns_edge = owns_vertex.clone();
        let mut is_owned = vec![false; mesh.positions.len()];
        let mut edges: Vec<([u32; 2], u32, u8)> = Vec::with_capacity(mesh.triangles.len() * 3);
        for (t, corners) in (0u32..).zip(&mesh.triangles) {
            for (k, own) in owns_vertex[t as usize].iter_mut().enumerate() {
                *own = !std::mem::replace(&mut is_owned[corners[k] as usize], true);
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                edges.push(([a.min(b), a.max(b)], t, k as u8));
            }
        }
        edges.sort_unstable();
        for same in edges.chunk_by(|a, b| a.0 == b.0) {
            owns_edge[same[0].1 as usize][same[0].2 as usize] = true;
        }
        Self {
            mesh,
            region,
            layers,
            owns_vertex,
            owns_edge,
        }
    }

    /// Conditions that keep what is near on its side, in a shape in which it is there. `None` where too much is near to be looked at.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn conditions(
        &self,
        at: &[DVec3],
        clearance: f64,
        exec: &Exec<'_>,
    ) -> Result<Option<Vec<Condition>>, Cancelled> {
        let reach = REACH * self.region.edge;
        let Some(pairs) = self.face_pairs(at, reach, exec)? else {
            return Ok(None);
        };
        let count = AtomicUsize::new(0);
        let of_pair = |pair: &[u32; 2]| {
            let mut found = Vec::new();
            if self.may_touch(*pair, at) && count.load(Ordering::Relaxed) <= MOST_CONDITIONS {
                self.add_vertices(*pair, at, &mut found);
                self.add_edges(*pair, at, &mut found);
            }
            found.retain_mut(|condition: &mut Condition| {
                let rest = condition.between(&self.mesh.positions).length();
                condition.least = clearance.min(REST_PART * rest);
                condition.gap > 0.0 && condition.gap < reach.min(CLOSER * rest)
            });
            count.fetch_add(found.len(), Ordering::Relaxed);
            found
        };
        let all = exec.pool.install(|| pairs.par_iter().flat_map_iter(of_pair).collect());
        exec.check()?;
        Ok((count.into_inner() <= MOST_CONDITIONS).then_some(all))
    }

    /// Pairs of faces whose boxes are within `reach` of each other, one of the region at least; ascending.
    fn face_pairs(&self, at: &[DVec3], reach: f64, exec: &Exec<'_>) -> Result<Option<Vec<[u32; 2]>>, Cancelled> {
        let grown = DVec3::splat(reach / 2.0);
        let box_of = |t: u32| {
            let [a, b, c] = self.mesh.triangles[t as usize].map(|v| at[v as usize]);
            [a.min(b).min(c) - grown, a.max(b).max(c) + grown]
        };
        let overlap = |a: &[DVec3; 2], b: &[DVec3; 2]| a[0].cmple(b[1]).all() && b[0].cmple(a[1]).all();
        let own = self.region.faces.iter().map(|t| box_of(*t));
        let all = own.fold([DVec3::MAX, DVec3::MIN], |all, one| {
            [all[0].min(one[0]), all[1].max(one[1])]
        });
        let near: Vec<u32> = (0..self.mesh.triangles.len() as u32)
            .filter(|t| overlap(&box_of(*t), &all))
            .collect();
        let corners: Vec<[u32; 3]> = near.iter().map(|t| self.mesh.triangles[*t as usize]).collect();
        let tree = TriangleBvh::build(at, &corners, exec.pool);
        let order = tree.triangle_order();
        let count = AtomicUsize::new(0);
        let beside = |t: u32| {
            let one = box_of(t);
            let (middle, square) = ((one[0] + one[1]) / 2.0, one[0].distance_squared(one[1]) / 4.0);
            let mut found = Vec::new();
            // The ball around the box, grown by as much as the other one's.
            let mut see = |place: usize, _: &mut f64| {
                let other = near[order[place] as usize];
                let is_first = t < other || !self.region.is_near[other as usize];
                if t != other && is_first && overlap(&one, &box_of(other)) {
                    found.push([t.min(other), t.max(other)]);
                }
            };
            let radius = square.sqrt() + reach;
            tree.visit_near(middle, radius * radius, &mut see);
            count.fetch_add(found.len(), Ordering::Relaxed);
            found
        };
        let of_block = |block: &[u32]| {
            exec.check()?;
            let is_full = count.load(Ordering::Relaxed) > MOST_PAIRS;
            Ok(if is_full {
                Vec::new()
            } else {
                block.iter().flat_map(|t| beside(*t)).collect()
            })
        };
        let blocks = self.region.faces.par_chunks(BLOCK);
        let found: Vec<Vec<[u32; 2]>> = exec
            .pool
            .install(|| blocks.map(of_block).collect::<Result<_, Cancelled>>())?;
        if count.into_inner() > MOST_PAIRS {
            return Ok(None);
        }
        let mut pairs = found.concat();
        pairs.sort_unstable();
        Ok(Some(pairs))
    }

    /// Whether two faces do not have an edge together, may move, and face each other.
    fn may_touch(&self, pair: [u32; 2], at: &[DVec3]) -> bool {
        let [f, g] = pair.map(|t| self.mesh.triangles[t as usize]);
        let normal = |corners: [u32; 3]| {
            let [a, b, c] = corners.map(|v| at[v as usize]);
            (b - a).cross(c - a).normalize_or_zero()
        };
        let is_facing = || normal(f).dot(normal(g)) <= FACING || self.layers.sides(f[0], g[0]).is_some();
        f.iter().filter(|v| g.contains(v)).count() < 2 && self.is_any_free(&[f, g].concat()) && is_facing()
    }

    fn is_any_free(&self, some: &[u32]) -> bool {
        some.iter()
            .any(|v| (self.region.local[*v as usize] as usize) < self.region.free)
    }

    fn add_vertices(&self, pair: [u32; 2], at: &[DVec3], found: &mut Vec<Condition>) {
        for [own, other] in [pair, [pair[1], pair[0]]] {
            let [a, b, c] = self.mesh.triangles[other as usize];
            for (v, owns) in self.mesh.triangles[own as usize]
                .into_iter()
                .zip(self.owns_vertex[own as usize])
            {
                if owns && self.is_any_free(&[v, a, b, c]) {
                    let (w, _) = closest_weights_on_triangle(at[v as usize], [a, b, c].map(|v| at[v as usize]));
                    found.push(apart([(v, 1.0), (a, -w[0]), (b, -w[1]), (c, -w[2])], at));
                }
            }
        }
    }

    fn add_edges(&self, pair: [u32; 2], at: &[DVec3], found: &mut Vec<Condition>) {
        let edges = |t: u32| {
            let c = self.mesh.triangles[t as usize];
            let owned = (0..3).filter(move |k| self.owns_edge[t as usize][*k]);
            owned.map(move |k| [c[k], c[(k + 1) % 3]])
        };
        for p in edges(pair[0]) {
            for q in edges(pair[1]).filter(|q| self.is_any_free(&[p, *q].concat())) {
                let (s, t) = closest_of_segments(p.map(|v| at[v as usize]), q.map(|v| at[v as usize]));
                found.push(apart([(p[0], 1.0 - s), (p[1], s), (q[0], t - 1.0), (q[1], -t)], at));
            }
        }
    }
}

/// The condition that two places stay apart as they are, without a distance yet.
fn apart([a, b, c, d]: [(u32, f64); 4], at: &[DVec3]) -> Condition {
    let mut condition = Condition {
        nodes: [a, b, c, d, (a.0, 0.0), (a.0, 0.0)],
        direction: DVec3::ZERO,
        least: 0.0,
        shift: 0.0,
        gap: 0.0,
    };
    let way = condition.between(at);
    condition.gap = way.length();
    condition.direction = way.normalize_or_zero();
    condition
}
