//! What follows an edit beside numbers of vertices: normals and tangents, what belongs to corners of faces, and which polygons
//! still stand.
//!
//! What belongs to corners of faces instead of vertices: which old corners a new corner is blended from.
//!
//! In OBJ a vertex may have other texture coordinates in each face around it. A blend names vertices only, so for each
//! new triangle one old triangle is found that it lies on, its *origin*, and the blend's vertices are looked up in the
//! faces around the origin, without crossing a seam where that can be avoided.
//!
//! Polygons through conversions and edits: which faces of a file still stand as they did.
//!
//! A model is triangles; where a file's faces have more corners, the reader notes which triangles each was cut into. A
//! writer that knows polygons puts those together again whose triangles are all there, on the same vertices.

use super::blends::sum_by_vertex;
use super::{EditedModel, PrimitiveRun, VertexBlend};
use crate::geometry::{PlacesByVertex, unit_or_zero};
use glam::{DMat3, DVec3, Vec3, Vec4};
use pliant_mesh::{NONE, shading};
use std::collections::BTreeSet;

/// One run's shape before and after, and the directions that follow.
///
/// *Before* is where the blends put the vertices among their base's, as placed; *after* is where they are now. Between
/// both lie all edits and all deformations, so that one gradient per vertex carries what an artist authored to where it
/// belongs.
pub(crate) struct CarriedAttributes<'a> {
    edited: &'a EditedModel<'a>,
    run: &'a PrimitiveRun,
    /// Where the run's vertices are now.
    now: &'a [DVec3],
    /// Triangles over the run's vertices.
    pub triangles: Vec<[u32; 3]>,
    gradients: Vec<Option<DMat3>>,
    /// Normals of the surface as it is now; made when first needed.
    smooth: std::cell::OnceCell<Vec<Vec3>>,
}

impl<'a> CarriedAttributes<'a> {
    /// `positions` are those of the whole edited model.
    pub fn new(edited: &'a EditedModel<'a>, run: &'a PrimitiveRun, positions: &'a [DVec3]) -> Self {
        let triangles = edited.local_triangles(run);
        let now = &positions[run.vertices()];
        let before = Self::before(edited, run);
        let mut used = vec![false; now.len()];
        triangles.as_flattened().iter().for_each(|&v| used[v as usize] = true);
        let gradients = if edited.primitive(run).has_normals && used.contains(&false) {
            // Those in no triangle turn with the surface around them, which may be another run's.
            let all: Vec<DVec3> = edited.runs.iter().flat_map(|run| Self::before(edited, run)).collect();
            // A cap is blended from its rim, so that it has no shape before.
            let is_cap = |t: &&[u32; 3]| t.iter().all(|&v| edited.is_bare(v as usize));
            let walls: Vec<[u32; 3]> = edited.triangles.iter().filter(|t| !is_cap(t)).copied().collect();
            let triangles = if walls.is_empty() { edited.triangles } else { &walls };
            let all = shading::gradients_of_all(&all, positions, triangles, run.vertices());
            all[run.vertices()].to_vec()
        } else {
            shading::gradients(&before, now, &triangles, &triangles, now.len())
        };
        Self {
            edited,
            run,
            now,
            triangles,
            gradients,
            smooth: std::cell::OnceCell::new(),
        }
    }

    /// Where the blends put a run's vertices.
    pub fn before(edited: &EditedModel<'_>, run: &PrimitiveRun) -> Vec<DVec3> {
        let base = edited.base(run);
        let place = |vertex: usize| {
            let old = &base.model.geometry.positions;
            let blend = edited.blend(vertex);
            let here = match blend {
                VertexBlend::Vertex(vertex) => old[vertex as usize],
                _ => blend.iter().map(|(v, weight)| old[v as usize] * weight).sum(),
            };
            base.world_from_model.transform_point3(here)
        };
        run.vertices().map(place).collect()
    }

    fn smooth(&self, i: usize) -> Vec3 {
        self.smooth
            .get_or_init(|| shading::smooth_normals(self.now, &self.triangles))
            .get(i)
            .copied()
            .unwrap_or(Vec3::Z)
    }

