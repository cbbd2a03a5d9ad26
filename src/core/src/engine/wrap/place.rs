//! Where the target stands over the template, found by the shapes of both.

use super::normals::smooth_normals;
use super::similarity::{PlacePair, Similarity};
use super::target::{NO_NORMAL, TargetSurface};
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::graph::principal_axes;
use crate::mesh::Mesh;
use crate::mesh::query::TriangleBvh;
use glam::{DMat3, DQuat, DVec3};

/// Points of each surface that are looked at for every way round, and for the best.
const SAMPLES: usize = 250;
const MORE_SAMPLES: usize = 1000;
/// Fits for every way round, and for the best.
const FITS: usize = 8;
const MORE_FITS: usize = 20;
/// As they stand, two surfaces need only be so many times as bad together as the best way round.
const AS_THEY_STAND: f64 = 1.3;
/// Distances beyond this share of the diagonal all count as this.
const CAP: f64 = 0.1;
/// How far the scale may go from that of the sizes.
const SCALES: std::ops::RangeInclusive<f64> = 0.6..=1.7;

/// Takes the target to the template by the shapes of both, and by landmarks that are too few to say all: tries every way round
/// of their principal axes, and as they stand, by fitting closest points of each on the other.
///
/// # Errors
/// [`Error::Cancelled`].
pub(super) fn place_by_shapes(
    template: &Mesh,
    target: &TargetSurface,
    landmarks: &[PlacePair],
    exec: &Exec<'_>,
) -> Result<Similarity, Error> {
    let own = SampledSurface::of(template, exec);
    let other = SampledSurface::of_target(target, exec);
    let (own_axes, other_axes) = (principal_axes(template), principal_axes(&target.mesh));
    let scale = own.radius / other.radius;
    let start = |turn: DMat3| {
        let rotation = DQuat::from_mat3(&turn).normalize();
        Similarity {
            scale,
            rotation,
            translation: own.middle - rotation * (other.middle * scale),
        }
    };
    let ways = cube_turns()
        .into_iter()
        .map(|way| own_axes * way * other_axes.transpose());
    let pairing = Pairing {
        own: &own,
        other: &other,
        landmarks,
        cap: CAP * template.bounds().diagonal(),
        scale,
    };
    let (mut best, mut as_they_stand) = (None::<(f64, Similarity)>, f64::INFINITY);
    for (k, turn) in std::iter::once(DMat3::IDENTITY).chain(ways).enumerate() {
        exec.check()?;
        let (found, score) = pairing.fit(start(turn), SAMPLES, FITS);
        if k == 0 {
            as_they_stand = score;
        }
        // What is first stays, where others are little better.
        let allowed = if best.is_some_and(|b| b.0 == as_they_stand) {
            AS_THEY_STAND
        } else {
            1.0
        };
        if best.is_none_or(|b| score * allowed < b.0) {
            best = Some((score, found));
        }
    }
    let best = best.map_or(start(DMat3::IDENTITY), |b| b.1);
    Ok(pairing.fit(best, MORE_SAMPLES, MORE_FITS).0)
}

/// The 24 rotations that take the axes to the axes.
fn cube_turns() -> Vec<DMat3> {
    let signs = [1.0, -1.0];
    let mut turns = Vec::new();
    for order in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]] {
        for (x, y) in signs.into_iter().flat_map(|x| signs.map(|y| (x, y))) {
            let [a, b, _] = order.map(|axis| DVec3::AXES[axis]);
            let (a, b) = (a * x, b * y);
            turns.push(DMat3::from_cols(a, b, a.cross(b)));
        }
    }
    turns
}

/// A surface with some of its points.
struct SampledSurface<'a> {
    tree: TriangleBvh<'a>,
    normals: Vec<DVec3>,
    /// Vertices, those near each other beside each other.
    order: Vec<u32>,
    middle: DVec3,
    /// The root mean square distance of the surface from its middle.
    radius: f64,
}

impl<'a> SampledSurface<'a> {
    fn of(mesh: &'a Mesh, exec: &Exec<'_>) -> Self {
        Self::new(
            &mesh.positions,
            &mesh.triangles,
            smooth_normals(&mesh.positions, &mesh.triangles),
            exec,
        )
    }

    fn of_target(target: &'a TargetSurface, exec: &Exec<'_>) -> Self {
        Self::new(&target.mesh.positions, &target.seen, target.normals.clone(), exec)
    }

