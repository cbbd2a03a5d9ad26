//! Filling holes whose boundaries are nearly flat by flat caps of their own.

use super::cut::cap_flat_openings;
use super::fill::{CapLook, fill_loop, gather_holes};
use super::patch::{EditWarning, SurfacePatch};
use super::region_mesh::RegionMesh;
use super::surface::SurfaceView;
use glam::DVec3;
use pliant_exec::progress::Progress;
use pliant_mesh::Error;
use std::collections::BTreeSet;

/// A boundary is flat when none of its points is farther from its plane than this part of its radius.
const FLAT: f64 = 0.1;

/// Planes are one when their normals make a smaller angle than that with this cosine (about 2°).
const PARALLEL: f64 = 0.9994;

/// Fills the holes whose boundary touches a point of the triangles `region`, or all holes, by flat caps: triangles between the
/// points of the boundary and in the plane between them. A hole inside another one in the same plane stays a hole of its cap. Caps
/// belong to primitives of their own: that of a hole in primitive p is number `own` + p. A hole whose boundary is not flat is filled as
/// by [`fill_holes`](crate::fill_holes), with the warning `cap-curved`.
///
/// # Errors
/// [`Error::Impossible`] when there is no such hole, [`Error::TooLarge`] for one with too long a boundary,
/// [`Error::Cancelled`].
pub fn fill_holes_flat(
    surface: &SurfaceView<'_>,
    region: Option<&[u32]>,
    own: u32,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    let (mut mesh, rings) = gather_holes(surface, region, progress)?;
    let look = CapLook {
        hard: &[],
        own: Some(own),
    };
    let planes: Vec<RingPlane> = rings.iter().map(|ring| RingPlane::of_ring(&mesh, ring)).collect();
    let mut is_done = vec![false; rings.len()];
    // The largest first: what lies in its plane may be a hole of its cap.
    let mut order: Vec<usize> = (0..rings.len()).collect();
    order.sort_by(|&i, &j| planes[j].radius.total_cmp(&planes[i].radius).then(i.cmp(&j)));
    for &first in &order {
        if is_done[first] {
            continue;
        }
        if !planes[first].is_flat() {
            is_done[first] = true;
            let message = format!(
                "a hole over {} edges is {:.0} % of its radius away from flat and is filled curved",
                rings[first].len(),
                100.0 * planes[first].height / planes[first].radius
            );
            let place = format!("{}", planes[first].middle);
            mesh.warnings.push(EditWarning::new("cap-curved", message, place));
            fill_loop(&mut mesh, &rings[first], look, progress)?;
            continue;
        }
        let mut sides = Vec::new();
        for &other in &order {
            if is_done[other] || !planes[other].lies_in(&planes[first]) {
                continue;
            }
            is_done[other] = true;
            let ring = &rings[other];
            let next = ring.iter().cycle().skip(1);
            // From the side of the faces that are there.
            sides.extend(
                ring.iter()
                    .zip(next)
                    .filter_map(|(&a, &b)| Some((b, a, mesh.faces_along(a, b).next()?))),
            );
        }
        cap_flat_openings(&mut mesh, &sides, planes[first].normal, look, progress)?;
    }
    mesh.open_fans(&BTreeSet::new());
    Ok(mesh.into_finite_patch(surface, Vec::new())?.0)
}

/// The plane of a loop's vector area.
struct RingPlane {
    normal: DVec3,
    middle: DVec3,
    /// The largest distance from the middle, and from the plane.
    radius: f64,
    height: f64,
}

impl RingPlane {
    fn of_ring(mesh: &RegionMesh, ring: &[u32]) -> Self {
        let at: Vec<DVec3> = ring.iter().map(|&p| mesh.position(p)).collect();
        let middle = at.iter().sum::<DVec3>() / at.len() as f64;
        let next = at.iter().cycle().skip(1);
        let area: DVec3 = at.iter().zip(next).map(|(a, b)| (*a - middle).cross(*b - middle)).sum();
        let normal = area.normalize_or_zero();
        let most = |of: &dyn Fn(DVec3) -> f64| at.iter().map(|x| of(*x - middle)).fold(0.0, f64::max);
        Self {
            radius: most(&|x| x.length()),
            height: most(&|x| x.dot(normal).abs()),
            normal,
            middle,
        }
    }

    fn is_flat(&self) -> bool {
        self.normal != DVec3::ZERO && self.height <= FLAT * self.radius
    }

    /// Whether a flat loop lies in the plane of another, which is larger.
    fn lies_in(&self, larger: &Self) -> bool {
        let off = (self.middle - larger.middle).dot(larger.normal).abs();
        self.is_flat()
            && self.normal.dot(larger.normal).abs() >= PARALLEL
            && off <= larger.height + 1e-3 * larger.radius
    }
}
