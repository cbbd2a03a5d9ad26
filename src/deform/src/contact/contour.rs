//! Conditions that shorten the curves in which surfaces cross, which need neither an inside nor a shape from before.
//!
//! Where an edge passes through a face, the curve of crossings goes on into the faces beside the edge. The way of the edge, seen from the
//! face, along which the curve gets shorter soonest follows from these directions (Volino and Magnenat-Thalmann, *Resolving surface
//! collisions through intersection contour minimization*, 2006). Ways are averaged along the curve, so that all of a deep crossing is
//! parted in one direction.

use super::find::{Condition, edges_through};
use glam::DVec3;
use pliant_mesh::Mesh;
use pliant_mesh::query::closest_point::closest_weights_on_triangle;
use std::collections::BTreeMap;

/// How often ways are averaged with those beside them on the curve.
const AVERAGED: usize = 400;
/// An edge meets a face at no less than this, as the cosine of the angle to its normal.
const FLATTEST: f64 = 0.1;
/// What the part along the face's normal counts, as in the publication.
const NORMAL_PART: f64 = 2.0;

/// An edge that passes through a face.
struct Passage {
    edge: [u32; 2],
    face: u32,
    place: DVec3,
    /// Where on the edge, 0 to 1.
    part: f64,
    /// Where on the face.
    weights: [f64; 3],
    /// Where the edge is to go, seen from the face; of any length.
    way: DVec3,
    /// Those beside it on the curve, with the sign that turns their ways into ways of this edge's side.
    beside: Vec<(usize, f64)>,
}

/// A piece of the curve in one pair of faces.
struct Piece {
    /// Passages at its ends, with which of the faces the edge is of.
    ends: Vec<(usize, usize)>,
    /// The corner that both faces have, where one end is.
    corner: Option<DVec3>,
}

/// Conditions of one round on pairs of faces that cross: each edge goes by `step` (model units).
pub(super) fn contour_conditions(mesh: &Mesh, at: &[DVec3], crossings: &[[u32; 2]], step: f64) -> Vec<Condition> {
    let (mut passages, pieces) = curves(mesh, at, crossings);
    for piece in &pieces {
        find_ways(mesh, at, piece, &mut passages);
    }
    for _ in 0..AVERAGED {
        let average = |passage: &Passage| {
            let beside = passage.beside.iter().map(|(k, sign)| passages[*k].way * *sign);
            (passage.way + beside.sum::<DVec3>()) / (1.0 + passage.beside.len() as f64)
        };
        let ways: Vec<DVec3> = passages.iter().map(average).collect();
        passages
            .iter_mut()
            .zip(ways)
            .for_each(|(passage, way)| passage.way = way);
    }
    let condition = |passage: &Passage| {
        let direction = passage.way.try_normalize()?;
        let ([p, q], [a, b, c], w) = (passage.edge, mesh.triangles[passage.face as usize], passage.weights);
        Some(Condition {
            nodes: [
                (p, 1.0 - passage.part),
                (q, passage.part),
                (a, -w[0]),
                (b, -w[1]),
                (c, -w[2]),
                (c, 0.0),
            ],
            direction,
            least: step,
            shift: 0.0,
            gap: 0.0,
        })
    };
    passages.iter().filter_map(condition).collect()
}

/// The passages of all pairs, and their pieces of the curve.
fn curves(mesh: &Mesh, at: &[DVec3], crossings: &[[u32; 2]]) -> (Vec<Passage>, Vec<Piece>) {
    let mut known: BTreeMap<([u32; 2], u32), usize> = BTreeMap::new();
    let mut passages: Vec<Passage> = Vec::new();
    let mut pieces = Vec::with_capacity(crossings.len());
    for pair in crossings {
        let corners = pair.map(|t| mesh.triangles[t as usize]);
        let places = corners.map(|c| c.map(|v| at[v as usize]));
        let mut ends = Vec::new();
        for side in 0..2 {
            let (face, others) = (pair[1 - side], corners[1 - side]);
            for edge in edges_through(corners[side], places[side], places[1 - side]) {
                if edge.iter().all(|v| !others.contains(v)) {
                    let k = *known.entry((edge, face)).or_insert(passages.len());
                    if k == passages.len() {
                        passages.push(Passage::of(edge, face, places[1 - side], at));
                    }
                    ends.push((k, side));
                }
            }
        }
        let shared = corners[0].iter().find(|v| corners[1].contains(v));
        let corner = shared.map(|v| at[*v as usize]);
        pieces.push(Piece { ends, corner });
    }
    (passages, pieces)
}

/// Adds what a piece of the curve says of the ways at its ends.
fn find_ways(mesh: &Mesh, at: &[DVec3], piece: &Piece, passages: &mut [Passage]) {
    let others = match (piece.ends.as_slice(), piece.corner) {
        (&[(a, own), (b, other)], _) => {
            let sign = if own == other { 1.0 } else { -1.0 };
            passages[a].beside.push((b, sign));
            passages[b].beside.push((a, sign));
            vec![passages[b].place, passages[a].place]
        }
        ([_], Some(corner)) => vec![corner],
        // Rounding has let an end go.
        _ => return,
    };
    for (&(k, _), other) in piece.ends.iter().zip(others) {
        let passage = &mut passages[k];
        let on = (other - passage.place).normalize_or_zero();
        let [a, b, c] = mesh.triangles[passage.face as usize].map(|v| at[v as usize]);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let edge = (at[passage.edge[1] as usize] - at[passage.edge[0] as usize]).normalize_or_zero();
        let slope = edge.dot(normal);
        let slope = slope.abs().max(FLATTEST).copysign(slope);
        passage.way += on - normal * (NORMAL_PART * edge.dot(on) / slope);
    }
}

impl Passage {
    fn of(edge: [u32; 2], face: u32, [a, b, c]: [DVec3; 3], at: &[DVec3]) -> Self {
        let [p, q] = edge.map(|v| at[v as usize]);
        let normal = (b - a).cross(c - a);
        let [before, behind] = [p, q].map(|end| (end - a).dot(normal));
        let part = before / (before - behind);
        let place = p.lerp(q, part);
        Self {
            edge,
            face,
            place,
            part,
            weights: closest_weights_on_triangle(place, [a, b, c]).0,
            way: DVec3::ZERO,
            beside: Vec::new(),
        }
    }
}
