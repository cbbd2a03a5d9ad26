//! From a draft to the patch that it stands for.

use super::draft::Draft;
use super::{Error, NewTriangle, NewVertex, Patch};
use crate::mesh::NONE;
use std::collections::BTreeMap;

impl Draft<'_> {
    /// Writes what has changed. `gone` are triangles outside the draft that go, in any order; `numbers` of points are
    /// answered beside the patch: for each draft point its number in the edited surface's old-or-new numbering of
    /// [`NewVertex::point`], or [`NONE`] when nothing uses it.
    pub fn finish(self, gone: Vec<u32>) -> Result<(Patch, Vec<u32>), Error> {
        let mut patch = Patch {
            removed: gone,
            warnings: self.warnings,
            ..Patch::default()
        };
        let old_points = self.local.points.len();
        let mut number = vec![NONE; self.positions.len()];
        number[..old_points].copy_from_slice(&self.local.points);
        let mut next_point = self.surface.points;
        let old_vertices = self.surface.positions.len() as u32;
        let mut made: BTreeMap<(u32, u32), u32> = BTreeMap::new();
        for (f, face) in self.faces.iter().enumerate() {
            let was = self.local.corners.get(f);
            if was.is_some() {
                if face.alive && was == Some(&face.corners) {
                    continue;
                }
                patch.removed.push(self.local.faces[f]);
            }
            if !face.alive {
                continue;
            }
            let mut corners = [0; 3];
            for k in 0..3 {
                let (point, wedge) = (face.corners[k], face.wedges[k]);
                let w = self.wedges[wedge as usize];
                let unmoved = w.vertex != NONE && number[point as usize] == self.surface.point_of[w.vertex as usize];
                if unmoved {
                    corners[k] = w.vertex;
                    continue;
                }
                if number[point as usize] == NONE {
                    number[point as usize] = next_point;
                    next_point += 1;
                }
                corners[k] = *made.entry((point, wedge)).or_insert_with(|| {
                    patch.vertices.push(NewVertex {
                        primitive: face.primitive,
                        point: number[point as usize],
                        position: self.positions[point as usize],
                        of: w.of,
                        weights: w.weights,
                    });
                    old_vertices + patch.vertices.len() as u32 - 1
                });
            }
            patch.triangles.push(NewTriangle {
                primitive: face.primitive,
                corners,
            });
        }
        patch.removed.sort_unstable();
        patch.removed.dedup();
        for p in 0..old_points {
            if self.positions[p] != self.local.positions[p] {
                patch.moved.push((self.local.points[p], self.positions[p]));
            }
        }
        if let Some(p) = self.positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::Impossible {
                problem: "a new point would lie nowhere; coordinates this large cannot be computed with".to_owned(),
                place: format!("{}", self.positions[p]),
            });
        }
        Ok((patch, number))
    }
}
