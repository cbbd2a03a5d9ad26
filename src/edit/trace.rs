//! Ways over a draft between two of its points: straight across faces, or along edges.

use super::draft::{Draft, key};
use glam::DVec3;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

/// A crossing nearer than this fraction of the edge to one of its ends goes through that end.
pub(super) const SNAP: f64 = 0.01;

/// A way longer than this many straight distances is not the one that was drawn.
const DETOUR: f64 = 4.0;

/// A step of a straight way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Step {
    /// Across the edge from `a` to `b`, at the fraction `t`.
    Edge { a: u32, b: u32, t: f64 },
    /// Through a point.
    Point(u32),
}

/// Why there is no way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stuck {
    /// It leaves the faces that the draft knows all neighbours of.
    Leaves,
    /// A rim, a turn, or a detour stands in between.
    Blocked,
}

/// The line in which the plane through `from`, `to` and the mean of their normals meets the surface. The draft stays as
/// it is; the last step is `to`.
pub(super) fn straight(draft: &Draft<'_>, from: u32, to: u32) -> Result<Vec<Step>, Stuck> {
    let at = |p: u32| draft.positions[p as usize];
    let aim = at(to) - at(from);
    let normal = point_normal(draft, from) + point_normal(draft, to);
    let Some(across) = aim.cross(normal).try_normalize() else {
        return Err(Stuck::Blocked);
    };
    let side = |p: u32| across.dot(at(p) - at(from));
    // Where the plane crosses an edge, or the end that it all but goes through.
    let crossing = |u: u32, v: u32| -> Option<(Step, DVec3)> {
        let (g, h) = (side(u), side(v));
        if g == 0.0 || h == 0.0 {
            let p = if g == 0.0 { u } else { v };
            return Some((Step::Point(p), at(p)));
        }
        if (g > 0.0) == (h > 0.0) {
            return None;
        }
        let t = g / (g - h);
        Some(if t < SNAP {
            (Step::Point(u), at(u))
        } else if t > 1.0 - SNAP {
            (Step::Point(v), at(v))
        } else {
            (Step::Edge { a: u, b: v, t }, at(u).lerp(at(v), t))
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
                if draft.has_edge(point, to) {
                    steps.push(Step::Point(to));
                    return Ok(steps);
                }
                if !draft.whole[point as usize] {
                    return Err(Stuck::Leaves);
                }
                let mut best: Option<(f64, Step, DVec3, u32)> = None;
                for &f in &draft.around[point as usize] {
                    let face = &draft.faces[f as usize];
                    let Some(k) = face.corner_of(point) else {
                        continue;
                    };
                    let Some((step, place)) = crossing(face.corners[(k + 1) % 3], face.corners[(k + 2) % 3]) else {
                        continue;
                    };
                    let taken = match step {
                        Step::Point(p) => passed.contains(&p),
                        Step::Edge { a, b, .. } => crossed.contains(&key(a, b)),
                    };
                    let forward = (place - here).normalize_or_zero().dot(heading.normalize_or_zero());
                    if !taken && forward > 0.0 && best.is_none_or(|b| forward > b.0) {
                        best = Some((forward, step, place, f));
                    }
                }
                let (_, step, place, f) = best.ok_or(Stuck::Blocked)?;
                (step, place, f)
            }
            Some((a, b, f)) => {
                let face = &draft.faces[f as usize];
                let Some(apex) = face.corners.into_iter().find(|&p| p != a && p != b) else {
                    return Err(Stuck::Blocked);
                };
                if apex == to {
                    steps.push(Step::Point(to));
                    return Ok(steps);
                }
                let exit = if (side(a) > 0.0) == (side(apex) > 0.0) { b } else { a };
                let (step, place) = crossing(exit, apex).ok_or(Stuck::Blocked)?;
                (step, place, f)
            }
        };
        travelled += place.distance(here);
        if travelled > DETOUR * aim.length() || steps.len() > draft.faces.len() {
            return Err(Stuck::Blocked);
        }
        heading = place - here;
        here = place;
        steps.push(step);
        match step {
            Step::Point(p) if p == to => return Ok(steps),
            Step::Point(p) => {
                if !passed.insert(p) {
                    return Err(Stuck::Blocked);
                }
                (entering, point) = (None, p);
            }
            Step::Edge { a, b, .. } => {
                if !(draft.whole[a as usize] || draft.whole[b as usize]) {
                    return Err(Stuck::Leaves);
                }
                if !crossed.insert(key(a, b)) {
                    return Err(Stuck::Blocked);
                }
                let next = draft.along(a, b).find(|&g| g != left).ok_or(Stuck::Blocked)?;
                entering = Some((a, b, next));
            }
        }
    }
}

/// The shortest way along edges, as the points after `from` up to `to` (Dijkstra).
pub(super) fn along_edges(draft: &Draft<'_>, from: u32, to: u32) -> Result<Vec<u32>, Stuck> {
    let at = |p: u32| draft.positions[p as usize];
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
        if !draft.whole[p as usize] {
            cut_off = true;
            continue;
        }
        for &f in &draft.around[p as usize] {
            for q in draft.faces[f as usize].corners {
                let length = far + at(p).distance(at(q));
                if q != p && reached.get(&q).is_none_or(|r| length < r.0) {
                    reached.insert(q, (length, p));
                    open.push(Reverse((length.to_bits(), q)));
                }
            }
        }
    }
    Err(if cut_off { Stuck::Leaves } else { Stuck::Blocked })
}

/// The mean of the normals around a point, weighted by area, of length 1 or 0.
fn point_normal(draft: &Draft<'_>, p: u32) -> DVec3 {
    let sum: DVec3 = draft.around[p as usize].iter().map(|&f| draft.area_normal(f)).sum();
    sum.normalize_or_zero()
}
