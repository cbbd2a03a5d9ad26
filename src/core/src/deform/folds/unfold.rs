//! Folds found, and patches around them relaxed.

use super::patch::{FoldPatch, FoldedSurface};
use crate::deform::handles::system::HandleSystem;
use crate::mesh::distortion::{is_turned_over, largest_stretch, vertex_gradients};
use crate::mesh::{Adjacency, Lists, Mesh, shading};
use crate::pool::Pool;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Faces stretched by more than this are brought back where they can be.
const OVERSTRETCHED: f64 = 8.0;

/// How many rings around its faces a patch has, in the order in which sizes are tried.
const RINGS: [usize; 3] = [2, 4, 8];

/// No vertex is moved further than this part of the diagonal.
const FARTHEST: f64 = 0.01;

/// A shape with more folds than one in so many faces is one that was asked for.
const FEW: usize = 16;

/// Brings faces back that turned over or were stretched beyond measure. What handles hold and
/// the rims of patches stay; so does everything where there are no such faces. `positions` are by node, vertices first.
///
/// Costs a pass over the triangles, and work in proportion to what is found.
pub fn unfold_faces(mesh: &Mesh, handles: &HandleSystem, positions: &mut [DVec3], pool: &Pool) {
    let vertices = mesh.positions.len();
    unfold_vertices(
        mesh,
        &handles.held_nodes()[..vertices],
        &mut positions[..vertices],
        pool,
    );
}

/// The same for vertices alone, of which some are held.
fn unfold_vertices(mesh: &Mesh, held: &[bool], now: &mut [DVec3], pool: &Pool) {
    let vertices = mesh.positions.len();
    let mut folds = pool.install(|| find_folds(mesh, now));
    if folds.is_empty() || folds.len() > mesh.triangles.len() / FEW {
        return;
    }
    let corners = || (0u32..).zip(&mesh.triangles).flat_map(|(t, c)| c.map(|v| (v, t)));
    let surface = FoldedSurface {
        mesh,
        adjacency: pool.install(|| Adjacency::build(vertices, &mesh.triangles)),
        faces: Lists::gather(vertices, corners),
        held,
        overstretched: OVERSTRETCHED,
    };
    let farthest = FARTHEST * mesh.bounds().diagonal();
    for rings in RINGS {
        for patch in surface.patches_around(&folds, rings) {
            relax_if_better(&surface, &patch, farthest, now);
        }
        folds = pool.install(|| find_folds(mesh, now));
        if folds.is_empty() {
            return;
        }
    }
}

/// Relaxes a patch; undone when it is no better, or moves further than `farthest`.
fn relax_if_better(surface: &FoldedSurface<'_>, patch: &FoldPatch, farthest: f64, now: &mut [DVec3]) {
    let before: Vec<DVec3> = patch.vertices.iter().map(|&v| now[v as usize]).collect();
    let was = surface.badness(patch, now);
    surface.relax(patch, now);
    let moved = (patch.vertices.iter().zip(&before))
        .map(|(&v, p)| now[v as usize].distance(*p))
        .fold(0.0, f64::max);
    let is_near = moved <= farthest;
    if !(is_near && surface.badness(patch, now).is_better_than(&was, OVERSTRETCHED)) {
        for (&v, p) in patch.vertices.iter().zip(before) {
            now[v as usize] = p;
        }
    }
}

/// Faces that turned over or are stretched beyond measure. Runs on the pool of the caller.
fn find_folds(mesh: &Mesh, now: &[DVec3]) -> Vec<u32> {
    let gradients = vertex_gradients(mesh, now);
    let cofactors: Vec<DMat3> = gradients.par_iter().map(shading::cofactor).collect();
    let is_fold = |t: &[u32; 3]| {
        let [p, q] = [&mesh.positions[..], now].map(|shape| t.map(|v| shape[v as usize]));
        p != q
            && (is_turned_over(p, q, t.map(|v| &cofactors[v as usize]))
                || largest_stretch(p, q).is_some_and(|s| s > OVERSTRETCHED))
    };
    let faces = mesh.triangles.par_iter().enumerate();
    faces.filter(|(_, t)| is_fold(t)).map(|(k, _)| k as u32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::shapes;
    use crate::mesh::Weld;

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
        let pool = Pool::new(2).expect("threads");
        assert!(!find_folds(&sheet, &folded).is_empty());
        let mut now = folded.clone();
        unfold_vertices(&sheet, &vec![false; now.len()], &mut now, &pool);
        assert!(find_folds(&sheet, &now).is_empty());
        let far = |v: usize| sheet.positions[v].distance(sheet.positions[inner]) > 0.15;
        assert!((0..now.len()).all(|v| !far(v) || now[v] == folded[v]));
        // The same bits for any number of threads.
        let mut again = folded.clone();
        let one = Pool::new(1).expect("a thread");
        unfold_vertices(&sheet, &vec![false; again.len()], &mut again, &one);
        assert_eq!(now, again);
    }

    #[test]
    fn a_fold_that_reaches_further_than_a_hundredth_of_the_diagonal_is_left_alone() {
        let (sheet, mut folded, inner) = folded_sheet();
        folded[inner].x += 0.1;
        let mut now = folded.clone();
        let pool = Pool::new(1).expect("a thread");
        unfold_vertices(&sheet, &vec![false; now.len()], &mut now, &pool);
        assert!(!find_folds(&sheet, &folded).is_empty());
        assert_eq!(now, folded);
    }

    #[test]
    fn what_is_held_stays_and_a_shape_without_folds_keeps_every_bit() {
        let (sheet, folded, inner) = folded_sheet();
        let pool = Pool::new(1).expect("a thread");
        let mut held = vec![false; folded.len()];
        held[inner] = true;
        let mut now = folded.clone();
        unfold_vertices(&sheet, &held, &mut now, &pool);
        assert_eq!(now[inner], folded[inner]);
        let bent: Vec<DVec3> = sheet
            .positions
            .iter()
            .map(|p| DVec3::new(p.x, p.y, p.z + 0.3 * p.x * p.y))
            .collect();
        let mut now = bent.clone();
        unfold_vertices(&sheet, &vec![false; now.len()], &mut now, &pool);
        assert_eq!(now, bent);
    }
}
