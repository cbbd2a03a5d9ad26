//! Layers: which side of each other parts of a surface lie on in the rest pose, so that what is outside stays outside: a sleeve on an
//! arm, a skirt, armour, a cap of hair.
//!
//! Normals of two parts that face each other say by themselves where each belongs. Those of a layer and of what it lies on are alike; so
//! each vertex remembers the nearest place of up to [`MOST_BESIDE`] other parts, and whether it was before or behind it.

use super::normals::smooth_normals;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::query::TriangleBvh;
use pliant_mesh::query::closest_point::closest_weights_on_triangle;
use pliant_mesh::{Adjacency, Mesh, NONE, sorted_set};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Parts that a vertex remembers at most.
const MOST_BESIDE: usize = 3;
/// How far off the other part may be, of the diagonal of the model.
const NEAR: f64 = 0.06;
/// A part beside a vertex rather than before or behind it has no side: cosine between its normal and the way there.
const LEAST_COSINE: f64 = 0.25;
/// In a pose a vertex is looked for within this many of its gaps of the place that it was nearest to, in the rest pose,
const REACH_GAPS: f64 = 4.0;
/// and this many median edges more.
const REACH_EDGES: f64 = 3.0;
/// In a pose a vertex is on the wrong side when it is further behind than this, median edges; what is less deep shows by what crosses.
const BEHIND: f64 = 0.1;
/// Vertices of a part that are asked, at most, on which side of another part it lies.
const MOST_ASKED: usize = 1000;
/// Vertices between two looks at whether the work is still wanted.
const BLOCK: usize = 1 << 13;

/// Another part that was near a vertex.
#[derive(Debug, Clone, Copy)]
struct BesidePart {
    part: u32,
    /// 1 before its surface, -1 behind.
    side: f64,
    /// How far off it was.
    gap: f64,
    /// Its nearest triangle, or [`NONE`] where any of the part will do.
    triangle: u32,
    /// The nearest place on it.
    place: DVec3,
}

/// The sides of vertices beside other parts of the surface. Without any, parts are kept apart by their normals alone.
#[derive(Debug, Clone, Default)]
pub struct LayerSides {
    /// By vertex; empty where there is one part alone.
    part: Vec<u32>,
    beside: Vec<Vec<BesidePart>>,
    /// By triangle: whether it may cross other parts. Empty: none may.
    may_cross: Vec<bool>,
    /// The median edge of the rest pose.
    edge: f64,
    /// How far a vertex may be on the wrong side.
    behind: f64,
}

/// A vertex that is not where it belongs.
#[derive(Debug, Clone, Copy)]
pub(super) struct MisplacedVertex {
    pub vertex: u32,
    /// The nearest triangle of the other part.
    pub triangle: u32,
    /// Whether it is on the wrong side of it, not only nearer than it may be.
    pub is_behind: bool,
}

