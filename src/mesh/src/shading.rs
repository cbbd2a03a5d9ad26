//! Carries authored normals and tangents along with a deformation.
//!
//! Normals are not recomputed: hard edges, seams and normals that an artist bent on purpose must survive. Each shading
//! vertex (a vertex as shading sees it: one per position, normal and seam) gets the area-weighted mean of the
//! deformation gradients of the triangles that use it; the gradient's cofactor moves its normal, the gradient itself
//! moves its tangent.

use crate::query::NearestPoints;
use glam::{DMat3, DVec3, Vec3, Vec4};

/// Deformation gradients of `count` shading vertices.
///
/// `triangles` index `rest` and `deformed`; `corners` has the same shape and says which shading vertex each corner is
/// (the same slice twice when every vertex shades on its own, as in glTF). The result is `None` where every triangle
/// around the shading vertex kept its exact positions, or where there is none: such a vertex keeps its normal.
///
/// # Panics
/// When an index is out of range or the two slices differ in length; readers guarantee neither happens.
pub fn gradients(
    rest: &[DVec3],
    deformed: &[DVec3],
    triangles: &[[u32; 3]],
    corners: &[[u32; 3]],
    count: usize,
) -> Vec<Option<DMat3>> {
    assert_eq!(triangles.len(), corners.len(), "one corner triple per triangle");
    let mut sum = vec![DMat3::ZERO; count];
    let mut moved = vec![false; count];
    for (triangle, corner) in triangles.iter().zip(corners) {
        let p = triangle.map(|v| rest[v as usize]);
        let q = triangle.map(|v| deformed[v as usize]);
        let changed = p != q;
        let gradient = if changed {
            area_gradient(p, q)
        } else {
            area_gradient(p, p)
        };
        for &c in corner {
            moved[c as usize] |= changed;
            if let Some(g) = gradient {
                sum[c as usize] += g;
            }
        }
    }
    sum.iter()
        .zip(&moved)
        .map(|(&g, &m)| (m && g.is_finite() && g != DMat3::ZERO).then_some(g))
        .collect()
}

/// Pairs each of some vertices that is in no triangle with the corner of the surface that is nearest to it in the shape `rest`.
/// The normals of points and lines turn as those there do.
///
/// # Panics
/// When an index is out of range.
pub fn nearest_corners(
    rest: &[DVec3],
    triangles: &[[u32; 3]],
    vertices: impl Iterator<Item = usize>,
) -> Vec<(u32, u32)> {
    let mut used = vec![false; rest.len()];
    triangles.as_flattened().iter().for_each(|&v| used[v as usize] = true);
    let loose: Vec<usize> = vertices.filter(|&v| !used[v]).collect();
    if loose.is_empty() {
        return Vec::new();
    }
    let corners = (0u32..).zip(rest).filter(|(v, _)| used[*v as usize]);
    let corners = NearestPoints::new(corners.map(|(v, place)| (*place, v)));
    let nearest = |v: usize| Some((v as u32, corners.nearest(rest[v])?.0));
    loose.into_iter().filter_map(nearest).collect()
}

/// The gradients of a model's vertices as [`gradients`], where those of `vertices` that are in no triangle have the one of the
/// nearest corner in the shape `rest`.
///
/// # Panics
/// As [`gradients`].
pub fn gradients_of_all(
    rest: &[DVec3],
    deformed: &[DVec3],
    triangles: &[[u32; 3]],
    vertices: impl Iterator<Item = usize>,
) -> Vec<Option<DMat3>> {
    let mut found = gradients(rest, deformed, triangles, triangles, deformed.len());
    for (vertex, corner) in nearest_corners(rest, triangles, vertices) {
        found[vertex as usize] = found[corner as usize];
    }
    found
}

/// The gradient of the affine map that takes one triangle and its unit normal to the other, times twice the rest area;
/// `None` for a triangle without area.
pub fn area_gradient(p: [DVec3; 3], q: [DVec3; 3]) -> Option<DMat3> {
    // Scaled to unit edges, so that tiny and huge models neither underflow nor overflow.
    let size = (p[1] - p[0]).abs().max((p[2] - p[0]).abs()).max_element();
    if !(size > 0.0 && size.is_finite()) {
        return None;
    }
    let (e1, e2) = ((p[1] - p[0]) / size, (p[2] - p[0]) / size);
    let (f1, f2) = ((q[1] - q[0]) / size, (q[2] - q[0]) / size);
    let (n, m) = (e1.cross(e2), f1.cross(f2));
    let (unit_n, unit_m) = (n.try_normalize()?, m.normalize_or_zero());
    let rest_inverse = DMat3::from_cols(e1, e2, unit_n).inverse();
    let gradient = DMat3::from_cols(f1, f2, unit_m) * rest_inverse * (n.length() * size * size);
    gradient.is_finite().then_some(gradient)
}

