//! Simple shapes as positions and triangles, for tests, benchmarks and examples.
//!
//! Closed shapes are manifold, share their vertices, and wind counter-clockwise seen from outside. Counts below the
//! least that makes sense are raised to it.

use glam::DVec3;
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

/// Positions, and triangles that index them.
pub type Shape = (Vec<DVec3>, Vec<[u32; 3]>);

/// The surface of a box from the origin to `size`, each side divided into `cells` (at least one) along its axes.
pub fn box_with_cells(size: DVec3, cells: [usize; 3]) -> Shape {
    let cells = cells.map(|n| n.max(1));
    let mut corners = Welder::default();
    let mut triangles = Vec::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for (side, i, j) in product([2, cells[u], cells[v]]) {
            let mut corner = |di: usize, dj: usize| {
                let mut at = [0; 3];
                (at[axis], at[u], at[v]) = (side * cells[axis], i + di, j + dj);
                corners.index(at)
            };
            let quad = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
            let [a, b, c, d] = if side == 1 {
                quad
            } else {
                [quad[0], quad[3], quad[2], quad[1]]
            };
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let at = |c: [usize; 3]| size * DVec3::from_array([0, 1, 2].map(|axis| c[axis] as f64 / cells[axis] as f64));
    (corners.keys.into_iter().map(at).collect(), triangles)
}

/// A flat open sheet in the x-z plane, from the origin to (`width`, 0, `depth`), facing +y.
pub fn grid(width: f64, depth: f64, cells: [usize; 2]) -> Shape {
    let cells = cells.map(|n| n.max(1));
    let at = |i: usize, j: usize| {
        DVec3::new(
            width * i as f64 / cells[0] as f64,
            0.0,
            depth * j as f64 / cells[1] as f64,
        )
    };
    let positions = product([1, cells[0] + 1, cells[1] + 1])
        .map(|(_, i, j)| at(i, j))
        .collect();
    let index = |i: usize, j: usize| (i * (cells[1] + 1) + j) as u32;
    let mut triangles = Vec::new();
    for (_, i, j) in product([1, cells[0], cells[1]]) {
        let [a, b, c, d] = [index(i, j), index(i, j + 1), index(i + 1, j + 1), index(i + 1, j)];
        triangles.extend([[a, b, c], [a, c, d]]);
    }
    (positions, triangles)
}

/// A tube about the z axis from z = 0 to `length`, of `around` (at least 3) by `along` (at least 1) cells. Both ends are
/// closed by fans about their middles when `capped`, else open.
pub fn cylinder(radius: f64, length: f64, around: usize, along: usize, capped: bool) -> Shape {
    let (around, along) = (around.max(3), along.max(1));
    let at = |_, ring: usize, i: usize| {
        let (sin, cos) = libm::sincos(TAU * i as f64 / around as f64);
        DVec3::new(radius * cos, radius * sin, length * ring as f64 / along as f64)
    };
    let mut positions: Vec<_> = product([1, along + 1, around]).map(|(a, b, c)| at(a, b, c)).collect();
    let index = |ring: usize, i: usize| (ring * around + i % around) as u32;
    let mut triangles = Vec::new();
    for (_, ring, i) in product([1, along, around]) {
        let [a, b, c, d] = [
            index(ring, i),
            index(ring, i + 1),
            index(ring + 1, i + 1),
            index(ring + 1, i),
        ];
        triangles.extend([[a, b, c], [a, c, d]]);
    }
    if capped {
        let (bottom, top) = (positions.len() as u32, positions.len() as u32 + 1);
        positions.extend([DVec3::ZERO, DVec3::Z * length]);
        for i in 0..around {
            triangles.push([bottom, index(0, i + 1), index(0, i)]);
            triangles.push([top, index(along, i), index(along, i + 1)]);
        }
    }
    (positions, triangles)
}

/// A wire of radius `wire` wound about the z axis: `turns` of radius `radius` that rise by `pitch` each, with `around` (at
/// least 3) by `along` (at least 1) cells and closed ends. It begins on the x axis at z = 0.
pub fn spring(radius: f64, wire: f64, pitch: f64, turns: f64, around: usize, along: usize) -> Shape {
    let (mut positions, triangles) = cylinder(wire, 1.0, around, along, true);
    let rise = pitch / TAU;
    // The frame of the wire: outwards, and across both that and its direction.
    let across = libm::atan2(rise, radius);
    let (tilt, level) = libm::sincos(across);
    for p in &mut positions {
        let angle = TAU * turns * p.z;
        let (sin, cos) = libm::sincos(angle);
        let (outwards, along) = (DVec3::new(cos, sin, 0.0), DVec3::new(-sin, cos, 0.0));
        let up = DVec3::Z * level - along * tilt;
        *p = outwards * (radius + p.x) + DVec3::Z * (rise * angle) - up * p.y;
    }
    (positions, triangles)
}

/// A sphere about the origin with poles on the z axis, of `around` (at least 3) meridians and `along` (at least 2) bands.
pub fn uv_sphere(radius: f64, around: usize, along: usize) -> Shape {
    let (around, along) = (around.max(3), along.max(2));
    let mut positions = vec![DVec3::Z * -radius];
    for (_, ring, i) in product([1, along - 1, around]) {
        let (sin_up, cos_up) = libm::sincos(PI * ((ring + 1) as f64 / along as f64 - 0.5));
        let (sin, cos) = libm::sincos(TAU * i as f64 / around as f64);
        positions.push(radius * DVec3::new(cos_up * cos, cos_up * sin, sin_up));
    }
    let north = positions.len() as u32;
    positions.push(DVec3::Z * radius);
    let index = |ring: usize, i: usize| (1 + ring * around + i % around) as u32;
    let mut triangles = Vec::new();
    for i in 0..around {
        triangles.push([0, index(0, i + 1), index(0, i)]);
        triangles.push([north, index(along - 2, i), index(along - 2, i + 1)]);
    }
    for (_, ring, i) in product([1, along - 2, around]) {
        let [a, b, c, d] = [
            index(ring, i),
            index(ring, i + 1),
            index(ring + 1, i + 1),
            index(ring + 1, i),
        ];
        triangles.extend([[a, b, c], [a, c, d]]);
    }
    (positions, triangles)
}

/// A sphere about the origin: an icosahedron whose triangles are divided in four `subdivisions` times (10·4ⁿ + 2 vertices).
pub fn icosphere(radius: f64, subdivisions: u32) -> Shape {
    let golden = (1.0 + 5f64.sqrt()) / 2.0;
    let mut positions = Vec::new();
    for axis in 0..3 {
        for (s, t) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
            let mut p = DVec3::ZERO;
            (p[(axis + 1) % 3], p[(axis + 2) % 3]) = (s, t * golden);
            positions.push(p.normalize());
        }
    }
    // Neighbours are the closest pairs; three mutual neighbours make a face.
    let near = |a: usize, b: usize| a != b && positions[a].distance(positions[b]) < 1.2;
    let mut triangles = Vec::new();
    for (a, b, c) in product([12, 12, 12]).filter(|&(a, b, c)| a < b && b < c && near(a, b) && near(b, c) && near(c, a))
    {
        let outward = (positions[b] - positions[a])
            .cross(positions[c] - positions[a])
            .dot(positions[a])
            > 0.0;
        triangles.push(if outward { [a, b, c] } else { [a, c, b] }.map(|i| i as u32));
    }
    for _ in 0..subdivisions {
        let mut middles = BTreeMap::new();
        let mut finer = Vec::with_capacity(triangles.len() * 4);
        for [a, b, c] in triangles {
            let mut middle = |i: u32, j: u32| {
                *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    positions.push((positions[i as usize] + positions[j as usize]).normalize());
                    positions.len() as u32 - 1
                })
            };
            let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
            finer.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
        triangles = finer;
    }
    (positions.into_iter().map(|p| p * radius).collect(), triangles)
}

