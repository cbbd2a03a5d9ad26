//! Lines and points through edits: what names old vertices by number, in the numbers of the edited model.

use super::{EditedModel, PrimitiveRun, VertexBlend};
use crate::{Error, Model};
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
    /// The vertices of the triangles, rising.
    in_triangle: Vec<u32>,
}

impl FollowedLines {
    /// Those of runs of one base.
    pub fn of_runs<'a>(edited: &EditedModel<'_>, runs: impl Iterator<Item = &'a PrimitiveRun>) -> Self {
        let mut followed = Self {
            same: BTreeMap::new(),
            between: BTreeMap::new(),
            edges: BTreeSet::new(),
            in_triangle: Vec::new(),
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
        followed.in_triangle = followed.edges.iter().flatten().copied().collect();
        followed.in_triangle.sort_unstable();
        followed.in_triangle.dedup();
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
        let mut levels: Vec<Vec<u32>> = vec![copies(from)];
        levels.extend(self.levels_inside(from, to));
        levels.push(copies(to));
        let mut found = Vec::new();
        for pair in levels.windows(2) {
            let pairs = pair[0].iter().flat_map(|a| pair[1].iter().map(move |b| [*a, *b]));
            found.extend(pairs.filter(|edge| self.edges.contains(&sorted(*edge))));
        }
        let is_gone = levels.iter().all(Vec::is_empty);
        (is_gone || !found.is_empty()).then_some(found)
    }

    /// A line through old vertices, in pieces: through those of them that are left, and what lies on the edges between. It
    /// ends where a cut has gone through such an edge. And how many vertices are not there; pieces of one vertex are none.
    pub fn line(&self, old: &[u32]) -> (Vec<Vec<u32>>, usize) {
        let mut levels: Vec<Vec<u32>> = Vec::with_capacity(old.len());
        // For each old vertex how many levels come before its own.
        let mut starts = Vec::with_capacity(old.len());
        for (i, &vertex) in old.iter().enumerate() {
            if let Some(before) = i.checked_sub(1) {
                levels.extend(self.levels_inside(old[before], vertex));
            }
            starts.push(levels.len());
            levels.push(self.same.get(&vertex).cloned().unwrap_or_default());
        }
        let mut pieces: Vec<Vec<u32>> = Vec::new();
        let mut piece: Vec<u32> = Vec::with_capacity(levels.len());
        let mut is_cut = false;
        let (mut next, mut from_gone) = (0, false);
        for &own in &starts {
            let inside = next..own;
            let is_gone = levels[own].is_empty();
            let begins = from_gone && (is_cut || !inside.is_empty());
            for at in next..=own {
                let Some((arrive, leave)) = self.ends_at(&levels, at) else {
                    continue;
                };
                let is_joined = |last: &u32| self.edges.contains(&sorted([*last, arrive]));
                if at == next && begins && !piece.last().is_some_and(is_joined) {
                    pieces.push(std::mem::take(&mut piece));
                }
                piece.push(arrive);
                if leave != arrive {
                    pieces.push(std::mem::replace(&mut piece, vec![leave]));
                }
            }
            is_cut = is_gone && (!inside.is_empty() || (is_cut && from_gone));
            (next, from_gone) = (own + 1, is_gone);
        }
        pieces.push(piece);
        pieces.retain(|piece| piece.len() > 1);
        (pieces, starts.iter().filter(|own| levels[**own].is_empty()).count())
    }

    /// What is left of the segment between two old vertices, in pieces: itself, with what an edit has put between, or parts of it.
    pub fn segment(&self, from: u32, to: u32) -> Vec<[u32; 2]> {
        let (pieces, _) = self.line(&[from, to]);
        let pairs = pieces.iter().flat_map(|piece| piece.windows(2));
        pairs.map(|pair| [pair[0], pair[1]]).collect()
    }

