//! What rides along through an edit: points and lines stay on the surface that they lie on.
//!
//! A vertex in no triangle has a place in the triangle nearest to it. Where an edit has divided that triangle, what the new
//! corners are blended from says which of the new triangles has the place; else the nearest place of the new surface is taken.

use super::edit_command::EditKind;
use super::error::Error;
use super::facts::DeformerWarning;
use super::riding::{LEAST_LOOSE_VISITS, RidingModel, VISITS_PER_LOOSE_VERTEX};
use crate::edit::{CutPlane, EditWarning, PatchedSurface, SurfacePatch, SurfaceView};
use crate::exec::Exec;
use crate::mesh::query::TriangleBvh;
use crate::mesh::query::closest_point::closest_weights_on_triangle;
use crate::mesh::{BoundingBox, NONE};
use glam::{DQuat, DVec3};
use std::cell::OnceCell;
use std::collections::BTreeMap;

/// What is within this share of the box's diagonal from the surface lies on it: 32-bit numbers are as exact.
const ON_SURFACE: f64 = 1e-6;
/// What would move by less than this share stays where it is.
const STAYS: f64 = 1e-9;
/// How far outside of a triangle a place in it may be, as a part of its corners' weights.
const OUTSIDE: f64 = 1e-6;
/// How many vertices of one primitive or name are listed.
const NAMES_LISTED: usize = 8;

/// An edit, as what rides along sees it.
#[derive(Clone, Copy)]
pub(super) struct RiddenEdit<'a> {
    pub model: RidingModel<'a>,
    /// The surface before.
    pub before: SurfaceView<'a>,
    pub patch: &'a SurfacePatch,
    pub kind: EditKind,
    /// Which vertices are ends of lines, or points, of the surface before.
    pub drawn: &'a dyn Fn() -> Result<Vec<[u32; 2]>, Error>,
    /// Whether what rides along goes with the surface. Sessions of before leave it where it was.
    pub follows: bool,
}

impl RiddenEdit<'_> {
    /// Puts what rides along where the surface under it is after the edit, and says what stands on surface that is gone.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn follow(self, applied: &mut PatchedSurface, exec: &Exec<'_>) -> Result<Option<DeformerWarning>, Error> {
        let SurfacePatch {
            removed, moved, joined, ..
        } = self.patch;
        let loose = self.model.loose();
        if loose.is_empty() || (removed.is_empty() && moved.is_empty() && joined.is_empty()) {
            return Ok(None);
        }
        let (mut places, mut taken) = (Vec::new(), Vec::new());
        {
            let search = AnchorSearch::new(self, applied, exec);
            let limit = LEAST_LOOSE_VISITS + VISITS_PER_LOOSE_VERTEX * loose.len() as u64;
            for (k, &vertex) in loose.iter().enumerate() {
                if k.is_multiple_of(256) {
                    exec.check()?;
                    if search.visits() > limit {
                        return Ok(Some(too_long(loose.len())));
                    }
                }
                let now = applied.vertex_from_old[vertex as usize];
                match search.place_of(vertex) {
                    _ if now == NONE => {}
                    Some(place) => places.push((now, place)),
                    None => taken.push(vertex),
                }
            }
        }
        if self.follows {
            for (vertex, place) in places {
                applied.positions[vertex as usize] = place;
            }
        }
        if taken.iter().any(|v| self.may_be_unused(*v)) {
            // What a primitive of lines shares with triangles and does not draw is not there to be seen.
            let mut drawn = (self.drawn)()?.into_flattened();
            drawn.sort_unstable();
            taken.retain(|v| !self.may_be_unused(*v) || drawn.binary_search(v).is_ok());
        }
        Ok(self.warning(&taken))
    }

    /// Whether a vertex is of a primitive that draws points or lines between some of its vertices.
    fn may_be_unused(self, vertex: u32) -> bool {
        let own = self.model.primitives.partition_point(|p| p.first_vertex <= vertex) - 1;
        self.model.primitives[own].index_count == 0 && !self.model.of_splats
    }

    /// Names what stood on surface that is gone.
    fn warning(self, taken: &[u32]) -> Option<DeformerWarning> {
        let primitives = self.model.primitives;
        let place_of = |v: &u32| primitives.partition_point(|p| p.first_vertex <= *v) - 1;
        let mut places: Vec<usize> = taken.iter().map(place_of).collect();
        places.sort_unstable();
        places.dedup();
        let name = |&k: &usize| match primitives[k].name.as_str() {
            "" => format!("primitive {k}"),
            name => format!("primitive {k} ({name})"),
        };
        let names: Vec<String> = places.iter().take(NAMES_LISTED).map(name).collect();
        let more = match places.len().saturating_sub(NAMES_LISTED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let vertices = if taken.len() == 1 { "vertex" } else { "vertices" };
        let message = format!(
            "{} {vertices} of points and lines, or in no triangle, stood on surface that the edit has taken, and stay: {}{more}",
            taken.len(),
            names.join(", ")
        );
        (!taken.is_empty()).then(|| DeformerWarning::new("loose-vertices-stay", message, ""))
    }
}

