//! Ways over a mesh between two of its points: straight across faces, or along edges.
//!
//! The nearest place on a surface, and the triangles in a box, without a tree: runs of triangles that follow each other
//! in the file lie close together, so the boxes of such runs sort out nearly all of them.

use crate::region_mesh::{RegionMesh, edge_key};
use crate::surface::SurfaceView;
use glam::DVec3;
use pliant_mesh::query::closest_point::closest_barycentric_point;
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
    let mut trace = StraightTrace::new(mesh, from, to)?;
    let mut front = TraceFront::Point(from);
    loop {
        let next = match front {
            TraceFront::Point(point) => trace.leave_point(point)?,
            TraceFront::Face { edge, face } => trace.cross_face(edge, face)?,
        };
        let Some(crossing) = next else {
            trace.steps.push(TraceStep::Point(to));
            return Ok(trace.steps);
        };
        trace.travel(&crossing)?;
        match crossing.step {
            TraceStep::Point(p) if p == to => return Ok(trace.steps),
            TraceStep::Point(p) => front = trace.enter_point(p)?,
            TraceStep::Edge { a, b, .. } => front = trace.enter_edge([a, b], crossing.face)?,
        }
    }
}

/// Where a trace has come to.
enum TraceFront {
    /// A point.
    Point(u32),
    /// An edge, about to enter a face.
    Face { edge: [u32; 2], face: u32 },
}

/// Where a trace goes next.
struct TraceCrossing {
    step: TraceStep,
    place: DVec3,
    /// The face that lies in between.
    face: u32,
}

/// A straight way as far as it is known.
struct StraightTrace<'m> {
    mesh: &'m RegionMesh,
    to: u32,
    start: DVec3,
    aim: DVec3,
    /// Normal of the plane that the way lies in.
    across: DVec3,
    steps: Vec<TraceStep>,
    passed: BTreeSet<u32>,
    crossed: BTreeSet<(u32, u32)>,
    here: DVec3,
    heading: DVec3,
    travelled: f64,
}

impl<'m> StraightTrace<'m> {
    fn new(mesh: &'m RegionMesh, from: u32, to: u32) -> Result<Self, TraceFailure> {
        let start = mesh.position(from);
        let aim = mesh.position(to) - start;
        let normal = point_normal(mesh, from) + point_normal(mesh, to);
        let across = aim.cross(normal).try_normalize().ok_or(TraceFailure::Blocked)?;
        Ok(Self {
            mesh,
            to,
            start,
            aim,
            across,
            steps: Vec::new(),
            passed: BTreeSet::from([from]),
            crossed: BTreeSet::new(),
            here: start,
            heading: aim,
            travelled: 0.0,
        })
    }

    /// Signed distance of a point to the plane.
    fn plane_distance(&self, p: u32) -> f64 {
        self.across.dot(self.mesh.position(p) - self.start)
    }

    /// Where the plane crosses an edge, or the end that it all but goes through.
    fn plane_crossing(&self, u: u32, v: u32) -> Option<(TraceStep, DVec3)> {
        let at = |p: u32| self.mesh.position(p);
        let (g, h) = (self.plane_distance(u), self.plane_distance(v));
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
    }

    /// From a point across the face around it that leads on most nearly straight; `None` if an edge leads to the end.
    fn leave_point(&self, point: u32) -> Result<Option<TraceCrossing>, TraceFailure> {
        let mesh = self.mesh;
        if mesh.has_edge(point, self.to) {
            return Ok(None);
        }
        if !mesh.points[point as usize].whole {
            return Err(TraceFailure::Leaves);
        }
        let mut best: Option<(f64, TraceCrossing)> = None;
        for &f in mesh.faces_around(point) {
            let face = &mesh.faces[f as usize];
            let Some(k) = face.corner_of(point) else {
                continue;
            };
            let Some((step, place)) = self.plane_crossing(face.points[(k + 1) % 3], face.points[(k + 2) % 3]) else {
                continue;
            };
            let taken = match step {
                TraceStep::Point(p) => self.passed.contains(&p),
                TraceStep::Edge { a, b, .. } => self.crossed.contains(&edge_key(a, b)),
            };
            let forward = (place - self.here)
                .normalize_or_zero()
                .dot(self.heading.normalize_or_zero());
            if !taken && forward > 0.0 && best.as_ref().is_none_or(|b| forward > b.0) {
                best = Some((forward, TraceCrossing { step, place, face: f }));
            }
        }
        let (_, crossing) = best.ok_or(TraceFailure::Blocked)?;
        Ok(Some(crossing))
    }

