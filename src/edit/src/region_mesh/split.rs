//! Changing faces by replacement: points and faces are added, faces removed, split and flipped. A piece remembers the face
//! that it comes from.
//!
//! Collapsing an edge into one of its ends.
//!
//! Changing faces in place: an edge is split or turned, a point moved.

use super::mesh::{CAP, EdgeFaces, RegionFace, RegionMesh, RegionPoint, Wedge, edge_key};
use crate::triangle::evenness;
use glam::DVec3;
use pliant_exec::progress::{Cancelled, Progress, check};
use pliant_mesh::NONE;

impl RegionMesh {
    /// Adds a point without faces.
    pub fn add_point(&mut self, position: DVec3) -> u32 {
        let point = self.points.len() as u32;
        self.points.push(RegionPoint {
            position,
            old: NONE,
            faces: Vec::new(),
            whole: true,
            fixed: false,
            root: point,
        });
        point
    }

    /// Moves a gathered point that stays the surface's own, with all faces around it, those outside the mesh included.
    pub fn move_surface_point(&mut self, p: u32, position: DVec3) {
        let point = &mut self.points[p as usize];
        if position != point.position {
            self.moved.push((point.old, position));
        }
        point.position = position;
    }

    /// Adds a wedge.
    pub fn add_wedge(&mut self, wedge: Wedge) -> u32 {
        self.wedges.push(wedge);
        self.wedges.len() as u32 - 1
    }

    /// Adds a face, of a part of the gathered face `source` or [`CAP`].
    pub fn add_face(&mut self, points: [u32; 3], wedges: [u32; 3], source: u32, primitive: u32) -> u32 {
        let face = self.faces.len() as u32;
        self.faces.push(RegionFace {
            points,
            wedges,
            primitive,
            source,
            untouched: false,
            frozen: false,
            alive: true,
        });
        for p in points {
            self.points[p as usize].faces.push(face);
        }
        face
    }

    /// Takes a face out.
    pub fn remove_face(&mut self, face: u32) {
        let f = &mut self.faces[face as usize];
        if std::mem::replace(&mut f.alive, false) {
            for p in f.points {
                self.points[p as usize].faces.retain(|&g| g != face);
            }
        }
    }

