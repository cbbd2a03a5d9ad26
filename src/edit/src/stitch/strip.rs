//! The shortest strip of triangles between two loops.
//!
//! Closed boundary loops that can be stitched.

use crate::region_mesh::RegionMesh;
use pliant_exec::progress::{Cancelled, Progress, check};
use pliant_mesh::{Error, NONE, sorted_set};
use std::collections::BTreeMap;

/// Most pairs of points for which all strips are compared; beyond, the shorter of the next two edges is taken each time.
const MOST_PAIRS: usize = 16 << 20;

/// A triangle of a strip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct StripTriangle {
    pub points: [u32; 3],
    /// The face that it shares the loop's edge with.
    pub beside: u32,
}

/// Triangles and the length of their edges from loop to loop.
#[derive(Debug, Clone)]
pub(super) struct StitchStrip {
    pub triangles: Vec<StripTriangle>,
    pub cost: f64,
}

/// The strip of least length that begins at the closest pair of points and has no edge that is there already; `None` when
/// there is none. Seen along the first loop the second runs backwards, so that the strip's faces turn as both parts' do.
pub(super) fn find_shortest_strip(
    mesh: &RegionMesh,
    a: &StitchLoop,
    b: &StitchLoop,
    progress: &dyn Progress,
) -> Result<Option<StitchStrip>, Cancelled> {
    let (n, m) = (a.points.len(), b.points.len());
    let mut start = (f64::INFINITY, 0, 0);
    // Long loops begin at a point that is close enough.
    let (skip_a, skip_b) = (n.div_ceil(4096), m.div_ceil(4096));
    for i in (0..n).step_by(skip_a) {
        check(progress)?;
        for j in (0..m).step_by(skip_b) {
            let length = mesh.edge_length(a.points[i], b.points[j]);
            if length < start.0 {
                start = (length, i, j);
            }
        }
    }
    let at_a = |i: usize| a.points[(start.1 + i) % n];
    let at_b = |j: usize| b.points[(start.2 + m * 2 - j) % m];
    let mut others = b.points.clone();
    others.sort_unstable();
    let mut joined: Vec<(u32, u32)> = Vec::new();
    for &p in &a.points {
        let beside = mesh.neighbours(p).into_iter();
        joined.extend(beside.filter(|q| others.binary_search(q).is_ok()).map(|q| (p, q)));
    }
    joined.sort_unstable();
    // No triangle may go all the way around one loop, or its sides would be one edge. Beginning along one loop and ending
    // along the other makes sure of that: both ways are tried.
    let try_from = |first_a: bool| {
        let forbidden = if first_a {
            [(n, 0), (0, m), (0, 1), (n - 1, m)]
        } else {
            [(n, 0), (0, m), (1, 0), (n, m - 1)]
        };
        let cost = |i: usize, j: usize| {
            let (p, q) = (at_a(i), at_b(j));
            if forbidden.contains(&(i, j)) || joined.binary_search(&(p, q)).is_ok() {
                f64::INFINITY
            } else {
                mesh.edge_length(p, q)
            }
        };
        if n.saturating_mul(m) <= MOST_PAIRS {
            shortest_steps(n, m, cost, progress)
        } else {
            Ok(greedy_steps(n, m, cost))
        }
    };
    let ways = [try_from(true)?, try_from(false)?].into_iter().flatten();
    let Some((steps, total)) = ways.min_by(|x, y| x.1.total_cmp(&y.1)) else {
        return Ok(None);
    };
    let (mut i, mut j) = (0, 0);
    let mut triangles = Vec::with_capacity(n + m);
    for along_a in steps {
        if along_a {
            let (p, q) = (at_a(i), at_a(i + 1));
            triangles.push(StripTriangle {
                points: [q, p, at_b(j)],
                beside: face_beside(mesh, p, q),
            });
            i += 1;
        } else {
            let (p, q) = (at_b(j), at_b(j + 1));
            triangles.push(StripTriangle {
                points: [p, q, at_a(i)],
                beside: face_beside(mesh, q, p),
            });
            j += 1;
        }
    }
    Ok(Some(StitchStrip { triangles, cost: total }))
}

/// The face at an edge of a loop.
fn face_beside(mesh: &RegionMesh, p: u32, q: u32) -> u32 {
    mesh.edge_faces(p, q).faces().next().unwrap_or(NONE)
}

/// Steps, true along the first loop, and their length in all.
type StepsAndCost = (Vec<bool>, f64);

