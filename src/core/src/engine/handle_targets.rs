//! Targets in the poses of the handles in force: checked, laid on those before, and turned into what holds are to do.

use super::error::Error;
use super::handle::HandlePose;
use super::resolved_handles::ResolvedHandles;
use super::target_vertices::{Pulls, no_guide};
use super::vertex_targets::VertexTargets;
use crate::deform::{DeformableBody, HandleConstraint, HoldTargets};
use crate::exec::Exec;
use glam::DVec3;
use std::sync::Arc;

impl ResolvedHandles {
    /// Checks the targets that handles are set with, which are of all their vertices.
    pub fn complete_targets(&mut self, rest: &[DVec3]) -> Result<(), Error> {
        for k in 0..self.set.handles.len() {
            let handle = &self.set.handles[k];
            let Some(pose) = handle
                .pose
                .clone()
                .filter(|pose| pose.targets.is_some() || pose.guide.is_some() || handle.targets.is_some())
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
        mut pose: HandlePose,
        before: Option<&HandlePose>,
        rest: &[DVec3],
        field: &str,
    ) -> Result<HandlePose, Error> {
        let id = &self.set.handles[handle].id;
        match &self.targets[handle] {
            Some(points) => points.check_guide(&pose, id, field)?,
            None if pose.guide.is_some() => return Err(no_guide(id, field)),
            None => {}
        }
        if let (Some(targets), Some(points)) = (&mut pose.targets, &self.targets[handle])
            && targets.has_one_weight()
        {
            let weight = targets.weights[0];
            Arc::make_mut(targets).weights.resize(points.vertices.len(), weight);
        }
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
            Some(_) => {
                let place = |v: &u32| (rest[*v as usize] - points.origin).as_vec3().to_array();
                points.vertices.iter().map(place).collect()
            }
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

    /// What the holds with targets are to do for poses by handle: in the rest pose without any.
    pub fn hold_targets(
        &self,
        poses: &[HandlePose],
        holds: &[HandleConstraint],
        body: &DeformableBody,
        rest: &[DVec3],
        exec: &Exec<'_>,
    ) -> Vec<HoldTargets> {
        let none = VertexTargets::default();
        let with_points = self.targets.iter().enumerate().zip(poses);
        let some = with_points.filter_map(|((hold, points), pose)| {
            let targets = pose.targets.as_deref().unwrap_or(&none);
            let points = points.as_ref()?;
            let led = points.led(pose, exec);
            let Pulls { places, weights } = points.pulls(&holds[hold], body, rest, targets, led.as_deref());
            Some(HoldTargets { hold, places, weights })
        });
        some.collect()
    }
}
