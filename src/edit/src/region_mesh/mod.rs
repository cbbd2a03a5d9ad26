//! The region mesh: a part of a surface while an operation changes it. All operations that change faces one by one work
//! on this one structure and answer with the [`SurfacePatch`](crate::patch::SurfacePatch) that it becomes.
//!
//! Topology is that of points. Each face corner also has a *wedge*: what the attributes there are blended from. Two faces
//! that share a render vertex share its wedge, so an operation makes one new wedge where both sides of an edge agree and
//! one for each side along a seam, without knowing what a seam is.
//!
//! `gather` fills the mesh from a surface, `emit` writes the patch. In between there are two ways to change faces,
//! and an operation uses one of them throughout:
//!
//! - `split` *replaces* faces: the old one dies, its pieces are appended. Cuts and fills need that, because they look up the
//!   face that a piece comes from, treat edges with many faces, and part points afterwards (`open`).
//! - `turn` and `collapse` change faces *in place*. Remeshing and decimation need that, because they change every
//!   face many times and dead faces would pile up. Edges with more than two faces are left alone there.
//!
//! The order of the faces decides the order of the triangles of the patch, and with it the bits of every later result;
//! so the two ways cannot be expressed by one another.

mod mesh;
mod split;

use super::patch::{BlendedVertex, NewTriangle, NewVertex, SurfacePatch};
use super::surface::{BitSet, SurfaceView, check_region};
use glam::DVec3;
pub(super) use mesh::{CAP, EdgeFaces, RegionMesh, Wedge, edge_key};
use mesh::{RegionFace, RegionPoint};
use pliant_mesh::{Error, NONE, sorted_set};
pub(super) use split::EdgeCollapse;
use std::collections::BTreeMap;

impl RegionMesh {
    /// Takes the triangles `triangles`; numbers need not rise and may repeat. Points rise with their numbers in the surface,
    /// faces with theirs; triangles without three different points and numbers beyond the surface are left out. No point
    /// counts as whole.
    pub fn from_triangles(surface: &SurfaceView<'_>, mut triangles: Vec<u32>) -> Self {
        triangles.sort_unstable();
        triangles.dedup();
        triangles.retain(|&t| (t as usize) < surface.triangles.len() && surface.proper_points(t).is_some());
        let corners = triangles.iter().flat_map(|&t| surface.triangles[t as usize]);
        let vertices: Vec<u32> = sorted_set(corners);
        let points: Vec<u32> = sorted_set(vertices.iter().map(|&v| surface.point_of[v as usize]));
        let local = |v: u32| points.partition_point(|&p| p < surface.point_of[v as usize]) as u32;
        let mut mesh = Self {
            points: (points.iter().zip(0u32..))
                .map(|(&old, p)| RegionPoint::from_surface_point(old, DVec3::ZERO, p))
                .collect(),
            wedges: vertices.iter().map(|&v| Wedge::of_vertex(v, local(v))).collect(),
            ..Self::default()
        };
        for t in triangles {
            let corners = surface.triangles[t as usize];
            let points = corners.map(local);
            for (p, v) in points.into_iter().zip(corners) {
                mesh.points[p as usize].position = surface.positions[v as usize];
            }
            let wedges = corners.map(|v| vertices.partition_point(|&w| w < v) as u32);
            mesh.add_gathered(surface, t, points, wedges, false);
        }
        mesh
    }

    /// Takes all triangles that touch some points of the surface; those points count as whole.
    pub fn around_points(surface: &SurfaceView<'_>, points: &BitSet) -> Self {
        let mut mesh = Self::from_triangles(surface, surface.triangles_touching(points));
        for point in &mut mesh.points {
            point.whole = points.contains(point.old);
        }
        mesh
    }

    /// Takes some triangles and all that touch a point of theirs; their points count as whole.
    pub fn with_ring(surface: &SurfaceView<'_>, triangles: &[u32]) -> Self {
        Self::around_points(surface, &surface.points_of_triangles(triangles))
    }

    /// Takes a region, rising triangle numbers, to be changed in place, and freezes the others that touch it. Points and
    /// faces are numbered as they are met. Fixed are the points of frozen faces and those around which the faces make no
    /// single fan: nothing at them changes, so that what lies outside does not notice. Triangles of the region with two
    /// corners at one point are left alone, with all that they touch.
    ///
    /// # Errors
    /// [`Error::Invalid`] when `region` is none, see [`check_region`].
    pub fn with_frozen_ring(surface: &SurfaceView, region: &[u32]) -> Result<Self, Error> {
        check_region(surface, region)?;
        let mut mesh = Self::default();
        let mut numbers = LocalNumbers {
            point: vec![0; surface.points as usize],
            wedge: vec![0; surface.positions.len()],
        };
        let mut touched = BitSet::new(surface.points as usize);
        let mut improper = Vec::new();
        for &t in region {
            match surface.proper_points(t) {
                Some(p) => {
                    p.iter().for_each(|&p| touched.insert(p));
                    mesh.add_as_met(surface, t, false, &mut numbers);
                }
                None => improper.push(t),
            }
        }
        let inside = mesh.points.len();
        if region.len() < surface.triangles.len() {
            let mut region = region.iter().peekable();
            for t in surface.triangles_touching(&touched) {
                while region.next_if(|&&f| f < t).is_some() {}
                if region.peek() == Some(&&t) {
                    continue;
                }
                if surface.proper_points(t).is_some() {
                    mesh.add_as_met(surface, t, true, &mut numbers);
                } else {
                    improper.push(t);
                }
            }
        }
        for p in 0..mesh.points.len() {
            let frozen = |&f: &u32| mesh.faces[f as usize].frozen;
            let fixed = p >= inside || mesh.points[p].faces.iter().any(frozen) || !mesh.is_single_fan(p as u32);
            mesh.points[p].whole = p < inside;
            mesh.points[p].fixed = fixed;
        }
        for v in improper.iter().flat_map(|&t| surface.triangles[t as usize]) {
            let p = surface.point_of[v as usize];
            if p != NONE && numbers.point[p as usize] > 0 {
                mesh.points[numbers.point[p as usize] as usize - 1].fixed = true;
            }
        }
        Ok(mesh)
    }

