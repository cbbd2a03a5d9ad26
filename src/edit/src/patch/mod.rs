//! What an edit answers: the smallest patch that does it, and how a patch becomes the next surface.
//!
//! Flat passes over the arrays: what the patch does not name is copied in runs. Vertices stay grouped by primitive; in
//! each group the old ones that are left come first, in their old order, then the new ones. Triangles likewise. Points:
//! the old ones that are left, in their old order, then the new ones.

mod resolve;
mod surface_patch;

use super::surface::SurfaceView;
use pliant_mesh::{Error, NONE};
use resolve::{ResolvedPatch, check_surface};
pub use surface_patch::{BlendedVertex, EditWarning, NewTriangle, NewVertex, PatchedSurface, SurfacePatch};

/// Applies `patch` to `surface`, whose render vertices stand in one run per primitive: run `p` starts at
/// `first_vertex[p]`.
///
/// Vertices that no triangle used before stay, but for those that the patch names. Linear in the surface, single-threaded.
///
/// # Errors
/// [`Error::Invalid`] when surface or patch break what their fields promise, [`Error::Impossible`] when no triangle
/// would be left, [`Error::TooLarge`] beyond what 32-bit numbers count.
pub fn apply_patch(
    surface: &SurfaceView<'_>,
    patch: &SurfacePatch,
    first_vertex: &[u32],
) -> Result<PatchedSurface, Error> {
    check_surface(surface, first_vertex)?;
    let resolved = ResolvedPatch::resolve_checked(surface, patch, first_vertex)?;
    let old_vertices = surface.positions.len();
    let mut applied = PatchedSurface::default();

    // Triangles, still with old corners; new ones after the old ones of their primitive.
    let kept = surface.triangles.len() - patch.removed.len();
    let total = kept + patch.triangles.len();
    if total == 0 {
        return Err(Error::impossible(
            "the edit would leave no triangle; keep a part of the surface",
            format!("all {} faces", surface.triangles.len()),
        ));
    }
    applied.triangles.reserve_exact(total);
    applied.primitive_of.reserve_exact(total);
    applied.old_from_triangle.reserve_exact(total);
    let mut fresh: Vec<u32> = (0..patch.triangles.len() as u32).collect();
    fresh.sort_by_key(|&t| patch.triangles[t as usize].primitive);
    let mut fresh = fresh.into_iter().peekable();
    let mut removed = patch.removed.iter().map(|&t| t as usize).peekable();
    let mut done = 0;
    for primitive in 0..first_vertex.len() as u32 {
        let end = done + surface.primitive_of[done..].partition_point(|&p| p <= primitive);
        while done < end {
            let stop = removed.peek().map_or(end, |&r| r.min(end));
            applied.triangles.extend_from_slice(&surface.triangles[done..stop]);
            applied.old_from_triangle.extend(done as u32..stop as u32);
            done = stop;
            if done < end && removed.next_if_eq(&done).is_some() {
                done += 1;
            }
        }
        while let Some(t) = fresh.next_if(|&t| patch.triangles[t as usize].primitive == primitive) {
            applied.triangles.push(patch.triangles[t as usize].corners);
            applied.old_from_triangle.push(NONE);
        }
        applied.primitive_of.resize(applied.triangles.len(), primitive);
    }

    let lost = lost_vertices(surface, patch, &applied.triangles)?;
    let mut lost = lost.into_iter().map(|v| v as usize).peekable();
    let mut number = vec![NONE; old_vertices + patch.vertices.len()];
    let mut order: Vec<u32> = (0..patch.vertices.len() as u32).collect();
    order.sort_by_key(|&v| patch.vertices[v as usize].primitive);
    let mut order = order.into_iter().peekable();
    let capacity = number.len();
    applied.positions.reserve_exact(capacity);
    applied.old_from_vertex.reserve_exact(capacity);
    for primitive in 0..first_vertex.len() {
        applied.first_vertex.push(applied.positions.len() as u32);
        let mut v = first_vertex[primitive] as usize;
        let end = first_vertex.get(primitive + 1).map_or(old_vertices, |&v| v as usize);
        while v < end {
            let stop = lost.peek().map_or(end, |&l| l.min(end));
            let now = applied.positions.len() as u32;
            number[v..stop].iter_mut().zip(now..).for_each(|(n, i)| *n = i);
            applied.positions.extend_from_slice(&surface.positions[v..stop]);
            applied.old_from_vertex.extend(v as u32..stop as u32);
            v = stop;
            if v < end && lost.next_if_eq(&v).is_some() {
                v += 1;
            }
        }
        while let Some(v) = order.next_if(|&v| patch.vertices[v as usize].primitive as usize == primitive) {
            number[old_vertices + v as usize] = applied.positions.len() as u32;
            applied.positions.push(patch.vertices[v as usize].position);
            applied.old_from_vertex.push(old_vertices as u32 + v);
        }
    }
    for triangle in &mut applied.triangles {
        *triangle = triangle.map(|v| number[v as usize]);
    }
    number.truncate(old_vertices);
    applied.vertex_from_old = number;
    resolved.number_points(surface, patch, &mut applied);
    Ok(applied)
}

