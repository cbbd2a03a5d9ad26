//! Faces that close the holes of open parts.
//!
//! What edges lack to be passed equally often both ways runs in loops, for any set of triangles: as much of it ends at a
//! vertex as begins there. A fan from the middle of each loop closes it, and then the winding number is whole
//! everywhere off the surface, which rows can be followed through.

use crate::mesh::{Adjacency, Mesh, MeshEdge};
use glam::DVec3;

/// Positions and faces of a closed surface.
#[derive(Debug, Default)]
pub(in crate::graph) struct ClosedHull {
    /// The mesh's positions, then the middles of loops.
    pub(in crate::graph) positions: Vec<DVec3>,
    pub(in crate::graph) faces: Vec<[u32; 3]>,
    /// For each loop one of its vertices, its length in edges and its middle.
    pub(in crate::graph) loops: Vec<(u32, usize, DVec3)>,
}

/// Positions and faces of a closed surface.
#[derive(Debug, Clone, Copy)]
pub(in crate::graph) struct HullFaces<'a> {
    pub(in crate::graph) positions: &'a [DVec3],
    pub(in crate::graph) faces: &'a [[u32; 3]],
}

impl<'a> HullFaces<'a> {
    /// Those of a mesh that is closed.
    pub(in crate::graph) fn of_mesh(mesh: &'a Mesh) -> Self {
        Self {
            positions: &mesh.positions,
            faces: &mesh.triangles,
        }
    }
}

impl ClosedHull {
    /// Its positions and faces.
    pub(in crate::graph) fn as_faces(&self) -> HullFaces<'_> {
        HullFaces {
            positions: &self.positions,
            faces: &self.faces,
        }
    }

    /// The faces of `triangles` whose vertices `wanted` says, closed by fans.
    pub(in crate::graph) fn close(
        positions: &[DVec3],
        triangles: &[[u32; 3]],
        adjacency: &Adjacency,
        wanted: impl Fn(u32) -> bool,
    ) -> Self {
        let mut hull = Self {
            positions: positions.to_vec(),
            faces: triangles.iter().copied().filter(|t| wanted(t[0])).collect(),
            loops: Vec::new(),
        };
        let mut lacking: Vec<[u32; 2]> = Vec::new();
        for e in adjacency.edges.iter().filter(|e| wanted(e.vertices[0])) {
            lacking.extend(missing(e));
        }
        lacking.sort_unstable();
        for ring in rings(positions.len(), &lacking) {
            let middle = hull.positions.len() as u32;
            let sum: DVec3 = ring.iter().map(|&v| positions[v as usize]).sum();
            hull.positions.push(sum / ring.len() as f64);
            hull.loops.push((ring[0], ring.len(), sum / ring.len() as f64));
            let next = ring.iter().cycle().skip(1);
            hull.faces.extend(ring.iter().zip(next).map(|(&a, &b)| [a, b, middle]));
        }
        hull
    }
}

/// The passages that an edge lacks.
pub(in crate::graph) fn missing(e: &MeshEdge) -> impl Iterator<Item = [u32; 2]> + use<> {
    missing_of(e.vertices, i32::from(e.forward) - i32::from(e.backward))
}

/// The passages that an edge lacks which is passed `more` times more from its first end than from its second.
pub(in crate::graph) fn missing_of([a, b]: [u32; 2], more: i32) -> impl Iterator<Item = [u32; 2]> + use<> {
    let passage = if more > 0 { [b, a] } else { [a, b] };
    (0..more.unsigned_abs()).map(move |_| passage)
}

/// Loops without repeated vertices that use each of the sorted `passages` once.
pub(in crate::graph) fn rings(vertices: usize, passages: &[[u32; 2]]) -> Vec<Vec<u32>> {
    const OFF: u32 = u32::MAX;
    let mut place = vec![OFF; vertices];
    let mut used = vec![false; passages.len()];
    // By vertex: where the first passage from it stands that has not been looked at.
    let mut next = vec![passages.len(); vertices];
    (0..passages.len())
        .rev()
        .for_each(|k| next[passages[k][0] as usize] = k);
    let mut rings = Vec::new();
    for first in 0..passages.len() {
        // Passages from one vertex are used in order, so an unused one is the next from its vertex.
        if used[first] {
            continue;
        }
        let mut path = vec![passages[first][0]];
        place[path[0] as usize] = 0;
        while let Some(&here) = path.last() {
            let out = next[here as usize];
            if passages.get(out).is_none_or(|p| p[0] != here) {
                break;
            }
            next[here as usize] += 1;
            used[out] = true;
            let to = passages[out][1];
            if place[to as usize] == OFF {
                place[to as usize] = path.len() as u32;
                path.push(to);
                continue;
            }
            let ring = path.split_off(place[to as usize] as usize + 1);
            let whole: Vec<u32> = std::iter::once(to).chain(ring).collect();
            whole[1..].iter().for_each(|&v| place[v as usize] = OFF);
            rings.push(whole);
        }
        path.iter().for_each(|&v| place[v as usize] = OFF);
    }
    rings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_set_of_triangles_is_closed() {
        // A fan of three around an edge, two that share a corner only, and one wound against its neighbour.
        let faces = [
            [0, 1, 2],
            [0, 1, 3],
            [1, 0, 4],
            [4, 5, 6],
            [7, 8, 9],
            [8, 9, 10],
            [0, 1, 11],
        ];
        let positions: Vec<DVec3> = (0..12)
            .map(|k| DVec3::new(f64::from(k % 3), f64::from(k % 5), f64::from(k)))
            .collect();
        let adjacency = Adjacency::build(positions.len(), &faces);
        let hull = ClosedHull::close(&positions, &faces, &adjacency, |_| true);
        assert_eq!(hull.faces[..faces.len()], faces);
        assert!(Adjacency::build(hull.positions.len(), &hull.faces).is_balanced());
        let some = ClosedHull::close(&positions, &faces, &adjacency, |v| v >= 7);
        assert!(Adjacency::build(some.positions.len(), &some.faces).is_balanced());
        assert_eq!(some.faces[..2], faces[4..6]);
    }

    #[test]
    fn a_square_hole_gets_a_fan_of_four() {
        let corner = |k: u32| DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2));
        let positions: Vec<DVec3> = (0..8).map(corner).collect();
        let quads = [[0, 2, 3, 1], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces: Vec<[u32; 3]> = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let adjacency = Adjacency::build(8, &faces);
        let hull = ClosedHull::close(&positions, &faces, &adjacency, |_| true);
        assert_eq!((hull.positions.len(), hull.faces.len()), (9, faces.len() + 4));
        assert_eq!(hull.positions[8], DVec3::new(0.5, 0.5, 1.0));
        assert!((crate::mesh::signed_volume(&hull.positions, &hull.faces) - 1.0).abs() < 1e-12);
    }
}
