//! Whether a surface keeps what its type promises, and how its topology stands: for tests and for doubt.
//!
//! The boundary of a whole surface, found without sorting its edges.

use super::surface::SurfaceView;
use glam::DVec3;
use pliant_mesh::NONE;
use std::collections::BTreeMap;

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
        use pliant_mesh::{Adjacency, Components};
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

/// The points where an edge has more faces on one side than on the other, rising.
///
/// One flat scan: over the faces around a point of the inside, each neighbour comes once after it and once before it,
/// so that sums of scrambled numbers cancel. That they cancel by chance is as good as impossible.
pub(super) fn boundary_points(surface: &SurfaceView<'_>) -> Vec<u32> {
    let sums = unmatched_neighbours(surface);
    let open = sums.iter().zip(0u32..).filter(|(sum, _)| **sum != 0);
    open.map(|(_, p)| p).collect()
}

/// The closed boundary loops as points, in the direction that faces filling them run; and the trails of boundary edges
/// that do not close.
///
/// Only faces with two boundary points can have a boundary edge, so the exact search sees those only.
pub(super) fn boundary_loops(surface: &SurfaceView<'_>) -> (Vec<Vec<u32>>, Vec<Vec<u32>>) {
    let sums = unmatched_neighbours(surface);
    // Each side of the faces: its edge, the smaller point first, and the side as it runs.
    let mut sides: Vec<([u32; 2], u32, usize, [u32; 2])> = Vec::new();
    for (f, t) in surface.triangles.iter().enumerate() {
        let open = |v: &&u32| {
            let sum = sums.get(surface.point_of[**v as usize] as usize);
            sum.is_some_and(|&sum| sum != 0)
        };
        if t.iter().filter(open).count() < 2 {
            continue;
        }
        if let Some(p) = surface.proper_points(f as u32) {
            sides.extend((0..3).map(|k| {
                let (a, b) = (p[k], p[(k + 1) % 3]);
                ([a.min(b), a.max(b)], f as u32, k, [a, b])
            }));
        }
    }
    sides.sort_unstable();
    let edges: Vec<[u32; 2]> = sides
        .chunk_by(|a, b| a.0 == b.0)
        .filter(|along| along.len() == 1)
        .map(|along| along[0].3)
        .filter(|ends| ends.iter().all(|&p| sums[p as usize] != 0))
        .map(|[from, to]| [to, from])
        .collect();
    split_into_loops(&edges)
}

/// For each point the scrambled numbers of the points that follow it around its faces, less those that precede it.
fn unmatched_neighbours(surface: &SurfaceView<'_>) -> Vec<u64> {
    let mut sums = vec![0u64; surface.points as usize];
    for p in surface.proper_faces() {
        for i in 0..3 {
            let sum = &mut sums[p[i] as usize];
            *sum = sum
                .wrapping_add(scramble(p[(i + 1) % 3]))
                .wrapping_sub(scramble(p[(i + 2) % 3]));
        }
    }
    sums
}

/// Mixes the bits of a number: the finaliser of SplitMix64 (Steele, Lea and Flood 2014).
fn scramble(p: u32) -> u64 {
    let mut x = u64::from(p).wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Splits directed edges into loops, which close and pass a point at most once, and the trails that are left, which end
/// somewhere else than they start. Deterministic in the order of `edges`.
pub(super) fn split_into_loops(edges: &[[u32; 2]]) -> (Vec<Vec<u32>>, Vec<Vec<u32>>) {
    let mut order: Vec<u32> = (0..edges.len() as u32).collect();
    order.sort_by_key(|&e| edges[e as usize][0]);
    let start = |p: u32| order.partition_point(|&e| edges[e as usize][0] < p);
    let mut used = vec![false; edges.len()];
    let take = |p: u32, used: &mut Vec<bool>| {
        let from = start(p);
        let rest = order[from..].iter().take_while(|&&e| edges[e as usize][0] == p);
        let free = rest.copied().find(|&e| !used[e as usize])?;
        used[free as usize] = true;
        Some(edges[free as usize][1])
    };
    // Where more edges start than end, an open trail starts: those first, so that none begins in its middle.
    let mut surplus: Vec<(u32, i32)> = edges.iter().flat_map(|e| [(e[0], 1), (e[1], -1)]).collect();
    surplus.sort_unstable();
    let loose = surplus
        .chunk_by(|a, b| a.0 == b.0)
        .flat_map(|c| std::iter::repeat_n(c[0].0, c.iter().map(|s| s.1).sum::<i32>().max(0) as usize));
    let starts: Vec<u32> = loose.chain(edges.iter().map(|e| e[0])).collect();
    let (mut closed, mut open) = (Vec::new(), Vec::new());
    let mut place: BTreeMap<u32, usize> = BTreeMap::new();
    for first in starts {
        let mut trail = vec![first];
        place.insert(first, 0);
        while let Some(next) = trail.last().and_then(|&here| take(here, &mut used)) {
            if let Some(&met) = place.get(&next) {
                closed.push(trail[met..].to_vec());
                for gone in trail.drain(met + 1..) {
                    place.remove(&gone);
                }
            } else {
                place.insert(next, trail.len());
                trail.push(next);
            }
        }
        if trail.len() > 1 {
            open.push(trail);
        }
        place.clear();
    }
    (closed, open)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::TestSurface;

    const POSITIONS: [DVec3; 5] = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_X];
    const TETRAHEDRON: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

    fn surface(triangles: &[[u32; 3]], points: usize) -> TestSurface {
        TestSurface::new(&POSITIONS[..points], triangles)
    }

    #[test]
    fn a_tetrahedron_is_closed_and_a_bow_tie_is_pinched() {
        let closed = SurfaceTopology::from_surface(&surface(&TETRAHEDRON, 4).view());
        assert!(closed.is_closed() && closed.euler == 2, "{closed:?}");
        let bow = surface(&[[0, 1, 2], [0, 3, 4]], 5);
        assert_eq!(verify_surface(&bow.view()), Ok(()));
        assert_eq!(SurfaceTopology::from_surface(&bow.view()).pinched_points, 1);
        let crowded = SurfaceTopology::from_surface(&surface(&[[0, 1, 2], [0, 1, 3], [1, 0, 4]], 5).view());
        assert_eq!((crowded.crowded_edges, crowded.rim_edges), (1, 6));
        let unused = surface(&[[0, 1, 2]], 4);
        assert!(verify_surface(&unused.view()).is_err(), "point 3 is in no triangle");
    }

    #[test]
    fn the_rim_of_a_square_runs_against_its_faces() {
        let square = surface(&[[0, 1, 2], [0, 2, 3]], 4);
        assert_eq!(boundary_loops(&square.view()), (vec![vec![1, 0, 3, 2]], vec![]));
        assert_eq!(boundary_loops(&surface(&TETRAHEDRON, 4).view()), (vec![], vec![]));
    }

    #[test]
    fn the_rim_of_an_open_box_is_found_and_a_closed_one_has_none() {
        let rim = |count: usize| boundary_points(&surface(&TETRAHEDRON[..count], 4).view());
        assert!(rim(4).is_empty());
        assert_eq!(rim(3), [0, 2, 3]);
    }

    #[test]
    fn trails_part_where_they_meet_themselves() {
        let (closed, open) = split_into_loops(&[[0, 1], [1, 2], [2, 0], [2, 3], [3, 4], [4, 2], [8, 9], [7, 8]]);
        assert_eq!(closed.len(), 2);
        assert!(closed.iter().all(|l| l.len() == 3), "{closed:?}");
        assert_eq!(open, [vec![7, 8, 9]]);
    }
}
