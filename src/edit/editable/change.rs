//! Splitting and flipping edges, moving points.

use super::{Edge, Editable, Face, Point, Wedge};
use crate::mesh::NONE;
use glam::DVec3;

impl Editable {
    /// Adds a point without faces.
    pub fn add_point(&mut self, position: DVec3) -> u32 {
        self.points.push(Point {
            position,
            old: NONE,
            faces: Vec::new(),
            fixed: false,
        });
        self.points.len() as u32 - 1
    }

    /// Adds a wedge at `point` that is a blend of render vertices.
    pub fn add_wedge(&mut self, point: u32, primitive: u32, of: [u32; 3], weights: [f64; 3]) -> u32 {
        self.wedges.push(Wedge {
            point,
            primitive,
            old: NONE,
            of,
            weights,
        });
        self.wedges.len() as u32 - 1
    }

    /// Puts a point without faces into the edge from `a` to `b`: the face to the left gets the corner `left`, that to the
    /// right `right`. Says which faces were made.
    pub fn split(&mut self, edge: Edge, a: u32, b: u32, left: u32, right: u32) -> [u32; 2] {
        let mut made = [NONE; 2];
        // To the right the edge runs from b to a.
        for (slot, (f, from, wedge)) in [(edge.left, a, left), (edge.right, b, right)].into_iter().enumerate() {
            if f == NONE {
                continue;
            }
            let points = self.points_of(f);
            let Some(i) = points.iter().position(|&p| p == from) else {
                continue;
            };
            let middle = self.wedges[wedge as usize].point;
            let face = self.faces[f as usize];
            let mut rest = Face { old: NONE, ..face };
            (rest.corners[i], rest.points[i]) = (wedge, middle);
            let new = self.faces.len() as u32;
            self.faces.push(rest);
            let half = &mut self.faces[f as usize];
            (half.corners[(i + 1) % 3], half.points[(i + 1) % 3]) = (wedge, middle);
            half.old = NONE;
            let (end, tip) = (points[(i + 1) % 3], points[(i + 2) % 3]);
            for g in &mut self.points[end as usize].faces {
                if *g == f {
                    *g = new;
                }
            }
            self.points[tip as usize].faces.push(new);
            self.points[middle as usize].faces.extend([f, new]);
            made[slot] = new;
        }
        made
    }

    /// The faces that replace those at the edge from `a` to `b` when it is turned, as positions; `None` when the edge is
    /// not inside or the ends of the turned edge are already joined.
    pub fn flipped(&self, edge: Edge, a: u32, b: u32) -> Option<[[DVec3; 3]; 2]> {
        if !self.is_inside(edge, a, b) {
            return None;
        }
        let (c, d) = (self.across(edge.left, a, b)?, self.across(edge.right, a, b)?);
        if c == d || self.edge(c, d).faces().next().is_some() {
            return None;
        }
        let [a, b, c, d] = [a, b, c, d].map(|p| self.at(p));
        Some([[a, d, c], [d, b, c]])
    }

    /// Turns the edge; see [`flipped`](Self::flipped), which must have said that it can be.
    pub fn flip(&mut self, edge: Edge, a: u32, b: u32) {
        let (l, r) = (edge.left, edge.right);
        let corners = |p, q| Some((self.across(p, a, b)?, self.across(q, a, b)?));
        let Some((c, d)) = corners(l, r) else { return };
        let wedge = |f, p| self.wedge_at(f, p);
        let (Some(wa), Some(wb), Some(wc), Some(wd)) = (wedge(l, a), wedge(l, b), wedge(l, c), wedge(r, d)) else {
            return;
        };
        for (f, corners, points) in [(l, [wa, wd, wc], [a, d, c]), (r, [wd, wb, wc], [d, b, c])] {
            let face = &mut self.faces[f as usize];
            (face.corners, face.points, face.old) = (corners, points, NONE);
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
            self.faces[f as usize].old = NONE;
            wedges.extend(self.wedge_at(f, p));
        }
        wedges.sort_unstable();
        wedges.dedup();
        for w in wedges {
            let (of, weights) = blend(w);
            let wedge = &mut self.wedges[w as usize];
            wedge.old = NONE;
            wedge.of = of;
            wedge.weights = weights;
        }
    }
}