    /// The unit normals of the run's vertices in world space.
    pub fn normals(&self) -> Vec<Vec3> {
        let base = self.edited.base(self.run);
        let old = &base.model.geometry.normals;
        let world_from_normal = shading::cofactor(&base.world_from_model.matrix3);
        let turned = base.world_from_model.matrix3 != DMat3::IDENTITY;
        let sign = if base.world_from_model.matrix3.determinant() < 0.0 {
            -1.0
        } else {
            1.0
        };
        let one = |(i, vertex): (usize, usize)| {
            if self.edited.is_bare(vertex) {
                return self.smooth(i);
            }
            let normal = match self.edited.blend(vertex) {
                VertexBlend::Vertex(v) => old.get(v as usize).copied().unwrap_or(Vec3::ZERO),
                blend => {
                    let of = |v: u32| old.get(v as usize).copied().unwrap_or(Vec3::ZERO).as_dvec3();
                    unit_or_zero(blend.iter().map(|(v, weight)| of(v) * weight).sum())
                }
            };
            let placed = if turned {
                unit_or_zero(world_from_normal * normal.as_dvec3() * sign)
            } else {
                normal
            };
            if placed == Vec3::ZERO {
                return self.smooth(i);
            }
            self.gradients[i]
                .as_ref()
                .map_or(placed, |g| shading::carry_normal(g, placed))
        };
        self.run.vertices().enumerate().map(one).collect()
    }

    /// The unit tangents of the run's vertices in world space, orthogonal to `normals`.
    pub fn tangents(&self, normals: &[Vec3]) -> Vec<Vec4> {
        let base = self.edited.base(self.run);
        let old = &base.model.geometry.tangents;
        let matrix = base.world_from_model.matrix3;
        let side = if matrix.determinant() < 0.0 { -1.0 } else { 1.0 };
        let of = |v: u32| old.get(v as usize).copied().unwrap_or(Vec4::ZERO);
        let one = |(i, vertex): (usize, usize)| {
            let blend = self.edited.blend(vertex);
            let normal = normals[i];
            // A mean of both sides is none; the heaviest vertex says on which side the bitangent lies.
            let w = if of(blend.heaviest()).w < 0.0 { -side } else { side };
            let tangent: DVec3 = blend
                .iter()
                .map(|(v, weight)| of(v).truncate().as_dvec3() * weight)
                .sum();
            let placed = unit_or_zero(matrix * tangent);
            let across = || normal.any_orthonormal_vector().extend(w);
            if placed == Vec3::ZERO || self.edited.is_bare(vertex) {
                return across();
            }
            match (&self.gradients[i], blend) {
                (Some(gradient), _) => shading::carry_tangent(gradient, placed.extend(w), normal),
                (None, VertexBlend::Vertex(_)) => placed.extend(w),
                (None, _) => (placed - normal * normal.dot(placed))
                    .try_normalize()
                    .map_or_else(across, |t| t.extend(w)),
            }
        };
        self.run.vertices().enumerate().map(one).collect()
    }
}

/// Old triangles around old vertices, and the origins of a run's triangles.
pub(crate) struct TriangleOrigins<'a> {
    edited: &'a EditedModel<'a>,
    run: &'a PrimitiveRun,
    old: &'a [[u32; 3]],
    /// Corners by old vertex: 3 × triangle + place.
    corners: PlacesByVertex,
    /// For each triangle of the run the old triangle that it lies on.
    of: Vec<u32>,
}

/// Most triangles searched for a vertex that is not a corner of the origin.
const MOST_VISITED: usize = 256;

impl<'a> TriangleOrigins<'a> {
    /// Finds the origins. `old` are the triangles of the run's base, all of them.
    pub fn new(edited: &'a EditedModel<'a>, run: &'a PrimitiveRun, old: &'a [[u32; 3]]) -> Self {
        let vertices = edited.base(run).model.geometry.positions.len();
        let mut origins = Self {
            edited,
            run,
            old,
            corners: PlacesByVertex::of(vertices, old.as_flattened()),
            of: Vec::new(),
        };
        origins.of = run.triangles().map(|t| origins.find(t)).collect();
        origins
    }

    /// For each triangle of the run the old triangle that it lies on; [`NONE`] where no old triangle has any of its
    /// blend's vertices.
    pub fn old_triangles(&self) -> &[u32] {
        &self.of
    }

