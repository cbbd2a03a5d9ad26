//! What belongs to corners of faces instead of vertices: which old corners a new corner is blended from.
//!
//! In OBJ a vertex may have other texture coordinates in each face around it. A blend names vertices only, so for each
//! new triangle one old triangle is found that it lies on, its *origin*, and the blend's vertices are looked up in the
//! faces around the origin, without crossing a seam where that can be avoided.

use super::{EditedModel, PrimitiveRun, VertexBlend};
use crate::mesh::NONE;
use std::collections::BTreeSet;

/// Old triangles around old vertices, and the origins of a run's triangles.
pub(in crate::asset) struct TriangleOrigins<'a> {
    edited: &'a EditedModel<'a>,
    run: &'a PrimitiveRun,
    old: &'a [[u32; 3]],
    /// For each old vertex where its corners begin in `corners`.
    starts: Vec<u32>,
    /// Corners by vertex: 3 × triangle + place.
    corners: Vec<u32>,
    /// For each triangle of the run the old triangle that it lies on.
    of: Vec<u32>,
}

/// Most triangles searched for a vertex that is not a corner of the origin.
const MOST_VISITED: usize = 256;

impl<'a> TriangleOrigins<'a> {
    /// Finds the origins. `old` are the triangles of the run's base, all of them.
    pub fn new(edited: &'a EditedModel<'a>, run: &'a PrimitiveRun, old: &'a [[u32; 3]]) -> Self {
        let vertices = edited.base(run).model.geometry.positions.len();
        let mut starts = vec![0u32; vertices + 1];
        for &vertex in old.as_flattened() {
            starts[vertex as usize + 1] += 1;
        }
        for i in 0..vertices {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let mut corners = vec![0u32; old.len() * 3];
        for (corner, &vertex) in old.as_flattened().iter().enumerate() {
            let at = &mut next[vertex as usize];
            corners[*at as usize] = corner as u32;
            *at += 1;
        }
        let mut origins = Self {
            edited,
            run,
            old,
            starts,
            corners,
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

    fn around(&self, vertex: u32) -> &[u32] {
        let v = vertex as usize;
        &self.corners[self.starts[v] as usize..self.starts[v + 1] as usize]
    }

    fn find(&self, triangle: usize) -> u32 {
        if let Some(&given) = self.edited.origins.get(triangle)
            && (given as usize) < self.old.len()
        {
            return given;
        }
        let blends = self.edited.triangles[triangle].map(|v| self.edited.blend(v as usize));
        let mut weights: Vec<(u32, f64)> = blends.iter().flat_map(|r| r.iter()).collect();
        weights.sort_by_key(|&(vertex, _)| vertex);
        weights.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            kept.1 += if same { next.1 } else { 0.0 };
            same
        });
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
            for &corner in self.around(vertex) {
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
                for &corner in self.around(self.old[triangle as usize][place as usize]) {
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
        self.around(vertex).first().copied()
    }
}
