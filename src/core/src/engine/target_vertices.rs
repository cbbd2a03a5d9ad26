//! The vertices of a handle with targets, and what its nodes are to do for those of a pose.

use super::derived_structures::DerivedStructures;
use super::error::Error;
use super::handle::{Handle, HandlePose, HandleSet};
use super::region::{AnchorCorners, Region};
use super::region_context::RegionContext;
use super::region_context::anchor_corners;
use super::vertex_targets::{StiffnessPer, VertexTargets};
use crate::deform::{BoundGuide, GuideProblem, HandleConstraint, HoldTargets, PulledPoint};
use crate::exec::Exec;
use crate::mesh::{Mesh, NONE};
use glam::{DVec3, Vec3};

/// What handles hold besides, while they are resolved: asked with the bytes of all so far, before the next one is.
pub(super) type HeldBytesAdmission<'a> = dyn Fn(u64) -> Result<(), Error> + 'a;

/// Shares of the model's area that [`StiffnessPer::Area`] counts in.
pub(super) const SHARES: f64 = 10_000.0;

/// What a handle with targets pulls.
#[derive(Debug, Clone)]
pub(super) struct TargetVertices {
    places: TargetPlaces,
    /// Of each vertex, or each corner of each anchor, the pull of the hold; [`NONE`] of a vertex in no face.
    pull_of: Vec<u32>,
    /// [`Handle::tangential`](super::Handle::tangential).
    tangential: f64,
    /// By pull, the weight without those of the pose: of the region, and of its area.
    weights: Vec<f64>,
    /// What gives their places.
    guide: Option<BoundGuide>,
    /// What targets are relative to.
    pub origin: DVec3,
}

/// What has targets.
#[derive(Debug, Clone)]
enum TargetPlaces {
    /// Render vertices, rising.
    Vertices(Vec<u32>),
    /// Points of the surface, each with its corners and weights that sum to 1.
    Anchors(Vec<([u32; 3], [f64; 3])>),
}

impl TargetVertices {
    /// What `held` marks of a handle, or its anchors; weights of its `pulls` take areas in where the handle asks for that.
    ///
    /// # Errors
    /// When an anchor does not fit the model, below the region.
    pub fn of(
        context: &RegionContext<'_>,
        held: &[bool],
        handle: &Handle,
        pulls: &mut [(u32, f64)],
    ) -> Result<Self, Error> {
        let mesh = context.mesh;
        if handle.targets == Some(StiffnessPer::Area) {
            let areas = shares_of_area(mesh);
            pulls
                .iter_mut()
                .for_each(|(node, weight)| *weight *= areas[*node as usize]);
        }
        let pull_of = |&vertex: &u32| match mesh.solver_from_render[vertex as usize] {
            NONE => NONE,
            node => (pulls.binary_search_by_key(&node, |p| p.0)).map_or(NONE, |pull| pull as u32),
        };
        let Region::Anchors(anchors) = &handle.region else {
            let marked = (0u32..).zip(held).filter(|(_, held)| **held);
            let vertices: Vec<u32> = marked.map(|(vertex, _)| vertex).collect();
            return Ok(Self {
                pull_of: vertices.iter().map(pull_of).collect(),
                weights: pulls.iter().map(|p| p.1).collect(),
                origin: context.origin,
                tangential: handle.tangential,
                places: TargetPlaces::Vertices(vertices),
                guide: None,
            });
        };
        let corners = (anchors.iter().enumerate()).map(|(k, anchor)| {
            let sum: f64 = anchor.weights.iter().map(|w| f64::from(*w)).sum();
            if !(anchor.weights.iter().all(|w| *w >= 0.0) && sum > 0.0 && sum.is_finite()) {
                let problem = format!("are {:?}; allowed are 0 to 1, and together 1", anchor.weights);
                return Err(Error::invalid(format!(".anchors.weights[{}]", 3 * k), problem));
            }
            Ok((
                anchor_corners(context, anchor, k)?,
                anchor.weights.map(|w| f64::from(w) / sum),
            ))
        });
        let anchors = corners.collect::<Result<Vec<_>, Error>>()?;
        let corners = anchors.iter().flat_map(|(corners, _)| corners);
        let resolved = Self {
            pull_of: corners.map(pull_of).collect(),
            weights: pulls.iter().map(|p| p.1).collect(),
            origin: context.origin,
            tangential: handle.tangential,
            places: TargetPlaces::Anchors(anchors),
            guide: None,
        };
        let shares = resolved.shares_of_anchors(|_| 1.0);
        pulls.iter_mut().zip(shares).for_each(|(pull, share)| pull.1 = share);
        Ok(resolved)
    }

