//! What an edit does to the parts that enclose space: which new points belong to them, and which passages along edges
//! they lack to be closed.

use crate::graph::recipe::InteriorRecipe;
use crate::graph::resample::change::GraphBefore;
use crate::graph::resample::change::{ChangedPoints, MeshChange};
use crate::graph::volume::caps::{missing_of, rings};
use crate::graph::volume::solid::{OPEN, SOUP, sample};
use crate::graph::winding::tree::WindingTree;
use crate::mesh::{Components, NONE};
use crate::pool::Pool;
use glam::DVec3;
use rayon::prelude::*;

/// Caps of new holes may be as large as this part of their surface; with more of it open, the whole surface decides
/// whether it still encloses anything.
const LARGEST_CAP: f64 = 0.15;
/// Winding numbers are asked this part of an offset beside a face.
pub(super) const BESIDE: f64 = 1.0 / 64.0;

/// Parts that enclose space after an edit.
pub(super) struct HullChange {
    /// As in [`InteriorRecipe`].
    pub(super) reach: Vec<f32>,
    /// As in [`InteriorRecipe`].
    pub(super) open: Vec<[u32; 2]>,
    /// New parts whose sides are not known yet: their points, by new number.
    pub(super) unsided: Vec<Vec<u32>>,
    /// Loops of new points that faces close.
    pub(super) loops: Vec<Vec<u32>>,
    /// Those of them that are new, and those that are no more, by old points.
    pub(super) new_loops: Vec<Vec<u32>>,
    pub(super) lost_loops: Vec<Vec<u32>>,
}

/// The fan over a loop: its middle, and a face for each edge.
pub(super) fn fan_over_loop(ring: &[u32], at: impl Fn(u32) -> DVec3) -> (DVec3, impl Iterator<Item = [u32; 2]> + '_) {
    let middle = ring.iter().map(|&v| at(v)).sum::<DVec3>() / ring.len() as f64;
    let next = ring.iter().cycle().skip(1);
    (middle, ring.iter().zip(next).map(|(&a, &b)| [a, b]))
}

/// Follows an edit. `None` when only the whole surface shows what it encloses now.
pub(super) fn follow_hull(
    old: &GraphBefore<'_>,
    inside: &InteriorRecipe,
    change: &MeshChange,
    points: &ChangedPoints,
    pool: &Pool,
) -> Option<HullChange> {
    let (assigned, fresh) = assign_reach(inside, change, points)?;
    let mut reach: Vec<f32> = pool.install(|| {
        let of = |&o: &u32| if o == NONE { 0.0 } else { inside.reach[o as usize] };
        change.old_from_new.par_iter().with_min_len(1 << 14).map(of).collect()
    });
    assigned.iter().for_each(|&(p, r)| reach[p as usize] = r);

    let mut unsided = Vec::new();
    for part in fresh {
        let solid = enclosing_edge_length(change, &part, pool)?;
        if solid > 0.0 {
            let offset = solid.min(old.stats.shell_offset) as f32;
            part.points.iter().for_each(|&p| reach[p as usize] = offset);
            unsided.push(part.points);
        }
    }

    let open = missing_passages(inside, change, points, &reach)?;
    let before = passage_loops(&inside.open);
    let loops = if open == inside.open {
        before.clone()
    } else {
        passage_loops(&open)
    };
    let turned = |ring: Vec<u32>| {
        let first = (0..ring.len()).min_by_key(|&k| ring[k]).unwrap_or(0);
        let mut ring = ring;
        ring.rotate_left(first);
        ring
    };
    // What each old loop is now, where none of its points changed.
    let still = |ring: &Vec<u32>| -> Option<Vec<u32>> {
        let to = |&v: &u32| Some(points.new_from_old[v as usize]).filter(|&n| n != NONE && !points.moved[n as usize]);
        ring.iter().map(to).collect::<Option<Vec<u32>>>().map(turned)
    };
    let mut known: Vec<Vec<u32>> = before.iter().filter_map(still).collect();
    known.sort_unstable();
    let mut there: Vec<Vec<u32>> = loops.iter().cloned().map(turned).collect();
    there.sort_unstable();
    let lost = |ring: &&Vec<u32>| still(ring).is_none_or(|r| there.binary_search(&r).is_err());
    let lost_loops = before.iter().filter(lost).cloned().collect();
    let is_new = |ring: &&Vec<u32>| known.binary_search(&turned((*ring).clone())).is_err();
    let new_loops: Vec<Vec<u32>> = loops.iter().filter(is_new).cloned().collect();
    let hull = HullChange {
        reach,
        open,
        unsided,
        loops,
        new_loops,
        lost_loops,
    };
    (!too_open(old, change, &hull)).then_some(hull)
}

