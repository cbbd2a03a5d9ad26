//! Collapsing an edge into one of its ends.

use super::mesh::RegionMesh;
use crate::mesh::NONE;
use glam::DVec3;

/// A collapse of an edge that keeps the surface's topology: what becomes of the wedges and faces of the point that goes.
#[derive(Debug, Clone)]
pub(in crate::edit) struct EdgeCollapse {
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
