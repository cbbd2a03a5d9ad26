//! Handles across an edit. A region that is given by place stays as it is while the rest shape stays where it is; it then holds what the
//! same handle holds when it is set after the edit. Every other region becomes the list of the vertices that it held, in the new numbers.

use crate::deform::Transform;
use crate::edit::{PatchedSurface, SurfacePatch};
use crate::engine::facts::{DeformerWarning, WarningPlace};
use crate::engine::handle::{Handle, HandlePose, HandleSet, Stiff};
use crate::engine::region::{Anchor, AnchorCorners, Region, VertexRange};
use crate::mesh::NONE;
use glam::DVec3;

/// The handles in force after an edit, and what became of them.
#[derive(Debug, Default)]
pub(super) struct CarriedHandles {
    /// The handles that still hold something.
    pub set: HandleSet,
    /// Those that hold nothing any more.
    pub warnings: Vec<DeformerWarning>,
}

/// What the handles in force held before an edit.
pub(super) struct HeldVertices<'a> {
    /// The handles.
    pub set: &'a HandleSet,
    /// The render vertices of each handle, then those of the region of interest, then those of each thing that is listed as stiff.
    pub vertices: Vec<Vec<bool>>,
    /// The default pivots.
    pub pivots: &'a [DVec3],
    /// Where a deformed shape was edited, how each handle moved its region; `None` where the rest shape stays in its place.
    pub moved: Option<Vec<Transform>>,
}

/// Carries handles over. With `poses` they keep their poses and pivots; without, they have their rest poses.
pub(super) fn carry_handles(
    held: &HeldVertices<'_>,
    poses: Option<&[HandlePose]>,
    applied: &PatchedSurface,
    patch: &SurfacePatch,
) -> CarriedHandles {
    let old = held.set;
    let mut carried = CarriedHandles::default();
    carried.set.symmetry_plane = old.symmetry_plane;
    carried.set.default_pivot = old.default_pivot;
    for (k, handle) in old.handles.iter().enumerate() {
        let region = match &handle.region {
            Region::Weights(values) => carry_weights(values, applied, patch),
            Region::Anchors(anchors) if handle.targets.is_some() => carry_anchors(anchors, applied),
            solid if solid.is_solid() && held.moved.is_none() => Some(solid.clone()),
            // It holds nodes inside alone, so there are no vertices to list.
            solid if solid.is_solid() && !held.vertices[k].contains(&true) => Some(
                (held.moved.as_ref().and_then(|moved| moved.get(k))).map_or_else(|| solid.clone(), |t| solid.moved(t)),
            ),
            _ => carry_vertices(&held.vertices[k], applied, patch, true),
        };
        let Some(region) = region else {
            carried.warnings.push(lost_handle(k, &handle.id));
            continue;
        };
        let pose = poses.and_then(|poses| poses.get(k)).map(|pose| match handle.targets {
            None => HandlePose {
                pivot: pose.pivot.or(Some(held.pivots[k])),
                ..pose.clone()
            },
            // Targets are of the vertices that were; a guide leads any.
            Some(_) => HandlePose {
                targets: None,
                ..pose.clone()
            },
        });
        carried.set.handles.push(Handle {
            region,
            pose,
            ..handle.clone()
        });
    }
    if let Some(region) = &old.region_of_interest {
        let marks = held.vertices.get(old.handles.len());
        carried.set.region_of_interest = match region.is_solid() && held.moved.is_none() {
            true => Some(region.clone()),
            false => marks.and_then(|marks| carry_vertices(marks, applied, patch, false)),
        };
        if carried.set.region_of_interest.is_none() {
            carried.warnings.push(lost_region_of_interest());
        }
    }
    carried.set.stiff = old.stiff.as_ref().map(|stiff| {
        // What an edit leaves of them has other numbers.
        let first = old.handles.len() + usize::from(old.region_of_interest.is_some());
        let regions = held.vertices[first..].iter();
        Stiff {
            primitives: Vec::new(),
            components: Vec::new(),
            regions: regions
                .filter_map(|marks| carry_vertices(marks, applied, patch, true))
                .collect(),
            ..*stiff
        }
    });
    carried
}

impl CarriedHandles {
    /// Takes out the handles of the set `old` whose regions hold nothing in the edited model (`holds_nothing`), and the region
    /// of interest where it has no vertex (`has_no_vertex`), with a warning of each.
    pub fn drop_empty(
        &mut self,
        old: &HandleSet,
        holds_nothing: impl Fn(&Region) -> bool,
        has_no_vertex: impl Fn(&Region) -> bool,
    ) {
        let Self { set, warnings } = self;
        set.handles.retain(|handle| {
            // Lists and weights are of vertices that are left.
            let is_lost = handle.region.is_solid() && holds_nothing(&handle.region);
            if is_lost {
                let was = old.handles.iter().position(|h| h.id == handle.id).unwrap_or_default();
                warnings.push(lost_handle(was, &handle.id));
            }
            !is_lost
        });
        if (set.region_of_interest.as_ref()).is_some_and(|region| region.is_solid() && has_no_vertex(region)) {
            set.region_of_interest = None;
            warnings.push(lost_region_of_interest());
        }
    }
}

fn lost_handle(number: usize, id: &str) -> DeformerWarning {
    let message = format!("handle \"{id}\" has no vertex left and is gone");
    DeformerWarning::about_handles("handle-lost", message, [number])
}

fn lost_region_of_interest() -> DeformerWarning {
    let message = "the region of interest has no vertex left and is gone; what was outside of it can move from now on";
    DeformerWarning {
        place: WarningPlace::RegionOfInterest,
        ..DeformerWarning::new("region-of-interest-lost", message, "")
    }
}

/// The vertices left of those marked, and the new ones between them: where all (or any) of what they are made of was marked.
fn carry_vertices(marks: &[bool], applied: &PatchedSurface, patch: &SurfacePatch, all: bool) -> Option<Region> {
    let old = applied.vertex_from_old.len();
    let marked = |v: u32| marks.get(v as usize).copied().unwrap_or(false);
    let holds = |was: u32| match patch.vertices.get((was as usize).wrapping_sub(old)) {
        None => marked(was),
        Some(new) => {
            let mut parts = new.parts().map(|(v, _)| v);
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

/// The anchors that have all their corners left.
fn carry_anchors(anchors: &[Anchor], applied: &PatchedSurface) -> Option<Region> {
    let carried = |anchor: &Anchor| {
        let AnchorCorners::Vertices(corners) = anchor.corners else {
            return None;
        };
        let corners = corners.map(|v| applied.vertex_from_old.get(v as usize).copied().unwrap_or(NONE));
        (!corners.contains(&NONE)).then_some(Anchor {
            corners: AnchorCorners::Vertices(corners),
            ..*anchor
        })
    };
    let left: Vec<Anchor> = anchors.iter().filter_map(carried).collect();
    (!left.is_empty()).then_some(Region::Anchors(left))
}

fn carry_weights(values: &[f32], applied: &PatchedSurface, patch: &SurfacePatch) -> Option<Region> {
    let old = applied.vertex_from_old.len();
    let value = |v: u32| values.get(v as usize).copied().unwrap_or(0.0);
    let values: Vec<f32> = (applied.old_from_vertex.iter())
        .map(|&was| match patch.vertices.get((was as usize).wrapping_sub(old)) {
            None => value(was),
            Some(new) => {
                let sum: f32 = new.parts().map(|(v, w)| value(v) * w as f32).sum();
                sum.clamp(0.0, 1.0)
            }
        })
        .collect();
    let any = values.iter().any(|w| *w > 0.0);
    any.then_some(Region::Weights(values))
}
