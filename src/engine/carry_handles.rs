//! Handles across an edit: regions become lists of the vertices that they held, in the new numbers.

use super::region::ResolvedRegion;
use crate::edit::{Applied, Patch};
use crate::mesh::NONE;
use crate::wire::pb;
use glam::DVec3;

/// The handles in force after an edit, and what became of them.
#[derive(Debug, Default)]
pub(super) struct CarriedHandles {
    /// With regions as lists.
    pub request: pb::SetHandlesRequest,
    /// Handles that still hold something.
    pub kept: Vec<String>,
    /// Which of the old handles these are.
    pub numbers: Vec<usize>,
    /// Those that hold nothing any more.
    pub warnings: Vec<pb::Warning>,
}

/// Carries `old` over. `held` has what each handle held, then what the region of interest did; `centroids` are the default
/// pivots. With `poses` handles keep them, turning about the same points as before; without they are at rest.
pub(super) fn carry(
    old: &pb::SetHandlesRequest,
    held: &[ResolvedRegion],
    centroids: &[DVec3],
    poses: Option<&[pb::HandlePose]>,
    applied: &Applied,
    patch: &Patch,
) -> CarriedHandles {
    let mut carried = CarriedHandles {
        request: pb::SetHandlesRequest {
            handles: Vec::with_capacity(old.handles.len()),
            ..old.clone()
        },
        ..Default::default()
    };
    for (k, handle) in old.handles.iter().enumerate() {
        let region = match handle.region.as_ref().and_then(|r| r.region.as_ref()) {
            Some(pb::region::Region::Weights(weights)) => weighted(&weights.values, applied, patch),
            _ => listed(&held[k].render, applied, patch, true),
        };
        let Some(region) = region else {
            carried.warnings.push(pb::Warning {
                code: "handle-lost".into(),
                message: format!("handle \"{}\" has no vertex left and is gone", handle.id),
                r#where: format!("handles[{k}]"),
            });
            continue;
        };
        let pose = poses.and_then(|poses| poses.get(k)).map(|pose| {
            let mut pose = pose.clone();
            if pose.pivot.is_empty() {
                pose.pivot = centroids[k].to_array().to_vec();
            }
            pose
        });
        carried.kept.push(handle.id.clone());
        carried.numbers.push(k);
        carried.request.handles.push(pb::Handle {
            region: Some(pb::Region { region: Some(region) }),
            pose,
            ..handle.clone()
        });
    }
    if old.region_of_interest.is_some() {
        let region = held.get(old.handles.len());
        let region = region.and_then(|held| listed(&held.render, applied, patch, false));
        if region.is_none() {
            carried.warnings.push(pb::Warning {
                code: "region-of-interest-lost".into(),
                message:
                    "the region of interest has no vertex left and is gone; what was outside of it can move from now on"
                        .into(),
                r#where: "regionOfInterest".into(),
            });
        }
        carried.request.region_of_interest = region.map(|region| pb::Region { region: Some(region) });
    }
    carried
}

/// The vertices left of those marked, and the new ones between them: where all (or any) of what they are made of was marked.
fn listed(marks: &[bool], applied: &Applied, patch: &Patch, all: bool) -> Option<pb::region::Region> {
    let old = applied.vertex_from_old.len();
    let marked = |v: u32| marks.get(v as usize).copied().unwrap_or(false);
    let holds = |was: u32| match patch.vertices.get((was as usize).wrapping_sub(old)) {
        None => marked(was),
        Some(new) => {
            let mut parts = new
                .of
                .iter()
                .zip(&new.weights)
                .filter(|(_, w)| **w > 0.0)
                .map(|(v, _)| *v);
            if all { parts.all(marked) } else { parts.any(marked) }
        }
    };
    let mut ranges: Vec<pb::region::Range> = Vec::new();
    for (now, &was) in (0u32..).zip(&applied.old_from_vertex) {
        if !holds(was) {
            continue;
        }
        match ranges.last_mut() {
            Some(last) if last.first + last.count == now => last.count += 1,
            _ => ranges.push(pb::region::Range { first: now, count: 1 }),
        }
    }
    (!ranges.is_empty()).then(|| {
        pb::region::Region::Vertices(pb::region::Vertices {
            indices: Vec::new(),
            ranges,
        })
    })
}

fn weighted(values: &[f32], applied: &Applied, patch: &Patch) -> Option<pb::region::Region> {
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
    any.then_some(pb::region::Region::Weights(pb::region::Weights { values }))
}

/// The runs of render vertices that an edit left, for the answer to a client.
pub(super) fn runs(applied: &Applied, old: usize) -> Vec<pb::edit_result::Run> {
    let mut runs: Vec<pb::edit_result::Run> = Vec::new();
    for (was, &now) in (0u32..).zip(&applied.vertex_from_old[..old]) {
        if now == NONE {
            continue;
        }
        match runs.last_mut() {
            Some(run) if run.was + run.count == was && run.now + run.count == now => run.count += 1,
            _ => runs.push(pb::edit_result::Run { was, now, count: 1 }),
        }
    }
    runs
}