impl LayerSides {
    /// Looks at a surface in its rest pose; `part` says of which part each vertex is.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn at_rest(mesh: &Mesh, part: Vec<u32>, exec: &Exec<'_>) -> Result<Self, Cancelled> {
        Self::of_vertices(0, mesh, part, exec)
    }

    /// As [`LayerSides::at_rest`], of the vertices from `first` on alone, an outfit on what comes before; the nearest part may be as far
    /// off as it likes then.
    pub(super) fn of_vertices(first: usize, mesh: &Mesh, part: Vec<u32>, exec: &Exec<'_>) -> Result<Self, Cancelled> {
        let Mesh {
            positions, triangles, ..
        } = mesh;
        if part.iter().all(|p| *p == part[0]) {
            return Ok(Self::default());
        }
        let surface = PartedSurface::of(mesh, positions, &part, exec);
        let near = NEAR * mesh.bounds().diagonal();
        let reach = if first > 0 { [f64::INFINITY, near] } else { [near; 2] };
        let borders = border_vertices(positions.len(), triangles);
        let mut beside = vec![Vec::new(); first];
        for begin in (first..positions.len()).step_by(BLOCK) {
            exec.check()?;
            let block = begin..(begin + BLOCK).min(positions.len());
            let found: Vec<Vec<BesidePart>> = exec.pool.install(|| {
                let all = block.into_par_iter().with_min_len(64);
                all.map(|v| surface.beside(v, reach, &borders)).collect()
            });
            beside.extend(found);
        }
        let edge = mesh.median_edge();
        Ok(Self {
            beside,
            may_cross: Vec::new(),
            edge,
            behind: BEHIND * edge,
            part,
        })
    }

    /// Where triangles of two parts cross, puts all vertices of a part on the side of the other on which most of them are.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub(super) fn of_most(mut self, mesh: &Mesh, crossings: &[[u32; 2]], exec: &Exec<'_>) -> Result<Self, Cancelled> {
        if self.is_empty() {
            return Ok(self);
        }
        let parts = crossings
            .iter()
            .map(|pair| pair.map(|t| self.part[mesh.triangles[t as usize][0] as usize]));
        let both = parts.filter(|[a, b]| a != b).flat_map(|[a, b]| [[a, b], [b, a]]);
        let both = sorted_set(both);
        let mut vertices: BTreeMap<u32, Vec<u32>> = both.iter().map(|[own, _]| (*own, Vec::new())).collect();
        for (v, part) in (0..).zip(&self.part) {
            if let Some(of) = vertices.get_mut(part) {
                of.push(v);
            }
        }
        let surface = PartedSurface::of(mesh, &mesh.positions, &self.part, exec);
        let borders = border_vertices(mesh.positions.len(), &mesh.triangles);
        let mut sides = BTreeMap::new();
        for [own, other] in both {
            exec.check()?;
            let all = &vertices[&own];
            let asked = all.iter().step_by(all.len().div_ceil(MOST_ASKED));
            let sum: f64 = asked.filter_map(|v| surface.side_of_part(*v, other, &borders)).sum();
            if sum != 0.0 {
                sides.insert([own, other], sum.signum());
            }
        }
        for (own, part) in self.beside.iter_mut().zip(&self.part) {
            for one in own {
                match sides.get(&[*part, one.part]) {
                    Some(side) if *side != one.side => (one.side, one.gap) = (*side, one.gap.max(self.behind)),
                    _ => {}
                }
            }
        }
        Ok(self)
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        let beside: usize = self.beside.iter().map(Vec::capacity).sum();
        self.part.capacity() * size_of::<u32>()
            + self.beside.capacity() * size_of::<Vec<BesidePart>>()
            + beside * size_of::<BesidePart>()
            + self.may_cross.capacity()
    }

    /// Whether there are none.
    pub(super) fn is_empty(&self) -> bool {
        self.beside.is_empty()
    }

    /// The side of a vertex beside a part: 1 before it, -1 behind it, `None` where that is not known.
    pub(super) fn side(&self, vertex: usize, part: u32) -> Option<f64> {
        let found = self.beside.get(vertex)?.iter().find(|beside| beside.part == part);
        found.map(|beside| beside.side)
    }

    /// Whether two triangles are of different parts and one of them may cross these.
    pub(super) fn allows(&self, triangles: &[[u32; 3]], pair: [u32; 2]) -> bool {
        let may = |t: u32| self.may_cross.get(t as usize).copied().unwrap_or(false);
        let of = |t: u32| self.part[triangles[t as usize][0] as usize];
        !self.may_cross.is_empty() && of(pair[0]) != of(pair[1]) && pair.iter().any(|t| may(*t))
    }

    /// The sides of two vertices of different parts, each beside the other one's part; 0 where it is not known. `None` where neither is.
    pub(super) fn sides(&self, own: u32, other: u32) -> Option<[f64; 2]> {
        let part = |v: u32| self.part.get(v as usize).copied();
        if part(own)? == part(other)? {
            return None;
        }
        let side = |v: u32, of: u32| self.side(v as usize, self.part[of as usize]).unwrap_or(0.0);
        let sides = [side(own, other), side(other, own)];
        (sides != [0.0; 2]).then_some(sides)
    }

    /// How far a vertex was from another one's part.
    pub(super) fn gap(&self, own: u32, other: u32) -> Option<f64> {
        let part = self.part.get(other as usize)?;
        let found = self.beside[own as usize].iter().find(|beside| beside.part == *part);
        found.map(|beside| beside.gap)
    }

    /// Vertices that are nearer than they may be to where they were, or on its wrong side, by vertex. A vertex may be as near as
    /// `least`, or as in the rest pose. With `is_asked`, corners of those faces alone.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub(super) fn misplaced(
        &self,
        mesh: &Mesh,
        at: &[DVec3],
        is_asked: Option<&[bool]>,
        least: f64,
        exec: &Exec<'_>,
    ) -> Result<Vec<MisplacedVertex>, Cancelled> {
        if self.is_empty() {
            return Ok(Vec::new());
        }
        let mut asked = vec![is_asked.is_none(); self.beside.len()];
        for (t, _) in is_asked.into_iter().flatten().enumerate().filter(|(_, asked)| **asked) {
            mesh.triangles[t].iter().for_each(|v| asked[*v as usize] = true);
        }
        let surface = PartedSurface::of(mesh, at, &self.part, exec);
        let mut all = Vec::new();
        for first in (0..self.beside.len()).step_by(BLOCK) {
            exec.check()?;
            let block = first..(first + BLOCK).min(self.beside.len());
            let of = |v: usize| {
                let each = self.beside[v].iter().filter(|_| asked[v]);
                each.filter_map(|beside| self.misplaced_beside(v, beside, mesh, least, &surface))
                    .collect()
            };
            let found: Vec<Vec<MisplacedVertex>> =
                (exec.pool).install(|| block.into_par_iter().with_min_len(64).map(of).collect());
            all.extend(found.into_iter().flatten());
        }
        Ok(all)
    }

    fn misplaced_beside(
        &self,
        v: usize,
        beside: &BesidePart,
        mesh: &Mesh,
        least: f64,
        surface: &PartedSurface<'_>,
    ) -> Option<MisplacedVertex> {
        let point = surface.positions[v];
        let reach = REACH_GAPS * beside.gap + REACH_EDGES * self.edge;
        let least = least.min(beside.gap);
        if beside.triangle != NONE {
            // Most are where they were.
            let on = surface.distance(point, beside.triangle);
            if beside.side * on.1 > 0.5 * on.0.distance(point) && on.0.distance(point) > 0.5 * reach {
                return None;
            }
        }
        let is_near = |t: u32| {
            surface.part_of(t) == beside.part
                && (beside.triangle == NONE || {
                    let corners = mesh.triangles[t as usize].map(|v| mesh.positions[v as usize]);
                    corners.iter().any(|c| c.distance(beside.place) < reach)
                })
        };
        let within = if beside.triangle == NONE {
            f64::INFINITY
        } else {
            2.0 * reach
        };
        let may_be = |node: usize| surface.of_node[node].is_none_or(|part| part == beside.part);
        let found = surface.tree.closest_point_below(point, within, &may_be, &is_near)?;
        let (place, along) = surface.distance(point, found.triangle);
        let far = place.distance(point);
        let distance = beside.side * along.signum() * far;
        (distance < least).then_some(MisplacedVertex {
            vertex: v as u32,
            triangle: found.triangle,
            is_behind: distance < -self.behind,
        })
    }

    /// Those of an outfit on a body, the first part, when another body that is `scale` times as large takes its place: there are `was`
    /// vertices and triangles of the one, `now` of the other. Triangles of the outfit that `crossed` the one may cross the other.
    pub(super) fn on_other_body(mut self, was: [usize; 2], now: [usize; 2], scale: f64, crossed: &[bool]) -> Self {
        let body = self.part.first().copied().unwrap_or_default();
        let shift = |t: u32| t - was[1] as u32 + now[1] as u32;
        let mut beside = vec![Vec::new(); now[0]];
        for mut own in self.beside.split_off(was[0].min(self.beside.len())) {
            for one in &mut own {
                one.gap *= scale;
                one.place *= scale;
                one.triangle = match one.part == body {
                    true => NONE,
                    false => shift(one.triangle),
                };
            }
            beside.push(own);
        }
        let mut part = vec![body; now[0]];
        part.extend(self.part.split_off(was[0].min(self.part.len())));
        let mut may_cross = vec![false; now[1]];
        may_cross.extend(crossed);
        Self {
            part,
            beside,
            may_cross,
            edge: self.edge * scale,
            behind: 0.0,
        }
    }
}

