//! The surface as it was: where new points are put, and what they are made of.

use crate::edit::region_mesh::RegionMesh;
use crate::edit::triangle;
use crate::mesh::NONE;
use crate::mesh::query::closest_point::{blend_corners, closest_weights_on_triangle};
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// After so many faces that are no nearer the search for the nearest one ends.
const STALL: u32 = 10;

/// The normal of a face with a larger aspect says little about the surface: its neighbours' counts.
pub(super) const SLIVER: f64 = 20.0;

/// Most faces that one search looks at.
const LONGEST_SEARCH: u32 = 5000;

/// A face of the original surface and weights of its corners.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct OriginalPoint {
    pub face: u32,
    pub weights: [f64; 3],
}

/// The gathered faces before any change, by their numbers in the editable mesh.
pub(super) struct OriginalSurface {
    corners: Vec<[DVec3; 3]>,
    /// Unit normals; that of its neighbours for a sliver, zero where those have none.
    normals: Vec<DVec3>,
    /// Render vertices at the corners.
    vertices: Vec<[u32; 3]>,
    points: Vec<[u32; 3]>,
    /// The face beyond each side, from a corner to the next; [`NONE`] where a curve or the rim lies between.
    beyond: Vec<[u32; 3]>,
    /// Target length at each point.
    sizes: Vec<f64>,
    seen: Vec<u32>,
    search: u32,
    /// Faces that searches looked at since this was last asked for.
    looked_at: usize,
}

impl OriginalSurface {
    /// Copies the faces. `crosses` says whether an edge may be crossed: that no curve lies on it.
    pub fn from_mesh(mesh: &RegionMesh, sizes: Vec<f64>, crosses: impl Fn(u32, u32) -> bool) -> Self {
        let count = mesh.faces.len() as u32;
        let beyond = (0..count).map(|f| {
            let p = mesh.points_of(f);
            [0, 1, 2].map(|i| {
                let (a, b) = (p[i], p[(i + 1) % 3]);
                let edge = mesh.edge_faces(a, b);
                if mesh.is_inside(edge, a, b) && crosses(a, b) {
                    edge.right
                } else {
                    NONE
                }
            })
        });
        let normal = |f| {
            let own = mesh.area_normal(f);
            if !is_sliver(mesh, f) {
                return own.normalize_or_zero();
            }
            let p = mesh.points_of(f);
            let beside = (0..3).flat_map(|i| mesh.edge_faces(p[i], p[(i + 1) % 3]).other_face(f));
            beside.map(|g| mesh.area_normal(g)).sum::<DVec3>().normalize_or_zero()
        };
        Self {
            corners: (0..count).map(|f| mesh.corner_positions(f)).collect(),
            normals: (0..count).map(normal).collect(),
            vertices: (mesh.faces.iter())
                .map(|f| f.wedges.map(|w| mesh.wedges[w as usize].vertex))
                .collect(),
            points: (0..count).map(|f| mesh.points_of(f)).collect(),
            beyond: beyond.collect(),
            sizes,
            seen: vec![0; count as usize],
            search: 0,
            looked_at: 0,
        }
    }

    /// Where corner `p` of face `f` is.
    pub fn corner_point(&self, f: u32, p: u32) -> OriginalPoint {
        let weights = self.points[f as usize].map(|q| if q == p { 1.0 } else { 0.0 });
        OriginalPoint { face: f, weights }
    }

    /// Unit normal of the surface at face `f`; zero where it has none.
    pub fn face_normal(&self, f: u32) -> DVec3 {
        self.normals[f as usize]
    }

    /// The place of a spot.
    pub fn position_at(&self, spot: OriginalPoint) -> DVec3 {
        blend_corners(self.corners[spot.face as usize], spot.weights)
    }

    /// Render vertices and weights that a spot is made of.
    pub fn blend_at(&self, spot: OriginalPoint) -> ([u32; 3], [f64; 3]) {
        (self.vertices[spot.face as usize], spot.weights)
    }

    /// The target length at a spot.
    pub fn target_length_at(&self, spot: OriginalPoint) -> f64 {
        let sizes = self.points[spot.face as usize].map(|p| self.sizes[p as usize]);
        (0..3).map(|i| sizes[i] * spot.weights[i]).sum()
    }

    /// Takes the count of faces that searches looked at since this was last called.
    pub fn take_work(&mut self) -> usize {
        std::mem::take(&mut self.looked_at)
    }

    /// The nearest spot to `p` that is found by walking from `seeds` over faces, nearest first, never across a curve.
    pub fn find_nearest(&mut self, p: DVec3, seeds: &[u32]) -> OriginalPoint {
        self.search(p, seeds, 0.0).1
    }

    /// The squared distance of the spot that the same search finds, or of the first that is not farther than `near`.
    pub fn squared_distance(&mut self, p: DVec3, seeds: &[u32], near: f64) -> f64 {
        self.search(p, seeds, near).0
    }

    fn search(&mut self, p: DVec3, seeds: &[u32], near: f64) -> (f64, OriginalPoint) {
        self.search += 1;
        let mut queue: BinaryHeap<Reverse<(u64, u32)>> = BinaryHeap::new();
        let mut best = (
            f64::INFINITY,
            OriginalPoint {
                face: seeds.first().copied().unwrap_or(0),
                weights: [1.0 / 3.0; 3],
            },
        );
        let mut stalled = 0;
        let look = |this: &mut Self, f: u32, queue: &mut BinaryHeap<_>, best: &mut (f64, OriginalPoint)| {
            if std::mem::replace(&mut this.seen[f as usize], this.search) == this.search {
                return false;
            }
            this.looked_at += 1;
            let (weights, distance) = closest_weights_on_triangle(p, this.corners[f as usize]);
            queue.push(Reverse((distance.to_bits(), f)));
            let better = distance < best.0;
            if better {
                *best = (distance, OriginalPoint { face: f, weights });
            }
            better
        };
        for &f in seeds {
            look(self, f, &mut queue, &mut best);
            if best.0 <= near {
                return best;
            }
        }
        for _ in 0..LONGEST_SEARCH {
            if best.0 <= near {
                break;
            }
            let Some(Reverse((_, f))) = queue.pop() else { break };
            let mut better = false;
            for g in self.beyond[f as usize] {
                if g != NONE {
                    better |= look(self, g, &mut queue, &mut best);
                }
            }
            stalled = if better { 0 } else { stalled + 1 };
            if stalled == STALL {
                break;
            }
        }
        best
    }
}

/// Whether face `f` is so thin that its normal says little.
pub(super) fn is_sliver(mesh: &RegionMesh, f: u32) -> bool {
    triangle::aspect(mesh.corner_positions(f)) > SLIVER
}
