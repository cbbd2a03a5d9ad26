//! How the samples of a surface have moved, turned and grown in a deformed shape, and what that does to a point.
//!
//! The rest surface: a tree whose nodes stand for the triangles below them when seen from far away.

use crate::carry::sides::SurfaceSides;
use crate::carry::triangle_ball::TriangleBall;
use crate::measure::BoundingBox;
use crate::query::TriangleBvh;
use crate::query::closest_point::closest_weights_on_triangle;
use crate::rotation::{fit_rotation, nearest_rotation, outer_product};
use glam::{DMat3, DQuat, DVec3};
use pliant_exec::pool::Pool;
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
    /// How many of them are vertices.
    vertices: usize,
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
            surface.add_clusters(&mut samples);
            Self {
                samples,
                vertices: current.len(),
                whole,
            }
        })
    }

    /// How far a vertex of the surface has gone.
    pub(super) fn displacement(&self, vertex: usize) -> DVec3 {
        self.samples[vertex].displacement
    }

    /// The displacement of a sample, its rotation and the logarithm of its scale.
    pub(super) fn of_sample(&self, sample: usize) -> (DVec3, DQuat, f64) {
        let own = &self.samples[sample];
        let rotation = match sample < self.vertices {
            true => DQuat::from_mat3(&own.rotation),
            false => turning_part(own.rotation, self.whole),
        };
        (own.displacement, rotation, own.log_scale)
    }

    /// The rotation that fits the whole surface best.
    pub(super) fn whole(&self) -> DQuat {
        self.whole
    }

    /// How much the rotations of `samples` agree, 0 to 1: the size of their mean.
    pub(super) fn agreement(&self, samples: impl Iterator<Item = (u32, f64)>) -> f64 {
        let mut mean = DMat3::ZERO;
        samples.for_each(|(sample, weight)| mean += self.samples[sample as usize].rotation * weight);
        rotation_size(mean)
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
        // Bit for bit, and also for a zero with a sign.
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
        let [clear, vague] = CONTRADICTION;
        let agreement = rotation_size(mean);
        let doubt = ((clear - agreement) / (clear - vague)).clamp(0.0, 1.0);
        if doubt > 0.0 {
            return fit_rotation(mean + DMat3::from_quat(self.whole) * (0.5 * doubt));
        }
        fit_rotation(mean)
    }
}

/// What samples of a surface have, and clusters the mean of.
pub(super) trait Averaged: Copy + Send + Sync {
    /// The sum of none.
    const NONE: Self;

    /// Adds another with a weight.
    fn add(&mut self, weight: f64, other: &Self);

    /// The mean, of a sum and the weights that it has.
    fn divided_by(self, weight: f64) -> Self;
}

