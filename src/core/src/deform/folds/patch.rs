//! Patches of a surface around folds, how bad they are, and how they are relaxed.

use crate::mesh::distortion::{is_turned_over, largest_stretch};
use crate::mesh::{Adjacency, Lists, Mesh, shading};
use glam::{DMat3, DVec3};

/// Sweeps over the vertices of a patch.
const SWEEPS: usize = 100;

/// How often gradients are averaged with those around them, by ring.
const SMOOTHING: usize = 4;

/// A patch has at most so many vertices.
const LARGEST: usize = 20_000;

/// What lies around the vertices of a surface.
#[derive(Debug)]
pub struct FaceSurroundings {
    /// Vertices.
    adjacency: Adjacency,
    /// Triangles.
    faces: Lists,
}

impl FaceSurroundings {
    /// Finds them. Runs on the pool of the caller.
    pub(super) fn of(mesh: &Mesh) -> Self {
        let vertices = mesh.positions.len();
        let corners = || (0u32..).zip(&mesh.triangles).flat_map(|(t, c)| c.map(|v| (v, t)));
        Self {
            adjacency: Adjacency::build(vertices, &mesh.triangles),
            faces: Lists::gather(vertices, corners),
        }
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.adjacency.byte_size() + self.faces.byte_size()
    }
}

/// A surface in which faces turned over.
pub(super) struct FoldedSurface<'a> {
    pub mesh: &'a Mesh,
    pub around: &'a FaceSurroundings,
    pub held: &'a [bool],
    /// Stretch beyond which a face counts as bad.
    pub overstretched: f64,
}

/// A connected patch.
pub(super) struct FoldPatch {
    /// Vertices that may move, rising.
    pub vertices: Vec<u32>,
    /// Triangles that have a say in how bad it is, rising.
    faces: Vec<u32>,
    rings: usize,
}

impl FoldPatch {
    /// Triangles that have a say in how bad it is, rising: all that its vertices, or those around them, are corners of.
    pub fn faces(&self) -> &[u32] {
        &self.faces
    }
}

/// How bad a patch is.
#[derive(Debug, Clone, Copy)]
pub(super) struct FoldCount {
    bad: usize,
    stretch: f64,
}

impl FoldCount {
    /// Fewer folds without more stretch than is allowed, or as many and less stretch.
    pub fn is_better_than(&self, other: &Self, allowed: f64) -> bool {
        let is_allowed = self.stretch <= other.stretch.max(allowed);
        (self.bad < other.bad && is_allowed) || (self.bad == other.bad && self.stretch < 0.95 * other.stretch)
    }
}

