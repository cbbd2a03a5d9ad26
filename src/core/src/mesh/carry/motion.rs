//! How the samples of a surface have moved, turned and grown in a deformed shape, and what that does to a point.

use crate::mesh::carry::clusters::CarrySurface;
use crate::mesh::rotation::{fit_rotation, nearest_rotation, outer_product};
use crate::pool::Pool;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

/// A sample grows or shrinks by no more than this, as a natural logarithm: what has collapsed leads nothing into infinity.
const MOST_GROWTH: f64 = 14.0;
/// Where the mean of rotations is shorter than the first fraction of a rotation, they contradict each other, and below the
/// second the rotation of the whole surface says as much as they do.
const CONTRADICTION: [f64; 2] = [0.7, 0.5];

/// Where a point of rest space has been carried, and how space around it has turned and grown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CarriedFrame {
    /// Where the point is now.
    pub position: DVec3,
    /// How the space around it has turned: a rest direction `d` is now `rotation * d`. A unit quaternion.
    pub rotation: DQuat,
    /// How many times as large lengths around it are now, above 0.
    pub scale: f64,
}

/// How every sample of a [`CarrySurface`] has moved in one deformed shape.
#[derive(Debug, Clone)]
pub struct SurfaceMotion {
    samples: Vec<SampleMotion>,
    /// The rotation that fits the whole surface best.
    whole: DQuat,
}

/// The motion of a sample: of a vertex its own, of a cluster the mean over its triangles.
#[derive(Debug, Clone, Copy)]
struct SampleMotion {
    displacement: DVec3,
    /// A rotation, or a mean of rotations.
    rotation: DMat3,
    log_scale: f64,
}

impl CarriedFrame {
    /// A frame that has not moved.
    pub fn resting(position: DVec3) -> Self {
        Self {
            position,
            rotation: DQuat::IDENTITY,
            scale: 1.0,
        }
    }
}

impl SurfaceMotion {
    /// Measures how `surface` has become `current`, which has one position per vertex of the surface.
    ///
    /// # Panics
    /// When `current` is shorter than the surface has vertices.
    pub fn between(surface: &CarrySurface, current: &[DVec3], pool: &Pool) -> Self {
        let current = &current[..surface.rest.len()];
        pool.install(|| {
            let whole = whole_rotation(surface, current);
            let mut samples = vertex_motions(surface, current, whole);
            let at_leaves: Vec<SampleMotion> = surface.nodes[..surface.leaves]
                .par_iter()
                .map(|leaf| {
                    let mut sum = SampleMotion::NONE;
                    for place in leaf.first as usize..(leaf.first + leaf.count) as usize {
                        let third = surface.weights[place] / 3.0;
                        let triangle = surface.triangles[surface.order[place] as usize];
                        triangle.iter().for_each(|&v| sum.add(third, &samples[v as usize]));
                    }
                    sum.divided_by(leaf.weight)
                })
                .collect();
            samples.extend(at_leaves);
            for node in &surface.nodes[surface.leaves..] {
                let mut sum = SampleMotion::NONE;
                for child in node.first..node.first + node.count {
                    let at = surface.rest.len() + child as usize;
                    sum.add(surface.nodes[child as usize].weight, &samples[at]);
                }
                samples.push(sum.divided_by(node.weight));
            }
            Self { samples, whole }
        })
    }

    /// Carries a point that follows `samples` with weights that add to 1; `lever`: from their mean rest place to it.
    pub(super) fn carry_along(
        &self,
        point: DVec3,
        lever: DVec3,
        samples: impl Iterator<Item = (u32, f64)>,
    ) -> CarriedFrame {
        let mut sum = SampleMotion::NONE;
        samples.for_each(|(sample, weight)| sum.add(weight, &self.samples[sample as usize]));
        let rotation = self.agreed_rotation(sum.rotation);
        let scale = libm::exp(sum.log_scale);
        // To the bit, and also for a zero with a sign.
        if sum.displacement == DVec3::ZERO && rotation == DQuat::IDENTITY && scale == 1.0 {
            return CarriedFrame::resting(point);
        }
        CarriedFrame {
            position: point + sum.displacement + (rotation * lever * scale - lever),
            rotation,
            scale,
        }
    }

    /// The rotation that a mean of rotations is nearest to; where they contradict each other the whole surface has a say.
    fn agreed_rotation(&self, mean: DMat3) -> DQuat {
        let length = mean.x_axis.length_squared() + mean.y_axis.length_squared() + mean.z_axis.length_squared();
        let [clear, vague] = CONTRADICTION;
        let agreement = (length / 3.0).sqrt();
        let doubt = ((clear - agreement) / (clear - vague)).clamp(0.0, 1.0);
        if doubt > 0.0 {
            return fit_rotation(mean + DMat3::from_quat(self.whole) * (0.5 * doubt));
        }
        fit_rotation(mean)
    }
}

impl SampleMotion {
    const NONE: Self = Self {
        displacement: DVec3::ZERO,
        rotation: DMat3::ZERO,
        log_scale: 0.0,
    };