impl Averaged for SampleMotion {
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

/// The size of a mean of rotations: 1 of equal ones.
fn rotation_size(mean: DMat3) -> f64 {
    let length = mean.x_axis.length_squared() + mean.y_axis.length_squared() + mean.z_axis.length_squared();
    (length / 3.0).sqrt()
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

impl CarrySurface {
    /// Adds to what the vertices have what the clusters have: the means over their triangles.
    pub(super) fn add_clusters<T: Averaged>(&self, samples: &mut Vec<T>) {
        let at_leaves: Vec<T> = self.nodes[..self.leaves]
            .par_iter()
            .map(|leaf| {
                let mut sum = T::NONE;
                for place in leaf.first as usize..(leaf.first + leaf.count) as usize {
                    let third = self.weights[place] / 3.0;
                    let triangle = self.triangles[self.order[place] as usize];
                    triangle.iter().for_each(|&v| sum.add(third, &samples[v as usize]));
                }
                sum.divided_by(leaf.weight)
            })
            .collect();
        samples.extend(at_leaves);
        for node in &self.nodes[self.leaves..] {
            let mut sum = T::NONE;
            for child in node.first..node.first + node.count {
                let at = self.rest.len() + child as usize;
                sum.add(self.nodes[child as usize].weight, &samples[at]);
            }
            samples.push(sum.divided_by(node.weight));
        }
    }
}

/// The gradient of the similarity-like map that takes one triangle to another, times the first one's area: in its plane the
/// affine map, across it the normal, grown by the root of the ratio of areas. Nothing is divided by the height of a thin
/// triangle. `None` for a triangle without rest area.
pub(super) fn weighted_gradient(rest: [DVec3; 3], now: [DVec3; 3]) -> Option<DMat3> {
    let (e1, e2) = (rest[1] - rest[0], rest[2] - rest[0]);
    let (f1, f2) = (now[1] - now[0], now[2] - now[0]);
    let (n, m) = (e1.cross(e2), f1.cross(f2));
    let unit = n.try_normalize()?;
    let across = m.normalize_or_zero() * (n.length() * m.length()).sqrt();
    let gradient = outer_product(f1, e2.cross(unit)) + outer_product(f2, unit.cross(e1)) + outer_product(across, unit);
    gradient.is_finite().then_some(gradient * 0.5)
}

/// What a triangle without area weighs, as a fraction of the squared diagonal: a surface of nothing else has samples too.
const LEAST_AREA: f64 = 1e-12;

/// A rest surface, ready to carry points. It owns what it needs, about 200 bytes per triangle, and depends on the
/// triangles alone.
///
/// Its *samples* are the vertices, numbered as given, and after them the clusters: nodes of a bounding-volume hierarchy that
/// have an area, a centre of mass and a mean normal.
#[derive(Debug, Clone)]
pub struct CarrySurface {
    pub(super) rest: Vec<DVec3>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Triangle numbers in the order of the leaves.
    pub(super) order: Vec<u32>,
    /// What each triangle weighs, in that order.
    pub(super) weights: Vec<f64>,
    /// A ball around each triangle, in that order.
    pub(super) balls: Vec<TriangleBall>,
    /// Their unit normals, 0 without an area.
    pub(super) normals: Vec<DVec3>,
    /// Leaves first, then each level above; the root is last.
    pub(super) nodes: Vec<ClusterNode>,
    pub(super) leaves: usize,
    /// Length of the diagonal of the box around all triangles.
    pub(super) diagonal: f64,
    /// Where points are to follow their own side of a cut alone.
    pub(super) sides: Option<SurfaceSides>,
}

/// A node of the tree, as what it is seen as from afar.
#[derive(Debug, Clone, Copy)]
pub(super) struct ClusterNode {
    pub(super) bounds: BoundingBox,
    /// The length of the diagonal of that.
    pub(super) diagonal: f64,
    /// Centre of mass of its triangles.
    pub(super) center: DVec3,
    /// Mean of its unit normals; shorter than 1 where they differ.
    pub(super) normal: DVec3,
    /// What its triangles weigh together.
    pub(super) weight: f64,
    /// First child: a place in the order of the leaves for leaves, a node for others.
    pub(super) first: u32,
    /// Number of children.
    pub(super) count: u32,
}

/// The place of the surface that is closest to a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct NearestPlace {
    pub(super) distance: f64,
    pub(super) triangle: u32,
    /// Barycentric.
    pub(super) corners: [f64; 3],
}

impl CarrySurface {
    /// Sorts `triangles` over `rest` into a tree.
    ///
    /// # Panics
    /// When a triangle names a position that does not exist.
    pub fn build(rest: &[DVec3], triangles: &[[u32; 3]], pool: &Pool) -> Self {
        let bvh = TriangleBvh::build(rest, triangles, pool);
        let order = bvh.triangle_order().to_vec();
        let (leaves, shape) = (bvh.leaf_count(), bvh.nodes().to_vec());
        let diagonal = match shape.len().checked_sub(1) {
            Some(root) if root >= leaves => bvh.inner_bounds(root).diagonal(),
            _ => BoundingBox::of(&corner_points(rest, triangles)).diagonal(),
        };
        let floor = if diagonal > 0.0 {
            LEAST_AREA * diagonal * diagonal
        } else {
            1.0
        };
        let mut surface = Self {
            rest: rest.to_vec(),
            triangles: triangles.to_vec(),
            order,
            weights: Vec::new(),
            balls: Vec::new(),
            normals: Vec::new(),
            nodes: Vec::with_capacity(shape.len()),
            leaves,
            diagonal,
            sides: None,
        };
        pool.install(|| {
            let area = |&t: &u32| 0.5 * surface.doubled_normal(t).length() + floor;
            surface.weights = surface.order.par_iter().map(area).collect();
            let ball = |&t: &u32| TriangleBall::around(surface.corners(t));
            surface.balls = surface.order.par_iter().map(ball).collect();
            let normal = |&t: &u32| surface.doubled_normal(t).normalize_or_zero();
            surface.normals = surface.order.par_iter().map(normal).collect();
            let leaf = |&(first, count): &(u32, u32)| surface.measure_leaf(first, count);
            let measured: Vec<ClusterNode> = shape[..leaves]
                .par_iter()
                .map(|node| leaf(&(node.first, node.count)))
                .collect();
            surface.nodes.extend(measured);
        });
        for node in &shape[leaves..] {
            let merged = surface.merge_children(node.first, node.count);
            surface.nodes.push(merged);
        }
        surface
    }

    /// The same surface, of which points follow one side alone where parts touch that are not joined, as the halves of a cut do: that of the
    /// nearest triangle.
    #[must_use]
    pub fn with_sides(mut self) -> Self {
        self.sides = SurfaceSides::of(&self.rest, &self.triangles);
        if let Some(sides) = &mut self.sides {
            for (index, node) in self.nodes.iter().enumerate() {
                let children = node.first as usize..(node.first + node.count) as usize;
                match index < self.leaves {
                    true => sides.push_leaf(&self.order[children]),
                    false => sides.push_node(children),
                }
            }
        }
        self
    }

    /// Number of samples that points can follow: vertices and clusters.
    pub fn samples(&self) -> usize {
        self.rest.len() + self.nodes.len()
    }