/// New points with their reach.
type NewReach = Vec<(u32, f32)>;

/// Triangles and points that are new and hang together with no old point.
struct NewPart {
    triangles: Vec<[u32; 3]>,
    points: Vec<u32>,
}

/// The reach of new points that hang together with old ones, and the new parts. `None` where an edit joins what encloses
/// space with what does not.
fn assign_reach(
    inside: &InteriorRecipe,
    change: &MeshChange,
    points: &ChangedPoints,
) -> Option<(NewReach, Vec<NewPart>)> {
    let faces: Vec<[u32; 3]> = change.added.iter().map(|&t| change.triangles[t as usize]).collect();
    let mut used: Vec<u32> = faces.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    let local = |v: u32| used.binary_search(&v).unwrap_or(0) as u32;
    let small: Vec<[u32; 3]> = faces.iter().map(|t| t.map(local)).collect();
    let groups = Components::of_triangles(used.len(), &small);
    let mut seen: Vec<Option<f32>> = vec![None; groups.count];
    for (&v, &group) in used.iter().zip(&groups.of_vertex) {
        let known = &mut seen[group as usize];
        if (v as usize) < points.kept {
            let own = inside.reach[change.old_from_new[v as usize] as usize];
            match *known {
                None => *known = Some(own),
                Some(other) if (own > 0.0) != (other > 0.0) || (own < 0.0) != (other < 0.0) => return None,
                Some(_) => {}
            }
        }
    }
    let mut assigned = Vec::new();
    let mut fresh: Vec<Option<NewPart>> = seen
        .iter()
        .map(|s| {
            s.is_none().then(|| NewPart {
                triangles: Vec::new(),
                points: Vec::new(),
            })
        })
        .collect();
    for (&v, &group) in used.iter().zip(&groups.of_vertex) {
        match (seen[group as usize], &mut fresh[group as usize]) {
            (Some(reach), _) if v as usize >= points.kept => assigned.push((v, reach)),
            (None, Some(part)) => part.points.push(v),
            _ => {}
        }
    }
    for (face, t) in faces.iter().zip(&small) {
        if let Some(part) = &mut fresh[groups.of_vertex[t[0] as usize] as usize] {
            part.triangles.push(*face);
        }
    }
    Some((assigned, fresh.into_iter().flatten().collect()))
}

/// The mean edge length of a new part when it encloses space, else 0; `None` when only its winding number shows it.
fn enclosing_edge_length(change: &MeshChange, part: &NewPart, pool: &Pool) -> Option<f64> {
    let at = |v: u32| change.positions[v as usize];
    let mut length = 0.0;
    let mut passed: Vec<([u32; 2], i32)> = Vec::with_capacity(3 * part.triangles.len());
    for t in &part.triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            length += at(a).distance(at(b));
            passed.push(([a.min(b), a.max(b)], if a < b { 1 } else { -1 }));
        }
    }
    let mean = length / passed.len() as f64;
    passed.sort_unstable();
    let (mut edges, mut open) = (0usize, 0usize);
    for edge in passed.chunk_by(|a, b| a.0 == b.0) {
        edges += 1;
        open += usize::from(edge.iter().map(|e| e.1).sum::<i32>() != 0);
    }
    if open == 0 {
        return Some(mean);
    }
    let tree = WindingTree::build(change.positions, &part.triangles, pool);
    let faces = sample((0..part.triangles.len() as u32).collect(), 1, |_| 0);
    let mut seen = (0.0, 0.0);
    for t in faces {
        let [a, b, c] = part.triangles[t as usize].map(at);
        if let Some(normal) = (b - a).cross(c - a).try_normalize() {
            let winding = tree.rough_winding_number((a + b + c) / 3.0 - normal * (mean * BESIDE));
            seen = (seen.0 + (winding - winding.round()).abs(), seen.1 + 1.0);
        }
    }
    match seen.1 > 0.0 && seen.0 <= OPEN * seen.1 {
        false => Some(0.0),
        true if open * SOUP > edges => None,
        true => Some(mean),
    }
}

