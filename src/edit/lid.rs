//! Closing an opening in any shape by the shortest way, alike on both sides of a cut.
//!
//! The lid depends on nothing but the loop, begun at the same point in the same direction from either side; so the lids
//! of two parts fit, and their volumes add up to that of the whole.

use super::Error;
use super::cap::{Rim, part_double_edges};
use super::draft::{CAP, Draft, Wedge};
use super::hole::triangulate;
use super::local::Local;
use super::refine::{Size, WHOLE_EDGES, refine};
use crate::mesh::NONE;
use crate::progress::Progress;
use std::collections::BTreeMap;

/// Fills the opening inside `ring`, given in the direction that the new faces run along it. `hard[p]`: lids of primitive
/// `p` do not share vertices with the surface beside them.
pub(super) fn lid(draft: &mut Draft<'_>, ring: &[u32], hard: &[bool], progress: &dyn Progress) -> Result<(), Error> {
    let n = ring.len();
    let root = |i: usize| draft.root[ring[i % n] as usize];
    let start = (0..n).min_by_key(|&i| root(i)).unwrap_or(0);
    let turned = root(start + n - 1) < root(start + 1);
    let common: Vec<u32> = (0..n)
        .map(|i| ring[if turned { start + n - i } else { start + i } % n])
        .collect();

    // The lid is made on its own, with places in the loop for points and vertices alike.
    let mut own = Draft::new(draft.surface, Local::of(draft.surface, Vec::new()));
    let mut sizes: BTreeMap<u32, f64> = BTreeMap::new();
    for i in 0..n {
        let at = |k: usize| draft.positions[common[k % n] as usize];
        let p = own.add_point(at(i));
        own.wedges.push(Wedge {
            vertex: NONE,
            of: [p; 3],
            weights: [1.0, 0.0, 0.0],
        });
        sizes.insert(
            p,
            (at(i).distance(at(i + 1)) + at(i).distance(at(i + n - 1))) * 0.5 * WHOLE_EDGES,
        );
    }
    let all: Vec<u32> = (0..n as u32).collect();
    match triangulate(&own, &all, false, progress)? {
        Some(triangles) => triangles.into_iter().for_each(|t| {
            own.add_face(t, t, CAP, 0);
        }),
        None => {
            let rim = Rim {
                primitive: 0,
                wedges: all.iter().map(|&p| (p, p)).collect(),
                sizes: sizes.clone(),
            };
            rim.fan(&mut own, &all);
        }
    }
    refine(&mut own, 0, &sizes, Size::of_loop(n), progress)?;

    let rim = Rim::of(draft, &[ring.to_vec()], hard);
    let first = draft.faces.len();
    let mut point = common.clone();
    point.extend(own.positions[n..].iter().map(|&x| draft.add_point(x)));
    let mut wedge: BTreeMap<u32, u32> = BTreeMap::new();
    for face in own.faces.iter().filter(|f| f.alive) {
        let mut corners = face.corners.map(|p| point[p as usize]);
        let mut wedges = [0; 3];
        for k in 0..3 {
            let w = own.wedges[face.wedges[k] as usize];
            let of = |i: usize| rim.wedges.get(&common[w.of[i] as usize]).copied();
            let simple = (face.corners[k] as usize) < n;
            let mixed = match (simple, wedge.get(&face.wedges[k])) {
                (true, _) => rim.wedges.get(&corners[k]).copied(),
                (false, Some(&w)) => Some(w),
                (false, None) => {
                    let parts: Vec<(u32, f64)> = (0..3)
                        .filter(|&i| w.weights[i] > 0.0)
                        .filter_map(|i| Some((of(i)?, w.weights[i])))
                        .collect();
                    Some(draft.blend(&parts))
                }
            };
            let Some(mixed) = mixed else {
                return Ok(());
            };
            wedge.insert(face.wedges[k], mixed);
            wedges[k] = mixed;
        }
        if turned {
            corners.swap(1, 2);
            wedges.swap(1, 2);
        }
        draft.add_face(corners, wedges, CAP, rim.primitive);
    }
    part_double_edges(draft, first);
    part_twins(draft, first);
    Ok(())
}

/// Splits a new face whose corners are those of an old one.
fn part_twins(draft: &mut Draft<'_>, first: usize) {
    for f in first..draft.faces.len() {
        let face = draft.faces[f];
        let [a, b, c] = face.corners;
        if face.alive
            && draft
                .along(a, b)
                .any(|g| (g as usize) < first && draft.faces[g as usize].corner_of(c).is_some())
        {
            let sum: glam::DVec3 = face.corners.iter().map(|&p| draft.positions[p as usize]).sum();
            draft.split_face(f as u32, [1.0 / 3.0; 3], sum / 3.0);
        }
    }
}
