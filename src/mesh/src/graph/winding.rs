//! How often triangles wrap around a point.
//!
//! The generalised winding number (Jacobson et al. 2013) says how often a surface wraps around a point, a whole number where
//! it is closed and a sensible fraction where it has holes; the tree evaluates distant clusters by their moments (Barill et
//! al. 2018).
//!
//! The tree is a bounding-volume hierarchy whose nodes know their far fields, which follow from moments of the surface.
//! Seen from afar a piece of surface is a dipole with corrections. With δ the offset from the centroid and n the unit
//! normal, its first three moments are the polynomials P₁(u) = ∫ n·u, P₂(u) = ∫ (δ·u)(n·u) and P₃(u) = ∫ (δ·u)²(n·u) in
//! a direction u; they are all that the solid angle needs up to second order (Barill et al. 2018, section 3).

use crate::query::TriangleBvh;
use crate::query::bvh::{FAN, NodeStack};
use glam::DVec3;
use pliant_exec::pool::Pool;
use rayon::prelude::*;
use std::f64::consts::PI;

/// A cluster is far when it is more than this many times its radius away (Barill et al. 2018 call it β). With moments
/// up to second order the number is then off by at most about 0.003 on the meshes that this was measured on.
const FAR: f64 = 2.0;
/// The same for a first look, which is off by at most about 0.1 there …
const ROUGHLY_FAR: f64 = 1.0;
/// … and is taken where it is further than this from the threshold.
const CLEAR: f64 = 0.25;

impl WindingTree<'_> {
    /// How often the triangles wrap around `point`: 1 inside and 0 outside a closed surface wound counter-clockwise
    /// seen from outside, −1 inside when wound the other way, a fraction near holes. Off by less than 0.01; the part
    /// of near triangles is exact to rounding.
    pub fn winding_number(&self, point: DVec3) -> f64 {
        self.evaluate(point, FAR)
    }

    /// As [`Self::winding_number`], at a third of the cost, but off by up to about 0.1.
    pub fn rough_winding_number(&self, point: DVec3) -> f64 {
        self.evaluate(point, ROUGHLY_FAR)
    }

    /// Whether `point` lies inside: the winding number is further from 0 than ½.
    pub fn contains(&self, point: DVec3) -> bool {
        let roughly = self.rough_winding_number(point).abs();
        if (roughly - 0.5).abs() > CLEAR {
            roughly > 0.5
        } else {
            self.winding_number(point).abs() > 0.5
        }
    }

    fn evaluate(&self, point: DVec3, far_ratio: f64) -> f64 {
        let mut angle = SolidAngle::default();
        let mut far = 0.0;
        let leaves = self.bvh.leaf_count();
        let mut stack = NodeStack::new(&self.bvh);
        let mut visits = 0;
        while let Some(index) = stack.pop() {
            visits += 1;
            let node = &self.nodes[index];
            let d = node.center - point;
            let square = d.length_squared();
            if square > far_ratio * far_ratio * node.radius * node.radius {
                let distance = square.sqrt();
                let u = (d / distance).as_vec3().to_array();
                far += f64::from(node.field.solid_angle(u, (node.radius / distance) as f32));
            } else if index < leaves {
                for place in node.first as usize..(node.first + node.count) as usize {
                    angle.add(self.bvh.corners(place).map(|p| p - point));
                }
            } else {
                (node.first..node.first + node.count).for_each(|child| stack.push(child));
            }
        }
        self.bvh.visits.add(visits);
        (angle.total() + far) / (4.0 * PI)
    }
}

/// A sum of solid angles. Half angles are added as arguments of complex numbers, so that the arc tangent is needed only
/// when the sum leaves the half plane.
struct SolidAngle {
    re: f64,
    im: f64,
    sum: f64,
}

impl Default for SolidAngle {
    fn default() -> Self {
        Self {
            re: 1.0,
            im: 0.0,
            sum: 0.0,
        }
    }
}

impl SolidAngle {
    /// Adds the solid angle of a triangle seen from the origin (van Oosterom and Strackee 1983).
    #[inline]
    fn add(&mut self, [a, b, c]: [DVec3; 3]) {
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        let im = a.dot(b.cross(c));
        let re = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        let size = re.abs() + im.abs();
        if size == 0.0 {
            return;
        }
        if re <= 0.0 {
            self.sum += libm::atan2(im, re);
            return;
        }
        // Both arguments are less than a quarter turn, so their sum is less than a half.
        let (r, i) = (
            (self.re * re - self.im * im) / size,
            (self.re * im + self.im * re) / size,
        );
        if r > 0.0 {
            let scale = 1.0 / (r + i.abs());
            (self.re, self.im) = (r * scale, i * scale);
        } else {
            self.sum += libm::atan2(i, r);
            (self.re, self.im) = (1.0, 0.0);
        }
    }

