//! Triangulation of flat polygons with holes: ears are clipped, then edges exchanged until all are Delaunay.
//!
//! Whatever the coordinates, touching or crossing loops included, the triangles use each edge of each loop once and
//! meet each other in pairs everywhere else: what is closed with them is closed. Only how they lie suffers.
//!
//! Method: holes are joined to the outer loop by bridges (Eberly, "Triangulation by Ear Clipping"), ears tested with
//! exact signs (Shewchuk's adaptive predicates); Lawson's flips.
//!
//! Making a flat triangulation Delaunay by exchanging edges (Lawson).
//!
//! Exact predicates in the plane (Shewchuk's adaptive ones) and measures of loops in it.

use glam::DVec2;
use pliant_exec::progress::{Cancelled, Progress, check};
use robust::Coord;
use std::collections::BTreeMap;

/// Places compared with ears between two looks at the progress: a few milliseconds.
const COMPARED: usize = 1 << 18;

/// Triangles, counter-clockwise, of the polygon inside `outer` (counter-clockwise) and outside `holes` (clockwise, none
/// inside another). Loops name places by number in `at`; a number stands in one loop once. `None` when the loops are so
/// entangled that a triangle would need one point twice.
pub(crate) fn triangulate_polygon(
    at: &[DVec2],
    outer: &[u32],
    holes: &[Vec<u32>],
    progress: &dyn Progress,
) -> Result<Option<Vec<[u32; 3]>>, Cancelled> {
    if outer.len() < 3 || holes.iter().any(|h| h.len() < 3) {
        return Ok(None);
    }
    let mut ring = PolygonRing::new(at, outer);
    let mut order: Vec<(usize, usize)> = (holes.iter().enumerate())
        .map(|(h, hole)| {
            let right = (0..hole.len()).max_by(|&a, &b| {
                let (p, q) = (at[hole[a] as usize], at[hole[b] as usize]);
                p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(b.cmp(&a))
            });
            (h, right.unwrap_or(0))
        })
        .collect();
    let rightmost = |&(h, k): &(usize, usize)| at[holes[h][k] as usize];
    order.sort_by(|a, b| rightmost(b).x.total_cmp(&rightmost(a).x).then(a.cmp(b)));
    for (h, k) in order {
        check(progress)?;
        ring.bridge(&holes[h], k);
    }
    match ring.clip(progress)? {
        Some(mut triangles) => {
            make_delaunay(at, &mut triangles, progress)?;
            Ok(Some(triangles))
        }
        None => Ok(None),
    }
}

/// A polygon as a ring of nodes; a bridge makes two nodes of one place.
struct PolygonRing<'a> {
    at: &'a [DVec2],
    id: Vec<u32>,
    prev: Vec<usize>,
    next: Vec<usize>,
}

impl<'a> PolygonRing<'a> {
    fn new(at: &'a [DVec2], outer: &[u32]) -> Self {
        let n = outer.len();
        Self {
            at,
            id: outer.to_vec(),
            prev: (0..n).map(|i| (i + n - 1) % n).collect(),
            next: (0..n).map(|i| (i + 1) % n).collect(),
        }
    }

    fn place(&self, node: usize) -> DVec2 {
        self.at[self.id[node] as usize]
    }

    fn link(&mut self, a: usize, b: usize) {
        self.next[a] = b;
        self.prev[b] = a;
    }

    fn push(&mut self, id: u32) -> usize {
        self.id.push(id);
        self.prev.push(0);
        self.next.push(0);
        self.id.len() - 1
    }

    /// Joins a hole by the edge between its rightmost corner `hole[k]` and a corner of the ring that can see it.
    fn bridge(&mut self, hole: &[u32], k: usize) {
        let m = self.at[hole[k] as usize];
        let to = self.seen_from(m);
        let mut last = to;
        for i in 0..=hole.len() {
            let node = self.push(hole[(k + i) % hole.len()]);
            if i == 0 {
                let after = self.next[to];
                self.link(to, node);
                self.link(node, after);
            } else {
                let after = self.next[last];
                self.link(last, node);
                self.link(node, after);
            }
            last = node;
        }
        let back = self.push(self.id[to]);
        let after = self.next[last];
        self.link(last, back);
        self.link(back, after);
    }

