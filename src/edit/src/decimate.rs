//! Fewer triangles: edges collapse into one of their ends, the cheapest first.
//!
//! The cost is the distance to the planes of the faces that were there (Garland and Heckbert 1997), so flat places thin
//! out first. The vertices that remain are old ones with all their attributes. The rim of the region stays. Boundaries,
//! seams and primitive borders thin out along themselves; planes perpendicular to their faces keep their corners.
//!
//! Every collapse is checked: no edge gets a third face, no face turns over. Simplifiers that work on buffers identify
//! points by position, so they close a cut whose sides lie at one place, and leave edges with three faces behind.

use super::patch::{EditWarning, SurfacePatch};
use super::region_mesh::{EdgeCollapse, RegionMesh};
use super::surface::SurfaceView;
use super::triangle;
use glam::DVec3;
use pliant_exec::progress::{Progress, check};
use pliant_mesh::{Error, NONE};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::ops::AddAssign;

/// No face turns by more than the angle with this cosine (about 75°) in one collapse.
const LEAST_COSINE: f64 = 0.25;

/// Worst aspect that a collapse may make, unless there was a worse one before.
const WORST_ASPECT: f64 = 12.0;

/// Faces looked at between two looks at the progress: a few milliseconds.
const CHECKED: usize = 1 << 14;
/// How much the length of an edge counts beside its distance to the planes, so that flat places thin out evenly.
const EVENNESS: f64 = 1e-5;

/// Thins out `faces`, rising triangle numbers, to `ratio` of their number, as far as shape, rim and topology allow;
/// warns with `decimate-short` when more than a tenth too many are left.
///
/// # Errors
/// [`Error::Invalid`] when `ratio` is not between 0 and 1 or `faces` is not a region; [`Error::Cancelled`].
pub fn decimate_region(
    surface: &SurfaceView,
    faces: &[u32],
    ratio: f64,
    progress: &dyn Progress,
) -> Result<SurfacePatch, Error> {
    if !(ratio > 0.0 && ratio < 1.0) {
        let problem = format!("{ratio} is not between 0 and 1, both excluded");
        return Err(Error::invalid("decimate.ratio", problem));
    }
    let mut mesh = RegionMesh::with_frozen_ring(surface, faces)?;
    let start = mesh.living_faces().count();
    let target = ((start as f64 * ratio).round() as usize).max(1);
    let left = Decimation::gather_quadrics(&mut mesh).collapse_down_to(start, target, progress)?;
    let (mut patch, _) = mesh.into_patch(surface);
    if left as f64 > 1.1 * target as f64 {
        let message =
            format!("{left} of {start} triangles are left, {target} were asked for: rim, seams or shape hold the rest");
        patch
            .warnings
            .push(EditWarning::new("decimate-short", message, "region"));
    }
    Ok(patch)
}

/// What may happen to a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum PointFreedom {
    /// Anything.
    Inside,
    /// It may move to these two neighbours, along a boundary or seam.
    Along([u32; 2]),
    Held,
}

struct Decimation<'a> {
    mesh: &'a mut RegionMesh,
    quadrics: Vec<Quadric>,
    /// How often the surroundings of a point have changed: an entry of the queue with an older count is out of date.
    stamps: Vec<u32>,
    /// Points known to be inside; collapses around them do not change that.
    inside: Vec<bool>,
    origin: DVec3,
}

/// Cost as ordered bits, from, to, and the stamp of the first. Each point has its cheapest collapse in the queue.
type QueuedCollapse = Reverse<(u64, u32, u32, u32)>;

