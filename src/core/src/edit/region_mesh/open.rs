//! Opening a region mesh: points whose faces no longer hang together become several.
//!
//! The faces around a point fall into *fans* that hang together by edges. Cutting an edge or removing faces can part a
//! fan; then each part gets a point of its own at the same place, so that a manifold surface stays one. Fans that were
//! apart before (the model's own pinched points) stay joined at their point.

use super::mesh::{RegionMesh, edge_key};
use crate::mesh::query::fan::group_fans;
use crate::mesh::{Lists, NONE};
use std::collections::BTreeSet;

impl RegionMesh {
    /// Gives each parted fan its own point; edges in `cuts` (smaller point first) join nothing. Faces of the mesh must
    /// have been changed by replacement only.
    pub fn open_fans(&mut self, cuts: &BTreeSet<(u32, u32)>) {
        let gathered = &self.faces[..self.triangles.len()];
        let faces_before = Lists::gather(self.points.len(), || {
            let numbered = gathered.iter().zip(0u32..);
            numbered.flat_map(|(face, f)| face.points.map(|p| (p, f)))
        });
        for p in 0..self.points.len() as u32 {
            let point = &self.points[p as usize];
            if !point.whole || point.faces.len() < 2 {
                continue;
            }
            let around = point.faces.clone();
            let fan = number_fans(p, &around, |f| self.points_of(f), |q| !cuts.contains(&edge_key(p, q)));
            let count = fan.iter().map(|f| f + 1).max().unwrap_or(0);
            if count < 2 {
                continue;
            }
            let before = self.fans_before(p, &faces_before);
            let mut seen: BTreeSet<u32> = BTreeSet::new();
            for part in 0..count {
                let members: Vec<u32> = (around.iter().zip(&fan))
                    .filter(|(_, f)| **f == part)
                    .map(|(&f, _)| f)
                    .collect();
                let mut first = false;
                for &f in &members {
                    match self.fan_before(&before, f) {
                        Some(was) => first |= seen.insert(was),
                        None => first |= part == 0,
                    }
                }
                if !first {
                    self.split_off_faces(p, &members);
                }
            }
        }
    }

    /// The fan of each gathered face around a gathered point, before anything was done.
    fn fans_before(&self, p: u32, faces_before: &Lists) -> Vec<(u32, u32)> {
        if self.points[p as usize].old == NONE {
            return Vec::new();
        }
        let around = faces_before.of(p);
        // What was split off since is at its root.
        let points = |f| self.points_of(f).map(|q| self.points[q as usize].root);
        let fan = number_fans(p, around, points, |_| true);
        around.iter().copied().zip(fan).collect()
    }

    /// The fan that a face comes from; none at new points, and for caps, which hang on their neighbours.
    fn fan_before(&self, before: &[(u32, u32)], face: u32) -> Option<u32> {
        let source = self.faces[face as usize].source;
        before.binary_search_by_key(&source, |b| b.0).ok().map(|k| before[k].1)
    }

    /// Moves `faces` from `p` to a new point at the same place.
    fn split_off_faces(&mut self, p: u32, faces: &[u32]) {
        let twin = self.add_point(self.position(p));
        self.points[twin as usize].root = self.points[p as usize].root;
        let mut moving = faces.to_vec();
        moving.sort_unstable();
        self.points[p as usize]
            .faces
            .retain(|f| moving.binary_search(f).is_err());
        for &f in faces {
            let face = &mut self.faces[f as usize];
            face.untouched = false;
            for c in &mut face.points {
                if *c == p {
                    *c = twin;
                }
            }
        }
        self.points[twin as usize].faces = faces.to_vec();
    }
}

/// Numbers the fans of the faces `around` a point, in the order of the first face of each. `joins` says whether faces
/// hang together along the edge from the point to another.
fn number_fans(p: u32, around: &[u32], points: impl Fn(u32) -> [u32; 3], joins: impl Fn(u32) -> bool) -> Vec<u32> {
    let faces = around.iter().zip(0u32..);
    let spokes = faces.flat_map(|(&f, i)| {
        points(f)
            .into_iter()
            .filter(|&q| q != p && joins(q))
            .map(move |q| (q, i))
    });
    group_fans(around.len(), spokes.collect::<Vec<_>>()).0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::surface::SurfaceView;
    use glam::DVec3;

    /// A fan of six triangles around point 0.
    fn hexagon() -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let angle = |k: u32| f64::from(k) * std::f64::consts::TAU / 6.0;
        let ring = (0..6).map(|k| DVec3::new(libm::cos(angle(k)), libm::sin(angle(k)), 0.0));
        let faces = (0..6u32).map(|k| [0, 1 + k, 1 + (k + 1) % 6]);
        (std::iter::once(DVec3::ZERO).chain(ring).collect(), faces.collect())
    }

    fn with_mesh(act: impl FnOnce(&mut RegionMesh)) {
        let (positions, triangles) = hexagon();
        let surface = SurfaceView {
            positions: &positions,
            triangles: &triangles,
            primitive_of: &[0; 6],
            point_of: &[0, 1, 2, 3, 4, 5, 6],
            points: 7,
        };
        act(&mut RegionMesh::with_ring(&surface, &[0, 1, 2, 3, 4, 5]));
    }

    fn roots(mesh: &RegionMesh) -> Vec<u32> {
        mesh.points[7..].iter().map(|p| p.root).collect()
    }

    #[test]
    fn a_cut_across_parts_and_a_cut_to_the_middle_does_not_part_the_middle() {
        with_mesh(|mesh| {
            mesh.open_fans(&BTreeSet::from([(0, 1), (0, 4)]));
            // The middle and both ends.
            assert_eq!(mesh.points.len(), 7 + 3);
            assert_eq!(roots(mesh), [0, 1, 4]);
            assert!(mesh.points.iter().all(|p| (1..=3).contains(&p.faces.len())));
        });
        with_mesh(|mesh| {
            mesh.open_fans(&BTreeSet::from([(0, 1)]));
            assert_eq!(roots(mesh), [1], "the rim opens, the middle holds");
            assert_eq!(mesh.faces_around(0).len(), 6);
        });
    }

    #[test]
    fn faces_left_corner_to_corner_get_points_of_their_own() {
        with_mesh(|mesh| {
            [1, 3, 5].into_iter().for_each(|f| mesh.remove_face(f));
            mesh.open_fans(&BTreeSet::new());
            assert_eq!(roots(mesh), [0, 0]);
            assert!(mesh.open_sides(|_, _| true).len() == 9);
        });
    }
}
