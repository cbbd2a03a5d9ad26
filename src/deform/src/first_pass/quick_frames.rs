//! Frames of all nodes many times a second, in single precision.
//!
//! About one axis they are made from three matrices and a polynomial. About several axes nodes go side by side through what
//! [`PoseBlend`] does with one after the other: polynomials take the place of sines and arcs, which are nearly all of its time.

use crate::field_terms::FieldTerms;
use crate::first_pass::blend::PoseBlend;
use crate::rotation::KARCHER_STEPS;
use glam::{DMat3, DQuat, DVec3, Mat3, Quat, Vec4};
use pliant_mesh::rotation::exp_rotation;
use pliant_solver::{MapColumns, prefetch};
use std::f64::consts::{FRAC_2_PI, FRAC_PI_2};

/// Nodes that go side by side, one in each lane.
pub(crate) const SIDE_BY_SIDE: usize = 4;
/// The identity.
const STILL: MapColumns = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
/// Steps towards the mean rotation end where none is longer than the root of this, in radians.
const SHORT_STEP: f32 = 1e-14;

/// π/2 less its nearest double.
const FRAC_PI_2_REST: f64 = 6.123_233_995_736_766e-17;

/// Angles beyond this many radians, which no hand turns, are left to the library.
const FARTHEST: f64 = 1e6;

/// Added to a double and taken off again, leaves the nearest whole number.
const ROUNDING: f64 = 6_755_399_441_055_744.0;

/// The frames of a pose.
pub(crate) struct QuickFrames<'a> {
    blend: PoseBlend<'a>,
    axes: Axes<'a>,
}

/// What the handles turn about.
enum Axes<'a> {
    One(OneAxisFrames<'a>),
    Several(SeveralAxesFrames),
}

/// Frames about one axis: a base, and what sine and 1 − cosine of an angle add to it (Rodrigues).
struct OneAxisFrames<'a> {
    /// Angles in radians.
    terms: FieldTerms<'a, f64>,
    matrices: [MapColumns; 3],
}

/// Frames about several axes, or with scales.
struct SeveralAxesFrames {
    /// Of each rotation.
    turns: Vec<SplitTurn>,
    /// What the blend is turned by in the end; `None` for the identity.
    base: Option<Quat>,
    /// Whether any rotation has a twist.
    twists: bool,
    /// How much of each step towards the mean is taken; 0 where none is.
    karcher: f32,
}

/// A rotation in parts: what happens first, by its vector, then the swing, by its vector and as a unit quaternion.
#[derive(Clone, Copy)]
struct SplitTurn {
    twist: DVec3,
    swing: [f32; 3],
    turn: [f32; 4],
}

/// Frames of nodes side by side, and memory for making them.
pub(crate) struct NodeFrames {
    frames: [MapColumns; SIDE_BY_SIDE],
    terms: Vec<BlockTerm>,
}

/// One rotation for each of the nodes side by side, by its number, its swing as a vector and as a unit quaternion, and its share there.
struct BlockTerm {
    number: [u32; SIDE_BY_SIDE],
    swing: [Vec4; 3],
    turn: [Vec4; 4],
    share: Vec4,
}

impl Default for NodeFrames {
    fn default() -> Self {
        Self {
            frames: [STILL; SIDE_BY_SIDE],
            terms: Vec::new(),
        }
    }
}

impl<'a> QuickFrames<'a> {
    pub fn new(blend: PoseBlend<'a>) -> Self {
        let rotations = &blend.rotations;
        let axis = rotations.blending.axis().filter(|_| blend.is_unscaled());
        let axes = match axis {
            Some(axis) => Axes::One(OneAxisFrames {
                matrices: about_axis(rotations.base, axis),
                terms: FieldTerms::new(rotations.fields, {
                    (rotations.terms.iter()).map(|t| (t.hold, t.vector.dot(axis)))
                }),
            }),
            None => {
                let parts = rotations.blending.parts.iter().map(|part| SplitTurn {
                    twist: part.twist,
                    swing: part.swing.as_vec3().to_array(),
                    turn: exp_rotation(part.swing).as_quat().to_array(),
                });
                Axes::Several(SeveralAxesFrames {
                    turns: parts.collect(),
                    base: rotations.turned_base.then(|| rotations.base.as_quat()),
                    twists: rotations.blending.parts.iter().any(|part| part.twist != DVec3::ZERO),
                    karcher: rotations.blending.karcher as f32,
                })
            }
        };
        Self { blend, axes }
    }