    fn total(&self) -> f64 {
        2.0 * (self.sum + libm::atan2(self.im, self.re))
    }
}

/// A tree over triangles that answers winding-number queries, and by its [`TriangleBvh`] all others.
///
/// Its shape depends on the triangles only. It is built in `n log n` time and holds about 80 bytes per triangle.
///
/// ```
/// use glam::DVec3;
/// use pliant_mesh::graph::WindingTree;
/// use pliant_exec::pool::Pool;
///
/// let positions = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
/// let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
/// let tree = WindingTree::build(&positions, &tetrahedron, &Pool::new(1).expect("a thread"));
/// assert!(tree.contains(DVec3::splat(0.1)) && !tree.contains(DVec3::ONE));
/// ```
#[derive(Debug)]
pub struct WindingTree<'a> {
    pub(super) bvh: TriangleBvh<'a>,
    /// The nodes of `bvh`, in its order.
    pub(super) nodes: Vec<WindingNode>,
}

/// One node: its far field and its children.
#[derive(Debug, Clone, Copy)]
pub(super) struct WindingNode {
    /// Area-weighted centroid.
    pub(super) center: DVec3,
    /// No point of the node is further from `center`.
    pub(super) radius: f64,
    pub(super) field: FarField,
    /// First child: a place in the order of the leaves for leaves, a node for others.
    pub(super) first: u32,
    /// Number of children.
    pub(super) count: u32,
}

/// The moments of a node and how far its points lie from their centre.
struct NodeMoments {
    moments: Moments,
    radius: f64,
}

impl<'a> WindingTree<'a> {
    /// Sorts `triangles` into a tree.
    ///
    /// # Panics
    /// When a triangle names a position that does not exist.
    pub fn build(positions: &'a [DVec3], triangles: &'a [[u32; 3]], pool: &Pool) -> Self {
        let bvh = TriangleBvh::build(positions, triangles, pool);
        let mut tree = Self { bvh, nodes: Vec::new() };
        pool.install(|| {
            let mut level: Vec<NodeMoments> = (0..tree.bvh.leaf_count())
                .into_par_iter()
                .map(|leaf| tree.measure_leaf(leaf))
                .collect();
            let mut first = 0;
            while !level.is_empty() {
                let nodes = level.par_iter().enumerate();
                tree.nodes
                    .par_extend(nodes.map(|(i, measured)| measured.node(&tree.bvh, first + i)));
                if level.len() == 1 {
                    break;
                }
                let above = first + level.len();
                level = (above..above + level.len().div_ceil(4))
                    .into_par_iter()
                    .map(|node| tree.measure_inner(node, &level, first))
                    .collect();
                first = above;
            }
        });
        tree
    }

    /// The hierarchy over the same triangles, for all queries but the winding number.
    pub fn bvh(&self) -> &TriangleBvh<'a> {
        &self.bvh
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.bvh.byte_size() + self.nodes.capacity() * size_of::<WindingNode>()
    }

    fn measure_leaf(&self, leaf: usize) -> NodeMoments {
        let node = self.bvh.nodes()[leaf];
        let places = node.first as usize..(node.first + node.count) as usize;
        let mut corners = [[DVec3::ZERO; 3]; FAN];
        let count = places.len();
        corners
            .iter_mut()
            .zip(places)
            .for_each(|(own, place)| *own = self.bvh.corners(place));
        let parts = corners.map(Moments::from_triangle);
        let moments = Moments::from_parts(&parts[..count]);
        let points = corners[..count].iter().flatten();
        NodeMoments {
            radius: points.map(|p| p.distance(moments.center)).fold(0.0, f64::max),
            moments,
        }
    }

    /// Measures an inner node; `below` are the nodes of the level below, the first of which is `first`.
    fn measure_inner(&self, node: usize, below: &[NodeMoments], first: usize) -> NodeMoments {
        let children = self.bvh.nodes()[node];
        let begin = children.first as usize - first;
        let children = &below[begin..begin + children.count as usize];
        let parts: [Moments; FAN] = std::array::from_fn(|k| children[k.min(children.len() - 1)].moments);
        let moments = Moments::from_parts(&parts[..children.len()]);
        let mut radius = 0.0f64;
        for c in children {
            radius = radius.max(c.radius + c.moments.center.distance(moments.center));
        }
        let bounds = self.bvh.inner_bounds(node);
        let far_corner = (bounds.max - moments.center).max(moments.center - bounds.min);
        NodeMoments {
            moments,
            radius: radius.min(far_corner.length()),
        }
    }
}

