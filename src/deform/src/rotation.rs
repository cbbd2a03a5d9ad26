//! Transforms of handles, rigid motions fitted to points, and weighted blends of rotations with any number of turns (paper
//! section 2.1).
//!
//! Rotations come as rotation vectors relative to a base, which has the weight that they leave. About one common axis the
//! blend is exp(Σ u θ), exact for any number of turns. Otherwise every vector is split: turns of half a circle and more
//! are *twists*, which happen first, about their own axes; what is shorter *swings* on top of them. A node half-way along
//! an arm that is twisted three times and bent by 90° is so turned one and a half times about the arm and then bent by
//! 45°; the sum of both vectors would spin it about an axis between the two. The split fades in with the angle, so that a
//! handle may be dragged through half a turn. Swings are taken to their Karcher mean, which does not depend on the base.

use glam::{DMat3, DQuat, DVec3};
pub use pliant_mesh::rotation::{exp_rotation, log_rotation};
use pliant_mesh::rotation::{exp_symmetric, fit_rotation, outer_product};
use std::f64::consts::PI;

/// A handle's pose in model space: x' = R S (x − pivot) + pivot + translation.
///
/// ```
/// use glam::DVec3;
/// use pliant_deform::Transform;
///
/// let quarter_turn = Transform {
///     rotation: DVec3::Z * std::f64::consts::FRAC_PI_2,
///     pivot: DVec3::X,
///     ..Transform::IDENTITY
/// };
/// let moved = quarter_turn.map()(DVec3::X * 2.0);
/// assert!(moved.distance(DVec3::new(1.0, 1.0, 0.0)) < 1e-12);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transform {
    /// Model units.
    pub translation: DVec3,
    /// Axis times angle in radians, any number of turns.
    pub rotation: DVec3,
    /// Symmetric matrix whose exponential is the scale S: logarithms on the diagonal for a scale along the axes.
    pub log_scale: DMat3,
    /// The point that scaling and rotation leave where it is.
    pub pivot: DVec3,
}

impl Transform {
    /// Leaves everything as it is.
    pub const IDENTITY: Self = Self {
        translation: DVec3::ZERO,
        rotation: DVec3::ZERO,
        log_scale: DMat3::ZERO,
        pivot: DVec3::ZERO,
    };

    /// So much of the motion, from 0, where nothing moves, to 1.
    #[must_use]
    pub fn in_part(&self, part: f64) -> Self {
        Self {
            translation: self.translation * part,
            rotation: self.rotation * part,
            log_scale: self.log_scale * part,
            pivot: self.pivot,
        }
    }

    /// Whether every point keeps its bits. A full turn is not the identity: it twists what lies between.
    pub fn is_identity(&self) -> bool {
        self.translation == DVec3::ZERO && self.rotation == DVec3::ZERO && self.log_scale == DMat3::ZERO
    }

    /// R S, the linear part.
    pub fn linear(&self) -> DMat3 {
        let rotation = DMat3::from_quat(exp_rotation(self.rotation));
        if self.log_scale == DMat3::ZERO {
            rotation
        } else {
            rotation * exp_symmetric(self.log_scale)
        }
    }

    /// The affine map as a closure, with its matrix computed once. The identity returns its argument's bits.
    pub fn map(&self) -> impl Fn(DVec3) -> DVec3 + Send + Sync + use<> {
        let (identity, linear) = (self.is_identity(), self.linear());
        let (pivot, shift) = (self.pivot, self.pivot + self.translation);
        move |p| if identity { p } else { linear * (p - pivot) + shift }
    }

    /// The transform seen in the mirror of the plane through `point` with unit normal `normal`.
    pub fn mirrored(&self, normal: DVec3, point: DVec3) -> Self {
        let reflect = |v: DVec3| v - normal * (2.0 * normal.dot(v));
        let mirror = DMat3::from_cols(reflect(DVec3::X), reflect(DVec3::Y), reflect(DVec3::Z));
        Self {
            translation: reflect(self.translation),
            // A rotation vector is axial: it changes its sign on top of the reflection.
            rotation: -reflect(self.rotation),
            log_scale: mirror * self.log_scale * mirror,
            pivot: reflect(self.pivot - point) + point,
        }
    }
}

