//! Folds: faces that a pose turned over, or stretched beyond measure, though nothing forces them to.
//!
//! The two passes weigh all edges alike and know no faces, so where a mesh is coarse, noisy or thin against what happens to it a
//! few faces may turn over. They are looked for when a shape is done, and what is around each is brought to agree with the
//! gradients a few rings around: the edges of the patch ask for what the mean gradient there makes of them, and its rim stays.
//! That is eq. (8) once more, on a patch of the surface alone. A patch that does not come out better is left as it was,
//! and a shape without folds keeps every bit.
//!
//! Patches of a surface around folds, how bad they are, and how they are relaxed.
//!
//! Folds found, and patches around them relaxed.

use crate::fold_suspects::find_suspects;
use crate::handles::system::HandleSystem;
use glam::{DMat3, DVec3};
use pliant_exec::pool::Pool;
use pliant_mesh::local_turns::{is_turned_over, largest_stretch, vertex_gradients};
use pliant_mesh::{Adjacency, Lists, Mesh, shading, sorted_set};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::sync::OnceLock;

/// Sweeps over the vertices of a patch.
const SWEEPS: usize = 100;

/// How often gradients are averaged with those around them, by ring.
const SMOOTHING: usize = 4;

/// A patch has at most so many vertices.
const LARGEST: usize = 20_000;

/// What lies around the vertices of a surface.
#[derive(Debug)]
pub struct FaceSurroundings {
    /// Vertices, once a fold was there.
    neighbours: OnceLock<Lists>,
    /// Triangles.
    faces: Lists,
}

impl FaceSurroundings {
    /// Finds them. Runs on the pool of the caller.
    pub(super) fn of(mesh: &Mesh) -> Self {
        let vertices = mesh.positions.len();
        let corners = || (0u32..).zip(&mesh.triangles).flat_map(|(t, c)| c.map(|v| (v, t)));
        Self {
            neighbours: OnceLock::new(),
            faces: Lists::gather(vertices, corners),
        }
    }

    /// Triangles around a vertex, rising.
    pub(crate) fn faces_of(&self, vertex: u32) -> &[u32] {
        self.faces.of(vertex)
    }

    /// Vertices around each vertex of the mesh. Runs on the pool of the caller.
    fn neighbours(&self, mesh: &Mesh) -> &Lists {
        (self.neighbours).get_or_init(|| Adjacency::build(mesh.positions.len(), &mesh.triangles).neighbours)
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.neighbours.get().map_or(0, Lists::byte_size) + self.faces.byte_size()
    }
}

/// A surface in which faces turned over.
struct FoldedSurface<'a> {
    pub mesh: &'a Mesh,
    /// Triangles around each vertex, and vertices.
    pub faces: &'a Lists,
    pub neighbours: &'a Lists,
    pub held: &'a [bool],
    /// Stretch beyond which a face counts as bad.
    pub overstretched: f64,
}

/// A connected patch.
struct FoldPatch {
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
struct FoldCount {
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
            let around = front.iter().flat_map(|&v| self.neighbours.of(v));
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
                for &w in self.neighbours.of(vertices[next]) {
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
            let mut faces: Vec<u32> = vertices.flat_map(|v| self.faces.of(v)).copied().collect();
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
        let faces = self.faces.of(vertex).iter();
        let of = |&t: &u32| shading::area_gradient(self.corners(&self.mesh.positions, t), self.corners(now, t));
        faces.filter_map(of).fold(DMat3::ZERO, |sum, g| sum + g)
    }

    /// What a shape does to some faces.
    fn changes_of(&self, faces: &[u32], now: &[DVec3]) -> Vec<FaceChange> {
        let corners = sorted_set(faces.iter().flat_map(|&t| self.mesh.triangles[t as usize]));
        let of = |&v: &u32| shading::cofactor(&self.gradient(v, now));
        let cofactors: Vec<DMat3> = corners.iter().map(of).collect();
        let change = |&t: &u32| {
            let own = self.mesh.triangles[t as usize];
            let at = own.map(|v| &cofactors[corners.binary_search(&v).unwrap_or_default()]);
            face_change(self.mesh, &own, now, at)
        };
        faces.iter().map(change).collect()
    }

