//! What the tests measure on surfaces before and after an edit.

use super::edit_support::*;
use glam::DVec3;
use pliant::edit::{SurfacePatch, SurfaceTopology};
use pliant::graph::WindingTree;
use pliant::pool::Pool;
use std::collections::BTreeMap;

/// All triangles.
pub fn all(model: &Model) -> Vec<u32> {
    (0..model.triangles.len() as u32).collect()
}

/// The triangles whose corners all satisfy `inside`.
pub fn region(model: &Model, inside: impl Fn(DVec3) -> bool) -> Vec<u32> {
    model.triangles_where(|t| t.iter().all(|&v| inside(model.positions[v as usize])))
}

/// The model with vertices of its own for each of its sides, as `side` finds from a face's middle; in one primitive, or
/// in one each.
pub fn with_seams(model: &Model, side: impl Fn(DVec3) -> u32, primitives: bool) -> Model {
    let mut faces: Vec<(u32, [u32; 3])> = Vec::new();
    for t in &model.triangles {
        faces.push((
            side(t.map(|v| model.positions[v as usize]).iter().sum::<DVec3>() / 3.0),
            *t,
        ));
    }
    faces.sort_by_key(|f| f.0);
    let mut numbers: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    for (side, t) in &faces {
        t.iter().for_each(|&v| {
            numbers.entry((*side, v)).or_insert(0);
        });
    }
    let mut made = Model {
        positions: Vec::new(),
        triangles: Vec::new(),
        primitive_of: Vec::new(),
        point_of: Vec::new(),
        points: model.points,
        first_vertex: vec![0],
    };
    let mut last = 0;
    for ((side, v), number) in &mut numbers {
        if primitives && *side != last {
            made.first_vertex
                .extend((last..*side).map(|_| made.positions.len() as u32));
            last = *side;
        }
        *number = made.positions.len() as u32;
        made.positions.push(model.positions[*v as usize]);
        made.point_of.push(model.point_of[*v as usize]);
    }
    for (side, t) in &faces {
        made.triangles.push(t.map(|v| numbers[&(*side, v)]));
        made.primitive_of.push(if primitives { *side } else { 0 });
    }
    made
}

/// Which of the six sides of a box about the origin a place belongs to.
pub fn box_side(p: DVec3) -> u32 {
    let axis = (0..3).max_by(|&i, &j| p[i].abs().total_cmp(&p[j].abs())).unwrap_or(0);
    2 * axis as u32 + u32::from(p[axis] > 0.0)
}

/// Asserts what every patch keeps outside its region: triangles, and the places of all points that they have.
pub fn assert_outside_kept(model: &Model, region: &[u32], patch: &SurfacePatch) {
    for t in &patch.removed {
        assert!(
            region.binary_search(t).is_ok(),
            "triangle {t} is outside the region and goes"
        );
    }
    let outside = (0..model.triangles.len() as u32).filter(|t| region.binary_search(t).is_err());
    let touched: std::collections::BTreeSet<u32> = outside
        .flat_map(|t| model.triangles[t as usize].map(|v| model.point_of[v as usize]))
        .collect();
    for (p, _) in &patch.moved {
        assert!(!touched.contains(p), "point {p} is outside the region and moves");
    }
    assert!(patch.joined.is_empty());
}

