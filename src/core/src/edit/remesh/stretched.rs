//! Where a deformed surface is stretched, and how fine its rest shape is.

use super::target::{ASPECT, STRETCH};
use crate::edit::region_mesh::RegionMesh;
use crate::edit::surface::{BitSet, SurfaceView};
use crate::edit::triangle;
use crate::mesh::NONE;
use glam::DVec3;

/// Rings of faces around stretched ones that are remeshed with them, so that lengths can change gently.
const RINGS: usize = 2;

/// Whether triangle `t` is stretched or thin.
pub(super) fn is_unfair(surface: &SurfaceView, t: u32, rest: &[DVec3]) -> bool {
    let now = surface.corner_positions(t);
    let then = surface.triangles[t as usize].map(|v| rest[v as usize]);
    let stretched = (0..3).any(|i| {
        let before = then[i].distance(then[(i + 1) % 3]);
        before > 0.0 && now[i].distance(now[(i + 1) % 3]) > STRETCH * before
    });
    stretched || triangle::aspect(now) > ASPECT
}

/// Those of `faces` that are stretched or thin, with the rings around them.
pub(super) fn find_stretched_faces(surface: &SurfaceView, faces: &[u32], rest: &[DVec3]) -> Vec<u32> {
    let needs = |&t: &u32| is_unfair(surface, t, rest);
    let mut points = BitSet::new(surface.points as usize);
    let mut any = false;
    for t in faces.iter().filter(|t| needs(t)) {
        if let Some(p) = surface.proper_points(*t) {
            p.iter().for_each(|&p| points.insert(p));
            any = true;
        }
    }
    if !any {
        return Vec::new();
    }
    let touched = |points: &BitSet| {
        let near = |t: &&u32| {
            let corners = surface.triangles[**t as usize];
            corners.iter().any(|&v| points.contains(surface.point_of[v as usize]))
        };
        faces.iter().filter(near).copied().collect::<Vec<u32>>()
    };
    let mut found = touched(&points);
    for _ in 1..RINGS {
        for v in found.iter().flat_map(|&t| surface.triangles[t as usize]) {
            let p = surface.point_of[v as usize];
            if p != NONE {
                points.insert(p);
            }
        }
        found = touched(&points);
    }
    found
}

/// The mean rest length of the edges at each point; where that is nothing, of those that are there now.
pub(super) fn rest_lengths(mesh: &RegionMesh, rest: &[DVec3]) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0, 0u32); mesh.points.len()];
    for (f, face) in mesh.faces.iter().enumerate() {
        let points = mesh.points_of(f as u32);
        let then = face.wedges.map(|w| rest[mesh.wedges[w as usize].vertex as usize]);
        for i in 0..3 {
            let j = (i + 1) % 3;
            for p in [points[i], points[j]] {
                let (before, now, count) = &mut sums[p as usize];
                *before += then[i].distance(then[j]);
                *now += mesh.edge_length(points[i], points[j]);
                *count += 1;
            }
        }
    }
    let all: f64 = sums.iter().map(|s| s.1 / f64::from(s.2.max(1))).sum::<f64>() / sums.len().max(1) as f64;
    let length = |&(before, now, count): &(f64, f64, u32)| {
        let count = f64::from(count.max(1));
        let known = |l: f64| l.is_finite() && l > 1e-3 * all;
        [before / count, now / count]
            .into_iter()
            .find(|&l| known(l))
            .unwrap_or(all)
    };
    sums.iter().map(length).collect()
}