/// A torus about the z axis: `around` cells (at least 3) along the ring of radius `major`, `across` cells (at least 3)
/// around the tube of radius `minor`.
pub fn torus(major: f64, minor: f64, around: usize, across: usize) -> Shape {
    let (around, across) = (around.max(3), across.max(3));
    let at = |i: usize, j: usize| {
        let (sin, cos) = libm::sincos(TAU * i as f64 / around as f64);
        let (tube_sin, tube_cos) = libm::sincos(TAU * j as f64 / across as f64);
        let out = major + minor * tube_cos;
        DVec3::new(out * cos, out * sin, minor * tube_sin)
    };
    let positions = product([1, around, across]).map(|(_, i, j)| at(i, j)).collect();
    let index = |i: usize, j: usize| ((i % around) * across + j % across) as u32;
    let mut triangles = Vec::new();
    for (_, i, j) in product([1, around, across]) {
        let [a, b, c, d] = [index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)];
        triangles.extend([[a, b, c], [a, c, d]]);
    }
    (positions, triangles)
}

/// Numbers lattice points in the order in which they are first asked for.
#[derive(Default)]
struct Welder {
    index: BTreeMap<[usize; 3], u32>,
    keys: Vec<[usize; 3]>,
}

impl Welder {
    fn index(&mut self, key: [usize; 3]) -> u32 {
        *self.index.entry(key).or_insert_with(|| {
            self.keys.push(key);
            self.keys.len() as u32 - 1
        })
    }
}

