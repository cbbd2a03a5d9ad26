//! Surfaces that a pose has pushed through each other, moved apart.
//!
//! Where triangles cross that did not in the rest pose, the surface around ([`region`]) is displaced as smoothly as conditions on its
//! vertices allow ([`displace`]), half of each on either side, all on one where handles hold the other. The result is looked at,
//! conditions that have come up are added, and so on. What handles hold stays.
//!
//! At first conditions shorten the curves in which surfaces cross, step by step ([`contour`]). That is gentle, and needs no inside, but
//! may end where a crossing is deep. Then the surface goes from a part of the pose in which nothing crosses to all of it, where the pose
//! can be taken in parts ([`follow`]), and its curves are shortened again. What that leaves becomes conditions that stay in force
//! ([`find`]): a vertex lies before a face, or an edge beside an edge, by the clearance, along the bisector of the two sides' normals, whose
//! outsides say where each of them belongs. Places so crumpled that faces cross others of the same direction are flattened instead. What
//! that leaves has its curves shortened again.
//!
//! Frames of a drag or a recording go on from the one before by a few of the steps that shorten curves ([`moving`]).

mod contour;
mod displace;
mod find;
mod follow;
mod layers;
mod moving;
mod nearness;
mod normals;
mod outfit;
mod pose_path;
mod region;
mod unintersect;

use crate::surface_faults::most_overlaps;
use contour::contour_conditions;
use displace::DisplacementProblem;
use find::{ContactFinder, Knowledge, PartingStyle};
use glam::DVec3;
pub use layers::LayerSides;
use layers::MisplacedVertex;
pub use moving::{ContactMemory, MovingSurface};
use normals::smooth_normals;
pub use outfit::{FittedOutfit, OutfitFaults, OutfitOnBody};
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use pliant_mesh::{Lists, Mesh, is_crossing, visit_crossings_within};
use pose_path::NoPath;
pub use pose_path::PosePath;
use region::ContactRegion;
use std::sync::{Mutex, PoisonError};
pub use unintersect::{CrossingSurface, UncrossedSurface};

/// How far the region reaches around triangles that cross, in rings of faces.
const RINGS: usize = 16;
/// The clearance where none is given, median edges around what crosses.
const CLEARANCE: f64 = 0.1;
/// Pairs that are worked on; a shape with more of them has collapsed, and stays as it is.
pub const MOST_PARTED: usize = 20_000;
/// With so many times the pairs of the beginning a style is given up.
const LOST: usize = 4;
/// What parting may change lengths of edges by, on the mean, whatever the pose does.
const LEAST_STRAIN: f64 = 0.02;
/// The same, where what crosses in the rest pose is parted: there is no pose that changes lengths.
const LEAST_STRAIN_AT_REST: f64 = 0.1;
/// How often the conditions are chosen that hold with equality, where they stay in force.
const CHOICES: usize = 3;
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

/// What the surface gives way with where curves of crossings are shortened.
const CONTOUR_STYLE: PartingStyle = PartingStyle {
    smoothing: 1,
    facing: 0.7,
    flatten: 0.0,
    bending: 0.5,
    stiffness: 1.0,
};
/// Rounds of shortening curves,
const CONTOUR_ROUNDS: usize = 30;
/// and how far surfaces go apart in each, median edges.
const CONTOUR_STEP: f64 = 0.3;
/// What part of the displacement so far is solved for again in each, so that what is no longer needed goes.
const CONTOUR_BACK: f64 = 0.1;
/// A kind of parting is given up after so many rounds without fewer pairs.
const PATIENCE: usize = 8;
/// Where nothing crosses any more, but edges are further from their rest lengths than so many times as far as before, another kind of
/// parting is tried too.
const LITTLE_STRAIN: f64 = 1.15;

/// A surface that handles hold in part.
#[derive(Clone, Copy)]
pub struct ContactSurface<'a> {
    /// In the rest pose.
    pub mesh: &'a Mesh,
    /// By graph node, those of the surface first: whether it stays.
    pub held: &'a [bool],
    /// What surfaces keep from each other, model units; `None`: [`CLEARANCE`] of the median edge around what crosses.
    pub clearance: Option<f64>,
    /// Which of its parts lie on which.
    pub layers: &'a LayerSides,
    /// What crosses in the rest pose.
    pub at_rest: RestCrossings,
}

