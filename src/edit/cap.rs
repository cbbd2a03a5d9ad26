//! Closing flat openings: the loops that a plane leaves are filled by triangles in that plane.
//!
//! Loops inside loops are holes of the section, loops inside those are islands. Each opening's triangles belong to the
//! primitive that most of its edges have.

use super::Error;
use super::draft::{CAP, Draft};
use super::local::trails;
use super::polygon;
use super::refine::{Size, WHOLE_EDGES, refine};
use crate::progress::Progress;
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;

/// Fills the openings along `rim` (sides of live faces: from, to, face), which lie in a plane with the outward normal
/// `normal`. `hard[p]`: caps of primitive `p` do not share vertices with the surface beside them.
pub(super) fn cap_plane(
    draft: &mut Draft<'_>,
    rim: &[(u32, u32, u32)],
    normal: DVec3,
    hard: &[bool],
    progress: &dyn Progress,
) -> Result<(), Error> {
    let edges: Vec<[u32; 2]> = rim.iter().map(|&(from, to, _)| [to, from]).collect();
    let (mut closed, open) = trails(&edges);
    for trail in open {
        let ends = [trail[0], trail[trail.len() - 1]].map(|p| draft.positions[p as usize]);
        draft.warnings.push((
            "open-section".to_owned(),
            format!(
                "the cut runs from rim to rim over {} edges and encloses nothing to fill",
                trail.len() - 1
            ),
            format!("{} to {}", ends[0], ends[1]),
        ));
    }
    closed.retain(|ring| {
        if ring.len() < 3 {
            draft.warnings.push((
                "open-section".to_owned(),
                "a section of two edges is not filled".to_owned(),
                format!("{}", draft.positions[ring[0] as usize]),
            ));
        }
        ring.len() >= 3
    });
    let Some(origin) = closed.first().map(|ring| draft.positions[ring[0] as usize]) else {
        return Ok(());
    };
    let right = normal.any_orthonormal_vector();
    let up = normal.cross(right);
    let mut flat: Vec<DVec2> = Vec::new();
    let mut number: BTreeMap<u32, u32> = BTreeMap::new();
    let mut points: Vec<u32> = Vec::new();
    for &p in closed.iter().flatten() {
        number.entry(p).or_insert_with(|| {
            let x = draft.positions[p as usize] - origin;
            flat.push(DVec2::new(x.dot(right), x.dot(up)));
            points.push(p);
            points.len() as u32 - 1
        });
    }
    let rings: Vec<Vec<u32>> = closed
        .iter()
        .map(|ring| ring.iter().map(|p| number[p]).collect())
        .collect();
    for (outer, holes) in nest(&mut flat, &rings) {
        if progress.cancelled() {
            return Err(Error::Cancelled);
        }
        let mut at = flat.clone();
        let mirrored = polygon::double_area(|p| at[p as usize], outer) < 0.0;
        if mirrored {
            at.iter_mut().for_each(|p| p.y = -p.y);
        }
        let found = polygon::triangulate(&at, outer, &holes, progress).map_err(|_| Error::Cancelled)?;
        let loops: Vec<Vec<u32>> = std::iter::once(outer)
            .chain(holes.iter().map(Vec::as_slice))
            .map(|ring| ring.iter().map(|&p| points[p as usize]).collect())
            .collect();
        let mut rim = Rim::of(draft, &loops, hard);
        rim.sizes.values_mut().for_each(|s| *s *= WHOLE_EDGES);
        let first = draft.faces.len();
        match found {
            Some(triangles) => {
                for t in triangles {
                    rim.add(draft, t.map(|p| points[p as usize]));
                }
            }
            None => loops.iter().for_each(|ring| rim.fan(draft, ring)),
        }
        part_double_edges(draft, first);
        refine(draft, first, &rim.sizes, Size::of_loop(rim.wedges.len()), progress)?;
    }
    Ok(())
}

