//! The region mesh itself: points, wedges and faces, and what is next to what.
//!
//! Opening a region mesh: points whose faces no longer hang together become several.
//!
//! The faces around a point fall into *fans* that hang together by edges. Cutting an edge or removing faces can part a
//! fan; then each part gets a point of its own at the same place, so that a manifold surface stays one. Fans that were
//! apart before (the model's own pinched points) stay joined at their point.

use crate::patch::EditWarning;
use crate::triangle;
use glam::DVec3;
use pliant_mesh::query::closest_surface_point::{group_fans, is_single_oriented_fan};
use pliant_mesh::{Lists, NONE};
use std::collections::{BTreeMap, BTreeSet};

/// In [`RegionFace::source`]: the face is new and closes a hole.
pub(crate) const CAP: u32 = u32::MAX;

/// An edge at a point with more faces than this is looked for at its other end, if that has fewer: at a point where very many
/// meet, looking through all of them for each of its edges would cost the square of their number.
const MANY_FACES: usize = 64;

/// A point of a region mesh and the faces around it.
#[derive(Debug, Clone)]
pub(crate) struct RegionPoint {
    pub position: DVec3,
    /// The surface's point that it is; [`NONE`] for one made here, or moved by [`RegionMesh::move_point`].
    pub old: u32,
    /// Living faces with a corner here.
    pub faces: Vec<u32>,
    /// Whether all faces around the point are here; true for new ones.
    pub whole: bool,
    /// Whether the point and its faces' edges at it must stay.
    pub fixed: bool,
    /// For a point that was split off from another when the mesh was opened, that one; else itself.
    pub root: u32,
}

/// What the attributes of a face corner are made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Wedge {
    /// The render vertex that it still is, or [`NONE`] for a blend.
    pub vertex: u32,
    /// The point of the mesh at which that vertex is.
    pub point: u32,
    /// Render vertices that it is blended from.
    pub of: [u32; 3],
    /// Their weights.
    pub weights: [f64; 3],
}

/// A face of a region mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RegionFace {
    /// Points at the corners.
    pub points: [u32; 3],
    /// Wedges at the corners.
    pub wedges: [u32; 3],
    /// The primitive that it belongs to.
    pub primitive: u32,
    /// The gathered face that it is a part of or lies beside, or [`CAP`].
    pub source: u32,
    /// Whether it still is the surface's triangle that it was gathered from.
    pub untouched: bool,
    /// Whether it is outside the region and stays as it is.
    pub frozen: bool,
    /// Whether it is still there.
    pub alive: bool,
}

impl Wedge {
    /// Makes a blend of render vertices, with weights that are not negative and sum to 1.
    pub fn from_blend(of: [u32; 3], weights: [f64; 3]) -> Self {
        let positive = weights.map(|w| w.max(0.0));
        let sum: f64 = positive.iter().sum();
        Self {
            vertex: NONE,
            point: NONE,
            of,
            weights: if sum > 0.0 && sum.is_finite() {
                positive.map(|w| w / sum)
            } else {
                [1.0, 0.0, 0.0]
            },
        }
    }
}

impl RegionFace {
    /// At which corner `point` is.
    pub fn corner_of(&self, point: u32) -> Option<usize> {
        self.points.iter().position(|&p| p == point)
    }

    /// The wedge at `point`.
    pub fn wedge_at(&self, point: u32) -> Option<u32> {
        self.corner_of(point).map(|k| self.wedges[k])
    }

    /// Whether the face passes from `a` straight to `b`.
    pub fn has_directed_edge(&self, a: u32, b: u32) -> bool {
        self.corner_of(a).is_some_and(|k| self.points[(k + 1) % 3] == b)
    }
}

/// The faces at an edge from `a` to `b`; [`NONE`] where there is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct EdgeFaces {
    /// The face that passes from `a` to `b`.
    pub left: u32,
    /// The face that passes from `b` to `a`.
    pub right: u32,
    /// More than one face passes it the same way.
    pub tangled: bool,
}

impl EdgeFaces {
    /// The face that is there beside `f`.
    pub fn other_face(self, f: u32) -> Option<u32> {
        self.faces().find(|&g| g != f)
    }

