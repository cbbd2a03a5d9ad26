//! A piece of a surface while it is being edited: split, flipped, cut open, capped.
//!
//! Points and faces are local. Each face corner has a *wedge*: what the attributes there are blended from. Two faces
//! that share a render vertex share its wedge, so splitting an edge makes one new wedge where the sides agree and one
//! per side along a seam, without knowing what a seam is.

use super::Surface;
use super::local::Local;
use crate::mesh::NONE;
use glam::DVec3;
use std::collections::{BTreeMap, BTreeSet};

/// In [`Face::source`]: the face is new, it closes a hole.
pub(super) const CAP: u32 = u32::MAX;

/// What the attributes of a face corner are made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Wedge {
    /// The old render vertex that it still is, or [`NONE`].
    pub vertex: u32,
    /// Old render vertices.
    pub of: [u32; 3],
    /// Their weights.
    pub weights: [f64; 3],
}

/// A triangle of a draft.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Face {
    /// Draft points.
    pub corners: [u32; 3],
    /// Wedges at the corners.
    pub wedges: [u32; 3],
    /// The local face that it is part of, or [`CAP`].
    pub source: u32,
    /// The primitive that it belongs to.
    pub primitive: u32,
    /// Whether it is still there.
    pub alive: bool,
}

impl Face {
    /// At which corner `point` is.
    pub fn corner_of(&self, point: u32) -> Option<usize> {
        self.corners.iter().position(|&p| p == point)
    }

    /// The wedge at `point`.
    pub fn wedge_at(&self, point: u32) -> Option<u32> {
        self.corner_of(point).map(|k| self.wedges[k])
    }
}

/// A local piece of a surface under edit.
pub(super) struct Draft<'a> {
    pub surface: &'a Surface<'a>,
    pub local: Local,
    /// Where each point is: the local points first, then the new ones.
    pub positions: Vec<DVec3>,
    /// Whether the faces around each point are all here; true for new ones.
    pub whole: Vec<bool>,
    /// For a point that was split off from another by opening the surface, that one; else itself.
    pub root: Vec<u32>,
    /// All faces ever; the first are the local ones.
    pub faces: Vec<Face>,
    /// Faces around each point that are alive.
    pub around: Vec<Vec<u32>>,
    pub wedges: Vec<Wedge>,
    /// Edges of drawn curves, smaller point first. Splitting an edge splits its mark.
    pub marked: BTreeSet<(u32, u32)>,
    /// The point that each marked edge was split at.
    pub split_at: BTreeMap<(u32, u32), u32>,
    pub warnings: Vec<(String, String, String)>,
    blends: BTreeMap<(u32, u32, u32), u32>,
}

