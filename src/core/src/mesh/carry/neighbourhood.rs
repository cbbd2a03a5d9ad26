//! Which samples of a surface a point follows, and how much.

use crate::mesh::carry::clusters::{CarrySurface, NearestPlace};
use crate::mesh::query::closest_point::{blend_corners, closest_weights_on_triangle};
use glam::DVec3;
use std::f64::consts::PI;

/// Nothing farther than this many times the distance of the surface is followed.
const REACH: f64 = 2.25;
/// Below this fraction of the diagonal a point lies on the surface.
const ON_SURFACE: f64 = 1e-9;
/// A cluster stands for its triangles where the diagonal of its box is below the first multiple of its distance, and its
/// children do where it is above the second; between the two both do, in shares, so that nothing jumps. What lies twice as
/// far as the surface weighs little and may be twice as coarse.
const FAR: [f64; 2] = [1.0, 1.4];
/// What a place of the surface still weighs whose outside is turned the wrong way.
const WRONG_SIDE: f64 = 0.01;

/// The samples that one point follows, reused from point to point.
#[derive(Debug, Default)]
pub(super) struct Neighbourhood {
    /// Samples in rising order, with weights that add to 1; empty without a surface.
    pub(super) samples: Vec<(u32, f64)>,
    /// Parts of surfaces that were looked at, for all points so far.
    pub(super) visits: u64,
    near: Vec<NearPart>,
    waiting: Vec<(u32, f64)>,
}

/// A part of the surface near a point: a triangle or a cluster.
#[derive(Debug, Clone, Copy)]
struct NearPart {
    part: SeenPart,
    weight: f64,
    /// How much it faces the point: 1 in front of it, −1 behind it.
    facing: f64,
}

#[derive(Debug, Clone, Copy)]
enum SeenPart {
    /// A triangle, at barycentric coordinates.
    Triangle(u32, [f64; 3]),
    /// A node of the tree.
    Cluster(u32),
}

impl Neighbourhood {
    /// Finds what `point` follows.
    pub(super) fn gather(&mut self, surface: &CarrySurface, point: DVec3) {
        self.samples.clear();
        self.near.clear();
        let Some(nearest) = surface.find_nearest(point, &mut self.visits) else {
            return;
        };
        if nearest.distance <= ON_SURFACE * surface.diagonal || !nearest.distance.is_finite() {
            self.follow_triangle(surface, nearest.triangle, nearest.corners, 1.0);
        } else {
            self.collect_near(surface, point, &nearest);
            self.share_weights(surface);
        }
        self.merge_equal();
    }

    /// Collects triangles and clusters within reach.
    fn collect_near(&mut self, surface: &CarrySurface, point: DVec3, nearest: &NearestPlace) {
        let reach = REACH * nearest.distance;
        self.waiting.clear();
        self.waiting.push((surface.nodes.len() as u32 - 1, 1.0));
        while let Some((index, share)) = self.waiting.pop() {
            self.visits += 1;
            let node = &surface.nodes[index as usize];
            let distance = node.distance_squared(point).sqrt();
            if distance >= reach {
                continue;
            }
            let merged = share * far_share(node.bounds.diagonal(), distance * (distance / nearest.distance));
            if merged > 0.0 {
                let offset = point - node.center;
                let away = offset.length().max(nearest.distance);
                self.near.push(NearPart {
                    part: SeenPart::Cluster(index),
                    weight: merged * proximity(away, nearest.distance) * seen_area(node.weight, away),
                    facing: node.normal.dot(offset) / away,
                });
            }
            let apart = share - merged;
            if apart <= 0.0 {
                continue;
            }
            let children = node.first..node.first + node.count;
            if index as usize >= surface.leaves {
                self.waiting.extend(children.rev().map(|child| (child, apart)));
                continue;
            }
            for place in children {
                let triangle = surface.order[place as usize];
                let corners = surface.corners(triangle);
                let (weights, square) = closest_weights_on_triangle(point, corners);
                let away = square.sqrt().max(nearest.distance);
                let weight = proximity(away, nearest.distance) * seen_area(surface.weights[place as usize], away);
                let normal = surface.doubled_normal(triangle).normalize_or_zero();
                if weight > 0.0 {
                    self.near.push(NearPart {
                        part: SeenPart::Triangle(triangle, weights),
                        weight: apart * weight,
                        facing: normal.dot(point - blend_corners(corners, weights)) / away,
                    });
                }
            }
        }
    }

    /// Takes weight from what faces the other way than the surface around the point does: inside a limb from the outside of
    /// its neighbour, outside of it from its far side.
    fn share_weights(&mut self, surface: &CarrySurface) {
        let (mut total, mut side) = (0.0, 0.0);
        for near in &self.near {
            total += near.weight;
            side += near.weight * near.facing;
        }
        let side = if total > 0.0 { side / total } else { 0.0 };
        for near in std::mem::take(&mut self.near) {
            let agreement = 0.5 * (1.0 + side * near.facing);
            let weight = near.weight * (WRONG_SIDE + agreement * agreement);
            match near.part {
                SeenPart::Cluster(node) => self.samples.push((surface.rest.len() as u32 + node, weight)),
                SeenPart::Triangle(triangle, corners) => self.follow_triangle(surface, triangle, corners, weight),
            }
        }
    }

    fn follow_triangle(&mut self, surface: &CarrySurface, triangle: u32, corners: [f64; 3], weight: f64) {
        let vertices = surface.triangles[triangle as usize];
        let used = vertices.into_iter().zip(corners).filter(|&(_, corner)| corner > 0.0);
        self.samples.extend(used.map(|(v, corner)| (v, weight * corner)));
    }

    /// Adds what belongs to one sample and makes the weights add to 1.
    fn merge_equal(&mut self) {
        self.samples.sort_by_key(|s| s.0);
        self.samples.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            if same {
                kept.1 += next.1;
            }
            same
        });
        let total: f64 = self.samples.iter().map(|s| s.1).sum();
        self.samples.iter_mut().for_each(|s| s.1 /= total);
    }
}

/// The share of a cluster of this size that it stands for itself, 0 to 1, where `allowed` is how large a whole one may be.
fn far_share(size: f64, allowed: f64) -> f64 {
    let [all, none] = FAR;
    let t = ((none * allowed - size) / ((none - all) * allowed)).clamp(0.0, 1.0);
    if t.is_nan() { 0.0 } else { t * t * (3.0 - 2.0 * t) }
}

/// Falls from 1 at the distance of the surface to 0, with its slope, at the reach.
fn proximity(distance: f64, nearest: f64) -> f64 {
    let end = REACH * nearest;
    let left = ((end - distance) / ((REACH - 1.0) * distance)).max(0.0);
    left * left
}

/// The area of a part as far as it lies about as near as its nearest place: all of a small one, of a large one no more than a
/// disc as wide as it is far. Cutting a triangle into smaller ones so changes little.
fn seen_area(area: f64, distance: f64) -> f64 {
    let disc = PI * distance * distance;
    area * (disc / (area + disc))
}