    /// The copies by which a line comes to a place and leaves it: two where a cut has parted it there. `None` where there are none.
    fn ends_at(&self, levels: &[Vec<u32>], at: usize) -> Option<(u32, u32)> {
        let copies = &levels[at];
        let (&first, &last) = (copies.first()?, copies.last()?);
        if copies.len() == 1 {
            return Some((first, first));
        }
        if copies.iter().all(|copy| self.in_triangle.binary_search(copy).is_err()) {
            return Some((first, last));
        }
        let side = |level: Option<&Vec<u32>>| {
            let joined =
                |copy: &&u32| level.is_some_and(|l| l.iter().any(|v| self.edges.contains(&sorted([*v, **copy]))));
            copies.iter().filter(joined).copied().collect::<Vec<u32>>()
        };
        let before = side(at.checked_sub(1).map(|k| &levels[k]));
        let after = side(levels.get(at + 1));
        Some(match (before.first(), after.first()) {
            (None, None) => (first, first),
            (Some(&only), None) | (None, Some(&only)) => (only, only),
            (Some(&arrive), Some(&leave)) => {
                let both = before.iter().find(|copy| after.contains(copy));
                both.map_or((arrive, leave), |&copy| (copy, copy))
            }
        })
    }

    /// The vertices on the edge between two old ones, copies of one place together.
    fn levels_inside(&self, from: u32, to: u32) -> Vec<Vec<u32>> {
        let mut levels: Vec<Vec<u32>> = Vec::new();
        let mut last = f64::NEG_INFINITY;
        for (at, vertex) in self.inside(from, to) {
            match levels.last_mut() {
                Some(level) if at - last <= SAME_PLACE => level.push(vertex),
                _ => levels.push(vec![vertex]),
            }
            last = at;
        }
        levels
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

/// The segments of the lines of a model that is edited, by its vertices, as edits have left them.
///
/// # Errors
/// Those of reading a base again.
pub(crate) fn segments_of(
    edited: &EditedModel<'_>,
    of_base: impl Fn(&Model) -> Result<Vec<[u32; 2]>, Error>,
) -> Result<Vec<[u32; 2]>, Error> {
    let mut found = Vec::new();
    for (base, model) in (0u32..).zip(edited.bases) {
        let segments = of_base(model.model)?;
        if segments.is_empty() {
            continue;
        }
        let followed = FollowedLines::of_runs(edited, edited.runs.iter().filter(|run| run.base == base));
        for [from, to] in segments {
            match from == to {
                true => found.extend(followed.vertex(from).map(|v| [v; 2])),
                false => found.extend(followed.segment(from, to)),
            }
        }
    }
    Ok(found)
}

fn sorted([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

#[cfg(test)]
mod tests {
    use crate::{
        BaseModel, CapLooks, EditedModel, FileSet, Format, Limits, Model, PrimitiveRun, VertexBlends,
        write_edited_model,
    };

    /// What is said when the second of two triangles is gone, and with it the last of four vertices.
    fn said_without_second(name: &str, format: Format, text: String) -> Vec<String> {
        let model = Model::read(FileSet::single(name, text), None, &Limits::default()).expect("readable");
        let edited = EditedModel {
            bases: &[BaseModel {
                model: &model,
                world_from_model: glam::DAffine3::IDENTITY,
            }],
            runs: &[PrimitiveRun {
                base: 0,
                primitive: 0,
                first_vertex: 0,
                vertex_count: 3,
                first_triangle: 0,
                triangle_count: 1,
            }],
            blends: &VertexBlends::identity(3),
            triangles: &model.triangles[..1],
            origins: &[],
            bare: &[],
            caps: CapLooks::default(),
        };
        let written = write_edited_model(&edited, &model.positions[..3], format).expect("writable");
        written.warnings.iter().map(|w| w.message.clone()).collect()
    }

    #[test]
    fn every_line_and_edge_that_is_gone_is_counted() {
        let vertices = "0 0 0\n1 0 0\n0 1 0\n1 1 0\n4 4 4\n";
        let obj: String = vertices.lines().map(|v| format!("v {v}\n")).collect();
        let obj = format!("{obj}f 1 2 3\nf 2 4 3\nl 1 2\nl 2 4\nl 4 5\nl 1 2 4\np 1 5\n");
        assert_eq!(
            said_without_second("one.obj", Format::OBJ, obj),
            ["after the edit the obj file has not: 2 lines, 2 vertices of lines and points"]
        );
        let head = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n\
                    property list uchar int vertex_indices\nelement edge 3\nproperty int vertex1\nproperty int vertex2\nend_header\n";
        let ply = format!("{head}{vertices}3 0 1 2\n3 1 3 2\n0 1\n1 3\n3 4\n");
        let said = said_without_second("one.ply", Format::PLY, ply);
        assert!(said.len() == 1 && said[0].contains("2 edges"), "{said:?}");
    }
}
