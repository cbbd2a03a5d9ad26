//! Faces too large to show the bend between handles: reported before and after a pose, and divided on request.

use super::facts::DeformerWarning;
use super::pose::HandlePoses;
use super::resolved_handles::ResolvedHandles;
use crate::deform::{HandleSystem, exp_rotation, shares_difference};
use crate::edit::{self, EvennessTarget, FieldSample, SurfacePatch, SurfaceView, subdivide_until_even};
use crate::exec::Exec;
use crate::mesh::Mesh;
use crate::mesh::distortion::vertex_gradients;
use crate::mesh::query::TriangleBvh;
use crate::mesh::rotation::fit_rotation;
use crate::progress::Cancelled;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

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
) -> Result<SurfacePatch, edit::Error> {
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
            true => Err(edit::Error::Impossible {
                problem: format!(
                    "finding how thick the body is takes more than {most_visits} comparisons, because faces are as long as the \
                     model; remesh it first, which gives it faces of about one size"
                ),
                place: edit::ErrorPlace::Described(format!("triangle {t}")),
            }),
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

/// The largest angle by which poses turn two handles against each other, radians; more than a half turn counts in full
/// where a handle is alone in turning.
pub(super) fn largest_turn(handles: &ResolvedHandles, poses: &HandlePoses) -> f64 {
    if poses.0.len() != handles.set.handles.len() {
        return 0.0;
    }
    let transforms = handles.transforms(&poses.0);
    let mut largest = 0.0f64;
    for (i, a) in transforms.iter().enumerate() {
        largest = largest.max(a.rotation.length());
        // Pairs of the first few tell; the clamp of what follows from it is coarse.
        for b in transforms[..i].iter().rev().take(64) {
            let between: DQuat = exp_rotation(a.rotation).inverse() * exp_rotation(b.rotation);
            largest = largest.max(2.0 * libm::acos(between.w.abs().min(1.0)));
        }
    }
    largest
}

/// Triangles with an edge whose ends are turned against each other by more than 30° in a shape: the bend is seen as a kink.
/// Short edges do not count. `gradients` are those of the vertices, by the areas around them.
pub(super) fn count_kinked_faces(mesh: &Mesh, gradients: &[DMat3], diagonal: f64) -> u32 {
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
