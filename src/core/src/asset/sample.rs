//! A friendly four-legged creature, made on the spot, for trying pliant where no model is at hand.
//!
//! It is about two units long, stands on the ground y = 0 with the origin between its feet, y up, looking along +x. Its
//! skin is one closed manifold: the zero of a field that blends rounded limbs.

use super::formats::codec_of;
use super::neutral::NeutralModel;
use super::surface_nets::{Lattice, gradient, polygonise, relax};
use super::{Format, Geometry};
use glam::{DVec2, DVec3, USizeVec3};

/// Useful regions of the creature, in its rest pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleHandles {
    /// Centre and radius of a sphere around the head, ears included.
    pub head: ([f64; 3], f64),
    /// Centre and radius of a sphere around the end of the tail.
    pub tail: ([f64; 3], f64),
    /// Normal n and offset of the half-space n·x ≥ offset that holds the four feet.
    pub feet: ([f64; 3], f64),
}

/// The regions that examples use.
pub const HANDLES: SampleHandles = SampleHandles {
    head: ([0.76, 1.22, 0.0], 0.36),
    tail: ([-1.0, 1.06, 0.0], 0.16),
    feet: ([0.0, -1.0, 0.0], -0.14),
};

/// Edge of the cells that the skin is sampled with.
const CELL: f64 = 0.03;

/// The creature as a mesh with smooth normals. The same bits every time.
pub fn creature() -> Geometry {
    let limbs: Vec<Limb> = BONES.iter().map(Limb::new).collect();
    let field = |p: DVec3| skin(&limbs, p);
    let lattice = Lattice {
        low: DVec3::new(-1.25, -0.16, -0.60),
        cell: CELL,
        cells: USizeVec3::new(82, 62, 40),
    };
    let (mut positions, triangles) = polygonise(&field, lattice);
    relax(&field, &mut positions, &triangles, CELL, 4);
    let normals = positions
        .iter()
        .map(|&p| gradient(&field, p, CELL).normalize_or_zero().as_vec3())
        .collect();
    let mut geometry = Geometry::from_one_mesh(positions, normals, triangles);
    for primitive in &mut geometry.primitives {
        primitive.name = "creature".into();
    }
    geometry
}

/// The creature as a GLB file.
///
/// # Panics
/// Never: a mesh of a few thousand finite vertices fits the format.
pub fn creature_glb() -> Vec<u8> {
    codec_of(Format::GLB)
        .build(&NeutralModel::from_geometry(creature()), Format::GLB)
        .expect("a small finite mesh fits the format")
        .main
}

/// A bent bone: a curve from the first point to the last that the middle one pulls toward itself (a quadratic Bézier),
/// with a radius that goes along in the same way.
struct Bone {
    points: [[f64; 3]; 3],
    radii: [f64; 3],
    /// Over what distance its skin blends with what it grows from.
    blend: f64,
}

const fn bone(points: [[f64; 3]; 3], radii: [f64; 3], blend: f64) -> Bone {
    Bone { points, radii, blend }
}