    /// Adds a wedge that is mixed from others.
    pub fn blend_wedges(&mut self, parts: &[(u32, f64)]) -> u32 {
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
            point: NONE,
            of: [first; 3],
            weights: [0.0; 3],
        };
        for (k, s) in sum.iter().enumerate() {
            wedge.of[k] = s.0;
            wedge.weights[k] = s.1 / total;
        }
        self.add_wedge(wedge)
    }

    /// Adds a wedge of its own with the blend of another: a hard edge.
    pub fn add_hard_wedge(&mut self, wedge: u32) -> u32 {
        let copy = Wedge {
            vertex: NONE,
            ..self.wedges[wedge as usize]
        };
        self.add_wedge(copy)
    }

    /// Splits the edge from `a` to `b` at the fraction `t` with a new point at `position`, in all faces along it. Each
    /// face becomes two; the new point is joined to its far corner.
    pub fn split_edge(&mut self, a: u32, b: u32, t: f64, position: DVec3) -> u32 {
        let m = self.add_point(position);
        let faces: Vec<u32> = self.faces_along(a, b).collect();
        // The new wedge between each pair of wedges: one where both sides agree.
        let mut made: Vec<([u32; 2], u32)> = Vec::new();
        for f in faces {
            let face = self.faces[f as usize];
            let (Some(ka), Some(kb)) = (face.corner_of(a), face.corner_of(b)) else {
                continue;
            };
            let (wa, wb) = (face.wedges[ka], face.wedges[kb]);
            let wedge = match made.iter().find(|w| w.0 == [wa, wb]) {
                Some(&(_, w)) => w,
                None => {
                    let w = self.blend_wedges(&[(wa, 1.0 - t), (wb, t)]);
                    made.push(([wa, wb], w));
                    w
                }
            };
            self.remove_face(f);
            for k in [kb, ka] {
                let (mut points, mut wedges) = (face.points, face.wedges);
                points[k] = m;
                wedges[k] = wedge;
                self.add_face(points, wedges, face.source, face.primitive);
            }
        }
        if self.marked.remove(&edge_key(a, b)) {
            self.marked.insert(edge_key(a, m));
            self.marked.insert(edge_key(m, b));
            self.split_at.insert(edge_key(a, b), m);
        }
        m
    }

    /// Splits a face into three at a new point with the given shares of its corners.
    pub fn split_face(&mut self, f: u32, shares: [f64; 3], position: DVec3) -> u32 {
        let m = self.add_point(position);
        let face = self.faces[f as usize];
        let [a, b, c] = face.wedges;
        let wedge = self.blend_wedges(&[(a, shares[0]), (b, shares[1]), (c, shares[2])]);
        self.remove_face(f);
        for k in 0..3 {
            let (mut points, mut wedges) = (face.points, face.wedges);
            points[k] = m;
            wedges[k] = wedge;
            self.add_face(points, wedges, face.source, face.primitive);
        }
        m
    }

    /// The two faces along an edge with the corners opposite to it, when the edge can be flipped to join these corners:
    /// it is not marked, its faces have one origin and share their wedges, and the corners have no edge yet.
    pub fn flippable_pair(&self, a: u32, b: u32) -> Option<[(u32, u32); 2]> {
        if !self.is_inside(self.edge_faces(a, b), a, b) || self.marked.contains(&edge_key(a, b)) {
            return None;
        }
        let mut along = self.faces_along(a, b);
        let (f, g) = (along.next()?, along.next()?);
        let (one, two) = (self.faces[f as usize], self.faces[g as usize]);
        if one.source != two.source || one.primitive != two.primitive {
            return None;
        }
        let (p, q) = (self.opposite_corner(f, a, b)?, self.opposite_corner(g, a, b)?);
        (p != q && !self.has_edge(p, q)).then_some([(f, p), (g, q)])
    }

    /// Whether exchanging the edge of a [flippable pair](Self::flippable_pair) leaves two faces that look the way the
    /// two did.
    pub fn flip_keeps_sides(&self, a: u32, b: u32, pair: [(u32, u32); 2]) -> bool {
        let [(f, p), (g, q)] = pair;
        let normal = self.area_normal(f) + self.area_normal(g);
        let area = |a: u32, b: u32, c: u32| {
            let at = |p: u32| self.position(p);
            (at(b) - at(a)).cross(at(c) - at(a)).dot(normal)
        };
        let (first, second) = if self.faces[f as usize].has_directed_edge(a, b) {
            (area(a, q, p), area(b, p, q))
        } else {
            (area(a, p, q), area(b, q, p))
        };
        first > 0.0 && second > 0.0
    }

    /// Exchanges the edge between `a` and `b` for the one between the corners opposite to it; what
    /// [`flippable_pair`](Self::flippable_pair) answered says which.
    pub fn flip_edge(&mut self, a: u32, b: u32, [(f, p), (g, q)]: [(u32, u32); 2]) {
        let (one, two) = (self.faces[f as usize], self.faces[g as usize]);
        let (Some(kb), Some(ka), Some(wp), Some(wq)) =
            (one.corner_of(b), two.corner_of(a), one.wedge_at(p), two.wedge_at(q))
        else {
            return;
        };
        // (a, b, p) and (b, a, q) become (a, q, p) and (b, p, q), whichever way round.
        let (mut first, mut second) = (one, two);
        (first.points[kb], first.wedges[kb]) = (q, wq);
        (second.points[ka], second.wedges[ka]) = (p, wp);
        self.remove_face(f);
        self.remove_face(g);
        self.add_face(first.points, first.wedges, one.source, one.primitive);
        self.add_face(second.points, second.wedges, two.source, two.primitive);
    }

    /// Exchanges edges inside gathered faces where that makes the smallest angle larger: splitting an edge joins the new
    /// point to whatever corner is opposite.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn improve_split_faces(
        &mut self,
        kept: impl Fn(u32, u32) -> bool,
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        let edges = self.edges_from(self.triangles.len(), |f| f.source != CAP);
        for (k, (a, b)) in edges.into_iter().enumerate() {
            if k.is_multiple_of(512) {
                check(progress)?;
            }
            if !kept(a, b) {
                self.exchange_for_fairer(a, b);
            }
        }
        Ok(())
    }

    /// Exchanges the edge between `a` and `b`, inside a gathered face, where that makes the smallest angle larger. Answers the
    /// ends of the edge that is there then.
    pub fn exchange_for_fairer(&mut self, a: u32, b: u32) -> Option<(u32, u32)> {
        let pair = self.flippable_pair(a, b)?;
        let [p, q] = pair.map(|(_, tip)| tip);
        let [a_at, b_at, p_at, q_at] = [a, b, p, q].map(|p| self.position(p));
        let before = evenness([a_at, b_at, p_at]).min(evenness([a_at, b_at, q_at]));
        let after = evenness([a_at, p_at, q_at]).min(evenness([b_at, p_at, q_at]));
        if after <= before * (1.0 + 1e-9) || !self.flip_keeps_sides(a, b, pair) {
            return None;
        }
        self.flip_edge(a, b, pair);
        Some((p, q))
    }

    /// The points along a marked edge, both ends included, as it was split since.
    pub fn points_along_mark(&self, a: u32, b: u32) -> Vec<u32> {
        let (mut path, mut open) = (vec![a], vec![(a, b)]);
        while let Some((from, to)) = open.pop() {
            match self.split_at.get(&edge_key(from, to)) {
                Some(&m) => open.extend([(m, to), (from, m)]),
                None => path.push(to),
            }
        }
        path
    }
}

