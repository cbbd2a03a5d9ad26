//! Where the target stands over the template: a similarity, by landmarks or by the shapes themselves.

use super::target::{NO_NORMAL, TargetSurface};
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::graph::principal_axes;
use crate::mesh::query::TriangleBvh;
use crate::mesh::rotation::{fit_rotation, outer_product};
use crate::mesh::{Mesh, shading};
use glam::{DMat3, DQuat, DVec3};

/// Scaled, then turned, then moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Similarity {
    scale: f64,
    rotation: DQuat,
    translation: DVec3,
}

/// Two places that belong together, and what they weigh.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlacePair {
    pub from: DVec3,
    pub to: DVec3,
    pub weight: f64,
}

/// Landmarks whose second moment is a smaller share of the first are on a line, and say nothing of the turn about it.
const ON_A_LINE: f64 = 1e-3;
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

impl Similarity {
    /// Where a point goes.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        self.rotation * (p * self.scale) + self.translation
    }

    /// How a direction turns.
    pub fn turn(&self, direction: DVec3) -> DVec3 {
        self.rotation * direction
    }

    /// The way back.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        let scale = 1.0 / self.scale;
        Self {
            scale,
            rotation,
            translation: rotation * (self.translation * -scale),
        }
    }

    /// The one that takes the first places nearest to the second ones (Horn 1987); `None` where they leave the turn open.
    pub fn of_pairs(pairs: &[PlacePair]) -> Option<Self> {
        let whole: f64 = pairs.iter().map(|p| p.weight).sum();
        let mean = |of: fn(&PlacePair) -> DVec3| pairs.iter().map(|p| of(p) * p.weight).sum::<DVec3>() / whole;
        let (from, to) = (mean(|p| p.from), mean(|p| p.to));
        let mut cross = DMat3::ZERO;
        let (mut spread, mut squares) = (DMat3::ZERO, [0.0; 2]);
        for pair in pairs {
            let (a, b) = (pair.from - from, pair.to - to);
            cross += outer_product(b, a) * pair.weight;
            spread += outer_product(a, a) * pair.weight;
            squares[0] += a.length_squared() * pair.weight;
            squares[1] += b.length_squared() * pair.weight;
        }
        // The sum of the principal minors is that of the products of two moments: 0 for places on a line.
        let d = [0, 1, 2].map(|k| spread.col(k)[k]);
        let minor = |i: usize, j: usize| d[i] * d[j] - spread.col(i)[j] * spread.col(i)[j];
        let minors = minor(0, 1) + minor(1, 2) + minor(0, 2);
        if !(squares[1] > 0.0 && minors > ON_A_LINE * squares[0] * squares[0]) {
            return None;
        }
        let rotation = fit_rotation(cross);
        let scale = (squares[1] / squares[0]).sqrt();
        Some(Self {
            scale,
            rotation,
            translation: to - rotation * (from * scale),
        })
    }

    /// Takes the target to the template by the shapes of both, and by landmarks that are too few to say all: tries every way round
    /// of their principal axes, and as they stand, by fitting closest points of each on the other.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn of_shapes(
        template: &Mesh,
        target: &TargetSurface,
        landmarks: &[PlacePair],
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        let own = SampledSurface::of(template, exec);
        let other = SampledSurface::of_target(target, exec);
        let (own_axes, other_axes) = (principal_axes(template), principal_axes(&target.mesh));
        let scale = own.radius / other.radius;
        let start = |turn: DMat3| {
            let rotation = DQuat::from_mat3(&turn).normalize();
            Self {
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
        let (mut best, mut as_they_stand) = (None::<(f64, Self)>, f64::INFINITY);
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

/// Unit normals by vertex; zero where there are none.
pub(super) fn smooth_normals(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<DVec3> {
    let normals = shading::smooth_normals(positions, triangles);
    normals.into_iter().map(|n| n.as_dvec3().normalize_or_zero()).collect()
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