/// The old vertices that were corners of removed triangles, or idle, and are in no triangle now, rising. Checks that all
/// new vertices are in one.
fn lost_vertices(surface: &SurfaceView<'_>, patch: &SurfacePatch, triangles: &[[u32; 3]]) -> Result<Vec<u32>, Error> {
    let old = surface.positions.len();
    let mut missing = vec![false; old + patch.vertices.len()];
    for v in patch.removed.iter().flat_map(|&t| surface.triangles[t as usize]) {
        missing[v as usize] = surface.point_of[v as usize] != NONE;
    }
    for &v in &patch.idle {
        match missing[..old].get_mut(v as usize) {
            Some(missing) => *missing = true,
            None => {
                return Err(Error::invalid(
                    "patch.idle",
                    format!("names vertex {v}, there are {old}"),
                ));
            }
        }
    }
    for (missing, vertex) in missing[old..].iter_mut().zip(&patch.vertices) {
        *missing = vertex.point != NONE;
    }
    for t in triangles {
        // Reading is cheaper than writing: few are missing.
        if t.iter().any(|&v| missing[v as usize]) {
            t.iter().for_each(|&v| missing[v as usize] = false);
        }
    }
    if let Some(idle) = missing[old..].iter().position(|&m| m) {
        return Err(Error::invalid(
            "patch.vertices",
            format!("new vertex {idle} is in no triangle"),
        ));
    }
    let lost = missing[..old].iter().zip(0u32..).filter(|(m, _)| **m);
    Ok(lost.map(|(_, v)| v).collect())
}

#[cfg(test)]
mod tests {
    use super::surface_patch::{NewTriangle, NewVertex};
    use super::*;
    use crate::topology::verify_surface;
    use glam::DVec3;

    const POSITIONS: [DVec3; 7] = [
        DVec3::new(0.0, 0.0, 0.0),
        DVec3::new(1.0, 0.0, 0.0),
        DVec3::new(1.0, 1.0, 0.0),
        DVec3::new(9.0, 9.0, 9.0),
        DVec3::new(0.0, 0.0, 0.0),
        DVec3::new(1.0, 1.0, 0.0),
        DVec3::new(0.0, 1.0, 0.0),
    ];