/// Asserts that blends are made of vertices of one side, and positions of one point agree bit for bit.
pub fn assert_blends(model: &Model, patch: &SurfacePatch) {
    let primitive = {
        let mut of = vec![u32::MAX; model.positions.len()];
        for (t, &p) in model.triangles.iter().zip(&model.primitive_of) {
            t.iter().for_each(|&v| of[v as usize] = p);
        }
        of
    };
    for v in &patch.vertices {
        assert!(v.position.is_finite());
        assert!(v.weights.iter().all(|w| *w >= 0.0) && (v.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(v.of.iter().all(|&o| primitive[o as usize] == v.primitive), "{v:?}");
    }
}

/// An attribute of each render vertex, carried through a patch, in the order of the result.
pub fn carry(model: &Model, patch: &SurfacePatch, values: &[DVec3]) -> Vec<DVec3> {
    let applied = pliant::edit::apply_patch(&model.surface(), patch, &model.first_vertex).expect("applies");
    let value = |&v: &u32| match (v as usize).checked_sub(values.len()) {
        None => values[v as usize],
        Some(new) => {
            let v = &patch.vertices[new];
            (0..3).map(|i| values[v.of[i] as usize] * v.weights[i]).sum()
        }
    };
    applied.old_from_vertex.iter().map(value).collect()
}

/// Longest side times perimeter over 4·√3 times the area.
pub fn aspect(t: [DVec3; 3]) -> f64 {
    let s = [t[0].distance(t[1]), t[1].distance(t[2]), t[2].distance(t[0])];
    let area = 0.5 * (t[1] - t[0]).cross(t[2] - t[0]).length();
    s[0].max(s[1]).max(s[2]) * (s[0] + s[1] + s[2]) / (4.0 * 3f64.sqrt() * area)
}

/// Corners of a triangle.
pub fn corners(model: &Model, t: u32) -> [DVec3; 3] {
    model.triangles[t as usize].map(|v| model.positions[v as usize])
}

/// The worst aspect of all triangles.
pub fn worst_aspect(model: &Model) -> f64 {
    all(model)
        .into_iter()
        .map(|t| aspect(corners(model, t)))
        .fold(0.0, f64::max)
}

/// The part of all edges whose length over `target` is in `range`.
pub fn lengths_within(model: &Model, target: f64, range: std::ops::RangeInclusive<f64>) -> f64 {
    let mut inside = 0usize;
    for t in 0..model.triangles.len() as u32 {
        let c = corners(model, t);
        inside += (0..3)
            .filter(|&i| range.contains(&(c[i].distance(c[(i + 1) % 3]) / target)))
            .count();
    }
    inside as f64 / (3 * model.triangles.len()) as f64
}

pub fn area(model: &Model) -> f64 {
    pliant::mesh::surface_area(&model.positions, &model.triangles)
}

/// What no operation may change that keeps the topology: Euler characteristic, parts, and edges and points that are not
/// manifold.
pub fn kind(t: &SurfaceTopology) -> [i64; 5] {
    let counts = [t.components, t.crowded_edges, t.twisted_edges, t.pinched_points];
    let [parts, crowded, twisted, pinched] = counts.map(|n| i64::try_from(n).expect("a count"));
    [t.euler, parts, crowded, twisted, pinched]
}

/// Mean edge length.
pub fn mean_length(model: &Model) -> f64 {
    let length = |t: u32| {
        let c = corners(model, t);
        c[0].distance(c[1]) + c[1].distance(c[2]) + c[2].distance(c[0])
    };
    all(model).into_iter().map(length).sum::<f64>() / (3 * model.triangles.len()) as f64
}

/// The least cosine between the normal of a triangle of `now` and that of the triangle of `before` that is nearest to its
/// middle; where several are as near, the one that agrees most. Needles of the original are not asked.
pub fn least_agreement(before: &Model, now: &Model, only: impl Fn(u32) -> bool) -> f64 {
    let normal = |c: [DVec3; 3]| (c[1] - c[0]).cross(c[2] - c[0]).normalize_or_zero();
    let mut least: f64 = 1.0;
    let old: Vec<[DVec3; 3]> = all(before).into_iter().map(|t| corners(before, t)).collect();
    for t in all(now).into_iter().filter(|&t| only(t)) {
        let c = corners(now, t);
        let middle = (c[0] + c[1] + c[2]) / 3.0;
        let reach = c[0].distance(c[1]).max(c[1].distance(c[2]));
        let mut near: Vec<(f64, f64)> = (old.iter())
            .filter(|o| o[0].distance(middle) < reach + o[0].distance(o[1]).max(o[0].distance(o[2])))
            .map(|o| (distance_to(middle, *o), normal(*o).dot(normal(c))))
            .collect();
        near.sort_by(|x, y| x.0.total_cmp(&y.0));
        let Some(&(nearest, _)) = near.first() else { continue };
        let best = near.iter().take_while(|n| n.0 <= nearest + 0.05 * reach).map(|n| n.1);
        least = least.min(best.fold(-1.0, f64::max));
    }
    least
}

/// How far a place is from a triangle.
pub fn distance_to(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let n = (b - a).cross(c - a);
    let inside = |u: DVec3, v: DVec3| (v - u).cross(p - u).dot(n) >= 0.0;
    if n.length() > 0.0 && inside(a, b) && inside(b, c) && inside(c, a) {
        return (p - a).dot(n).abs() / n.length();
    }
    let segment = |u: DVec3, v: DVec3| {
        let s = ((p - u).dot(v - u) / (v - u).length_squared()).clamp(0.0, 1.0);
        p.distance(u + (v - u) * s)
    };
    segment(a, b).min(segment(b, c)).min(segment(c, a))
}

/// The farthest that a corner or middle of `now` is from the surface of `before`.
pub fn deviation(before: &Model, now: &Model) -> f64 {
    let old: Vec<[DVec3; 3]> = all(before).into_iter().map(|t| corners(before, t)).collect();
    let mut farthest: f64 = 0.0;
    for t in all(now) {
        let c = corners(now, t);
        for p in [c[0], (c[0] + c[1] + c[2]) / 3.0] {
            farthest = farthest.max(old.iter().map(|o| distance_to(p, *o)).fold(f64::INFINITY, f64::min));
        }
    }
    farthest
}

/// The farthest that two surfaces are from each other, either way, at places all over their triangles.
pub fn distance_between(one: &Model, two: &Model) -> f64 {
    farthest_from(one, two).max(farthest_from(two, one))
}

/// The farthest that a place on the triangles of `from` is from those of `to`.
fn farthest_from(from: &Model, to: &Model) -> f64 {
    const STEPS: i32 = 6;
    let faces: Vec<[u32; 3]> = all(to).into_iter().map(|t| to.triangles[t as usize]).collect();
    let tree = WindingTree::build(&to.positions, &faces, &Pool::new(2).expect("threads"));
    let nearest = |p: DVec3| tree.bvh().closest_point(p).expect("a surface").distance;
    let mut farthest = 0.0f64;
    for t in all(from) {
        let [a, b, c] = corners(from, t);
        for i in 0..=STEPS {
            for j in 0..=STEPS - i {
                let (u, v) = (f64::from(i) / f64::from(STEPS), f64::from(j) / f64::from(STEPS));
                farthest = farthest.max(nearest(a * (1.0 - u - v) + b * u + c * v));
            }
        }
    }
    farthest
}