    #[inline]
    fn add(&mut self, weight: f64, other: &Self) {
        self.displacement += other.displacement * weight;
        self.rotation += other.rotation * weight;
        self.log_scale += other.log_scale * weight;
    }

    fn divided_by(self, weight: f64) -> Self {
        let part = 1.0 / weight;
        Self {
            displacement: self.displacement * part,
            rotation: self.rotation * part,
            log_scale: self.log_scale * part,
        }
    }
}

/// The rotation that fits all of the surface best; the identity where nothing has moved.
fn whole_rotation(surface: &CarrySurface, current: &[DVec3]) -> DQuat {
    let (Some(root), false) = (surface.nodes.last(), current == surface.rest) else {
        return DQuat::IDENTITY;
    };
    let mut sum = (DVec3::ZERO, DMat3::ZERO);
    for (&triangle, &weight) in surface.order.iter().zip(&surface.weights) {
        for v in surface.triangles[triangle as usize] {
            let from_center = surface.rest[v as usize] - root.center;
            sum.0 += from_center * weight;
            sum.1 += outer_product(current[v as usize] - root.center, from_center) * weight;
        }
    }
    // What the mean displacement adds is nothing: the offsets from the centre of mass add to nothing.
    fit_rotation(sum.1)
}

/// The motion of every vertex, its rotation and scale fitted to the triangles around it.
fn vertex_motions(surface: &CarrySurface, current: &[DVec3], whole: DQuat) -> Vec<SampleMotion> {
    let gradients: Vec<Option<DMat3>> = surface
        .triangles
        .par_iter()
        .zip(0u32..surface.triangles.len() as u32)
        .map(|(triangle, t)| weighted_gradient(surface.corners(t), triangle.map(|v| current[v as usize])))
        .collect();
    // Sum of gradients, sum of areas, and whether any triangle has changed.
    let mut sums = vec![(DMat3::ZERO, 0.0f64, false); surface.rest.len()];
    for (t, (triangle, gradient)) in (0u32..).zip(surface.triangles.iter().zip(&gradients)) {
        let area = 0.5 * surface.doubled_normal(t).length();
        let changed = triangle
            .iter()
            .any(|&v| current[v as usize] != surface.rest[v as usize]);
        for &v in triangle {
            let sum = &mut sums[v as usize];
            sum.2 |= changed;
            if let Some(gradient) = gradient {
                sum.0 += *gradient;
                sum.1 += area;
            }
        }
    }
    let motion = |((&rest, &now), &(gradient, area, changed)): ((&DVec3, &DVec3), &(DMat3, f64, bool))| {
        if !changed {
            return SampleMotion {
                rotation: DMat3::IDENTITY,
                ..SampleMotion::NONE
            };
        }
        let rotation = DMat3::from_quat(if area > 0.0 {
            turning_part(gradient, whole)
        } else {
            whole
        });
        // The uniform scale that fits best beside that rotation.
        let stretch = rotation.transpose() * gradient;
        let scale = (stretch.x_axis.x + stretch.y_axis.y + stretch.z_axis.z) / (3.0 * area);
        let log_scale = if area > 0.0 && scale > 0.0 {
            libm::log(scale)
        } else {
            0.0
        };
        SampleMotion {
            displacement: now - rest,
            rotation,
            log_scale: log_scale.clamp(-MOST_GROWTH, MOST_GROWTH),
        }
    };
    surface.rest.par_iter().zip(current).zip(&sums).map(motion).collect()
}

/// The rotational part of a gradient. Newton's steps from a guess are faster than an eigenvector, and safe near it.
fn turning_part(gradient: DMat3, guess: DQuat) -> DQuat {
    let turned = DMat3::from_quat(guess).transpose() * gradient;
    let size = turned.x_axis.length() + turned.y_axis.length() + turned.z_axis.length();
    let trace = turned.x_axis.x + turned.y_axis.y + turned.z_axis.z;
    // Close to the guess: less than about 60 degrees of a plain rotation.
    if trace > 0.66 * size {
        nearest_rotation(gradient, guess)
    } else {
        fit_rotation(gradient)
    }
}

/// The gradient of the similarity-like map that takes one triangle to another, times the first one's area: in its plane the
/// affine map, across it the normal, grown by the root of the ratio of areas. Nothing is divided by the height of a thin
/// triangle. `None` for a triangle without rest area.
fn weighted_gradient(rest: [DVec3; 3], now: [DVec3; 3]) -> Option<DMat3> {
    let (e1, e2) = (rest[1] - rest[0], rest[2] - rest[0]);
    let (f1, f2) = (now[1] - now[0], now[2] - now[0]);
    let (n, m) = (e1.cross(e2), f1.cross(f2));
    let unit = n.try_normalize()?;
    let across = m.normalize_or_zero() * (n.length() * m.length()).sqrt();
    let gradient = outer_product(f1, e2.cross(unit)) + outer_product(f2, unit.cross(e1)) + outer_product(across, unit);
    gradient.is_finite().then_some(gradient * 0.5)
}
