//! Lines that a remeshed surface must keep: boundaries, seams, primitive borders and sharp edges.
//!
//! A chain runs from one held point to the next. Points in between may slide along it, be added and removed. The length
//! from the chain's start gives their positions, so they are always on the original line. The segment gives what they
//! are made of, on either side.

use super::deviation::is_sliver;
use crate::region_mesh::RegionMesh;
use crate::triangle;
use glam::DVec3;
use pliant_mesh::{NONE, sorted_set};
use std::collections::{BTreeMap, BTreeSet};

/// A line that turns by more than 45° at a point has a corner there: the cosine.
const CORNER: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// A sharp line that ends loosely and is not longer than so many target lengths is noise.
const LOOSE: f64 = 4.0;

/// Sharp edges that hang together and end loosely, but not for so many target lengths, are noise.
const NOISE: f64 = 6.0;

/// What kind of line an edge is part of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LineKind {
    /// One face.
    Boundary,
    /// Two faces that show different vertices.
    Seam,
    /// Two faces with one vertex at each end, at an angle.
    Sharp,
}

/// One line between two held points.
#[derive(Debug, Clone)]
pub(super) struct Chain {
    pub kind: LineKind,
    positions: Vec<DVec3>,
    /// Length from the start to each position.
    along: Vec<f64>,
    /// Target length at each position.
    sizes: Vec<f64>,
    /// Render vertices at both ends of each segment: to the left, to the right.
    sides: Vec<[Option<[u32; 2]>; 2]>,
}

impl Chain {
    fn segment_at(&self, s: f64) -> (usize, f64) {
        let last = self.along.len().saturating_sub(2);
        let i = self.along.partition_point(|&l| l <= s).saturating_sub(1).min(last);
        let t = (s - self.along[i]) / (self.along[i + 1] - self.along[i]);
        (i, if t.is_finite() { t.clamp(0.0, 1.0) } else { 0.0 })
    }

    /// The place at length `s`.
    pub fn position_at(&self, s: f64) -> DVec3 {
        let (i, t) = self.segment_at(s);
        self.positions[i] * (1.0 - t) + self.positions[i + 1] * t
    }

    /// The target length at `s`.
    pub fn target_length_at(&self, s: f64) -> f64 {
        let (i, t) = self.segment_at(s);
        self.sizes[i] * (1.0 - t) + self.sizes[i + 1] * t
    }

    /// What a point at `s` is made of, on the left (0) or right (1).
    pub fn blend_at(&self, s: f64, side: usize) -> Option<([u32; 3], [f64; 3])> {
        let (i, t) = self.segment_at(s);
        let [a, b] = self.sides[i][side].or(self.sides[i][1 - side])?;
        Some(([a, b, a], [1.0 - t, t, 0.0]))
    }
}

/// A piece of a chain that is an edge now: from its smaller to its larger point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ChainSegment {
    pub chain: u32,
    /// Lengths along the chain at the smaller and the larger point.
    pub at: [f64; 2],
}

/// All chains, and the edges that they consist of now.
#[derive(Debug, Clone, Default)]
pub(super) struct FeatureLines {
    pub chains: Vec<Chain>,
    pieces: BTreeMap<(u32, u32), ChainSegment>,
}

/// Where an inner point of a chain is, and its neighbours on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ChainPoint {
    pub chain: u32,
    pub at: f64,
    /// Towards the start and towards the end.
    pub beside: [u32; 2],
}

impl FeatureLines {
    /// The chain's piece from `a` to `b`, with lengths in that order.
    pub fn chain_segment(&self, a: u32, b: u32) -> Option<ChainSegment> {
        let piece = *self.pieces.get(&(a.min(b), a.max(b)))?;
        let [s, t] = piece.at;
        Some(ChainSegment {
            at: if a < b { [s, t] } else { [t, s] },
            ..piece
        })
    }

    /// Notes that the edge from `a` to `b` is this piece.
    pub fn set_segment(&mut self, a: u32, b: u32, chain: u32, at: [f64; 2]) {
        let at = if a < b { at } else { [at[1], at[0]] };
        self.pieces.insert((a.min(b), a.max(b)), ChainSegment { chain, at });
    }

    /// Forgets the edge from `a` to `b`.
    pub fn remove_segment(&mut self, a: u32, b: u32) {
        self.pieces.remove(&(a.min(b), a.max(b)));
    }

