//! How far a shape is from the rest shape, in numbers.
//!
//! Faces too large to show the bend between handles are reported before and after a pose, and divided on request.

use crate::deform::{FaceChanges, HandleSystem, Transform, exp_rotation, shares_difference};
use crate::edit::{EvennessTarget, FieldSample, SurfacePatch, SurfaceView, subdivide_until_even};
use crate::engine::facts::{DeformerWarning, QualityReport};
use crate::exec::Exec;
use crate::mesh::local_turns::{is_turned_over, largest_stretch, vertex_gradients};
use crate::mesh::query::TriangleBvh;
use crate::mesh::rotation::fit_rotation;
use crate::mesh::{self, BoundingBox, CrossingCount, Mesh, shading};
use crate::pool::Pool;
use crate::progress::Cancelled;
use glam::{DMat3, DQuat, DVec3};
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
        new_self_intersections: None,
        off_rigid: None,
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
    /// Pairs of triangles that cross, when asked for.
    pub crossings: Option<CrossingCount>,
}

impl FrameQuality {
    /// Adds what was counted of crossings to a report.
    pub fn tell_crossings(&self, report: &mut QualityReport) {
        let narrow = |count: u64| u32::try_from(count).unwrap_or(u32::MAX);
        report.self_intersections = self.crossings.map(|crossings| narrow(crossings.all));
        report.new_self_intersections = self.crossings.map(|crossings| narrow(crossings.new));
    }

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
            crossings: None,
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

/// A face is too large when one of its edges goes more than this part of the way between handles.
const LARGEST_WAY: f64 = 0.5;
/// Edges shorter than this share of the diagonal are never called too large, however close two handles are.
const SHORTEST: f64 = 0.02;
/// What part of the way one edge may go after a division, at most and at least.
const DIVIDED_WAY: [f64; 2] = [1.0 / 24.0, 0.25];
/// By how much the ends of an edge may be turned against each other after a division, radians: 15°.
const DIVIDED_TURN: f64 = std::f64::consts::PI / 12.0;
/// Beyond this turn between the ends of an edge a bend is seen as a kink, radians: 30°.
const LARGEST_TURN: f64 = std::f64::consts::PI / 6.0;
/// How long an edge may be in a bend by a radian, as a part of how thick the body is there, and between which parts it stays
/// for other turns: a bar of longer edges flattens where it bends.
const BENT_PART: f64 = 0.3;
/// The least and the largest part of the thickness.
const THICKNESS_PARTS: [f64; 2] = [0.1, 0.5];
/// The first of the nine numbers of a rotation among the fields that are sampled; handles have smaller ones.
const TURNED: u32 = u32::MAX - 9;
/// What finding how thick the body is behind one face may look at on average. Where faces are of about one size it looks at a
/// tenth of it.
const VISITS_PER_FACE: u64 = 8192;
/// The same for any faces.
const LEAST_VISITS: u64 = 1 << 28;
/// How many faces a warning names.
const NAMED: usize = 8;

/// What handles do to a model, as far as the sizes of faces are concerned.
#[derive(Clone, Copy)]
pub(super) struct HandleBend<'a> {
    /// The handles in force.
    pub handles: &'a HandleSystem,
    /// The welded rest mesh.
    pub mesh: &'a Mesh,
    /// The current shape, one position per render vertex.
    pub shape: &'a [DVec3],
    /// The largest angle by which their poses turn two of them against each other, radians.
    pub turn: f64,
    /// Length of the model's diagonal.
    pub diagonal: f64,
}

/// The warning that faces are too large for these handles, if more than `least` of all faces are.
///
/// # Errors
/// [`Cancelled`].
pub(in crate::engine) fn warn_of_large_faces(
    mesh: &Mesh,
    handles: &HandleSystem,
    diagonal: f64,
    least: f64,
    exec: &Exec<'_>,
) -> Result<Option<DeformerWarning>, Cancelled> {
    let shortest = SHORTEST * diagonal;
    let mut found: Vec<u32> = Vec::new();
    let (mut count, mut worst) = (0usize, 0.0f64);
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        // All handles may have a say at each corner.
        if t.is_multiple_of(64) {
            exec.check()?;
        }
        let way = longest_way(mesh, triangle, shortest, |a, b| {
            handles.way_between(a as usize, b as usize)
        });
        if way > LARGEST_WAY {
            count += 1;
            worst = worst.max(way);
            if found.len() < NAMED {
                found.push(mesh.source_triangle[t]);
            }
        }
    }
    if count as f64 <= least * mesh.triangles.len() as f64 {
        return Ok(None);
    }
    let finer = (worst / DIVIDED_WAY[1]).ceil();
    let message = format!(
        "{count} of {} triangles reach over more than half of the way between handles and cannot show a bend there; edges \
         {finer} times shorter would, and the edit \"subdivide\" with \"auto\" makes them",
        mesh.triangles.len()
    );
    let named: Vec<String> = found.iter().map(u32::to_string).collect();
    let more = count - found.len();
    let rest = if more > 0 {
        format!(" and {more} more")
    } else {
        String::new()
    };
    let place = format!("triangles {}{rest}", named.join(", "));
    Ok(Some(DeformerWarning::new("faces-too-large", message, place)))
}

/// The largest part of the way between handles that an edge of a triangle goes, of those longer than `shortest`.
fn longest_way(mesh: &Mesh, triangle: &[u32; 3], shortest: f64, way: impl Fn(u32, u32) -> f64) -> f64 {
    let mut longest = 0.0f64;
    for (a, b) in [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (triangle[i], triangle[j])) {
        if mesh.positions[a as usize].distance(mesh.positions[b as usize]) > shortest {
            longest = longest.max(way(a, b));
        }
    }
    longest
}

