//! Points that are carried four at a time: one in each lane of a vector.

use glam::{BVec4, Mat4, Vec3, Vec4};

/// Points that are taken at once.
pub(super) const LANES: usize = 4;
/// Steps towards the rotation of a gradient, from that of the frame.
const MOST_STEPS: usize = 8;
/// A step of which the square is below this is the last one, radians: what is left is about its third power.
const LAST_STEP: f32 = 4e-4;
/// Up to this logarithm a series gives a scale within single precision.
const SMALL_LOGARITHM: f32 = 0.25;

/// Three numbers of each point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lanes3(pub [Vec4; 3]);

impl Lanes3 {
    /// One vector for each point.
    #[inline]
    pub fn each(self) -> [Vec3; LANES] {
        let [x, y, z] = self.0;
        across([x, y, z, Vec4::ZERO]).map(Vec4::truncate)
    }

    #[inline]
    fn dot(self, other: Self) -> Vec4 {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        a * x + b * y + c * z
    }

    #[inline]
    fn cross(self, other: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, other.0);
        Self([b * z - c * y, c * x - a * z, a * y - b * x])
    }
}

/// Four vectors of four numbers, the other way round.
#[inline]
pub(super) fn across([a, b, c, d]: [Vec4; LANES]) -> [Vec4; LANES] {
    let turned = Mat4::from_cols(a, b, c, d).transpose();
    [turned.x_axis, turned.y_axis, turned.z_axis, turned.w_axis]
}

/// Points on their way.
pub(super) struct PointLanes {
    pub displacement: Lanes3,
    pub log_scale: Vec4,
    /// About unit quaternions.
    pub turn: [Vec4; 4],
    pub lever: Lanes3,
    /// By columns.
    pub gradient: [Lanes3; 3],
}

/// What becomes of points.
pub(super) struct CarriedLanes {
    pub moved: Lanes3,
    /// w is 0 or more.
    pub turn: [Vec4; 4],
    pub stretch: Lanes3,
    pub shear: Lanes3,
}

impl PointLanes {
    /// Points of which the rotations agree so much, as the square of the length of their mean, and the gradients are numbers.
    #[inline]
    pub fn agree(&self, least: f32) -> BVec4 {
        let [x, y, z, w] = self.turn;
        let columns = self.gradient.map(|Lanes3([x, y, z])| x + y + z);
        let sum = (columns[0] + columns[1] + columns[2]).abs();
        let agreement = x * x + y * y + z * z + w * w;
        let agree = agreement.cmpge(Vec4::splat(least)) & sum.cmple(Vec4::splat(f32::MAX));
        BVec4::from_array(agree.into())
    }

    #[inline]
    pub fn carried(&self) -> CarriedLanes {
        let mut turn = unit(self.turn);
        let rows = rows_of(turn);
        let scale = exponential(self.log_scale);
        let ([dx, dy, dz], [lx, ly, lz]) = (self.displacement.0, self.lever.0);
        let turned = rows.map(|row| row.dot(self.lever) * scale);
        let moved = Lanes3([dx + (turned[0] - lx), dy + (turned[1] - ly), dz + (turned[2] - lz)]);
        let mut left = self.turned_back(rows);
        for _ in 0..MOST_STEPS {
            let (step, size) = step_of(&left);
            let [x, y, z] = (step.0).map(|number| number * 0.5);
            let [a, b, c, d] = turn;
            // The product of quaternions, of which the second one has w of 1.
            turn = unit([
                a + d * x + b * z - c * y,
                b + d * y + c * x - a * z,
                c + d * z + a * y - b * x,
                d - a * x - b * y - c * z,
            ]);
            left = self.turned_back(rows_of(turn));
            if size.max_element() < LAST_STEP {
                break;
            }
        }
        let side = turn[3].cmplt(Vec4::ZERO);
        let half = Vec4::splat(0.5);
        CarriedLanes {
            moved,
            turn: turn.map(|number| Vec4::select(side, -number, number)),
            stretch: Lanes3([left[0].0[0], left[1].0[1], left[2].0[2]]),
            shear: Lanes3([
                (left[1].0[2] + left[2].0[1]) * half,
                (left[2].0[0] + left[0].0[2]) * half,
                (left[0].0[1] + left[1].0[0]) * half,
            ]),
        }
    }

