//! Which connected parts of a mesh enclose space, and which way leads in.
//!
//! The winding number jumps by one across a face. Across a closed surface it jumps between whole numbers; across a
//! sheet in empty space between −½ and ½; a surface with holes lies between the two. A part whose faces see values
//! nearer to a half than to a whole number is a sheet: it encloses nothing, and it is left out when other parts are
//! asked what they enclose.

use crate::graph::error::Error;
use crate::graph::parallel::{map, map_in_space};
use crate::graph::volume::angle::upper_angle;
use crate::graph::volume::caps::ClosedHull;
use crate::graph::volume::near_surface::NearSurface;
use crate::graph::winding::tree::WindingTree;
use crate::mesh::query::VisitBudget;
use crate::mesh::{Adjacency, Components, Mesh};
use glam::DVec3;

/// Places of each part that are looked at.
const SAMPLES: usize = 32;
/// A part is a sheet when the winding number beside its faces is on average further than this from a whole number.
/// Measured: 0.47 to 0.50 for sheets, 0.26 for a car body without floor, under 0.07 for scans with holes.
pub(in crate::graph) const OPEN: f64 = 0.35;
/// One edge in so many without its match makes a soup.
pub(in crate::graph) const SOUP: usize = 4;
/// And so does one in so many edges around holes that lie inside.
const LOST: usize = 4;
/// Across a hole the winding number lies half-way between whole numbers; where it is nearer to one than this, there is no
/// hole.
const WHOLE: f64 = 0.15;

/// A unit vector for each vertex that has one.
pub(in crate::graph) type InwardDirections = Vec<DVec3>;

/// What a part encloses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::graph) enum PartKind {
    /// Space, exactly: each edge is passed equally often both ways, so its winding number is whole off its surface.
    Closed,
    /// Space, with holes that faces can close.
    Holed,
    /// Space, with so many holes that only its winding number shows what is inside.
    Soup,
    /// Nothing.
    Sheet,
}

/// The connected parts of a mesh, and what each encloses.
pub(in crate::graph) struct ClassifiedParts {
    pub(in crate::graph) components: Components,
    pub(in crate::graph) kinds: Vec<PartKind>,
}

impl ClassifiedParts {
    /// Separates solids from sheets. `step` is a small length beside an edge.
    pub(in crate::graph) fn sort(
        mesh: &Mesh,
        adjacency: &Adjacency,
        surface: &NearSurface,
        step: f64,
        budget: &VisitBudget<'_>,
    ) -> Result<Self, Error> {
        let components = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
        let mut kinds = vec![PartKind::Closed; components.count];
        // All edges of a part, and those that are not passed equally often both ways.
        let mut edges = vec![(0usize, 0usize); components.count];
        for e in &adjacency.edges {
            let part = components.of_vertex[e.vertices[0] as usize] as usize;
            edges[part].0 += 1;
            if e.forward != e.backward {
                edges[part].1 += 1;
                kinds[part] = PartKind::Sheet;
            }
        }
        if kinds.contains(&PartKind::Sheet) {
            let part = |t: u32| components.of_vertex[mesh.triangles[t as usize][0] as usize] as usize;
            let faces = (0..mesh.triangles.len() as u32)
                .filter(|&t| kinds[part(t)] == PartKind::Sheet)
                .collect();
            let looked_at = sample(faces, components.count, part);
            let tree = surface.tree();
            let space = || tree.bvh().triangle_order().to_vec();
            let open = map_in_space(&looked_at, space, budget, |&t| {
                let [a, b, c] = mesh.triangles[t as usize].map(|v| mesh.positions[v as usize]);
                let beside = (b - a).cross(c - a).try_normalize()? * step;
                let winding = tree.rough_winding_number((a + b + c) / 3.0 - beside);
                Some((winding - winding.round()).abs())
            })?;
            let mut seen = vec![(0.0, 0.0); components.count];
            for (&t, open) in looked_at.iter().zip(open).filter_map(|(t, o)| Some((t, o?))) {
                let s: &mut (f64, f64) = &mut seen[part(t)];
                *s = (s.0 + open, s.1 + 1.0);
            }
            for ((kind, (sum, count)), (all, open)) in kinds.iter_mut().zip(seen).zip(edges) {
                if count > 0.0 && sum <= OPEN * count {
                    *kind = if open * SOUP > all {
                        PartKind::Soup
                    } else {
                        PartKind::Holed
                    };
                }
            }
        }
        Ok(Self { components, kinds })
    }

    /// What the part of a vertex encloses.
    pub(in crate::graph) fn kind(&self, vertex: u32) -> PartKind {
        self.kinds[self.components.of_vertex[vertex as usize] as usize]
    }

