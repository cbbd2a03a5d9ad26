//! Surfaces that a pose has pushed through each other, moved apart.
//!
//! Where triangles cross that did not in the rest pose, each pair becomes a condition on the vertices around it ([`find`]): a vertex
//! lies before a face, or an edge beside an edge, by the clearance, along the bisector of the two sides' normals. The surface around
//! ([`region`]) is displaced as smoothly as these allow ([`displace`]), half of each on either side, all on one where handles hold the
//! other. The result is looked at, conditions that have come up are added, and so on. What handles hold stays. No pose is solved again.
//!
//! The outsides of the two surfaces say where each of them belongs. Places so crumpled that faces cross others of the same direction are
//! flattened instead.

mod displace;
mod find;
mod layers;
mod outfit;
mod region;

use crate::surface_faults::most_overlaps;
use displace::DisplacementProblem;
use find::{ContactFinder, Knowledge, PartingStyle, smooth_normals};
use glam::DVec3;
pub use layers::LayerSides;
use layers::MisplacedVertex;
pub use outfit::{FittedOutfit, OutfitFaults, OutfitOnBody};
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::{Mesh, is_crossing, visit_crossings_within};
use region::ContactRegion;
use std::sync::{Mutex, PoisonError};

/// The clearance where none is given, median edges around what crosses.
const CLEARANCE: f64 = 0.1;
/// Pairs that are worked on; a shape with more of them has collapsed, and stays as it is.
const MOST_PAIRS: usize = 20_000;
/// With so many times the pairs of the beginning a style is given up.
const LOST: usize = 4;
/// What parting may change lengths of edges by, on the mean, whatever the pose does.
const LEAST_STRAIN: f64 = 0.02;
/// Rounds of one style.
const ROUNDS: usize = 20;
/// How surfaces are parted, one after the other until nothing crosses. Each goes on from the best shape of those before.
const STYLES: [PartingStyle; 3] = [
    PartingStyle {
        smoothing: 1,
        facing: 0.7,
        flatten: 0.3,
        bending: 0.5,
        stiffness: 3.0,
    },
    PartingStyle {
        smoothing: 3,
        facing: 0.5,
        flatten: 0.3,
        bending: 0.5,
        stiffness: 1.0,
    },
    PartingStyle {
        smoothing: 6,
        facing: 0.5,
        flatten: 0.1,
        bending: 0.5,
        stiffness: 1.0,
    },
];

/// A surface that handles hold in part.
pub struct ContactSurface<'a> {
    /// In the rest pose.
    pub mesh: &'a Mesh,
    /// By graph node, those of the surface first: whether it stays.
    pub held: &'a [bool],
    /// What surfaces keep from each other, model units; `None`: [`CLEARANCE`] of the median edge around what crosses.
    pub clearance: Option<f64>,
    /// Which of its parts lie on which.
    pub layers: &'a LayerSides,
}

/// What is wrong with a shape.
struct ContactFaults {
    /// Pairs of faces that cross.
    crossings: Vec<[u32; 2]>,
    /// Vertices that are nearer to another part than they may be.
    misplaced: Vec<MisplacedVertex>,
}

impl ContactFaults {
    /// How many there are: what is near, but on its side, is none.
    fn count(&self) -> usize {
        self.crossings.len() + self.behind().count()
    }

    fn behind(&self) -> impl Iterator<Item = &MisplacedVertex> {
        self.misplaced.iter().filter(|v| v.is_behind)
    }

    /// Faces around all of them, two by two.
    fn places(&self, mesh: &Mesh) -> Vec<[u32; 2]> {
        let mut own = vec![0; mesh.positions.len()];
        for (t, corners) in (0..).zip(&mesh.triangles) {
            corners.iter().for_each(|v| own[*v as usize] = t);
        }
        let behind = self.behind().map(|v| [own[v.vertex as usize], v.triangle]);
        self.crossings.iter().copied().chain(behind).collect()
    }
}

