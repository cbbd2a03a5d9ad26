//! Changing faces in place: an edge is split or turned, a point moved.

use super::mesh::{EdgeFaces, RegionFace, RegionMesh, Wedge};
use crate::mesh::NONE;
use glam::DVec3;

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