    /// A node that the straight line from `m`, which lies inside the ring, reaches: the ray to the right finds an edge,
    /// and the corner beside it or a corner in between is free.
    fn seen_from(&self, m: DVec2) -> usize {
        let mut hit: Option<(f64, usize)> = None;
        for a in 0..self.id.len() {
            let (p, q) = (self.place(a), self.place(self.next[a]));
            if p.y <= m.y && m.y <= q.y && p.y < q.y && turn(p, q, m) >= 0.0 {
                let x = p.x + (q.x - p.x) * ((m.y - p.y) / (q.y - p.y));
                if hit.is_none_or(|h| x < h.0) {
                    hit = Some((x, a));
                }
            }
        }
        let nearest = || {
            let distance = |&a: &usize, &b: &usize| {
                let (a, b) = (self.place(a).distance_squared(m), self.place(b).distance_squared(m));
                a.total_cmp(&b)
            };
            (0..self.id.len()).min_by(distance).unwrap_or(0)
        };
        let Some((x, a)) = hit else {
            return nearest();
        };
        let b = self.next[a];
        let corner = if self.place(a).x > self.place(b).x { a } else { b };
        let (i, p) = (DVec2::new(x, m.y), self.place(corner));
        // Corners inside the triangle between ray and corner stand in the way; the one closest to the ray is free.
        let (s, t) = if p.y < m.y { (p, i) } else { (i, p) };
        let mut best = (f64::INFINITY, f64::INFINITY, corner);
        for n in 0..self.id.len() {
            let c = self.place(n);
            let reflex = turn(self.place(self.prev[n]), c, self.place(self.next[n])) <= 0.0;
            let inside = turn(m, s, c) >= 0.0 && turn(s, t, c) >= 0.0 && turn(t, m, c) >= 0.0;
            if !(inside && reflex && c.x >= m.x && c != p) {
                continue;
            }
            let slope = (c.y - m.y).abs() / (c.x - m.x);
            let far = c.distance_squared(m);
            if (slope, far) < (best.0, best.1) {
                best = (slope, far, n);
            }
        }
        self.sector(best.2, m)
    }

    /// Of the nodes at one place (earlier bridges made several), the one whose inside `m` lies in.
    fn sector(&self, node: usize, m: DVec2) -> usize {
        let twins = (0..self.id.len()).filter(|&n| self.id[n] == self.id[node]);
        let sees = |&n: &usize| {
            let (p, c, q) = (self.place(self.prev[n]), self.place(n), self.place(self.next[n]));
            let (left, right) = (turn(c, q, m) > 0.0, turn(p, c, m) > 0.0);
            if turn(p, c, q) > 0.0 {
                left && right
            } else {
                left || right
            }
        };
        twins.into_iter().find(sees).unwrap_or(node)
    }