/// Sorts loops into openings: an outer loop and its holes. Mirrors all coordinates when most of the section is wound
/// clockwise: the surface is inside out.
fn nest<'a>(flat: &mut [DVec2], rings: &'a [Vec<u32>]) -> Vec<(&'a [u32], Vec<Vec<u32>>)> {
    let total: f64 = rings
        .iter()
        .map(|r| polygon::double_area(|p| flat[p as usize], r))
        .sum();
    if total < 0.0 {
        flat.iter_mut().for_each(|p| p.y = -p.y);
    }
    let at = |p: u32| flat[p as usize];
    let area: Vec<f64> = rings.iter().map(|r| polygon::double_area(at, r)).collect();
    let bounds: Vec<(DVec2, DVec2)> = (rings.iter())
        .map(|r| {
            r.iter()
                .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), &p| {
                    (low.min(at(p)), high.max(at(p)))
                })
        })
        .collect();
    let mut holes: Vec<Vec<Vec<u32>>> = vec![Vec::new(); rings.len()];
    let mut outer: Vec<usize> = Vec::new();
    for (i, ring) in rings.iter().enumerate() {
        if area[i] >= 0.0 {
            outer.push(i);
            continue;
        }
        let around = (0..rings.len())
            .filter(|&j| area[j] > 0.0 && area[j] >= -area[i])
            .filter(|&j| bounds[j].0.cmple(bounds[i].0).all() && bounds[j].1.cmpge(bounds[i].1).all())
            .filter(|&j| {
                let told = ring.iter().find_map(|&p| polygon::contains(at, &rings[j], at(p)));
                told.unwrap_or(true)
            })
            .min_by(|&a, &b| area[a].total_cmp(&area[b]));
        match around {
            Some(j) => holes[j].push(ring.clone()),
            // Nothing around it: a part that is inside out, filled by itself.
            None => outer.push(i),
        }
    }
    outer
        .into_iter()
        .map(|i| (rings[i].as_slice(), std::mem::take(&mut holes[i])))
        .collect()
}

/// The loops around an opening with what their new faces hang on.
pub(super) struct Rim {
    /// The primitive of the new faces.
    pub primitive: u32,
    /// The wedge of the new faces at each point of the loops.
    pub wedges: BTreeMap<u32, u32>,
    /// The mean length of the edges that the surface has at each point.
    pub sizes: BTreeMap<u32, f64>,
}

impl Rim {
    /// Loops in the direction that new faces run along them: against the faces that are there.
    pub fn of(draft: &mut Draft<'_>, loops: &[Vec<u32>], hard: &[bool]) -> Self {
        let mut votes: BTreeMap<u32, usize> = BTreeMap::new();
        let sides = |ring: &[u32]| -> Vec<(u32, u32)> {
            ring.iter()
                .copied()
                .zip(ring.iter().copied().cycle().skip(1))
                .take(ring.len())
                .collect()
        };
        for (a, b) in loops.iter().flat_map(|r| sides(r)) {
            if let Some(f) = draft.along(a, b).next() {
                *votes.entry(draft.faces[f as usize].primitive).or_default() += 1;
            }
        }
        let primitive = votes
            .iter()
            .max_by_key(|(p, n)| (**n, std::cmp::Reverse(**p)))
            .map_or(0, |(p, _)| *p);
        let own = hard.get(primitive as usize).copied().unwrap_or(false);
        let mut rim = Self {
            primitive,
            wedges: BTreeMap::new(),
            sizes: BTreeMap::new(),
        };
        let mut spare = None;
        for ring in loops {
            let native: Vec<Option<u32>> = (0..ring.len())
                .map(|i| {
                    let (p, next, prev) = (
                        ring[i],
                        ring[(i + 1) % ring.len()],
                        ring[(i + ring.len() - 1) % ring.len()],
                    );
                    let beside = draft.along(p, next).chain(draft.along(p, prev));
                    let all = beside.chain(draft.around[p as usize].iter().copied());
                    let mut faces = all
                        .map(|f| &draft.faces[f as usize])
                        .filter(|f| f.primitive == primitive);
                    faces.next().and_then(|f| f.wedge_at(p))
                })
                .collect();
            let n = ring.len();
            for i in 0..n {
                let wedge = match native[i] {
                    Some(w) if own => draft.own_wedge(w),
                    Some(w) => w,
                    // The neighbour along the loop that has one lends its blend.
                    None => {
                        let near = (1..=n / 2).flat_map(|d| [native[(i + d) % n], native[(i + n - d) % n]]);
                        match near.flatten().next().or(spare) {
                            Some(w) => draft.own_wedge(w),
                            None => continue,
                        }
                    }
                };
                spare = spare.or(native[i]);
                rim.wedges.insert(ring[i], wedge);
            }
        }
        for &p in loops.iter().flatten() {
            rim.sizes.insert(p, mean_edge(draft, p));
        }
        rim
    }