    fn add_as_met(&mut self, surface: &SurfaceView, t: u32, frozen: bool, numbers: &mut LocalNumbers) {
        let wedges = surface.triangles[t as usize].map(|v| {
            let known = &mut numbers.wedge[v as usize];
            if *known > 0 {
                return *known - 1;
            }
            let old_point = surface.point_of[v as usize];
            let point = &mut numbers.point[old_point as usize];
            if *point == 0 {
                let number = self.points.len() as u32;
                let position = surface.positions[v as usize];
                self.points
                    .push(RegionPoint::from_surface_point(old_point, position, number));
                *point = number + 1;
            }
            self.wedges.push(Wedge::of_vertex(v, *point - 1));
            *known = self.wedges.len() as u32;
            *known - 1
        });
        let points = wedges.map(|w| self.wedges[w as usize].point);
        self.add_gathered(surface, t, points, wedges, frozen);
    }

    fn add_gathered(&mut self, surface: &SurfaceView, t: u32, points: [u32; 3], wedges: [u32; 3], frozen: bool) {
        let f = self.faces.len() as u32;
        for p in points {
            self.points[p as usize].faces.push(f);
        }
        self.triangles.push(t);
        self.faces.push(RegionFace {
            points,
            wedges,
            primitive: surface.primitive_of[t as usize],
            source: f,
            untouched: true,
            frozen,
            alive: true,
        });
    }
}

impl RegionPoint {
    fn from_surface_point(old: u32, position: DVec3, number: u32) -> Self {
        Self {
            position,
            old,
            faces: Vec::new(),
            whole: false,
            fixed: false,
            root: number,
        }
    }
}

impl Wedge {
    fn of_vertex(vertex: u32, point: u32) -> Self {
        Self {
            vertex,
            point,
            of: [vertex; 3],
            weights: [1.0, 0.0, 0.0],
        }
    }
}

/// One more than the local number of a point or render vertex, 0 for those not met. Zeroed memory costs only where it
/// is touched.
struct LocalNumbers {
    point: Vec<u32>,
    wedge: Vec<u32>,
}

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

    /// Writes which points have moved, and what their vertices are made of now, for a mesh in which nothing else has changed:
    /// all vertices and triangles stay.
    pub fn into_moves(self, surface: &SurfaceView<'_>) -> SurfacePatch {
        let mut moved: BTreeMap<u32, DVec3> = BTreeMap::new();
        let mut blended: BTreeMap<u32, BlendedVertex> = BTreeMap::new();
        for (face, &triangle) in self.faces.iter().zip(&self.triangles) {
            for (k, vertex) in surface.triangles[triangle as usize].into_iter().enumerate() {
                let position = self.position(face.points[k]);
                if position != surface.positions[vertex as usize] {
                    moved.insert(surface.point_of[vertex as usize], position);
                }
                let Wedge { of, weights, .. } = self.wedges[face.wedges[k] as usize];
                let is_itself = |(v, w): (u32, f64)| w == 0.0 || v == vertex;
                if !of.into_iter().zip(weights).all(is_itself) {
                    let flat = false;
                    blended.insert(
                        vertex,
                        BlendedVertex {
                            vertex,
                            of,
                            weights,
                            flat,
                        },
                    );
                }
            }
        }
        SurfacePatch {
            moved: moved.into_iter().collect(),
            blended: blended.into_values().collect(),
            warnings: self.warnings,
            ..SurfacePatch::default()
        }
    }

    /// Does the same as [`into_patch`](Self::into_patch) for a mesh of which new points may have left the range of numbers. `gone` are triangles outside the
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::TestSurface;

    #[test]
    fn a_ring_grows_and_knows_which_points_are_whole() {
        // A strip of six triangles over points 0..=7.
        let positions: Vec<DVec3> = (0..8)
            .map(|i| DVec3::new(f64::from(i / 2), f64::from(i % 2), 0.0))
            .collect();
        let triangles: Vec<[u32; 3]> = (0..3)
            .flat_map(|i| [[2 * i, 2 * i + 2, 2 * i + 1], [2 * i + 1, 2 * i + 2, 2 * i + 3]])
            .collect();
        let strip = TestSurface::new(positions, triangles);
        let surface = strip.view();
        let alone = RegionMesh::from_triangles(&surface, vec![1, 99, 1]);
        let old = |mesh: &RegionMesh| mesh.points.iter().map(|p| p.old).collect::<Vec<u32>>();
        assert_eq!((alone.triangles.as_slice(), old(&alone)), (&[1][..], vec![1, 2, 3]));
        let ring = RegionMesh::with_ring(&surface, &[0]);
        assert_eq!(ring.triangles, [0, 1, 2]);
        let whole: Vec<bool> = ring.points.iter().map(|p| p.whole).collect();
        assert_eq!(whole, [true, true, true, false, false]);
        assert_eq!(ring.open_sides(|_, _| true).len(), 5);
        assert_eq!(ring.position(4), strip.positions[4]);
    }
}