/// A surface of several parts, to be asked for what is near.
struct PartedSurface<'a> {
    positions: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    part: &'a [u32],
    normals: Vec<DVec3>,
    tree: TriangleBvh<'a>,
    /// By node of the tree, the part that all below are of.
    of_node: Vec<Option<u32>>,
}

impl<'a> PartedSurface<'a> {
    fn of(mesh: &'a Mesh, positions: &'a [DVec3], part: &'a [u32], exec: &Exec<'_>) -> Self {
        let triangles = &mesh.triangles;
        let normals = smooth_normals(mesh, positions, 0);
        let tree = TriangleBvh::build(positions, triangles, exec.pool);
        let of_node = tree.fold_nodes(
            |t| Some(part[triangles[t as usize][0] as usize]),
            |a, b| if a == b { a } else { None },
        );
        Self {
            positions,
            triangles,
            part,
            normals,
            tree,
            of_node,
        }
    }

    fn part_of(&self, t: u32) -> u32 {
        self.part[self.triangles[t as usize][0] as usize]
    }

    /// The nearest place of a triangle, and how far a point is from it along the normal there.
    fn distance(&self, point: DVec3, t: u32) -> (DVec3, f64) {
        let corners = self.triangles[t as usize];
        let (weights, _) = closest_weights_on_triangle(point, corners.map(|v| self.positions[v as usize]));
        let sum = |all: &[DVec3]| (0..3).map(|k| all[corners[k] as usize] * weights[k]).sum::<DVec3>();
        let place = sum(self.positions);
        (place, (point - place).dot(sum(&self.normals).normalize_or_zero()))
    }

