//! An outfit on another body: what was outside of the body that it was made for is outside of the other one.

use super::layers::LayerSides;
use super::{ContactFaults, ContactSurface, RestCrossings};
use crate::surface_faults::most_overlaps;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::{Components, Mesh, surface_area, visit_crossings_within};
use std::sync::{Mutex, PoisonError};

/// The clearance where none is given, of the diagonal of the other body.
const CLEARANCE: f64 = 0.005;
/// How far from all else the body is put in the rest pose of what is solved, so that nothing crosses it there, diagonals.
const AWAY: f64 = 4.0;

/// An outfit, and two bodies.
pub struct OutfitOnBody<'a> {
    /// The body that it was made for; its triangles wind outwards, as those of the other one.
    pub body: &'a Mesh,
    /// The outfit where it fits that.
    pub outfit: &'a Mesh,
    /// The body that it is to fit.
    pub other: &'a Mesh,
    /// What is kept from the other body at most, model units of that one; as far as it was from the first, in proportion to the sizes of
    /// the bodies. `None`: [`CLEARANCE`] of its diagonal.
    pub clearance: Option<f64>,
}

/// How an outfit is on a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OutfitFaults {
    /// Vertices that are inside and were outside of the first body.
    pub inside: u32,
    /// Pairs of triangles, one or both of the outfit, that cross and did not on the first body.
    pub crossings: u64,
}

/// An outfit on another body.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FittedOutfit {
    /// Where its vertices are.
    pub positions: Vec<DVec3>,
    /// Vertices that were inside of the first body; they may be inside of the other one.
    pub inside_at_rest: u32,
    /// How the outfit was as it was carried to the other body.
    pub carried: OutfitFaults,
    /// How it is now.
    pub fitted: OutfitFaults,
}

impl OutfitOnBody<'_> {
    /// Puts the outfit outside of the other body, from where its vertices were carried. Where it cannot, it stays there.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn fit(&self, carried: &[DVec3], exec: &Exec<'_>) -> Result<FittedOutfit, Cancelled> {
        let [body, outfit, other] = [self.body, self.outfit, self.other];
        let areas = [body, other].map(|m| surface_area(&m.positions, &m.triangles));
        let scale = (areas[1] / areas[0].max(f64::MIN_POSITIVE)).sqrt();
        let at_rest = joined(body, outfit);
        let parts = Components::of_triangles(outfit.positions.len(), &outfit.triangles).of_vertex;
        let part = std::iter::repeat_n(0, body.positions.len()).chain(parts.iter().map(|p| p + 1));
        let sides = LayerSides::of_vertices(body.positions.len(), &at_rest, part.collect(), exec)?;
        let inside = (body.positions.len()..at_rest.positions.len()).filter(|v| sides.side(*v, 0) == Some(-1.0));
        let inside_at_rest = inside.count() as u32;
        let crossed = crossed_by_body(&at_rest, body.triangles.len(), exec)?;
        let counts = |m: &Mesh| [m.positions.len(), m.triangles.len()];
        let sides = sides.on_other_body(counts(body), counts(other), scale, &crossed);

        let mut rest = joined(other, outfit);
        let bodies = other.positions.len();
        let diagonal = other.bounds().diagonal();
        let away = DVec3::X * (AWAY * (diagonal + scale * at_rest.bounds().diagonal()));
        rest.positions[bodies..].iter_mut().for_each(|p| *p *= scale);
        let place = rest.positions[bodies];
        rest.positions[..bodies].iter_mut().for_each(|p| *p += place + away);
        let mut held = vec![true; rest.positions.len()];
        held[bodies..].fill(false);
        let surface = ContactSurface {
            mesh: &rest,
            held: &held,
            clearance: Some(self.clearance.unwrap_or(CLEARANCE * diagonal)),
            layers: &sides,
            at_rest: RestCrossings::Stay,
        };
        let mut positions = other.positions.clone();
        positions.extend(carried);
        let told = |faults: Option<ContactFaults>| match faults {
            Some(faults) => OutfitFaults {
                inside: faults.behind().count() as u32,
                crossings: faults.crossings.len() as u64,
            },
            None => OutfitFaults::default(),
        };
        let before = told(surface.faults(&positions, None, 0.0, exec)?);
        surface.part(&mut positions, exec)?;
        Ok(FittedOutfit {
            inside_at_rest,
            carried: before,
            fitted: told(surface.faults(&positions, None, 0.0, exec)?),
            positions: positions.split_off(bodies),
        })
    }
}

/// Two surfaces as one, the second after the first.
fn joined(first: &Mesh, second: &Mesh) -> Mesh {
    let mut all = first.clone();
    let shift = all.positions.len() as u32;
    all.positions.extend(&second.positions);
    all.triangles
        .extend(second.triangles.iter().map(|t| t.map(|v| v + shift)));
    all
}

/// By triangle of an outfit, which comes after those of a body: whether it crosses the body.
fn crossed_by_body(all: &Mesh, body: usize, exec: &Exec<'_>) -> Result<Vec<bool>, Cancelled> {
    let of_outfit: Vec<bool> = (0..all.triangles.len()).map(|t| t >= body).collect();
    let found = Mutex::new(vec![false; all.triangles.len() - body]);
    let keep = |[own, other]: [u32; 2]| {
        let (own, other) = (own as usize, other as usize);
        if own < body && other >= body {
            found.lock().unwrap_or_else(PoisonError::into_inner)[other - body] = true;
        }
    };
    let most = most_overlaps(&all.triangles);
    visit_crossings_within(most, &all.positions, &all.triangles, Some(&of_outfit), &keep, exec)?;
    Ok(found.into_inner().unwrap_or_else(PoisonError::into_inner))
}
