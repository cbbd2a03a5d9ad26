//! The vertices of a handle with targets, and what its nodes are to do for those of a pose.

use super::error::Error;
use super::handle::{Handle, HandlePose, HandleSet};
use super::region_context::RegionContext;
use super::vertex_targets::{StiffnessPer, VertexTargets};
use crate::deform::{BoundGuide, DeformableBody, GuideProblem, HandleConstraint};
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
    /// The render vertices of the handle, rising.
    pub vertices: Vec<u32>,
    /// Of each the pull of the hold; [`NONE`] of a vertex in no face.
    pull_of: Vec<u32>,
    /// By pull, the weight without those of the pose: of the region, and of its area.
    weights: Vec<f64>,
    /// What gives their places.
    guide: Option<BoundGuide>,
    /// What targets are relative to.
    pub origin: DVec3,
}

impl TargetVertices {
    /// The vertices that `held` marks of a handle with `pulls`, whose weights take areas in where the handle asks for that.
    pub fn of(context: &RegionContext<'_>, held: &[bool], per: StiffnessPer, pulls: &mut [(u32, f64)]) -> Self {
        let mesh = context.mesh;
        if per == StiffnessPer::Area {
            let areas = shares_of_area(mesh);
            pulls
                .iter_mut()
                .for_each(|(node, weight)| *weight *= areas[*node as usize]);
        }
        let marked = (0u32..).zip(held).filter(|(_, held)| **held);
        let vertices: Vec<u32> = marked.map(|(vertex, _)| vertex).collect();
        let pull_of = |&vertex: &u32| match mesh.solver_from_render[vertex as usize] {
            NONE => NONE,
            node => (pulls.binary_search_by_key(&node, |p| p.0)).map_or(NONE, |pull| pull as u32),
        };
        Self {
            pull_of: vertices.iter().map(pull_of).collect(),
            weights: pulls.iter().map(|p| p.1).collect(),
            origin: context.origin,
            vertices,
            guide: None,
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
        let count = self.vertices.len();
        let wrong = |wrong: GuideProblem| Error::invalid(format!("{field}.guide.{}", wrong.field), wrong.problem);
        guide.check(count).map_err(wrong)?;
        admit(guide.bound_bytes(count) as u64)?;
        let places = self.vertices.iter().map(|v| rest[*v as usize]).collect();
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

    /// How many vertices have targets.
    pub fn count(&self) -> u32 {
        self.vertices.len() as u32
    }

    /// What the nodes are to do, where there are targets: those of several vertices of one node are averaged by weight. A target
    /// that is the rest position in single precision is the rest position.
    pub fn pulls(
        &self,
        hold: &HandleConstraint,
        body: &DeformableBody,
        rest: &[DVec3],
        targets: &VertexTargets,
        led: Option<&[Option<DVec3>]>,
    ) -> Pulls {
        let at_rest = |pull: usize| body.graph.positions[hold.pulls[pull].0 as usize];
        // By pull: the way from rest times weight, the weights, and the vertices.
        let mut sums = vec![(DVec3::ZERO, 0.0, 0u32); self.weights.len()];
        for (k, (&vertex, &pull)) in self.vertices.iter().zip(&self.pull_of).enumerate() {
            let Some(sum) = sums.get_mut(pull as usize) else {
                continue;
            };
            let mut weight = targets.weights.get(k).map_or(1.0, |w| f64::from(*w));
            let rest = rest[vertex as usize];
            let near = rest - self.origin;
            let place = targets.positions.get(k).map(|p| Vec3::from_array(*p));
            let way = match (led.map(|led| led[k]), place) {
                (Some(None), _) => {
                    weight = 0.0;
                    DVec3::ZERO
                }
                (Some(Some(place)), _) => place - rest,
                (None, Some(place)) if place != near.as_vec3() => place.as_dvec3() - near,
                _ => DVec3::ZERO,
            };
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
        Pulls {
            places: sums.iter().enumerate().map(place).collect(),
            weights: sums.iter().zip(&self.weights).map(weight).collect(),
        }
    }

    /// Bytes held, with the places that the system has of it.
    pub fn byte_size(&self) -> usize {
        let guide = self.guide.as_ref().map_or(0, BoundGuide::byte_size);
        4 * (self.vertices.len() + self.pull_of.len()) + (8 + size_of::<DVec3>()) * self.weights.len() + guide
    }
}

/// By pull of a hold.
pub(super) struct Pulls {
    pub places: Vec<DVec3>,
    pub weights: Vec<f64>,
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

/// The refusal of the shape of a guide that handle `id` does not have; `field` is the pose's.
pub(super) fn no_guide(id: &str, field: &str) -> Error {
    let problem = format!("is given, but handle \"{id}\" has no guide; a handle is set with it");
    Error::invalid(format!("{field}.guide"), problem)
}

/// Refuses a handle with targets that asks for what it cannot do.
pub(super) fn check_targets_alone(set: &HandleSet, handle: &Handle, field: &str) -> Result<(), Error> {
    if handle.targets.is_none() {
        return match handle.guide.is_some() {
            true => Err(Error::invalid(
                format!("{field}.guide"),
                "is set, but targets is not: a guide gives their places",
            )),
            false => Ok(()),
        };
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