impl NodeMoments {
    fn node(&self, bvh: &TriangleBvh<'_>, index: usize) -> WindingNode {
        let children = bvh.nodes()[index];
        WindingNode {
            center: self.moments.center,
            radius: self.radius,
            field: FarField::from_moments(&self.moments, self.radius),
            first: children.first,
            count: children.count,
        }
    }
}

/// Moments about a centroid.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moments {
    /// Area-weighted centroid.
    pub(super) center: DVec3,
    pub(super) area: f64,
    /// P₁: integral of the unit normal.
    normal: DVec3,
    /// P₂ by its coefficients of xx, yy, zz, xy, yz, zx.
    second: [f64; 6],
    /// P₃ by its coefficients of xxx, yyy, zzz, xxy, xxz, yyx, yyz, zzx, zzy, xyz.
    third: [f64; 10],
}

/// `(s·u)(a·u)` by its coefficients.
fn multiply_linear(s: DVec3, a: DVec3) -> [f64; 6] {
    let cross = |i: usize, j: usize| s[i] * a[j] + s[j] * a[i];
    [s.x * a.x, s.y * a.y, s.z * a.z, cross(0, 1), cross(1, 2), cross(2, 0)]
}

/// `(s·u) q(u)` for a quadratic polynomial.
fn multiply_quadratic(s: DVec3, q: &[f64; 6]) -> [f64; 10] {
    let [xx, yy, zz, xy, yz, zx] = *q;
    [
        s.x * xx,
        s.y * yy,
        s.z * zz,
        s.y * xx + s.x * xy,
        s.z * xx + s.x * zx,
        s.x * yy + s.y * xy,
        s.z * yy + s.y * yz,
        s.x * zz + s.z * zx,
        s.y * zz + s.z * yz,
        s.x * yz + s.y * zx + s.z * xy,
    ]
}

fn add_scaled<const N: usize>(to: &mut [f64; N], what: [f64; N], times: f64) {
    to.iter_mut().zip(what).for_each(|(t, w)| *t += w * times);
}

impl Moments {
    /// Computes those of a triangle.
    fn from_triangle([a, b, c]: [DVec3; 3]) -> Self {
        let center = (a + b + c) / 3.0;
        let normal = 0.5 * (b - a).cross(c - a);
        let mut third = [0.0; 10];
        // The mean of δδᵀ over a triangle is a twelfth of its sum over the corners.
        for corner in [a, b, c] {
            let d = corner - center;
            add_scaled(
                &mut third,
                multiply_quadratic(normal, &multiply_linear(d, d)),
                1.0 / 12.0,
            );
        }
        Self {
            center,
            area: normal.length(),
            normal,
            second: [0.0; 6],
            third,
        }
    }

    /// Adds up those of several pieces, at least one.
    pub(super) fn from_parts(parts: &[Self]) -> Self {
        let largest = parts.iter().map(|p| p.area).fold(0.0, f64::max);
        // Without any area every part counts the same; relative weights keep products away from underflow.
        let weight = |p: &Self| if largest > 0.0 { p.area / largest } else { 1.0 };
        let total: f64 = parts.iter().map(weight).sum();
        let center = parts.iter().map(|p| p.center * (weight(p) / total)).sum();
        let mut sum = Self {
            center,
            area: 0.0,
            normal: DVec3::ZERO,
            second: [0.0; 6],
            third: [0.0; 10],
        };
        for p in parts {
            let shift = p.center - center;
            sum.area += p.area;
            sum.normal += p.normal;
            add_scaled(&mut sum.second, p.second, 1.0);
            add_scaled(&mut sum.second, multiply_linear(shift, p.normal), 1.0);
            add_scaled(&mut sum.third, p.third, 1.0);
            add_scaled(&mut sum.third, multiply_quadratic(shift, &p.second), 2.0);
            add_scaled(
                &mut sum.third,
                multiply_quadratic(shift, &multiply_linear(shift, p.normal)),
                1.0,
            );
        }
        sum
    }
}

/// The far field of a piece of surface, in units of its radius.
#[derive(Debug, Clone, Copy)]
pub(super) struct FarField {
    first: [f32; 3],
    second: [f32; 6],
    third: [f32; 10],
    /// Trace of P₂'s symmetric matrix.
    trace: f32,
    /// Trace of P₃'s symmetric tensor over two of its three indices.
    traces: [f32; 3],
}

