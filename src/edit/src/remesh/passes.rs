//! The passes of Botsch and Kobbelt (2004): split long edges, collapse short ones, turn edges towards even valences,
//! even out.
//!
//! Where a deformed surface is stretched, and how fine its rest shape is.

use super::deviation::WORK;
use super::remesher::{PointConstraint, Remesher};
use super::sizing::{ASPECT, STRETCH};
use crate::region_mesh::RegionMesh;
use crate::surface::{BitSet, SurfaceView};
use crate::triangle;
use glam::DVec3;
use pliant_exec::progress::{Progress, check};
use pliant_mesh::{Error, NONE};
use std::cmp::Ordering;

/// Edges longer than this times the target are split.
const LONG: f64 = 4.0 / 3.0;

/// Edges shorter than this times the target are collapsed.
const SHORT: f64 = 4.0 / 5.0;

/// Points are not moved by less than this times the target.
const STILL: f64 = 0.02;

/// Turned faces keep within the angle with this cosine (about 32°) of the pair before.
const FLAT: f64 = 0.85;

/// A face this far from equilateral is still good enough to be made by turning or moving.
const GOOD: f64 = 2.5;

/// A point with more faces than this is far from even, however it lies.
const MANY_FACES: usize = 64;

/// Asks whether to go on when enough has been done since this was asked last. Now `points` come, whose faces are looked at.
fn check_work(work: &mut Remesher, points: &[u32], done: &mut usize, progress: &dyn Progress) -> Result<(), Error> {
    let around: usize = points.iter().map(|&p| work.mesh.faces_around(p).len()).sum();
    // A step without any distance is work as well.
    *done += 20 + around + work.take_work();
    if *done >= WORK {
        *done = 0;
        check(progress)?;
    }
    Ok(())
}

/// Splits edges that are too long, the longest first, until none is or `most` faces are there.
pub(super) fn split_long_edges(work: &mut Remesher, most: usize, progress: &dyn Progress) -> Result<usize, Error> {
    let (mut count, mut done) = (0, 0);
    // Each round halves the longest edges, so a few do even for lengths that differ a thousandfold.
    for _ in 0..24 {
        let mut long: Vec<(u64, (u32, u32))> = Vec::new();
        for (a, b) in work.mesh.edges() {
            let relative = work.relative_length(a, b);
            if relative > LONG && work.may_change(work.mesh.edge_faces(a, b).faces()) {
                long.push((relative.to_bits(), (a, b)));
            }
        }
        long.sort_unstable_by_key(|&(bits, edge)| (std::cmp::Reverse(bits), edge));
        let mut split = 0;
        check(progress)?;
        for &(_, (a, b)) in &long {
            check_work(work, &[a, b], &mut done, progress)?;
            if work.mesh.faces.len() >= most {
                return Ok(count + split);
            }
            split += usize::from(work.split_edge(a, b));
        }
        count += split;
        if split == 0 {
            break;
        }
    }
    Ok(count)
}

/// Collapses edges that are too short, the shortest first, unless that makes one too long or a needle.
pub(super) fn collapse_short_edges(work: &mut Remesher, progress: &dyn Progress) -> Result<usize, Error> {
    let mut short: Vec<(u64, (u32, u32))> = Vec::new();
    for (a, b) in work.mesh.edges() {
        let relative = work.relative_length(a, b);
        if relative < SHORT {
            short.push((relative.to_bits(), (a, b)));
        }
    }
    short.sort_unstable();
    check(progress)?;
    let (mut count, mut done) = (0, 0);
    for &(_, (a, b)) in &short {
        check_work(work, &[a, b], &mut done, progress)?;
        if work.mesh.edge_faces(a, b).faces().next().is_none() || work.relative_length(a, b) >= SHORT {
            continue;
        }
        for (from, to) in [(a, b), (b, a)] {
            if !work.may_change(work.mesh.faces_around(from).iter().copied()) {
                continue;
            }
            let limit = LONG * 0.5 * (work.sizes[from as usize] + work.sizes[to as usize]);
            let before = work.worst_aspect(from, work.mesh.position(from));
            let done = work.collapse_edge(from, to, |_, after| {
                let mut after = after.iter();
                after.all(|&t| triangle::longest_side(t) <= limit && triangle::aspect(t) <= before.max(2.0 * GOOD))
            });
            if done {
                count += 1;
                break;
            }
        }
    }
    Ok(count)
}