/// What becomes of triangles that cross in the rest pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RestCrossings {
    /// They may cross in a pose, too.
    Stay,
    /// They are parted; the surface gives way so many rings of faces around.
    Part(usize),
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

/// A displacement of the region with what is left.
#[derive(Clone)]
struct Parted {
    /// As [`ContactFaults::count`].
    faults: usize,
    /// As [`ContactSurface::strain`].
    strain: f64,
    /// By free node.
    moved: Vec<DVec3>,
    knowledge: Knowledge,
}

/// A shape that may be the result.
struct PartedShape {
    at: Vec<DVec3>,
    /// As [`ContactFaults::count`].
    faults: usize,
    /// As [`ContactSurface::strain`].
    strain: f64,
}

/// A shape and what is wrong with it.
struct Faulty {
    at: Vec<DVec3>,
    faults: ContactFaults,
}

/// Says when a kind of parting is given up.
#[derive(Default)]
struct Patience {
    fewest: Option<usize>,
    rounds: usize,
}

/// A shape that is being parted.
struct Parting<'a> {
    surface: &'a ContactSurface<'a>,
    /// The places of all vertices before.
    base: &'a [DVec3],
    region: ContactRegion,
    clearance: f64,
    rest_bend: Vec<f64>,
    /// Without displacement.
    before: Parted,
    /// The best one so far.
    best: Parted,
}

