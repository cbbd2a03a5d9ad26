//! Opening a draft: points whose faces no longer hang together become several.
//!
//! The faces around a point fall into *fans* that hang together by edges. Cutting an edge or removing faces can part a
//! fan; then each part gets a point of its own at the same place, so that a manifold surface stays one. Fans that were
//! apart before (the model's own pinched points) stay joined at their point.

use super::draft::{CAP, Draft, key};
use crate::mesh::query::fan::group_fans;
use std::collections::BTreeSet;

impl Draft<'_> {
    /// Gives each parted fan its own point; edges in `cuts` (smaller point first) join nothing.
    pub fn open(&mut self, cuts: &BTreeSet<(u32, u32)>) {
        for p in 0..self.positions.len() as u32 {
            if !self.whole[p as usize] || self.around[p as usize].len() < 2 {
                continue;
            }
            let around = self.around[p as usize].clone();
            let fan = fans(
                p,
                &around,
                |f| self.faces[f as usize].corners,
                |q| !cuts.contains(&key(p, q)),
            );
            let count = fan.iter().map(|f| f + 1).max().unwrap_or(0);
            if count < 2 {
                continue;
            }
            let before = self.fans_before(p);
            let mut seen: BTreeSet<u32> = BTreeSet::new();
            for part in 0..count {
                let members = || {
                    around
                        .iter()
                        .zip(&fan)
                        .filter(move |(_, f)| **f == part)
                        .map(|(&f, _)| f)
                };
                let mut first = false;
                for f in members() {
                    match self.fan_before(&before, f) {
                        Some(was) => first |= seen.insert(was),
                        None => first |= part == 0,
                    }
                }
                if !first {
                    let members: Vec<u32> = members().collect();
                    self.split_off(p, &members);
                }
            }
        }
    }

    /// The fan of each local face around a local point, before anything was done.
    fn fans_before(&self, p: u32) -> Vec<(u32, u32)> {
        if p as usize >= self.local.points.len() {
            return Vec::new();
        }
        let around = self.local.around.of(p);
        let fan = fans(p, around, |f| self.local.corners[f as usize], |_| true);
        around.iter().copied().zip(fan).collect()
    }

    /// The fan that a face comes from; none at new points, and for caps, which hang on their neighbours.
    fn fan_before(&self, before: &[(u32, u32)], face: u32) -> Option<u32> {
        let source = self.faces[face as usize].source;
        before.binary_search_by_key(&source, |b| b.0).ok().map(|k| before[k].1)
    }

    /// Moves `faces` from `p` to a new point at the same place.
    fn split_off(&mut self, p: u32, faces: &[u32]) {
        let twin = self.add_point(self.positions[p as usize]);
        self.root[twin as usize] = self.root[p as usize];
        let mut moving = faces.to_vec();
        moving.sort_unstable();
        self.around[p as usize].retain(|f| moving.binary_search(f).is_err());
        for &f in faces {
            for c in &mut self.faces[f as usize].corners {
                if *c == p {
                    *c = twin;
                }
            }
        }
        self.around[twin as usize] = faces.to_vec();
    }

    /// The sides of live faces that no other face lies along, for which `wanted` (asked with both ends in the face's
    /// order) says yes; as from, to, face.
    pub fn rim(&self, wanted: impl Fn(u32, u32) -> bool) -> Vec<(u32, u32, u32)> {
        let mut rim = Vec::new();
        for (face, f) in self.faces.iter().zip(0u32..).filter(|(face, _)| face.alive) {
            for k in 0..3 {
                let (a, b) = (face.corners[k], face.corners[(k + 1) % 3]);
                if wanted(a, b) && self.along(a, b).nth(1).is_none() {
                    rim.push((a, b, f));
                }
            }
        }
        rim
    }

    /// Exchanges edges inside old faces where that makes the smallest angle larger: splitting an edge joins the new
    /// point to whatever corner is opposite.
    pub fn improve(&mut self, kept: impl Fn(u32, u32) -> bool) {
        let mut queue: Vec<(u32, u32)> = Vec::new();
        for face in self.faces[self.local.faces.len()..]
            .iter()
            .filter(|f| f.alive && f.source != CAP)
        {
            let [a, b, c] = face.corners;
            queue.extend([key(a, b), key(b, c), key(c, a)]);
        }
        queue.sort_unstable();
        queue.dedup();
        for (a, b) in queue {
            if kept(a, b) {
                continue;
            }
            let Some(pair) = self.flippable(a, b) else {
                continue;
            };
            let [p, q] = [pair[0].1, pair[1].1];
            let at = |p: u32| self.positions[p as usize];
            let normal = self.area_normal(pair[0].0) + self.area_normal(pair[1].0);
            let area = |a: u32, b: u32, c: u32| (at(b) - at(a)).cross(at(c) - at(a)).dot(normal);
            let turned = self.faces[pair[0].0 as usize];
            let forward = turned.corner_of(a).is_some_and(|k| turned.corners[(k + 1) % 3] == b);
            let (first, second) = if forward {
                (area(a, q, p), area(b, p, q))
            } else {
                (area(a, p, q), area(b, q, p))
            };
            let before = quality([at(a), at(b), at(p)]).min(quality([at(a), at(b), at(q)]));
            let after = quality([at(a), at(p), at(q)]).min(quality([at(b), at(p), at(q)]));
            if first > 0.0 && second > 0.0 && after > before * (1.0 + 1e-9) {
                self.flip(a, b, pair);
            }
        }
    }
}

