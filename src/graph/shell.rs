//! The inner shell: a copy of each vertex moved inwards, wherever there is room inside (Zhou et al. 2005).
//!
//! A copy is accepted only where it lies inside, at least half its offset away from the whole surface, and reached from
//! its vertex without crossing the surface; the offset is halved up to six times until that holds. A vertex without
//! such a place has no copy.

use super::Error;
use super::columns::Columns;
use super::parallel::map;
use super::solid::Parts;
use super::winding::WindingTree;
use crate::mesh::{Adjacency, Mesh};
use crate::pool::Pool;
use crate::progress::Progress;
use glam::DVec3;

/// How often the offset may be halved.
const HALVINGS: i32 = 6;

/// For each vertex its copy, or `None`.
pub(super) type Shell = Vec<Option<DVec3>>;

/// What shell and lattice are built from.
pub(super) struct Site<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) adjacency: &'a Adjacency,
    /// The whole surface, for distances and crossings.
    pub(super) surface: &'a WindingTree<'a>,
    pub(super) parts: &'a Parts,
    /// Closed parts and those whose holes have been closed, if there are any.
    pub(super) hull: Option<&'a WindingTree<'a>>,
    /// The same, to be asked what lies inside.
    pub(super) columns: Option<Columns<'a>>,
    /// Soups that enclose space, if there are any.
    pub(super) soup: Option<&'a WindingTree<'a>>,
    pub(super) pool: &'a Pool,
    pub(super) progress: &'a dyn Progress,
}

impl Site<'_> {
    /// The vertex where a walk along the mesh from `start` comes no nearer to `p`.
    pub(super) fn walk(&self, start: u32, p: DVec3) -> u32 {
        let distance = |v: u32| self.mesh.positions[v as usize].distance_squared(p);
        let nearer = |a: u32, b: u32| if distance(b) < distance(a) { b } else { a };
        let mut here = start;
        loop {
            let next = self.adjacency.neighbours.of(here).iter().copied().fold(here, nearer);
            if next == here {
                return here;
            }
            here = next;
        }
    }

    /// Soups that are worth a lattice; beside a hull of many more faces they have a shell only.
    pub(super) fn large_soup(&self) -> Option<&WindingTree<'_>> {
        let faces = |tree: &WindingTree| tree.triangles().len();
        self.soup
            .filter(|soup| self.hull.is_none_or(|hull| faces(soup) >= faces(hull) / 4))
    }

    /// Whether a place lies inside the hull, or inside soups.
    pub(super) fn contains(&self, p: DVec3) -> bool {
        self.columns.as_ref().is_some_and(|columns| columns.contains(p))
            || self.soup.is_some_and(|soup| soup.contains(p))
    }
}

/// Moves each vertex along its `inward` direction by the offset of its part, or by less where there is less room;
/// vertices whose direction is zero have no copy.
pub(super) fn shell(site: &Site, inward: &[DVec3], offsets: &[f64]) -> Result<Shell, Error> {
    let mut placed: Shell = vec![None; site.mesh.positions.len()];
    // In the order of the tree, so that one query finds in the cache what the last one read.
    let mut waiting = site.surface.vertices_in_space();
    waiting.retain(|&v| inward[v as usize] != DVec3::ZERO);
    let found = map(&waiting, site.pool, site.progress, |&v| {
        let at = |by: f64| site.mesh.positions[v as usize] + inward[v as usize] * by;
        let has_room = |by: f64| {
            // Only the half of the way that lies outside the clear ball can meet the surface.
            let half = 0.5 * by;
            !site.surface.is_within(at(by), half) && site.surface.first_hit(at(0.0), at(half), Some(v)).is_none()
        };
        let offset = offsets[site.parts.components.of_vertex[v as usize] as usize];
        let mut by = offset;
        for halving in 0..=HALVINGS {
            if has_room(by) && site.contains(at(by)) {
                return Some(at(by));
            }
            // Where not even the smallest offset leads inside, those between need not be tried.
            let smallest = offset * 0.5f64.powi(HALVINGS);
            if halving == 0 && !site.contains(at(smallest)) {
                return None;
            }
            by *= 0.5;
        }
        None
    })?;
    for (v, copy) in waiting.into_iter().zip(found) {
        placed[v as usize] = copy;
    }
    Ok(placed)
}