    /// The frames of nodes, in memory of `block`; that of a number that names none is of no use.
    #[inline(always)]
    pub fn of<'b>(&self, nodes: &[u32; SIDE_BY_SIDE], block: &'b mut NodeFrames) -> &'b [MapColumns; SIDE_BY_SIDE] {
        match &self.axes {
            Axes::One(frames) => frames.fill(&self.blend, nodes, block),
            Axes::Several(frames) => frames.fill(&self.blend, nodes, block),
        }
        &block.frames
    }

    /// Asks memory for what the frames of nodes are made from.
    #[inline(always)]
    pub fn prefetch(&self, nodes: &[u32; SIDE_BY_SIDE]) {
        if !self.blend.covers_all {
            (nodes.iter()).for_each(|&node| prefetch(self.blend.component, node as usize));
        }
        match &self.axes {
            Axes::One(frames) => frames.terms.prefetch(nodes),
            Axes::Several(_) => self.blend.rotations.numbers.prefetch(nodes),
        }
    }
}

/// Matrices of which the first, with the sine of an angle times the second and 1 less its cosine times the third, is the turn by that
/// angle about an axis, and after it the base.
fn about_axis(base: DQuat, DVec3 { x, y, z }: DVec3) -> [MapColumns; 3] {
    let across = DMat3::from_cols_array(&[0.0, z, -y, -z, 0.0, x, y, -x, 0.0]);
    let base = DMat3::from_quat(base);
    [base, base * across, base * across * across].map(|m| columns(&m.as_mat3()))
}

impl OneAxisFrames<'_> {
    /// As [`SeveralAxesFrames::fill`].
    #[inline(always)]
    fn fill(&self, blend: &PoseBlend<'_>, nodes: &[u32; SIDE_BY_SIDE], block: &mut NodeFrames) {
        let mut angles = [0.0; SIDE_BY_SIDE];
        (self.terms).each_beside(nodes, |lane, share, whole| {
            angles[lane] += f64::from(share).max(0.0) * whole
        });
        let (sines, cosines) = sin_cos(angles);
        let [base, by_sine, by_rest] = self
            .matrices
            .map(|[a, b, c]| [Vec4::from_array(a), Vec4::from_array(b), Vec4::from_array(c)]);
        for lane in 0..SIDE_BY_SIDE {
            let (sine, rest) = (sines[lane] as f32, (1.0 - cosines[lane]) as f32);
            for k in 0..3 {
                block.frames[lane][k] = (base[k] + by_sine[k] * sine + by_rest[k] * rest).to_array();
            }
            if !blend.covers(nodes[lane]) {
                block.frames[lane] = STILL;
            }
        }
    }
}