    /// Finds all lines of a mesh. Says for each point whether it is inner to a chain, and where; points on lines that are
    /// not are to be held. Edges are sharp when the normals of their faces make an angle with a smaller cosine than
    /// `sharp_cosine`; lines of them that end loosely and are shorter than a few target lengths are noise.
    pub fn trace_lines(
        mesh: &RegionMesh,
        sizes: &[f64],
        sharp_cosine: f64,
    ) -> (Self, Vec<Option<ChainPoint>>, BTreeSet<u32>) {
        let mut lines = LineEdges::find_line_edges(mesh, sharp_cosine);
        lines.drop_small(mesh, sizes);
        for _ in 0..4 {
            let chains = lines.list_chains(mesh);
            let mut dropped = false;
            for run in &chains {
                let length: f64 = run.windows(2).map(|p| mesh.edge_length(p[0], p[1])).sum();
                let loose = [run[0], run[run.len() - 1]].iter().any(|&p| lines.is_loose(mesh, p));
                let sharp = lines.line_kind(run[0], run[1]) == Some(LineKind::Sharp);
                if sharp && loose && length < LOOSE * sizes[run[0] as usize] {
                    run.windows(2).for_each(|p| lines.remove(p[0], p[1]));
                    dropped = true;
                }
            }
            if !dropped {
                break;
            }
        }
        let mut curves = Self::default();
        let mut on = vec![None; mesh.points.len()];
        for search_pieces in lines.list_chains(mesh) {
            curves.add_chain(mesh, sizes, &search_pieces, &lines, &mut on);
        }
        let held = (lines.beside.keys().copied())
            .filter(|&p| on[p as usize].is_none())
            .collect();
        (curves, on, held)
    }

    fn add_chain(
        &mut self,
        mesh: &RegionMesh,
        sizes: &[f64],
        run: &[u32],
        lines: &LineEdges,
        on: &mut [Option<ChainPoint>],
    ) {
        let Some(kind) = lines.line_kind(run[0], run[1]) else {
            return;
        };
        let mut along = vec![0.0];
        let mut sides = Vec::new();
        for p in run.windows(2) {
            let (a, b) = (p[0], p[1]);
            along.push(along[along.len() - 1] + mesh.edge_length(a, b));
            let edge = mesh.edge_faces(a, b);
            sides.push([edge.left, edge.right].map(|f| {
                let old = |p| Some(mesh.wedges[mesh.wedge_at(f, p)? as usize].vertex);
                if f == NONE { None } else { Some([old(a)?, old(b)?]) }
            }));
        }
        let chain = self.chains.len() as u32;
        for (i, p) in run.windows(2).enumerate() {
            self.set_segment(p[0], p[1], chain, [along[i], along[i + 1]]);
        }
        for i in 1..run.len() - 1 {
            on[run[i] as usize] = Some(ChainPoint {
                chain,
                at: along[i],
                beside: [run[i - 1], run[i + 1]],
            });
        }
        self.chains.push(Chain {
            kind,
            positions: run.iter().map(|&p| mesh.position(p)).collect(),
            along,
            sizes: run.iter().map(|&p| sizes[p as usize]).collect(),
            sides,
        });
    }
}

/// The edges that are part of lines, from each of their ends; the other ends rise.
struct LineEdges {
    beside: BTreeMap<u32, Vec<(u32, LineKind)>>,
}

impl LineEdges {
    fn find_line_edges(mesh: &RegionMesh, sharp_cosine: f64) -> Self {
        let mut beside: BTreeMap<u32, Vec<(u32, LineKind)>> = BTreeMap::new();
        for (a, b) in mesh.edges() {
            let edge = mesh.edge_faces(a, b);
            if mesh.is_locked(edge) {
                continue;
            }
            let kind = if edge.faces().count() == 1 {
                LineKind::Boundary
            } else if !mesh.is_smooth(edge, a, b) {
                LineKind::Seam
            } else {
                let faces = [edge.left, edge.right];
                let [n, m] = faces.map(|f| mesh.area_normal(f));
                let sharp = triangle::cosine(n, m).is_some_and(|c| c < sharp_cosine);
                if !sharp || faces.iter().any(|&f| is_sliver(mesh, f)) {
                    continue;
                }
                LineKind::Sharp
            };
            beside.entry(a).or_default().push((b, kind));
            beside.entry(b).or_default().push((a, kind));
        }
        Self { beside }
    }

