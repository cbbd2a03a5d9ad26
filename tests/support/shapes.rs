//! Shapes generated for tests, wound counter-clockwise seen from outside.

use glam::DVec3;
use pliant::graph::{InteriorKind, MeshGraph, VolumeOptions};
use pliant::mesh::{Adjacency, Mesh, MeshReport, Weld, inspect};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// The options of the paper's graph.
pub fn paper_graph() -> VolumeOptions {
    VolumeOptions {
        kind: InteriorKind::Paper,
        ..VolumeOptions::default()
    }
}

/// Points and triangles.
pub type Shape = (Vec<DVec3>, Vec<[u32; 3]>);

/// A grid of `u × v` quads that closes on itself both ways, split into triangles; quads run along u, then along v.
fn wrapped(u: u32, v: u32, point: impl Fn(f64, f64) -> DVec3) -> Shape {
    let id = |i: u32, j: u32| (i % u) * v + j % v;
    let angle = |k: u32, n: u32| f64::from(k) / f64::from(n) * TAU;
    let points = (0..u * v).map(|k| point(angle(k / v, u), angle(k % v, v))).collect();
    let quads = (0..u * v).map(|k| (k / v, k % v));
    let faces = quads.flat_map(|(i, j)| {
        let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1)];
        [[a, b, c], [a, c, d]]
    });
    (points, faces.collect())
}

/// A ring around the z axis.
pub fn torus(around: u32, across: u32, radius: f64, tube: f64) -> Shape {
    wrapped(around, across, |u, v| {
        let r = radius + tube * v.cos();
        DVec3::new(r * u.cos(), r * u.sin(), tube * v.sin())
    })
}

/// A sphere around the origin: an octahedron, each face split into four `levels` times.
pub fn sphere(levels: u32, radius: f64) -> Shape {
    let mut points = vec![DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    let mut faces = vec![
        [0, 2, 4],
        [2, 1, 4],
        [1, 3, 4],
        [3, 0, 4],
        [2, 0, 5],
        [1, 2, 5],
        [3, 1, 5],
        [0, 3, 5],
    ];
    for _ in 0..levels {
        (points, faces) = split((points, faces));
        points.iter_mut().for_each(|p| *p = p.normalize());
    }
    points.iter_mut().for_each(|p| *p *= radius);
    (points, faces)
}

/// Each triangle split into four at the middles of its edges.
pub fn split((mut points, faces): Shape) -> Shape {
    let mut middles = BTreeMap::new();
    let mut split = Vec::new();
    for [a, b, c] in faces {
        let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(i, j): (u32, u32)| {
            *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                points.push((points[i as usize] + points[j as usize]) * 0.5);
                points.len() as u32 - 1
            })
        });
        split.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
    }
    (points, split)
}

/// The cube from −1 to 1, its sides split `levels − 1` times.
pub fn cube(levels: u32) -> Shape {
    let corner = |k: u32| DVec3::from_array([0, 1, 2].map(|axis| if k >> axis & 1 == 1 { 1.0 } else { -1.0 }));
    let sides = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let faces = sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    (1..levels).fold(((0..8).map(corner).collect(), faces), |shape, _| split(shape))
}

/// A flat rectangle of `x × y` unit squares.
pub fn sheet(x: u32, y: u32) -> Shape {
    let id = |i: u32, j: u32| i * (y + 1) + j;
    let points = (0..(x + 1) * (y + 1)).map(|k| DVec3::new(f64::from(k / (y + 1)), f64::from(k % (y + 1)), 0.0));
    let quads = (0..x * y).map(|k| (k / y, k % y));
    let faces = quads.flat_map(|(i, j)| {
        [
            [id(i, j), id(i + 1, j), id(i + 1, j + 1)],
            [id(i, j), id(i + 1, j + 1), id(i, j + 1)],
        ]
    });
    (points.collect(), faces.collect())
}

/// Two shapes side by side in one list.
pub fn both((mut points, mut faces): Shape, (more, others): Shape) -> Shape {
    let first = points.len() as u32;
    points.extend(more);
    faces.extend(others.iter().map(|f| f.map(|v| v + first)));
    (points, faces)
}