impl ContactSurface<'_> {
    /// Moves vertices among `positions` (of all graph nodes, those of the surface first) so that fewer pairs of triangles cross that do
    /// not in the rest pose, pairs that are held apart. Where it cannot, they keep their bits.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn part(&self, positions: &mut [DVec3], exec: &Exec<'_>) -> Result<(), Cancelled> {
        let vertices = self.mesh.positions.len();
        let base = &positions[..vertices];
        let before = match self.faults(base, None, 0.0, exec)? {
            Some(before) if (1..=MOST_PAIRS).contains(&before.count()) => before,
            _ => return Ok(()),
        };
        let region = ContactRegion::around(self.mesh, &self.held[..vertices], &before.places(self.mesh));
        let before = before.count();
        let clearance = self.clearance.unwrap_or(CLEARANCE * region.edge);
        let rest_bend = rest_bend(self.mesh);
        let strain = self.strain(base);
        // The more pairs are parted, the more lengths of edges may change: up to twice as far as before, on the mean, and some beside
        // that where the pose itself changes none.
        let is_worth = |left: usize, at: &[DVec3]| {
            let parted = 1.0 - left as f64 / before as f64;
            self.strain(at) <= strain + parted * parted * strain.max(LEAST_STRAIN)
        };
        let mut best = (before, vec![DVec3::ZERO; region.free], Knowledge::default());
        let by_normals = LayerSides::default();
        // Where layers lie in a crease that has no room for them, what the normals alone say may be better.
        let kinds = if self.layers.is_empty() { 1 } else { 2 };
        for layers in [self.layers, &by_normals].into_iter().take(kinds) {
            let mut own = (before, vec![DVec3::ZERO; region.free], Knowledge::default());
            for style in STYLES {
                if own.0 == 0 {
                    break;
                }
                let mut at = displaced(base, &region, &own.1);
                let mut finder = ContactFinder {
                    normals: smooth_normals(self.mesh, &at, style.smoothing),
                    knowledge: own.2.clone(),
                    mesh: self.mesh,
                    region: &region,
                    layers,
                    style,
                    clearance,
                };
                let mut moved = own.1.clone();
                let Some(mut faults) = self.faults(&at, Some(&region.is_near), clearance, exec)? else {
                    break;
                };
                for _ in 0..ROUNDS {
                    exec.check()?;
                    finder.look(&at, &faults.crossings, &faults.misplaced);
                    DisplacementProblem::new(&finder, base, &rest_bend).improve(&mut moved, exec)?;
                    at = displaced(base, &region, &moved);
                    faults = match self.faults(&at, Some(&region.is_near), clearance, exec)? {
                        Some(faults) => faults,
                        None => break,
                    };
                    let left = faults.count();
                    if left < own.0 && is_worth(left, &at) {
                        own = (left, moved.clone(), finder.knowledge.clone());
                    }
                    if own.0 == 0 || left > LOST * before {
                        break;
                    }
                }
            }
            if own.0 < best.0 {
                best = own;
            }
            if best.0 == 0 {
                break;
            }
        }
        let parted = displaced(base, &region, &best.1);
        let left = self.faults(&parted, None, 0.0, exec)?;
        if parted.iter().all(|p| p.is_finite()) && left.is_some_and(|left| left.count() < before) {
            positions[..vertices].copy_from_slice(&parted);
        }
        Ok(())
    }

    /// How far edges are from their rest lengths, relative to these, on the mean.
    fn strain(&self, at: &[DVec3]) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for triangle in &self.mesh.triangles {
            for k in 0..3 {
                let [a, b] = [triangle[k], triangle[(k + 1) % 3]].map(|v| v as usize);
                let rest = self.mesh.positions[a].distance(self.mesh.positions[b]);
                if rest > 0.0 {
                    sum += (at[a].distance(at[b]) / rest - 1.0).abs();
                    count += 1.0;
                }
            }
        }
        sum / f64::max(count, 1.0)
    }

    /// What is wrong with a shape; vertices of layers may be as near as `least`. As [`ContactSurface::crossings`].
    fn faults(
        &self,
        at: &[DVec3],
        is_asked: Option<&[bool]>,
        least: f64,
        exec: &Exec<'_>,
    ) -> Result<Option<ContactFaults>, Cancelled> {
        let Some(crossings) = self.crossings(at, is_asked, exec)? else {
            return Ok(None);
        };
        let mut misplaced = self.layers.misplaced(self.mesh, at, is_asked, least, exec)?;
        misplaced.retain(|found| {
            let corners = self.mesh.triangles[found.triangle as usize];
            let mut all = corners.iter().chain([&found.vertex]);
            !all.all(|v| self.held[*v as usize])
        });
        Ok(Some(ContactFaults { crossings, misplaced }))
    }

    /// Pairs of faces that cross, did not in the rest pose, and are not held wholly; ascending. With `is_asked` those pairs alone of
    /// which one face is asked for. `None` where nearly all faces overlap.
    fn crossings(
        &self,
        at: &[DVec3],
        is_asked: Option<&[bool]>,
        exec: &Exec<'_>,
    ) -> Result<Option<Vec<[u32; 2]>>, Cancelled> {
        let Mesh {
            positions, triangles, ..
        } = self.mesh;
        let origin = self.mesh.bounds().origin();
        let found = Mutex::new(Vec::new());
        let keep = |pair: [u32; 2]| {
            let mut corners = pair.iter().flat_map(|t| triangles[*t as usize]);
            let was_there = || is_crossing(positions, origin, triangles, pair) || self.layers.allows(triangles, pair);
            if !corners.all(|v| self.held[v as usize]) && !was_there() {
                found.lock().unwrap_or_else(PoisonError::into_inner).push(pair);
            }
        };
        if !visit_crossings_within(most_overlaps(triangles), at, triangles, is_asked, &keep, exec)? {
            return Ok(None);
        }
        let mut found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
        found.sort_unstable();
        Ok(Some(found))
    }
}

/// All places, those of the region displaced.
fn displaced(base: &[DVec3], region: &ContactRegion, moved: &[DVec3]) -> Vec<DVec3> {
    let mut at = base.to_vec();
    for (v, by) in region.nodes.iter().zip(moved) {
        at[*v as usize] += *by;
    }
    at
}

/// By vertex, how far it lies beyond its neighbours along its normal in the rest pose, summed over them.
fn rest_bend(mesh: &Mesh) -> Vec<f64> {
    let normals = smooth_normals(mesh, &mesh.positions, 1);
    let mut sums = vec![DVec3::ZERO; normals.len()];
    for triangle in &mesh.triangles {
        for k in 0..3 {
            let [a, b] = [triangle[k], triangle[(k + 1) % 3]].map(|v| v as usize);
            // An inner edge is met from both of its faces, once each way.
            sums[a] += mesh.positions[a] - mesh.positions[b];
        }
    }
    sums.iter()
        .zip(&normals)
        .map(|(sum, normal)| sum.dot(*normal))
        .collect()
}