/// Area over the sum of squared edges: 0 for a sliver, largest for an equilateral triangle.
pub(super) fn quality([a, b, c]: [glam::DVec3; 3]) -> f64 {
    let squares = (b - a).length_squared() + (c - b).length_squared() + (a - c).length_squared();
    if squares > 0.0 {
        (b - a).cross(c - a).length() / squares
    } else {
        0.0
    }
}

/// Numbers the fans of the faces `around` a point, in the order of the first face of each. `joins` says whether faces
/// hang together along the edge from the point to another.
fn fans(p: u32, around: &[u32], corners: impl Fn(u32) -> [u32; 3], joins: impl Fn(u32) -> bool) -> Vec<u32> {
    let faces = around.iter().zip(0u32..);
    let spokes = faces.flat_map(|(&f, i)| {
        corners(f)
            .into_iter()
            .filter(|&q| q != p && joins(q))
            .map(move |q| (q, i))
    });
    group_fans(around.len(), spokes.collect::<Vec<_>>()).0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::{Local, Surface};
    use glam::DVec3;

    /// A fan of six triangles around point 0.
    fn hexagon() -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let angle = |k: u32| f64::from(k) * std::f64::consts::TAU / 6.0;
        let ring = (0..6).map(|k| DVec3::new(libm::cos(angle(k)), libm::sin(angle(k)), 0.0));
        let faces = (0..6u32).map(|k| [0, 1 + k, 1 + (k + 1) % 6]);
        (std::iter::once(DVec3::ZERO).chain(ring).collect(), faces.collect())
    }

    fn with_draft(act: impl FnOnce(&mut Draft<'_>)) {
        let (positions, triangles) = hexagon();
        let surface = Surface {
            positions: &positions,
            triangles: &triangles,
            primitive_of: &[0; 6],
            point_of: &[0, 1, 2, 3, 4, 5, 6],
            points: 7,
        };
        act(&mut Draft::new(
            &surface,
            Local::around(&surface, &[0, 1, 2, 3, 4, 5], 1),
        ));
    }

    #[test]
    fn a_cut_across_parts_and_a_cut_to_the_middle_does_not_part_the_middle() {
        with_draft(|draft| {
            draft.open(&BTreeSet::from([(0, 1), (0, 4)]));
            // The middle and both ends.
            assert_eq!(draft.positions.len(), 7 + 3);
            assert_eq!(draft.root[7..], [0, 1, 4]);
            assert!(draft.around.iter().all(|a| (1..=3).contains(&a.len())));
        });
        with_draft(|draft| {
            draft.open(&BTreeSet::from([(0, 1)]));
            assert_eq!(draft.root[7..], [1], "the rim opens, the middle holds");
            assert_eq!(draft.around[0].len(), 6);
        });
    }

    #[test]
    fn faces_left_corner_to_corner_get_points_of_their_own() {
        with_draft(|draft| {
            [1, 3, 5].into_iter().for_each(|f| draft.kill(f));
            draft.open(&BTreeSet::new());
            assert_eq!(draft.root[7..], [0, 0]);
            assert!(draft.rim(|_, _| true).len() == 9);
        });
    }
}
