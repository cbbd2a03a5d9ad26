//! Bodies of rounded limbs: a skin is the zero of a field that blends bent bones of varying radius, cut flat by the ground.

use crate::asset::Geometry;
use crate::asset::surface_nets::{Lattice, gradient, polygonise, relax};
use glam::{DVec2, DVec3};

/// A bent bone: a quadratic Bézier curve of three points, with a radius that varies in the same way.
pub(super) struct Bone {
    points: [[f64; 3]; 3],
    radii: [f64; 3],
    /// Over what distance its skin blends with what it grows from.
    blend: f64,
}

pub(super) const fn bone(points: [[f64; 3]; 3], radii: [f64; 3], blend: f64) -> Bone {
    Bone { points, radii, blend }
}

/// A body: its bones, and the axis across which what lies beyond 0 has a twin on the other side.
pub(super) struct Body {
    limbs: Vec<Limb>,
    across: usize,
}

impl Body {
    /// The body that `bones` make. A bone that begins at a positive place along the axis `across` is one of a pair.
    pub(super) fn of(bones: &[Bone], across: usize) -> Self {
        let limbs = bones.iter().map(|bone| Limb::of(bone, across)).collect();
        Self { limbs, across }
    }

    /// About the signed distance from the skin, negative inside.
    pub(super) fn distance(&self, point: DVec3) -> f64 {
        let mut twin = point;
        twin[self.across] = -point[self.across];
        let mut distance = 10.0;
        for limb in &self.limbs {
            distance = limb.blend_into(distance, point);
            if limb.paired {
                distance = limb.blend_into(distance, twin);
            }
        }
        // The ground cuts the soles flat.
        -smooth_min(-distance, point.y, 0.03)
    }

    /// The skin, a distance `off` outside of it, as one primitive with smooth normals. The same bits every time.
    pub(super) fn polygonised(&self, name: &str, lattice: Lattice, off: f64) -> Geometry {
        let field = |p: DVec3| self.distance(p) - off;
        let (mut positions, triangles) = polygonise(&field, lattice);
        relax(&field, &mut positions, &triangles, lattice.cell, 4);
        let normals = positions
            .iter()
            .map(|&p| gradient(&field, p, lattice.cell).normalize_or_zero().as_vec3())
            .collect();
        let mut geometry = Geometry::from_one_mesh(positions, normals, triangles);
        for primitive in &mut geometry.primitives {
            primitive.name = name.into();
        }
        geometry
    }
}

/// Straight pieces that a bone is made of.
const PIECES: usize = 10;

/// A bone ready for measuring distances.
struct Limb {
    pieces: [RoundCone; PIECES],
    blend: f64,
    paired: bool,
    /// A ball around all of it.
    ball: (DVec3, f64),
}

impl Limb {
    fn of(bone: &Bone, across: usize) -> Self {
        let points = bone.points.map(DVec3::from_array);
        let joint = |i: usize| {
            let t = i as f64 / PIECES as f64;
            let weights = [(1.0 - t) * (1.0 - t), 2.0 * t * (1.0 - t), t * t];
            let point = (0..3).map(|k| points[k] * weights[k]).sum::<DVec3>();
            (point, (0..3).map(|k| bone.radii[k] * weights[k]).sum::<f64>())
        };
        let center = joint(PIECES / 2).0;
        let reach = |(point, radius): (DVec3, f64)| center.distance(point) + radius;
        Self {
            pieces: std::array::from_fn(|i| RoundCone::new(joint(i), joint(i + 1))),
            blend: bone.blend,
            paired: points[0][across] > 0.0,
            ball: (center, (0..=PIECES).map(|i| reach(joint(i))).fold(0.0, f64::max)),
        }
    }

    /// Blends the limb's distance into that of what is there already.
    fn blend_into(&self, distance: f64, point: DVec3) -> f64 {
        if point.distance(self.ball.0) - self.ball.1 >= distance + self.blend {
            return distance;
        }
        let own = self
            .pieces
            .iter()
            .map(|piece| piece.distance(point))
            .fold(f64::INFINITY, f64::min);
        smooth_min(distance, own, self.blend)
    }
}

/// The hull of two balls.
struct RoundCone {
    start: DVec3,
    axis: DVec3,
    length: f64,
    radius: f64,
    /// By how much the radius shrinks along the axis, and the tangent of that angle.
    slope: f64,
    lean: f64,
}

impl RoundCone {
    fn new((start, radius): (DVec3, f64), (end, end_radius): (DVec3, f64)) -> Self {
        let length = start.distance(end);
        let slope = (radius - end_radius) / length;
        let lean = slope / (1.0 - slope * slope).sqrt();
        Self {
            start,
            axis: (end - start) / length,
            length,
            radius,
            slope,
            lean,
        }
    }

    /// Signed distance from its surface.
    fn distance(&self, point: DVec3) -> f64 {
        let offset = point - self.start;
        let along = offset.dot(self.axis);
        let aside = (offset.length_squared() - along * along).max(0.0).sqrt();
        // The nearest ball's centre lies off the foot of the perpendicular, by the lean of the mantle.
        let center = (along - aside * self.lean).clamp(0.0, self.length);
        DVec2::new(aside, along - center).length() - (self.radius - self.slope * center)
    }
}

/// The smaller of two numbers, rounded off where they differ by less than `blend`.
fn smooth_min(a: f64, b: f64, blend: f64) -> f64 {
    let overlap = (blend - (a - b).abs()).max(0.0) / blend;
    a.min(b) - overlap * overlap * blend * 0.25
}
