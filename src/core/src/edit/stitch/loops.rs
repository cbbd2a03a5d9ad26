//! Closed boundary loops that can be stitched.

use crate::edit::error::Error;
use crate::edit::region_mesh::RegionMesh;
use crate::mesh::NONE;
use crate::progress::{Progress, check};
use std::collections::BTreeMap;

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
        let mut once = points.clone();
        once.sort_unstable();
        once.dedup();
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