    /// The faces that are there.
    pub fn faces(self) -> impl Iterator<Item = u32> {
        [self.left, self.right].into_iter().filter(|&f| f != NONE)
    }
}

/// A part of a surface under edit; see the module page.
#[derive(Debug, Clone, Default)]
pub(crate) struct RegionMesh {
    /// The gathered points first, then the new ones.
    pub points: Vec<RegionPoint>,
    pub wedges: Vec<Wedge>,
    /// All faces ever; the first are the gathered ones.
    pub faces: Vec<RegionFace>,
    /// The surface's triangle that each gathered face was.
    pub triangles: Vec<u32>,
    /// Edges of drawn curves, smaller point first. Splitting an edge splits its mark.
    pub marked: BTreeSet<(u32, u32)>,
    pub warnings: Vec<EditWarning>,
    /// The surface's points that were moved and stay themselves, and where they are now.
    pub(super) moved: Vec<(u32, DVec3)>,
    /// The point that each marked edge was split at.
    pub(super) split_at: BTreeMap<(u32, u32), u32>,
}

/// Names an edge by its ends, the smaller first.
pub(crate) fn edge_key(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

impl RegionMesh {
    /// Where point `p` is.
    pub fn position(&self, p: u32) -> DVec3 {
        self.points[p as usize].position
    }

    /// Living faces around point `p`.
    pub fn faces_around(&self, p: u32) -> &[u32] {
        &self.points[p as usize].faces
    }

    /// Points at the corners of face `f`.
    pub fn points_of(&self, f: u32) -> [u32; 3] {
        self.faces[f as usize].points
    }

    /// Positions of the corners of face `f`.
    pub fn corner_positions(&self, f: u32) -> [DVec3; 3] {
        self.points_of(f).map(|p| self.position(p))
    }

    /// Twice the area of face `f` times its normal.
    pub fn area_normal(&self, f: u32) -> DVec3 {
        triangle::area_normal(self.corner_positions(f))
    }

    /// The distance of two points.
    pub fn edge_length(&self, a: u32, b: u32) -> f64 {
        self.position(a).distance(self.position(b))
    }

    /// How many points were gathered, when none of them was moved by [`move_point`](Self::move_point).
    pub fn gathered_points(&self) -> usize {
        self.points.partition_point(|p| p.old != NONE)
    }

    /// The number here of a point of the surface, in a mesh whose gathered points rise.
    pub fn find_point(&self, old: u32) -> Option<u32> {
        let gathered = &self.points[..self.gathered_points()];
        gathered.binary_search_by_key(&old, |p| p.old).ok().map(|p| p as u32)
    }

    /// The number here of a triangle of the surface, in a mesh whose gathered faces rise.
    pub fn find_face(&self, triangle: u32) -> Option<u32> {
        self.triangles.binary_search(&triangle).ok().map(|f| f as u32)
    }

    /// The faces around an end of an edge: `a`, but for one with very many faces.
    fn faces_at_an_end(&self, a: u32, b: u32) -> &[u32] {
        let [at_a, at_b] = [a, b].map(|p| self.faces_around(p));
        if at_a.len() > MANY_FACES && at_b.len() < at_a.len() {
            at_b
        } else {
            at_a
        }
    }

    /// Living faces along the edge between two points, however many.
    pub fn faces_along(&self, a: u32, b: u32) -> impl Iterator<Item = u32> + '_ {
        let faces = self.faces_at_an_end(a, b).iter().copied();
        faces.filter(move |&f| [a, b].iter().all(|&p| self.faces[f as usize].corner_of(p).is_some()))
    }

    /// Whether two points are joined by an edge.
    pub fn has_edge(&self, a: u32, b: u32) -> bool {
        self.faces_along(a, b).next().is_some()
    }

    /// The faces at the edge from `a` to `b`, by side.
    pub fn edge_faces(&self, a: u32, b: u32) -> EdgeFaces {
        let mut edge = EdgeFaces {
            left: NONE,
            right: NONE,
            tangled: false,
        };
        for &f in self.faces_at_an_end(a, b) {
            let p = self.points_of(f);
            for i in 0..3 {
                let side = if p[i] == a && p[(i + 1) % 3] == b {
                    &mut edge.left
                } else if p[i] == b && p[(i + 1) % 3] == a {
                    &mut edge.right
                } else {
                    continue;
                };
                edge.tangled |= *side != NONE;
                *side = f;
            }
        }
        edge
    }

    /// The wedge of face `f` at point `p`; `None` when `p` is none of its corners.
    pub fn wedge_at(&self, f: u32, p: u32) -> Option<u32> {
        self.faces[f as usize].wedge_at(p)
    }

    /// The corner of face `f` that is neither `a` nor `b`.
    pub fn opposite_corner(&self, f: u32, a: u32, b: u32) -> Option<u32> {
        self.points_of(f).into_iter().find(|&p| p != a && p != b)
    }

    /// Whether the two faces at an edge show the same wedges along it.
    pub fn is_smooth(&self, edge: EdgeFaces, a: u32, b: u32) -> bool {
        edge.left != NONE
            && edge.right != NONE
            && [a, b]
                .into_iter()
                .all(|p| self.wedge_at(edge.left, p) == self.wedge_at(edge.right, p))
    }

    /// Whether an edge may not be changed at all: a face outside the region lies there, or more than two faces meet.
    pub fn is_locked(&self, edge: EdgeFaces) -> bool {
        edge.tangled || edge.faces().any(|f| self.faces[f as usize].frozen)
    }

    /// Whether the edge has a face of the region on either side and the same wedges on both.
    pub fn is_inside(&self, edge: EdgeFaces, a: u32, b: u32) -> bool {
        !self.is_locked(edge) && self.is_smooth(edge, a, b)
    }

    /// Points that share an edge with `p`, rising.
    pub fn neighbours(&self, p: u32) -> Vec<u32> {
        let faces = self.faces_around(p);
        let mut around: Vec<u32> = Vec::with_capacity(2 * faces.len());
        for &f in faces {
            around.extend(self.points_of(f).into_iter().filter(|&q| q != p));
        }
        around.sort_unstable();
        around.dedup();
        around
    }

    /// How many points share an edge with `p`, and how many faces are there: equal in the inside of a surface.
    pub fn valence(&self, p: u32) -> (usize, usize) {
        let mut links = self.fan_links(p);
        links.sort_unstable();
        // In a fan each neighbour is the next corner of one face, but the last of an open one.
        let is_next = |q: &u32| links.binary_search_by_key(q, |(next, _)| *next).is_ok();
        let ends = links.iter().filter(|(_, last)| !is_next(last));
        (links.len() + ends.count(), links.len())
    }

    /// For each face around `p` the corner after and the corner before it.
    pub fn fan_links(&self, p: u32) -> Vec<(u32, u32)> {
        let link = |&f: &u32| {
            let face = &self.faces[f as usize];
            let i = face.corner_of(p)?;
            Some((face.points[(i + 1) % 3], face.points[(i + 2) % 3]))
        };
        self.faces_around(p).iter().filter_map(link).collect()
    }

    /// Whether the faces around `p` make one fan, open or closed, that turns one way.
    pub fn is_single_fan(&self, p: u32) -> bool {
        is_single_oriented_fan(&mut self.fan_links(p))
    }

    /// All edges that the living faces of the region have, smaller end first, sorted.
    pub fn edges(&self) -> Vec<(u32, u32)> {
        self.edges_from(0, |face| !face.frozen)
    }

    /// All edges of the living faces from number `first` on, closing ones included, smaller end first, sorted.
    pub fn edges_from(&self, first: usize, wanted: impl Fn(&RegionFace) -> bool) -> Vec<(u32, u32)> {
        let mut edges = Vec::with_capacity((self.faces.len() - first) * 3);
        for face in self.faces[first..].iter().filter(|f| f.alive && wanted(f)) {
            let [a, b, c] = face.points;
            edges.extend([edge_key(a, b), edge_key(b, c), edge_key(c, a)]);
        }
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// Numbers of the living faces of the region.
    pub fn living_faces(&self) -> impl Iterator<Item = u32> {
        let faces = self.faces.iter().zip(0u32..);
        faces.filter(|(face, _)| face.alive && !face.frozen).map(|(_, f)| f)
    }

    /// The sides of living faces that no other face lies along, for which `wanted` (asked with both ends in the face's
    /// order) says yes; as from, to, face.
    pub fn open_sides(&self, wanted: impl Fn(u32, u32) -> bool) -> Vec<(u32, u32, u32)> {
        let mut sides = Vec::new();
        for (face, f) in self.faces.iter().zip(0u32..).filter(|(face, _)| face.alive) {
            for k in 0..3 {
                let (a, b) = (face.points[k], face.points[(k + 1) % 3]);
                if wanted(a, b) && self.faces_along(a, b).nth(1).is_none() {
                    sides.push((a, b, f));
                }
            }
        }
        sides
    }
}

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
    use crate::surface::TestSurface;

    #[test]
    fn a_point_where_very_many_faces_meet_has_the_edges_and_neighbours_that_others_have() {
        let count = 3 * MANY_FACES as u32;
        let positions: Vec<DVec3> = (0..=count).map(|k| DVec3::splat(f64::from(k))).collect();
        let ring: Vec<[u32; 3]> = (0..count).map(|k| [0, 1 + k, 1 + (k + 1) % count]).collect();
        let points: Vec<u32> = (0..=count).collect();
        for (faces, ends) in [(&ring[..], 0), (&ring[1..], 1)] {
            let surface = TestSurface::new(&positions[..], faces);
            let mesh = RegionMesh::from_triangles(&surface.view(), (0..faces.len() as u32).collect());
            assert_eq!(mesh.neighbours(0), points[1..]);
            assert_eq!(mesh.valence(0), (faces.len() + ends, faces.len()));
            let mut sides = 0;
            for &spoke in &points[1..] {
                let (out, back) = (mesh.edge_faces(0, spoke), mesh.edge_faces(spoke, 0));
                assert_eq!((out.left, out.right), (back.right, back.left));
                assert!(mesh.faces_along(0, spoke).eq(mesh.faces_along(spoke, 0)));
                sides += mesh.faces_along(0, spoke).count();
            }
            assert_eq!(sides, 2 * faces.len());
            assert!(mesh.has_edge(3, 0) && !mesh.has_edge(1, 3));
        }
    }

    /// A fan of six triangles around point 0.
    fn hexagon() -> RegionMesh {
        let angle = |k: u32| f64::from(k) * std::f64::consts::TAU / 6.0;
        let ring = (0..6).map(|k| DVec3::new(libm::cos(angle(k)), libm::sin(angle(k)), 0.0));
        let faces: Vec<[u32; 3]> = (0..6u32).map(|k| [0, 1 + k, 1 + (k + 1) % 6]).collect();
        let positions: Vec<DVec3> = std::iter::once(DVec3::ZERO).chain(ring).collect();
        RegionMesh::with_ring(&TestSurface::new(positions, faces).view(), &[0, 1, 2, 3, 4, 5])
    }

    fn roots(mesh: &RegionMesh) -> Vec<u32> {
        mesh.points[7..].iter().map(|p| p.root).collect()
    }

    #[test]
    fn a_cut_across_parts_and_a_cut_to_the_middle_does_not_part_the_middle() {
        let mut mesh = hexagon();
        mesh.open_fans(&BTreeSet::from([(0, 1), (0, 4)]));
        // The middle and both ends.
        assert_eq!(mesh.points.len(), 7 + 3);
        assert_eq!(roots(&mesh), [0, 1, 4]);
        assert!(mesh.points.iter().all(|p| (1..=3).contains(&p.faces.len())));
        let mut mesh = hexagon();
        mesh.open_fans(&BTreeSet::from([(0, 1)]));
        assert_eq!(roots(&mesh), [1], "the rim opens, the middle holds");
        assert_eq!(mesh.faces_around(0).len(), 6);
    }

    #[test]
    fn faces_left_corner_to_corner_get_points_of_their_own() {
        let mut mesh = hexagon();
        [1, 3, 5].into_iter().for_each(|f| mesh.remove_face(f));
        mesh.open_fans(&BTreeSet::new());
        assert_eq!(roots(&mesh), [0, 0]);
        assert!(mesh.open_sides(|_, _| true).len() == 9);
    }
}
