//! The rims of holes: loops of edges that have one face only.

use crate::mesh::adjacency::{Adjacency, MeshEdge};
use crate::mesh::lists::Lists;
use glam::DVec3;

/// One rim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundaryLoop {
    /// Number of its edges.
    pub edges: usize,
    /// Sum of their lengths.
    pub length: f64,
    /// A solver vertex on it: the smallest.
    pub vertex: u32,
    /// Whether it comes back to its start. A rim that ends at a non-manifold edge does not.
    pub closed: bool,
}

/// All rims in the order of the first edge found on each. Where rims touch at a vertex they are separate, so that
/// each loop passes a vertex at most once.
///
/// # Panics
/// When `adjacency` belongs to a mesh with more vertices than there are positions.
pub fn boundary_loops(positions: &[DVec3], adjacency: &Adjacency) -> Vec<BoundaryLoop> {
    let rim: Vec<MeshEdge> = adjacency.edges.iter().filter(|e| e.faces() == 1).copied().collect();
    if rim.is_empty() {
        return Vec::new();
    }
    let at = Lists::gather(positions.len(), || {
        rim.iter().zip(0u32..).flat_map(|(e, i)| e.vertices.map(|v| (v, i)))
    });
    let mut walk = BoundaryWalk {
        positions,
        rim: &rim,
        at: &at,
        next: vec![0; positions.len()],
        used: vec![false; rim.len()],
        place: vec![NOWHERE; positions.len()],
        loops: Vec::new(),
    };
    // Open rims first, from their loose ends, so that none is cut in two by starting in its middle.
    for v in 0..positions.len() as u32 {
        if at.of(v).len() % 2 == 1 {
            walk.run(v);
        }
    }
    for e in &rim {
        walk.run(e.vertices[0]);
    }
    walk.loops
}

const NOWHERE: u32 = u32::MAX;

struct BoundaryWalk<'a> {
    positions: &'a [DVec3],
    rim: &'a [MeshEdge],
    at: &'a Lists,
    /// Per vertex, how many of its rim edges have been looked at.
    next: Vec<u32>,
    used: Vec<bool>,
    /// Per vertex, where it stands in the current trail.
    place: Vec<u32>,
    loops: Vec<BoundaryLoop>,
}

impl BoundaryWalk<'_> {
    /// The first unused rim edge at `v`.
    fn take(&mut self, v: u32) -> Option<MeshEdge> {
        let edges = self.at.of(v);
        while let Some(&e) = edges.get(self.next[v as usize] as usize) {
            self.next[v as usize] += 1;
            if !std::mem::replace(&mut self.used[e as usize], true) {
                return Some(self.rim[e as usize]);
            }
        }
        None
    }

    /// Walks unused edges from `start` until stuck. Whenever the trail meets itself, the part since then is a loop and
    /// is cut off; what is left at the end is an open rim.
    fn run(&mut self, start: u32) {
        let mut trail = vec![start];
        self.place[start as usize] = 0;
        let mut here = start;
        while let Some(edge) = self.take(here) {
            here = if edge.vertices[0] == here {
                edge.vertices[1]
            } else {
                edge.vertices[0]
            };
            let met = self.place[here as usize];
            trail.push(here);
            if met == NOWHERE {
                self.place[here as usize] = trail.len() as u32 - 1;
                continue;
            }
            self.record(&trail[met as usize..], true);
            for v in trail.drain(met as usize + 1..) {
                if v != here {
                    self.place[v as usize] = NOWHERE;
                }
            }
        }
        if trail.len() > 1 {
            self.record(&trail, false);
        }
        for v in trail {
            self.place[v as usize] = NOWHERE;
        }
    }

    fn record(&mut self, trail: &[u32], closed: bool) {
        let length = |w: &[u32]| self.positions[w[0] as usize].distance(self.positions[w[1] as usize]);
        self.loops.push(BoundaryLoop {
            edges: trail.len() - 1,
            length: trail.windows(2).map(length).sum(),
            vertex: trail.iter().copied().min().unwrap_or(0),
            closed,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loops(positions: &[DVec3], faces: &[[u32; 3]]) -> Vec<BoundaryLoop> {
        boundary_loops(positions, &Adjacency::build(positions.len(), faces))
    }

    #[test]
    fn touching_rims_are_told_apart() {
        // Two triangles that share vertex 2 only: a bow tie.
        let p: Vec<DVec3> = [[0., 0.], [0., 1.], [1., 0.], [2., 0.], [2., 1.]]
            .iter()
            .map(|p| DVec3::new(p[0], p[1], 0.0))
            .collect();
        let found = loops(&p, &[[0, 2, 1], [2, 3, 4]]);
        let seen: Vec<_> = found.iter().map(|l| (l.edges, l.vertex, l.closed)).collect();
        assert!(
            seen.contains(&(3, 0, true)) && seen.contains(&(3, 2, true)) && seen.len() == 2,
            "{seen:?}"
        );
        assert!((found.iter().map(|l| l.length).sum::<f64>() - (2.0 + 2.0 * 2f64.sqrt() + 2.0)).abs() < 1e-12);
    }

    #[test]
    fn a_fin_leaves_an_open_rim() {
        // Three faces share the edge 0-1; each outer pair of edges runs from 0 to 1.
        let p: Vec<DVec3> = [DVec3::ZERO, DVec3::Z, DVec3::X, DVec3::Y, DVec3::NEG_X].to_vec();
        let found = loops(&p, &[[0, 1, 2], [0, 1, 3], [1, 0, 4]]);
        assert_eq!(found.iter().map(|l| l.edges).sum::<usize>(), 6);
        assert_eq!(found.iter().filter(|l| !l.closed).count(), 1, "{found:?}");
    }

    #[test]
    fn a_closed_surface_has_none() {
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        assert!(loops(&p, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]).is_empty());
    }
}