/// How far the valences of some points are from the best, each changed by one.
fn valence_unevenness(work: &Remesher, points: [(u32, i64); 4]) -> i64 {
    let of = |(p, change): (u32, i64)| {
        let faces = work.mesh.faces_around(p).len();
        let (neighbours, faces) = match work.constraints[p as usize] {
            PointConstraint::OnSurface(_) => (faces, faces),
            // One neighbour more or less does not matter then, and would be looked for at each edge.
            _ if faces > MANY_FACES => (faces, faces),
            _ => work.mesh.valence(p),
        };
        let best = if neighbours > faces { 4 } else { 6 };
        (neighbours as i64 + change - best).pow(2)
    };
    points.into_iter().map(of).sum()
}

/// Turns edges where that brings valences nearer to six (four on a boundary).
pub(super) fn even_valences(work: &mut Remesher, progress: &dyn Progress) -> Result<usize, Error> {
    let (mut count, mut done) = (0, 0);
    for (a, b) in work.mesh.edges() {
        check_work(work, &[a, b], &mut done, progress)?;
        let edge = work.mesh.edge_faces(a, b);
        if !work.mesh.is_inside(edge, a, b) || !work.may_change(edge.faces()) {
            continue;
        }
        let (Some(c), Some(d)) = (
            work.mesh.opposite_corner(edge.left, a, b),
            work.mesh.opposite_corner(edge.right, a, b),
        ) else {
            continue;
        };
        let now = valence_unevenness(work, [(a, 0), (b, 0), (c, 0), (d, 0)]);
        let then = valence_unevenness(work, [(a, -1), (b, -1), (c, 1), (d, 1)]);
        if then < now {
            count += usize::from(try_turn_edge(work, a, b, |before, after| after <= before.max(GOOD)));
        }
    }
    Ok(count)
}

/// Turns the edge if it is inside, the pair is nearly flat, no face turns over, and `accept` likes the worst aspect
/// after it, given that before.
fn try_turn_edge(work: &mut Remesher, a: u32, b: u32, accept: impl Fn(f64, f64) -> bool) -> bool {
    let edge = work.mesh.edge_faces(a, b);
    if work.curves.chain_segment(a, b).is_some() {
        return false;
    }
    let Some(after) = work.mesh.faces_after_turn(edge, a, b) else {
        return false;
    };
    let before = [edge.left, edge.right].map(|f| work.mesh.corner_positions(f));
    let worst = |pair: [[DVec3; 3]; 2]| triangle::aspect(pair[0]).max(triangle::aspect(pair[1]));
    let normal = triangle::area_normal(before[0]) + triangle::area_normal(before[1]);
    let flat = after.iter().all(|&t| {
        let turned = triangle::cosine(triangle::area_normal(t), normal);
        turned.is_some_and(|c| c >= FLAT)
    });
    let faithful = [edge.left, edge.right]
        .into_iter()
        .all(|f| after.iter().all(|&t| work.is_faithful(f, t)));
    if !flat || !faithful || !accept(worst(before), worst(after)) {
        return false;
    }
    if !after.iter().all(|&t| work.is_faithful_nearby(edge.left, t)) {
        return false;
    }
    work.turn_edge(edge, a, b, after)
}

/// The middle of the points that share an edge with `p`.
fn neighbour_middle(work: &Remesher, p: u32) -> DVec3 {
    let around = work.mesh.neighbours(p);
    around.iter().map(|&q| work.mesh.position(q)).sum::<DVec3>() / around.len().max(1) as f64
}