/// All ways from (0, 0) to (n, m) by single steps, compared; true is a step along the first loop.
fn shortest_steps(
    n: usize,
    m: usize,
    cost: impl Fn(usize, usize) -> f64,
    progress: &dyn Progress,
) -> Result<Option<StepsAndCost>, Cancelled> {
    let width = m + 1;
    let mut from_a = vec![false; (n + 1) * width];
    let mut row = vec![f64::INFINITY; width];
    for i in 0..=n {
        check(progress)?;
        for j in 0..=m {
            let here = if (i, j) == (n, m) { cost(0, 0) } else { cost(i, j) };
            let (up, left) = (
                if i > 0 { row[j] } else { f64::INFINITY },
                if j > 0 { row[j - 1] } else { f64::INFINITY },
            );
            from_a[i * width + j] = up <= left;
            row[j] = if (i, j) == (0, 0) { here } else { here + up.min(left) };
        }
    }
    let total = row[m];
    if !total.is_finite() {
        return Ok(None);
    }
    let mut steps = Vec::with_capacity(n + m);
    let (mut i, mut j) = (n, m);
    while (i, j) != (0, 0) {
        let along_a = from_a[i * width + j];
        steps.push(along_a);
        if along_a {
            i -= 1;
        } else {
            j -= 1;
        }
    }
    steps.reverse();
    Ok(Some((steps, total)))
}

/// The shorter of the two next edges each time.
fn greedy_steps(n: usize, m: usize, cost: impl Fn(usize, usize) -> f64) -> Option<StepsAndCost> {
    let mut steps = Vec::with_capacity(n + m);
    let (mut i, mut j, mut total) = (0, 0, cost(0, 0));
    while (i, j) != (n, m) {
        let next_a = if i < n { cost(i + 1, j) } else { f64::INFINITY };
        let next_b = if j < m { cost(i, j + 1) } else { f64::INFINITY };
        let along_a = i < n && (j == m || next_a <= next_b);
        steps.push(along_a);
        total += if along_a { next_a } else { next_b };
        if along_a {
            i += 1;
        } else {
            j += 1;
        }
    }
    total.is_finite().then_some((steps, total))
}

/// Points compared on each loop when the nearest are looked for.
const SAMPLE: usize = 48;
/// Pairs of loops that are compared at most; a few seconds.
const MOST_LOOP_PAIRS: usize = 100_000_000;

/// A closed boundary loop, each point once, in the order in which the faces beside it pass its edges.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct StitchLoop {
    pub points: Vec<u32>,
    pub length: f64,
}

impl StitchLoop {
    /// The primitive that most faces beside it belong to, the smallest of equals.
    pub fn main_primitive(&self, mesh: &RegionMesh) -> u32 {
        let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
        for (i, &p) in self.points.iter().enumerate() {
            let q = self.points[(i + 1) % self.points.len()];
            let face = mesh.edge_faces(p, q).left;
            if face != NONE {
                *counts.entry(mesh.faces[face as usize].primitive).or_default() += 1;
            }
        }
        let most = counts.iter().max_by(|a, b| a.1.cmp(b.1).then(b.0.cmp(a.0)));
        most.map_or(0, |(&primitive, _)| primitive)
    }

    fn sample_points(&self) -> impl Iterator<Item = u32> {
        self.points.iter().copied().step_by(self.points.len().div_ceil(SAMPLE))
    }
}

/// The closed boundary loops among the faces of `mesh` that are not frozen, in the order of their smallest points. Where
/// loops touch at a point each keeps to its own fan of faces; a rim that ends at an edge with more than two faces is none.
pub(super) fn find_loops(mesh: &RegionMesh) -> Vec<StitchLoop> {
    // A frozen face cannot have a boundary edge: all faces at boundary points were gathered.
    let mut next: BTreeMap<(u32, u32), (u32, u32)> = BTreeMap::new();
    for f in mesh.living_faces() {
        let p = mesh.points_of(f);
        for i in 0..3 {
            let (a, b) = (p[i], p[(i + 1) % 3]);
            let edge = mesh.edge_faces(a, b);
            if edge.right == NONE
                && !edge.tangled
                && let Some(on) = next_boundary_edge(mesh, f, b)
            {
                next.insert((a, b), on);
            }
        }
    }
    let mut loops = Vec::new();
    while let Some((&start, _)) = next.first_key_value() {
        let mut points = Vec::new();
        let mut here = start;
        while let Some(on) = next.remove(&here) {
            points.push(here.0);
            here = on;
        }
        let once = sorted_set(points.iter());
        if here == start && points.len() >= 3 && once.len() == points.len() {
            let ends = points.iter().zip(points.iter().cycle().skip(1));
            let length = ends.map(|(&p, &q)| mesh.edge_length(p, q)).sum();
            loops.push(StitchLoop { points, length });
        }
    }
    loops
}

