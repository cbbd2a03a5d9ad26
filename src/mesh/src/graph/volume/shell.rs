//! The inner shell: a copy of each vertex moved inwards, wherever there is room inside (Zhou et al. 2005).
//!
//! A copy is accepted only where it lies inside, at least half its offset away from the whole surface, and reached from
//! its vertex without crossing the surface; the offset is halved up to six times until that holds. A vertex without
//! such a place has no copy. Which way leads inwards from each vertex is found first.

use crate::graph::parallel::{map, map_in_space};
use crate::graph::volume::caps::{FaceColumns, HullFaces};
use crate::graph::volume::lattice_grid::{NearSurface, RoomQueries};
use crate::graph::volume::solid::{ClassifiedParts, InwardDirections, PartKind, normal, sample, turn};
use crate::graph::winding::WindingTree;
use crate::query::{VisitBudget, VisitCount};
use crate::{Adjacency, Error, Mesh};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;

/// How often the offset may be halved.
const HALVINGS: i32 = 6;

/// For each vertex its copy, or `None`.
pub(in crate::graph) type ShellNodes = Vec<Option<DVec3>>;

/// What shell and lattice are built from.
pub(in crate::graph) struct VolumeSite<'a> {
    pub(in crate::graph) mesh: &'a Mesh,
    pub(in crate::graph) adjacency: &'a Adjacency,
    /// The whole surface, for distances and crossings.
    pub(in crate::graph) surface: &'a NearSurface<'a>,
    pub(in crate::graph) parts: &'a ClassifiedParts,
    /// Closed parts and those whose holes have been closed, if there are any.
    pub(in crate::graph) hull: Option<HullFaces<'a>>,
    /// The same, to test what lies inside.
    pub(in crate::graph) inside_hull: &'a InsideHull<'a>,
    /// Soups that enclose space, if there are any.
    pub(in crate::graph) soup: Option<&'a WindingTree<'a>>,
    pub(in crate::graph) exec: &'a Exec<'a>,
    /// What queries may look at in all.
    pub(in crate::graph) budget: &'a VisitBudget<'a>,
    /// What is looked at without asking any structure.
    pub(in crate::graph) looked: &'a VisitCount,
}

/// What decides whether a place is inside a hull.
pub(in crate::graph) enum InsideHull<'a> {
    /// There is no hull.
    Nothing,
    Columns(Box<FaceColumns<'a>>),
    Tree(&'a WindingTree<'a>),
}

impl<'a> InsideHull<'a> {
    /// Sorts the faces of a hull into columns; where these are of no help, the `tree` over the same faces is asked.
    pub(in crate::graph) fn of_faces(
        hull: Option<HullFaces<'a>>,
        tree: impl FnOnce() -> &'a WindingTree<'a>,
        pool: &Pool,
    ) -> Self {
        let Some(hull) = hull else {
            return Self::Nothing;
        };
        match FaceColumns::sort(hull.positions, hull.faces, pool) {
            Some(columns) => Self::Columns(Box::new(columns)),
            None => Self::Tree(tree()),
        }
    }

    /// What long queries of the columns have looked at; a tree counts for itself.
    pub(in crate::graph) fn visits(&self) -> u64 {
        match self {
            Self::Columns(columns) => columns.visits(),
            Self::Nothing | Self::Tree(_) => 0,
        }
    }
}

impl VolumeSite<'_> {
    /// The vertex where a walk along the mesh from `start` comes no nearer to `p`.
    pub(in crate::graph) fn walk(&self, start: u32, p: DVec3) -> u32 {
        walk(&self.mesh.positions, self.adjacency, start, p, self.looked)
    }

    /// Soups that are worth a lattice; beside a hull of many more faces they have a shell only.
    pub(in crate::graph) fn large_soup(&self) -> Option<&WindingTree<'_>> {
        let is_large = |soup: &&WindingTree| {
            let faces = soup.bvh().triangles().len();
            self.hull.is_none_or(|hull| faces >= hull.faces.len() / 4)
        };
        self.soup.filter(is_large)
    }

    /// Lists all vertices, so that those next to each other in the list are close in space, and their columns are the same.
    pub(in crate::graph) fn vertices_in_space_order(&self) -> Vec<u32> {
        let InsideHull::Columns(columns) = self.inside_hull else {
            return self.surface.vertices_in_space_order();
        };
        // A hull may have more vertices than the mesh, or lack some.
        let mut order = columns.vertices_in_space_order();
        let count = self.mesh.positions.len();
        order.retain(|&v| (v as usize) < count);
        if order.len() < count {
            let mut seen = vec![false; count];
            order.iter().for_each(|&v| seen[v as usize] = true);
            order.extend((0..count as u32).filter(|&v| !seen[v as usize]));
        }
        order
    }

    /// Whether a place lies inside the hull, or inside soups.
    pub(in crate::graph) fn contains(&self, p: DVec3) -> bool {
        let in_hull = match self.inside_hull {
            InsideHull::Nothing => false,
            InsideHull::Columns(columns) => columns.contains(p),
            InsideHull::Tree(tree) => tree.contains(p),
        };
        in_hull || self.soup.is_some_and(|soup| soup.contains(p))
    }
}