impl SeveralAxesFrames {
    /// Makes the frames of nodes; a number that names none is passed over.
    fn fill(&self, blend: &PoseBlend<'_>, nodes: &[u32; SIDE_BY_SIDE], block: &mut NodeFrames) {
        self.gather(blend, nodes, &mut block.terms);
        let (mut start, mut base_share) = ([Vec4::ZERO; 3], Vec4::splat(1.0));
        let mut twists = [DVec3::ZERO; SIDE_BY_SIDE];
        for term in &block.terms {
            base_share -= term.share;
            start
                .iter_mut()
                .zip(&term.swing)
                .for_each(|(sum, part)| *sum += *part * term.share);
            for (lane, twist) in twists.iter_mut().enumerate().filter(|_| self.twists) {
                *twist += self.turns[term.number[lane] as usize].twist * f64::from(term.share[lane]);
            }
        }
        let mut mean = exp_vectors(&start);
        if self.karcher > 0.0 {
            self.step_to_mean(&mut mean, base_share, &block.terms);
        }
        for (lane, out) in block.frames.iter_mut().enumerate() {
            let node = nodes.get(lane).map_or(usize::MAX, |node| *node as usize);
            if node >= blend.component.len() {
                continue;
            }
            let [x, y, z, w] = mean.map(|part| part[lane]);
            let mut turn = Quat::from_xyzw(x, y, z, w);
            if twists[lane] != DVec3::ZERO {
                turn *= exp_rotation(twists[lane]).as_quat();
            }
            if let Some(base) = self.base.filter(|_| blend.is_covered(node)) {
                turn = base * turn;
            }
            let map = Mat3::from_quat(turn);
            let scale = blend.scale(node);
            *out = columns(&scale.map_or(map, |scale| map * scale.as_mat3()));
        }
    }

    /// Replaces `terms` by the rotations that have a share at any of the nodes.
    fn gather(&self, blend: &PoseBlend<'_>, nodes: &[u32; SIDE_BY_SIDE], terms: &mut Vec<BlockTerm>) {
        terms.clear();
        match &blend.rotations.numbers {
            FieldTerms::Whole(fields) => {
                for &(field, number) in fields {
                    let mut term = BlockTerm::of(number as u32, &self.turns[number]);
                    for (lane, &node) in nodes.iter().enumerate().filter(|(_, node)| blend.covers(**node)) {
                        term.share[lane] = field.get(node as usize).map_or(0.0, |share| share.max(0.0));
                    }
                    if term.share != Vec4::ZERO {
                        terms.push(term);
                    }
                }
            }
            FieldTerms::Sparse(..) => {
                for (lane, &node) in nodes.iter().enumerate().filter(|(_, node)| blend.covers(**node)) {
                    let mut count = 0;
                    blend.rotations.numbers.each_at(node as usize, |share, &number| {
                        let turn = &self.turns[number];
                        if terms.len() == count {
                            terms.push(BlockTerm::of(number as u32, turn));
                        }
                        terms[count].set(lane, number as u32, turn, share.max(0.0));
                        count += 1;
                    });
                }
            }
        }
    }

    /// Steps from the sum of vectors towards the Karcher mean, as [`RotationBlending`](crate::rotation::RotationBlending) does.
    fn step_to_mean(&self, mean: &mut [Vec4; 4], base_share: Vec4, terms: &[BlockTerm]) {
        for _ in 0..KARCHER_STEPS {
            let [x, y, z, w] = *mean;
            let back = [Vec4::ZERO - x, Vec4::ZERO - y, Vec4::ZERO - z, w];
            let mut step = [Vec4::ZERO; 3];
            add_logarithms(&back, base_share, &mut step);
            for term in terms {
                add_logarithms(&product(&back, &term.turn), term.share, &mut step);
            }
            let lengths = step[0] * step[0] + step[1] * step[1] + step[2] * step[2];
            let step = step.map(|part| part * self.karcher);
            *mean = normalized(&product(mean, &exp_vectors(&step)));
            if lengths.max_element() < SHORT_STEP {
                break;
            }
        }
    }
}

impl BlockTerm {
    /// One rotation for all, without shares.
    fn of(number: u32, turn: &SplitTurn) -> Self {
        Self {
            number: [number; SIDE_BY_SIDE],
            swing: turn.swing.map(Vec4::splat),
            turn: turn.turn.map(Vec4::splat),
            share: Vec4::ZERO,
        }
    }

    fn set(&mut self, lane: usize, number: u32, turn: &SplitTurn, share: f32) {
        self.number[lane] = number;
        self.share[lane] = share;
        (0..3).for_each(|c| self.swing[c][lane] = turn.swing[c]);
        (0..4).for_each(|c| self.turn[c][lane] = turn.turn[c]);
    }
}