impl FarField {
    /// Scales the moments by powers of `radius`, so that they fit single precision whatever the model's size.
    fn from_moments(m: &Moments, radius: f64) -> Self {
        let scale = if radius > 0.0 { 1.0 / radius } else { 0.0 };
        // Powers are applied one by one: the fourth power of a tiny length is not a number.
        let third = m.third.map(|t| (t * scale * scale * scale * scale) as f32);
        let [xxx, yyy, zzz, xxy, xxz, yyx, yyz, zzx, zzy, _] = third;
        let second = m.second.map(|t| (t * scale * scale * scale) as f32);
        Self {
            first: (m.normal * scale * scale).as_vec3().to_array(),
            second,
            third,
            traces: [
                xxx + (yyx + zzx) / 3.0,
                yyy + (xxy + zzy) / 3.0,
                zzz + (xxz + yyz) / 3.0,
            ],
            trace: second[0] + second[1] + second[2],
        }
    }

    /// The solid angle seen from a point in direction −`u` (a unit vector), `ratio` = radius / distance.
    ///
    /// It is ∫ ∇(1/|x|)·n expanded about the centroid: the derivatives of the dipole field u/r² contract with the
    /// moments to P₁(u), tr P₂ − 3 P₂(u), and 7.5 P₃(u) − 4.5 (trace of P₃)·u, each with one more power of 1/r.
    #[inline]
    pub(super) fn solid_angle(&self, u: [f32; 3], ratio: f32) -> f32 {
        let [x, y, z] = u;
        let (xx, yy, zz, xy, yz, zx) = (x * x, y * y, z * z, x * y, y * z, z * x);
        let linear = self.first[0] * x + self.first[1] * y + self.first[2] * z;
        let q = &self.second;
        let quadratic = q[0] * xx + q[1] * yy + q[2] * zz + q[3] * xy + q[4] * yz + q[5] * zx;
        let c = &self.third;
        let cubic = (c[0] * xx + c[5] * yy + c[7] * zz) * x
            + (c[1] * yy + c[3] * xx + c[8] * zz) * y
            + (c[2] * zz + c[4] * xx + c[6] * yy) * z
            + c[9] * xy * z;
        let traces = self.traces[0] * x + self.traces[1] * y + self.traces[2] * z;
        let second_order = 7.5 * cubic - 4.5 * traces;
        ratio * ratio * (linear + ratio * ((self.trace - 3.0 * quadratic) + ratio * second_order))
    }
}

#[cfg(test)]
mod moments_tests {
    use super::*;

    #[test]
    fn moments_of_parts_add_up_to_those_of_the_whole() {
        let [a, b, c] = [
            DVec3::new(0.1, 0.0, 0.3),
            DVec3::new(1.0, 0.2, 0.0),
            DVec3::new(0.3, 1.0, 0.7),
        ];
        let middle = (a + b) * 0.3 + c * 0.4;
        let whole = Moments::from_triangle([a, b, c]);
        let parts = Moments::from_parts(&[[a, b, middle], [b, c, middle], [c, a, middle]].map(Moments::from_triangle));
        assert!(whole.center.distance(parts.center) < 1e-12 && (whole.area - parts.area).abs() < 1e-12);
        assert!(
            whole
                .second
                .iter()
                .zip(parts.second)
                .all(|(w, p)| (w - p).abs() < 1e-12)
        );
        assert!(whole.third.iter().zip(parts.third).all(|(w, p)| (w - p).abs() < 1e-12));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_exec::pool::Pool;

    #[test]
    fn one_triangle_spans_the_solid_angle_of_the_textbook() {
        // Seen from the origin the three unit points span an octant.
        let p = [DVec3::X, DVec3::Y, DVec3::Z];
        let tree = WindingTree::build(&p, &[[0, 1, 2]], &Pool::new(1).expect("a pool"));
        assert!((tree.winding_number(DVec3::ZERO) - 0.125).abs() < 1e-12);
        assert!((tree.winding_number(DVec3::splat(1e3))).abs() < 1e-6);
        assert!(
            tree.winding_number(DVec3::X).is_finite(),
            "a corner itself has no angle, but a number"
        );
    }

    #[test]
    fn many_small_angles_add_up_past_a_full_turn() {
        let octant = [DVec3::X, DVec3::Y, DVec3::Z];
        let mut angle = SolidAngle::default();
        (0..100).for_each(|_| angle.add(octant));
        assert!((angle.total() - 100.0 * PI / 2.0).abs() < 1e-9);
    }

    #[test]
    fn nothing_winds_around_nothing() {
        let tree = WindingTree::build(&[], &[], &Pool::new(1).expect("a pool"));
        assert_eq!(tree.winding_number(DVec3::ONE), 0.0);
        assert!(!tree.contains(DVec3::ZERO));
    }
}
