//! From the editable region back to a patch.

use super::Editable;
use crate::edit::{NewTriangle, NewVertex, Patch};
use crate::mesh::NONE;

impl Editable {
    /// What is different from the surface that the region was gathered from. Faces that are as they were stay.
    pub fn into_patch(self) -> Patch {
        let mut patch = Patch::default();
        let mut kept: Vec<u32> = self.living().map(|f| self.faces[f as usize].old).collect();
        kept.sort_unstable();
        patch.removed = (self.region.iter().copied())
            .filter(|t| kept.binary_search(t).is_err())
            .collect();
        let mut vertex = vec![NONE; self.wedges.len()];
        let mut point = vec![NONE; self.points.len()];
        let mut points = self.old_points;
        for f in self.living() {
            let face = self.faces[f as usize];
            if face.old != NONE {
                continue;
            }
            let corners = face.corners.map(|w| {
                let wedge = self.wedges[w as usize];
                if wedge.old != NONE {
                    return wedge.old;
                }
                if vertex[w as usize] == NONE {
                    let at = &self.points[wedge.point as usize];
                    let number = &mut point[wedge.point as usize];
                    if *number == NONE {
                        *number = if at.old == NONE {
                            points += 1;
                            points - 1
                        } else {
                            at.old
                        };
                    }
                    vertex[w as usize] = self.old_vertices + patch.vertices.len() as u32;
                    patch.vertices.push(NewVertex {
                        primitive: wedge.primitive,
                        point: *number,
                        position: at.position,
                        of: wedge.of,
                        weights: tidy(wedge.weights),
                    });
                }
                vertex[w as usize]
            });
            patch.triangles.push(NewTriangle {
                primitive: face.primitive,
                corners,
            });
        }
        patch
    }
}

/// Weights that are not negative and sum to 1.
fn tidy(weights: [f64; 3]) -> [f64; 3] {
    let positive = weights.map(|w| w.max(0.0));
    let sum: f64 = positive.iter().sum();
    if sum > 0.0 && sum.is_finite() {
        positive.map(|w| w / sum)
    } else {
        [1.0, 0.0, 0.0]
    }
}