    /// Counts folds of a patch.
    pub fn badness(&self, patch: &FoldPatch, now: &[DVec3]) -> FoldCount {
        let mut count = FoldCount { bad: 0, stretch: 0.0 };
        for (is_over, stretch) in self.changes_of(&patch.faces, now) {
            count.stretch = count.stretch.max(stretch);
            count.bad += usize::from(is_over || stretch > self.overstretched);
        }
        count
    }

    /// Brings the vertices of a patch to where the gradients around have them.
    pub fn relax(&self, patch: &FoldPatch, now: &mut [DVec3]) {
        let mut nodes: Vec<u32> = patch.vertices.clone();
        nodes.extend(patch.vertices.iter().flat_map(|&v| self.neighbours.of(v)));
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
                let around = self.neighbours.of(v).iter();
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
                for &t in self.faces.of(v) {
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
            .map(|&v| self.neighbours.of(v).iter().filter_map(|&w| number(w)).collect())
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

/// Faces stretched by more than this are brought back where they can be.
const OVERSTRETCHED: f64 = 8.0;

/// How many rings around its faces a patch has, in the order in which sizes are tried.
const RINGS: [usize; 3] = [2, 4, 8];

/// No vertex is moved further than this part of the diagonal.
const FARTHEST: f64 = 0.01;

/// A shape with more folds than one in so many faces is folded on purpose.
const FEW: usize = 16;

/// Brings faces back that turned over or were stretched too far, and returns what the shape does to every face. What
/// handles hold and the rims of patches stay; so does everything where there are no such faces. `positions` are by node,
/// vertices first.
///
/// Costs a pass over the triangles, and work in proportion to what is found.
pub fn unfold_faces(
    mesh: &Mesh,
    surroundings: &OnceLock<FaceSurroundings>,
    handles: &HandleSystem,
    positions: &mut [DVec3],
    pool: &Pool,
) -> FaceChanges {
    let vertices = mesh.positions.len();
    let held = &handles.held_nodes()[..vertices];
    unfold_vertices(mesh, surroundings, held, &mut positions[..vertices], pool)
}

/// The same for vertices alone, of which some are held.
pub fn unfold_vertices(
    mesh: &Mesh,
    surroundings: &OnceLock<FaceSurroundings>,
    held: &[bool],
    now: &mut [DVec3],
    pool: &Pool,
) -> FaceChanges {
    let mut changes = FaceChanges::find(mesh, now, pool);
    if !changes.folds(mesh, now).is_empty() {
        FoldedSurface::of(mesh, surroundings, held, pool).unfold(&mut changes, now);
    }
    changes
}

/// As [`unfold_faces`] for those who do not need what the shape does to every face; positions agree bit for bit.
pub fn unfold_suspects(
    mesh: &Mesh,
    surroundings: &OnceLock<FaceSurroundings>,
    handles: &HandleSystem,
    positions: &mut [DVec3],
    pool: &Pool,
) {
    let vertices = mesh.positions.len();
    let (held, now) = (&handles.held_nodes()[..vertices], &mut positions[..vertices]);
    let suspects = find_suspects(mesh, now, pool);
    if suspects.len() > mesh.triangles.len() / FEW {
        unfold_vertices(mesh, surroundings, held, now, pool);
    } else if !suspects.is_empty() {
        let surface = FoldedSurface::of(mesh, surroundings, held, pool);
        let mut folds = KnownFolds::default();
        folds.look_at(&surface, &suspects, now);
        surface.unfold(&mut folds, now);
    }
}

/// Where folds are.
trait FoldSearch {
    /// Looks again at the faces of a patch whose vertices have moved.
    fn update(&mut self, surface: &FoldedSurface<'_>, patch: &FoldPatch, now: &[DVec3]);

    /// Faces that turned over or are stretched beyond measure, and have moved, rising.
    fn folds(&self, mesh: &Mesh, now: &[DVec3]) -> Vec<u32>;
}

/// Nothing but the folds.
#[derive(Default)]
struct KnownFolds(BTreeSet<u32>);

impl KnownFolds {
    fn look_at(&mut self, surface: &FoldedSurface<'_>, faces: &[u32], now: &[DVec3]) {
        for (&t, change) in faces.iter().zip(surface.changes_of(faces, now)) {
            match is_fold(&change) {
                true => self.0.insert(t),
                false => self.0.remove(&t),
            };
        }
    }
}

impl FoldSearch for KnownFolds {
    fn update(&mut self, surface: &FoldedSurface<'_>, patch: &FoldPatch, now: &[DVec3]) {
        self.look_at(surface, patch.faces(), now);
    }

    fn folds(&self, mesh: &Mesh, now: &[DVec3]) -> Vec<u32> {
        self.0.iter().copied().filter(|&t| is_moved(mesh, t, now)).collect()
    }
}

impl<'a> FoldedSurface<'a> {
    fn of(mesh: &'a Mesh, surroundings: &'a OnceLock<FaceSurroundings>, held: &'a [bool], pool: &Pool) -> Self {
        let (faces, neighbours) = pool.install(|| {
            let around = surroundings.get_or_init(|| FaceSurroundings::of(mesh));
            (&around.faces, around.neighbours(mesh))
        });
        Self {
            mesh,
            faces,
            neighbours,
            held,
            overstretched: OVERSTRETCHED,
        }
    }

    /// Relaxes patches around the folds, larger ones where that was not enough.
    fn unfold(&self, search: &mut impl FoldSearch, now: &mut [DVec3]) {
        let mut folds = search.folds(self.mesh, now);
        if folds.len() > self.mesh.triangles.len() / FEW {
            return;
        }
        let farthest = FARTHEST * self.mesh.bounds().diagonal();
        for rings in RINGS {
            if folds.is_empty() {
                break;
            }
            for patch in self.patches_around(&folds, rings) {
                if relax_if_better(self, &patch, farthest, now) {
                    search.update(self, &patch, now);
                }
            }
            folds = search.folds(self.mesh, now);
        }
    }
}

/// Relaxes a patch; undone when it is not better, or moves further than `farthest`. Whether it was kept.
fn relax_if_better(surface: &FoldedSurface<'_>, patch: &FoldPatch, farthest: f64, now: &mut [DVec3]) -> bool {
    let before: Vec<DVec3> = patch.vertices.iter().map(|&v| now[v as usize]).collect();
    let was = surface.badness(patch, now);
    surface.relax(patch, now);
    let moved = (patch.vertices.iter().zip(&before))
        .map(|(&v, p)| now[v as usize].distance(*p))
        .fold(0.0, f64::max);
    let is_kept = moved <= farthest && surface.badness(patch, now).is_better_than(&was, OVERSTRETCHED);
    if !is_kept {
        for (&v, p) in patch.vertices.iter().zip(before) {
            now[v as usize] = p;
        }
    }
    is_kept
}

/// What a shape does to each face of a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceChanges {
    /// By vertex: the gradient, a sum over its triangles by area.
    gradients: Vec<DMat3>,
    /// By triangle.
    faces: Vec<FaceChange>,
}

/// Whether a triangle was turned over against what is around it, and how far it is stretched (0 where it has no area).
type FaceChange = (bool, f64);

fn is_fold((is_over, stretch): &FaceChange) -> bool {
    *is_over || *stretch > OVERSTRETCHED
}

fn is_moved(mesh: &Mesh, t: u32, now: &[DVec3]) -> bool {
    let mut corners = mesh.triangles[t as usize].iter();
    corners.any(|&v| mesh.positions[v as usize] != now[v as usize])
}

impl FaceChanges {
    /// Looks at every face of a shape, one position per solver vertex.
    pub fn find(mesh: &Mesh, now: &[DVec3], pool: &Pool) -> Self {
        pool.install(|| {
            let gradients = vertex_gradients(mesh, now);
            let cofactors: Vec<DMat3> = gradients.par_iter().map(shading::cofactor).collect();
            let of = |t: &[u32; 3]| face_change(mesh, t, now, t.map(|v| &cofactors[v as usize]));
            let faces = mesh.triangles.par_iter().with_min_len(1024).map(of).collect();
            Self { gradients, faces }
        })
    }

    /// How many faces are turned over against what is around them.
    pub fn turned_over(&self) -> usize {
        self.faces.iter().filter(|f| f.0).count()
    }

    /// The largest stretch of a face; 0 without faces.
    pub fn largest_stretch(&self) -> f64 {
        self.faces.iter().map(|f| f.1).fold(0.0, f64::max)
    }
}

impl FoldSearch for FaceChanges {
    fn update(&mut self, surface: &FoldedSurface<'_>, patch: &FoldPatch, now: &[DVec3]) {
        let mesh = surface.mesh;
        for v in sorted_set(patch.faces().iter().flat_map(|&t| mesh.triangles[t as usize])) {
            self.gradients[v as usize] = surface.gradient(v, now);
        }
        for (&t, change) in patch.faces().iter().zip(surface.changes_of(patch.faces(), now)) {
            self.faces[t as usize] = change;
        }
    }

    fn folds(&self, mesh: &Mesh, now: &[DVec3]) -> Vec<u32> {
        let bad = (0u32..).zip(&self.faces).filter(|(_, change)| is_fold(change));
        bad.map(|(t, _)| t).filter(|&t| is_moved(mesh, t, now)).collect()
    }
}

fn face_change(mesh: &Mesh, corners: &[u32; 3], now: &[DVec3], cofactors: [&DMat3; 3]) -> FaceChange {
    let [p, q] = [&mesh.positions[..], now].map(|shape| corners.map(|v| shape[v as usize]));
    (is_turned_over(p, q, cofactors), largest_stretch(p, q).unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_asset::shapes;
    use pliant_mesh::Weld;

    fn find_folds(sheet: &Mesh, now: &[DVec3]) -> Vec<u32> {
        let pool = Pool::new(1).expect("a thread");
        FaceChanges::find(sheet, now, &pool).folds(sheet, now)
    }

    /// Unfolds, and checks that the returned face changes match the shape.
    fn unfold(sheet: &Mesh, held: &[bool], now: &mut [DVec3], threads: usize) {
        let pool = Pool::new(threads).expect("threads");
        let mut quickly = now.to_vec();
        let suspects = find_suspects(sheet, now, &pool);
        let surroundings = OnceLock::new();
        let surface = FoldedSurface::of(sheet, &surroundings, held, &pool);
        let mut folds = KnownFolds::default();
        folds.look_at(&surface, &suspects, now);
        surface.unfold(&mut folds, &mut quickly);
        let returned = unfold_vertices(sheet, &OnceLock::new(), held, now, &pool);
        assert_eq!(now, quickly);
        assert_eq!(returned, FaceChanges::find(sheet, now, &pool));
    }

    /// A sheet of 100 by 100 cells, and the same with one inner vertex dragged over its neighbours.
    fn folded_sheet() -> (Mesh, Vec<DVec3>, usize) {
        let (positions, triangles) = shapes::grid(1.0, 1.0, [100, 100]);
        let sheet = Mesh::build(&positions, &triangles, Weld::Exact).expect("a sheet");
        let inner = 50 * 101 + 50;
        let mut folded = sheet.positions.clone();
        folded[inner].x += 0.012;
        (sheet, folded, inner)
    }

    #[test]
    fn a_fold_that_nothing_holds_is_brought_back_and_what_is_far_stays_to_the_bit() {
        let (sheet, folded, inner) = folded_sheet();
        assert!(!find_folds(&sheet, &folded).is_empty());
        let mut now = folded.clone();
        unfold(&sheet, &vec![false; sheet.positions.len()], &mut now, 2);
        assert!(find_folds(&sheet, &now).is_empty());
        let far = |v: usize| sheet.positions[v].distance(sheet.positions[inner]) > 0.15;
        assert!((0..now.len()).all(|v| !far(v) || now[v] == folded[v]));
        // The same bits for any number of threads.
        let mut again = folded.clone();
        unfold(&sheet, &vec![false; sheet.positions.len()], &mut again, 1);
        assert_eq!(now, again);
    }

    #[test]
    fn a_fold_that_reaches_further_than_a_hundredth_of_the_diagonal_is_left_alone() {
        let (sheet, mut folded, inner) = folded_sheet();
        folded[inner].x += 0.1;
        let mut now = folded.clone();
        unfold(&sheet, &vec![false; sheet.positions.len()], &mut now, 2);
        assert!(!find_folds(&sheet, &folded).is_empty());
        assert_eq!(now, folded);
    }

    #[test]
    fn what_is_held_stays_and_a_shape_without_folds_keeps_every_bit() {
        let (sheet, folded, inner) = folded_sheet();
        let mut held = vec![false; folded.len()];
        held[inner] = true;
        let mut now = folded.clone();
        unfold(&sheet, &held, &mut now, 1);
        assert_eq!(now[inner], folded[inner]);
        let bent: Vec<DVec3> = sheet
            .positions
            .iter()
            .map(|p| DVec3::new(p.x, p.y, p.z + 0.3 * p.x * p.y))
            .collect();
        let mut now = bent.clone();
        unfold(&sheet, &vec![false; sheet.positions.len()], &mut now, 2);
        assert_eq!(now, bent);
    }
}