impl<'a> Decimation<'a> {
    fn gather_quadrics(mesh: &'a mut RegionMesh) -> Self {
        let count = mesh.points.len();
        let origin = mesh.points.iter().map(|p| p.position).sum::<DVec3>() / count.max(1) as f64;
        let mut quadrics = vec![Quadric::default(); count];
        for f in 0..mesh.faces.len() as u32 {
            let corners = mesh.corner_positions(f).map(|p| p - origin);
            let normal = triangle::area_normal(corners);
            let Some(unit) = normal.try_normalize() else { continue };
            let points = mesh.points_of(f);
            for p in points {
                quadrics[p as usize] += Quadric::from_plane(unit, corners[0], 0.5 * normal.length());
            }
            // A plane that stands on an edge which is to stay where it is.
            for i in 0..3 {
                let (a, b) = (points[i], points[(i + 1) % 3]);
                if mesh.is_inside(mesh.edge_faces(a, b), a, b) {
                    continue;
                }
                let along = corners[(i + 1) % 3] - corners[i];
                if let Some(across) = along.cross(unit).try_normalize() {
                    for p in [a, b] {
                        quadrics[p as usize] += Quadric::from_plane(across, corners[i], along.length_squared());
                    }
                }
            }
        }
        Self {
            quadrics,
            stamps: vec![0; count],
            inside: vec![false; count],
            mesh,
            origin,
        }
    }

    /// Collapses until `target` faces are left or none can go; says how many are left.
    fn collapse_down_to(mut self, start: usize, target: usize, progress: &dyn Progress) -> Result<usize, Error> {
        let mut left = start;
        // A collapse that topology forbids now may be allowed after others: rounds, while they do something.
        for _ in 0..8 {
            let before = left;
            let mut queue = self.queue_all();
            let mut steps = 0;
            while left > target {
                let Some(Reverse((cost, from, to, stamp))) = queue.pop() else {
                    break;
                };
                // A step looks at all faces around its points, which may be all that there are.
                let around = self.mesh.faces_around(from).len() + self.mesh.faces_around(to).len();
                steps += 1 + around;
                if steps > CHECKED {
                    steps = 0;
                    check(progress)?;
                    progress.report("edit", (start - left) as f32 / (start - target).max(1) as f32);
                }
                if self.stamps[from as usize] == stamp {
                    match self.try_collapse(from, to, &mut queue) {
                        0 => queue.extend(self.find_cheapest(from, cost, to)),
                        gone => left -= gone,
                    }
                }
            }
            check(progress)?;
            if left <= target || left == before {
                break;
            }
        }
        Ok(left)
    }

    fn queue_all(&mut self) -> BinaryHeap<QueuedCollapse> {
        let mut entries = Vec::new();
        for p in 0..self.mesh.points.len() as u32 {
            self.inside[p as usize] = self.point_freedom(p) == PointFreedom::Inside;
            entries.extend(self.find_cheapest(p, 0, 0));
        }
        entries.into()
    }

    /// The cheapest collapse of `p` into a neighbour, of those that come after this cost and neighbour.
    fn find_cheapest(&self, p: u32, after: u64, neighbour: u32) -> Option<QueuedCollapse> {
        let targets = match self.point_freedom(p) {
            PointFreedom::Held => return None,
            PointFreedom::Along(ends) => ends.to_vec(),
            PointFreedom::Inside => self.mesh.neighbours(p),
        };
        let at = |q: u32| self.mesh.position(q) - self.origin;
        let faces = self.mesh.faces_around(p).iter();
        let area: f64 = faces.map(|&f| self.mesh.area_normal(f).length()).sum();
        let cost = |q: u32| {
            let mut sum = self.quadrics[p as usize];
            sum += self.quadrics[q as usize];
            // The bits of numbers that are not negative are ordered as they are.
            (sum.error_at(at(q)) + EVENNESS * area * at(p).distance_squared(at(q))).to_bits()
        };
        let costs = targets.into_iter().map(|q| (cost(q), q));
        let least = costs.filter(|&c| c > (after, neighbour)).min()?;
        Some(Reverse((least.0, p, least.1, self.stamps[p as usize])))
    }

    fn point_freedom(&self, p: u32) -> PointFreedom {
        if self.inside[p as usize] {
            return PointFreedom::Inside;
        }
        if self.mesh.points[p as usize].fixed {
            return PointFreedom::Held;
        }
        let mut ends = [NONE; 2];
        let mut open = [false; 2];
        let mut count = 0;
        for q in self.mesh.neighbours(p) {
            let edge = self.mesh.edge_faces(p, q);
            if self.mesh.is_inside(edge, p, q) {
                continue;
            }
            if count == 2 || self.mesh.is_locked(edge) {
                return PointFreedom::Held;
            }
            ends[count] = q;
            open[count] = edge.faces().count() == 1;
            count += 1;
        }
        match count {
            0 => PointFreedom::Inside,
            2 if open[0] == open[1] => PointFreedom::Along(ends),
            _ => PointFreedom::Held,
        }
    }