/// The shape with its triangles wound the other way.
pub fn inside_out((points, faces): Shape) -> Shape {
    (points, faces.into_iter().map(|[a, b, c]| [a, c, b]).collect())
}

/// The shape with its points moved.
pub fn moved((points, faces): Shape, to: impl FnMut(DVec3) -> DVec3) -> Shape {
    (points.into_iter().map(to).collect(), faces)
}

/// The shape as OBJ.
pub fn obj_text((points, faces): &Shape) -> String {
    let places = points.iter().map(|p| format!("v {} {} {}\n", p.x, p.y, p.z));
    let corners = faces.iter().map(|t| t.map(|v| v + 1));
    places
        .chain(corners.map(|[a, b, c]| format!("f {a} {b} {c}\n")))
        .collect()
}

/// The least and the largest corner of the box around points.
pub fn bounds(points: &[DVec3]) -> (DVec3, DVec3) {
    let ends = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    points.iter().fold(ends, |(low, high), &p| (low.min(p), high.max(p)))
}

/// Welded exactly.
pub fn mesh(shape: &Shape) -> Mesh {
    Mesh::build(&shape.0, &shape.1, Weld::Exact).expect("a generated shape is a mesh")
}

/// Welded exactly and inspected.
pub fn report(points: &[DVec3], faces: &[[u32; 3]]) -> MeshReport {
    let mesh = Mesh::build(points, faces, Weld::Exact).expect("a generated shape is a mesh");
    inspect(&mesh, &Adjacency::build(mesh.positions.len(), &mesh.triangles))
}

/// The sum of all solid angles, one by one (van Oosterom and Strackee).
pub fn winding_by_sum((points, faces): &Shape, q: DVec3) -> f64 {
    let angle = |f: &[u32; 3]| {
        let [a, b, c] = f.map(|v| points[v as usize] - q);
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        libm::atan2(a.dot(b.cross(c)), below)
    };
    faces.iter().map(angle).sum::<f64>() / std::f64::consts::TAU
}

/// Panics unless the graph keeps everything that its type promises.
pub fn check_graph(graph: &MeshGraph, mesh: &Mesh) {
    let n = graph.nodes();
    assert_eq!(graph.surface, mesh.positions.len());
    assert_eq!(graph.positions[..graph.surface], mesh.positions);
    assert_eq!(
        (graph.offsets.len(), graph.offsets[n] as usize),
        (n + 1, graph.neighbours.len())
    );
    assert_eq!((graph.nearest_surface.len(), graph.component.len()), (n, n));
    assert_eq!(graph.surface + graph.stats.shell_nodes + graph.stats.lattice_nodes, n);
    let weight = |i: u32, k: usize| {
        graph
            .weights
            .as_ref()
            .map_or(1.0, |w| w[graph.offsets[i as usize] as usize + k])
    };
    let mut with_surface = vec![false; graph.components];
    for i in 0..n as u32 {
        let row = graph.row(i);
        assert!(row.windows(2).all(|w| w[0] < w[1]), "row {i} rises");
        assert!(
            !row.is_empty() && row.binary_search(&i).is_err(),
            "row {i} has neighbours, not itself"
        );
        for (k, &j) in row.iter().enumerate() {
            let back = graph
                .row(j)
                .binary_search(&i)
                .unwrap_or_else(|_| panic!("{i} – {j} is one-sided"));
            assert_eq!(weight(i, k), weight(j, back));
            assert!(weight(i, k) > 0.0);
            assert_eq!(graph.component[i as usize], graph.component[j as usize]);
        }
        assert!(graph.positions[i as usize].is_finite());
        let near = graph.nearest_surface[i as usize];
        assert!((near as usize) < graph.surface);
        if (i as usize) < graph.surface {
            assert_eq!(near, i);
            with_surface[graph.component[i as usize] as usize] = true;
        } else if (i as usize) < graph.surface + graph.stats.shell_nodes {
            assert!(row.contains(&near), "a shell node is tied to its vertex");
        }
    }
    assert!(with_surface.iter().all(|&s| s), "each component has surface nodes");
    assert_eq!(graph.stats.component_has_volume.len(), graph.components);
}