/// All triples below the given counts, the last running fastest.
fn product([a, b, c]: [usize; 3]) -> impl Iterator<Item = (usize, usize, usize)> {
    (0..a).flat_map(move |i| (0..b).flat_map(move |j| (0..c).map(move |k| (i, j, k))))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Boundary edges, after checking that every edge has at most one face on each side.
    pub(crate) fn boundary_edges((positions, triangles): &Shape) -> usize {
        let mut directed = BTreeMap::new();
        for t in triangles {
            assert!(t.iter().all(|&v| (v as usize) < positions.len()));
            for i in 0..3 {
                *directed.entry((t[i], t[(i + 1) % 3])).or_insert(0) += 1;
            }
        }
        assert!(
            directed.values().all(|&n| n == 1),
            "an edge is used twice in the same direction"
        );
        directed
            .keys()
            .filter(|(a, b)| !directed.contains_key(&(*b, *a)))
            .count()
    }

    /// Vertices minus edges plus faces.
    pub(crate) fn euler((positions, triangles): &Shape) -> i64 {
        let mut edges = std::collections::BTreeSet::new();
        for t in triangles {
            edges.extend((0..3).map(|i| (t[i].min(t[(i + 1) % 3]), t[i].max(t[(i + 1) % 3]))));
        }
        positions.len() as i64 - edges.len() as i64 + triangles.len() as i64
    }

    /// The enclosed volume; positive when triangles face outward.
    pub(crate) fn volume((positions, triangles): &Shape) -> f64 {
        let six = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            a.dot(b.cross(c))
        };
        triangles.iter().map(six).sum::<f64>() / 6.0
    }

    fn assert_closed(shape: &Shape, expected_euler: i64, expected_volume: f64, tolerance: f64) {
        assert_eq!(boundary_edges(shape), 0);
        assert_eq!(euler(shape), expected_euler);
        let seen = volume(shape);
        assert!(
            (seen / expected_volume - 1.0).abs() < tolerance,
            "volume {seen}, expected about {expected_volume}"
        );
    }

    #[test]
    fn closed_shapes_enclose_their_volume() {
        assert_closed(&box_with_cells(DVec3::new(1.0, 2.0, 3.0), [2, 3, 4]), 2, 6.0, 1e-12);
        assert_closed(&cylinder(1.0, 2.0, 64, 5, true), 2, TAU, 0.01);
        assert_closed(&uv_sphere(2.0, 60, 40), 2, 4.0 / 3.0 * PI * 8.0, 0.01);
        assert_closed(&icosphere(0.5, 4), 2, PI / 6.0, 0.01);
        assert_closed(&torus(2.0, 0.5, 80, 40), 0, 2.0 * PI * PI * 2.0 * 0.25, 0.01);
        let length = 3.0 * f64::hypot(TAU * 2.0, 1.2);
        assert_closed(&spring(2.0, 0.2, 1.2, 3.0, 64, 300), 2, PI * 0.04 * length, 0.01);
    }

    #[test]
    fn open_shapes_are_open_where_they_should_be() {
        assert_eq!(boundary_edges(&grid(1.0, 1.0, [3, 5])), 16);
        let tube = cylinder(1.0, 1.0, 7, 3, false);
        assert_eq!((boundary_edges(&tube), tube.0.len(), euler(&tube)), (14, 28, 0));
        let (positions, triangles) = grid(1.0, 1.0, [1, 1]);
        let [a, b, c] = triangles[0].map(|v| positions[v as usize]);
        assert!((b - a).cross(c - a).y > 0.0, "the sheet faces up");
    }

    #[test]
    fn counts_too_small_are_raised() {
        assert_eq!(boundary_edges(&uv_sphere(1.0, 0, 0)), 0);
        assert_eq!(boundary_edges(&torus(1.0, 0.1, 0, 0)), 0);
        assert_eq!(box_with_cells(DVec3::ONE, [0, 0, 0]).0.len(), 8);
        assert_eq!(icosphere(1.0, 0).0.len(), 12);
    }
}
