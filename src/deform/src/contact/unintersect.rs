//! A surface that crosses itself in the shape that it has, freed of that by little deformation.
//!
//! There is no shape from before to compare with. Curves in which surfaces cross are shortened as in a pose; where that is not enough,
//! normals say on which side each belongs, and of two parts that cross the sides on which most of their vertices lie. First all places
//! are parted at once, of what is deep with more of the surface around, then each one that is left, with all others held.

use super::layers::LayerSides;
use super::region::ContactRegion;
use super::{ContactSurface, MOST_PARTED, RINGS, RestCrossings, faces_of_vertices};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::{Components, Mesh, self_intersections};
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// Places that are parted one by one at most.
const MOST_PLACES: usize = 16;
/// So many places in a row that could not be parted end the work: those that follow have fewer pairs and less room.
const PLACE_PATIENCE: usize = 3;
/// Where lengths of edges change by more, on the mean, or pairs are left, a wider part of the surface is let give way,
const STRAINED: f64 = 0.01;
/// so many rings of faces.
const WIDE_RINGS: usize = 48;

/// A surface that crosses itself.
pub struct CrossingSurface<'a> {
    /// In the shape that is mended.
    pub mesh: &'a Mesh,
    /// By vertex, whether it stays.
    pub fixed: &'a [bool],
    /// What surfaces that crossed are to keep from each other, model units; `None`: a tenth of the median edge around them.
    pub clearance: Option<f64>,
}

/// A surface with as few crossings as was possible.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct UncrossedSurface {
    /// Where its vertices are. Where nothing was better, those that were given.
    pub positions: Vec<DVec3>,
    /// Pairs of triangles that crossed before.
    pub crossings_before: u64,
    /// Pairs that cross now; never more.
    pub crossings: u64,
    /// Whether parting ended before all places were tried, because those before could not be parted.
    pub is_given_up: bool,
}

impl CrossingSurface<'_> {
    /// Parts what crosses.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn part(&self, exec: &Exec<'_>) -> Result<UncrossedSurface, Cancelled> {
        let mesh = self.mesh;
        let mut best = UncrossedSurface {
            positions: mesh.positions.clone(),
            crossings_before: self_intersections(&mesh.positions, &mesh.triangles, exec)?,
            ..UncrossedSurface::default()
        };
        best.crossings = best.crossings_before;
        if !(1..=MOST_PARTED as u64).contains(&best.crossings) {
            return Ok(best);
        }
        let parts = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
        let sides = LayerSides::at_rest(mesh, parts.of_vertex, exec)?;
        let mut surface = ContactSurface {
            mesh,
            held: self.fixed,
            clearance: self.clearance,
            layers: &LayerSides::default(),
            at_rest: RestCrossings::Part(RINGS),
        };
        let crossings = surface.crossings(&mesh.positions, None, exec)?.unwrap_or_default();
        let sides = sides.of_most(mesh, &crossings, exec)?;
        surface.layers = &sides;
        let before = best.clone();
        self.try_with(&surface, &mut best, exec)?;
        if best.crossings > 0 || surface.strain(&best.positions) > STRAINED {
            let wide = ContactSurface {
                at_rest: RestCrossings::Part(WIDE_RINGS),
                ..surface
            };
            let mut other = before.clone();
            self.try_with(&wide, &mut other, exec)?;
            let rank = |one: &UncrossedSurface| (one.crossings, surface.strain(&one.positions));
            if rank(&other) < rank(&best) {
                best = other;
            }
        }
        if best.crossings > 0 {
            self.part_places(&surface, &mut best, exec)?;
        }
        if (1..before.crossings).contains(&best.crossings) && !best.is_given_up {
            self.try_with(&surface, &mut best, exec)?;
        }
        Ok(best)
    }

    /// Parts what `surface` leaves free, and keeps that where fewer pairs cross.
    fn try_with(
        &self,
        surface: &ContactSurface<'_>,
        best: &mut UncrossedSurface,
        exec: &Exec<'_>,
    ) -> Result<(), Cancelled> {
        let mut positions = best.positions.clone();
        surface.part(&mut positions, exec)?;
        if positions == best.positions {
            return Ok(());
        }
        let crossings = self_intersections(&positions, &self.mesh.triangles, exec)?;
        if crossings < best.crossings {
            (best.positions, best.crossings) = (positions, crossings);
        }
        Ok(())
    }

    /// Parts each place that is left, with all others held.
    fn part_places(
        &self,
        surface: &ContactSurface<'_>,
        best: &mut UncrossedSurface,
        exec: &Exec<'_>,
    ) -> Result<(), Cancelled> {
        let Some(crossings) = surface.crossings(&best.positions, None, exec)? else {
            return Ok(());
        };
        let places = CrossingPlaces::of(self.mesh, self.fixed, &crossings);
        if places.parts.len() < 2 {
            return Ok(());
        }
        let mut patience = PLACE_PATIENCE;
        for part in places.parts.iter().take(MOST_PLACES) {
            let before = best.crossings;
            let held = places.held_beside(*part);
            self.try_with(
                &ContactSurface {
                    held: &held,
                    ..*surface
                },
                best,
                exec,
            )?;
            patience = if best.crossings < before {
                PLACE_PATIENCE
            } else {
                patience - 1
            };
            if patience == 0 {
                best.is_given_up = true;
                break;
            }
        }
        Ok(())
    }
}

/// Places of a surface where triangles cross: pairs whose regions touch are one.
struct CrossingPlaces {
    /// By vertex, which part of the surface around all pairs it is in.
    part_of: Vec<u32>,
    /// By vertex, whether it may move.
    is_free: Vec<bool>,
    /// The parts with pairs, those with most of them first.
    parts: Vec<u32>,
}

impl CrossingPlaces {
    fn of(mesh: &Mesh, fixed: &[bool], crossings: &[[u32; 2]]) -> Self {
        let region = ContactRegion::around(mesh, &faces_of_vertices(mesh), fixed, crossings, RINGS);
        let near = region.faces.iter().map(|t| mesh.triangles[*t as usize]);
        // Both surfaces of a pair are one place.
        let joints = crossings.iter().map(|pair| {
            let [a, b] = pair.map(|t| mesh.triangles[t as usize]);
            [a[0], a[1], b[0]]
        });
        let all: Vec<[u32; 3]> = near.chain(joints).collect();
        let part_of = Components::of_triangles(mesh.positions.len(), &all).of_vertex;
        let mut pairs: BTreeMap<u32, usize> = BTreeMap::new();
        for pair in crossings {
            let part = part_of[mesh.triangles[pair[0] as usize][0] as usize];
            *pairs.entry(part).or_default() += 1;
        }
        let mut parts: Vec<u32> = pairs.keys().copied().collect();
        parts.sort_by_key(|part| Reverse(pairs[part]));
        Self {
            part_of,
            is_free: (region.local.iter()).map(|k| (*k as usize) < region.free).collect(),
            parts,
        }
    }

    /// By vertex, whether it stays while one of the parts is parted.
    fn held_beside(&self, part: u32) -> Vec<bool> {
        let own = self.part_of.iter().zip(&self.is_free);
        own.map(|(of, is_free)| !is_free || *of != part).collect()
    }
}
