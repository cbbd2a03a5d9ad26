//! A friendly four-legged creature, made on the spot, for trying pliant where no model is at hand.
//!
//! It is about two units long, stands on the ground y = 0 with the origin between its feet, y up, looking along +x. Its
//! skin is one closed manifold: the zero of a field that blends rounded limbs.

use super::limbs::{Body, Bone, bone};
use crate::asset::formats::codec_of;
use crate::asset::neutral::NeutralModel;
use crate::asset::surface_nets::Lattice;
use crate::asset::{Format, Geometry};
use glam::{DVec3, USizeVec3};

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
    let lattice = Lattice {
        low: DVec3::new(-1.25, -0.16, -0.60),
        cell: CELL,
        cells: USizeVec3::new(82, 62, 40),
    };
    Body::of(&BONES, 2).polygonised("creature", lattice, 0.0)
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