impl ContactSurface<'_> {
    /// Moves vertices among `positions` (of all graph nodes, those of the surface first) so that fewer pairs of triangles cross that do
    /// not in the rest pose, pairs that are held apart. Where it cannot, they keep their bits.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn part(&self, positions: &mut [DVec3], exec: &Exec<'_>) -> Result<(), Cancelled> {
        self.part_on::<NoPath>(positions, None, exec)
    }

    /// As [`ContactSurface::part`] of a pose that can be taken in parts.
    ///
    /// # Errors
    /// Those of the path; [`Cancelled`].
    pub fn part_on<P: PosePath>(
        &self,
        positions: &mut [DVec3],
        path: Option<&mut P>,
        exec: &Exec<'_>,
    ) -> Result<(), P::Error> {
        let vertices = self.mesh.positions.len();
        let base = &positions[..vertices];
        let before = match self.faults(base, None, 0.0, exec)? {
            Some(before) if (1..=MOST_PARTED).contains(&before.count()) => before,
            _ => return Ok(()),
        };
        let mut parting = Parting::of(self, base, &before);
        parting.shorten_curves(exec)?;
        let mut best = parting.best_shape();
        if !parting.is_good(&best) {
            let followed = match path {
                Some(path) => self.follow(base, path, exec)?,
                None => None,
            };
            let is_followed = followed.is_some();
            if let Some(at) = followed {
                parting.weigh(self.freed(at, exec)?, &mut best, exec)?;
            }
            // On the way layers are not looked at.
            if !is_followed || (best.faults > 0 && !self.layers.is_empty()) {
                parting.best = parting.before.clone();
                parting.part_further(&mut best, exec)?;
            }
        }
        parting.relax(&mut best, exec)?;
        let left = self.faults(&best.at, None, 0.0, exec)?;
        if best.at.iter().all(|p| p.is_finite()) && left.is_some_and(|left| left.count() < before.count()) {
            positions[..vertices].copy_from_slice(&best.at);
        }
        Ok(())
    }

    /// Parts what still crosses at the end of the way to a pose.
    fn freed(&self, at: Vec<DVec3>, exec: &Exec<'_>) -> Result<Vec<DVec3>, Cancelled> {
        let before = match self.faults(&at, None, 0.0, exec)? {
            Some(before) if (1..=MOST_PARTED).contains(&before.count()) => before,
            _ => return Ok(at),
        };
        let mut parting = Parting::of(self, &at, &before);
        parting.shorten_curves(exec)?;
        let mut best = parting.best_shape();
        if !parting.is_good(&best) {
            parting.part_further(&mut best, exec)?;
        }
        Ok(best.at)
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

    /// Pairs of faces that cross, did not in the rest pose (unless that is to be parted too), and are not held wholly; ascending. With `is_asked` those pairs alone of
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
            let at_rest = || self.at_rest == RestCrossings::Stay && is_crossing(positions, origin, triangles, pair);
            let was_there = || at_rest() || self.layers.allows(triangles, pair);
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

impl Patience {
    /// After a round that left so many faults, of so many at the beginning.
    fn ends(&mut self, faults: usize, first: usize) -> bool {
        if self.fewest.is_none_or(|fewest| faults < fewest) {
            (self.fewest, self.rounds) = (Some(faults), 0);
        } else {
            self.rounds += 1;
        }
        faults == 0 || faults > LOST * first || self.rounds >= PATIENCE
    }
}

impl PartedShape {
    fn is_better(&self, other: &Self) -> bool {
        self.faults < other.faults || (self.faults == other.faults && self.strain < other.strain)
    }
}

impl<'a> Parting<'a> {
    fn of(surface: &'a ContactSurface<'a>, base: &'a [DVec3], faults: &ContactFaults) -> Self {
        let mesh = surface.mesh;
        let rings = match surface.at_rest {
            RestCrossings::Stay => RINGS,
            RestCrossings::Part(rings) => rings,
        };
        let held = &surface.held[..base.len()];
        let region = ContactRegion::around(mesh, &faces_of_vertices(mesh), held, &faults.places(mesh), rings);
        let before = Parted {
            faults: faults.count(),
            strain: surface.strain(base),
            moved: vec![DVec3::ZERO; region.free],
            knowledge: Knowledge::default(),
        };
        Self {
            clearance: surface.clearance.unwrap_or(CLEARANCE * region.edge),
            rest_bend: rest_bend(mesh),
            best: before.clone(),
            surface,
            base,
            region,
            before,
        }
    }

    /// Whether nothing crosses and edges are little further from their rest lengths than before.
    fn is_good(&self, shape: &PartedShape) -> bool {
        shape.faults == 0 && shape.strain <= LITTLE_STRAIN * self.before.strain
    }

    /// The best shape so far.
    fn best_shape(&self) -> PartedShape {
        PartedShape {
            at: displaced(self.base, &self.region, &self.best.moved),
            faults: self.best.faults,
            strain: self.best.strain,
        }
    }

    /// How far edges may be from their rest lengths in a shape with so many faults. The more is parted, the more lengths may change: up
    /// to twice as far as before, on the mean, and some beside that where the pose itself changes none.
    fn most_strain(&self, faults: usize) -> f64 {
        let parted = 1.0 - faults as f64 / self.before.faults as f64;
        let least = match self.surface.at_rest {
            RestCrossings::Stay => LEAST_STRAIN,
            RestCrossings::Part(_) => LEAST_STRAIN_AT_REST,
        };
        self.before.strain + parted * parted * self.before.strain.max(least)
    }

    /// Puts a shape in the place of the `best` one where it is better.
    fn weigh(&self, at: Vec<DVec3>, best: &mut PartedShape, exec: &Exec<'_>) -> Result<(), Cancelled> {
        let Some(faults) = self.surface.faults(&at, None, 0.0, exec)? else {
            return Ok(());
        };
        let (faults, strain) = (faults.count(), self.surface.strain(&at));
        let shape = PartedShape { at, faults, strain };
        if faults < self.before.faults && strain <= self.most_strain(faults) && shape.is_better(best) {
            *best = shape;
        }
        Ok(())
    }

    fn finder(&self, style: PartingStyle, normals: Vec<DVec3>, knowledge: Knowledge) -> ContactFinder<'_> {
        ContactFinder {
            mesh: self.surface.mesh,
            region: &self.region,
            layers: self.surface.layers,
            clearance: self.clearance,
            is_posed: self.surface.at_rest == RestCrossings::Stay,
            style,
            normals,
            knowledge,
        }
    }

    /// Looks at the region displaced, where layers may be as near as `least`. Answers what is wrong, and keeps it where it is the best so
    /// far; `None` where nearly all faces overlap.
    fn look(
        &mut self,
        moved: &[DVec3],
        knowledge: &Knowledge,
        least: f64,
        exec: &Exec<'_>,
    ) -> Result<Option<Faulty>, Cancelled> {
        let at = displaced(self.base, &self.region, moved);
        let Some(faults) = self.surface.faults(&at, Some(&self.region.is_near), least, exec)? else {
            return Ok(None);
        };
        let left = faults.count();
        if left < self.best.faults {
            let strain = self.surface.strain(&at);
            if strain <= self.most_strain(left) {
                self.best = Parted {
                    faults: left,
                    strain,
                    moved: moved.to_vec(),
                    knowledge: knowledge.clone(),
                };
            }
        }
        Ok(Some(Faulty { at, faults }))
    }

    /// Goes on from the best displacement by small steps, each of which shortens the curves of crossings.
    fn shorten_curves(&mut self, exec: &Exec<'_>) -> Result<(), Cancelled> {
        let mut moved = self.best.moved.clone();
        let mut patience = Patience::default();
        let Some(mut now) = self.look(&moved, &Knowledge::default(), 0.0, exec)? else {
            return Ok(());
        };
        for _ in 0..CONTOUR_ROUNDS {
            exec.check()?;
            // Nothing is flattened: no normal is asked for.
            let finder = self.finder(CONTOUR_STYLE, Vec::new(), Knowledge::default());
            let conditions = contour_conditions(
                self.surface.mesh,
                &now.at,
                &now.faults.crossings,
                CONTOUR_STEP * self.region.edge,
            );
            let part = |part: f64| moved.iter().map(|by| *by * part).collect::<Vec<DVec3>>();
            let (kept, mut by) = (part(1.0 - CONTOUR_BACK), part(CONTOUR_BACK));
            let from = displaced(self.base, &self.region, &kept);
            DisplacementProblem::new(&finder, &from, &self.rest_bend)
                .keeping_volume(self.base, &now.at, &by)
                .improve(conditions, 1, &mut by, exec)?;
            moved = kept.iter().zip(&by).map(|(kept, by)| *kept + *by).collect();
            match self.look(&moved, &Knowledge::default(), 0.0, exec)? {
                Some(next) if !patience.ends(next.faults.count(), self.before.faults) => now = next,
                _ => break,
            }
        }
        Ok(())
    }

    /// Goes on from the best displacement by conditions that stay in force, and shortens curves again where these do not suffice. Puts the
    /// shape in the place of the `best` one where it is better.
    fn part_further(&mut self, best: &mut PartedShape, exec: &Exec<'_>) -> Result<(), Cancelled> {
        self.meet_conditions(exec)?;
        if self.best.faults > 0 {
            self.shorten_curves(exec)?;
        }
        let other = self.best_shape();
        if other.is_better(best) {
            *best = other;
        }
        Ok(())
    }

    /// Parts surfaces by conditions that stay in force, in one style after the other until nothing crosses.
    fn meet_conditions(&mut self, exec: &Exec<'_>) -> Result<(), Cancelled> {
        for style in STYLES {
            if self.best.faults == 0 {
                break;
            }
            let (mut moved, mut knowledge) = (self.best.moved.clone(), self.best.knowledge.clone());
            let mut patience = Patience::default();
            let Some(mut now) = self.look(&moved, &knowledge, self.clearance, exec)? else {
                break;
            };
            let mut normals = smooth_normals(self.surface.mesh, &now.at, style.smoothing);
            for _ in 0..ROUNDS {
                exec.check()?;
                let mut finder = self.finder(style, normals, knowledge);
                finder.look(&now.at, &now.faults.crossings, &now.faults.misplaced);
                DisplacementProblem::new(&finder, self.base, &self.rest_bend)
                    .keeping_volume(self.base, &now.at, &moved)
                    .improve(finder.conditions(), CHOICES, &mut moved, exec)?;
                ContactFinder { normals, knowledge, .. } = finder;
                match self.look(&moved, &knowledge, self.clearance, exec)? {
                    Some(next) if !patience.ends(next.faults.count(), self.before.faults) => now = next,
                    _ => break,
                }
            }
        }
        Ok(())
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

/// The faces of each vertex.
fn faces_of_vertices(mesh: &Mesh) -> Lists {
    let corners = || {
        (0u32..)
            .zip(&mesh.triangles)
            .flat_map(|(t, corners)| corners.map(|v| (v, t)))
    };
    Lists::gather(mesh.positions.len(), corners)
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
