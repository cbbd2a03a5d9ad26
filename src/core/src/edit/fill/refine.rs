//! Triangles of a new patch of surface made as large as those around it (Liepa, "Filling Holes in Meshes", 2003,
//! section 3): a triangle that is too large for its corners gets a point in its middle, then edges are exchanged until
//! opposite angles are no more than half a turn together.

use crate::edit::error::Error;
use crate::edit::region_mesh::{CAP, RegionMesh, edge_key};
use crate::progress::{Progress, check};
use std::collections::BTreeMap;

/// How far to refine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::edit) struct RefineSize {
    /// How much larger triangles may become with each point on the way inside.
    pub growth: f64,
    /// At most this many points.
    pub most: usize,
}

impl RefineSize {
    /// Chooses for an opening with so many edges around it: even triangles in small ones, growing ones in large ones, whose
    /// number of points would else grow with the square of their rim.
    pub fn for_loop(edges: usize) -> Self {
        Self {
            growth: if edges <= 400 { 1.0 } else { 2.0 },
            most: 40 * edges + 100,
        }
    }
}

/// Edges along a cut are pieces of faces; those of the surface are about so many times longer.
pub(in crate::edit) const WHOLE_EDGES: f64 = 2.0;

/// Rounds of splitting; each halves the triangles at least, so this many reach any size that numbers can have.
const ROUNDS: usize = 60;

/// Refines the new faces of `mesh` from number `first` on. `sizes` says how long edges are at the points of the rim.
/// Answers the new points.
pub(in crate::edit) fn refine_faces(
    mesh: &mut RegionMesh,
    first: usize,
    sizes: &BTreeMap<u32, f64>,
    size: RefineSize,
    progress: &dyn Progress,
) -> Result<Vec<u32>, Error> {
    let mut target: Vec<f64> = vec![0.0; mesh.points.len()];
    for (&p, &s) in sizes {
        target[p as usize] = s;
    }
    // Points that are there already (the middle of a fan) take the mean of what is around them.
    let inner: Vec<u32> = inner_points(mesh, first, sizes);
    let mean = sizes.values().sum::<f64>() / sizes.len().max(1) as f64;
    inner.iter().for_each(|&p| target[p as usize] = mean);
    let mut made = inner;
    make_edges_delaunay(mesh, first, progress)?;
    for _ in 0..ROUNDS {
        let (before, fresh) = (made.len(), mesh.faces.len());
        for f in first..fresh {
            let face = mesh.faces[f];
            if !face.alive || face.source != CAP || made.len() >= size.most {
                continue;
            }
            let corners = face.points.map(|p| mesh.position(p));
            let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
            let wanted = face.points.map(|p| target[p as usize]);
            let own = (wanted[0] + wanted[1] + wanted[2]) / 3.0;
            let large = |k: usize| {
                let reach = std::f64::consts::SQRT_2 * middle.distance(corners[k]);
                reach > own && reach > wanted[k]
            };
            if (0..3).all(large) {
                made.push(mesh.split_face(f as u32, [1.0 / 3.0; 3], middle));
                target.push(own * size.growth);
            }
        }
        if made.len() == before {
            break;
        }
        // What was not split and not exchanged is as it should be.
        make_edges_delaunay(mesh, fresh, progress)?;
    }
    Ok(made)
}

/// Points of the new faces that are not on the rim.
fn inner_points(mesh: &RegionMesh, first: usize, sizes: &BTreeMap<u32, f64>) -> Vec<u32> {
    let faces = mesh.faces[first..].iter().filter(|f| f.alive);
    let mut inner: Vec<u32> = faces
        .flat_map(|f| f.points)
        .filter(|p| !sizes.contains_key(p))
        .collect();
    inner.sort_unstable();
    inner.dedup();
    inner
}

/// Exchanges inner edges of the faces from `first` on whose opposite angles are more than half a turn together.
pub(super) fn make_edges_delaunay(mesh: &mut RegionMesh, first: usize, progress: &dyn Progress) -> Result<(), Error> {
    let mut queue = mesh.edges_from(first, |_| true);
    // In a plane the exchanges end by themselves; on a bent patch they might go round.
    let mut budget = 16 * queue.len() + 1024;
    while let Some((a, b)) = queue.pop() {
        let Some(pair) = mesh.flippable_pair(a, b) else {
            continue;
        };
        let [p, q] = [pair[0].1, pair[1].1];
        let at = |p: u32| mesh.position(p);
        // The sum of two angles is above half a turn when the sum of their cotangents is negative.
        let cotangent = |apex: u32| {
            let (u, v) = (at(a) - at(apex), at(b) - at(apex));
            u.dot(v) / u.cross(v).length().max(f64::MIN_POSITIVE)
        };
        let score = cotangent(p) + cotangent(q);
        if score >= -1e-9 || score.is_nan() {
            continue;
        }
        if !mesh.flip_keeps_sides(a, b, pair) {
            continue;
        }
        mesh.flip_edge(a, b, pair);
        budget = budget.saturating_sub(1);
        if budget == 0 {
            break;
        }
        if budget.is_multiple_of(256) {
            check(progress)?;
        }
        queue.extend([edge_key(a, q), edge_key(q, b), edge_key(b, p), edge_key(p, a)]);
    }
    Ok(())
}
