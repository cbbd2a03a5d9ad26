//! Handles across an edit: regions become lists of the vertices that they held, in the new numbers.

use super::edit_command::KeptVertexRun;
use super::facts::{DeformerWarning, WarningPlace};
use super::handle::{Handle, HandleSet};
use super::pose::HandlePose;
use super::region::{Region, VertexRange};
use crate::edit::{PatchedSurface, SurfacePatch};
use crate::mesh::NONE;
use glam::DVec3;

/// The handles in force after an edit, and what became of them.
#[derive(Debug, Default)]
pub(super) struct CarriedHandles {
    /// With regions as lists.
    pub set: HandleSet,
    /// Handles that still hold something.
    pub kept: Vec<String>,
    /// Those that hold nothing any more.
    pub warnings: Vec<DeformerWarning>,
}

/// What the handles in force held before an edit.
pub(super) struct HeldVertices<'a> {
    /// The handles.
    pub set: &'a HandleSet,
    /// The render vertices of each handle, then those of the region of interest.
    pub vertices: Vec<Vec<bool>>,
    /// The default pivots.
    pub centroids: &'a [DVec3],
}

/// Carries handles over. With `poses` they keep them, turning about the same points as before; without they are at rest.
pub(super) fn carry_handles(
    held: &HeldVertices<'_>,
    poses: Option<&[HandlePose]>,
    applied: &PatchedSurface,
    patch: &SurfacePatch,
) -> CarriedHandles {
    let old = held.set;
    let mut carried = CarriedHandles::default();
    carried.set.symmetry_plane = old.symmetry_plane;
    for (k, handle) in old.handles.iter().enumerate() {
        let region = match &handle.region {
            Region::Weights(values) => carry_weights(values, applied, patch),
            // What holds nodes inside alone goes on to hold them; there are no vertices to list.
            inside if inside.is_solid() && !held.vertices[k].contains(&true) => Some(inside.clone()),
            _ => carry_vertices(&held.vertices[k], applied, patch, true),
        };
        let Some(region) = region else {
            let message = format!("handle \"{}\" has no vertex left and is gone", handle.id);
            let warning = DeformerWarning::about_handles("handle-lost", message, [k]);
            carried.warnings.push(warning);
            continue;
        };
        let pose = poses.and_then(|poses| poses.get(k)).map(|pose| HandlePose {
            pivot: pose.pivot.or(Some(held.centroids[k])),
            ..*pose
        });
        carried.kept.push(handle.id.clone());
        carried.set.handles.push(Handle {
            region,
            pose,
            ..handle.clone()
        });
    }
    if old.region_of_interest.is_some() {
        let marks = held.vertices.get(old.handles.len());
        let region = marks.and_then(|marks| carry_vertices(marks, applied, patch, false));
        if region.is_none() {
            let message =
                "the region of interest has no vertex left and is gone; what was outside of it can move from now on";
            carried.warnings.push(DeformerWarning {
                place: WarningPlace::RegionOfInterest,
                ..DeformerWarning::new("region-of-interest-lost", message, "")
            });
        }
        carried.set.region_of_interest = region;
    }
    carried
}

/// The vertices left of those marked, and the new ones between them: where all (or any) of what they are made of was marked.
fn carry_vertices(marks: &[bool], applied: &PatchedSurface, patch: &SurfacePatch, all: bool) -> Option<Region> {
    let old = applied.vertex_from_old.len();
    let marked = |v: u32| marks.get(v as usize).copied().unwrap_or(false);
    let holds = |was: u32| match patch.vertices.get((was as usize).wrapping_sub(old)) {
        None => marked(was),
        Some(new) => {
            let parts = new.of.iter().zip(&new.weights).filter(|(_, w)| **w > 0.0);
            let mut parts = parts.map(|(v, _)| *v);
            if all { parts.all(marked) } else { parts.any(marked) }
        }
    };
    let mut ranges: Vec<VertexRange> = Vec::new();
    for (now, &was) in (0u32..).zip(&applied.old_from_vertex) {
        if !holds(was) {
            continue;
        }
        match ranges.last_mut() {
            Some(last) if last.first + last.count == now => last.count += 1,
            _ => ranges.push(VertexRange { first: now, count: 1 }),
        }
    }
    (!ranges.is_empty()).then(|| Region::Vertices {
        indices: Vec::new(),
        ranges,
    })
}

fn carry_weights(values: &[f32], applied: &PatchedSurface, patch: &SurfacePatch) -> Option<Region> {
    let old = applied.vertex_from_old.len();
    let value = |v: u32| values.get(v as usize).copied().unwrap_or(0.0);
    let values: Vec<f32> = (applied.old_from_vertex.iter())
        .map(|&was| match patch.vertices.get((was as usize).wrapping_sub(old)) {
            None => value(was),
            Some(new) => {
                let parts = new.of.iter().zip(&new.weights).filter(|(_, w)| **w > 0.0);
                let sum: f32 = parts.map(|(&v, &w)| value(v) * w as f32).sum();
                sum.clamp(0.0, 1.0)
            }
        })
        .collect();
    let any = values.iter().any(|w| *w > 0.0);
    any.then_some(Region::Weights(values))
}

/// The runs of render vertices that an edit left of `old` ones.
pub(super) fn kept_vertex_runs(applied: &PatchedSurface, old: usize) -> Vec<KeptVertexRun> {
    let mut runs: Vec<KeptVertexRun> = Vec::new();
    for (was, &now) in (0u32..).zip(&applied.vertex_from_old[..old]) {
        if now == NONE {
            continue;
        }
        match runs.last_mut() {
            Some(run) if run.was + run.count == was && run.now + run.count == now => run.count += 1,
            _ => runs.push(KeptVertexRun { was, now, count: 1 }),
        }
    }
    runs
}
