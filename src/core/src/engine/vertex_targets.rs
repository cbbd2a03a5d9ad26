//! Targets of single vertices: where a pose wants each vertex of a handle, and what follows for the nodes that are solved.

use super::error::Error;
use super::handle::{Handle, HandlePose, HandleSet};
use super::resolved_handles::ResolvedHandles;
use crate::deform::{DeformableBody, HandleConstraint, HoldTargets};
use crate::mesh::{Mesh, NONE};
use glam::{DVec3, Vec3};
use std::sync::Arc;

/// What the stiffness of a handle with targets is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StiffnessPer {
    /// Each vertex.
    #[default]
    Vertex,
    /// A share of 1/10000 of the area of the model: a vertex has the stiffness × 10000 × its area (a third of that of its
    /// triangles) / the area of the model. Handles then pull alike at any resolution of a surface.
    Area,
}

/// Shares of the model's area that [`StiffnessPer::Area`] counts in.
const SHARES: f64 = 10_000.0;

/// Where a pose wants vertices of a handle with targets.
///
/// ```
/// use pliant_core::engine::VertexTargets;
/// let all = VertexTargets::of([[0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]).weighted([1.0, 0.5]);
/// assert_eq!((all.first, all.positions.len()), (None, 2));
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct VertexTargets {
    /// `None`: the lists have an entry for each vertex of the handle, in the order of the model's vertices. Else they are of some
    /// of them, from this one of the handle on; the others keep what they have.
    pub first: Option<u32>,
    /// The places, model space. Empty: as before, which is at rest to begin with.
    pub positions: Vec<[f32; 3]>,
    /// What each of them weighs, 0 or more: a factor of the stiffness. Empty: as before, which is 1 to begin with.
    pub weights: Vec<f32>,
}

impl VertexTargets {
    /// Makes the targets of all vertices of a handle.
    pub fn of(positions: impl IntoIterator<Item = [f32; 3]>) -> Self {
        Self {
            positions: positions.into_iter().collect(),
            ..Self::default()
        }
    }

    /// Adds weights.
    #[must_use]
    pub fn weighted(self, weights: impl IntoIterator<Item = f32>) -> Self {
        let weights = weights.into_iter().collect();
        Self { weights, ..self }
    }

    /// Bytes held.
    pub fn byte_size(&self) -> usize {
        size_of::<Self>() + size_of_val(&self.positions[..]) + size_of_val(&self.weights[..])
    }

    /// These on top of `before`, for all vertices of a handle, whose rest positions are given.
    fn on_top_of(&self, before: Option<&Self>, rest: &[[f32; 3]]) -> Self {
        let laid = |all: Vec<_>, change: &[_]| replaced(all, change, self.first);
        let positions = match (&self.positions[..], before) {
            ([], before) => before.map_or_else(Vec::new, |b| b.positions.clone()),
            (change, _) if self.first.is_none() => change.to_vec(),
            (change, Some(b)) if !b.positions.is_empty() => laid(b.positions.clone(), change),
            (change, _) => laid(rest.to_vec(), change),
        };
        let weights = match (&self.weights[..], before) {
            ([], before) => before.map_or_else(Vec::new, |b| b.weights.clone()),
            (change, _) if self.first.is_none() => change.to_vec(),
            (change, Some(b)) if !b.weights.is_empty() => replaced(b.weights.clone(), change, self.first),
            (change, _) => replaced(vec![1.0; rest.len()], change, self.first),
        };
        Self {
            first: None,
            positions,
            weights,
        }
    }
}

/// `all` with `change` from a place on, which is within.
fn replaced<T: Copy>(mut all: Vec<T>, change: &[T], first: Option<u32>) -> Vec<T> {
    let first = first.unwrap_or(0) as usize;
    all[first..first + change.len()].copy_from_slice(change);
    all
}

/// What a handle with targets pulls.
#[derive(Debug, Clone)]
pub(super) struct TargetVertices {
    /// The render vertices of the handle, rising.
    vertices: Vec<u32>,
    /// Of each the pull of the hold; [`NONE`] of a vertex in no face.
    pull_of: Vec<u32>,
    /// By pull, the weight without those of the pose: of the region, and of its area.
    weights: Vec<f64>,
}

