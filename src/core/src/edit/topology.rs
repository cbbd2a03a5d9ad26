//! Whether a surface keeps what its type promises, and how its topology stands: for tests and for doubt.

use super::surface::SurfaceView;
use crate::mesh::NONE;
use glam::DVec3;

/// Says what is wrong with the arrays of a surface: lengths, numbers out of range, points without vertices, vertices of
/// one point that lie apart, places that are not finite, triangles with two equal corners, triangles across primitives.
///
/// # Errors
/// A sentence about the first thing found.
pub fn verify_surface(surface: &SurfaceView<'_>) -> Result<(), String> {
    let SurfaceView {
        positions,
        triangles,
        primitive_of,
        point_of,
        points,
    } = *surface;
    if positions.len() != point_of.len() || triangles.len() != primitive_of.len() {
        return Err("arrays differ in length".to_owned());
    }
    if let Some(t) = (1..triangles.len()).find(|&t| primitive_of[t] < primitive_of[t - 1]) {
        return Err(format!(
            "triangle {t} is of an earlier primitive than the one before it"
        ));
    }
    let mut place: Vec<Option<DVec3>> = vec![None; points as usize];
    for (v, (&p, &x)) in point_of.iter().zip(positions).enumerate() {
        if p == NONE {
            continue;
        }
        let Some(known) = place.get_mut(p as usize) else {
            return Err(format!("vertex {v} has point {p}, there are {points}"));
        };
        if !x.is_finite() || known.is_some_and(|k| k != x) {
            return Err(format!("vertex {v} lies at {x}, its point {p} at {known:?}"));
        }
        *known = Some(x);
    }
    if let Some(p) = place.iter().position(Option::is_none) {
        return Err(format!("point {p} has no vertex"));
    }
    let mut primitive = vec![NONE; positions.len()];
    for (t, (corners, &own)) in triangles.iter().zip(primitive_of).enumerate() {
        for &v in corners {
            match primitive.get_mut(v as usize) {
                None => return Err(format!("triangle {t} names vertex {v}, there are {}", positions.len())),
                Some(p) if *p != NONE && *p != own => return Err(format!("vertex {v} is in two primitives")),
                Some(p) => *p = own,
            }
        }
        let [a, b, c] = corners.map(|v| point_of[v as usize]);
        if a == b || b == c || c == a || [a, b, c].contains(&NONE) {
            return Err(format!("triangle {t} has the points {:?}", [a, b, c]));
        }
    }
    match (0..positions.len()).find(|&v| primitive[v] == NONE && point_of[v] != NONE) {
        Some(v) => Err(format!("vertex {v} has a point, but no triangle names it")),
        None => Ok(()),
    }
}

/// How the faces of a surface hang together, over points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SurfaceTopology {
    /// Points minus edges plus faces.
    pub euler: i64,
    /// Edges with one face.
    pub rim_edges: usize,
    /// Edges with more than two faces.
    pub crowded_edges: usize,
    /// Edges with two faces that pass them the same way: their normals disagree.
    pub twisted_edges: usize,
    /// Points whose faces do not hang together by edges.
    pub pinched_points: usize,
    /// Parts that hang together by points.
    pub components: usize,
}

impl SurfaceTopology {
    /// Counts by sorting all edges.
    ///
    /// # Panics
    /// When [`verify_surface`] would refuse the surface.
    pub fn from_surface(surface: &SurfaceView<'_>) -> Self {
        use crate::mesh::{Adjacency, Components};
        let faces: Vec<[u32; 3]> = surface
            .triangles
            .iter()
            .map(|t| t.map(|v| surface.point_of[v as usize]))
            .collect();
        let points = surface.points as usize;
        let adjacency = Adjacency::build(points, &faces);
        let edges = &adjacency.edges;
        let mut topology = Self {
            euler: points as i64 - edges.len() as i64 + faces.len() as i64,
            rim_edges: edges.iter().filter(|e| e.faces() == 1).count(),
            crowded_edges: edges.iter().filter(|e| e.faces() > 2).count(),
            twisted_edges: edges
                .iter()
                .filter(|e| e.faces() == 2 && e.forward != e.backward)
                .count(),
            components: Components::of_triangles(points, &faces).count,
            pinched_points: 0,
        };
        for p in 0..points as u32 {
            let around = adjacency.faces.of(p);
            let mut group: Vec<usize> = (0..around.len()).collect();
            for i in 0..around.len() {
                for j in 0..i {
                    let shared = (faces[around[i] as usize].iter()).filter(|c| faces[around[j] as usize].contains(c));
                    let (a, b) = (group[i], group[j]);
                    if shared.count() > 1 && a != b {
                        group.iter_mut().filter(|g| **g == a).for_each(|g| *g = b);
                    }
                }
            }
            if group.windows(2).any(|w| w[0] != w[1]) {
                topology.pinched_points += 1;
            }
        }
        topology
    }

    /// Whether every edge has one or two faces that agree, and every point one fan.
    pub fn is_manifold(&self) -> bool {
        self.crowded_edges == 0 && self.twisted_edges == 0 && self.pinched_points == 0
    }

    /// Whether it is manifold and has no rim.
    pub fn is_closed(&self) -> bool {
        self.is_manifold() && self.rim_edges == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tetrahedron_is_closed_and_a_bow_tie_is_pinched() {
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X];
        let surface = |triangles: &'static [[u32; 3]], points: u32| SurfaceView {
            positions: &positions[..points as usize],
            triangles,
            primitive_of: &[0; 4][..triangles.len()],
            point_of: &[0, 1, 2, 3, 4][..points as usize],
            points,
        };
        let closed = SurfaceTopology::from_surface(&surface(&[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], 4));
        assert!(closed.is_closed() && closed.euler == 2, "{closed:?}");
        let bow = surface(&[[0, 1, 2], [0, 3, 4]], 5);
        assert_eq!(verify_surface(&bow), Ok(()));
        assert_eq!(SurfaceTopology::from_surface(&bow).pinched_points, 1);
        let crowded = SurfaceTopology::from_surface(&surface(&[[0, 1, 2], [0, 1, 3], [1, 0, 4]], 5));
        assert_eq!((crowded.crowded_edges, crowded.rim_edges), (1, 6));
        assert!(
            verify_surface(&surface(&[[0, 1, 2]], 4)).is_err(),
            "point 3 is in no triangle"
        );
    }
}