/// What lies at z > 0 has a twin on the other side.
const BONES: [Bone; 12] = [
    // Trunk, from rump to chest, with a little sway in the back.
    bone(
        [[-0.42, 0.67, 0.0], [-0.05, 0.60, 0.0], [0.28, 0.72, 0.0]],
        [0.27, 0.26, 0.26],
        0.05,
    ),
    // Neck, skull and muzzle.
    bone(
        [[0.30, 0.78, 0.0], [0.50, 0.88, 0.0], [0.62, 1.10, 0.0]],
        [0.20, 0.17, 0.16],
        0.16,
    ),
    bone(
        [[0.60, 1.18, 0.0], [0.68, 1.22, 0.0], [0.76, 1.18, 0.0]],
        [0.23, 0.24, 0.22],
        0.08,
    ),
    bone(
        [[0.76, 1.13, 0.0], [0.88, 1.10, 0.0], [0.97, 1.10, 0.0]],
        [0.16, 0.15, 0.12],
        0.10,
    ),
    bone(
        [[1.04, 1.17, 0.0], [1.05, 1.175, 0.0], [1.06, 1.17, 0.0]],
        [0.055, 0.06, 0.055],
        0.02,
    ),
    // Eyes.
    bone(
        [[0.855, 1.30, 0.115], [0.865, 1.302, 0.118], [0.875, 1.30, 0.12]],
        [0.06, 0.062, 0.06],
        0.02,
    ),
    // Hanging ears.
    bone(
        [[0.62, 1.35, 0.12], [0.54, 1.60, 0.36], [0.54, 1.22, 0.43]],
        [0.07, 0.085, 0.075],
        0.06,
    ),
    // Tail, curled up.
    bone(
        [[-0.58, 0.76, 0.0], [-1.10, 0.72, 0.0], [-1.00, 1.12, 0.0]],
        [0.14, 0.08, 0.055],
        0.14,
    ),
    // Front and hind legs, then feet.
    bone(
        [[0.25, 0.62, 0.15], [0.30, 0.36, 0.19], [0.27, 0.10, 0.18]],
        [0.16, 0.11, 0.105],
        0.10,
    ),
    bone(
        [[-0.42, 0.62, 0.14], [-0.40, 0.36, 0.19], [-0.47, 0.10, 0.18]],
        [0.19, 0.12, 0.11],
        0.10,
    ),
    bone(
        [[0.28, 0.075, 0.18], [0.32, 0.075, 0.18], [0.38, 0.065, 0.18]],
        [0.11, 0.105, 0.09],
        0.05,
    ),
    bone(
        [[-0.46, 0.075, 0.18], [-0.42, 0.075, 0.18], [-0.36, 0.065, 0.18]],
        [0.115, 0.11, 0.095],
        0.05,
    ),
];

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
    fn new(bone: &Bone) -> Self {
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
            paired: points[0].z > 0.0,
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

/// About the signed distance from the skin, negative inside.
fn skin(limbs: &[Limb], point: DVec3) -> f64 {
    let mut distance = 10.0;
    for limb in limbs {
        distance = limb.blend_into(distance, point);
        if limb.paired {
            distance = limb.blend_into(distance, DVec3::new(point.x, point.y, -point.z));
        }
    }
    // The ground cuts the soles flat.
    -smooth_min(-distance, point.y, 0.03)
}

/// The smaller of two numbers, rounded off where they differ by less than `blend`.
fn smooth_min(a: f64, b: f64, blend: f64) -> f64 {
    let overlap = (blend - (a - b).abs()).max(0.0) / blend;
    a.min(b) - overlap * overlap * blend * 0.25
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::shapes::tests::{boundary_edges, euler, volume};
    use crate::asset::{FileSet, Limits, Model};

    #[test]
    fn the_creature_is_one_closed_manifold_of_modest_size() {
        let creature = creature();
        assert!(
            (6000..=9000).contains(&creature.positions.len()),
            "{} vertices",
            creature.positions.len()
        );
        let shape = (creature.positions.clone(), creature.triangles.clone());
        assert_eq!((boundary_edges(&shape), euler(&shape)), (0, 2));
        assert!(volume(&shape) > 0.2);
        let (low, high) = creature
            .positions
            .iter()
            .fold((DVec3::MAX, DVec3::MIN), |(l, h), p| (l.min(*p), h.max(*p)));
        assert!(
            low.y.abs() < 0.02 && (1.8..2.3).contains(&(high.x - low.x)),
            "from {low} to {high}"
        );
    }

    #[test]
    fn normals_agree_with_the_triangles() {
        let creature = creature();
        for t in &creature.triangles {
            let [a, b, c] = t.map(|v| creature.positions[v as usize]);
            let face = (b - a).cross(c - a).normalize();
            for &v in t {
                let normal = creature.normals[v as usize].as_dvec3();
                assert!((normal.length() - 1.0).abs() < 1e-5 && normal.dot(face) > 0.2);
            }
        }
    }

    #[test]
    fn the_named_regions_hold_what_they_say() {
        let positions = creature().positions;
        let in_sphere = |(center, radius): ([f64; 3], f64)| {
            positions
                .iter()
                .filter(|p| p.distance(DVec3::from_array(center)) <= radius)
                .copied()
                .collect::<Vec<_>>()
        };
        let (head, tail) = (in_sphere(HANDLES.head), in_sphere(HANDLES.tail));
        assert!(head.len() > 300 && head.iter().all(|p| p.x > 0.3 && p.y > 0.8));
        assert!(tail.len() > 20 && tail.iter().all(|p| p.x < -0.8));
        let (normal, offset) = HANDLES.feet;
        let feet: Vec<_> = positions
            .iter()
            .filter(|p| p.dot(DVec3::from_array(normal)) >= offset)
            .collect();
        for (front, left) in [(false, false), (false, true), (true, false), (true, true)] {
            assert!(
                feet.iter()
                    .filter(|p| (p.x > 0.0) == front && (p.z > 0.0) == left)
                    .count()
                    > 50
            );
        }
    }

    #[test]
    fn the_file_reads_back() {
        let files = FileSet::single("creature.glb", creature_glb());
        let model = Model::read(files, None, &Limits::default()).expect("it is a GLB");
        assert_eq!(model.triangles, creature().triangles);
        assert!(model.primitives[0].has_normals);
    }
}