    /// From an edge to one of the other two edges of a face; `None` if the face has the end for a corner.
    fn cross_face(&self, [a, b]: [u32; 2], face: u32) -> Result<Option<TraceCrossing>, TraceFailure> {
        let corners = self.mesh.faces[face as usize].points;
        let apex = corners.into_iter().find(|&p| p != a && p != b);
        let apex = apex.ok_or(TraceFailure::Blocked)?;
        if apex == self.to {
            return Ok(None);
        }
        let is_above = |p: u32| self.plane_distance(p) > 0.0;
        let exit = if is_above(a) == is_above(apex) { b } else { a };
        let (step, place) = self.plane_crossing(exit, apex).ok_or(TraceFailure::Blocked)?;
        Ok(Some(TraceCrossing { step, place, face }))
    }

    /// Takes a step, unless the way has become too long.
    fn travel(&mut self, crossing: &TraceCrossing) -> Result<(), TraceFailure> {
        self.travelled += crossing.place.distance(self.here);
        if self.travelled > DETOUR * self.aim.length() || self.steps.len() > self.mesh.faces.len() {
            return Err(TraceFailure::Blocked);
        }
        self.heading = crossing.place - self.here;
        self.here = crossing.place;
        self.steps.push(crossing.step);
        Ok(())
    }

    fn enter_point(&mut self, p: u32) -> Result<TraceFront, TraceFailure> {
        match self.passed.insert(p) {
            true => Ok(TraceFront::Point(p)),
            false => Err(TraceFailure::Blocked),
        }
    }

    /// Finds the face on the other side of an edge, coming from `face`.
    fn enter_edge(&mut self, edge: [u32; 2], face: u32) -> Result<TraceFront, TraceFailure> {
        let ([a, b], mesh) = (edge, self.mesh);
        if !(mesh.points[a as usize].whole || mesh.points[b as usize].whole) {
            return Err(TraceFailure::Leaves);
        }
        if !self.crossed.insert(edge_key(a, b)) {
            return Err(TraceFailure::Blocked);
        }
        let other = mesh.faces_along(a, b).find(|&g| g != face);
        let face = other.ok_or(TraceFailure::Blocked)?;
        Ok(TraceFront::Face { edge, face })
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

/// Triangles in a run.
const RUN: usize = 256;

/// A place on a triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FacePosition {
    pub face: u32,
    pub position: DVec3,
}

/// The boxes around runs of 256 triangles that follow each other in a surface.
pub(super) struct TriangleRuns {
    boxes: Vec<(DVec3, DVec3)>,
}

impl TriangleRuns {
    pub fn build(surface: &SurfaceView<'_>) -> Self {
        let boxes = surface.triangles.chunks(RUN).map(|run| {
            run.iter()
                .flatten()
                .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &v| {
                    let x = surface.positions[v as usize];
                    (low.min(x), high.max(x))
                })
        });
        Self { boxes: boxes.collect() }
    }