    /// Puts the corners of anchors in the place of the faces that they were given by.
    pub fn name_corners(&self, region: &mut Region) {
        if let (TargetPlaces::Anchors(known), Region::Anchors(anchors)) = (&self.places, region) {
            for (anchor, (corners, _)) in anchors.iter_mut().zip(known) {
                anchor.corners = AnchorCorners::Vertices(*corners);
            }
        }
    }

    /// What it pulls, in words.
    pub fn what(&self) -> &'static str {
        match self.places {
            TargetPlaces::Vertices(_) => "vertices",
            TargetPlaces::Anchors(_) => "anchors",
        }
    }

    /// Where its targets are in the rest pose, of render vertices there.
    pub fn rest_places<'a>(&'a self, rest: &'a [DVec3]) -> impl Iterator<Item = DVec3> + 'a {
        (0..self.count() as usize).map(|k| self.rest_place(k, rest))
    }

    fn rest_place(&self, k: usize, rest: &[DVec3]) -> DVec3 {
        match &self.places {
            TargetPlaces::Vertices(vertices) => rest[vertices[k] as usize],
            TargetPlaces::Anchors(anchors) => {
                let (corners, weights) = &anchors[k];
                corners.iter().zip(weights).map(|(v, w)| rest[*v as usize] * *w).sum()
            }
        }
    }

    /// By pull, its weight where anchors, by their number, weigh so much.
    fn shares_of_anchors(&self, weight: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut shares = vec![0.0; self.weights.len()];
        if let TargetPlaces::Anchors(anchors) = &self.places {
            for (k, (_, weights)) in anchors.iter().enumerate() {
                let pulls = &self.pull_of[3 * k..3 * k + 3];
                let all = weight(k) * self.own_weight(k);
                let corners = pulls.iter().zip(weights);
                corners.for_each(|(pull, w)| shares[*pull as usize] += all * w);
            }
        }
        shares
    }

    /// What an anchor weighs for the area around it: the mean of its corners.
    fn own_weight(&self, anchor: usize) -> f64 {
        let TargetPlaces::Anchors(anchors) = &self.places else {
            return 1.0;
        };
        let pulls = &self.pull_of[3 * anchor..3 * anchor + 3];
        let corners = pulls.iter().zip(anchors[anchor].1);
        corners.map(|(pull, w)| self.weights[*pull as usize] * w).sum()
    }

    /// Refuses normals of a handle that takes none, and targets without the normals that they need.
    pub fn check_normals(
        &self,
        targets: &VertexTargets,
        before: Option<&VertexTargets>,
        id: &str,
        field: &str,
    ) -> Result<(), Error> {
        let wrong = |problem: String| Err(Error::invalid(format!("{field}.targets.normals"), problem));
        let has_normals = !targets.normals.is_empty() || before.is_some_and(|before| !before.normals.is_empty());
        match self.tangential > 0.0 {
            false if !targets.normals.is_empty() => wrong(format!(
                "are given, but handle \"{id}\" is not tangential; a handle is set so"
            )),
            true if !has_normals && matches!(self.places, TargetPlaces::Anchors(_)) => wrong(format!(
                "are not given, but handle \"{id}\" is tangential, and anchors make no surface that would give them"
            )),
            _ => Ok(()),
        }
    }

    /// Binds the guide of a handle, where it has one, to the vertices; `admit` is asked with the bytes before.
    pub fn bind_guide(
        &mut self,
        handle: &Handle,
        rest: &[DVec3],
        field: &str,
        admit: &HeldBytesAdmission<'_>,
        exec: &Exec<'_>,
    ) -> Result<(), Error> {
        let Some(guide) = &handle.guide else { return Ok(()) };
        let count = self.count() as usize;
        let wrong = |wrong: GuideProblem| Error::invalid(format!("{field}.guide.{}", wrong.field), wrong.problem);
        guide.check(count).map_err(wrong)?;
        admit(guide.bound_bytes(count) as u64)?;
        let places = self.rest_places(rest).collect();
        self.guide = Some(guide.bind(places, exec)?);
        Ok(())
    }

    /// Checks the shape of the guide in a pose of the handle.
    pub fn check_guide(&self, pose: &HandlePose, id: &str, field: &str) -> Result<(), Error> {
        let (shape, guide) = match (&pose.guide, &self.guide) {
            (None, None) => return Ok(()),
            (Some(_), None) => return Err(no_guide(id, field)),
            (_, Some(_)) if pose.targets.as_ref().is_some_and(|t| !t.positions.is_empty()) => {
                let problem = format!("are given, but handle \"{id}\" has a guide, which gives them");
                return Err(Error::invalid(format!("{field}.targets.positions"), problem));
            }
            (None, Some(_)) => return Ok(()),
            (Some(shape), Some(guide)) => (shape, guide),
        };
        let wrong = |wrong: GuideProblem| Error::invalid(format!("{field}.guide.{}", wrong.field), wrong.problem);
        guide.check(shape).map_err(wrong)
    }

    /// Where the guide wants the vertices for a pose; `None` of those that it does not lead.
    pub fn led(&self, pose: &HandlePose, exec: &Exec<'_>) -> Option<Vec<Option<DVec3>>> {
        let guide = self.guide.as_ref()?;
        Some(match &pose.guide {
            Some(shape) => guide.places(shape, exec),
            None => guide.rest_places(),
        })
    }

    /// How many vertices, or anchors, have targets.
    pub fn count(&self) -> u32 {
        match &self.places {
            TargetPlaces::Vertices(vertices) => vertices.len() as u32,
            TargetPlaces::Anchors(anchors) => anchors.len() as u32,
        }
    }

    /// The way from rest that a target asks for, and its weight. A target that is the rest position in single precision is the rest
    /// position.
    fn way(&self, k: usize, wanted: &WantedPlaces<'_>) -> (DVec3, f64) {
        let weight = wanted.targets.weights.get(k).map_or(1.0, |w| f64::from(*w));
        let rest = self.rest_place(k, wanted.rest);
        let near = rest - self.origin;
        let place = wanted.targets.positions.get(k).map(|p| Vec3::from_array(*p));
        match (wanted.led.map(|led| led[k]), place) {
            (Some(None), _) => (DVec3::ZERO, 0.0),
            (Some(Some(place)), _) => (place - rest, weight),
            (None, Some(place)) if place != near.as_vec3() => (place.as_dvec3() - near, weight),
            _ => (DVec3::ZERO, weight),
        }
    }

    /// What the nodes of a hold, given with its number, are to do, where there are targets: those of several vertices of one node are
    /// averaged by weight.
    pub fn pulls(
        &self,
        number: usize,
        hold: &HandleConstraint,
        derived: &DerivedStructures,
        wanted: &WantedPlaces<'_>,
    ) -> HoldTargets {
        if let TargetPlaces::Anchors(anchors) = &self.places {
            return HoldTargets {
                hold: number,
                places: Vec::new(),
                points: self.anchored_points(anchors, hold, derived, wanted),
                weights: self.shares_of_anchors(|k| self.way(k, wanted).1),
            };
        }
        let at_rest = |pull: usize| derived.body.graph.positions[hold.pulls[pull].0 as usize];
        // By pull: the way from rest times weight, the weights, and the vertices.
        let mut sums = vec![(DVec3::ZERO, 0.0, 0u32); self.weights.len()];
        for (k, &pull) in self.pull_of.iter().enumerate() {
            let Some(sum) = sums.get_mut(pull as usize) else {
                continue;
            };
            let (way, weight) = self.way(k, wanted);
            *sum = (sum.0 + way * weight, sum.1 + weight, sum.2 + 1);
        }
        let place = |(pull, (way, weight, _)): (usize, &(DVec3, f64, u32))| match *weight > 0.0 {
            true => at_rest(pull) + *way / *weight,
            false => at_rest(pull),
        };
        let weight = |((_, weight, vertices), own): (&(DVec3, f64, u32), &f64)| match vertices {
            0 => 0.0,
            _ => own * (weight / f64::from(*vertices)),
        };
        let places: Vec<DVec3> = sums.iter().enumerate().map(place).collect();
        let weights = sums.iter().zip(&self.weights).map(weight).collect();
        if self.tangential == 0.0 {
            return HoldTargets {
                hold: number,
                places,
                weights,
                points: Vec::new(),
            };
        }
        let counts: Vec<u32> = sums.iter().map(|sum| sum.2).collect();
        HoldTargets {
            hold: number,
            points: self.planes(&counts, hold, derived, wanted, &places),
            places: Vec::new(),
            weights,
        }
    }

    fn anchored_points(
        &self,
        anchors: &[([u32; 3], [f64; 3])],
        hold: &HandleConstraint,
        derived: &DerivedStructures,
        wanted: &WantedPlaces<'_>,
    ) -> Vec<PulledPoint> {
        let point = |(k, (_, corners)): (usize, &([u32; 3], [f64; 3]))| {
            let pulls = &self.pull_of[3 * k..3 * k + 3];
            let (way, weight) = self.way(k, wanted);
            let mut point = PulledPoint {
                nodes: [0, 1, 2].map(|c| hold.pulls[pulls[c] as usize].0),
                corners: *corners,
                place: way,
                weight: weight * self.own_weight(k),
                normal: normal_of(wanted.targets, k),
                tangential: self.tangential,
            };
            point.place += point.at_rest(&derived.body);
            point
        };
        anchors.iter().enumerate().map(point).collect()
    }

    /// The vertices as points that are wanted in planes. Given are the vertices of each pull, and the places of the pulls.
    fn planes(
        &self,
        counts: &[u32],
        hold: &HandleConstraint,
        derived: &DerivedStructures,
        wanted: &WantedPlaces<'_>,
        places: &[DVec3],
    ) -> Vec<PulledPoint> {
        let own = match wanted.targets.normals.is_empty() {
            true => target_normals(hold, derived, places),
            false => Vec::new(),
        };
        let mut points = Vec::with_capacity(self.pull_of.len());
        for (k, &pull) in self.pull_of.iter().enumerate() {
            let Some(&(node, _)) = hold.pulls.get(pull as usize) else {
                continue;
            };
            let (way, weight) = self.way(k, wanted);
            points.push(PulledPoint {
                nodes: [node; 3],
                corners: [1.0, 0.0, 0.0],
                place: derived.body.graph.positions[node as usize] + way,
                weight: weight * self.weights[pull as usize] / f64::from(counts[pull as usize]),
                normal: (own.get(pull as usize)).map_or_else(|| normal_of(wanted.targets, k), |n| *n),
                tangential: self.tangential,
            });
        }
        points
    }

    /// Bytes held, with the places that the system has of it.
    pub fn byte_size(&self) -> usize {
        let guide = self.guide.as_ref().map_or(0, BoundGuide::byte_size);
        let (places, points) = match &self.places {
            TargetPlaces::Vertices(vertices) if self.tangential > 0.0 => (4 * vertices.len(), vertices.len()),
            TargetPlaces::Vertices(vertices) => (4 * vertices.len(), 0),
            TargetPlaces::Anchors(anchors) => (size_of_val(&anchors[..]), anchors.len()),
        };
        let points = 2 * size_of::<PulledPoint>() * points;
        places + points + 4 * self.pull_of.len() + (8 + size_of::<DVec3>()) * self.weights.len() + guide
    }
}