/// A collapse of an edge that keeps the surface's topology: what becomes of the wedges and faces of the point that goes.
#[derive(Debug, Clone)]
pub(crate) struct EdgeCollapse {
    from: u32,
    to: u32,
    /// Faces at the edge, which go.
    gone: [u32; 2],
    /// Faces that stay and get another corner.
    pub kept: Vec<u32>,
    /// Wedges of the point that goes and what replaces them.
    wedges: [(u32, u32); 2],
}

impl RegionMesh {
    /// Looks whether point `from` can be moved into its neighbour `to` without changing the topology: the two may have
    /// no common neighbours but those across their edge, no face may fall onto another, and each wedge at `from` must
    /// meet one wedge at `to`. The caller sees to it that `from` is inside, or on a curve that the edge belongs to.
    pub fn plan_collapse(&self, from: u32, to: u32) -> Option<EdgeCollapse> {
        let edge = self.edge_faces(from, to);
        if self.points[from as usize].fixed || self.is_locked(edge) {
            return None;
        }
        let mut wedges = [(NONE, NONE); 2];
        let mut across = [NONE; 2];
        for (slot, f) in edge.faces().enumerate() {
            wedges[slot] = (self.wedge_at(f, from)?, self.wedge_at(f, to)?);
            across[slot] = self.opposite_corner(f, from, to)?;
        }
        if wedges[0].0 == wedges[1].0 && wedges[0].1 != wedges[1].1 && wedges[1].0 != NONE {
            return None;
        }
        let around = self.neighbours(from);
        let common = around.into_iter().filter(|&q| q != to && self.has_edge(q, to));
        let mut shared = 0;
        for q in common {
            if !across.contains(&q) {
                return None;
            }
            shared += 1;
        }
        if shared != edge.faces().count() || (across[0] == across[1] && across[0] != NONE) {
            return None;
        }
        let mut kept = Vec::with_capacity(self.faces_around(from).len());
        for &f in self.faces_around(from) {
            if f == edge.left || f == edge.right {
                continue;
            }
            let own = self.wedge_at(f, from)?;
            if !wedges.iter().any(|w| w.0 == own) {
                return None;
            }
            // The one way left for two faces to fall together: `from` has three faces and lies over a face of `to`.
            let p = self.points_of(f);
            if across.iter().all(|q| p.contains(q)) {
                let faces = self.faces_around(to);
                if (faces.iter()).any(|&g| across.iter().all(|q| self.points_of(g).contains(q))) {
                    return None;
                }
            }
            kept.push(f);
        }
        if kept.is_empty() {
            return None;
        }
        Some(EdgeCollapse {
            from,
            to,
            gone: [edge.left, edge.right],
            kept,
            wedges,
        })
    }