    /// Collapses if it may be; says how many faces went.
    fn try_collapse(&mut self, from: u32, to: u32, queue: &mut BinaryHeap<QueuedCollapse>) -> usize {
        let allowed = match self.point_freedom(from) {
            PointFreedom::Inside => true,
            PointFreedom::Along(ends) => ends.contains(&to),
            PointFreedom::Held => false,
        };
        if !allowed {
            return 0;
        }
        let Some(collapse) = self.mesh.plan_collapse(from, to) else {
            return 0;
        };
        if self.spoils_faces(&collapse) {
            return 0;
        }
        let gone = self.mesh.edge_faces(from, to).faces().count();
        self.mesh.apply_collapse(&collapse);
        let moved = self.quadrics[from as usize];
        self.quadrics[to as usize] += moved;
        self.stamps[from as usize] += 1;
        for p in self.mesh.neighbours(to).into_iter().chain([to]) {
            self.stamps[p as usize] += 1;
            queue.extend(self.find_cheapest(p, 0, 0));
        }
        gone
    }

    /// Whether the collapse turns a face over or makes a needle worse than any that it touches.
    fn spoils_faces(&self, collapse: &EdgeCollapse) -> bool {
        let (mut old, mut new) = (WORST_ASPECT, 0.0f64);
        for (_, before, after) in self.mesh.before_and_after(collapse) {
            old = old.max(triangle::aspect(before));
            new = new.max(triangle::aspect(after));
            if !triangle::turns_little(before, after, LEAST_COSINE) {
                return true;
            }
        }
        new > old
    }
}

/// The sum of weighted squared distances to planes, as a function of the place: xᵀAx + 2bᵀx + c with A symmetric.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Quadric {
    diagonal: DVec3,
    /// yz, zx, xy.
    mixed: DVec3,
    linear: DVec3,
    constant: f64,
}

impl Quadric {
    /// The plane through `at` with unit normal `n`. Nothing when a number is not finite.
    pub fn from_plane(n: DVec3, at: DVec3, weight: f64) -> Self {
        let offset = -n.dot(at);
        let value = Self {
            diagonal: n * n * weight,
            mixed: DVec3::new(n.y * n.z, n.z * n.x, n.x * n.y) * weight,
            linear: n * (offset * weight),
            constant: offset * offset * weight,
        };
        let finite = value.diagonal.is_finite() && value.linear.is_finite() && value.constant.is_finite();
        if finite { value } else { Self::default() }
    }

    /// The sum at `x`, never negative.
    pub fn error_at(&self, x: DVec3) -> f64 {
        let squares = self.diagonal.dot(x * x);
        let products = self.mixed.dot(DVec3::new(x.y * x.z, x.z * x.x, x.x * x.y));
        (squares + 2.0 * (products + self.linear.dot(x)) + self.constant).max(0.0)
    }
}

impl AddAssign for Quadric {
    fn add_assign(&mut self, other: Self) {
        self.diagonal += other.diagonal;
        self.mixed += other.mixed;
        self.linear += other.linear;
        self.constant += other.constant;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_sum_of_weighted_squared_distances() {
        let planes = [
            (DVec3::X, DVec3::ONE, 2.0),
            (DVec3::new(1.0, -2.0, 0.5).normalize(), DVec3::new(0.3, 0.1, -4.0), 0.7),
        ];
        let mut q = Quadric::default();
        for (n, at, w) in planes {
            q += Quadric::from_plane(n, at, w);
        }
        let x = DVec3::new(2.0, -1.0, 0.4);
        let expected: f64 = planes.iter().map(|(n, at, w)| w * (x - *at).dot(*n).powi(2)).sum();
        assert!((q.error_at(x) - expected).abs() < 1e-12);
        assert_eq!(Quadric::from_plane(DVec3::NAN, DVec3::ONE, 1.0), Quadric::default());
    }
}
