//! Thin faces: edges and faces far smaller than what is around them follow it, instead of opening.
//!
//! The second pass weighs every edge alike, so it spreads its error over edges evenly, whatever their lengths. An error
//! of a tenth of an edge is harmless to a face of ordinary size, but ten times the height of a thin one.
//! Faces are thin in two ways (Botsch and Kobbelt 2001, "A robust procedure to eliminate degenerate faces"): a needle has
//! an edge far shorter than the others, a cap has a corner close to its longest edge. Vertices on short edges take the
//! mean motion of those around them, corners of caps follow the edge that they lie on. Even meshes have neither and
//! keep all their bits.
//!
//! Which vertices of a mesh lie on short edges, and which close to the edge of a face.
//!
//! Thin faces brought to follow what is around them.

use crate::body::DeformableBody;
use crate::first_pass::blend::LocalFrame;
use crate::handles::system::HandleSystem;
use glam::{DVec3, Mat3};
use pliant_exec::pool::Pool;
use pliant_mesh::{Lists, Mesh};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::atomic::{AtomicU64, Ordering};

/// The thin faces of a mesh.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NeedlesAndCaps {
    /// Vertices with short edges, rising.
    crowded: Vec<u32>,
    /// For each of them those that it is averaged with.
    crowds: Lists,
    /// For each of them the distance at which others count no more, in model units.
    reach: Vec<f64>,
    /// Corners of caps; those over longer edges first, as what they lie on may lie on another.
    caps: Vec<Cap>,
}

/// A vertex close to an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Cap {
    pub apex: u32,
    pub edge: [u32; 2],
    /// Where on the edge it lies, from 0 at the first end to 1 at the second.
    pub along: f64,
    /// What the edge's motion weighs against its own; infinite for a vertex on the edge.
    pub weight: f64,
}

impl NeedlesAndCaps {
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.crowded.is_empty() && self.caps.is_empty()
    }

    /// The vertices whose frames say where thin faces go, in no order, some more than once.
    pub fn framed_vertices(&self) -> impl Iterator<Item = u32> {
        let crowds = (0..self.crowded.len() as u32).flat_map(|row| self.crowds.of(row));
        crowds.copied().chain(self.caps.iter().map(|cap| cap.apex))
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.crowded.capacity() * 4
            + self.crowds.byte_size()
            + self.reach.capacity() * 8
            + self.caps.capacity() * size_of::<Cap>()
    }
}

/// A length is short below this share of the longest edge around it.
const SHORT: f64 = 0.1;

/// Over how many edges in a row reaches are spread, at most. An even mesh has nothing to spread.
const SPREAD: usize = 32;

/// Triangles that one piece of work handles.
const PIECE: usize = 1 << 13;

/// A vertex is averaged with at most so many others; one that has more within reach is left as it is.
const CROWD: usize = 256;

impl NeedlesAndCaps {
    /// Finds the needles and caps of a mesh. A mesh without any costs four passes over its triangles.
    pub fn find(mesh: &Mesh, pool: &Pool) -> Self {
        let (reach, shorts, caps) = pool.install(|| {
            let reach = reaches(mesh);
            let shorts = short_edges(mesh, &reach);
            let caps = caps(mesh, &reach);
            (reach, shorts, caps)
        });
        let mut found = Self {
            caps,
            ..Self::default()
        };
        if shorts.is_empty() {
            found.crowds = Lists::gather(0, std::iter::empty);
            return found;
        }
        let near = Lists::gather(mesh.positions.len(), || {
            shorts.iter().flat_map(|&[a, b]| [(a, b), (b, a)])
        });
        let mut pairs = Vec::new();
        let mut seen = Vec::new();
        for vertex in 0..mesh.positions.len() as u32 {
            if near.of(vertex).is_empty() {
                continue;
            }
            let row = found.crowded.len() as u32;
            gather_crowd(vertex, reach[vertex as usize], &near, &mesh.positions, &mut seen);
            if seen.len() > CROWD {
                continue;
            }
            pairs.extend(seen[1..].iter().map(|&other| (row, other)));
            found.crowded.push(vertex);
            found.reach.push(reach[vertex as usize]);
        }
        found.crowds = Lists::gather(found.crowded.len(), || pairs.iter().copied());
        found
    }
}

