//! How far a shape is from the rest shape, in numbers.

use super::facts::QualityReport;
use super::large_faces::count_kinked_faces;
use crate::deform::FaceChanges;
use crate::mesh::distortion::{is_turned_over, largest_stretch, vertex_gradients};
use crate::mesh::{BoundingBox, Mesh, shading};
use crate::pool::Pool;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Triangles whose numbers are summed by one thread. QualitySums depend on it, so it is fixed.
const BLOCK: usize = 4096;

/// Compares a shape of the welded mesh with its rest shape. `closed` says whether the mesh has a volume.
///
/// A triangle counts as flipped when its normal opposes the rest normal turned by the mean rotation around it, which is
/// taken from its neighbours' normals: a fold shows, a part that was turned over as a whole does not.
pub(super) fn measure_quality(mesh: &Mesh, closed: bool, deformed: &[DVec3], pool: &Pool) -> QualityReport {
    let centers = [&mesh.positions, deformed].map(|p| BoundingBox::of(p).center());
    let (sums, max_stretch, (flipped_triangles, faces_too_large)) = pool.install(|| {
        let blocks: Vec<QualitySums> = mesh
            .triangles
            .par_chunks(BLOCK)
            .map(|block| QualitySums::of(block, [&mesh.positions, deformed], closed, centers))
            .collect();
        let sums = blocks.into_iter().fold(QualitySums::default(), QualitySums::join);
        (sums, greatest_stretch(mesh, deformed), count_bad_faces(mesh, deformed))
    });
    QualityReport {
        edge_rms: sums.edge_rms(),
        volume_change: if closed { change(sums.volume) } else { 0.0 },
        open_surface: !closed,
        area_change: change(sums.area),
        flipped_triangles,
        max_stretch,
        faces_too_large,
        self_intersections: None,
    }
}

/// How far a frame of an animation is from the rest shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameQuality {
    /// As [`QualityReport::volume_change`].
    pub volume_change: f64,
    /// As [`QualityReport::flipped_triangles`].
    pub flipped_triangles: u32,
    /// As [`QualityReport::max_stretch`].
    pub max_stretch: f64,
    /// As [`QualityReport::edge_rms`].
    pub edge_rms: f64,
}

impl FrameQuality {
    /// Measures a shape of which it is known what it does to each face: the numbers of [`measure_quality`] for less work.
    pub(super) fn measure(mesh: &Mesh, closed: bool, deformed: &[DVec3], faces: &FaceChanges, pool: &Pool) -> Self {
        let centers = [&mesh.positions, deformed].map(|p| BoundingBox::of(p).center());
        let of = |block: &[[u32; 3]]| QualitySums::of(block, [&mesh.positions, deformed], closed, centers);
        let blocks: Vec<QualitySums> = pool.install(|| mesh.triangles.par_chunks(BLOCK).map(of).collect());
        let sums = blocks.into_iter().fold(QualitySums::default(), QualitySums::join);
        Self {
            volume_change: if closed { change(sums.volume) } else { 0.0 },
            flipped_triangles: u32::try_from(faces.turned_over()).unwrap_or(u32::MAX),
            max_stretch: faces.largest_stretch(),
            edge_rms: sums.edge_rms(),
        }
    }
}

fn change([before, now]: [f64; 2]) -> f64 {
    if before != 0.0 { now / before - 1.0 } else { 0.0 }
}

/// Sums over triangles; pairs are of the rest shape and the deformed one.
#[derive(Default)]
struct QualitySums {
    squares: f64,
    edges: u64,
    area: [f64; 2],
    volume: [f64; 2],
}

impl QualitySums {
    fn of(triangles: &[[u32; 3]], shapes: [&[DVec3]; 2], closed: bool, centers: [DVec3; 2]) -> Self {
        let mut sums = Self::default();
        for t in triangles {
            let [p, q] = shapes.map(|shape| t.map(|v| shape[v as usize]));
            for k in 0..3 {
                // An inner edge is met twice and a rim edge once; each pair of a closed mesh is counted from one side.
                let (a, b) = (k, (k + 1) % 3);
                let length = p[a].distance(p[b]);
                if length > 0.0 && (t[a] < t[b] || !closed) {
                    let change = q[a].distance(q[b]) / length - 1.0;
                    sums.squares += change * change;
                    sums.edges += 1;
                }
            }
            for (k, [a, b, c]) in [p, q].into_iter().enumerate() {
                let normal = (b - a).cross(c - a);
                sums.area[k] += 0.5 * normal.length();
                sums.volume[k] += (a - centers[k]).dot(normal) / 6.0;
            }
        }
        sums
    }

    fn edge_rms(&self) -> f64 {
        (self.squares / self.edges.max(1) as f64).sqrt()
    }

    fn join(self, other: Self) -> Self {
        let add = |a: [f64; 2], b: [f64; 2]| [a[0] + b[0], a[1] + b[1]];
        Self {
            squares: self.squares + other.squares,
            edges: self.edges + other.edges,
            area: add(self.area, other.area),
            volume: add(self.volume, other.volume),
        }
    }
}