/// What a pose says of where a handle is wanted.
pub(super) struct WantedPlaces<'a> {
    pub targets: &'a VertexTargets,
    /// By target, what a guide says; `None` of one that it does not lead.
    pub led: Option<&'a [Option<DVec3>]>,
    /// The rest pose, by render vertex.
    pub rest: &'a [DVec3],
}

/// By solver vertex: its share of the model's area, times [`SHARES`].
pub(super) fn shares_of_area(mesh: &Mesh) -> Vec<f64> {
    let mut areas = vec![0.0; mesh.positions.len()];
    let mut all = 0.0;
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
        let area = 0.5 * (b - a).cross(c - a).length();
        all += area;
        triangle.iter().for_each(|v| areas[*v as usize] += area / 3.0);
    }
    let scale = if all > 0.0 { SHARES / all } else { 0.0 };
    areas.iter_mut().for_each(|area| *area *= scale);
    areas
}

/// The normal of a target, of unit length; zero where there is none.
fn normal_of(targets: &VertexTargets, k: usize) -> DVec3 {
    let normal = targets.normals.get(k).map_or(Vec3::ZERO, |n| Vec3::from_array(*n));
    normal.as_dvec3().normalize_or_zero()
}

/// By pull of a hold, the normal of the surface that it makes with its nodes at `places` and the others in the rest pose.
fn target_normals(hold: &HandleConstraint, derived: &DerivedStructures, places: &[DVec3]) -> Vec<DVec3> {
    let mut positions = derived.mesh.positions.clone();
    for (&(node, _), place) in hold.pulls.iter().zip(places) {
        positions[node as usize] = *place;
    }
    let mut normals = vec![DVec3::ZERO; positions.len()];
    for triangle in &derived.mesh.triangles {
        let [a, b, c] = triangle.map(|v| positions[v as usize]);
        let area = (b - a).cross(c - a);
        triangle.iter().for_each(|v| normals[*v as usize] += area);
    }
    let normal = |&(node, _): &(u32, f64)| normals[node as usize].normalize_or_zero();
    hold.pulls.iter().map(normal).collect()
}