    /// Each kept face of a collapse before and after.
    pub fn before_and_after(&self, collapse: &EdgeCollapse) -> impl Iterator<Item = (u32, [DVec3; 3], [DVec3; 3])> {
        let to = self.position(collapse.to);
        collapse.kept.iter().map(move |&f| {
            let points = self.points_of(f);
            let before = points.map(|p| self.position(p));
            let mut after = before;
            for (corner, p) in after.iter_mut().zip(points) {
                if p == collapse.from {
                    *corner = to;
                }
            }
            (f, before, after)
        })
    }

    /// Carries out a planned collapse.
    pub fn apply_collapse(&mut self, collapse: &EdgeCollapse) {
        for f in collapse.gone.into_iter().filter(|&f| f != NONE) {
            self.remove_face(f);
        }
        for &f in &collapse.kept {
            let face = &mut self.faces[f as usize];
            for i in 0..3 {
                if face.points[i] != collapse.from {
                    continue;
                }
                face.points[i] = collapse.to;
                if let Some(&(_, with)) = collapse.wedges.iter().find(|w| w.0 == face.wedges[i]) {
                    face.wedges[i] = with;
                }
            }
            face.untouched = false;
        }
        self.points[collapse.from as usize].faces = Vec::new();
        self.points[collapse.to as usize].faces.extend(&collapse.kept);
    }
}

impl RegionMesh {
    /// Puts point `m`, which has no face yet, into the edge from `a` to `b`. The faces to the left and to the right get the
    /// wedges `left` and `right` there.
    pub fn insert_into_edge(&mut self, edge: EdgeFaces, [a, b]: [u32; 2], m: u32, [left, right]: [u32; 2]) {
        // To the right the edge runs from b to a.
        for (f, from, wedge) in [(edge.left, a, left), (edge.right, b, right)] {
            if f == NONE {
                continue;
            }
            let points = self.points_of(f);
            let Some(i) = points.iter().position(|&p| p == from) else {
                continue;
            };
            let mut rest = RegionFace {
                untouched: false,
                ..self.faces[f as usize]
            };
            (rest.wedges[i], rest.points[i]) = (wedge, m);
            let new = self.faces.len() as u32;
            self.faces.push(rest);
            let half = &mut self.faces[f as usize];
            (half.wedges[(i + 1) % 3], half.points[(i + 1) % 3]) = (wedge, m);
            half.untouched = false;
            let (end, tip) = (points[(i + 1) % 3], points[(i + 2) % 3]);
            for g in &mut self.points[end as usize].faces {
                if *g == f {
                    *g = new;
                }
            }
            self.points[tip as usize].faces.push(new);
            self.points[m as usize].faces.extend([f, new]);
        }
    }

    /// The faces that replace those at the edge from `a` to `b` when it is turned, as positions; `None` when the edge is
    /// not inside or the ends of the turned edge are already joined.
    pub fn faces_after_turn(&self, edge: EdgeFaces, a: u32, b: u32) -> Option<[[DVec3; 3]; 2]> {
        if !self.is_inside(edge, a, b) {
            return None;
        }
        let (c, d) = (
            self.opposite_corner(edge.left, a, b)?,
            self.opposite_corner(edge.right, a, b)?,
        );
        if c == d || self.has_edge(c, d) {
            return None;
        }
        let [a, b, c, d] = [a, b, c, d].map(|p| self.position(p));
        Some([[a, d, c], [d, b, c]])
    }

    /// Turns the edge; [`faces_after_turn`](Self::faces_after_turn) must have said that it can be.
    pub fn turn_edge(&mut self, edge: EdgeFaces, a: u32, b: u32) {
        let (l, r) = (edge.left, edge.right);
        let corners = |p, q| Some((self.opposite_corner(p, a, b)?, self.opposite_corner(q, a, b)?));
        let Some((c, d)) = corners(l, r) else { return };
        let wedge = |f, p| self.wedge_at(f, p);
        let (Some(wa), Some(wb), Some(wc), Some(wd)) = (wedge(l, a), wedge(l, b), wedge(l, c), wedge(r, d)) else {
            return;
        };
        for (f, wedges, points) in [(l, [wa, wd, wc], [a, d, c]), (r, [wd, wb, wc], [d, b, c])] {
            let face = &mut self.faces[f as usize];
            (face.wedges, face.points, face.untouched) = (wedges, points, false);
        }
        self.points[a as usize].faces.retain(|&f| f != r);
        self.points[b as usize].faces.retain(|&f| f != l);
        self.points[c as usize].faces.push(r);
        self.points[d as usize].faces.push(l);
    }