/// The largest stretch of a triangle. Runs on the pool of the caller.
fn greatest_stretch(mesh: &Mesh, deformed: &[DVec3]) -> f64 {
    let corners = |shape: &[DVec3], t: &[u32; 3]| t.map(|v| shape[v as usize]);
    let stretches = (mesh.triangles.par_iter().with_min_len(BLOCK))
        .filter_map(|t| largest_stretch(corners(&mesh.positions, t), corners(deformed, t)));
    stretches.reduce(|| 0.0, f64::max)
}

/// Triangles that turned over, and those too large for the bend that they are in. Runs on the pool of the caller.
fn count_bad_faces(mesh: &Mesh, deformed: &[DVec3]) -> (u32, u32) {
    let gradients = vertex_gradients(mesh, deformed);
    let cofactors: Vec<DMat3> = gradients.par_iter().map(shading::cofactor).collect();
    let count = mesh
        .triangles
        .par_iter()
        .filter(|t| {
            let [p, q] = [&mesh.positions[..], deformed].map(|shape| t.map(|v| shape[v as usize]));
            is_turned_over(p, q, t.map(|v| &cofactors[v as usize]))
        })
        .count();
    let diagonal = BoundingBox::of(&mesh.positions).diagonal();
    let too_large = count_kinked_faces(mesh, &gradients, diagonal);
    (u32::try_from(count).unwrap_or(u32::MAX), too_large)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::shapes;
    use crate::mesh::{Weld, signed_volume, surface_area};

    fn pool(threads: usize) -> Pool {
        Pool::new(threads).expect("threads")
    }

    fn mesh(shape: &shapes::Shape) -> Mesh {
        Mesh::build(&shape.0, &shape.1, Weld::Exact).expect("a mesh")
    }

    #[test]
    fn a_shape_that_is_turned_moved_or_scaled_has_the_numbers_of_that() {
        let mesh = mesh(&shapes::torus(1.0, 0.3, 40, 20));
        let turn = glam::DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 2.5);
        let moved = |scale: f64| -> Vec<DVec3> {
            let place = |p: &DVec3| turn * *p * scale + DVec3::new(50.0, -3.0, 8.0);
            mesh.positions.iter().map(place).collect()
        };
        let still = measure_quality(&mesh, true, &moved(1.0), &pool(2));
        assert!(still.edge_rms < 1e-12 && still.volume_change.abs() < 1e-12 && still.area_change.abs() < 1e-12);
        assert!((still.max_stretch - 1.0).abs() < 1e-12);
        assert_eq!((still.flipped_triangles, still.self_intersections), (0, None));
        let grown = measure_quality(&mesh, true, &moved(1.2), &pool(2));
        assert!((grown.edge_rms - 0.2).abs() < 1e-12 && (grown.max_stretch - 1.2).abs() < 1e-12);
        assert!((grown.volume_change - 0.728).abs() < 1e-12 && (grown.area_change - 0.44).abs() < 1e-12);
        assert_eq!(
            measure_quality(&mesh, false, &moved(1.2), &pool(2)).volume_change,
            0.0,
            "an open mesh has no volume"
        );
    }

    #[test]
    fn threads_change_no_bit_and_blocks_add_up() {
        let mesh = mesh(&shapes::icosphere(1.0, 5));
        assert!(mesh.triangles.len() > 4 * BLOCK);
        let deformed: Vec<DVec3> = mesh
            .positions
            .iter()
            .map(|p| DVec3::new(p.x + 0.3 * p.y * p.y, p.y * (1.0 + 0.5 * p.z), p.z - 0.2 * p.x))
            .collect();
        let one = measure_quality(&mesh, true, &deformed, &pool(1));
        assert_eq!(one, measure_quality(&mesh, true, &deformed, &pool(3)));
        let ratio = |of: fn(&[DVec3], &[[u32; 3]]) -> f64| {
            of(&deformed, &mesh.triangles) / of(&mesh.positions, &mesh.triangles) - 1.0
        };
        assert!((one.volume_change - ratio(signed_volume)).abs() < 1e-12);
        assert!((one.area_change - ratio(surface_area)).abs() < 1e-12);
    }

    #[test]
    fn a_fold_is_flipped_and_a_turned_part_is_not() {
        let (positions, triangles) = shapes::grid(1.0, 1.0, [20, 20]);
        let sheet = Mesh::build(&positions, &triangles, Weld::Exact).expect("a sheet");
        // One inner vertex dragged over its neighbours.
        let mut folded = sheet.positions.clone();
        let inner = 10 * 21 + 10;
        folded[inner].x += 0.12;
        assert!(measure_quality(&sheet, false, &folded, &pool(1)).flipped_triangles > 0);
        let over: Vec<DVec3> = sheet.positions.iter().map(|p| DVec3::new(p.x, -p.y, -p.z)).collect();
        assert_eq!(measure_quality(&sheet, false, &over, &pool(1)).flipped_triangles, 0);
        // A collapse to a point has no normals at all, and no number that is none.
        let gone = measure_quality(&sheet, false, &vec![DVec3::ONE; sheet.positions.len()], &pool(1));
        assert_eq!(gone.flipped_triangles, 0);
        assert!((gone.edge_rms - 1.0).abs() < 1e-12 && gone.area_change == -1.0 && gone.max_stretch == 0.0);
    }
}