    /// Cuts off ears until a triangle is left. When no clean ear is left, the demands on an ear fall, one by one.
    fn clip(mut self, progress: &dyn Progress) -> Result<Option<Vec<[u32; 3]>>, Cancelled> {
        let mut triangles = Vec::with_capacity(self.id.len());
        let mut left = self.id.len();
        let reflex_at =
            |ring: &Self, n: usize| turn(ring.place(ring.prev[n]), ring.place(n), ring.place(ring.next[n])) <= 0.0;
        let mut reflex: Vec<bool> = (0..left).map(|n| reflex_at(&self, n)).collect();
        let mut bad: Vec<usize> = (0..left).filter(|&n| reflex[n]).collect();
        let (mut node, mut misses, mut leniency) = (0, 0, 0);
        let mut compared = 0;
        while left > 3 {
            compared += bad.len() + 1;
            if compared > COMPARED {
                compared = 0;
                check(progress)?;
            }
            let (a, c) = (self.prev[node], self.next[node]);
            let mut obstacles = bad.iter().copied().filter(|&n| reflex[n]);
            if self.is_ear([a, node, c], &mut obstacles, leniency) {
                triangles.push([self.id[a], self.id[node], self.id[c]]);
                if triangles.len() % 64 == 0 {
                    bad.retain(|&n| reflex[n]);
                }
                self.link(a, c);
                // A clipped node blocks nothing any more; its neighbours only ever open up.
                reflex[node] = false;
                for n in [a, c] {
                    let was = std::mem::replace(&mut reflex[n], reflex_at(&self, n));
                    if reflex[n] && !was {
                        bad.push(n);
                    }
                }
                left -= 1;
                (misses, leniency) = (0, 0);
                // Skipping a node keeps ears from fanning out around one corner.
                node = self.next[c];
                continue;
            }
            node = c;
            misses += 1;
            if misses > left {
                (misses, leniency) = (0, leniency + 1);
                if leniency > 3 {
                    return Ok(None);
                }
            }
        }
        let (a, c) = (self.prev[node], self.next[node]);
        let last = [self.id[a], self.id[node], self.id[c]];
        if last[0] == last[1] || last[1] == last[2] || last[2] == last[0] {
            return Ok(None);
        }
        triangles.push(last);
        Ok(Some(triangles))
    }

    /// True if the triangle of three nodes in a row can be cut off. `obstacles` are the nodes that may lie in it.
    fn is_ear(&self, nodes: [usize; 3], obstacles: &mut impl Iterator<Item = usize>, leniency: u32) -> bool {
        let ids = nodes.map(|n| self.id[n]);
        if ids[0] == ids[2] || ids[0] == ids[1] || ids[1] == ids[2] {
            return false;
        }
        let [p, q, r] = nodes.map(|n| self.place(n));
        let convex = turn(p, q, r);
        match leniency {
            0 | 1 if convex <= 0.0 => return false,
            2 if convex < 0.0 => return false,
            2 | 3 => return true,
            _ => {}
        }
        let (low, high) = (p.min(q).min(r), p.max(q).max(r));
        !obstacles.filter(|&n| !ids.contains(&self.id[n])).any(|n| {
            let x = self.place(n);
            if x.cmplt(low).any() || x.cmpgt(high).any() {
                return false;
            }
            let sides = [turn(p, q, x), turn(q, r, x), turn(r, p, x)];
            if leniency == 0 {
                sides.iter().all(|&s| s >= 0.0)
            } else {
                sides.iter().all(|&s| s > 0.0)
            }
        })
    }
}

/// Exchanges inner edges until each triangle's circle is empty of its neighbours' corners. Triangles without area go
/// first. Edges that already exist are never made twice.
fn make_delaunay(at: &[DVec2], triangles: &mut [[u32; 3]], progress: &dyn Progress) -> Result<(), Cancelled> {
    let mut owner: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    let mut queue: Vec<(u32, u32)> = Vec::new();
    for (t, i) in triangles.iter().zip(0u32..) {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            if owner.insert((a, b), i).is_some() {
                // Entangled loops: leave them as they are.
                return Ok(());
            }
            queue.push((a.min(b), a.max(b)));
        }
    }
    let place = |p: u32| at[p as usize];
    let far = |t: [u32; 3], a: u32, b: u32| t.into_iter().find(|&p| p != a && p != b);
    // Lawson's flips end by themselves; the count guards against rounding in places that are not numbers.
    let mut budget = 64 * triangles.len() + 4096;
    while let Some((a, b)) = queue.pop() {
        let (Some(&f), Some(&g)) = (owner.get(&(a, b)), owner.get(&(b, a))) else {
            continue;
        };
        let (Some(p), Some(q)) = (far(triangles[f as usize], a, b), far(triangles[g as usize], a, b)) else {
            continue;
        };
        if p == q || owner.contains_key(&(p, q)) || owner.contains_key(&(q, p)) {
            continue;
        }
        // f is (a, b, p), g is (b, a, q).
        let [point_a, point_b, pp, pq] = [a, b, p, q].map(place);
        if turn(point_a, pq, pp) <= 0.0 || turn(pq, point_b, pp) <= 0.0 {
            continue;
        }
        let flat = turn(point_a, point_b, pp) <= 0.0 || turn(point_b, point_a, pq) <= 0.0;
        if !flat && robust::incircle(coord(point_a), coord(point_b), coord(pp), coord(pq)) <= 0.0 {
            continue;
        }
        budget -= 1;
        if budget == 0 {
            return Ok(());
        }
        if budget.is_multiple_of(256) {
            check(progress)?;
        }
        triangles[f as usize] = [a, q, p];
        triangles[g as usize] = [q, b, p];
        owner.remove(&(a, b));
        owner.remove(&(b, a));
        for (edge, face) in [
            ((a, q), f),
            ((q, p), f),
            ((p, a), f),
            ((q, b), g),
            ((b, p), g),
            ((p, q), g),
        ] {
            owner.insert(edge, face);
        }
        queue.extend([(a, q), (q, b), (b, p), (p, a)].map(|(x, y): (u32, u32)| (x.min(y), x.max(y))));
    }
    Ok(())
}

