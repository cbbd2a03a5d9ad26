//! Lines and points through edits: what names old vertices by number, in the numbers of the edited model.

use super::{EditedModel, PrimitiveRun, VertexBlend};
use std::collections::{BTreeMap, BTreeSet};

/// How far along an edge copies of one vertex may be from each other.
const SAME_PLACE: f64 = 1e-6;

/// Where the old vertices of a base, and its edges, are after an edit.
pub(crate) struct FollowedLines {
    /// The vertices that an old one is, each old one with all of its copies.
    same: BTreeMap<u32, Vec<u32>>,
    /// The vertices on the edge between two old ones, with how near they are to the second.
    between: BTreeMap<[u32; 2], Vec<(f64, u32)>>,
    /// The edges of the triangles, the lower vertex first.
    edges: BTreeSet<[u32; 2]>,
}

impl FollowedLines {
    /// Those of runs of one base.
    pub fn of_runs<'a>(edited: &EditedModel<'_>, runs: impl Iterator<Item = &'a PrimitiveRun>) -> Self {
        let mut followed = Self {
            same: BTreeMap::new(),
            between: BTreeMap::new(),
            edges: BTreeSet::new(),
        };
        for run in runs {
            for (vertex, number) in run.vertices().zip(0..) {
                let vertex_number = run.first_vertex + number;
                match edited.blend(vertex) {
                    VertexBlend::Vertex(old) => followed.same.entry(old).or_default().push(vertex_number),
                    VertexBlend::Blend(&[(a, _), (b, weight)]) if a < b => {
                        let places = followed.between.entry([a, b]).or_default();
                        places.push((f64::from(weight), vertex_number));
                    }
                    VertexBlend::Blend(&[(b, weight), (a, _)]) => {
                        let places = followed.between.entry([a, b]).or_default();
                        places.push((f64::from(weight), vertex_number));
                    }
                    VertexBlend::Blend(_) => {}
                }
            }
            for &[a, b, c] in &edited.triangles[run.triangles()] {
                followed.edges.extend([[a, b], [b, c], [c, a]].map(sorted));
            }
        }
        for places in followed.between.values_mut() {
            places.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        }
        followed
    }

    /// The vertex that an old one is, the first of its copies.
    pub fn vertex(&self, old: u32) -> Option<u32> {
        self.same.get(&old)?.first().copied()
    }

    /// The edges that the edge between two old vertices has become, as far as the surface is still there; `None` where an end of
    /// it is left, and no piece of it.
    pub fn edges_along(&self, from: u32, to: u32) -> Option<Vec<[u32; 2]>> {
        let copies = |old: u32| self.same.get(&old).cloned().unwrap_or_default();
        // Copies of one place stand together.
        let mut levels: Vec<Vec<u32>> = vec![copies(from)];
        let mut last = f64::NEG_INFINITY;
        for (at, vertex) in self.inside(from, to) {
            match levels.last_mut() {
                Some(level) if at - last <= SAME_PLACE => level.push(vertex),
                _ => levels.push(vec![vertex]),
            }
            last = at;
        }
        levels.push(copies(to));
        let mut found = Vec::new();
        for pair in levels.windows(2) {
            let pairs = pair[0].iter().flat_map(|a| pair[1].iter().map(move |b| [*a, *b]));
            found.extend(pairs.filter(|edge| self.edges.contains(&sorted(*edge))));
        }
        let is_gone = levels.iter().all(Vec::is_empty);
        (is_gone || !found.is_empty()).then_some(found)
    }

    /// A line through old vertices: through those of them that are left, and what lies on the edges between. `None` where
    /// less than two are left; and how many vertices are not.
    pub fn line(&self, old: &[u32]) -> (Option<Vec<u32>>, usize) {
        let mut line: Vec<u32> = Vec::with_capacity(old.len());
        let mut lost = 0;
        let mut last: Option<(usize, u32)> = None;
        for (i, &vertex) in old.iter().enumerate() {
            let Some(now) = self.vertex(vertex) else {
                lost += 1;
                continue;
            };
            if let Some((at, before)) = last
                && at + 1 == i
            {
                let mut level = f64::NEG_INFINITY;
                for (place, between) in self.inside(before, vertex) {
                    if place - level > SAME_PLACE {
                        line.push(between);
                    }
                    level = place;
                }
            }
            line.push(now);
            last = Some((i, vertex));
        }
        let is_line = line.len() > 1;
        (is_line.then_some(line), lost)
    }

    /// The vertices on the edge between two old ones, from the first to the second.
    fn inside(&self, from: u32, to: u32) -> Vec<(f64, u32)> {
        let places = self.between.get(&sorted([from, to])).map_or(&[][..], Vec::as_slice);
        match from < to {
            true => places.to_vec(),
            false => places.iter().rev().map(|&(at, vertex)| (1.0 - at, vertex)).collect(),
        }
    }
}

fn sorted([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}