impl TargetVertices {
    /// The vertices that `held` marks of a handle with `pulls`, whose weights take areas in where the handle asks for that.
    pub fn of(mesh: &Mesh, held: &[bool], per: StiffnessPer, pulls: &mut [(u32, f64)]) -> Self {
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
            vertices,
        }
    }

    /// How many vertices have targets.
    pub fn count(&self) -> u32 {
        self.vertices.len() as u32
    }

    /// What the nodes are to do, where there are targets: those of several vertices of one node are averaged by weight. A target
    /// that is the rest position as it is told in single precision is the rest position.
    fn pulls(&self, hold: &HandleConstraint, body: &DeformableBody, rest: &[DVec3], targets: &VertexTargets) -> Pulls {
        let at_rest = |pull: usize| body.graph.positions[hold.pulls[pull].0 as usize];
        // By pull: the way from rest times weight, the weights, and the vertices.
        let mut sums = vec![(DVec3::ZERO, 0.0, 0u32); self.weights.len()];
        for (k, (&vertex, &pull)) in self.vertices.iter().zip(&self.pull_of).enumerate() {
            let Some(sum) = sums.get_mut(pull as usize) else {
                continue;
            };
            let weight = targets.weights.get(k).map_or(1.0, |w| f64::from(*w));
            let rest = rest[vertex as usize];
            let place = targets.positions.get(k).map(|p| Vec3::from_array(*p));
            let way = match place {
                Some(place) if place != rest.as_vec3() => place.as_dvec3() - rest,
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
        4 * (self.vertices.len() + self.pull_of.len()) + (8 + size_of::<DVec3>()) * self.weights.len()
    }
}

/// By pull of a hold.
struct Pulls {
    places: Vec<DVec3>,
    weights: Vec<f64>,
}

/// By solver vertex: its share of the model's area, times [`SHARES`].
fn shares_of_area(mesh: &Mesh) -> Vec<f64> {
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

/// Refuses a handle with targets that asks for what it cannot do.
pub(super) fn check_targets_alone(set: &HandleSet, handle: &Handle, field: &str) -> Result<(), Error> {
    if handle.targets.is_none() {
        return Ok(());
    }
    let kinds = handle.constrains;
    let problem = match handle {
        _ if handle.stiffness.is_none() => "is set, but stiffness is not: targets pull softly",
        _ if !kinds.position || kinds.rotation || kinds.scale => "is set, but constrains is not POSITION alone",
        _ if handle.rigid => "is set on a rigid handle: one of both is allowed",
        _ if handle.falloff.is_some() => "is set beside a falloff: one of both is allowed; weights may fade",
        _ if set.symmetry_plane.is_some() => "is set beside a symmetryPlane, which targets do not know",
        _ => return Ok(()),
    };
    Err(Error::invalid(format!("{field}.targets"), problem))
}

impl ResolvedHandles {
    /// Checks the targets that handles are set with, which are of all their vertices.
    pub fn complete_targets(&mut self, rest: &[DVec3]) -> Result<(), Error> {
        for k in 0..self.set.handles.len() {
            let handle = &self.set.handles[k];
            let Some(pose) = handle
                .pose
                .clone()
                .filter(|pose| pose.targets.is_some() || handle.targets.is_some())
            else {
                continue;
            };
            let field = format!("handles[{k}].pose");
            self.set.handles[k].pose = Some(self.with_targets(k, pose, None, rest, &field)?);
        }
        Ok(())
    }

    /// Checks the pose of a handle for whether it has targets, and lays them on top of those that the handle has.
    pub fn with_targets(
        &self,
        handle: usize,
        pose: HandlePose,
        before: Option<&HandlePose>,
        rest: &[DVec3],
        field: &str,
    ) -> Result<HandlePose, Error> {
        let id = &self.set.handles[handle].id;
        let (targets, points) = match (&pose.targets, &self.targets[handle]) {
            (None, None) => return Ok(pose),
            (Some(_), None) => {
                let problem = format!("are given, but handle \"{id}\" has no targets; a handle is set with them");
                return Err(Error::invalid(format!("{field}.targets"), problem));
            }
            (_, Some(_)) if pose.moves() || pose.free_rotation || pose.pivot.is_some() => {
                let problem = format!("moves as a whole, but handle \"{id}\" has targets, which are all it takes");
                return Err(Error::invalid(field, problem));
            }
            (None, Some(_)) => return Ok(pose),
            (Some(targets), Some(points)) => (targets, points),
        };
        let count = points.vertices.len();
        for (name, seen) in [
            ("positions", targets.positions.len()),
            ("weights", targets.weights.len()),
        ] {
            let fits = match targets.first {
                None => seen == count,
                Some(first) => (first as usize).checked_add(seen).is_some_and(|end| end <= count),
            };
            if seen > 0 && !fits {
                let from = targets
                    .first
                    .map_or_else(String::new, |first| format!(" from {first} on"));
                let problem = format!("has {seen} entries{from}, but handle \"{id}\" has {count} vertices");
                return Err(Error::invalid(format!("{field}.targets.{name}"), problem));
            }
        }
        let rest: Vec<[f32; 3]> = match targets.first {
            None => Vec::new(),
            Some(_) => (points.vertices.iter().map(|v| rest[*v as usize].as_vec3().to_array())).collect(),
        };
        let before = before.and_then(|pose| pose.targets.as_deref());
        let is_whole = targets.first.is_none() && !targets.positions.is_empty();
        if is_whole && (!targets.weights.is_empty() || before.is_none_or(|b| b.weights.is_empty())) {
            return Ok(pose);
        }
        let whole = targets.on_top_of(before, &rest);
        Ok(HandlePose {
            targets: Some(Arc::new(whole)),
            ..pose
        })
    }

    /// What the holds with targets are to do for poses by handle: at rest without any.
    pub fn hold_targets(
        &self,
        poses: &[HandlePose],
        holds: &[HandleConstraint],
        body: &DeformableBody,
        rest: &[DVec3],
    ) -> Vec<HoldTargets> {
        let none = VertexTargets::default();
        let with_points = self.targets.iter().enumerate().zip(poses);
        let some = with_points.filter_map(|((hold, points), pose)| {
            let targets = pose.targets.as_deref().unwrap_or(&none);
            let Pulls { places, weights } = points.as_ref()?.pulls(&holds[hold], body, rest, targets);
            Some(HoldTargets { hold, places, weights })
        });
        some.collect()
    }
}
