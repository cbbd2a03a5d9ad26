//! How far the new surface may come away from the old one, and how far it has.
//!
//! Both ways are looked at wherever a step changes faces. The new edges and the middles of the new faces must lie near the
//! old surface; and each old point and place on an old edge, which always belongs to one of the new faces, must lie near a
//! face that replaces its own.
//!
//! The surface as it was: where new points are put, and what they are made of.

use crate::region_mesh::RegionMesh;
use crate::triangle;
use glam::DVec3;
use pliant_exec::progress::{Progress, check};
use pliant_mesh::query::closest_point::{blend_corners, closest_weights_on_triangle};
use pliant_mesh::{Error, NONE};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// After distances to so many triangles work asks whether it shall go on: some milliseconds.
pub(super) const WORK: usize = 20_000;

/// Three places of an edge see four fifths of the farthest that it is from a surface which it crosses once, and less of one
/// that it crosses more often; this part is counted on.
const SEEN: f64 = 0.55;

/// At an edge with a larger cosine between its faces the surface is flat (about 5°).
const FLAT: f64 = 0.996;

/// Where on an edge its distance is looked at.
const PLACES: [f64; 3] = [0.5, 0.25, 0.75];

/// Faces that a step changes.
#[derive(Debug, Default)]
pub(super) struct ChangedFaces {
    /// The faces that are there before it.
    pub before: Vec<u32>,
    /// Those that are there after it, with their corners.
    pub after: Vec<(u32, [DVec3; 3])>,
    /// The edges that it makes or moves.
    pub edges: Vec<[DVec3; 2]>,
}

/// Places of the old surface, its points and places on its edges, by the new faces that they belong to.
pub(super) struct DeviationBound<'a> {
    /// Asked within steps that compare much: they are refused once the work is cancelled, and the pass ends.
    progress: &'a dyn Progress,
    /// The largest squared distance that may be seen.
    limit: f64,
    points: Vec<DVec3>,
    /// The first place of each face, and the one after each.
    first: Vec<u32>,
    next: Vec<u32>,
    /// Work done since it was last asked for.
    work: usize,
}

impl<'a> DeviationBound<'a> {
    /// Begins with the mesh before any change and the target lengths at its points.
    pub fn new(mesh: &RegionMesh, sizes: &[f64], max_deviation: f64, progress: &'a dyn Progress) -> Self {
        let mut bound = Self {
            progress,
            limit: (SEEN * max_deviation).powi(2),
            points: Vec::new(),
            first: vec![NONE; mesh.faces.len()],
            next: Vec::new(),
            work: 0,
        };
        for point in &mesh.points {
            // What is fixed stays a corner.
            if let Some(&f) = point.faces.first().filter(|_| !point.fixed) {
                bound.add(point.position, f);
            }
        }
        for (a, b) in mesh.edges() {
            let edge = mesh.edge_faces(a, b);
            let [n, m] = [edge.left, edge.right].map(|f| if f == NONE { DVec3::ZERO } else { mesh.area_normal(f) });
            if triangle::cosine(n, m).is_none_or(|c| c < FLAT)
                && let Some(f) = edge.faces().find(|&f| !mesh.faces[f as usize].frozen)
            {
                let long = mesh.edge_length(a, b) > sizes[a as usize].min(sizes[b as usize]);
                for &s in &PLACES[..if long { 3 } else { 1 }] {
                    bound.add(mesh.position(a).lerp(mesh.position(b), s), f);
                }
            }
        }
        bound
    }

    /// Takes the count of triangles that distances were computed to since this was last called.
    pub fn take_work(&mut self, original: &mut OriginalSurface) -> usize {
        std::mem::take(&mut self.work) + original.take_work()
    }