impl FoldedSurface<'_> {
    /// Connected patches of so many rings around faces, none of them too large.
    pub fn patches_around(&self, folds: &[u32], rings: usize) -> Vec<FoldPatch> {
        let mut is_in = vec![false; self.mesh.positions.len()];
        let corners = folds.iter().flat_map(|&t| self.mesh.triangles[t as usize]);
        let mut front: Vec<u32> = corners.collect();
        let mut all = Vec::new();
        for _ring in 0..=rings {
            front.retain(|&v| !std::mem::replace(&mut is_in[v as usize], true));
            all.extend_from_slice(&front);
            let around = front.iter().flat_map(|&v| self.around.adjacency.neighbours.of(v));
            front = around.copied().collect();
        }
        all.iter()
            .filter(|v| self.held[**v as usize])
            .for_each(|&v| is_in[v as usize] = false);
        all.sort_unstable();
        let mut patches = Vec::new();
        for first in all {
            if !is_in[first as usize] {
                continue;
            }
            is_in[first as usize] = false;
            let (mut vertices, mut next) = (vec![first], 0);
            while next < vertices.len() {
                for &w in self.around.adjacency.neighbours.of(vertices[next]) {
                    if std::mem::take(&mut is_in[w as usize]) {
                        vertices.push(w);
                    }
                }
                next += 1;
            }
            if vertices.len() <= LARGEST {
                vertices.sort_unstable();
                let faces = self.faces_with(&vertices);
                patches.push(FoldPatch { vertices, faces, rings });
            }
        }
        patches
    }

    /// Faces that have a vertex or touch one that does, rising.
    fn faces_with(&self, vertices: &[u32]) -> Vec<u32> {
        let around = |vertices: &mut dyn Iterator<Item = u32>| {
            let mut faces: Vec<u32> = vertices.flat_map(|v| self.around.faces.of(v)).copied().collect();
            faces.sort_unstable();
            faces.dedup();
            faces
        };
        let own = around(&mut vertices.iter().copied());
        let mut corners: Vec<u32> = own.iter().flat_map(|&t| self.mesh.triangles[t as usize]).collect();
        corners.sort_unstable();
        corners.dedup();
        around(&mut corners.into_iter())
    }

    fn corners(&self, shape: &[DVec3], t: u32) -> [DVec3; 3] {
        self.mesh.triangles[t as usize].map(|v| shape[v as usize])
    }

    /// The gradient at a vertex: a sum over its triangles by area.
    pub fn gradient(&self, vertex: u32, now: &[DVec3]) -> DMat3 {
        let faces = self.around.faces.of(vertex).iter();
        let of = |&t: &u32| shading::area_gradient(self.corners(&self.mesh.positions, t), self.corners(now, t));
        faces.filter_map(of).fold(DMat3::ZERO, |sum, g| sum + g)
    }

    /// Counts folds of a patch.
    pub fn badness(&self, patch: &FoldPatch, now: &[DVec3]) -> FoldCount {
        let faces = patch.faces.iter();
        let mut corners: Vec<u32> = faces.flat_map(|&t| self.mesh.triangles[t as usize]).collect();
        corners.sort_unstable();
        corners.dedup();
        let of = |&v: &u32| shading::cofactor(&self.gradient(v, now));
        let cofactors: Vec<DMat3> = corners.iter().map(of).collect();
        let mut count = FoldCount { bad: 0, stretch: 0.0 };
        for &t in &patch.faces {
            let [p, q] = [&self.mesh.positions[..], now].map(|shape| self.corners(shape, t));
            let own = self.mesh.triangles[t as usize].map(|v| {
                let at = corners.binary_search(&v).unwrap_or_default();
                &cofactors[at]
            });
            let stretch = largest_stretch(p, q).unwrap_or(0.0);
            count.stretch = count.stretch.max(stretch);
            count.bad += usize::from(is_turned_over(p, q, own) || stretch > self.overstretched);
        }
        count
    }

    /// Brings the vertices of a patch to where the gradients around have them.
    pub fn relax(&self, patch: &FoldPatch, now: &mut [DVec3]) {
        let mut nodes: Vec<u32> = patch.vertices.clone();
        nodes.extend(
            patch
                .vertices
                .iter()
                .flat_map(|&v| self.around.adjacency.neighbours.of(v)),
        );
        nodes.sort_unstable();
        nodes.dedup();
        let gradients = self.smooth_gradients(&nodes, patch.rings * SMOOTHING, now);
        let rest = &self.mesh.positions;
        let at = |v: u32| gradients[nodes.binary_search(&v).unwrap_or_default()];
        let rows: Vec<Vec<(u32, f64, DVec3)>> = patch
            .vertices
            .iter()
            .map(|&v| {
                let own = at(v);
                let around = self.around.adjacency.neighbours.of(v).iter();
                let edge = |&w: &u32| {
                    let edge = rest[v as usize] - rest[w as usize];
                    let asked = (own + at(w)) * edge * 0.5;
                    (w, 1.0 / edge.length_squared().max(f64::MIN_POSITIVE), asked)
                };
                around.map(edge).collect()
            })
            .collect();
        for sweep in 0..SWEEPS {
            let mut step = |k: usize| {
                let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
                for &(w, weight, asked) in &rows[k] {
                    sum += (now[w as usize] + asked) * weight;
                    weights += weight;
                }
                let place = sum / weights;
                if place.is_finite() {
                    now[patch.vertices[k] as usize] = place;
                }
            };
            match sweep % 2 {
                0 => (0..rows.len()).for_each(&mut step),
                _ => (0..rows.len()).rev().for_each(&mut step),
            }
        }
    }

    /// Gradients at `nodes` (rising), averaged with those around. What is bad has no say.
    fn smooth_gradients(&self, nodes: &[u32], times: usize, now: &[DVec3]) -> Vec<DMat3> {
        let number = |v: u32| nodes.binary_search(&v).ok();
        let mut sums: Vec<(DMat3, f64)> = nodes
            .iter()
            .map(|&v| {
                let cofactor = shading::cofactor(&self.gradient(v, now));
                let (mut sum, mut areas) = (DMat3::ZERO, 0.0);
                for &t in self.around.faces.of(v) {
                    let [p, q] = [&self.mesh.positions[..], now].map(|shape| self.corners(shape, t));
                    let is_bad = is_turned_over(p, q, [&cofactor; 3])
                        || largest_stretch(p, q).is_none_or(|s| s > self.overstretched / 4.0);
                    if let Some(gradient) = shading::area_gradient(p, q).filter(|_| !is_bad) {
                        sum += gradient;
                        areas += (p[1] - p[0]).cross(p[2] - p[0]).length();
                    }
                }
                (sum, areas)
            })
            .collect();
        let around: Vec<Vec<usize>> = nodes
            .iter()
            .map(|&v| {
                self.around
                    .adjacency
                    .neighbours
                    .of(v)
                    .iter()
                    .filter_map(|&w| number(w))
                    .collect()
            })
            .collect();
        for _time in 0..times {
            let averaged = |(k, own): (usize, &(DMat3, f64))| {
                let others = around[k].iter().map(|&j| sums[j]);
                let share = 1.0 / (around[k].len() + 1) as f64;
                let sum = others.fold(*own, |a, b| (a.0 + b.0, a.1 + b.1));
                (sum.0 * share, sum.1 * share)
            };
            sums = sums.iter().enumerate().map(averaged).collect();
        }
        let mean = |(sum, areas): (DMat3, f64)| {
            if areas > 0.0 {
                sum * (1.0 / areas)
            } else {
                DMat3::IDENTITY
            }
        };
        sums.into_iter().map(mean).collect()
    }
}