    /// Number of vertices, whether a triangle uses them or not.
    pub fn vertices(&self) -> usize {
        self.rest.len()
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        size_of_val(self.rest.as_slice())
            + size_of_val(self.triangles.as_slice())
            + size_of_val(self.order.as_slice())
            + size_of_val(self.weights.as_slice())
            + size_of_val(self.balls.as_slice())
            + size_of_val(self.normals.as_slice())
            + size_of_val(self.nodes.as_slice())
            + self.sides.as_ref().map_or(0, SurfaceSides::byte_size)
    }

    /// Where the vertices are in the rest pose.
    pub(super) fn rest_places(&self) -> &[DVec3] {
        &self.rest
    }

    /// The rest place of a sample.
    pub(super) fn sample_place(&self, sample: u32) -> DVec3 {
        match self.rest.get(sample as usize) {
            Some(&vertex) => vertex,
            None => self.nodes[sample as usize - self.rest.len()].center,
        }
    }

    pub(super) fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|v| self.rest[v as usize])
    }

    /// Perpendicular to a triangle, twice its area long.
    pub(super) fn doubled_normal(&self, triangle: u32) -> DVec3 {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(c - a)
    }

    fn measure_leaf(&self, first: u32, count: u32) -> ClusterNode {
        let places = first as usize..(first + count) as usize;
        let points = corner_points(
            &self.rest,
            self.order[places.clone()].iter().map(|&t| &self.triangles[t as usize]),
        );
        let mut node = ClusterNode::empty(BoundingBox::of(&points), first, count);
        for place in places {
            let triangle = self.order[place];
            let middle = self.corners(triangle).iter().sum::<DVec3>() / 3.0;
            node.add(
                self.weights[place],
                middle,
                self.doubled_normal(triangle).normalize_or_zero(),
            );
        }
        node.finished()
    }

    fn merge_children(&self, first: u32, count: u32) -> ClusterNode {
        let children = &self.nodes[first as usize..(first + count) as usize];
        let mut node = ClusterNode::empty(children[0].bounds, first, count);
        for child in children {
            node.bounds.min = node.bounds.min.min(child.bounds.min);
            node.bounds.max = node.bounds.max.max(child.bounds.max);
            node.add(child.weight, child.center, child.normal);
        }
        node.finished()
    }

    /// Finds the place closest to `point`, of equally near triangles the first; `None` without triangles. Adds to `visits` how
    /// many nodes it looked at.
    pub(super) fn find_nearest(&self, point: DVec3, visits: &mut u64) -> Option<NearestPlace> {
        let root = self.nodes.len().checked_sub(1)?;
        let mut best = (f64::INFINITY, u32::MAX, [1.0, 0.0, 0.0]);
        let mut nearest = f64::INFINITY;
        // Sixteen levels, four children each, one of them taken off.
        let mut waiting = [(0.0f64, root as u32); 64];
        let mut len = 1;
        while len > 0 {
            len -= 1;
            *visits += 1;
            let (square, index) = waiting[len];
            if square > best.0 {
                continue;
            }
            let node = &self.nodes[index as usize];
            if (index as usize) < self.leaves {
                for place in node.first as usize..(node.first + node.count) as usize {
                    if self.balls[place].is_beyond(point, nearest) {
                        continue;
                    }
                    let t = self.order[place];
                    let (corners, square) = closest_weights_on_triangle(point, self.corners(t));
                    if (square, t) < (best.0, best.1) {
                        best = (square, t, corners);
                        nearest = square.sqrt();
                    }
                }
                continue;
            }
            let begin = len;
            for child in node.first..node.first + node.count {
                let square = self.nodes[child as usize].distance_squared(point);
                if square <= best.0 {
                    waiting[len] = (square, child);
                    len += 1;
                }
            }
            // The nearest is visited next.
            waiting[begin..len].sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)));
        }
        (best.1 != u32::MAX).then(|| NearestPlace {
            distance: best.0.sqrt(),
            triangle: best.1,
            corners: best.2,
        })
    }
}

impl ClusterNode {
    fn empty(bounds: BoundingBox, first: u32, count: u32) -> Self {
        Self {
            bounds,
            diagonal: 0.0,
            center: DVec3::ZERO,
            normal: DVec3::ZERO,
            weight: 0.0,
            first,
            count,
        }
    }

    /// Adds a part; centre and normal are sums until [`ClusterNode::finished`] divides them.
    fn add(&mut self, weight: f64, center: DVec3, normal: DVec3) {
        self.weight += weight;
        self.center += center * weight;
        self.normal += normal * weight;
    }

    fn finished(mut self) -> Self {
        self.center /= self.weight;
        self.normal /= self.weight;
        self.diagonal = self.bounds.diagonal();
        self
    }

    /// Squared distance of the box from `point`; 0 inside.
    pub(super) fn distance_squared(&self, point: DVec3) -> f64 {
        let out = (self.bounds.min - point).max(point - self.bounds.max);
        out.max(DVec3::ZERO).length_squared()
    }
}

fn corner_points<'a>(rest: &[DVec3], triangles: impl IntoIterator<Item = &'a [u32; 3]>) -> Vec<DVec3> {
    let corners = triangles.into_iter().flatten();
    corners.map(|&v| rest[v as usize]).collect()
}
