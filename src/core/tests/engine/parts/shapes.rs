//! Models of several parts, and how far what lay side by side is apart after a bend.

use glam::{DMat3, DQuat, DVec3};
use pliant_core::asset::FileSet;
use pliant_core::asset::shapes::{Shape, box_with_cells, uv_sphere};
use pliant_core::mesh::query::TriangleBvh;
use pliant_core::mesh::query::closest_point::closest_weights_on_triangle;
use pliant_core::mesh::{BoundingBox, Components, Mesh};
use pliant_core::pool::Pool;

/// Shapes side by side in one list.
pub fn together(shapes: impl IntoIterator<Item = Shape>) -> Shape {
    let (mut points, mut faces) = (Vec::new(), Vec::new());
    for (more, others) in shapes {
        let first = points.len() as u32;
        points.extend(more);
        faces.extend(others.iter().map(|f| f.map(|v| v + first)));
    }
    (points, faces)
}

/// The shape with its points moved.
pub fn moved((points, faces): Shape, to: impl FnMut(DVec3) -> DVec3) -> Shape {
    (points.into_iter().map(to).collect(), faces)
}

/// A box of a size with its middle at a place.
pub fn block(middle: [f64; 3], size: [f64; 3], cells: [usize; 3]) -> Shape {
    let (middle, size) = (DVec3::from_array(middle), DVec3::from_array(size));
    moved(box_with_cells(size, cells), |p| p + middle - 0.5 * size)
}

/// An axe: a long handle, a head pushed onto it, and a pin through both.
pub fn axe() -> Shape {
    together([
        block([0.0, 0.0, 0.0], [0.2, 4.0, 0.2], [3, 40, 3]),
        block([0.25, 1.6, 0.0], [0.9, 0.6, 0.3], [9, 6, 3]),
        block([0.0, 1.6, 0.0], [0.06, 0.06, 0.5], [1, 1, 5]),
    ])
}

/// A stack of slabs whose faces lie a hair apart.
pub fn slices(count: usize, gap: f64) -> Shape {
    together((0..count).map(|k| block([0.0, k as f64 * (0.5 + gap), 0.0], [1.0, 0.5, 1.0], [8, 4, 8])))
}

/// A ball, a strap around it that touches it nowhere, and hair cards that stand on it.
pub fn strapped_ball() -> Shape {
    let ball = uv_sphere(1.0, 32, 24);
    let strap = (0..48u32).flat_map(|k| {
        let (sin, cos) = libm::sincos(f64::from(k) * std::f64::consts::TAU / 48.0);
        [
            DVec3::new(1.01 * cos, -0.1, 1.01 * sin),
            DVec3::new(1.01 * cos, 0.1, 1.01 * sin),
        ]
    });
    let band = (0..48u32).flat_map(|k| {
        let (a, b) = (2 * k, (2 * k + 2) % 96);
        [[a, b, a + 1], [a + 1, b, b + 1]]
    });
    let card = |k: u32| {
        let turn = DQuat::from_rotation_y(f64::from(k) * 0.7) * DQuat::from_rotation_x(0.15 + f64::from(k) * 0.03);
        let corners = [
            [-0.05, 0.99, 0.0],
            [0.05, 0.99, 0.0],
            [0.05, 1.3, 0.0],
            [-0.05, 1.3, 0.0],
        ];
        (
            corners.map(|c| turn * DVec3::from_array(c)).to_vec(),
            vec![[0, 1, 2], [0, 2, 3]],
        )
    };
    together(
        [ball, (strap.collect(), band.collect())]
            .into_iter()
            .chain((0..12).map(card)),
    )
}

/// A mesh that keeps its points as they are, also where several lie in one place.
pub fn unwelded((points, faces): &Shape) -> Mesh {
    let own = (0..points.len() as u32).collect();
    Mesh::of_points(points, faces, own, points.len()).expect("a generated shape is a mesh")
}

/// The shape as a file.
pub fn obj((points, faces): &Shape) -> FileSet {
    let mut text = String::new();
    points
        .iter()
        .for_each(|p| text += &format!("v {:?} {:?} {:?}\n", p.x, p.y, p.z));
    faces
        .iter()
        .for_each(|t| text += &format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1));
    FileSet::single("parts.obj", text)
}

/// A vertex, and a place on another part that lies beside it.
pub struct Neighbours {
    pub vertex: u32,
    corners: [u32; 3],
    shares: [f64; 3],
}

/// All vertices that lie within `reach` of another part, with the nearest place on each such part.
pub fn side_by_side(mesh: &Mesh, reach: f64, pool: &Pool) -> Vec<Neighbours> {
    let parts = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
    let mut triangles = vec![Vec::new(); parts.count];
    for t in &mesh.triangles {
        triangles[parts.of_vertex[t[0] as usize] as usize].push(*t);
    }
    let mut found = Vec::new();
    for (part, triangles) in (0u32..).zip(&triangles) {
        let tree = TriangleBvh::build(&mesh.positions, triangles, pool);
        let corners: Vec<DVec3> = triangles
            .iter()
            .flatten()
            .map(|&v| mesh.positions[v as usize])
            .collect();
        let bounds = BoundingBox::of(&corners);
        for (vertex, &p) in (0u32..).zip(&mesh.positions) {
            let outside = (bounds.min - p).max(p - bounds.max).max_element() > reach;
            if parts.of_vertex[vertex as usize] == part || outside {
                continue;
            }
            if let Some(near) = tree.closest_point_within(p, reach) {
                let corners = triangles[near.triangle as usize];
                let (shares, _) = closest_weights_on_triangle(p, corners.map(|v| mesh.positions[v as usize]));
                found.push(Neighbours {
                    vertex,
                    corners,
                    shares,
                });
            }
        }
    }
    found
}

/// How much each offset has changed, turned with the triangle that it begins at.
pub fn offset_errors(neighbours: &[Neighbours], rest: &[DVec3], now: &[DVec3]) -> Vec<f64> {
    let error = |n: &Neighbours| {
        let [before, after] = [rest, now].map(|at| {
            let t = n.corners.map(|v| at[v as usize]);
            let place = t[0] * n.shares[0] + t[1] * n.shares[1] + t[2] * n.shares[2];
            (frame(t), at[n.vertex as usize] - place)
        });
        match (before.0, after.0) {
            (Some(from), Some(to)) => (to * (from.transpose() * before.1)).distance(after.1),
            _ => (before.1.length() - after.1.length()).abs(),
        }
    };
    let mut errors: Vec<f64> = neighbours.iter().map(error).collect();
    errors.sort_by(f64::total_cmp);
    errors
}

/// A triangle's own axes; `None` without an area.
fn frame([a, b, c]: [DVec3; 3]) -> Option<DMat3> {
    let normal = (b - a).cross(c - a).try_normalize()?;
    let along = (b - a).try_normalize()?;
    Some(DMat3::from_cols(along, normal.cross(along), normal))
}

/// The value that the given part of a rising list lies at or below.
pub fn quantile(sorted: &[f64], part: f64) -> f64 {
    let last = sorted.len().saturating_sub(1) as f64;
    sorted.get((part * last) as usize).copied().unwrap_or(0.0)
}