fn coord(p: DVec2) -> Coord<f64> {
    Coord { x: p.x, y: p.y }
}

/// Positive when `a`, `b`, `c` turn left; the sign is exact.
pub(super) fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    robust::orient2d(coord(a), coord(b), coord(c))
}

/// Twice the signed area of a loop.
pub(crate) fn double_area(at: impl Fn(u32) -> DVec2, ring: &[u32]) -> f64 {
    let Some(&first) = ring.first() else {
        return 0.0;
    };
    let base = at(first);
    let ends = ring.iter().zip(ring.iter().cycle().skip(1));
    ends.map(|(&a, &b)| (at(a) - base).perp_dot(at(b) - base)).sum()
}

/// Whether `p` lies inside a loop (by crossings), or `None` when it lies on it.
pub(crate) fn loop_contains(at: impl Fn(u32) -> DVec2, ring: &[u32], p: DVec2) -> Option<bool> {
    let mut inside = false;
    for (&a, &b) in ring.iter().zip(ring.iter().cycle().skip(1)) {
        let (a, b) = (at(a), at(b));
        let side = turn(a, b, p);
        let between = p.cmpge(a.min(b)).all() && p.cmple(a.max(b)).all();
        if side == 0.0 && between {
            return None;
        }
        if (a.y <= p.y) != (b.y <= p.y) && (side > 0.0) == (b.y > a.y) {
            inside = !inside;
        }
    }
    Some(inside)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_exec::progress::Silent;
    use std::collections::BTreeMap;

    fn ring(n: u32, radius: f64, center: DVec2) -> Vec<DVec2> {
        let angle = |k: u32| f64::from(k) / f64::from(n) * std::f64::consts::TAU;
        (0..n)
            .map(|k| center + radius * DVec2::new(libm::cos(angle(k)), libm::sin(angle(k))))
            .collect()
    }

    /// Checks orientation, areas and that each loop edge is used once and all others pairwise.
    fn verify(at: &[DVec2], outer: &[u32], holes: &[Vec<u32>]) -> Vec<[u32; 3]> {
        let found = triangulate_polygon(at, outer, holes, &Silent)
            .expect("not cancelled")
            .expect("a polygon");
        let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
        let mut area = 0.0;
        for t in &found {
            let double = turn(at[t[0] as usize], at[t[1] as usize], at[t[2] as usize]);
            assert!(double > 0.0, "{t:?} has area {double}");
            area += double;
            for k in 0..3 {
                *edges.entry((t[k], t[(k + 1) % 3])).or_default() += 1;
            }
        }
        assert!(edges.values().all(|&n| n == 1));
        let rim: Vec<(u32, u32)> = edges
            .keys()
            .copied()
            .filter(|&(a, b)| !edges.contains_key(&(b, a)))
            .collect();
        let loops = || std::iter::once(outer).chain(holes.iter().map(Vec::as_slice));
        assert_eq!(rim.len(), loops().map(<[u32]>::len).sum::<usize>());
        let expected: f64 = loops()
            .map(|l| super::super::polygon::double_area(|p| at[p as usize], l))
            .sum();
        assert!((area - expected).abs() <= 1e-12 * expected, "{area} of {expected}");
        found
    }

    #[test]
    fn a_comb_with_collinear_points_is_filled_exactly() {
        let mut at = vec![DVec2::new(0.0, 0.0), DVec2::new(5.0, 0.0), DVec2::new(10.0, 0.0)];
        for k in (0..10).rev() {
            let x = f64::from(k);
            at.extend([
                DVec2::new(x + 1.0, 5.0),
                DVec2::new(x + 0.5, 5.0),
                DVec2::new(x + 0.5, 1.0),
                DVec2::new(x, 1.0),
            ]);
        }
        at.pop();
        at.push(DVec2::new(0.0, 1.0));
        let outer: Vec<u32> = (0..at.len() as u32).collect();
        assert_eq!(verify(&at, &outer, &[]).len(), at.len() - 2);
    }

    #[test]
    fn many_holes_are_left_out() {
        let mut at = ring(40, 10.0, DVec2::ZERO);
        let outer: Vec<u32> = (0..40).collect();
        let mut holes = Vec::new();
        for (x, y) in [(-5.0, 0.0), (5.0, 0.0), (0.0, 5.0), (0.0, -5.0), (0.0, 0.0)] {
            let first = at.len() as u32;
            at.extend(ring(12, 1.5, DVec2::new(x, y)));
            holes.push((first..first + 12).rev().collect::<Vec<u32>>());
        }
        let found = verify(&at, &outer, &holes);
        assert_eq!(found.len(), 40 + 60 + 2 * 5 - 2);
    }

    #[test]
    fn entangled_loops_are_closed_all_the_same() {
        // A star that crosses itself.
        let mut at = ring(7, 1.0, DVec2::ZERO);
        at = (0..7).map(|k| at[(k * 3) % 7]).collect();
        let outer: Vec<u32> = (0..7).collect();
        if let Some(found) = triangulate_polygon(&at, &outer, &[], &Silent).expect("not cancelled") {
            assert_eq!(found.len(), 5);
        }
        let nowhere = vec![DVec2::ZERO; 5];
        let found = triangulate_polygon(&nowhere, &[0, 1, 2, 3, 4], &[], &Silent).expect("not cancelled");
        assert_eq!(found.map(|f| f.len()), Some(3));
    }

    #[test]
    fn inside_is_distinguished_from_outside_and_on() {
        let at = ring(8, 1.0, DVec2::ZERO);
        let all: Vec<u32> = (0..8).collect();
        let inside = |p| super::super::polygon::loop_contains(|i| at[i as usize], &all, p);
        assert_eq!(inside(DVec2::ZERO), Some(true));
        assert_eq!(inside(DVec2::new(2.0, 0.0)), Some(false));
        assert_eq!(inside(at[3]), None);
    }
}

#[cfg(test)]
mod delaunay_tests {
    use super::*;
    use pliant_exec::progress::Silent;

    #[test]
    fn a_fan_over_a_strip_becomes_its_ladder() {
        // Two rows of six places; the fan from the first has slivers, one triangle in it has no area.
        let at: Vec<DVec2> = (0..6)
            .map(|k| DVec2::new(f64::from(k), 0.0))
            .chain((0..6).rev().map(|k| DVec2::new(f64::from(k), 1.0)))
            .collect();
        let mut triangles: Vec<[u32; 3]> = (1..11).map(|k| [0, k, k + 1]).collect();
        make_delaunay(&at, &mut triangles, &Silent).expect("not cancelled");
        for t in &triangles {
            let [a, b, c] = t.map(|p| at[p as usize]);
            assert_eq!(turn(a, b, c), 1.0, "{t:?}");
            assert!(
                (a.x - b.x).abs().max((b.x - c.x).abs()).max((c.x - a.x).abs()) == 1.0,
                "{t:?}"
            );
        }
    }
}