/// Moves inner points by a part of the way, up to 1, towards the middle of their neighbours, along the surface, and points of
/// lines along those.
pub(super) fn smooth_points(work: &mut Remesher, part: f64, progress: &dyn Progress) -> Result<(), Error> {
    let mut done = 0;
    for p in 0..work.constraints.len() as u32 {
        check_work(work, &[p], &mut done, progress)?;
        if !work.may_change(work.mesh.faces_around(p).iter().copied()) || work.mesh.faces_around(p).is_empty() {
            continue;
        }
        let here = work.mesh.position(p);
        let before = work.worst_aspect(p, here);
        let still = STILL * work.sizes[p as usize];
        let accept = |s: &Remesher, to: DVec3| s.worst_aspect(p, to) <= before.max(GOOD) && to.distance(here) > still;
        match work.constraints[p as usize] {
            PointConstraint::Held => {}
            PointConstraint::OnLine(on) => {
                let ends = on
                    .beside
                    .map(|q| work.curves.chain_segment(p, q).map(|piece| piece.at[1]));
                if let [Some(s), Some(t)] = ends {
                    let middle = 0.5 * (s + t);
                    let at = if part < 1.0 {
                        on.at + (middle - on.at) * part
                    } else {
                        middle
                    };
                    work.slide_on_line(p, on, at, accept);
                }
            }
            PointConstraint::OnSurface(_) => {
                let middle = neighbour_middle(work, p);
                let normals = work.mesh.faces_around(p).iter();
                let normal: DVec3 = normals.map(|&f| work.mesh.area_normal(f)).sum();
                let normal = normal.normalize_or_zero();
                let step = middle - here;
                let step = (step - normal * normal.dot(step)) * part;
                if step.length() <= still || !step.is_finite() {
                    continue;
                }
                // Half the way where the whole would turn a face over.
                if !work.move_on_surface(p, here + step, accept) {
                    work.move_on_surface(p, here + step * 0.5, accept);
                }
            }
        }
    }
    work.refresh_sources(progress)
}

/// Mends faces worse than `bound` by turning their longest edge, else by collapsing their shortest, and faces that stand
/// against the surface beside them by turning an edge. The worst come first. Says how many it mended.
pub(super) fn mend_faces(work: &mut Remesher, bound: f64, progress: &dyn Progress) -> Result<usize, Error> {
    check(progress)?;
    let mut bad: Vec<(u64, u32)> = Vec::new();
    for f in work.mesh.living_faces() {
        let aspect = triangle::aspect(work.mesh.corner_positions(f));
        if aspect > bound || work.stands_against(f) {
            bad.push((aspect.to_bits(), f));
        }
    }
    bad.sort_unstable_by_key(|&(bits, f)| (std::cmp::Reverse(bits), f));
    let (mut count, mut done) = (0, 0);
    for (_, f) in bad {
        let corners = work.mesh.points_of(f);
        check_work(work, &corners, &mut done, progress)?;
        if !work.mesh.faces[f as usize].alive {
            continue;
        }
        if triangle::aspect(work.mesh.corner_positions(f)) > bound {
            count += usize::from(mend_face(work, f));
        } else if work.stands_against(f) {
            count += usize::from(mend_against(work, f, bound));
        }
    }
    Ok(count)
}

/// The sides of a face in an order of their lengths.
fn sides_by_length(mesh: &RegionMesh, f: u32, order: impl Fn(f64, f64) -> Ordering) -> [(u32, u32); 3] {
    let p = mesh.points_of(f);
    let mut sides = [0, 1, 2].map(|i| (p[i], p[(i + 1) % 3]));
    sides.sort_by(|x, y| order(mesh.edge_length(x.0, x.1), mesh.edge_length(y.0, y.1)));
    sides
}

/// A face that cuts off a thin part of the surface: other edges may follow it.
fn mend_against(work: &mut Remesher, f: u32, bound: f64) -> bool {
    let sides = sides_by_length(&work.mesh, f, |x, y| y.total_cmp(&x));
    (sides.into_iter()).any(|(a, b)| try_turn_edge(work, a, b, |before, after| after <= before.max(bound)))
}

