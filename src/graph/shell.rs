//! The inner shell: a copy of each vertex moved inwards, wherever there is room inside (Zhou et al. 2005).
//!
//! A copy is accepted only where it lies inside, at least half its offset away from the whole surface, and reached from
//! its vertex without crossing the surface; the offset is halved up to six times until that holds. A vertex without
//! such a place has no copy.

use super::Error;
use super::parallel::map;
use super::winding::WindingTree;
use crate::mesh::{Adjacency, Components, Mesh};
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
    /// The parts that enclose space, for winding numbers.
    pub(super) solid: &'a WindingTree<'a>,
    /// The winding number of `solid` is a whole number everywhere off its surface, so places that are joined without
    /// crossing the surface lie on the same side of it.
    pub(super) balanced: bool,
    pub(super) pool: &'a Pool,
    pub(super) progress: &'a dyn Progress,
}

/// Moves each vertex along its `inward` direction by `offset`, or by less where there is less room; vertices whose
/// direction is zero have no copy.
pub(super) fn shell(site: &Site, inward: &[DVec3], offset: f64) -> Result<Shell, Error> {
    let vertices = site.mesh.positions.len();
    let mut placed: Shell = vec![None; vertices];
    // In the order of the tree, so that one query finds in the cache what the last one read.
    let mut waiting = site.surface.vertices_in_space();
    waiting.retain(|&v| inward[v as usize] != DVec3::ZERO);
    let at = |v: u32, by: f64| site.mesh.positions[v as usize] + inward[v as usize] * by;
    for halving in 0..=HALVINGS {
        if waiting.is_empty() {
            break;
        }
        let by = offset * 0.5f64.powi(halving);
        let reach = by * 1.001;
        // The room around each moved vertex, 0 where it is too close to the surface or beyond it.
        let room = map(&waiting, site.pool, site.progress, |&v| {
            let p = at(v, by);
            let room = site
                .surface
                .closest_within(p, reach)
                .map_or(reach, |near| near.distance);
            // Only the part of the way that lies outside the clear ball can meet the surface.
            let way = by - room;
            let free = way <= by * 1e-9 || site.surface.first_hit(at(v, 0.0), at(v, way), Some(v)).is_none();
            if room >= 0.5 * by && free { room } else { 0.0 }
        })?;
        let candidates: Vec<(u32, f64)> = waiting
            .iter()
            .zip(&room)
            .filter(|c| *c.1 > 0.0)
            .map(|(&v, &room)| (v, room))
            .collect();
        for ((v, _), inside) in candidates.iter().zip(inside_of(site, &candidates, |v| at(v, by))?) {
            if inside {
                placed[*v as usize] = Some(at(*v, by));
            }
        }
        waiting.retain(|&v| placed[v as usize].is_none());
        if halving == 0 {
            // Where not even the smallest offset leads inside, the halvings between need not be tried.
            let smallest = offset * 0.5f64.powi(HALVINGS);
            let hope = map(&waiting, site.pool, site.progress, |&v| {
                site.solid.contains(at(v, smallest))
            })?;
            let mut hope = hope.into_iter();
            waiting.retain(|_| hope.next() == Some(true));
        }
    }
    Ok(placed)
}

/// Whether each candidate's place lies inside. Around a place there is a ball without surface; on a balanced surface all
/// places in it share an answer, so one is asked per set of mesh neighbours whose balls contain each other.
fn inside_of(site: &Site, candidates: &[(u32, f64)], at: impl Fn(u32) -> DVec3 + Sync) -> Result<Vec<bool>, Error> {
    if !site.balanced {
        return Ok(map(candidates, site.pool, site.progress, |c| {
            site.solid.contains(at(c.0))
        })?);
    }
    let mut place = vec![u32::MAX; site.mesh.positions.len()];
    for (i, c) in (0u32..).zip(candidates) {
        place[c.0 as usize] = i;
    }
    let joined = candidates.iter().zip(0u32..).flat_map(|(&(v, room), i)| {
        let (at, place) = (&at, &place);
        let later = site.adjacency.neighbours.of(v).iter().map(|&w| (w, place[w as usize]));
        let later = later.filter(move |&(_, j)| j != u32::MAX && j > i);
        later
            .filter(move |&(w, j)| at(v).distance(at(w)) < room.max(candidates[j as usize].1))
            .map(move |l| (i, l.1))
    });
    let sets = Components::of_edges(candidates.len(), joined);
    let firsts: Vec<u32> = sets
        .first_vertices()
        .into_iter()
        .map(|i| candidates[i as usize].0)
        .collect();
    let inside = map(&firsts, site.pool, site.progress, |&v| site.solid.contains(at(v)))?;
    Ok(sets.of_vertex.iter().map(|&s| inside[s as usize]).collect())
}