    /// Two triangles of a square, one in each primitive; vertex 3 is in none.
    const SQUARE: SurfaceView<'static> = SurfaceView {
        positions: &POSITIONS,
        triangles: &[[0, 1, 2], [4, 5, 6]],
        primitive_of: &[0, 1],
        point_of: &[0, 1, 2, NONE, 0, 2, 3],
        points: 4,
    };

    /// Applies a patch to the square, of which `change` says what is not empty.
    fn applied(change: impl FnOnce(&mut SurfacePatch)) -> Result<PatchedSurface, Error> {
        let mut patch = SurfacePatch::default();
        change(&mut patch);
        apply_patch(&SQUARE, &patch, &[0, 4])
    }

    fn vertex(primitive: u32, point: u32, position: DVec3, of: u32) -> NewVertex {
        NewVertex {
            primitive,
            point,
            position,
            of: [of; 3],
            weights: [1.0, 0.0, 0.0],
        }
    }

    fn triangle(primitive: u32, corners: [u32; 3]) -> NewTriangle {
        NewTriangle { primitive, corners }
    }

    #[test]
    fn an_empty_patch_changes_nothing() {
        let a = applied(|_| ()).expect("applies");
        assert_eq!(
            (&a.positions[..], &a.triangles[..]),
            (SQUARE.positions, SQUARE.triangles)
        );
        assert_eq!((&a.point_of[..], a.points), (SQUARE.point_of, 4));
        assert_eq!(
            (&a.first_vertex[..], &a.old_from_triangle[..]),
            (&[0, 4][..], &[0, 1][..])
        );
        assert_eq!(a.vertex_from_old, [0, 1, 2, 3, 4, 5, 6]);
        assert_eq!(verify_surface(&a.surface()), Ok(()));
    }

    #[test]
    fn a_split_keeps_primitives_together_and_numbers_points_after_the_old_ones() {
        // The middle of 0–2 in the first primitive's triangle only; point 1 leaves with its vertex.
        let middle = DVec3::new(0.5, 0.5, 0.0);
        let blended = NewVertex {
            of: [4, 5, 0],
            weights: [0.5, 0.5, 0.0],
            ..vertex(1, 4, middle, 4)
        };
        let a = applied(|patch| {
            patch.removed = vec![0, 1];
            patch.vertices = vec![blended, vertex(0, 4, middle, 0), vertex(0, 5, DVec3::X * 2.0, 1)];
            patch.triangles = vec![triangle(1, [4, 7, 6]), triangle(0, [0, 9, 8])];
        });
        let a = a.expect("applies");
        assert_eq!(a.old_from_vertex, [0, 3, 8, 9, 4, 6, 7]);
        assert_eq!(a.triangles, [[0, 3, 2], [4, 6, 5]]);
        assert_eq!((&a.primitive_of[..], &a.first_vertex[..]), (&[0, 1][..], &[0, 4][..]));
        assert_eq!(a.point_from_old, [0, NONE, NONE, 1]);
        assert_eq!(a.old_from_point, [0, 3, NONE, NONE]);
        assert_eq!(a.point_of, [0, NONE, 2, 3, 0, 1, 2]);
        assert_eq!(verify_surface(&a.surface()), Ok(()));
    }

    #[test]
    fn moved_and_joined_points_take_all_their_vertices_along() {
        let a = applied(|patch| (patch.moved, patch.joined) = (vec![(0, DVec3::Z)], vec![(3, 1)]));
        let a = a.expect("applies");
        assert_eq!([0, 4, 6].map(|v| a.positions[v]), [DVec3::Z, DVec3::Z, DVec3::X]);
        assert_eq!((a.points, &a.point_from_old[..]), (3, &[0, 1, 2, 1][..]));
    }

    #[test]
    fn idle_vertices_go_when_they_are_named() {
        let a = applied(|patch| patch.idle = vec![3]).expect("applies");
        assert_eq!(a.old_from_vertex, [0, 1, 2, 4, 5, 6]);
        assert_eq!((&a.triangles[..], a.points), (&[[0, 1, 2], [3, 4, 5]][..], 4));
        // One that a triangle uses is not idle, whatever is said.
        let a = applied(|patch| patch.idle = vec![2]).expect("applies");
        assert_eq!(a.positions.len(), 7);
        assert!(applied(|patch| patch.idle = vec![7]).is_err());
    }

    #[test]
    fn broken_patches_are_refused_by_name() {
        let fresh =
            |v: NewVertex| applied(|patch| (patch.vertices, patch.triangles) = (vec![v], vec![triangle(0, [0, 1, 7])]));
        let heavy = NewVertex {
            weights: [0.5, 0.2, 0.0],
            ..vertex(0, 4, DVec3::Z, 0)
        };
        for (refused, words) in [
            (applied(|patch| patch.removed = vec![1, 1]), "patch.removed"),
            (applied(|patch| patch.removed = vec![0, 1]), "no triangle"),
            (applied(|patch| patch.moved = vec![(9, DVec3::ZERO)]), "patch.moved"),
            (applied(|patch| patch.moved = vec![(0, DVec3::NAN)]), "not a place"),
            (applied(|patch| patch.joined = vec![(0, 1), (1, 2)]), "patch.joined"),
            (fresh(vertex(0, 5, DVec3::Z, 0)), "next new one"),
            (fresh(vertex(0, 4, DVec3::Z, 4)), "blended from vertex 4"),
            (fresh(vertex(7, 4, DVec3::Z, 0)), "primitive 7"),
            (fresh(vertex(0, 3, DVec3::Z, 0)), "old point 3"),
            (fresh(vertex(0, 0, DVec3::ZERO, 0)), "two are one"),
            (fresh(heavy), "sum to 0.7"),
            (
                applied(|patch| patch.triangles = vec![triangle(0, [0, 1, 3])]),
                "unused",
            ),
            (
                applied(|patch| patch.vertices = vec![vertex(0, 4, DVec3::Z, 0)]),
                "in no triangle",
            ),
        ] {
            let text = refused.expect_err(words).to_string();
            assert!(text.contains(words), "{text}");
        }
        assert!(apply_patch(&SQUARE, &SurfacePatch::default(), &[0, 9]).is_err());
        assert!(apply_patch(&SQUARE, &SurfacePatch::default(), &[0]).is_err());
    }
}