fn mend_face(work: &mut Remesher, f: u32) -> bool {
    let [short, _, long] = sides_by_length(&work.mesh, f, |x, y| x.total_cmp(&y));
    if try_turn_edge(work, long.0, long.1, |before, after| after < before) {
        return true;
    }
    let own = triangle::aspect(work.mesh.corner_positions(f));
    for (from, to) in [short, (short.1, short.0)] {
        let mut before = own;
        for &g in work.mesh.faces_around(from) {
            before = before.max(triangle::aspect(work.mesh.corner_positions(g)));
        }
        let limit = 2.0 * LONG * work.sizes[from as usize].max(work.sizes[to as usize]);
        let done = work.collapse_edge(from, to, |_, after| {
            let mut after = after.iter();
            after.all(|&t| triangle::aspect(t) < before.min(own.max(GOOD)) && triangle::longest_side(t) <= limit)
        });
        if done {
            return true;
        }
    }
    // A cap over a line: the line gets a point below its tip, or the tip moves off.
    let tip = work.mesh.opposite_corner(f, long.0, long.1);
    if let Some(tip) = tip
        && matches!(work.constraints[tip as usize], PointConstraint::OnSurface(_))
    {
        let here = work.mesh.position(tip);
        let middle = neighbour_middle(work, tip);
        let before = work.worst_aspect(tip, here);
        return [1.0, 0.5, 0.25].into_iter().any(|part| {
            work.move_on_surface(tip, here + (middle - here) * part, |s, to| {
                s.worst_aspect(tip, to) < before * 0.95
            })
        });
    }
    false
}

/// Rings of faces around stretched ones that are remeshed with them, so that lengths can change gently.
const RINGS: usize = 2;

/// Whether triangle `t` is stretched or thin.
pub(super) fn is_unfair(surface: &SurfaceView, t: u32, rest: &[DVec3]) -> bool {
    let now = surface.corner_positions(t);
    let then = surface.triangles[t as usize].map(|v| rest[v as usize]);
    let stretched = (0..3).any(|i| {
        let before = then[i].distance(then[(i + 1) % 3]);
        before > 0.0 && now[i].distance(now[(i + 1) % 3]) > STRETCH * before
    });
    stretched || triangle::aspect(now) > ASPECT
}

/// Those of `faces` that are stretched or thin, with the rings around them.
pub(super) fn find_stretched_faces(surface: &SurfaceView, faces: &[u32], rest: &[DVec3]) -> Vec<u32> {
    let needs = |&t: &u32| is_unfair(surface, t, rest);
    let mut points = BitSet::new(surface.points as usize);
    let mut any = false;
    for t in faces.iter().filter(|t| needs(t)) {
        if let Some(p) = surface.proper_points(*t) {
            p.iter().for_each(|&p| points.insert(p));
            any = true;
        }
    }
    if !any {
        return Vec::new();
    }
    let touched = |points: &BitSet| {
        let near = |t: &&u32| {
            let corners = surface.triangles[**t as usize];
            corners.iter().any(|&v| points.contains(surface.point_of[v as usize]))
        };
        faces.iter().filter(near).copied().collect::<Vec<u32>>()
    };
    let mut found = touched(&points);
    for _ in 1..RINGS {
        for v in found.iter().flat_map(|&t| surface.triangles[t as usize]) {
            let p = surface.point_of[v as usize];
            if p != NONE {
                points.insert(p);
            }
        }
        found = touched(&points);
    }
    found
}

/// The mean rest length of the edges at each point; where that is nothing, of those that are there now.
pub(super) fn rest_lengths(mesh: &RegionMesh, rest: &[DVec3]) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0, 0u32); mesh.points.len()];
    for (f, face) in mesh.faces.iter().enumerate() {
        let points = mesh.points_of(f as u32);
        let then = face.wedges.map(|w| rest[mesh.wedges[w as usize].vertex as usize]);
        for i in 0..3 {
            let j = (i + 1) % 3;
            for p in [points[i], points[j]] {
                let (before, now, count) = &mut sums[p as usize];
                *before += then[i].distance(then[j]);
                *now += mesh.edge_length(points[i], points[j]);
                *count += 1;
            }
        }
    }
    let all: f64 = sums.iter().map(|s| s.1 / f64::from(s.2.max(1))).sum::<f64>() / sums.len().max(1) as f64;
    let length = |&(before, now, count): &(f64, f64, u32)| {
        let count = f64::from(count.max(1));
        let known = |l: f64| l.is_finite() && l > 1e-3 * all;
        [before / count, now / count]
            .into_iter()
            .find(|&l| known(l))
            .unwrap_or(all)
    };
    sums.iter().map(length).collect()
}