/// Sums parts times rising powers.
#[inline(always)]
fn polynomial<const PARTS: usize>(parts: &[f32; PARTS], of: Vec4) -> Vec4 {
    let rest = parts[..PARTS - 1].iter().rev();
    rest.fold(Vec4::splat(parts[PARTS - 1]), |sum, part| sum * of + Vec4::splat(*part))
}

/// Products of unit quaternions x, y, z, w.
#[inline(always)]
fn product([ax, ay, az, aw]: &[Vec4; 4], [bx, by, bz, bw]: &[Vec4; 4]) -> [Vec4; 4] {
    [
        *aw * *bx + *ax * *bw + *ay * *bz - *az * *by,
        *aw * *by - *ax * *bz + *ay * *bw + *az * *bx,
        *aw * *bz + *ax * *by - *ay * *bx + *az * *bw,
        *aw * *bw - *ax * *bx - *ay * *by - *az * *bz,
    ]
}

#[inline(always)]
fn normalized(q: &[Vec4; 4]) -> [Vec4; 4] {
    let squares = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    let per_length = squares.map(|square| 1.0 / square.sqrt());
    q.map(|part| part * per_length)
}

/// Twice the arc cosine of 1 − t by the root of t (2 − t), which takes the vector part of a unit quaternion with the real part 1 − t to
/// its rotation vector: interpolated at ten Chebyshev nodes of 0 ≤ t ≤ 1, off by less than 4e-8.
const ARC: [f32; 10] = [
    2.0,
    0.666_670_76,
    0.266_533_14,
    0.115_955_606,
    0.040_326_98,
    0.060_118_355,
    -0.067_106,
    0.101_951_52,
    -0.065_183_38,
    0.022_325_65,
];

/// Adds the rotation vectors of unit quaternions times their shares.
#[inline(always)]
fn add_logarithms(turn: &[Vec4; 4], share: Vec4, sum: &mut [Vec4; 3]) {
    let arc = polynomial(&ARC, Vec4::splat(1.0) - turn[3].abs());
    // Both signs are the same rotation.
    let signed = arc.copysign(turn[3]);
    let factor = signed * share;
    sum.iter_mut().zip(turn).for_each(|(sum, part)| *sum += *part * factor);
}

/// The unit quaternions of rotation vectors, of no more than half a turn: Taylor series of sine and cosine in the square of the half
/// angle s, off by less than (π/2)¹⁴ / 14! < 7e-9.
#[inline(always)]
fn exp_vectors(vectors: &[Vec4; 3]) -> [Vec4; 4] {
    const SINE: [f32; 7] = [
        1.0,
        -1.0 / 6.0,
        1.0 / 120.0,
        -1.0 / 5_040.0,
        1.0 / 362_880.0,
        -1.0 / 39_916_800.0,
        1.0 / 6_227_020_800.0,
    ];
    const COSINE: [f32; 7] = [
        1.0,
        -1.0 / 2.0,
        1.0 / 24.0,
        -1.0 / 720.0,
        1.0 / 40_320.0,
        -1.0 / 3_628_800.0,
        1.0 / 479_001_600.0,
    ];
    let [x, y, z] = *vectors;
    let square = (x * x + y * y + z * z) * 0.25;
    let half_sine = polynomial(&SINE, square) * 0.5;
    [x * half_sine, y * half_sine, z * half_sine, polynomial(&COSINE, square)]
}

fn columns(map: &Mat3) -> MapColumns {
    map.to_cols_array_2d().map(|[x, y, z]| [x, y, z, 0.0])
}