/// The refusal of the shape of a guide that handle `id` does not have; `field` is the pose's.
pub(super) fn no_guide(id: &str, field: &str) -> Error {
    let problem = format!("is given, but handle \"{id}\" has no guide; a handle is set with it");
    Error::invalid(format!("{field}.guide"), problem)
}

/// Refuses a handle with targets that asks for what it cannot do.
pub(super) fn check_targets_alone(set: &HandleSet, handle: &Handle, field: &str) -> Result<(), Error> {
    if handle.targets.is_none() {
        if handle.tangential != 0.0 {
            let problem = "is set, but targets is not: it says how far they pull along the surface";
            return Err(Error::invalid(format!("{field}.targets.tangential"), problem));
        }
        return match handle.guide.is_some() {
            true => Err(Error::invalid(
                format!("{field}.guide"),
                "is set, but targets is not: a guide gives their places",
            )),
            false => Ok(()),
        };
    }
    if !(0.0..=1.0).contains(&handle.tangential) {
        let problem = format!("is {}, allowed are 0 to 1", handle.tangential);
        return Err(Error::invalid(format!("{field}.targets.tangential"), problem));
    }
    let kinds = handle.constrains;
    let problem = match handle {
        _ if handle.stiffness.is_none() => "is set, but stiffness is not: vertices are pulled softly",
        _ if !kinds.position || kinds.rotation || kinds.scale => "is set, but constrains is not POSITION alone",
        _ if handle.rigid => "is set on a rigid handle: one of both is allowed",
        _ if handle.falloff.is_some() => "is set beside a falloff: one of both is allowed; weights may fade",
        _ if set.symmetry_plane.is_some() => {
            "is set beside a symmetryPlane, which pulls of single vertices do not know"
        }
        _ => return Ok(()),
    };
    let name = if handle.guide.is_some() { "guide" } else { "targets" };
    Err(Error::invalid(format!("{field}.{name}"), problem))
}
