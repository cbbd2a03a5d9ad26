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
use pliant_mesh::{Components, Lists, Mesh, self_intersections};
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// Places that are parted one by one at most.
const MOST_PLACES: usize = 16;
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
            crossings: 0,
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
        if (1..before.crossings).contains(&best.crossings) {
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
        let faces_of = faces_of_vertices(self.mesh);
        let places = places_of(self.mesh, &faces_of, self.fixed, &crossings);
        if places.len() < 2 {
            return Ok(());
        }
        for place in places.iter().take(MOST_PLACES) {
            let region = ContactRegion::around(self.mesh, &faces_of, self.fixed, place, RINGS);
            let held: Vec<bool> = (region.local.iter()).map(|k| (*k as usize) >= region.free).collect();
            self.try_with(
                &ContactSurface {
                    held: &held,
                    ..*surface
                },
                best,
                exec,
            )?;
        }
        Ok(())
    }
}

/// Pairs that cross, those whose regions touch together; the largest such place first.
fn places_of(mesh: &Mesh, faces_of: &Lists, fixed: &[bool], crossings: &[[u32; 2]]) -> Vec<Vec<[u32; 2]>> {
    let region = ContactRegion::around(mesh, faces_of, fixed, crossings, RINGS);
    let near = (0..mesh.triangles.len()).filter(|t| region.is_near[*t]);
    let near: Vec<[u32; 3]> = near.map(|t| mesh.triangles[t]).collect();
    // Both surfaces of a pair are one place.
    let joints = crossings.iter().map(|pair| {
        let [a, b] = pair.map(|t| mesh.triangles[t as usize]);
        [a[0], a[1], b[0]]
    });
    let all: Vec<[u32; 3]> = near.iter().copied().chain(joints).collect();
    let of = Components::of_triangles(mesh.positions.len(), &all).of_vertex;
    let mut places: BTreeMap<u32, Vec<[u32; 2]>> = BTreeMap::new();
    for pair in crossings {
        let part = of[mesh.triangles[pair[0] as usize][0] as usize];
        places.entry(part).or_default().push(*pair);
    }
    let mut places: Vec<Vec<[u32; 2]>> = places.into_values().collect();
    places.sort_by_key(|place| Reverse(place.len()));
    places
}