/// What is said where finding what rides along takes too long: all of it stays, as a cloud is not torn.
fn too_long(loose: usize) -> DeformerWarning {
    let message = format!(
        "{loose} vertices of points and lines, or in no triangle, stay where they are, because faces are as long as the model and \
         finding the places under them takes too long; remesh the model to give it faces of about one size"
    );
    DeformerWarning::new("loose-vertices-stay", message, "")
}

/// Takes the splats of a model of their own along with what an edit takes: those beyond the plane of a cut, and those of which the
/// nearest surface is deleted. `cut`: the plane, and which side stays.
///
/// # Errors
/// [`Error::Cancelled`].
pub(super) fn take_splats(
    patch: &mut SurfacePatch,
    before: &SurfaceView<'_>,
    splats: &[u32],
    cut: Option<(CutPlane, bool)>,
    exec: &Exec<'_>,
) -> Result<(), Error> {
    let place = |v: &u32| before.positions[*v as usize];
    let gone: Vec<u32> = match cut {
        Some((plane, keeps_above)) => {
            let is_above = |v: &u32| plane.normal.dot(place(v)) >= plane.offset;
            splats.iter().copied().filter(|v| is_above(v) != keeps_above).collect()
        }
        None if patch.removed.is_empty() => return Ok(()),
        None => {
            let surface = TriangleBvh::build(before.positions, before.triangles, exec.pool);
            let mut gone = Vec::new();
            for (k, v) in splats.iter().enumerate() {
                if k.is_multiple_of(256) {
                    exec.check()?;
                }
                let nearest = surface.closest_point(place(v));
                if nearest.is_some_and(|at| patch.removed.binary_search(&at.triangle).is_ok()) {
                    gone.push(*v);
                }
            }
            gone
        }
    };
    if !gone.is_empty() {
        let splats = if gone.len() == 1 { "splat" } else { "splats" };
        let message = format!("{} {splats} went with the surface around them", gone.len());
        patch.warnings.push(EditWarning::new("splats-cut", message, ""));
    }
    patch.idle.extend(gone);
    patch.idle.sort_unstable();
    patch.idle.dedup();
    Ok(())
}

/// Finds where places of the surface before an edit are after it.
struct AnchorSearch<'a> {
    edit: RiddenEdit<'a>,
    applied: &'a PatchedSurface,
    exec: &'a Exec<'a>,
    diagonal: f64,
    before: TriangleBvh<'a>,
    after: OnceCell<TriangleBvh<'a>>,
    /// For each vertex in no triangle that has the place of one of the surface, that one.
    alike: BTreeMap<u32, u32>,
    /// Where the points are after the edit.
    points: Vec<DVec3>,
    /// The new triangles that were made of one old one, by its points, rising.
    divided: BTreeMap<[u32; 3], Vec<u32>>,
}

impl<'a> AnchorSearch<'a> {
    fn new(edit: RiddenEdit<'a>, applied: &'a PatchedSurface, exec: &'a Exec<'a>) -> Self {
        let SurfaceView {
            positions, triangles, ..
        } = edit.before;
        let bounds = BoundingBox::of(positions);
        let mut search = Self {
            edit,
            applied,
            exec,
            diagonal: (bounds.max - bounds.min).length(),
            before: TriangleBvh::build(positions, triangles, exec.pool),
            after: OnceCell::new(),
            alike: edit.model.part_by_place(edit.model.loose()).0.into_iter().collect(),
            points: applied.surface().point_positions(),
            divided: BTreeMap::new(),
        };
        let fresh = (0u32..)
            .zip(&applied.old_from_triangle)
            .filter(|(_, was)| **was == NONE);
        for (triangle, _) in fresh {
            let corners = applied.triangles[triangle as usize];
            let mut points: Vec<u32> = (corners.iter())
                .flat_map(|&v| search.parts(v))
                .map(|part| part.0)
                .collect();
            points.sort_unstable();
            points.dedup();
            if let Ok(key) = <[u32; 3]>::try_from(points) {
                search.divided.entry(key).or_default().push(triangle);
            }
        }
        search
    }

    /// What long queries have looked at.
    fn visits(&self) -> u64 {
        self.before.visits.total() + self.after.get().map_or(0, |after| after.visits.total())
    }

    /// The old points that a vertex after the edit is blended from, with their weights.
    fn parts(&self, vertex: u32) -> Vec<(u32, f64)> {
        let SurfaceView {
            positions, point_of, ..
        } = self.edit.before;
        let patch = self.edit.patch;
        let was = self.applied.old_from_vertex[vertex as usize];
        let parts: Vec<(u32, f64)> = match (was as usize).checked_sub(positions.len()) {
            Some(new) => patch.vertices[new].parts().collect(),
            None => match patch.blended.binary_search_by_key(&was, |b| b.vertex) {
                Ok(slid) => patch.blended[slid].parts().collect(),
                Err(_) => vec![(was, 1.0)],
            },
        };
        parts
            .into_iter()
            .map(|(v, weight)| (point_of[v as usize], weight))
            .collect()
    }