    /// Drops groups of sharp edges that hang together, end loosely somewhere and are shorter in all than a few target lengths.
    fn drop_small(&mut self, mesh: &RegionMesh, sizes: &[f64]) {
        let sharp = |row: &[(u32, LineKind)]| -> Vec<u32> {
            row.iter().filter(|n| n.1 == LineKind::Sharp).map(|n| n.0).collect()
        };
        let mut seen = BTreeSet::new();
        let mut small = Vec::new();
        for &start in self.beside.keys() {
            if !seen.insert(start) {
                continue;
            }
            let (mut group, mut length, mut loose, mut next) = (Vec::new(), 0.0, false, vec![start]);
            while let Some(p) = next.pop() {
                loose |= self.is_loose(mesh, p);
                for q in self.beside.get(&p).map(|row| sharp(row)).unwrap_or_default() {
                    if p < q {
                        group.push((p, q));
                        length += mesh.edge_length(p, q);
                    }
                    if seen.insert(q) {
                        next.push(q);
                    }
                }
            }
            if loose && length < NOISE * sizes[start as usize] {
                small.extend(group);
            }
        }
        small.into_iter().for_each(|(a, b)| self.remove(a, b));
    }

    fn line_kind(&self, a: u32, b: u32) -> Option<LineKind> {
        let row = self.beside.get(&a)?;
        row.binary_search_by_key(&b, |n| n.0).ok().map(|k| row[k].1)
    }

    fn remove(&mut self, a: u32, b: u32) {
        for (p, q) in [(a, b), (b, a)] {
            if let Some(row) = self.beside.get_mut(&p) {
                if let Ok(k) = row.binary_search_by_key(&q, |n| n.0) {
                    row.remove(k);
                }
                if row.is_empty() {
                    self.beside.remove(&p);
                }
            }
        }
    }

    /// Whether a line just ends at `p`, inside the surface.
    fn is_loose(&self, mesh: &RegionMesh, p: u32) -> bool {
        !mesh.points[p as usize].fixed && self.beside.get(&p).is_some_and(|row| row.len() == 1)
    }

    /// The two neighbours of a point that a line passes without a corner.
    fn line_neighbours(&self, mesh: &RegionMesh, p: u32) -> Option<[u32; 2]> {
        let &[(a, kind), (b, other)] = self.beside.get(&p)?.as_slice() else {
            return None;
        };
        if mesh.points[p as usize].fixed || kind != other {
            return None;
        }
        let turn = triangle::cosine(mesh.position(p) - mesh.position(a), mesh.position(b) - mesh.position(p))?;
        let wedges: Vec<u32> = sorted_set((mesh.faces_around(p).iter()).filter_map(|&f| mesh.wedge_at(f, p)));
        let expected = if kind == LineKind::Seam { 2 } else { 1 };
        (turn > CORNER && wedges.len() == expected).then_some([a, b])
    }

    /// All chains as lists of points. A ring without a corner is cut at three of its points.
    fn list_chains(&self, mesh: &RegionMesh) -> Vec<Vec<u32>> {
        let through: BTreeMap<u32, [u32; 2]> = (self.beside.keys())
            .filter_map(|&p| Some((p, self.line_neighbours(mesh, p)?)))
            .collect();
        let mut done: BTreeSet<(u32, u32)> = BTreeSet::new();
        let mut runs = Vec::new();
        let walk = |start: u32, next: u32, done: &mut BTreeSet<(u32, u32)>| {
            let mut run = vec![start];
            let (mut before, mut here) = (start, next);
            loop {
                done.insert((before, here));
                done.insert((here, before));
                run.push(here);
                let Some(&[a, b]) = through.get(&here) else { break };
                let on = if a == before { b } else { a };
                if done.contains(&(here, on)) {
                    break;
                }
                (before, here) = (here, on);
            }
            run
        };
        for (&p, row) in &self.beside {
            if through.contains_key(&p) {
                continue;
            }
            for &(q, _) in row {
                if !done.contains(&(p, q)) {
                    runs.push(walk(p, q, &mut done));
                }
            }
        }
        for (&p, [_, q]) in &through {
            if done.contains(&(p, *q)) {
                continue;
            }
            let ring = walk(p, *q, &mut done);
            let edges = ring.len() - 1;
            let cuts = [0, edges / 3, 2 * edges / 3, edges];
            runs.extend(cuts.windows(2).map(|c| ring[c[0]..=c[1]].to_vec()));
        }
        runs.retain(|run| run.len() > 1);
        runs
    }
}