    fn new(positions: &'a [DVec3], triangles: &'a [[u32; 3]], normals: Vec<DVec3>, exec: &Exec<'_>) -> Self {
        let tree = TriangleBvh::build(positions, triangles, exec.pool);
        let (mut whole, mut middle, mut square) = (0.0, DVec3::ZERO, 0.0);
        for pass in 0..2 {
            for [a, b, c] in triangles.iter().map(|t| t.map(|v| positions[v as usize])) {
                let area = (b - a).cross(c - a).length();
                let at = (a + b + c) / 3.0;
                match pass {
                    0 => (whole, middle) = (whole + area, middle + at * area),
                    _ => square += at.distance_squared(middle) * area,
                }
            }
            if pass == 0 {
                middle /= f64::max(whole, f64::MIN_POSITIVE);
            }
        }
        Self {
            order: tree.vertices_in_space_order(),
            tree,
            normals,
            middle,
            radius: (square / whole.max(f64::MIN_POSITIVE)).sqrt().max(f64::MIN_POSITIVE),
        }
    }

    fn samples(&self, count: usize) -> impl Iterator<Item = usize> + '_ {
        let step = self.order.len().div_ceil(count).max(1);
        self.order.iter().step_by(step).map(|v| *v as usize)
    }
}

/// Finds pairs of closest points.
struct Pairing<'a> {
    own: &'a SampledSurface<'a>,
    other: &'a SampledSurface<'a>,
    landmarks: &'a [PlacePair],
    cap: f64,
    /// The ratio of the sizes.
    scale: f64,
}

impl Pairing<'_> {
    /// Fits so many times, and says how far both are from each other then.
    fn fit(&self, start: Similarity, samples: usize, fits: usize) -> (Similarity, f64) {
        let mut now = start;
        for _ in 0..fits {
            let (mut pairs, _) = self.pairs(&now, samples);
            if !self.landmarks.is_empty() {
                let weight = 0.5 * pairs.len() as f64 / self.landmarks.len() as f64;
                pairs.extend(self.landmarks.iter().map(|pair| PlacePair { weight, ..*pair }));
            }
            let Some(mut next) = Similarity::of_pairs(&pairs) else {
                break;
            };
            let wanted = next.scale / self.scale;
            let allowed = wanted.clamp(*SCALES.start(), *SCALES.end());
            if wanted != allowed {
                next = Similarity {
                    scale: allowed * self.scale,
                    ..next
                };
                let middle = self.other.middle;
                next.translation += now.apply(middle) - next.apply(middle);
            }
            now = next;
        }
        let mut score = self.pairs(&now, samples).1;
        for pair in self.landmarks {
            let apart = now.apply(pair.from).distance(pair.to).min(4.0 * self.cap);
            score += apart * apart / self.landmarks.len() as f64;
        }
        (now, score)
    }

    /// Pairs both ways, and the mean square of their distances, capped.
    fn pairs(&self, at: &Similarity, samples: usize) -> (Vec<PlacePair>, f64) {
        let back = at.inverse();
        let (mut pairs, mut sum, mut count) = (Vec::new(), 0.0, 0u32);
        let mut take = |from: DVec3, to: DVec3, cosine: f64| {
            let square = at.apply(from).distance_squared(to);
            let fits = square < self.cap * self.cap && cosine > 0.0;
            sum += if fits { square } else { self.cap * self.cap };
            count += 1;
            if cosine > 0.0 {
                pairs.push(PlacePair {
                    from,
                    to,
                    weight: if fits { 1.0 } else { 0.05 },
                });
            }
        };
        let cosine = |a: DVec3, b: DVec3| {
            if a == NO_NORMAL || b == NO_NORMAL {
                1.0
            } else {
                a.dot(b)
            }
        };
        for v in self.own.samples(samples) {
            let to = self.own.tree.positions()[v];
            if let Some(found) = self.other.tree.closest_point(back.apply(to)) {
                let normal = at.rotation * self.other.normals[found.vertex as usize];
                take(found.point, to, cosine(normal, self.own.normals[v]));
            }
        }
        for v in self.other.samples(samples) {
            let from = self.other.tree.positions()[v];
            if let Some(found) = self.own.tree.closest_point(at.apply(from)) {
                let normal = at.rotation * self.other.normals[v];
                take(
                    from,
                    found.point,
                    cosine(normal, self.own.normals[found.vertex as usize]),
                );
            }
        }
        (pairs, sum / f64::from(count.max(1)))
    }
}