    /// Moves a point: it, its wedges and faces become new ones. `blend` gives what each of its wedges is made of.
    pub fn move_point(&mut self, p: u32, position: DVec3, mut blend: impl FnMut(u32) -> ([u32; 3], [f64; 3])) {
        let point = &mut self.points[p as usize];
        point.position = position;
        point.old = NONE;
        let mut wedges: Vec<u32> = Vec::new();
        for &f in &self.points[p as usize].faces {
            self.faces[f as usize].untouched = false;
            wedges.extend(self.faces[f as usize].wedge_at(p));
        }
        wedges.sort_unstable();
        wedges.dedup();
        for w in wedges {
            let (of, weights) = blend(w);
            self.wedges[w as usize] = Wedge::from_blend(of, weights);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::patch::{PatchedSurface, SurfacePatch, apply_patch};
    use crate::surface::SurfaceView;

    const POSITIONS: [DVec3; 5] = [
        DVec3::new(0.0, 0.0, 0.0),
        DVec3::new(2.0, 0.0, 0.0),
        DVec3::new(2.0, 2.0, 0.0),
        DVec3::new(2.0, 2.0, 0.0),
        DVec3::new(0.0, 2.0, 0.0),
    ];

    /// A square whose diagonal 0–2 is a seam at point 2 only: vertices 2 and 3 are that point.
    const SQUARE: SurfaceView<'static> = SurfaceView {
        positions: &POSITIONS,
        triangles: &[[0, 1, 2], [0, 3, 4]],
        primitive_of: &[0, 0],
        point_of: &[0, 1, 2, 2, 3],
        points: 4,
    };

    fn mesh_of(triangles: &[u32]) -> RegionMesh {
        RegionMesh::from_triangles(&SQUARE, triangles.to_vec())
    }

    fn done(mesh: RegionMesh) -> (SurfacePatch, PatchedSurface) {
        let (patch, _) = mesh.into_finite_patch(&SQUARE, Vec::new()).expect("finite");
        let applied = apply_patch(&SQUARE, &patch, &[0]).expect("applies");
        (patch, applied)
    }

    #[test]
    fn an_untouched_mesh_is_an_empty_patch() {
        assert_eq!(done(mesh_of(&[0, 1])).0, SurfacePatch::default());
    }

    #[test]
    fn a_split_seam_gets_a_vertex_per_side_and_one_point() {
        let mut mesh = mesh_of(&[0, 1]);
        let m = mesh.split_edge(0, 2, 0.25, DVec3::new(0.5, 0.5, 0.0));
        assert_eq!(mesh.faces_around(m).len(), 4);
        let (patch, applied) = done(mesh);
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
        let mut mesh = mesh_of(&[0]);
        let inside = mesh.split_face(0, [0.5, 0.25, 0.25], DVec3::new(1.0, 0.5, 0.0));
        mesh.split_edge(0, inside, 0.5, DVec3::new(0.5, 0.25, 0.0));
        let (patch, applied) = done(mesh);
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
        let mut mesh = mesh_of(&[0, 1]);
        mesh.marked.insert((0, 2));
        let m = mesh.split_edge(2, 0, 0.5, DVec3::new(1.0, 1.0, 0.0));
        assert_eq!(mesh.points_along_mark(2, 0), [2, m, 0]);
        assert!(mesh.marked.contains(&edge_key(0, m)) && !mesh.marked.contains(&(0, 2)));
        assert!(
            mesh.flippable_pair(0, m).is_none(),
            "it is marked, and between two old faces"
        );
        let (one, two) = (mesh.faces_along(m, 1).collect::<Vec<_>>(), mesh.flippable_pair(m, 1));
        assert_eq!(one.len(), 2);
        let pair = two.expect("inside one old face");
        mesh.flip_edge(m, 1, pair);
        assert!(mesh.has_edge(0, 2) && !mesh.has_edge(m, 1));
        assert!(
            (0..mesh.faces.len() as u32)
                .filter(|&f| mesh.faces[f as usize].alive)
                .all(|f| mesh.area_normal(f).z >= 0.0)
        );
    }
}
