//! Polygons through conversions and edits: which faces of a file still stand as they did.
//!
//! A model is triangles; where a file's faces have more corners, the reader notes which triangles each was cut into. A
//! writer that knows polygons puts those together again whose triangles are all there, on the same vertices.

use super::{EditedModel, PrimitiveRun, TriangleOrigins, VertexBlend};

/// The faces of a file that have more than three corners, as runs of its triangles.
#[derive(Debug, Clone, Default, PartialEq)]
pub(in crate::asset) struct FaceOutlines {
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
pub(in crate::asset) struct RunFaces {
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