    /// The gradients without rotations of these rows, by columns.
    #[inline]
    fn turned_back(&self, rows: [Lanes3; 3]) -> [Lanes3; 3] {
        // The columns of the rotation are the rows of its inverse.
        let axes: [Lanes3; 3] = std::array::from_fn(|k| Lanes3(rows.map(|row| row.0[k])));
        self.gradient.map(|column| Lanes3(axes.map(|axis| axis.dot(column))))
    }
}

/// Quaternions of length 1.
#[inline]
fn unit(turn: [Vec4; 4]) -> [Vec4; 4] {
    let [x, y, z, w] = turn;
    let length = (x * x + y * y + z * z + w * w).max(Vec4::splat(f32::MIN_POSITIVE));
    let part = Vec4::ONE / length.sqrt();
    turn.map(|number| number * part)
}

/// The rows of rotation matrices.
#[inline]
fn rows_of([x, y, z, w]: [Vec4; 4]) -> [Lanes3; 3] {
    let (x2, y2, z2) = (x + x, y + y, z + z);
    let (xx, yy, zz) = (x * x2, y * y2, z * z2);
    let (yz, zx, xy) = (y * z2, x * z2, x * y2);
    let (wx, wy, wz) = (w * x2, w * y2, w * z2);
    let one = Vec4::ONE;
    [
        Lanes3([one - (yy + zz), xy - wz, zx + wy]),
        Lanes3([xy + wz, one - (xx + zz), yz - wx]),
        Lanes3([zx - wy, yz + wx, one - (xx + yy)]),
    ]
}

/// A step from what is left of gradients towards their rotation, as [`nearest_rotation`](crate::rotation::nearest_rotation) takes it,
/// and its square.
#[inline]
fn step_of(left: &[Lanes3; 3]) -> (Lanes3, Vec4) {
    let [Lanes3([xx, yx, zx]), Lanes3([xy, yy, zy]), Lanes3([xz, yz, zz])] = *left;
    let slope = Lanes3([zy - yz, xz - zx, yx - xy]);
    let half = Vec4::splat(-0.5);
    let (a, b, c) = ((yz + zy) * half, (zx + xz) * half, (xy + yx) * half);
    let curve = [
        Lanes3([yy + zz, c, b]),
        Lanes3([c, xx + zz, a]),
        Lanes3([b, a, xx + yy]),
    ];
    // Cramer's rule.
    let across = curve[1].cross(curve[2]);
    let determinant = curve[0].dot(across);
    let part = Vec4::ONE / determinant;
    let newton = [across, curve[2].cross(curve[0]), curve[0].cross(curve[1])].map(|row| slope.dot(row) * part);
    let newton = Lanes3(newton);
    let size = newton.dot(newton);
    let is_short = determinant.cmpgt(Vec4::ZERO) & size.cmplt(Vec4::ONE);
    if is_short.all() {
        return (newton, size);
    }
    // Where the curve is not positive, along the slope by no more than can be right.
    let careful = (xx + yy + zz).abs() + slope.dot(slope).sqrt() + Vec4::splat(f32::MIN_POSITIVE);
    let step: [Vec4; 3] = std::array::from_fn(|k| Vec4::select(is_short, newton.0[k], slope.0[k] / careful));
    let step = Lanes3(step);
    (step, step.dot(step))
}

/// The exponential function, without a call near 0.
#[inline]
fn exponential(x: Vec4) -> Vec4 {
    if x.abs().max_element() > SMALL_LOGARITHM {
        return Vec4::from_array(x.to_array().map(libm::expf));
    }
    let [one, half] = [Vec4::ONE, Vec4::splat(1.0 / 2.0)];
    let [third, fourth, fifth] = [1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0].map(Vec4::splat);
    one + x * (one + x * (half + x * (third + x * (fourth + x * fifth))))
}