/// From face `f`, which a boundary edge leads into `p` along, around `p` to the boundary edge that leads away.
fn next_boundary_edge(mesh: &RegionMesh, mut f: u32, p: u32) -> Option<(u32, u32)> {
    for _ in 0..mesh.faces_around(p).len() {
        let q = mesh.points_of(f);
        let i = q.iter().position(|&x| x == p)?;
        let to = q[(i + 1) % 3];
        let edge = mesh.edge_faces(p, to);
        if edge.tangled {
            return None;
        }
        if edge.right == NONE {
            return Some((p, to));
        }
        f = edge.right;
    }
    None
}

/// The least distance between points of two loops, of a sample when they are long.
pub(super) fn loop_distance(mesh: &RegionMesh, a: &StitchLoop, b: &StitchLoop) -> f64 {
    let mut least = f64::INFINITY;
    for p in a.sample_points() {
        for q in b.sample_points() {
            least = least.min(mesh.edge_length(p, q));
        }
    }
    least
}

/// The pair, one of each list, whose points are nearest to each other on average, among those whose places in the lists `allowed`
/// accepts.
///
/// # Errors
/// [`Error::Impossible`] where there are too many pairs to compare; [`Error::Cancelled`].
pub(super) fn nearest_pair<'a>(
    mesh: &RegionMesh,
    from: &[&'a StitchLoop],
    to: &[&'a StitchLoop],
    allowed: impl Fn(usize, usize) -> bool,
    progress: &dyn Progress,
) -> Result<Option<(&'a StitchLoop, &'a StitchLoop)>, Error> {
    // With many loops a few points of each must do.
    let pairs = from.len().saturating_mul(to.len());
    if pairs > MOST_LOOP_PAIRS {
        let problem = format!(
            "{} and {} boundary loops are more than {MOST_LOOP_PAIRS} pairs to compare; name a point on each of two loops",
            from.len(),
            to.len()
        );
        return Err(Error::impossible(problem, "the whole surface"));
    }
    let few = if pairs > 10_000 { 1 } else { SAMPLE };
    let mut best: Option<(f64, &StitchLoop, &StitchLoop)> = None;
    for (i, &a) in from.iter().enumerate() {
        check(progress)?;
        for (j, &b) in to.iter().enumerate() {
            if !allowed(i, j) {
                continue;
            }
            let gap = mean_gap(mesh, a, b, few).max(mean_gap(mesh, b, a, few));
            if best.is_none_or(|(least, ..)| gap < least) {
                best = Some((gap, a, b));
            }
        }
    }
    Ok(best.map(|(_, a, b)| (a, b)))
}

fn mean_gap(mesh: &RegionMesh, a: &StitchLoop, b: &StitchLoop, few: usize) -> f64 {
    let mut sum = 0.0;
    let mut count = 0u32;
    for p in a.sample_points().take(few) {
        let gaps = b.sample_points().take(few).map(|q| mesh.edge_length(p, q));
        sum += gaps.fold(f64::INFINITY, f64::min);
        count += 1;
    }
    sum / f64::from(count.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_exec::progress::Silent;

    fn shortest(n: usize, m: usize, cost: impl Fn(usize, usize) -> f64) -> Option<StepsAndCost> {
        shortest_steps(n, m, cost, &Silent).expect("not cancelled")
    }

    #[test]
    fn both_ways_of_choosing_reach_the_end_and_the_full_one_is_no_longer() {
        let a = [0.0, 0.3, 0.5, 0.9, 1.0f64];
        let b = [0.0, 0.5, 0.6, 0.7, 0.75, 0.9, 1.0f64];
        let cost = |i: usize, j: usize| (a[i] - b[j]).abs() + 0.1;
        let (full, least) = shortest(4, 6, cost).expect("a way");
        let (greedy, more) = greedy_steps(4, 6, cost).expect("a way");
        for steps in [&full, &greedy] {
            assert_eq!((steps.len(), steps.iter().filter(|s| **s).count()), (10, 4));
        }
        assert!(least <= more + 1e-12);
    }

    #[test]
    fn forbidden_edges_are_gone_around_or_refused() {
        let blocked = |i: usize, j: usize| if (i, j) == (1, 1) { f64::INFINITY } else { 1.0 };
        assert!(shortest(3, 3, blocked).is_some_and(|(_, total)| total == 7.0));
        assert!(shortest(2, 2, |i, j| if i == 1 || j == 1 { f64::INFINITY } else { 1.0 }).is_none());
    }
}
