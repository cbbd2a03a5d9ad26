//! Targets in the poses of the handles in force: checked, laid on those before, and turned into what holds are to do.

use super::derived_structures::DerivedStructures;
use super::error::Error;
use super::handle::HandlePose;
use super::resolved_handles::ResolvedHandles;
use super::target_vertices::{WantedPlaces, no_guide};
use super::vertex_targets::VertexTargets;
use crate::deform::{HandleConstraint, HoldTargets};
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
            Arc::make_mut(targets).weights.resize(points.count() as usize, weight);
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
        let before = before.and_then(|pose| pose.targets.as_deref());
        points.check_normals(targets, before, id, field)?;
        let count = points.count() as usize;
        for (name, seen) in [
            ("positions", targets.positions.len()),
            ("weights", targets.weights.len()),
            ("normals", targets.normals.len()),
        ] {
            let fits = match targets.first {
                None => seen == count,
                Some(first) => (first as usize).checked_add(seen).is_some_and(|end| end <= count),
            };
            if seen > 0 && !fits {
                let from = targets
                    .first
                    .map_or_else(String::new, |first| format!(" from {first} on"));
                let what = points.what();
                let problem = format!("has {seen} entries{from}, but handle \"{id}\" has {count} {what}");
                return Err(Error::invalid(format!("{field}.targets.{name}"), problem));
            }
        }
        let rest: Vec<[f32; 3]> = match targets.first {
            None => Vec::new(),
            Some(_) => {
                let place = |place: DVec3| (place - points.origin).as_vec3().to_array();
                points.rest_places(rest).map(place).collect()
            }
        };
        let is_whole = targets.first.is_none() && !targets.positions.is_empty();
        let has_weights = !targets.weights.is_empty() || before.is_none_or(|b| b.weights.is_empty());
        let has_normals = !targets.normals.is_empty() || before.is_none_or(|b| b.normals.is_empty());
        if is_whole && has_weights && has_normals {
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
        derived: &DerivedStructures,
        exec: &Exec<'_>,
    ) -> Vec<HoldTargets> {
        let rest = &derived.topology().rest;
        let none = VertexTargets::default();
        let with_points = self.targets.iter().enumerate().zip(poses);
        let some = with_points.filter_map(|((hold, points), pose)| {
            let targets = pose.targets.as_deref().unwrap_or(&none);
            let points = points.as_ref()?;
            let led = points.led(pose, exec);
            let wanted = WantedPlaces {
                targets,
                led: led.as_deref(),
                rest,
            };
            Some(points.pulls(hold, &holds[hold], derived, &wanted))
        });
        some.collect()
    }
}
