//! How `vn` lines follow a deformation.
//!
//! A `vn` line may serve corners at many vertices, which a deformation turns differently. A *pair* is a `vn` line as used
//! at one vertex; pairs are what shades. A line whose pairs still agree is rewritten; where they part, the line serves
//! the first of them and the others get new lines.

use super::statements::NO_NORMAL;
use crate::mesh::shading;
use glam::{DVec3, Vec3};
use std::collections::BTreeMap;

/// The normals of a file and who uses them.
#[derive(Debug, Clone)]
pub(super) struct NormalLines {
    /// Unit normal of each `vn` line, zero where the line gives none.
    values: Vec<Vec3>,
    /// Each used (normal, vertex), ascending.
    pairs: Vec<[u32; 2]>,
    /// The pair of each triangle corner; `pairs.len()` for corners without a normal.
    corners: Vec<[u32; 3]>,
}

/// What becomes of the `vn` lines.
pub(super) struct NormalPlan {
    /// The new value of each line that is rewritten.
    pub rewritten: Vec<Option<Vec3>>,
    /// Lines to add.
    pub added: Vec<Vec3>,
    /// For each pair the line it uses now; lines to add count on from the existing ones.
    line_of_pair: Vec<u32>,
}

impl NormalLines {
    /// `corner_vertices` and `corner_normals` are the faces' corners, `slots` the triangles as places in them.
    pub fn new(values: Vec<Vec3>, corner_vertices: &[u32], corner_normals: &[u32], slots: &[[u32; 3]]) -> Self {
        let pair_at = |slot: usize| [corner_normals[slot], corner_vertices[slot]];
        let mut pairs: Vec<_> = (0..corner_vertices.len())
            .map(pair_at)
            .filter(|p| p[0] != NO_NORMAL)
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        let corner = |slot: u32| pairs.binary_search(&pair_at(slot as usize)).unwrap_or(pairs.len()) as u32;
        let corners = slots.iter().map(|t| t.map(corner)).collect();
        Self { values, pairs, corners }
    }

    /// The normals by vertex, where every corner of every used vertex names the same; zero for unused vertices.
    pub fn per_vertex(&self, vertex_count: usize) -> Option<Vec<Vec3>> {
        let mut line = vec![NO_NORMAL; vertex_count];
        for &[normal, vertex] in &self.pairs {
            if std::mem::replace(&mut line[vertex as usize], normal) != NO_NORMAL {
                return None;
            }
        }
        let none = self.pairs.len() as u32;
        let complete = !self.corners.iter().flatten().any(|&c| c == none);
        complete.then(|| {
            line.iter()
                .map(|&n| self.values.get(n as usize).copied().unwrap_or(Vec3::ZERO))
                .collect()
        })
    }

    /// Decides which lines change when the vertices move.
    pub fn plan_changes(&self, rest: &[DVec3], deformed: &[DVec3], triangles: &[[u32; 3]]) -> NormalPlan {
        let gradients = shading::gradients(rest, deformed, triangles, &self.corners, self.pairs.len() + 1);
        let mut plan = NormalPlan {
            rewritten: vec![None; self.values.len()],
            added: Vec::new(),
            line_of_pair: self.pairs.iter().map(|p| p[0]).collect(),
        };
        let mut first = 0;
        for run in self.pairs.chunk_by(|a, b| a[0] == b[0]) {
            let line = run[0][0] as usize;
            let authored = self.values[line];
            let carried: Vec<Vec3> = (first..first + run.len())
                .map(|pair| {
                    gradients[pair]
                        .as_ref()
                        .map_or(authored, |g| shading::carry_normal(g, authored))
                })
                .collect();
            self.share_lines(&mut plan, line, first, &carried);
            first += run.len();
        }
        plan
    }

    /// Gives one line's pairs, of which the first is number `first`, lines that hold their new values.
    fn share_lines(&self, plan: &mut NormalPlan, line: usize, first: usize, carried: &[Vec3]) {
        let authored = self.values[line];
        // The line stays as authored if anyone still uses it so.
        let kept = if carried.iter().any(|&n| is_same(n, authored)) {
            authored
        } else {
            carried[0]
        };
        if kept != authored {
            plan.rewritten[line] = Some(kept);
        }
        let mut others = BTreeMap::new();
        for (i, &normal) in carried.iter().enumerate() {
            if !is_same(normal, kept) {
                let bits = normal.to_array().map(f32::to_bits);
                plan.line_of_pair[first + i] = *others.entry(bits).or_insert_with(|| {
                    plan.added.push(normal);
                    (self.values.len() + plan.added.len() - 1) as u32
                });
            }
        }
    }

    pub fn bytes_held(&self) -> u64 {
        let lists = size_of_val(self.values.as_slice())
            + size_of_val(self.pairs.as_slice())
            + size_of_val(self.corners.as_slice());
        lists as u64
    }

    /// The line that a corner uses now.
    pub fn line_of(&self, plan: &NormalPlan, normal: u32, vertex: u32) -> u32 {
        self.pairs
            .binary_search(&[normal, vertex])
            .map_or(normal, |pair| plan.line_of_pair[pair])
    }
}

/// Whether two normals differ by rounding only. Without this a rigid motion would tear shared lines apart.
fn is_same(a: Vec3, b: Vec3) -> bool {
    (a - b).abs().max_element() <= 1e-6
}
