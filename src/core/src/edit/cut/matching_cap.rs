//! Closing an opening in any shape by the shortest way, alike on both sides of a cut.
//!
//! The cap depends on nothing but the loop, begun at the same point in the same direction from either side; so the caps
//! of two parts fit, and their volumes add up to that of the whole.

use crate::edit::error::Error;
use crate::edit::fill::{OpeningRim, RefineSize, WHOLE_EDGES, refine_faces, split_double_edges, triangulate_loop};
use crate::edit::region_mesh::{CAP, RegionMesh, Wedge};
use crate::mesh::NONE;
use crate::progress::Progress;
use std::collections::BTreeMap;

/// Fills the opening inside `ring`, given in the direction that the new faces run along it. `hard[p]`: caps of primitive
/// `p` do not share vertices with the surface beside them.
pub(super) fn cap_opening_alike(
    mesh: &mut RegionMesh,
    ring: &[u32],
    hard: &[bool],
    progress: &dyn Progress,
) -> Result<(), Error> {
    let n = ring.len();
    let root = |i: usize| mesh.points[ring[i % n] as usize].root;
    let start = (0..n).min_by_key(|&i| root(i)).unwrap_or(0);
    let turned = root(start + n - 1) < root(start + 1);
    let common: Vec<u32> = (0..n)
        .map(|i| ring[if turned { start + n - i } else { start + i } % n])
        .collect();
    let cap = mesh_cap(mesh, &common, progress)?;

    let rim = OpeningRim::from_loops(mesh, &[ring.to_vec()], hard);
    let first = mesh.faces.len();
    let mut point = common.clone();
    point.extend(cap.points[n..].iter().map(|p| mesh.add_point(p.position)));
    let mut wedge: BTreeMap<u32, u32> = BTreeMap::new();
    for face in cap.faces.iter().filter(|f| f.alive) {
        let mut points = face.points.map(|p| point[p as usize]);
        let mut wedges = [0; 3];
        for k in 0..3 {
            let w = cap.wedges[face.wedges[k] as usize];
            let of = |i: usize| rim.wedges.get(&common[w.of[i] as usize]).copied();
            let simple = (face.points[k] as usize) < n;
            let mixed = match (simple, wedge.get(&face.wedges[k])) {
                (true, _) => rim.wedges.get(&points[k]).copied(),
                (false, Some(&w)) => Some(w),
                (false, None) => {
                    let parts: Vec<(u32, f64)> = (0..3)
                        .filter(|&i| w.weights[i] > 0.0)
                        .filter_map(|i| Some((of(i)?, w.weights[i])))
                        .collect();
                    Some(mesh.blend_wedges(&parts))
                }
            };
            let Some(mixed) = mixed else {
                return Ok(());
            };
            wedge.insert(face.wedges[k], mixed);
            wedges[k] = mixed;
        }
        if turned {
            points.swap(1, 2);
            wedges.swap(1, 2);
        }
        mesh.add_face(points, wedges, CAP, rim.primitive);
    }
    split_double_edges(mesh, first);
    split_twin_faces(mesh, first);
    Ok(())
}

/// Makes the cap on its own, with places in the loop `ring` for points and vertices alike.
fn mesh_cap(mesh: &RegionMesh, ring: &[u32], progress: &dyn Progress) -> Result<RegionMesh, Error> {
    let n = ring.len();
    let mut cap = RegionMesh::default();
    let mut sizes: BTreeMap<u32, f64> = BTreeMap::new();
    for i in 0..n {
        let at = |k: usize| mesh.position(ring[k % n]);
        let p = cap.add_point(at(i));
        cap.add_wedge(Wedge {
            vertex: NONE,
            point: NONE,
            of: [p; 3],
            weights: [1.0, 0.0, 0.0],
        });
        let beside = at(i).distance(at(i + 1)) + at(i).distance(at(i + n - 1));
        sizes.insert(p, beside * 0.5 * WHOLE_EDGES);
    }
    let all: Vec<u32> = (0..n as u32).collect();
    match triangulate_loop(&cap, &all, false, progress)? {
        Some(triangles) => triangles.into_iter().for_each(|t| {
            cap.add_face(t, t, CAP, 0);
        }),
        None => {
            let rim = OpeningRim {
                primitive: 0,
                wedges: all.iter().map(|&p| (p, p)).collect(),
                sizes: sizes.clone(),
            };
            rim.fill_with_fan(&mut cap, &all);
        }
    }
    refine_faces(&mut cap, 0, &sizes, RefineSize::for_loop(n), progress)?;
    Ok(cap)
}

/// Splits a new face whose corners are those of an old one.
fn split_twin_faces(mesh: &mut RegionMesh, first: usize) {
    for f in first..mesh.faces.len() {
        let face = mesh.faces[f];
        let [a, b, c] = face.points;
        let twin = |g: u32| (g as usize) < first && mesh.faces[g as usize].corner_of(c).is_some();
        if face.alive && mesh.faces_along(a, b).any(twin) {
            let sum: glam::DVec3 = face.points.iter().map(|&p| mesh.position(p)).sum();
            mesh.split_face(f as u32, [1.0 / 3.0; 3], sum / 3.0);
        }
    }
}