/// Sines and cosines. On an eighth of a turn either side of 0 the Taylor series up to x¹³ and x¹² are off by less than the term
/// left out: (π/4)¹⁵ / 15! < 3e-14 and (π/4)¹⁴ / 14! < 4e-13; taking quarter turns off loses 1e-16 of the angle.
#[inline(always)]
fn sin_cos(angles: [f64; SIDE_BY_SIDE]) -> ([f64; SIDE_BY_SIDE], [f64; SIDE_BY_SIDE]) {
    if angles.iter().any(|x| x.is_nan() || x.abs() > FARTHEST) {
        return (angles.map(libm::sin), angles.map(libm::cos));
    }
    let rounded = angles.map(|x| x * FRAC_2_PI + ROUNDING);
    let r: [f64; SIDE_BY_SIDE] = std::array::from_fn(|lane| {
        let quarters = rounded[lane] - ROUNDING;
        (angles[lane] - quarters * FRAC_PI_2) - quarters * FRAC_PI_2_REST
    });
    let s = r.map(|r| r * r);
    let mut sines: [f64; SIDE_BY_SIDE] = std::array::from_fn(|lane| {
        let s = s[lane];
        let sum = -1.0 / 39_916_800.0 + s * (1.0 / 6_227_020_800.0);
        let sum = -1.0 / 5_040.0 + s * (1.0 / 362_880.0 + s * sum);
        let sum = -1.0 / 6.0 + s * (1.0 / 120.0 + s * sum);
        r[lane] + r[lane] * s * sum
    });
    let mut cosines = s.map(|s| {
        let sum = -1.0 / 3_628_800.0 + s * (1.0 / 479_001_600.0);
        let sum = -1.0 / 720.0 + s * (1.0 / 40_320.0 + s * sum);
        1.0 + s * (-0.5 + s * (1.0 / 24.0 + s * sum))
    });
    for lane in 0..SIDE_BY_SIDE {
        // The last bits of the rounded number count the quarter turns.
        let quarter = rounded[lane].to_bits() & 3;
        let (sine, cosine) = (sines[lane].to_bits(), cosines[lane].to_bits());
        let (sine, cosine) = if quarter & 1 == 0 {
            (sine, cosine)
        } else {
            (cosine, sine)
        };
        sines[lane] = f64::from_bits(sine ^ (quarter & 2) << 62);
        cosines[lane] = f64::from_bits(cosine ^ ((quarter + 1) & 2) << 62);
    }
    (sines, cosines)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::{BodyOptions, DeformableBody};
    use crate::handles::ownership::{HandleConstraint, HandleSetup};
    use crate::handles::system::HandleSystem;
    use crate::rotation::Transform;
    use pliant_asset::shapes;
    use pliant_exec::Exec;
    use pliant_exec::pool::Pool;
    use pliant_exec::progress::Silent;
    use pliant_mesh::{Mesh, Weld};

    #[test]
    fn sine_and_cosine_are_those_of_the_library() {
        let mut worst = 0.0f64;
        for k in -400_000..400_000 {
            let x = f64::from(k) * 1.7e-4;
            let lane = (k & 3) as usize;
            let (quick, exact) = (sin_cos([x; SIDE_BY_SIDE]), libm::sincos(x));
            worst = (worst.max((quick.0[lane] - exact.0).abs())).max((quick.1[lane] - exact.1).abs());
        }
        assert!(worst < 1e-12, "{worst}");
        for odd in [0.0, -0.0, 1e-200, 1e5 + 0.3, -9e5, 1e9, f64::INFINITY, f64::NAN] {
            let (sines, cosines) = sin_cos([0.0, odd, 1.0, 2.0]);
            let (quick, exact) = ((sines[1], cosines[1]), libm::sincos(odd));
            let near = (quick.0 - exact.0).abs() < 1e-10 && (quick.1 - exact.1).abs() < 1e-10;
            assert!(
                near || exact.0.is_nan() && quick.0.is_nan(),
                "{odd}: {quick:?} against {exact:?}"
            );
        }
    }

    #[test]
    fn polynomials_give_the_vectors_and_quaternions_of_the_library() {
        let mut worst = [0.0f64; 2];
        for k in 0..4000 {
            let angle = f64::from(k) * (std::f64::consts::PI / 4000.0);
            let vector = DVec3::new(2.0, -1.0, 2.0) / 3.0 * angle;
            let exact = exp_rotation(vector);
            let single = vector.as_vec3().to_array().map(Vec4::splat);
            let turn = exp_vectors(&single);
            for (quick, exact) in turn.iter().zip(exact.to_array()) {
                worst[0] = worst[0].max((f64::from(quick[3]) - exact).abs());
            }
            // Of either sign of the quaternion.
            for sign in [1.0f32, -1.0] {
                let mut sum = [Vec4::ZERO; 3];
                let turn = exact.as_quat().to_array().map(|v| Vec4::splat(v * sign));
                add_logarithms(&turn, Vec4::splat(1.0), &mut sum);
                for (quick, exact) in sum.iter().zip(vector.to_array()) {
                    worst[1] = worst[1].max((f64::from(quick[2]) - exact).abs());
                }
            }
        }
        assert!(worst[0] < 3e-7 && worst[1] < 1e-6, "{worst:?}");
    }

    /// A ball with so many handles of one vertex each.
    fn ball_with_handles(count: usize, pool: &Pool) -> (DeformableBody, HandleSystem) {
        let (positions, triangles) = shapes::icosphere(1.0, 4);
        let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a ball");
        let exec = Exec::new(pool, &Silent);
        let options = BodyOptions {
            local_fields: true,
            ..BodyOptions::default()
        };
        let body = DeformableBody::build(&mesh, &options, &exec).expect("a body");
        let hold = |k: usize| HandleConstraint {
            nodes: vec![(k * positions.len() / count) as u32],
            position: true,
            rotation: true,
            ..Default::default()
        };
        let setup = HandleSetup {
            handles: (0..count).map(hold).collect(),
            ..Default::default()
        };
        let handles = HandleSystem::build(&body, setup, &exec).expect("handles");
        (body, handles)
    }

    #[test]
    fn frames_side_by_side_are_those_of_one_node_after_the_other() {
        let pool = Pool::new(1).expect("a thread");
        // Bends, bends and turns of more than half a circle, swings too far apart for a mean, all of them with scales.
        for (count, longest) in [(2, 1.0), (5, 1.4), (5, 9.0), (9, 3.0), (80, 0.7)] {
            let (body, handles) = ball_with_handles(count, &pool);
            for (still, scale) in [(true, 0.0), (false, 0.0), (false, 0.3)] {
                let transform = |k: usize| {
                    let at = |phase: f64| libm::sin(k as f64 * 1.7 + phase);
                    let rotation = DVec3::new(at(0.3), at(2.0), at(4.0)) * (longest / 3f64.sqrt());
                    Transform {
                        rotation: if still && k == 0 { DVec3::ZERO } else { rotation },
                        log_scale: DMat3::from_diagonal(DVec3::new(at(1.0), at(3.0), at(5.0)) * scale),
                        ..Transform::IDENTITY
                    }
                };
                let transforms: Vec<Transform> = (0..count).map(transform).collect();
                let blend = || PoseBlend::new(&body, &handles, &transforms, None);
                let (exact, quick) = (blend(), QuickFrames::new(blend()));
                let mut nodes: Vec<u32> = (0..body.nodes() as u32).rev().chain([u32::MAX; 3]).collect();
                nodes.resize(nodes.len().next_multiple_of(SIDE_BY_SIDE), u32::MAX);
                let mut block = NodeFrames::default();
                let mut worst = 0.0f64;
                let (whole, _) = nodes.as_chunks::<SIDE_BY_SIDE>();
                let blocks = whole.iter().flat_map(|some| {
                    let frames = *quick.of(some, &mut block);
                    some.iter().copied().zip(frames)
                });
                for (node, found) in blocks.filter(|(node, _)| *node != u32::MAX) {
                    let node = node as usize;
                    let turn = DMat3::from_quat(exact.rotation(node).unwrap_or(DQuat::IDENTITY));
                    let expected = exact.scale(node).map_or(turn, |scale| turn * scale);
                    for (found, expected) in found.iter().zip(expected.to_cols_array_2d()) {
                        for (found, expected) in found.iter().zip(expected) {
                            worst = worst.max((f64::from(*found) - expected).abs());
                        }
                    }
                }
                assert!(worst < 2e-6, "{count} handles up to {longest}: {worst}");
            }
        }
    }
}