    /// Other parts near a vertex, the nearest first: it within the first reach, others within the second.
    fn beside(&self, v: usize, reach: [f64; 2], borders: &[bool]) -> Vec<BesidePart> {
        let point = self.positions[v];
        let mut seen = vec![self.part[v]];
        let mut all = Vec::new();
        for k in 0..MOST_BESIDE {
            let reach = reach[k.min(1)];
            let is_other = |t: u32| !seen.contains(&self.part_of(t));
            let may_be = |node: usize| self.of_node[node].is_none_or(|part| !seen.contains(&part));
            let Some(found) = self.tree.closest_point_below(point, reach, &may_be, &is_other) else {
                break;
            };
            let part = self.part_of(found.triangle);
            seen.push(part);
            all.extend(self.beside_triangle(point, found.triangle, borders));
        }
        all
    }

    /// The side of a vertex beside a part, however far off, if it has one.
    fn side_of_part(&self, v: u32, part: u32, borders: &[bool]) -> Option<f64> {
        let point = self.positions[v as usize];
        let may_be = |node: usize| self.of_node[node].is_none_or(|of| of == part);
        let found = (self.tree).closest_point_below(point, f64::INFINITY, &may_be, &|t| self.part_of(t) == part)?;
        Some(self.beside_triangle(point, found.triangle, borders)?.side)
    }

    /// A point beside the triangle of another part that is nearest to it; `None` where it is neither before nor behind it.
    fn beside_triangle(&self, point: DVec3, triangle: u32, borders: &[bool]) -> Option<BesidePart> {
        let (place, along) = self.distance(point, triangle);
        let gap = place.distance(point);
        let corners = self.triangles[triangle as usize];
        let (weights, _) = closest_weights_on_triangle(point, corners.map(|v| self.positions[v as usize]));
        let on_border =
            (0..3).all(|k| weights[k] < 1e-6 || borders[corners[k] as usize]) && weights.iter().any(|w| *w < 1e-6);
        (!on_border && along.abs() > LEAST_COSINE * gap).then_some(BesidePart {
            part: self.part_of(triangle),
            side: along.signum(),
            gap,
            triangle,
            place,
        })
    }
}

/// By vertex: whether it is on the border of the surface.
fn border_vertices(vertices: usize, triangles: &[[u32; 3]]) -> Vec<bool> {
    let mut borders = vec![false; vertices];
    for edge in &Adjacency::build(vertices, triangles).edges {
        if edge.faces() == 1 {
            edge.vertices.iter().for_each(|v| borders[*v as usize] = true);
        }
    }
    borders
}
