//! Ways over a mesh between two of its points: straight across faces, or along edges.

use crate::edit::region_mesh::{RegionMesh, edge_key};
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

/// A crossing nearer than this fraction of the edge to one of its ends goes through that end.
pub(super) const SNAP: f64 = 0.01;

/// A way longer than this many straight distances is not the one that was drawn.
const DETOUR: f64 = 4.0;

/// A step of a straight way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum TraceStep {
    /// Across the edge from `a` to `b`, at the fraction `t`.
    Edge { a: u32, b: u32, t: f64 },
    /// Through a point.
    Point(u32),
}

/// Why there is no way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TraceFailure {
    /// It leaves the faces that the mesh knows all neighbours of.
    Leaves,
    /// A rim, a turn, or a detour stands in between.
    Blocked,
}

/// The line in which the plane through `from`, `to` and the mean of their normals meets the surface. The mesh stays as
/// it is; the last step is `to`.
pub(super) fn trace_straight(mesh: &RegionMesh, from: u32, to: u32) -> Result<Vec<TraceStep>, TraceFailure> {
    let at = |p: u32| mesh.position(p);
    let aim = at(to) - at(from);
    let normal = point_normal(mesh, from) + point_normal(mesh, to);
    let Some(across) = aim.cross(normal).try_normalize() else {
        return Err(TraceFailure::Blocked);
    };
    let side = |p: u32| across.dot(at(p) - at(from));
    // Where the plane crosses an edge, or the end that it all but goes through.
    let crossing = |u: u32, v: u32| -> Option<(TraceStep, DVec3)> {
        let (g, h) = (side(u), side(v));
        if g == 0.0 || h == 0.0 {
            let p = if g == 0.0 { u } else { v };
            return Some((TraceStep::Point(p), at(p)));
        }
        if (g > 0.0) == (h > 0.0) {
            return None;
        }
        let t = g / (g - h);
        Some(if t < SNAP {
            (TraceStep::Point(u), at(u))
        } else if t > 1.0 - SNAP {
            (TraceStep::Point(v), at(v))
        } else {
            (TraceStep::Edge { a: u, b: v, t }, at(u).lerp(at(v), t))
        })
    };
    let (mut steps, mut passed, mut crossed) = (Vec::new(), BTreeSet::from([from]), BTreeSet::new());
    let (mut here, mut heading, mut travelled) = (at(from), aim, 0.0);
    // Either at a point, or on an edge about to enter a face.
    let mut entering: Option<(u32, u32, u32)> = None;
    let mut point = from;
    loop {
        let (step, place, left) = match entering {
            None => {
                if mesh.has_edge(point, to) {
                    steps.push(TraceStep::Point(to));
                    return Ok(steps);
                }
                if !mesh.points[point as usize].whole {
                    return Err(TraceFailure::Leaves);
                }
                let mut best: Option<(f64, TraceStep, DVec3, u32)> = None;
                for &f in mesh.faces_around(point) {
                    let face = &mesh.faces[f as usize];
                    let Some(k) = face.corner_of(point) else {
                        continue;
                    };
                    let Some((step, place)) = crossing(face.points[(k + 1) % 3], face.points[(k + 2) % 3]) else {
                        continue;
                    };
                    let taken = match step {
                        TraceStep::Point(p) => passed.contains(&p),
                        TraceStep::Edge { a, b, .. } => crossed.contains(&edge_key(a, b)),
                    };
                    let forward = (place - here).normalize_or_zero().dot(heading.normalize_or_zero());
                    if !taken && forward > 0.0 && best.is_none_or(|b| forward > b.0) {
                        best = Some((forward, step, place, f));
                    }
                }
                let (_, step, place, f) = best.ok_or(TraceFailure::Blocked)?;
                (step, place, f)
            }
            Some((a, b, f)) => {
                let face = &mesh.faces[f as usize];
                let Some(apex) = face.points.into_iter().find(|&p| p != a && p != b) else {
                    return Err(TraceFailure::Blocked);
                };
                if apex == to {
                    steps.push(TraceStep::Point(to));
                    return Ok(steps);
                }
                let exit = if (side(a) > 0.0) == (side(apex) > 0.0) { b } else { a };
                let (step, place) = crossing(exit, apex).ok_or(TraceFailure::Blocked)?;
                (step, place, f)
            }
        };
        travelled += place.distance(here);
        if travelled > DETOUR * aim.length() || steps.len() > mesh.faces.len() {
            return Err(TraceFailure::Blocked);
        }
        heading = place - here;
        here = place;
        steps.push(step);
        match step {
            TraceStep::Point(p) if p == to => return Ok(steps),
            TraceStep::Point(p) => {
                if !passed.insert(p) {
                    return Err(TraceFailure::Blocked);
                }
                (entering, point) = (None, p);
            }
            TraceStep::Edge { a, b, .. } => {
                if !(mesh.points[a as usize].whole || mesh.points[b as usize].whole) {
                    return Err(TraceFailure::Leaves);
                }
                if !crossed.insert(edge_key(a, b)) {
                    return Err(TraceFailure::Blocked);
                }
                let next = mesh
                    .faces_along(a, b)
                    .find(|&g| g != left)
                    .ok_or(TraceFailure::Blocked)?;
                entering = Some((a, b, next));
            }
        }
    }
}

/// The shortest way along edges, as the points after `from` up to `to` (Dijkstra).
pub(super) fn trace_along_edges(mesh: &RegionMesh, from: u32, to: u32) -> Result<Vec<u32>, TraceFailure> {
    let at = |p: u32| mesh.position(p);
    let mut reached: BTreeMap<u32, (f64, u32)> = BTreeMap::from([(from, (0.0, from))]);
    // Lengths are not negative, so their bits have their order.
    let mut open = BinaryHeap::from([Reverse((0u64, from))]);
    let mut cut_off = false;
    while let Some(Reverse((bits, p))) = open.pop() {
        let far = f64::from_bits(bits);
        if p == to {
            let mut way = vec![to];
            while let Some(&(_, before)) = way.last().and_then(|p| reached.get(p)) {
                if before == from {
                    break;
                }
                way.push(before);
            }
            way.reverse();
            return Ok(way);
        }
        if reached.get(&p).is_some_and(|r| r.0 < far) {
            continue;
        }
        if !mesh.points[p as usize].whole {
            cut_off = true;
            continue;
        }
        for &f in mesh.faces_around(p) {
            for q in mesh.faces[f as usize].points {
                let length = far + at(p).distance(at(q));
                if q != p && reached.get(&q).is_none_or(|r| length < r.0) {
                    reached.insert(q, (length, p));
                    open.push(Reverse((length.to_bits(), q)));
                }
            }
        }
    }
    Err(if cut_off {
        TraceFailure::Leaves
    } else {
        TraceFailure::Blocked
    })
}

/// The mean of the normals around a point, weighted by area, of length 1 or 0.
fn point_normal(mesh: &RegionMesh, p: u32) -> DVec3 {
    let sum: DVec3 = mesh.faces_around(p).iter().map(|&f| mesh.area_normal(f)).sum();
    sum.normalize_or_zero()
}
