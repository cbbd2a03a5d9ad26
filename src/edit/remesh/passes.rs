//! The passes of Botsch and Kobbelt (2004): split long edges, collapse short ones, turn edges towards even valences,
//! even out.

use super::state::{Place, State};
use crate::edit::Error;
use crate::edit::editable::triangle;
use crate::progress::{Progress, check};
use glam::DVec3;

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

fn stop(progress: &dyn Progress) -> Result<(), Error> {
    check(progress).map_err(|_| Error::Cancelled)
}

/// Splits edges that are too long, the longest first, until none is or `most` faces are there.
pub(super) fn split_long(state: &mut State, most: usize, progress: &dyn Progress) -> Result<usize, Error> {
    let mut count = 0;
    // Each round halves the longest edges, so a few do even for lengths that differ a thousandfold.
    for _ in 0..24 {
        let mut long: Vec<(u64, (u32, u32))> = Vec::new();
        for (a, b) in state.mesh.edges() {
            let relative = state.relative_length(a, b);
            if relative > LONG {
                long.push((relative.to_bits(), (a, b)));
            }
        }
        long.sort_unstable_by_key(|&(bits, edge)| (std::cmp::Reverse(bits), edge));
        let mut split = 0;
        for (i, &(_, (a, b))) in long.iter().enumerate() {
            if i % 1024 == 0 {
                stop(progress)?;
            }
            if state.mesh.faces.len() >= most {
                return Ok(count + split);
            }
            split += usize::from(state.split(a, b));
        }
        count += split;
        if split == 0 {
            break;
        }
    }
    Ok(count)
}