/// For each vertex the length below which edges are short: a share of the longest edge of its faces, and what is left of
/// that of others on the way from there.
fn reaches(mesh: &Mesh) -> Vec<f64> {
    let edges = |t: &[u32; 3]| {
        let sides = [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
        sides.map(|[a, b]| {
            let length = mesh.positions[a as usize].distance(mesh.positions[b as usize]);
            (a as usize, b as usize, length)
        })
    };
    // The bits of numbers that are not negative are in the order of the numbers, and a maximum asks for no order.
    let longest: Vec<AtomicU64> = (0..mesh.positions.len()).map(|_| AtomicU64::new(0)).collect();
    let triangles = || mesh.triangles.par_iter().with_min_len(PIECE);
    triangles().flat_map_iter(edges).for_each(|(a, b, length)| {
        let bits = (SHORT * length).to_bits();
        for v in [a, b] {
            if longest[v].load(Ordering::Relaxed) < bits {
                longest[v].fetch_max(bits, Ordering::Relaxed);
            }
        }
    });
    let mut reach: Vec<f64> = longest
        .into_iter()
        .map(|bits| f64::from_bits(bits.into_inner()))
        .collect();
    // Only what was raised in one round can raise others in the next.
    let mut is_raised = vec![true; reach.len()];
    for _round in 0..SPREAD {
        let may_raise = |t: &&[u32; 3]| t.iter().any(|&v| is_raised[v as usize]);
        let raised_ends = |(a, b, length): (usize, usize, f64)| {
            [(a, b), (b, a)].map(|(from, to)| (to, reach[from] - length, reach[to]))
        };
        let open = triangles().filter(may_raise);
        let raised: Vec<(usize, f64)> = (open.flat_map_iter(edges).flat_map_iter(raised_ends))
            .filter(|(_, left, now)| left > now)
            .map(|(to, left, _)| (to, left))
            .collect();
        if raised.is_empty() {
            break;
        }
        is_raised.fill(false);
        for (to, left) in raised {
            reach[to] = reach[to].max(left);
            is_raised[to] = true;
        }
    }
    reach
}

/// Edges that are short at both ends, each once.
fn short_edges(mesh: &Mesh, reach: &[f64]) -> Vec<[u32; 2]> {
    let of_triangle = |t: &[u32; 3]| {
        let sides = [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
        let is_short = |[a, b]: &[u32; 2]| {
            let length = mesh.positions[*a as usize].distance(mesh.positions[*b as usize]);
            length < reach[*a as usize].min(reach[*b as usize])
        };
        sides.into_iter().filter(is_short).map(|[a, b]| [a.min(b), a.max(b)])
    };
    let mut short: Vec<[u32; 2]> = (mesh.triangles.par_iter().with_min_len(PIECE))
        .flat_map_iter(of_triangle)
        .collect();
    short.sort_unstable();
    short.dedup();
    short
}

/// Fills `crowd` with a vertex and those within reach along short edges, nearest in steps first.
fn gather_crowd(vertex: u32, reach: f64, near: &Lists, positions: &[DVec3], crowd: &mut Vec<u32>) {
    let here = positions[vertex as usize];
    crowd.clear();
    crowd.push(vertex);
    let mut next = 0;
    while next < crowd.len() && crowd.len() <= CROWD {
        for &other in near.of(crowd[next]) {
            let is_near = positions[other as usize].distance(here) < reach;
            if is_near && crowd.len() <= CROWD && !crowd.contains(&other) {
                crowd.push(other);
            }
        }
        next += 1;
    }
}

/// The corners of caps, over the longest edges first. A corner of several goes with the one whose edge is closest.
fn caps(mesh: &Mesh, reach: &[f64]) -> Vec<Cap> {
    // (height relative to reach, length of the edge, cap)
    let of_triangle = |t: &[u32; 3]| {
        let p = t.map(|v| mesh.positions[v as usize]);
        let lengths = [p[1].distance(p[2]), p[2].distance(p[0]), p[0].distance(p[1])];
        let k = (0..3).fold(0, |best, k| if lengths[k] > lengths[best] { k } else { best });
        let (a, b) = ((k + 1) % 3, (k + 2) % 3);
        let (edge, to) = (p[b] - p[a], p[k] - p[a]);
        let along = (to.dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
        let height = to.distance(edge * along);
        let limit = reach[t[k] as usize];
        // Where the corner is as close to an end, the face is a needle.
        let inside = along.min(1.0 - along) * lengths[k];
        (height < limit && height < inside).then(|| {
            let weight = (limit / height) * (limit / height) - 1.0;
            let cap = Cap {
                apex: t[k],
                edge: [t[a], t[b]],
                along,
                weight,
            };
            (height / limit, lengths[k], cap)
        })
    };
    let triangles = mesh.triangles.par_iter().with_min_len(PIECE);
    let mut found: Vec<(f64, f64, Cap)> = triangles.filter_map(of_triangle).collect();
    found.sort_by(|x, y| {
        (x.2.apex, x.0)
            .partial_cmp(&(y.2.apex, y.0))
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    found.dedup_by_key(|(_, _, cap)| cap.apex);
    found.sort_by(|x, y| y.1.total_cmp(&x.1).then(x.2.apex.cmp(&y.2.apex)));
    found.into_iter().map(|(_, _, cap)| cap).collect()
}

/// How often corners of caps are brought to their edges, whose ends may be corners of others.
const SWEEPS: usize = 3;

impl NeedlesAndCaps {
    /// Moves the corners of thin faces to where the shape around them is. What handles hold stays, and so does what has
    /// not moved. `positions` and `frames` are by node, as in [`crate::SolvedNodes`].
    pub fn settle(
        &self,
        body: &DeformableBody,
        handles: &HandleSystem,
        frames: &[LocalFrame],
        positions: &mut [DVec3],
        pool: &Pool,
    ) {
        if self.is_empty() || frames.len() != positions.len() {
            return;
        }
        // What is tied to another part stays at its place beside it.
        let mut held = Cow::Borrowed(handles.held_nodes());
        for anchor in body.graph.ties.iter().flat_map(|ties| ties.anchors()) {
            let held = held.to_mut();
            held[anchor.vertex as usize] = true;
            anchor.corners.iter().for_each(|&v| held[v as usize] = true);
        }
        let shape = PosedNodes {
            rest: &body.graph.positions,
            frames,
            held: &held,
        };
        let averaged = |row: usize| self.averaged(row, &shape, positions);
        let moved: Vec<Option<DVec3>> = pool.install(|| {
            (0..self.crowded.len())
                .into_par_iter()
                .with_min_len(64)
                .map(averaged)
                .collect()
        });
        for (&vertex, place) in self.crowded.iter().zip(moved) {
            if let Some(place) = place {
                positions[vertex as usize] = place;
            }
        }
        for _sweep in 0..SWEEPS {
            self.caps
                .iter()
                .for_each(|cap| self.follow_edge(cap, &shape, positions));
        }
    }

    /// Brings the corner of a cap to its edge, and those that it is crowded with along.
    fn follow_edge(&self, cap: &Cap, shape: &PosedNodes<'_>, positions: &mut [DVec3]) {
        let apex = cap.apex as usize;
        let [a, b] = cap.edge.map(|v| v as usize);
        if shape.held[apex] || [apex, a, b].iter().all(|&v| positions[v] == shape.rest[v]) {
            return;
        }
        let foot = shape.rest[a].lerp(shape.rest[b], cap.along);
        let on_edge = positions[a].lerp(positions[b], cap.along) + shape.turned(apex, shape.rest[apex] - foot);
        let share = if cap.weight.is_finite() {
            cap.weight / (1.0 + cap.weight)
        } else {
            1.0
        };
        let step = (on_edge - positions[apex]) * share;
        positions[apex] += step;
        let Ok(row) = self.crowded.binary_search(&cap.apex) else {
            return;
        };
        for &other in self.crowds.of(row as u32) {
            let other = other as usize;
            if !shape.held[other] && other != a && other != b {
                let away = shape.rest[other].distance_squared(shape.rest[apex]);
                positions[other] += step * fade(away / (self.reach[row] * self.reach[row]));
            }
        }
    }

    /// Where a crowded vertex goes; `None` when it stays.
    fn averaged(&self, row: usize, shape: &PosedNodes<'_>, positions: &[DVec3]) -> Option<DVec3> {
        let vertex = self.crowded[row] as usize;
        let crowd = self.crowds.of(row as u32);
        let is_still = |v: usize| positions[v] == shape.rest[v];
        if shape.held[vertex] || (is_still(vertex) && crowd.iter().all(|&v| is_still(v as usize))) {
            return None;
        }
        let here = shape.rest[vertex];
        let (mut sum, mut weights) = (positions[vertex], 1.0);
        for &other in crowd {
            let other = other as usize;
            let away = here - shape.rest[other];
            let share = away.length_squared() / (self.reach[row] * self.reach[row]);
            // What is held does not come half of the way.
            let weight = if shape.held[other] {
                fade(share) / share.max(1e-12)
            } else {
                fade(share)
            };
            sum += (positions[other] + shape.turned(other, away)) * weight;
            weights += weight;
        }
        Some(sum / weights)
    }
}

/// How much a vertex counts at a share of the reach, squared: 1 at the middle, 0 with a flat end at the reach.
fn fade(share: f64) -> f64 {
    (1.0 - share).max(0.0) * (1.0 - share).max(0.0)
}

/// Nodes and how they are turned.
struct PosedNodes<'a> {
    rest: &'a [DVec3],
    frames: &'a [LocalFrame],
    held: &'a [bool],
}

impl PosedNodes<'_> {
    /// A vector at a node as the node is turned and scaled.
    fn turned(&self, node: usize, vector: DVec3) -> DVec3 {
        Mat3::from_cols_array(&self.frames[node]).as_dmat3() * vector
    }
}