/// The passages that enclosing parts lack after an edit. `None` when an edge of a point that is gone keeps a face, so
/// that the edit contradicts itself.
fn missing_passages(
    inside: &InteriorRecipe,
    change: &MeshChange,
    points: &ChangedPoints,
    reach: &[f32],
) -> Option<Vec<[u32; 2]>> {
    let beyond = change.positions.len() as u32;
    let name = |old: u32| match points.new_from_old[old as usize] {
        NONE => beyond + old,
        new => new,
    };
    let mut passed: Vec<([u32; 2], i32)> = Vec::new();
    let mut pass = |a: u32, b: u32, times: i32| {
        passed.push(([a.min(b), a.max(b)], if a < b { times } else { -times }));
    };
    inside.open.iter().for_each(|&[a, b]| pass(name(a), name(b), -1));
    let mut face = |[a, b, c]: [u32; 3], times: i32| {
        pass(a, b, times);
        pass(b, c, times);
        pass(c, a, times);
    };
    let removed = change.removed.iter().filter(|t| inside.reach[t[0] as usize] != 0.0);
    removed.for_each(|t| face(t.map(name), -1));
    let added = change.added.iter().map(|&t| change.triangles[t as usize]);
    added.filter(|t| reach[t[0] as usize] != 0.0).for_each(|t| face(t, 1));
    passed.sort_unstable();
    let mut open = Vec::new();
    for edge in passed.chunk_by(|a, b| a.0 == b.0) {
        let sum: i32 = edge.iter().map(|e| e.1).sum();
        if sum != 0 && edge[0].0[1] >= beyond {
            return None;
        }
        open.extend(missing_of(edge[0].0, sum));
    }
    open.sort_unstable();
    Some(open)
}

/// The loops that sorted passages run in.
fn passage_loops(open: &[[u32; 2]]) -> Vec<Vec<u32>> {
    let mut used: Vec<u32> = open.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    let local = |v: u32| used.binary_search(&v).unwrap_or(0) as u32;
    // Renumbering keeps the order, so the passages stay sorted.
    let small: Vec<[u32; 2]> = open.iter().map(|p| p.map(local)).collect();
    let rings = rings(used.len(), &small);
    rings
        .into_iter()
        .map(|ring| ring.into_iter().map(|v| used[v as usize]).collect())
        .collect()
}

/// Whether holes grew by much against the surface that they are in.
fn too_open(old: &GraphBefore<'_>, change: &MeshChange, hull: &HullChange) -> bool {
    let now = |v: u32| change.positions[v as usize];
    let before = |v: u32| old.positions[v as usize];
    let mut caps: Vec<(u32, f64)> = Vec::new();
    for ring in &hull.new_loops {
        let known = ring
            .iter()
            .map(|&v| change.old_from_new[v as usize])
            .find(|&o| o != NONE);
        caps.extend(known.map(|o| (old.component[o as usize], cap_area(ring, now))));
    }
    let lost = hull.lost_loops.iter();
    caps.extend(lost.map(|ring| (old.component[ring[0] as usize], -cap_area(ring, before))));
    caps.sort_by_key(|c| c.0);
    caps.chunk_by(|a, b| a.0 == b.0).any(|of_part| {
        let cap: f64 = of_part.iter().map(|c| c.1).sum();
        let part = of_part[0].0;
        let vertices = old.component[..old.surface].iter().filter(|&&c| c == part).count();
        // Two equilateral faces for each vertex.
        let edge = old.stats.shell_offset;
        cap > LARGEST_CAP * vertices as f64 * edge * edge * 0.866
    })
}

fn cap_area(ring: &[u32], at: impl Fn(u32) -> DVec3 + Copy) -> f64 {
    let (middle, edges) = fan_over_loop(ring, at);
    edges
        .map(|[a, b]| 0.5 * (at(a) - middle).cross(at(b) - middle).length())
        .sum()
}