    fn find(&self, triangle: usize) -> u32 {
        if let Some(&given) = self.edited.origins.get(triangle)
            && (given as usize) < self.old.len()
        {
            return given;
        }
        let blends = self.edited.triangles[triangle].map(|v| self.edited.blend(v as usize));
        let mut weights: Vec<(u32, f64)> = blends.iter().flat_map(|r| r.iter()).collect();
        sum_by_vertex(&mut weights);
        let unchanged = match blends {
            [VertexBlend::Vertex(a), VertexBlend::Vertex(b), VertexBlend::Vertex(c)] => Some([a, b, c]),
            _ => None,
        };
        let share = |t: u32| {
            let corners = self.old[t as usize];
            let of = |v: u32| weights.binary_search_by_key(&v, |w| w.0).map_or(0.0, |i| weights[i].1);
            let turned = |k: usize| unchanged == Some([corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]]);
            // Of two faces back to back the one that faces the same way.
            corners.iter().map(|&v| of(v)).sum::<f64>() + if (0..3).any(turned) { 0.5 } else { 0.0 }
        };
        let mut best = (NONE, 0.0);
        for &(vertex, _) in &weights {
            for &corner in self.corners.at(vertex) {
                let candidate = corner / 3;
                let value = share(candidate);
                if value > best.1 + 1e-9 || (value > best.1 - 1e-9 && candidate < best.0) {
                    best = (candidate, value.max(best.1));
                }
            }
        }
        best.0
    }

    /// The old corners that a corner of the run's triangle `triangle` (counted from 0) is blended from, with weights.
    /// `seam` has an identity for each old corner; around one vertex, faces with different ones are on different sides of
    /// a seam.
    pub fn corner(&self, triangle: usize, corner: usize, seam: &[u32]) -> Vec<(u32, f64)> {
        let vertex = self.edited.triangles[self.run.first_triangle as usize + triangle][corner] as usize;
        let origin = self.of[triangle];
        if origin == NONE {
            return Vec::new();
        }
        let blend = self.edited.blend(vertex).iter();
        blend
            .filter_map(|(v, weight)| Some((self.nearest(origin, v, seam)?, weight)))
            .collect()
    }

    /// The corner of an old vertex nearest to an old triangle.
    fn nearest(&self, origin: u32, vertex: u32, seam: &[u32]) -> Option<u32> {
        let corner_in = |t: u32| {
            (0..3)
                .map(|k| 3 * t + k)
                .find(|&c| self.old[t as usize][(c % 3) as usize] == vertex)
        };
        if let Some(corner) = corner_in(origin) {
            return Some(corner);
        }
        let mut seen = BTreeSet::from([origin]);
        let mut open = std::collections::VecDeque::from([origin]);
        while let Some(triangle) = open.pop_front() {
            for place in 0..3 {
                let here = 3 * triangle + place;
                for &corner in self.corners.at(self.old[triangle as usize][place as usize]) {
                    let next = corner / 3;
                    if seam[corner as usize] != seam[here as usize] || seen.len() >= MOST_VISITED || !seen.insert(next)
                    {
                        continue;
                    }
                    if let Some(corner) = corner_in(next) {
                        return Some(corner);
                    }
                    open.push_back(next);
                }
            }
        }
        self.corners.at(vertex).first().copied()
    }
}

/// The faces of a file that have more than three corners, as runs of its triangles.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct FaceOutlines {
    /// For each such face its first triangle, ascending.
    first_triangles: Vec<u32>,
    /// For each such face the place in `corners` past its last corner.
    ends: Vec<u32>,
    /// Corners in the order of the face: 3 × triangle + place, triangles counted from the face's first one.
    corners: Vec<u32>,
}

impl FaceOutlines {
    /// Adds a face: its first triangle, and its corners counted as in [`FaceOutlines`].
    pub fn add_face(&mut self, first_triangle: u32, corners: impl Iterator<Item = u32>) {
        self.corners.extend(corners);
        self.first_triangles.push(first_triangle);
        self.ends.push(self.corners.len() as u32);
    }

    /// About how many bytes it holds in memory.
    pub fn bytes_held(&self) -> u64 {
        let numbers = self.first_triangles.len() + self.ends.len() + self.corners.len();
        4 * numbers as u64
    }