    /// Checks both distances. When they are allowed, the old points belong to the faces after the change from now on.
    pub fn admit(&mut self, original: &mut OriginalSurface, change: &ChangedFaces, seeds: &[u32]) -> bool {
        let middles = change.after.iter().map(|(_, t)| (t[0] + t[1] + t[2]) / 3.0);
        let along = PLACES
            .iter()
            .flat_map(|&s| change.edges.iter().map(move |[a, b]| a.lerp(*b, s)));
        for place in along.chain(middles) {
            if original.squared_distance(place, seeds, self.limit) > self.limit {
                return false;
            }
        }
        let mut moved: Vec<(u32, u32)> = Vec::new();
        let between_checks = WORK / change.after.len().max(1) + 1;
        for &f in &change.before {
            for p in self.points_of(f) {
                if moved.len() % between_checks == between_checks - 1 && self.progress.cancelled() {
                    return false;
                }
                let (square, face) = nearest_of(self.points[p as usize], &change.after);
                if square > self.limit {
                    return false;
                }
                moved.push((p, face));
            }
        }
        self.work += moved.len() * change.after.len();
        change.before.iter().for_each(|&f| self.detach(f));
        moved.into_iter().for_each(|(p, f)| self.attach(p, f));
        true
    }

    /// Gives the old points of changed faces to those after a change that leaves the surface as it is.
    pub fn hand_over(&mut self, change: &ChangedFaces) {
        for &f in &change.before {
            let points: Vec<u32> = self.points_of(f).collect();
            self.detach(f);
            self.work += points.len() * change.after.len();
            for p in points {
                let (_, face) = nearest_of(self.points[p as usize], &change.after);
                self.attach(p, face);
            }
        }
    }

    /// The largest distance between the old surface and the changed faces of the new one, either way; it is seen at places
    /// that may miss a part of it, and the part that they see is taken to be [`SEEN`].
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn measure(
        &self,
        original: &mut OriginalSurface,
        mesh: &RegionMesh,
        seeds: impl Fn(u32) -> Vec<u32>,
        progress: &dyn Progress,
    ) -> Result<f64, Error> {
        let mut largest = 0.0f64;
        let mut done = 0;
        for f in mesh.living_faces() {
            let corners = mesh.corner_positions(f);
            if !mesh.faces[f as usize].untouched {
                let seeds = seeds(f);
                let edges = [[0, 1], [1, 2], [2, 0]];
                let along = edges
                    .iter()
                    .flat_map(|&[i, j]| PLACES.map(|s| corners[i].lerp(corners[j], s)));
                for place in along.chain([(corners[0] + corners[1] + corners[2]) / 3.0]) {
                    // A step was allowed that found the surface nearer from other faces.
                    largest = largest.max(original.squared_distance(place, &seeds, 0.0).min(self.limit));
                }
            }
            for p in self.points_of(f) {
                done += 1;
                largest = largest.max(
                    closest_weights_on_triangle(self.points[p as usize], corners)
                        .1
                        .min(self.limit),
                );
            }
            done += 1 + original.take_work();
            if done >= WORK {
                done = 0;
                check(progress)?;
            }
        }
        Ok(largest.sqrt() / SEEN)
    }

    fn add(&mut self, place: DVec3, f: u32) {
        self.points.push(place);
        self.next.push(NONE);
        self.attach(self.points.len() as u32 - 1, f);
    }

    fn detach(&mut self, f: u32) {
        if let Some(first) = self.first.get_mut(f as usize) {
            *first = NONE;
        }
    }

    fn attach(&mut self, p: u32, f: u32) {
        if self.first.len() <= f as usize {
            self.first.resize(f as usize + 1, NONE);
        }
        self.next[p as usize] = std::mem::replace(&mut self.first[f as usize], p);
    }

    fn points_of(&self, f: u32) -> impl Iterator<Item = u32> {
        let first = self.first.get(f as usize).copied().filter(|&p| p != NONE);
        std::iter::successors(first, |&p| Some(self.next[p as usize]).filter(|&q| q != NONE))
    }
}

/// The nearest of some faces to a place and its squared distance; of equally near ones the first.
fn nearest_of(place: DVec3, faces: &[(u32, [DVec3; 3])]) -> (f64, u32) {
    let mut best = (f64::INFINITY, NONE);
    for (f, corners) in faces {
        let square = closest_weights_on_triangle(place, *corners).1;
        if square < best.0 {
            best = (square, *f);
        }
    }
    best
}

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