/// Plans the division of those of `faces` that are too large for the handles, for how far poses turn these against each
/// other, and for the turns that the current shape has: what [`count_kinked_faces`] counts is divided.
pub(super) fn plan_division(
    surface: &SurfaceView<'_>,
    faces: &[u32],
    bend: &HandleBend<'_>,
    exec: &Exec<'_>,
) -> Result<SurfacePatch, mesh::Error> {
    let HandleBend {
        handles,
        mesh,
        shape,
        turn,
        diagonal,
    } = *bend;
    let turn = turn.max(1e-9);
    let [least, most] = DIVIDED_WAY;
    let way = (DIVIDED_TURN / turn).clamp(least, most);
    let turns = vertex_turns(mesh, shape, exec);
    let tree = TriangleBvh::build(surface.positions, surface.triangles, exec.pool);
    let most_visits = LEAST_VISITS + VISITS_PER_FACE * faces.len() as u64;
    let [least, most] = THICKNESS_PARTS;
    let part = (BENT_PART / turn).clamp(least, most);
    let shares = |sample: &FieldSample| sample.partition_point(|s| s.0 < TURNED);
    let target = EvennessTarget {
        sample: &|point| {
            let mut sample = handles.shares_at(point as usize);
            sample.extend((TURNED..).zip(turns[point as usize]));
            sample
        },
        difference: &|a, b| {
            let ((a_shares, a_turn), (b_shares, b_turn)) = (a.split_at(shares(a)), b.split_at(shares(b)));
            let apart: f32 = a_turn.iter().zip(b_turn).map(|(a, b)| (a.1 - b.1).powi(2)).sum();
            // Rotations by an angle from each other are so far apart as matrices.
            let divided = 8f64.sqrt() * libm::sin(0.5 * DIVIDED_TURN);
            (shares_difference(a_shares, b_shares) / way).max(f64::from(apart).sqrt() / divided)
        },
        largest: 1.0,
        shortest: SHORTEST * diagonal,
        longest: &|t| match tree.visits.total() > most_visits {
            true => Err(mesh::Error::impossible(
                format!(
                    "finding how thick the body is takes more than {most_visits} comparisons, because faces are as long as the \
                     model; remesh it first, which gives it faces of about one size"
                ),
                format!("triangle {t}"),
            )),
            false => Ok(part * thickness_at(surface, &tree, t, diagonal)),
        },
    };
    subdivide_until_even(surface, faces, &target, exec.progress)
}

/// How a shape turns the surface at each vertex of the mesh, as nine numbers.
fn vertex_turns(mesh: &Mesh, shape: &[DVec3], exec: &Exec<'_>) -> Vec<[f32; 9]> {
    let now = |p: u32| shape[mesh.render_vertices_of(p)[0] as usize];
    let deformed: Vec<DVec3> = (0..mesh.positions.len() as u32).map(now).collect();
    let turn = |gradient: &DMat3| {
        DMat3::from_quat(fit_rotation(*gradient))
            .to_cols_array()
            .map(|x| x as f32)
    };
    exec.pool
        .install(|| vertex_gradients(mesh, &deformed).par_iter().map(turn).collect())
}

/// How thick the body is behind triangle `t`: the shortest way in from some of its places to where the surface is met from
/// inside; infinite when it is met nowhere.
fn thickness_at(surface: &SurfaceView<'_>, tree: &TriangleBvh<'_>, t: u32, diagonal: f64) -> f64 {
    let corners = |t: u32| surface.triangles[t as usize].map(|v| surface.positions[v as usize]);
    let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).normalize_or_zero();
    let own = corners(t);
    let (inward, middle) = (-normal(own), (own[0] + own[1] + own[2]) / 3.0);
    let start = 1e-6 * diagonal;
    let places = [middle, own[0], own[1], own[2]].map(|corner| (middle + corner) * 0.5 + inward * start);
    let ways = places.into_iter().filter_map(|place| {
        let hit = tree.first_hit(place, place + inward * diagonal, None)?;
        (normal(corners(hit.triangle)).dot(inward) > 0.0).then_some(start + hit.along * diagonal)
    });
    ways.fold(f64::INFINITY, f64::min)
}

/// The largest angle by which two handles are turned against each other, radians; more than a half turn counts in full
/// where a handle is alone in turning.
pub(super) fn largest_turn(transforms: &[Transform]) -> f64 {
    let mut largest = 0.0f64;
    for (i, a) in transforms.iter().enumerate() {
        largest = largest.max(a.rotation.length());
        // Pairs of a few handles suffice; the clamp of what follows from it is coarse.
        for b in transforms[..i].iter().rev().take(64) {
            let between: DQuat = exp_rotation(a.rotation).inverse() * exp_rotation(b.rotation);
            largest = largest.max(2.0 * libm::acos(between.w.abs().min(1.0)));
        }
    }
    largest
}

/// Triangles with an edge whose ends are turned against each other by more than 30° in a shape: the bend is seen as a kink.
/// Short edges do not count. `gradients` are those of the vertices, by the areas around them.
fn count_kinked_faces(mesh: &Mesh, gradients: &[DMat3], diagonal: f64) -> u32 {
    let shortest = SHORTEST * diagonal;
    let least = libm::cos(0.5 * LARGEST_TURN);
    let turn = |a: u32, b: u32| {
        let [a, b] = [a, b].map(|v| fit_rotation(gradients[v as usize]));
        f64::from(u8::from((a.inverse() * b).w.abs() < least))
    };
    let count = mesh
        .triangles
        .iter()
        .filter(|t| longest_way(mesh, t, shortest, turn) > 0.5)
        .count();
    u32::try_from(count).unwrap_or(u32::MAX)
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