    /// Adds a face over points of the loops.
    pub fn add(&self, draft: &mut Draft<'_>, corners: [u32; 3]) {
        let wedges = corners.map(|p| self.wedges.get(&p).copied());
        if let [Some(a), Some(b), Some(c)] = wedges {
            draft.add_face(corners, [a, b, c], CAP, self.primitive);
        }
    }

    /// Fills one loop by triangles around a new point in its middle: always possible.
    pub fn fan(&self, draft: &mut Draft<'_>, ring: &[u32]) {
        let n = ring.len();
        let sum: DVec3 = ring.iter().map(|&p| draft.positions[p as usize]).sum();
        let middle = draft.add_point(sum / n as f64);
        let shares: Vec<(u32, f64)> = [0, n / 3, 2 * n / 3]
            .iter()
            .filter_map(|&i| self.wedges.get(&ring[i]))
            .map(|&w| (w, 1.0 / 3.0))
            .collect();
        let wedge = draft.blend(&shares);
        for i in 0..n {
            let (a, b) = (ring[i], ring[(i + 1) % n]);
            if let (Some(&wa), Some(&wb)) = (self.wedges.get(&a), self.wedges.get(&b)) {
                draft.add_face([a, b, middle], [wa, wb, wedge], CAP, self.primitive);
            }
        }
    }
}

/// The mean length of the edges at a point.
pub(super) fn mean_edge(draft: &Draft<'_>, p: u32) -> f64 {
    let here = draft.positions[p as usize];
    let (mut sum, mut count) = (0.0, 0usize);
    for &f in &draft.around[p as usize] {
        for q in draft.faces[f as usize].corners.into_iter().filter(|&q| q != p) {
            sum += here.distance(draft.positions[q as usize]);
            count += 1;
        }
    }
    if count > 0 { sum / count as f64 } else { 0.0 }
}

/// Splits inner edges of the new faces (from `first` on) that join points which the surface joins already: without
/// this, such an edge would have four faces.
pub(super) fn part_double_edges(draft: &mut Draft<'_>, first: usize) {
    let mut f = first;
    while f < draft.faces.len() {
        let face = draft.faces[f];
        let double = (0..3).find_map(|k| {
            let (a, b) = (face.corners[k], face.corners[(k + 1) % 3]);
            let inner = draft.along(a, b).filter(|&g| g as usize >= first).count() == 2;
            (face.alive && inner && draft.along(a, b).any(|g| (g as usize) < first)).then_some((a, b))
        });
        if let Some((a, b)) = double {
            let position = (draft.positions[a as usize] + draft.positions[b as usize]) * 0.5;
            let m = draft.add_point(position);
            let sides: Vec<u32> = draft.along(a, b).filter(|&g| g as usize >= first).collect();
            let wedge = match (face.wedge_at(a), face.wedge_at(b)) {
                (Some(wa), Some(wb)) => draft.blend(&[(wa, 0.5), (wb, 0.5)]),
                _ => face.wedges[0],
            };
            for g in sides {
                let old = draft.faces[g as usize];
                draft.kill(g);
                for end in [a, b] {
                    let (mut corners, mut wedges) = (old.corners, old.wedges);
                    if let Some(k) = old.corner_of(end) {
                        corners[k] = m;
                        wedges[k] = wedge;
                        draft.add_face(corners, wedges, CAP, old.primitive);
                    }
                }
            }
        }
        f += 1;
    }
}