    fn is_empty(&self) -> bool {
        self.first_triangles.is_empty()
    }

    fn corners_of(&self, face: usize) -> &[u32] {
        let first = face.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.corners[first as usize..self.ends[face] as usize]
    }
}

/// The faces of a run: polygons that still stand, and triangles. A corner is 3 × triangle + place, triangles of the run
/// counted from 0, so that whatever belongs to corners of triangles is found.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct RunFaces {
    corners: Vec<u32>,
    /// For each face the place in `corners` past its last corner.
    ends: Vec<u32>,
}

impl RunFaces {
    /// Finds the faces of a run; `None` when all are triangles. `outlines` are those of the run's base.
    pub fn of_run(edited: &EditedModel<'_>, run: &PrimitiveRun, outlines: &FaceOutlines) -> Option<Self> {
        if outlines.is_empty() || run.triangle_count == 0 {
            return None;
        }
        let old = &edited.base(run).model.geometry.triangles;
        let origins: Vec<u32> = if let Some(given) = edited.origins.get(run.triangles()) {
            given.to_vec()
        } else if edited.is_untouched(run, old) {
            (0..run.triangle_count).collect()
        } else {
            TriangleOrigins::new(edited, run, old).old_triangles().to_vec()
        };
        let triangles = &edited.triangles[run.triangles()];
        let mut faces = Self::default();
        let mut polygons = 0;
        let mut i = 0;
        while i < triangles.len() {
            let face = outlines.first_triangles.binary_search(&origins[i]).ok();
            let corners = face.map(|face| outlines.corners_of(face));
            let corners = corners.filter(|corners| {
                let count = corners.len() - 2;
                let new = triangles.get(i..i + count).zip(origins.get(i..i + count));
                new.is_some_and(|(new, origins)| still_stands(edited, old, new, origins))
            });
            let first = 3 * i as u32;
            match corners {
                Some(corners) => {
                    faces.corners.extend(corners.iter().map(|c| first + c));
                    i += corners.len() - 2;
                    polygons += 1;
                }
                None => {
                    faces.corners.extend(first..first + 3);
                    i += 1;
                }
            }
            faces.ends.push(faces.corners.len() as u32);
        }
        (polygons > 0).then_some(faces)
    }

    /// How many faces there are.
    pub fn face_count(&self) -> usize {
        self.ends.len()
    }

    /// The corners of each face.
    pub fn face_corners(&self) -> impl Iterator<Item = &[u32]> {
        let firsts = std::iter::once(0).chain(self.ends.iter().copied());
        firsts
            .zip(&self.ends)
            .map(|(first, &end)| &self.corners[first as usize..end as usize])
    }

    /// Hands out the corners of every face of a run of `triangles` triangles; those of `faces` where it has polygons.
    pub fn each_or_triangles(faces: Option<&Self>, triangles: usize, mut face: impl FnMut(&[u32])) {
        match faces {
            Some(faces) => faces.face_corners().for_each(face),
            None => (0..triangles as u32).for_each(|t| face(&[3 * t, 3 * t + 1, 3 * t + 2])),
        }
    }
}

/// Whether new triangles are those that a face was cut into: one after the other, on the vertices that they had.
fn still_stands(edited: &EditedModel<'_>, old: &[[u32; 3]], new: &[[u32; 3]], origins: &[u32]) -> bool {
    let consecutive = origins
        .iter()
        .zip(origins[0]..)
        .all(|(&origin, wanted)| origin == wanted);
    let Some(old) = old
        .get(origins[0] as usize..)
        .and_then(|old| old.get(..new.len()))
        .filter(|_| consecutive)
    else {
        return false;
    };
    let mut pairs: Vec<(u32, u32)> = old
        .as_flattened()
        .iter()
        .copied()
        .zip(new.as_flattened().iter().copied())
        .collect();
    let kept = |&(old, new): &(u32, u32)| edited.blend(new as usize) == VertexBlend::Vertex(old);
    if !pairs.iter().all(kept) {
        return false;
    }
    // An edit may have parted a vertex in two, with the face between them.
    pairs.sort_unstable();
    pairs.windows(2).all(|w| w[0].0 != w[1].0 || w[0].1 == w[1].1)
}