/// Steps towards the Karcher mean from the sum of vectors; more change nothing that can be seen.
pub(crate) const KARCHER_STEPS: usize = 3;
/// Below the first angle a rotation is all swing, above the second all twist.
const TWIST: [f64; 2] = [0.7 * PI, PI];
/// Where two swings are further apart than the second angle, their mean is not safe to look for; below the first it is.
const APART: [f64; 2] = [0.75 * PI, 0.95 * PI];

/// What one rotation puts into a blend.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct SwingTwist {
    pub(crate) swing: DVec3,
    pub(crate) twist: DVec3,
}

/// A set of rotations, ready to be blended with any weights.
#[derive(Debug, Clone, Default)]
pub(crate) struct RotationBlending {
    pub(crate) parts: Vec<SwingTwist>,
    /// The swings as quaternions; empty where the Karcher mean is not looked for.
    swings: Vec<DQuat>,
    /// Whether all of them turn about one axis.
    coaxial: bool,
    /// How much of each step towards the Karcher mean is taken, 0 to 1.
    pub(crate) karcher: f64,
}

impl RotationBlending {
    /// Takes rotation vectors relative to the base.
    pub fn new(vectors: &[DVec3]) -> Self {
        if coaxial(vectors) {
            let parts = vectors.iter().map(|&twist| SwingTwist {
                swing: DVec3::ZERO,
                twist,
            });
            return Self {
                parts: parts.collect(),
                swings: Vec::new(),
                coaxial: true,
                karcher: 0.0,
            };
        }
        let parts: Vec<SwingTwist> = vectors
            .iter()
            .map(|&v| {
                let share = fade(v.length(), TWIST);
                SwingTwist {
                    swing: v * (1.0 - share),
                    twist: v * share,
                }
            })
            .collect();
        let swings: Vec<DQuat> = parts.iter().map(|p| exp_rotation(p.swing)).collect();
        let vectors: Vec<DVec3> = parts.iter().map(|p| p.swing).collect();
        let karcher = 1.0 - fade(widest(&vectors, &swings), APART);
        Self {
            coaxial: false,
            swings: if karcher > 0.0 { swings } else { Vec::new() },
            karcher,
            parts,
        }
    }

    /// The blend for weights (index of the vector, weight); the base has the rest of the weight. As a unit quaternion
    /// that depends continuously on the weights: its sign counts turns.
    pub fn at(&self, weights: &[(usize, f64)]) -> DQuat {
        let sum =
            |of: &dyn Fn(&SwingTwist) -> DVec3| weights.iter().map(|&(k, u)| of(&self.parts[k]) * u).sum::<DVec3>();
        let twist = exp_rotation(sum(&|p| p.twist));
        let start = sum(&|p| p.swing);
        if start == DVec3::ZERO && self.karcher == 0.0 {
            return twist;
        }
        let mut mean = exp_rotation(start);
        if self.karcher > 0.0 && weights.len() > 1 {
            mean = self.towards_karcher(mean, weights);
        }
        mean * twist
    }

    /// The axis that all rotations are about, of unit length; `None` if there are several.
    pub fn axis(&self) -> Option<DVec3> {
        let longest = self.parts.iter().map(|p| p.twist).fold(DVec3::ZERO, |a, b| {
            if b.length_squared() > a.length_squared() { b } else { a }
        });
        self.coaxial.then(|| longest.normalize_or(DVec3::Z))
    }

    fn towards_karcher(&self, mut mean: DQuat, weights: &[(usize, f64)]) -> DQuat {
        let base_weight = 1.0 - weights.iter().map(|w| w.1).sum::<f64>();
        for _ in 0..KARCHER_STEPS {
            let back = mean.inverse();
            let step = log_rotation(back) * base_weight
                + weights
                    .iter()
                    .map(|&(k, u)| log_rotation(back * self.swings[k]) * u)
                    .sum::<DVec3>();
            mean = (mean * exp_rotation(step * self.karcher)).normalize();
            if step.length_squared() < 1e-20 {
                break;
            }
        }
        mean
    }
}