/// The unit vector that leads inwards from each vertex; zero where the vertex has no normal, and on parts that
/// enclose nothing; `order` has all vertices in the order in which they are best looked at. Normals of a part that is wound
/// inside out are turned round. With it for each part 1, −1 when its normals were turned, or 0 when it has no inside.
pub(in crate::graph) fn inward_directions(
    site: &VolumeSite,
    order: &[u32],
    step: f64,
) -> Result<(InwardDirections, Vec<f64>), Error> {
    let VolumeSite { parts, budget, .. } = *site;
    let (positions, triangles) = (&site.mesh.positions, &site.mesh.triangles);
    let found = map(order, budget, |&v| {
        if parts.kind(v) != PartKind::Sheet {
            -normal(positions, triangles, site.adjacency, v)
        } else {
            DVec3::ZERO
        }
    })?;
    let mut inward = vec![DVec3::ZERO; positions.len()];
    order.iter().zip(found).for_each(|(&v, d)| inward[v as usize] = d);
    let part = |v: u32| parts.components.of_vertex[v as usize] as usize;
    let candidates = (0..positions.len() as u32)
        .filter(|&v| inward[v as usize] != DVec3::ZERO)
        .collect();
    let asked = sample(candidates, parts.kinds.len(), part);
    let space = || order.to_vec();
    let sides = map_in_space(&asked, space, budget, |&v| {
        let (p, d) = (positions[v as usize], inward[v as usize] * step);
        (site.contains(p + d), site.contains(p - d))
    })?;
    let mut votes = vec![(0usize, 0usize); parts.kinds.len()];
    for (&v, (ahead, behind)) in asked.iter().zip(sides) {
        let vote = &mut votes[part(v)];
        vote.0 += usize::from(ahead);
        vote.1 += usize::from(behind);
    }
    let turns: Vec<f64> = votes.into_iter().map(|(ahead, behind)| turn(ahead, behind)).collect();
    for (d, v) in inward.iter_mut().zip(0u32..) {
        let turn = turns[part(v)];
        if turn <= 0.0 {
            *d = if turn < 0.0 { -*d } else { DVec3::ZERO };
        }
    }
    Ok((inward, turns))
}

/// Moves each vertex along its `inward` direction by the offset of its part, or by less where there is less room;
/// vertices whose direction is zero have no copy. `order` has all vertices in the order in which they are best looked at.
pub(in crate::graph) fn shell(
    site: &VolumeSite,
    order: Vec<u32>,
    inward: &[DVec3],
    offsets: &[f64],
) -> Result<ShellNodes, Error> {
    let mut placed: ShellNodes = vec![None; site.mesh.positions.len()];
    // In the order of space, so that one query finds in the cache what the last one read.
    let mut waiting = order;
    waiting.retain(|&v| inward[v as usize] != DVec3::ZERO);
    let found = map(&waiting, site.budget, |&v| {
        let offset = offsets[site.parts.components.of_vertex[v as usize] as usize];
        let p = site.mesh.positions[v as usize];
        copy(site.surface, v, p, inward[v as usize], offset, |p| site.contains(p))
    })?;
    for (v, copy) in waiting.into_iter().zip(found) {
        placed[v as usize] = copy;
    }
    Ok(placed)
}

/// Where the copy of vertex `v`, at `p`, is put: `offset` along `inward`, or less where there is less room.
pub(in crate::graph) fn copy(
    surface: &impl RoomQueries,
    v: u32,
    p: DVec3,
    inward: DVec3,
    offset: f64,
    contains: impl Fn(DVec3) -> bool,
) -> Option<DVec3> {
    let at = |by: f64| p + inward * by;
    let mut by = offset;
    for halving in 0..=HALVINGS {
        if has_room(surface, v, at(0.0), at(0.5 * by), at(by), 0.5 * by) && contains(at(by)) {
            return Some(at(by));
        }
        // Where not even the smallest offset leads inside, those between need not be tried.
        let smallest = offset * 0.5f64.powi(HALVINGS);
        if halving == 0 && !contains(at(smallest)) {
            return None;
        }
        by *= 0.5;
    }
    None
}

/// Whether no face is nearer to `end` than `half`, and none but those around vertex `v` crosses the way from `start` to
/// `middle`; only this half of the way, outside the clear ball, can meet the surface.
pub(in crate::graph) fn has_room(
    surface: &impl RoomQueries,
    v: u32,
    start: DVec3,
    middle: DVec3,
    end: DVec3,
    half: f64,
) -> bool {
    !surface.has_face_within(end, half) && !surface.is_way_crossed(start, middle, Some(v))
}

/// The vertex where a walk along the mesh from `start` comes no nearer to `p`.
pub(in crate::graph) fn walk(
    positions: &[DVec3],
    adjacency: &Adjacency,
    start: u32,
    p: DVec3,
    looked: &VisitCount,
) -> u32 {
    let distance = |v: u32| positions[v as usize].distance_squared(p);
    let nearer = |a: u32, b: u32| if distance(b) < distance(a) { b } else { a };
    let mut here = start;
    loop {
        let around = adjacency.neighbours.of(here);
        looked.add(around.len() as u64);
        let next = around.iter().copied().fold(here, nearer);
        if next == here {
            return here;
        }
        here = next;
    }
}