    /// Where an old point is after the edit, if it is there.
    fn point_after(&self, point: u32) -> Option<DVec3> {
        let now = *self.applied.point_from_old.get(point as usize)?;
        self.points.get(now as usize).copied()
    }

    /// Where a vertex in no triangle is after the edit; `None` where it stands on surface that is gone.
    fn place_of(&self, vertex: u32) -> Option<DVec3> {
        let SurfaceView {
            positions,
            triangles,
            point_of,
            ..
        } = self.edit.before;
        let place = positions[vertex as usize];
        let on_vertex = self.alike.get(&vertex).map(|&like| point_of[like as usize]);
        if let Some(now) = on_vertex.and_then(|point| self.point_after(point)) {
            return Some(now);
        }
        let Some(nearest) = self.before.closest_point(place) else {
            return Some(place);
        };
        let corners = triangles[nearest.triangle as usize];
        let old = corners.map(|v| positions[v as usize]);
        let points = corners.map(|v| point_of[v as usize]);
        let (weights, _) = closest_weights_on_triangle(place, old);
        let is_on = nearest.distance <= ON_SURFACE * self.diagonal;
        let moved = |from: [DVec3; 3], anchor: DVec3, to: [DVec3; 3]| {
            let offset = if is_on {
                DVec3::ZERO
            } else {
                turned(place - nearest.point, from, to)
            };
            let now = anchor + offset;
            if now.distance(place) <= STAYS * self.diagonal {
                place
            } else {
                now
            }
        };
        let new: [Option<DVec3>; 3] = points.map(|p| self.point_after(p));
        if let ([Some(a), Some(b), Some(c)], Err(_)) = (new, self.edit.patch.removed.binary_search(&nearest.triangle)) {
            return Some(moved(old, blend([a, b, c], weights), [a, b, c]));
        }
        if let Some((anchor, to)) = self.in_divided(points, weights) {
            return Some(moved(old, anchor, to));
        }
        let expected = [0, 1, 2].map(|k| new[k].unwrap_or(old[k]));
        let after = (self.after)
            .get_or_init(|| TriangleBvh::build(&self.applied.positions, &self.applied.triangles, self.exec.pool))
            .closest_point(blend(expected, weights))?;
        let takes_surface = matches!(self.edit.kind, EditKind::Cut | EditKind::Delete | EditKind::Clean);
        if takes_surface {
            // What is beside the surface stays there, with or without it.
            let is_gone = is_on && after.distance > 10.0 * ON_SURFACE * self.diagonal;
            return (!is_gone).then_some(place);
        }
        let to = self.applied.triangles[after.triangle as usize].map(|v| self.applied.positions[v as usize]);
        Some(moved(old, after.point, to))
    }

    /// The place with these weights of the corners of an old triangle, in one of the new triangles made of it, with the
    /// corners of that one.
    fn in_divided(&self, points: [u32; 3], weights: [f64; 3]) -> Option<(DVec3, [DVec3; 3])> {
        let mut key = points;
        key.sort_unstable();
        let mut best: Option<(f64, [f64; 3], u32)> = None;
        for &triangle in self.divided.get(&key)? {
            let corners = self.applied.triangles[triangle as usize];
            let of_corner = corners.map(|v| {
                let parts = self.parts(v);
                let of = |p: u32| parts.iter().filter(|part| part.0 == p).map(|part| part.1).sum::<f64>();
                DVec3::from_array(points.map(of))
            });
            let inside = glam::DMat3::from_cols(of_corner[0], of_corner[1], of_corner[2]);
            if inside.determinant().abs() < 1e-12 {
                continue;
            }
            let own = (inside.inverse() * DVec3::from_array(weights)).to_array();
            let least = own.into_iter().fold(f64::INFINITY, f64::min);
            if least >= -OUTSIDE && best.is_none_or(|b| least > b.0) {
                best = Some((least, own, triangle));
            }
        }
        let (_, own, triangle) = best?;
        let to = self.applied.triangles[triangle as usize].map(|v| self.applied.positions[v as usize]);
        Some((blend(to, own), to))
    }
}

fn blend(corners: [DVec3; 3], weights: [f64; 3]) -> DVec3 {
    crate::mesh::query::closest_point::blend_corners(corners, weights)
}

/// A vector that turns as the normal of a triangle does.
fn turned(offset: DVec3, from: [DVec3; 3], to: [DVec3; 3]) -> DVec3 {
    let normal = |t: [DVec3; 3]| (t[1] - t[0]).cross(t[2] - t[0]).try_normalize();
    match (normal(from), normal(to)) {
        (Some(from), Some(to)) if from != to => DQuat::from_rotation_arc(from, to) * offset,
        _ => offset,
    }
}