/// The smaller first.
pub(super) fn key(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

impl<'a> Draft<'a> {
    pub fn new(surface: &'a Surface<'a>, local: Local) -> Self {
        let mut vertices: Vec<u32> = local.vertices.iter().flatten().copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        let wedge = |v: u32| vertices.partition_point(|&w| w < v) as u32;
        let faces = (local.corners.iter().zip(&local.vertices).zip(0u32..))
            .map(|((&corners, t), f)| Face {
                corners,
                wedges: t.map(wedge),
                source: f,
                primitive: surface.primitive_of[local.faces[f as usize] as usize],
                alive: true,
            })
            .collect();
        let points = local.points.len();
        Self {
            surface,
            positions: local.positions.clone(),
            whole: local.whole.clone(),
            root: (0..points as u32).collect(),
            faces,
            around: (0..points as u32).map(|p| local.around.of(p).to_vec()).collect(),
            wedges: (vertices.iter())
                .map(|&v| Wedge {
                    vertex: v,
                    of: [v; 3],
                    weights: [1.0, 0.0, 0.0],
                })
                .collect(),
            marked: BTreeSet::new(),
            split_at: BTreeMap::new(),
            warnings: Vec::new(),
            blends: BTreeMap::new(),
            local,
        }
    }

    /// A new point without faces.
    pub fn add_point(&mut self, position: DVec3) -> u32 {
        let point = self.positions.len() as u32;
        self.positions.push(position);
        self.whole.push(true);
        self.root.push(point);
        self.around.push(Vec::new());
        point
    }

    pub fn add_face(&mut self, corners: [u32; 3], wedges: [u32; 3], source: u32, primitive: u32) -> u32 {
        let face = self.faces.len() as u32;
        self.faces.push(Face {
            corners,
            wedges,
            source,
            primitive,
            alive: true,
        });
        for p in corners {
            self.around[p as usize].push(face);
        }
        face
    }

    pub fn kill(&mut self, face: u32) {
        let f = &mut self.faces[face as usize];
        if std::mem::replace(&mut f.alive, false) {
            for p in f.corners {
                self.around[p as usize].retain(|&g| g != face);
            }
        }
    }

    /// Faces along the edge between two points.
    pub fn along(&self, a: u32, b: u32) -> impl Iterator<Item = u32> + '_ {
        let faces = self.around[a as usize].iter().copied();
        faces.filter(move |&f| self.faces[f as usize].corner_of(b).is_some())
    }

    pub fn has_edge(&self, a: u32, b: u32) -> bool {
        self.along(a, b).next().is_some()
    }

    /// Twice the area of a face times its normal.
    pub fn area_normal(&self, face: u32) -> DVec3 {
        let [a, b, c] = self.faces[face as usize].corners.map(|p| self.positions[p as usize]);
        (b - a).cross(c - a)
    }

    /// A wedge at `point` mixed from others; the same mix at the same point is the same wedge.
    pub fn blend(&mut self, parts: &[(u32, f64)]) -> u32 {
        let mut sum: Vec<(u32, f64)> = Vec::with_capacity(3 * parts.len());
        for &(wedge, share) in parts {
            let w = self.wedges[wedge as usize];
            for (of, weight) in w.of.into_iter().zip(w.weights) {
                let weight = weight * share;
                if weight > 0.0 {
                    match sum.iter_mut().find(|s| s.0 == of) {
                        Some(s) => s.1 += weight,
                        None => sum.push((of, weight)),
                    }
                }
            }
        }
        // Three carry the blend; inside one old triangle there are no more.
        sum.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        sum.truncate(3);
        let total: f64 = sum.iter().map(|s| s.1).sum();
        let first = sum.first().map_or(0, |s| s.0);
        let mut wedge = Wedge {
            vertex: NONE,
            of: [first; 3],
            weights: [0.0; 3],
        };
        for (k, s) in sum.iter().enumerate() {
            wedge.of[k] = s.0;
            wedge.weights[k] = s.1 / total;
        }
        self.wedges.push(wedge);
        self.wedges.len() as u32 - 1
    }

    /// A wedge of its own with the blend of another: a hard edge.
    pub fn own_wedge(&mut self, wedge: u32) -> u32 {
        let copy = Wedge {
            vertex: NONE,
            ..self.wedges[wedge as usize]
        };
        self.wedges.push(copy);
        self.wedges.len() as u32 - 1
    }

    /// Splits the edge from `a` to `b` at the fraction `t` with a new point at `position`, in all faces along it. Each
    /// face becomes two; the new point is joined to its far corner.
    pub fn split_edge(&mut self, a: u32, b: u32, t: f64, position: DVec3) -> u32 {
        let m = self.add_point(position);
        let faces: Vec<u32> = self.along(a, b).collect();
        for f in faces {
            let face = self.faces[f as usize];
            let (Some(ka), Some(kb)) = (face.corner_of(a), face.corner_of(b)) else {
                continue;
            };
            let (wa, wb) = (face.wedges[ka], face.wedges[kb]);
            let wedge = match self.blends.get(&(m, wa, wb)) {
                Some(&w) => w,
                None => {
                    let w = self.blend(&[(wa, 1.0 - t), (wb, t)]);
                    self.blends.insert((m, wa, wb), w);
                    w
                }
            };
            self.kill(f);
            for k in [kb, ka] {
                let (mut corners, mut wedges) = (face.corners, face.wedges);
                corners[k] = m;
                wedges[k] = wedge;
                self.add_face(corners, wedges, face.source, face.primitive);
            }
        }
        if self.marked.remove(&key(a, b)) {
            self.marked.insert(key(a, m));
            self.marked.insert(key(m, b));
            self.split_at.insert(key(a, b), m);
        }
        m
    }

    /// Splits a face into three at a new point with the given shares of its corners.
    pub fn split_face(&mut self, f: u32, shares: [f64; 3], position: DVec3) -> u32 {
        let m = self.add_point(position);
        let face = self.faces[f as usize];
        let [a, b, c] = face.wedges;
        let wedge = self.blend(&[(a, shares[0]), (b, shares[1]), (c, shares[2])]);
        self.kill(f);
        for k in 0..3 {
            let (mut corners, mut wedges) = (face.corners, face.wedges);
            corners[k] = m;
            wedges[k] = wedge;
            self.add_face(corners, wedges, face.source, face.primitive);
        }
        m
    }

    /// The two faces along an edge and the corners opposite to it, when the edge may be exchanged for the one between
    /// those: two faces of one origin, wound alike, that share their wedges, and no such edge yet.
    pub fn flippable(&self, a: u32, b: u32) -> Option<[(u32, u32); 2]> {
        let mut along = self.along(a, b);
        let (f, g) = (along.next()?, along.next()?);
        let (one, two) = (self.faces[f as usize], self.faces[g as usize]);
        if along.next().is_some() || one.source != two.source || one.primitive != two.primitive {
            return None;
        }
        let after = |face: &Face| face.corner_of(a).map(|k| face.corners[(k + 1) % 3] == b);
        let same = one.wedge_at(a) == two.wedge_at(a) && one.wedge_at(b) == two.wedge_at(b);
        if after(&one) == after(&two) || !same || self.marked.contains(&key(a, b)) {
            return None;
        }
        let far = |face: &Face| face.corners.into_iter().find(|&p| p != a && p != b);
        let (p, q) = (far(&one)?, far(&two)?);
        (p != q && !self.has_edge(p, q)).then_some([(f, p), (g, q)])
    }

    /// Exchanges the edge between `a` and `b` for the one between the corners opposite to it; what
    /// [`flippable`](Self::flippable) answered says which.
    pub fn flip(&mut self, a: u32, b: u32, [(f, p), (g, q)]: [(u32, u32); 2]) {
        let (one, two) = (self.faces[f as usize], self.faces[g as usize]);
        let (Some(kb), Some(ka), Some(wp), Some(wq)) =
            (one.corner_of(b), two.corner_of(a), one.wedge_at(p), two.wedge_at(q))
        else {
            return;
        };
        // (a, b, p) and (b, a, q) become (a, q, p) and (b, p, q), whichever way round.
        let (mut first, mut second) = (one, two);
        (first.corners[kb], first.wedges[kb]) = (q, wq);
        (second.corners[ka], second.wedges[ka]) = (p, wp);
        self.kill(f);
        self.kill(g);
        self.add_face(first.corners, first.wedges, one.source, one.primitive);
        self.add_face(second.corners, second.wedges, two.source, two.primitive);
    }

    /// The marked edges between two points, in order, following how an edge was split since.
    pub fn unfold(&self, a: u32, b: u32) -> Vec<u32> {
        let (mut path, mut open) = (vec![a], vec![(a, b)]);
        while let Some((from, to)) = open.pop() {
            match self.split_at.get(&key(from, to)) {
                Some(&m) => open.extend([(m, to), (from, m)]),
                None => path.push(to),
            }
        }
        path
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::{Applied, Patch, apply};

    const POSITIONS: [DVec3; 5] = [
        DVec3::new(0.0, 0.0, 0.0),
        DVec3::new(2.0, 0.0, 0.0),
        DVec3::new(2.0, 2.0, 0.0),
        DVec3::new(2.0, 2.0, 0.0),
        DVec3::new(0.0, 2.0, 0.0),
    ];

    /// A square whose diagonal 0–2 is a seam at point 2 only: vertices 2 and 3 are that point.
    fn square() -> Surface<'static> {
        Surface {
            positions: &POSITIONS,
            triangles: &[[0, 1, 2], [0, 3, 4]],
            primitive_of: &[0, 0],
            point_of: &[0, 1, 2, 2, 3],
            points: 4,
        }
    }

    fn done(draft: Draft<'_>) -> (Patch, Applied) {
        let surface = *draft.surface;
        let (patch, _) = draft.finish(Vec::new()).expect("finite");
        let applied = apply(&surface, &patch, &[0]).expect("applies");
        (patch, applied)
    }

    #[test]
    fn an_untouched_draft_is_an_empty_patch() {
        let s = square();
        assert_eq!(done(Draft::new(&s, Local::of(&s, vec![0, 1]))).0, Patch::default());
    }

    #[test]
    fn a_split_seam_gets_a_vertex_per_side_and_one_point() {
        let s = square();
        let mut draft = Draft::new(&s, Local::of(&s, vec![0, 1]));
        let m = draft.split_edge(0, 2, 0.25, DVec3::new(0.5, 0.5, 0.0));
        assert_eq!(draft.around[m as usize].len(), 4);
        let (patch, applied) = done(draft);
        assert_eq!(
            (patch.vertices.len(), applied.points, applied.triangles.len()),
            (2, 5, 4)
        );
        for (vertex, far) in patch.vertices.iter().zip([2, 3]) {
            assert_eq!(
                (vertex.point, vertex.of, vertex.weights),
                (4, [0, far, 0], [0.75, 0.25, 0.0])
            );
        }
    }

    #[test]
    fn splits_of_splits_are_blended_from_old_vertices() {
        let s = square();
        let mut draft = Draft::new(&s, Local::of(&s, vec![0]));
        let inside = draft.split_face(0, [0.5, 0.25, 0.25], DVec3::new(1.0, 0.5, 0.0));
        draft.split_edge(0, inside, 0.5, DVec3::new(0.5, 0.25, 0.0));
        let (patch, applied) = done(draft);
        let last = patch
            .vertices
            .iter()
            .find(|v| v.position.y == 0.25)
            .expect("the second");
        assert_eq!((last.of, last.weights), ([0, 1, 2], [0.75, 0.125, 0.125]));
        assert_eq!(applied.triangles.len(), 1 + 5);
    }

    #[test]
    fn marks_follow_splits_and_flips_keep_the_winding() {
        let s = square();
        let mut draft = Draft::new(&s, Local::of(&s, vec![0, 1]));
        draft.marked.insert((0, 2));
        let m = draft.split_edge(2, 0, 0.5, DVec3::new(1.0, 1.0, 0.0));
        assert_eq!(draft.unfold(2, 0), [2, m, 0]);
        assert!(draft.marked.contains(&key(0, m)) && !draft.marked.contains(&(0, 2)));
        assert!(
            draft.flippable(0, m).is_none(),
            "it is marked, and between two old faces"
        );
        let (one, two) = (draft.along(m, 1).collect::<Vec<_>>(), draft.flippable(m, 1));
        assert_eq!(one.len(), 2);
        let pair = two.expect("inside one old face");
        draft.flip(m, 1, pair);
        assert!(draft.has_edge(0, 2) && !draft.has_edge(m, 1));
        assert!(
            (0..draft.faces.len() as u32)
                .filter(|&f| draft.faces[f as usize].alive)
                .all(|f| draft.area_normal(f).z >= 0.0)
        );
    }
}