/// Collapses edges that are too short, the shortest first, unless that makes one too long or a needle.
pub(super) fn collapse_short(state: &mut State, progress: &dyn Progress) -> Result<usize, Error> {
    let mut short: Vec<(u64, (u32, u32))> = Vec::new();
    for (a, b) in state.mesh.edges() {
        let relative = state.relative_length(a, b);
        if relative < SHORT {
            short.push((relative.to_bits(), (a, b)));
        }
    }
    short.sort_unstable();
    let mut count = 0;
    for (i, &(_, (a, b))) in short.iter().enumerate() {
        if i % 1024 == 0 {
            stop(progress)?;
        }
        if state.mesh.edge(a, b).faces().next().is_none() || state.relative_length(a, b) >= SHORT {
            continue;
        }
        for (from, to) in [(a, b), (b, a)] {
            let limit = LONG * 0.5 * (state.sizes[from as usize] + state.sizes[to as usize]);
            let before = state.worst_aspect(from, state.mesh.at(from));
            let done = state.collapse(from, to, |_, after| {
                after.iter().all(|t| {
                    let longest = t[0].distance(t[1]).max(t[1].distance(t[2])).max(t[2].distance(t[0]));
                    longest <= limit && triangle::aspect(*t) <= before.max(2.0 * GOOD)
                })
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
fn unevenness(state: &State, points: [(u32, i64); 4]) -> i64 {
    let of = |(p, change): (u32, i64)| {
        let (neighbours, faces) = match state.places[p as usize] {
            Place::Inside(_) => {
                let faces = state.mesh.points[p as usize].faces.len();
                (faces, faces)
            }
            _ => state.mesh.valence(p),
        };
        let best = if neighbours > faces { 4 } else { 6 };
        (neighbours as i64 + change - best).pow(2)
    };
    points.into_iter().map(of).sum()
}

/// Turns edges where that brings valences nearer to six (four on a boundary).
pub(super) fn flip(state: &mut State, progress: &dyn Progress) -> Result<usize, Error> {
    let mut count = 0;
    for (i, (a, b)) in state.mesh.edges().into_iter().enumerate() {
        if i % 1024 == 0 {
            stop(progress)?;
        }
        let edge = state.mesh.edge(a, b);
        if !state.mesh.is_inside(edge, a, b) {
            continue;
        }
        let (Some(c), Some(d)) = (state.mesh.across(edge.left, a, b), state.mesh.across(edge.right, a, b)) else {
            continue;
        };
        let now = unevenness(state, [(a, 0), (b, 0), (c, 0), (d, 0)]);
        let then = unevenness(state, [(a, -1), (b, -1), (c, 1), (d, 1)]);
        if then < now {
            count += usize::from(try_flip(state, a, b, |before, after| after <= before.max(GOOD)));
        }
    }
    Ok(count)
}

/// Turns the edge if it is inside, the pair is nearly flat, no face turns over, and `accept` likes the worst aspect
/// after it, given that before.
pub(super) fn try_flip(state: &mut State, a: u32, b: u32, accept: impl Fn(f64, f64) -> bool) -> bool {
    let edge = state.mesh.edge(a, b);
    if state.curves.piece(a, b).is_some() {
        return false;
    }
    let Some(after) = state.mesh.flipped(edge, a, b) else {
        return false;
    };
    let before = [edge.left, edge.right].map(|f| state.mesh.corners_of(f));
    let worst = |pair: [[DVec3; 3]; 2]| triangle::aspect(pair[0]).max(triangle::aspect(pair[1]));
    let normal = triangle::area_normal(before[0]) + triangle::area_normal(before[1]);
    let flat = after.iter().all(|&t| {
        let turned = triangle::cosine(triangle::area_normal(t), normal);
        turned.is_some_and(|c| c >= FLAT)
    });
    let faithful = [edge.left, edge.right]
        .into_iter()
        .all(|f| after.iter().all(|&t| state.is_faithful(f, t)));
    if !flat || !faithful || !accept(worst(before), worst(after)) {
        return false;
    }
    if !after.iter().all(|&t| state.agrees(edge.left, t)) {
        return false;
    }
    state.mesh.flip(edge, a, b);
    true
}

/// Moves inner points towards the middle of their neighbours, along the surface, and points of lines along those.
pub(super) fn smooth(state: &mut State, progress: &dyn Progress) -> Result<(), Error> {
    for p in 0..state.places.len() as u32 {
        if p % 1024 == 0 {
            stop(progress)?;
        }
        if state.mesh.points[p as usize].faces.is_empty() {
            continue;
        }
        let here = state.mesh.at(p);
        let before = state.worst_aspect(p, here);
        let still = STILL * state.sizes[p as usize];
        let accept = |s: &State, to: DVec3| s.worst_aspect(p, to) <= before.max(GOOD) && to.distance(here) > still;
        match state.places[p as usize] {
            Place::Held => {}
            Place::On(on) => {
                let ends = on.beside.map(|q| state.curves.piece(p, q).map(|piece| piece.at[1]));
                if let [Some(s), Some(t)] = ends {
                    state.slide(p, on, 0.5 * (s + t), accept);
                }
            }
            Place::Inside(_) => {
                let around = state.mesh.neighbours(p);
                let middle = around.iter().map(|&q| state.mesh.at(q)).sum::<DVec3>() / around.len().max(1) as f64;
                let normals = state.mesh.points[p as usize].faces.iter();
                let normal: DVec3 = normals.map(|&f| triangle::area_normal(state.mesh.corners_of(f))).sum();
                let normal = normal.normalize_or_zero();
                let step = middle - here;
                let step = step - normal * normal.dot(step);
                if step.length() <= still || !step.is_finite() {
                    continue;
                }
                // Half the way where the whole would turn a face over.
                if !state.move_inside(p, here + step, accept) {
                    state.move_inside(p, here + step * 0.5, accept);
                }
            }
        }
    }
    state.refresh_sources();
    Ok(())
}

/// Mends faces worse than `bound` by turning their longest edge, else by collapsing their shortest, and faces that stand
/// against the surface beside them by turning an edge. The worst come first. Says how many it mended.
pub(super) fn mend(state: &mut State, bound: f64, progress: &dyn Progress) -> Result<usize, Error> {
    stop(progress)?;
    let mut bad: Vec<(u64, u32)> = Vec::new();
    for f in state.mesh.living() {
        let aspect = triangle::aspect(state.mesh.corners_of(f));
        if aspect > bound || state.stands_against(f) {
            bad.push((aspect.to_bits(), f));
        }
    }
    bad.sort_unstable_by_key(|&(bits, f)| (std::cmp::Reverse(bits), f));
    let mut count = 0;
    for (_, f) in bad {
        if !state.mesh.faces[f as usize].alive {
            continue;
        }
        if triangle::aspect(state.mesh.corners_of(f)) > bound {
            count += usize::from(mend_face(state, f));
        } else if state.stands_against(f) {
            count += usize::from(mend_against(state, f, bound));
        }
    }
    Ok(count)
}

/// A face that cuts off a thin part of the surface: other edges may follow it.
fn mend_against(state: &mut State, f: u32, bound: f64) -> bool {
    let p = state.mesh.points_of(f);
    let mut sides = [0, 1, 2].map(|i| (p[i], p[(i + 1) % 3]));
    sides.sort_by(|x, y| state.mesh.length(y.0, y.1).total_cmp(&state.mesh.length(x.0, x.1)));
    (sides.into_iter()).any(|(a, b)| try_flip(state, a, b, |before, after| after <= before.max(bound)))
}

fn mend_face(state: &mut State, f: u32) -> bool {
    let p = state.mesh.points_of(f);
    let mut sides = [0, 1, 2].map(|i| (p[i], p[(i + 1) % 3]));
    sides.sort_by(|x, y| state.mesh.length(x.0, x.1).total_cmp(&state.mesh.length(y.0, y.1)));
    let [short, _, long] = sides;
    if try_flip(state, long.0, long.1, |before, after| after < before) {
        return true;
    }
    let own = triangle::aspect(state.mesh.corners_of(f));
    for (from, to) in [short, (short.1, short.0)] {
        let mut before = own;
        for &g in &state.mesh.points[from as usize].faces {
            before = before.max(triangle::aspect(state.mesh.corners_of(g)));
        }
        let limit = 2.0 * LONG * state.sizes[from as usize].max(state.sizes[to as usize]);
        let longest = |t: &[DVec3; 3]| t[0].distance(t[1]).max(t[1].distance(t[2])).max(t[2].distance(t[0]));
        let done = state.collapse(from, to, |_, after| {
            after
                .iter()
                .all(|t| triangle::aspect(*t) < before.min(own.max(GOOD)) && longest(t) <= limit)
        });
        if done {
            return true;
        }
    }
    // A cap over a line: the line gets a point below its tip, or the tip moves off.
    let tip = p.into_iter().find(|&q| q != long.0 && q != long.1);
    if let Some(tip) = tip
        && matches!(state.places[tip as usize], Place::Inside(_))
    {
        let here = state.mesh.at(tip);
        let around = state.mesh.neighbours(tip);
        let middle = around.iter().map(|&q| state.mesh.at(q)).sum::<DVec3>() / around.len().max(1) as f64;
        let before = state.worst_aspect(tip, here);
        return [1.0, 0.5, 0.25].into_iter().any(|part| {
            state.move_inside(tip, here + (middle - here) * part, |s, to| {
                s.worst_aspect(tip, to) < before * 0.95
            })
        });
    }
    false
}
