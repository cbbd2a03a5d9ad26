//! Triangles of a new patch of surface made as large as those around it (Liepa, "Filling Holes in Meshes", 2003,
//! section 3): a triangle that is too large for its corners gets a point in its middle, then edges are exchanged until
//! opposite angles are no more than half a turn together.

use super::Error;
use super::draft::{CAP, Draft, key};
use crate::progress::Progress;
use std::collections::BTreeMap;

/// How far to refine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Size {
    /// How much larger triangles may become with each point on the way inside.
    pub growth: f64,
    /// At most this many points.
    pub most: usize,
}

impl Size {
    /// For an opening with so many edges around it: even triangles in small ones, growing ones in large ones, whose
    /// number of points would else grow with the square of their rim.
    pub fn of_loop(edges: usize) -> Self {
        Self {
            growth: if edges <= 400 { 1.0 } else { 2.0 },
            most: 40 * edges + 100,
        }
    }
}

/// Edges along a cut are pieces of faces; those of the surface are about so many times longer.
pub(super) const WHOLE_EDGES: f64 = 2.0;

/// Rounds of splitting; each halves the triangles at least, so this many reach any size that numbers can have.
const ROUNDS: usize = 60;

/// Refines the new faces of `draft` from number `first` on. `sizes` says how long edges are at the points of the rim.
/// Answers the new points.
pub(super) fn refine(
    draft: &mut Draft<'_>,
    first: usize,
    sizes: &BTreeMap<u32, f64>,
    size: Size,
    progress: &dyn Progress,
) -> Result<Vec<u32>, Error> {
    let mut target: Vec<f64> = vec![0.0; draft.positions.len()];
    for (&p, &s) in sizes {
        target[p as usize] = s;
    }
    // Points that are there already (the middle of a fan) take the mean of what is around them.
    let inner: Vec<u32> = inner_points(draft, first, sizes);
    let mean = sizes.values().sum::<f64>() / sizes.len().max(1) as f64;
    inner.iter().for_each(|&p| target[p as usize] = mean);
    let mut made = inner;
    relax(draft, first, progress)?;
    for _ in 0..ROUNDS {
        let (before, fresh) = (made.len(), draft.faces.len());
        for f in first..fresh {
            let face = draft.faces[f];
            if !face.alive || face.source != CAP || made.len() >= size.most {
                continue;
            }
            let corners = face.corners.map(|p| draft.positions[p as usize]);
            let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
            let wanted = face.corners.map(|p| target[p as usize]);
            let own = (wanted[0] + wanted[1] + wanted[2]) / 3.0;
            let large = |k: usize| {
                let reach = std::f64::consts::SQRT_2 * middle.distance(corners[k]);
                reach > own && reach > wanted[k]
            };
            if (0..3).all(large) {
                made.push(draft.split_face(f as u32, [1.0 / 3.0; 3], middle));
                target.push(own * size.growth);
            }
        }
        if made.len() == before {
            break;
        }
        // What was not split and not exchanged is as it should be.
        relax(draft, fresh, progress)?;
    }
    Ok(made)
}

/// Points of the new faces that are not on the rim.
fn inner_points(draft: &Draft<'_>, first: usize, sizes: &BTreeMap<u32, f64>) -> Vec<u32> {
    let faces = draft.faces[first..].iter().filter(|f| f.alive);
    let mut inner: Vec<u32> = faces
        .flat_map(|f| f.corners)
        .filter(|p| !sizes.contains_key(p))
        .collect();
    inner.sort_unstable();
    inner.dedup();
    inner
}

/// Exchanges inner edges of the faces from `first` on whose opposite angles are more than half a turn together.
pub(super) fn relax(draft: &mut Draft<'_>, first: usize, progress: &dyn Progress) -> Result<(), Error> {
    let mut queue: Vec<(u32, u32)> = Vec::new();
    for face in draft.faces[first..].iter().filter(|f| f.alive) {
        let [a, b, c] = face.corners;
        queue.extend([key(a, b), key(b, c), key(c, a)]);
    }
    queue.sort_unstable();
    queue.dedup();
    // In a plane the exchanges end by themselves; on a bent patch they might go round.
    let mut budget = 16 * queue.len() + 1024;
    while let Some((a, b)) = queue.pop() {
        let Some(pair) = draft.flippable(a, b) else {
            continue;
        };
        let [p, q] = [pair[0].1, pair[1].1];
        let at = |p: u32| draft.positions[p as usize];
        // The sum of two angles is above half a turn when the sum of their cotangents is negative.
        let cotangent = |apex: u32| {
            let (u, v) = (at(a) - at(apex), at(b) - at(apex));
            u.dot(v) / u.cross(v).length().max(f64::MIN_POSITIVE)
        };
        let score = cotangent(p) + cotangent(q);
        if score >= -1e-9 || score.is_nan() {
            continue;
        }
        // The new faces must face where the old ones did.
        let normal = draft.area_normal(pair[0].0) + draft.area_normal(pair[1].0);
        let face = draft.faces[pair[0].0 as usize];
        let forward = face.corner_of(a).is_some_and(|k| face.corners[(k + 1) % 3] == b);
        let (q2, p2) = if forward { (q, p) } else { (p, q) };
        let area = |a: u32, b: u32, c: u32| (at(b) - at(a)).cross(at(c) - at(a)).dot(normal);
        if !(area(a, q2, p2) > 0.0 && area(b, p2, q2) > 0.0) {
            continue;
        }
        draft.flip(a, b, pair);
        budget = budget.saturating_sub(1);
        if budget == 0 {
            break;
        }
        if budget.is_multiple_of(256) && progress.cancelled() {
            return Err(Error::Cancelled);
        }
        queue.extend([key(a, q), key(q, b), key(b, p), key(p, a)]);
    }
    Ok(())
}
