//! From the region mesh to the patch that it stands for.

use super::mesh::RegionMesh;
use crate::edit::error::Error;
use crate::edit::patch::{NewTriangle, NewVertex, SurfacePatch};
use crate::edit::surface::SurfaceView;
use crate::mesh::NONE;
use std::collections::BTreeMap;

impl RegionMesh {
    /// Writes what is different from the surface that the mesh was gathered from; faces that are as they were stay. Answers
    /// beside it, for each point of the mesh, its number as in [`NewVertex::point`], or [`NONE`] when it is new and no face
    /// uses it.
    pub fn into_patch(self, surface: &SurfaceView<'_>) -> (SurfacePatch, Vec<u32>) {
        let mut patch = SurfacePatch {
            moved: self.moved,
            warnings: self.warnings,
            ..SurfacePatch::default()
        };
        let mut number: Vec<u32> = self.points.iter().map(|p| p.old).collect();
        let mut next_point = surface.points;
        let old_vertices = surface.positions.len() as u32;
        let mut made: BTreeMap<(u32, u32), u32> = BTreeMap::new();
        for (f, face) in self.faces.iter().enumerate() {
            if let Some(&triangle) = self.triangles.get(f) {
                if face.alive && face.untouched {
                    continue;
                }
                patch.removed.push(triangle);
            }
            if !face.alive {
                continue;
            }
            let mut corners = [0; 3];
            for k in 0..3 {
                let (point, wedge) = (face.points[k], face.wedges[k]);
                let w = self.wedges[wedge as usize];
                if w.vertex != NONE && w.point == point {
                    corners[k] = w.vertex;
                    continue;
                }
                corners[k] = *made.entry((point, wedge)).or_insert_with(|| {
                    let number = &mut number[point as usize];
                    if *number == NONE {
                        *number = next_point;
                        next_point += 1;
                    }
                    patch.vertices.push(NewVertex {
                        primitive: face.primitive,
                        point: *number,
                        position: self.points[point as usize].position,
                        of: w.of,
                        weights: w.weights,
                    });
                    old_vertices + patch.vertices.len() as u32 - 1
                });
            }
            let primitive = face.primitive;
            patch.triangles.push(NewTriangle { primitive, corners });
        }
        patch.removed.sort_unstable();
        patch.moved.sort_unstable_by_key(|m| m.0);
        (patch, number)
    }

    /// Does the same for a mesh of which new points may have left the range of numbers. `gone` are triangles outside the
    /// mesh that go as well, in any order.
    ///
    /// # Errors
    /// [`Error::Impossible`] when a point would lie nowhere.
    pub fn into_finite_patch(
        self,
        surface: &SurfaceView<'_>,
        gone: Vec<u32>,
    ) -> Result<(SurfacePatch, Vec<u32>), Error> {
        if let Some(point) = self.points.iter().find(|p| !p.position.is_finite()) {
            return Err(Error::impossible(
                "a new point would lie nowhere; coordinates this large cannot be computed with",
                format!("{}", point.position),
            ));
        }
        let (mut patch, number) = self.into_patch(surface);
        patch.removed.extend(gone);
        patch.removed.sort_unstable();
        patch.removed.dedup();
        Ok((patch, number))
    }
}