    /// Whether all parts are of one kind.
    pub(in crate::graph) fn all(&self, kind: PartKind) -> bool {
        self.kinds.iter().all(|&k| k == kind)
    }

    /// Whether rows can be followed through the part of a vertex: it is closed, or closed by faces over its holes.
    pub(in crate::graph) fn is_hull(&self, vertex: u32) -> bool {
        matches!(self.kind(vertex), PartKind::Closed | PartKind::Holed)
    }

    /// Closed and holed parts with their holes closed; `None` when there are none, or when all parts are closed.
    pub(in crate::graph) fn hull(&self, mesh: &Mesh, adjacency: &Adjacency) -> Option<ClosedHull> {
        let some = self
            .kinds
            .iter()
            .any(|k| matches!(k, PartKind::Closed | PartKind::Holed));
        let wanted = |v: u32| self.is_hull(v);
        (some && !self.all(PartKind::Closed))
            .then(|| ClosedHull::close(&mesh.positions, &mesh.triangles, adjacency, wanted))
    }

    /// The faces of soups; `None` when there are none, or when all parts are.
    pub(in crate::graph) fn soup(&self, mesh: &Mesh) -> Option<Vec<[u32; 3]>> {
        let mixed = self.kinds.contains(&PartKind::Soup) && !self.all(PartKind::Soup);
        let faces = mesh.triangles.iter().copied();
        mixed.then(|| faces.filter(|t| self.kind(t[0]) == PartKind::Soup).collect())
    }

    /// Takes holed parts for soups where closing their holes cuts through what the winding number counts as inside, as it
    /// does where cracks part a surface into patches. Whether any was found.
    pub(in crate::graph) fn doubt(
        &mut self,
        tree: &WindingTree,
        hull: &ClosedHull,
        budget: &VisitBudget<'_>,
    ) -> Result<bool, Error> {
        let within = map(&hull.loops, budget, |l| {
            let winding = tree.winding_number(l.2).abs();
            winding > 0.5 && (winding - winding.round()).abs() < WHOLE
        })?;
        // By part: edges of all loops, and of those that run around the inside.
        let mut edges = vec![(0usize, 0usize); self.kinds.len()];
        for (&(vertex, length, _), within) in hull.loops.iter().zip(within) {
            let part = &mut edges[self.components.of_vertex[vertex as usize] as usize];
            part.0 += length;
            part.1 += if within { length } else { 0 };
        }
        let mut found = false;
        for (kind, (all, within)) in self.kinds.iter_mut().zip(edges) {
            if within * LOST > all {
                *kind = PartKind::Soup;
                found = true;
            }
        }
        Ok(found)
    }
}

/// From how many places ahead of and behind a part's vertices lie inside to how its normals are to be taken: 1, −1 turned
/// round, 0 not at all.
pub(in crate::graph) fn turn((ahead, behind): (usize, usize)) -> f64 {
    match (ahead, behind) {
        (0, 0) => 0.0,
        _ if behind > ahead => -1.0,
        _ => 1.0,
    }
}

/// At most about [`SAMPLES`] members of each part, evenly spread over `members`.
pub(in crate::graph) fn sample(members: Vec<u32>, parts: usize, part: impl Fn(u32) -> usize) -> Vec<u32> {
    let mut size = vec![0usize; parts];
    members.iter().for_each(|&m| size[part(m)] += 1);
    let mut seen = vec![0usize; parts];
    let mut chosen = members;
    chosen.retain(|&m| {
        let part = part(m);
        seen[part] += 1;
        (seen[part] - 1).is_multiple_of(size[part].div_ceil(SAMPLES))
    });
    chosen
}

/// Unit normal of a vertex: face normals weighted by the angle at the vertex; zero where they cancel.
pub(in crate::graph) fn normal(positions: &[DVec3], triangles: &[[u32; 3]], adjacency: &Adjacency, v: u32) -> DVec3 {
    let p = positions[v as usize];
    let mut sum = DVec3::ZERO;
    for &f in adjacency.faces.of(v) {
        let t = triangles[f as usize];
        // Which corner it is comes at random, so this is no branch.
        let first = 2 * usize::from(t[2] == v) + usize::from(t[1] == v);
        let [a, b] = [1, 2].map(|k| positions[t[(first + k) % 3] as usize] - p);
        let cross = a.cross(b);
        let twice_area = cross.length();
        if twice_area > 0.0 {
            sum += cross / twice_area * upper_angle(twice_area, a.dot(b));
        }
    }
    if sum.length() > 1e-9 {
        sum.normalize()
    } else {
        DVec3::ZERO
    }
}