/// Blends rotation vectors relative to a base: `terms` are (weight, vector), the base has the rest of the weight.
///
/// One term, or several about one axis: exp(Σ u θ), exact for any number of turns. The result depends continuously on
/// weights and vectors, also where one passes half a turn, and turns with them when all are turned together.
///
/// ```
/// use glam::DVec3;
/// use pliant_deform::{blend_rotations, exp_rotation, log_rotation};
///
/// // Half of three turns about one axis is one turn and a half.
/// let three_turns = DVec3::Z * 3.0 * std::f64::consts::TAU;
/// let half = blend_rotations(&[(0.5, three_turns)]);
/// assert!(log_rotation(half.inverse() * exp_rotation(three_turns * 0.5)).length() < 1e-9);
/// ```
pub fn blend_rotations(terms: &[(f64, DVec3)]) -> DQuat {
    let vectors: Vec<DVec3> = terms.iter().map(|t| t.1).collect();
    let weights: Vec<(usize, f64)> = terms.iter().map(|t| t.0).enumerate().collect();
    RotationBlending::new(&vectors).at(&weights)
}

/// From 0 at the first angle smoothly to 1 at the second.
pub fn fade(angle: f64, [from, to]: [f64; 2]) -> f64 {
    let t = ((angle - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// So many rotations have all their differences taken one by one.
const MOST_DIFFERENCES: usize = 64;

/// The largest angle between any two of the rotations and the identity, or a bound of it where that lies below [`APART`]; `turns`
/// are the rotations as quaternions.
fn widest(vectors: &[DVec3], turns: &[DQuat]) -> f64 {
    let mut lengths: Vec<f64> = vectors.iter().map(|v| v.length()).collect();
    lengths.sort_by(|a, b| b.total_cmp(a));
    let longest = lengths.first().copied().unwrap_or(0.0);
    // No two are further apart than both are from the identity together.
    let bound = longest + lengths.get(1).copied().unwrap_or(0.0);
    if bound < APART[0] * (1.0 - 1e-9) {
        return bound;
    }
    if turns.len() > MOST_DIFFERENCES {
        let pairs = turns.iter().enumerate();
        let nearest = pairs.map(|(i, a)| turns[..i].iter().map(|b| a.dot(*b).abs()).fold(1.0, f64::min));
        return longest.max(2.0 * libm::acos(nearest.fold(1.0, f64::min)));
    }
    let mut widest = longest;
    for (i, a) in turns.iter().enumerate() {
        let from_a = a.inverse();
        for b in &turns[..i] {
            widest = widest.max(log_rotation(from_a * *b).length());
        }
    }
    widest
}

/// Whether all vectors lie on one line through the origin.
fn coaxial(vectors: &[DVec3]) -> bool {
    let Some(longest) = vectors
        .iter()
        .copied()
        .reduce(|a, b| if b.length_squared() > a.length_squared() { b } else { a })
    else {
        return true;
    };
    vectors
        .iter()
        .all(|v| v.cross(longest).length() <= 1e-9 * longest.length_squared())
}

/// Finds the rigid motion that takes `rest` nearest to `deformed` in the least-squares sense.
///
/// ```
/// use glam::DVec3;
/// use pliant_deform::{exp_rotation, fit_rigid_motion};
///
/// let rest = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
/// let turned = rest.map(|p| exp_rotation(DVec3::Z) * p + DVec3::X);
/// let motion = fit_rigid_motion(&rest, &turned).map();
/// assert!(rest.iter().zip(turned).all(|(p, q)| motion(*p).distance(q) < 1e-9));
/// ```
pub fn fit_rigid_motion(rest: &[DVec3], deformed: &[DVec3]) -> Transform {
    let count = rest.len().min(deformed.len());
    if count == 0 {
        return Transform::IDENTITY;
    }
    let rest_mean = rest.iter().sum::<DVec3>() / count as f64;
    let mean = deformed.iter().sum::<DVec3>() / count as f64;
    let mut covariance = DMat3::ZERO;
    for (p, x) in rest.iter().zip(deformed) {
        covariance += outer_product(*x - mean, *p - rest_mean);
    }
    Transform {
        translation: mean - rest_mean,
        rotation: log_rotation(fit_rotation(covariance)),
        log_scale: DMat3::ZERO,
        pivot: rest_mean,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_mesh::rotation::exp_rotation;
    use std::f64::consts::TAU;

    #[test]
    fn a_mirrored_transform_moves_mirrored_points_to_mirrored_places() {
        let t = Transform {
            translation: DVec3::new(0.3, -1.0, 2.0),
            rotation: DVec3::new(0.7, 0.2, -1.9),
            log_scale: DMat3::from_diagonal(DVec3::new(0.2, -0.4, 0.1)),
            pivot: DVec3::new(1.0, 2.0, 3.0),
        };
        let (n, o) = (DVec3::new(2.0, -1.0, 2.0) / 3.0, DVec3::new(0.5, 0.5, 0.0));
        let reflect = |p: DVec3| p - n * (2.0 * n.dot(p - o));
        let (map, mirrored) = (t.map(), t.mirrored(n, o).map());
        for p in [DVec3::ZERO, DVec3::new(3.0, -2.0, 1.0)] {
            assert!((mirrored(reflect(p)) - reflect(map(p))).length() < 1e-12);
        }
    }

    /// Directions and numbers in −1 … 1 that look random and are the same every time.
    struct RandomSequence(u64);

    impl RandomSequence {
        fn number(&mut self) -> f64 {
            self.0 = self
                .0
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        }

        fn axis(&mut self) -> DVec3 {
            loop {
                let v = DVec3::new(self.number(), self.number(), self.number());
                if (0.1..1.0).contains(&v.length()) {
                    return v.normalize();
                }
            }
        }
    }

    fn angle_between(a: DQuat, b: DQuat) -> f64 {
        log_rotation(a.inverse() * b).length()
    }

    #[test]
    fn half_the_weight_turns_half_the_way_about_one_axis() {
        let v = DVec3::new(0., 0., 5.0 * PI);
        assert!(angle_between(blend_rotations(&[(0.5, v)]), exp_rotation(v * 0.5)) < 1e-9);
        let both = blend_rotations(&[(0.25, v), (0.5, v * -0.3)]);
        assert!(angle_between(both, exp_rotation(v * 0.1)) < 1e-9);
    }

    #[test]
    fn the_karcher_mean_turns_with_the_scene_and_does_not_depend_on_the_base() {
        let (a, b) = (DVec3::new(1.2, 0.1, 0.), DVec3::new(0., -0.9, 1.1));
        let scene = exp_rotation(DVec3::new(0.4, 2.0, -0.7));
        let plain = blend_rotations(&[(0.3, a), (0.4, b)]);
        let turned = blend_rotations(&[(0.3, scene * a), (0.4, scene * b)]);
        assert!(angle_between(scene * plain * scene.inverse(), turned) < 1e-9);
        let from_a = |v: DVec3| log_rotation(exp_rotation(a).inverse() * exp_rotation(v));
        let rebased = exp_rotation(a) * blend_rotations(&[(0.3, from_a(DVec3::ZERO)), (0.4, from_a(b))]);
        let plain = blend_rotations(&[(0.3, a), (0.4, b)]);
        assert!(
            angle_between(plain, rebased) < 1e-3,
            "{}",
            angle_between(plain, rebased)
        );
    }

    #[test]
    fn whole_weights_give_the_rotations_themselves() {
        let mut random = RandomSequence(7);
        for _ in 0..300 {
            let vectors = [0; 3].map(|_| random.axis() * (random.number() + 1.0) * 10.0);
            for k in 0..3 {
                let terms: Vec<_> = (0..3).map(|j| (f64::from(u8::from(j == k)), vectors[j])).collect();
                let far = angle_between(blend_rotations(&terms), exp_rotation(vectors[k]));
                assert!(far < 1e-7, "{far} for {vectors:?}");
            }
        }
    }

    #[test]
    fn a_twist_of_many_turns_carries_a_swing_instead_of_drowning_it() {
        let (twist, bend) = (DVec3::Z * (3.0 * TAU), DVec3::X * (0.5 * PI));
        // On the way from the base to the twisted and bent end: both with equal weights at every place.
        for u in [0.1, 0.25, 0.5] {
            let q = blend_rotations(&[(u, twist), (u, bend)]);
            let expected = exp_rotation(bend * u) * exp_rotation(twist * u);
            assert!(angle_between(q, expected) < 1e-9);
            // The arm's direction only bends: the twist does not turn it aside.
            assert!((angle_of(q * DVec3::Z, DVec3::Z) - u * 0.5 * PI).abs() < 1e-9);
        }
    }

    fn angle_of(a: DVec3, b: DVec3) -> f64 {
        libm::atan2(a.cross(b).length(), a.dot(b))
    }

    #[test]
    fn no_step_of_a_drag_makes_the_blend_jump() {
        let mut random = RandomSequence(3);
        let mut worst = 0.0f64;
        for _ in 0..400 {
            let (axis, others) = (
                random.axis(),
                [0; 2].map(|_| random.axis() * (random.number() + 1.0) * PI),
            );
            let weights = [0; 3].map(|_| (random.number() + 1.0) / 6.0);
            let at = |degrees: f64| {
                blend_rotations(&[
                    (weights[0], axis * degrees.to_radians()),
                    (weights[1], others[0]),
                    (weights[2], others[1]),
                ])
            };
            for degrees in [100.0, 126.0, 134.9, 171.0, 179.9, 359.9, 539.9] {
                let jump = angle_between(at(degrees), at(degrees + 0.2)).to_degrees();
                worst = worst.max(jump);
            }
        }
        // The handle itself turns by 0.2°.
        assert!(worst < 1.5, "the blend turned by {worst}°");
    }

    #[test]
    fn no_step_along_the_mesh_makes_the_blend_jump() {
        let mut random = RandomSequence(11);
        for _ in 0..100 {
            let vectors = [0; 3].map(|_| random.axis() * (random.number() + 1.0) * 2.0 * PI);
            let at = |t: f64| {
                let weights = [0.8 * t, 0.6 * (1.0 - t), 0.3 * t * (1.0 - t)];
                blend_rotations(&[0, 1, 2].map(|k| (weights[k], vectors[k])))
            };
            for k in 0..200 {
                let (a, b) = (at(f64::from(k) / 200.0), at(f64::from(k + 1) / 200.0));
                // All turn by at most 4π; a two-hundredth of the way is a few degrees.
                assert!(angle_between(a, b) < 0.35, "{} for {vectors:?}", angle_between(a, b));
                assert!(a.dot(b) > 0.0, "the sign is kept");
            }
        }
    }

    #[test]
    fn a_rigid_motion_is_found_again_and_a_mirror_image_gives_no_reflection() {
        let rest: Vec<_> = [[0., 0., 0.], [1., 0., 0.], [0., 2., 0.], [0., 0., 3.], [1., 1., 1.]]
            .map(DVec3::from_array)
            .to_vec();
        for rotation in [
            DVec3::ZERO,
            DVec3::new(0.1, 0., 0.),
            DVec3::new(1.0, -2.0, 0.5),
            DVec3::new(0., 0., 3.1),
        ] {
            let moved: Vec<_> = rest
                .iter()
                .map(|&p| exp_rotation(rotation) * p + DVec3::new(7., 8., 9.))
                .collect();
            let map = fit_rigid_motion(&rest, &moved).map();
            for (p, x) in rest.iter().zip(&moved) {
                assert!((map(*p) - *x).length() < 1e-9, "{rotation}");
            }
        }
        let mirrored: Vec<_> = rest.iter().map(|p| DVec3::new(-p.x, p.y, p.z)).collect();
        assert!((fit_rigid_motion(&rest, &mirrored).linear().determinant() - 1.0).abs() < 1e-9);
    }
}
