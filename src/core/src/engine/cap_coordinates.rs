//! Texture coordinates of caps that edits make.
//!
//! A cap is laid out flat as it is seen from outside. All caps of one edit have one scale, with which the largest of them fits
//! between 0 and 1, and each begins at 0. Later edits blend the coordinates as they blend all else.

use crate::edit::{PatchedSurface, SurfacePatch};
use crate::mesh::Components;
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;

/// The texture coordinates of vertices of caps after an edit; `before` are those before it, empty while there are none.
pub(super) fn cap_uv_after_edit(before: &[[f32; 2]], applied: &PatchedSurface, patch: &SurfacePatch) -> Vec<[f32; 2]> {
    if before.is_empty() && patch.caps.is_empty() {
        return Vec::new();
    }
    let of = |v: u32| before.get(v as usize).copied().unwrap_or_default();
    let mean = |parts: &mut dyn Iterator<Item = (u32, f64)>| {
        let sum: DVec2 = parts.map(|(v, w)| DVec2::from_array(of(v).map(f64::from)) * w).sum();
        sum.as_vec2().to_array()
    };
    let one = |&was: &u32| match (was as usize)
        .checked_sub(before.len())
        .and_then(|k| patch.vertices.get(k))
    {
        Some(new) => mean(&mut new.parts()),
        None => match patch.blended.binary_search_by_key(&was, |b| b.vertex) {
            Ok(k) => mean(&mut patch.blended[k].parts()),
            Err(_) => of(was),
        },
    };
    let mut uv: Vec<[f32; 2]> = applied.old_from_vertex.iter().map(one).collect();
    lay_out_caps(&mut uv, applied, patch);
    uv
}

/// Lays out the caps that are new.
fn lay_out_caps(uv: &mut [[f32; 2]], applied: &PatchedSurface, patch: &SurfacePatch) {
    let is_new = |primitive: u32| patch.caps.iter().any(|cap| cap.0 == primitive);
    let triangles: Vec<[u32; 3]> = (applied.triangles.iter().zip(&applied.primitive_of))
        .filter(|(_, primitive)| is_new(**primitive))
        .map(|(t, _)| *t)
        .collect();
    if triangles.is_empty() {
        return;
    }
    let points: Vec<[u32; 3]> = triangles
        .iter()
        .map(|t| t.map(|v| applied.point_of[v as usize]))
        .collect();
    let parts = Components::of_triangles(applied.points as usize, &points);
    let mut caps: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
    for (t, p) in triangles.iter().zip(&points) {
        caps.entry(parts.of_vertex[p[0] as usize]).or_default().push(*t);
    }
    let at = |v: u32| applied.positions[v as usize];
    let mut laid: Vec<(u32, DVec2)> = Vec::new();
    let mut largest = 0.0f64;
    for cap in caps.values() {
        let area = |t: &[u32; 3]| (at(t[1]) - at(t[0])).cross(at(t[2]) - at(t[0]));
        let normal = cap.iter().map(area).sum::<DVec3>().normalize_or_zero();
        // Upright where it can be.
        let right = DVec3::Y.cross(normal);
        let right = if right.length() > 0.1 {
            right.normalize()
        } else {
            DVec3::X.reject_from(normal).normalize_or_zero()
        };
        let up = normal.cross(right);
        let flat = |v: u32| DVec2::new(at(v).dot(right), -at(v).dot(up));
        let corners = || cap.as_flattened().iter().map(|&v| flat(v));
        let (low, high) = (corners().reduce(DVec2::min), corners().reduce(DVec2::max));
        let (Some(low), Some(high)) = (low, high) else { continue };
        largest = largest.max((high - low).max_element());
        laid.extend(cap.as_flattened().iter().map(|&v| (v, flat(v) - low)));
    }
    for (v, place) in laid {
        let place = place / largest;
        uv[v as usize] = if place.is_finite() {
            place.as_vec2().to_array()
        } else {
            [0.0; 2]
        };
    }
}
