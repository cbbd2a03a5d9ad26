//! Folds found, and patches around them relaxed.

use super::patch::{FaceSurroundings, FoldPatch, FoldedSurface};
use crate::deform::handles::system::HandleSystem;
use crate::mesh::distortion::{is_turned_over, largest_stretch, vertex_gradients};
use crate::mesh::{Mesh, shading};
use crate::pool::Pool;
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use std::sync::OnceLock;

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
fn unfold_vertices(
    mesh: &Mesh,
    surroundings: &OnceLock<FaceSurroundings>,
    held: &[bool],
    now: &mut [DVec3],
    pool: &Pool,
) -> FaceChanges {
    let mut changes = FaceChanges::find(mesh, now, pool);
    let mut folds = changes.folds(mesh, now);
    if folds.is_empty() || folds.len() > mesh.triangles.len() / FEW {
        return changes;
    }
    let surface = FoldedSurface {
        mesh,
        around: surroundings.get_or_init(|| pool.install(|| FaceSurroundings::of(mesh))),
        held,
        overstretched: OVERSTRETCHED,
    };
    let farthest = FARTHEST * mesh.bounds().diagonal();
    for rings in RINGS {
        for patch in surface.patches_around(&folds, rings) {
            if relax_if_better(&surface, &patch, farthest, now) {
                changes.update(&surface, &patch, now);
            }
        }
        folds = changes.folds(mesh, now);
        if folds.is_empty() {
            break;
        }
    }
    changes
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
    /// By triangle: whether it was turned over against what is around it, and how far it is stretched (0 where it has no area).
    faces: Vec<(bool, f64)>,
}

impl FaceChanges {
    /// Looks at every face.
    fn find(mesh: &Mesh, now: &[DVec3], pool: &Pool) -> Self {
        pool.install(|| {
            let gradients = vertex_gradients(mesh, now);
            let cofactors: Vec<DMat3> = gradients.par_iter().map(shading::cofactor).collect();
            let of = |t: &[u32; 3]| face_change(mesh, t, now, t.map(|v| &cofactors[v as usize]));
            let faces = mesh.triangles.par_iter().with_min_len(1024).map(of).collect();
            Self { gradients, faces }
        })
    }

    /// Looks again at the faces of a patch whose vertices have moved.
    fn update(&mut self, surface: &FoldedSurface<'_>, patch: &FoldPatch, now: &[DVec3]) {
        let mesh = surface.mesh;
        let faces = patch.faces().iter();
        let mut corners: Vec<u32> = faces.flat_map(|&t| mesh.triangles[t as usize]).collect();
        corners.sort_unstable();
        corners.dedup();
        for &v in &corners {
            self.gradients[v as usize] = surface.gradient(v, now);
        }
        for &t in patch.faces() {
            let corners = mesh.triangles[t as usize];
            let [a, b, c] = corners.map(|v| shading::cofactor(&self.gradients[v as usize]));
            self.faces[t as usize] = face_change(mesh, &corners, now, [&a, &b, &c]);
        }
    }

    /// Faces that turned over or are stretched beyond measure, rising.
    fn folds(&self, mesh: &Mesh, now: &[DVec3]) -> Vec<u32> {
        let is_moved = |t: u32| {
            mesh.triangles[t as usize]
                .iter()
                .any(|&v| mesh.positions[v as usize] != now[v as usize])
        };
        let bad = (0u32..)
            .zip(&self.faces)
            .filter(|(_, (over, stretch))| *over || *stretch > OVERSTRETCHED);
        bad.map(|(t, _)| t).filter(|&t| is_moved(t)).collect()
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

fn face_change(mesh: &Mesh, corners: &[u32; 3], now: &[DVec3], cofactors: [&DMat3; 3]) -> (bool, f64) {
    let [p, q] = [&mesh.positions[..], now].map(|shape| corners.map(|v| shape[v as usize]));
    (is_turned_over(p, q, cofactors), largest_stretch(p, q).unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::shapes;
    use crate::mesh::Weld;

    fn find_folds(sheet: &Mesh, now: &[DVec3]) -> Vec<u32> {
        let pool = Pool::new(1).expect("a thread");
        FaceChanges::find(sheet, now, &pool).folds(sheet, now)
    }

    /// Unfolds, and checks that the returned face changes match the shape.
    fn unfold(sheet: &Mesh, held: &[bool], now: &mut [DVec3], threads: usize) {
        let pool = Pool::new(threads).expect("threads");
        let told = unfold_vertices(sheet, &OnceLock::new(), held, now, &pool);
        assert_eq!(told, FaceChanges::find(sheet, now, &pool));
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