/// The normal after the deformation, of unit length; the old one where the gradient has collapsed.
pub fn carry_normal(gradient: &DMat3, normal: Vec3) -> Vec3 {
    let n = normal.as_dvec3();
    (cofactor(gradient) * n).try_normalize().map_or(normal, |n| n.as_vec3())
}

/// What moves normals when the gradient moves points, scaled to entries of at most 1; zero where the gradient has
/// collapsed.
pub fn cofactor(gradient: &DMat3) -> DMat3 {
    // It needs no division, so it stays finite where the gradient is singular.
    let (a, b, c) = (gradient.x_axis, gradient.y_axis, gradient.z_axis);
    let cofactor = DMat3::from_cols(b.cross(c), c.cross(a), a.cross(b));
    let largest = cofactor
        .x_axis
        .abs()
        .max(cofactor.y_axis.abs())
        .max(cofactor.z_axis.abs())
        .max_element();
    if largest > 0.0 {
        cofactor * (1.0 / largest)
    } else {
        DMat3::ZERO
    }
}

/// The tangent after the deformation: unit length, orthogonal to `carried_normal`, with its handedness (w) kept.
pub fn carry_tangent(gradient: &DMat3, tangent: Vec4, carried_normal: Vec3) -> Vec4 {
    let n = carried_normal.as_dvec3();
    let moved = (*gradient * tangent.truncate().as_dvec3()).normalize_or_zero();
    (moved - n * n.dot(moved))
        .try_normalize()
        .map_or(tangent, |t| t.as_vec3().extend(tangent.w))
}

/// Area-weighted vertex normals, for pictures and previews of models that carry none.
pub fn smooth_normals(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut sum = vec![DVec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        let normal = (b - a).cross(c - a);
        if normal.is_finite() {
            for &v in t {
                sum[v as usize] += normal;
            }
        }
    }
    sum.iter()
        .map(|n| n.try_normalize().map_or(Vec3::Z, |n| n.as_vec3()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    fn patch() -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let points = [[0., 0., 0.], [1., 0., 0.1], [1., 1., 0.], [0., 1., 0.3]]
            .map(DVec3::from_array)
            .to_vec();
        (points, vec![[0, 1, 2], [0, 2, 3]])
    }

    #[test]
    fn a_rotation_turns_normals_and_tangents_with_it() {
        let (rest, triangles) = patch();
        let turn = DQuat::from_axis_angle(DVec3::new(1., 2., 3.).normalize(), 2.0);
        let moved: Vec<_> = rest.iter().map(|&p| turn * p + DVec3::splat(5.0)).collect();
        let normal = Vec3::new(0.2, -0.3, 0.9).normalize();
        let tangent = normal.any_orthonormal_vector().extend(-1.0);
        for g in gradients(&rest, &moved, &triangles, &triangles, 4) {
            let g = g.expect("every vertex moved");
            let carried = carry_normal(&g, normal);
            assert!((carried.as_dvec3() - turn * normal.as_dvec3()).length() < 1e-6);
            let t = carry_tangent(&g, tangent, carried);
            assert!((t.truncate().as_dvec3() - turn * tangent.truncate().as_dvec3()).length() < 1e-6);
            assert_eq!(t.w, -1.0);
        }
    }

    #[test]
    fn a_stretch_tilts_normals_the_other_way() {
        let (rest, triangles) = patch();
        let moved: Vec<_> = rest.iter().map(|p| DVec3::new(p.x * 2.0, p.y, p.z)).collect();
        let slope = {
            let n = (rest[1] - rest[0]).cross(rest[2] - rest[0]).normalize();
            let m = (moved[1] - moved[0]).cross(moved[2] - moved[0]).normalize();
            let g = gradients(&rest, &moved, &triangles[..1], &triangles[..1], 4)[1].expect("moved");
            (carry_normal(&g, n.as_vec3()).as_dvec3() - m).length()
        };
        assert!(slope < 1e-6, "a face's own normal stays normal to it, off by {slope}");
    }

    #[test]
    fn untouched_and_collapsed_places_keep_what_was_authored() {
        let (rest, triangles) = patch();
        let mut moved = rest.clone();
        moved[3].z += 1.0;
        let g = gradients(&rest, &moved, &triangles, &triangles, 4);
        assert!(g[1].is_none(), "vertex 1 is only in the triangle that stayed");
        assert!(g[0].is_some() && g[3].is_some());
        let flat = vec![DVec3::ZERO; 4];
        let normal = Vec3::X;
        for g in gradients(&rest, &flat, &triangles, &triangles, 4).into_iter().flatten() {
            assert_eq!(carry_normal(&g, normal), normal);
        }
    }
}