    /// The place nearest to `x`; of equally near ones that on the first triangle. `None` without triangles.
    pub fn find_nearest(&self, surface: &SurfaceView<'_>, x: DVec3) -> Option<FacePosition> {
        let far = |(low, high): &(DVec3, DVec3)| (x.clamp(*low, *high) - x).length_squared();
        let start = (0..self.boxes.len()).min_by(|&a, &b| far(&self.boxes[a]).total_cmp(&far(&self.boxes[b])))?;
        let mut best: Option<(f64, FacePosition)> = None;
        for run in std::iter::once(start).chain(0..self.boxes.len()) {
            if best.is_some_and(|b| far(&self.boxes[run]) > b.0) {
                continue;
            }
            for face in run * RUN..((run + 1) * RUN).min(surface.triangles.len()) {
                if surface.proper_points(face as u32).is_none() {
                    continue;
                }
                let position = closest_barycentric_point(x, surface.corner_positions(face as u32));
                let place = FacePosition {
                    face: face as u32,
                    position,
                };
                let distance = position.distance_squared(x);
                if best.is_none_or(|(d, p)| (distance, place.face) < (d, p.face)) {
                    best = Some((distance, place));
                }
            }
        }
        best.map(|b| b.1)
    }

    /// Adds the triangles whose boxes meet the box from `low` to `high`.
    pub fn collect_in_box(&self, surface: &SurfaceView<'_>, low: DVec3, high: DVec3, found: &mut Vec<u32>) {
        let meets = |l: DVec3, h: DVec3| l.cmple(high).all() && h.cmpge(low).all();
        for (run, _) in self.boxes.iter().enumerate().filter(|(_, b)| meets(b.0, b.1)) {
            for face in run * RUN..((run + 1) * RUN).min(surface.triangles.len()) {
                let [a, b, c] = surface.corner_positions(face as u32);
                if meets(a.min(b).min(c), a.max(b).max(c)) {
                    found.push(face as u32);
                }
            }
        }
    }
}

#[cfg(test)]
mod nearest_face_tests {
    use super::*;

    #[test]
    fn nearest_places_are_those_of_a_search_over_all() {
        let positions: Vec<DVec3> = (0..400u32)
            .map(|i| {
                let (x, y) = (f64::from(i % 20), f64::from(i / 20));
                DVec3::new(x, y, libm::sin(x * 0.7) * libm::cos(y * 0.5))
            })
            .collect();
        let corner = |x: u32, y: u32| 20 * y + x;
        let triangles: Vec<[u32; 3]> = (0..361u32)
            .flat_map(|i| {
                let (x, y) = (i % 19, i / 19);
                let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
                [[a, b, c], [a, c, d]]
            })
            .collect();
        let points: Vec<u32> = (0..400).collect();
        let surface = SurfaceView {
            positions: &positions,
            triangles: &triangles,
            primitive_of: &vec![0; triangles.len()],
            point_of: &points,
            points: 400,
        };
        let runs = TriangleRuns::build(&surface);
        for k in 0..60 {
            let x = DVec3::new(
                f64::from(k % 9) * 2.6 - 1.0,
                f64::from(k / 9) * 3.1 - 0.5,
                f64::from(k % 4) - 1.5,
            );
            let all = triangles
                .iter()
                .map(|t| closest_barycentric_point(x, t.map(|v| positions[v as usize])).distance(x));
            let least = all.fold(f64::INFINITY, f64::min);
            let found = runs.find_nearest(&surface, x).expect("a surface");
            assert_eq!(found.position.distance(x), least);
            // No step around the place gets closer.
            let t = triangles[found.face as usize].map(|v| positions[v as usize]);
            let steps = [[0.5, 0.25, 0.25], [0.25, 0.5, 0.25], [0.25, 0.25, 0.5]];
            for s in steps {
                let inside = t[0] * s[0] + t[1] * s[1] + t[2] * s[2];
                assert!(found.position.lerp(inside, 1e-3).distance(x) >= least - 1e-12);
            }
        }
        let mut some = Vec::new();
        runs.collect_in_box(
            &surface,
            DVec3::new(4.5, 4.5, -9.0),
            DVec3::new(4.6, 4.6, 9.0),
            &mut some,
        );
        assert_eq!(some.len(), 2);
    }
}
