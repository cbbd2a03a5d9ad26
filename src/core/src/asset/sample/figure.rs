//! A person who stands with the arms stretched out: about 1.75 units tall, on the ground y = 0, y up, looking along +z.

use super::limbs::{Body, Bone, bone};
use crate::asset::formats::codec_of;
use crate::asset::neutral::NeutralModel;
use crate::asset::surface_nets::Lattice;
use crate::asset::{Format, Geometry};
use glam::{DVec3, USizeVec3};

/// The figure's skin as a closed mesh of cells of the edge `cell` (0.01 to 0.2), a distance `off` (0 to 0.1) outside of the body.
/// The same bits every time.
pub fn figure_body(name: &str, cell: f64, off: f64) -> Geometry {
    let (low, high) = (DVec3::new(-0.93, 0.0, -0.25), DVec3::new(0.93, 1.82, 0.26));
    let low = low - DVec3::splat(off + 2.0 * cell);
    let size = (high + DVec3::splat(off + 2.0 * cell) - low) / cell;
    let lattice = Lattice {
        low,
        cell,
        cells: USizeVec3::from_array(size.to_array().map(|cells| cells.ceil() as usize)),
    };
    Body::of(&BONES, 0).polygonised(name, lattice, off)
}

/// The figure's body alone, as a GLB file: one closed mesh, without a skeleton. The same bytes every time.
///
/// # Panics
/// Never: some ten thousand finite vertices fit the format.
pub fn body_glb() -> Vec<u8> {
    let body = NeutralModel::from_geometry(figure_body("body", BODY_CELL, 0.0));
    let built = codec_of(Format::GLB).build(&body, Format::GLB);
    built.expect("a small finite mesh fits the format").main
}

/// Edge of the cells that the body alone is sampled with.
const BODY_CELL: f64 = 0.015;

/// What lies at x > 0 has a twin on the other side.
const BONES: [Bone; 11] = [
    // Trunk, one for each side.
    bone(
        [[0.055, 0.95, 0.0], [0.04, 1.12, 0.012], [0.075, 1.33, 0.0]],
        [0.125, 0.105, 0.12],
        0.08,
    ),
    // Neck, head and nose.
    bone(
        [[0.0, 1.36, -0.01], [0.0, 1.45, -0.01], [0.0, 1.54, 0.01]],
        [0.075, 0.055, 0.06],
        0.07,
    ),
    bone(
        [[0.0, 1.57, 0.012], [0.0, 1.63, 0.02], [0.0, 1.66, 0.0]],
        [0.08, 0.1, 0.105],
        0.04,
    ),
    bone(
        [[0.0, 1.61, 0.1], [0.0, 1.6, 0.115], [0.0, 1.59, 0.12]],
        [0.02, 0.022, 0.024],
        0.03,
    ),
    // Arm, hand and thumb.
    bone(
        [[0.14, 1.385, 0.0], [0.30, 1.41, 0.0], [0.46, 1.41, 0.0]],
        [0.078, 0.06, 0.047],
        0.07,
    ),
    bone(
        [[0.45, 1.41, 0.0], [0.56, 1.41, 0.0], [0.69, 1.41, 0.0]],
        [0.048, 0.049, 0.034],
        0.03,
    ),
    bone(
        [[0.70, 1.41, 0.0], [0.77, 1.41, 0.005], [0.86, 1.405, 0.0]],
        [0.036, 0.044, 0.028],
        0.03,
    ),
    bone(
        [[0.72, 1.41, 0.03], [0.77, 1.41, 0.06], [0.8, 1.41, 0.075]],
        [0.024, 0.024, 0.022],
        0.03,
    ),
    // Leg and foot.
    bone(
        [[0.095, 0.92, 0.0], [0.11, 0.72, 0.015], [0.11, 0.49, 0.0]],
        [0.118, 0.09, 0.06],
        0.05,
    ),
    bone(
        [[0.11, 0.49, 0.0], [0.115, 0.30, -0.02], [0.11, 0.09, -0.01]],
        [0.058, 0.06, 0.042],
        0.03,
    ),
    bone(
        [[0.11, 0.06, -0.04], [0.11, 0.055, 0.06], [0.115, 0.04, 0.15]],
        [0.055, 0.05, 0.04],
        0.04,
    ),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::shapes::tests::{boundary_edges, euler, volume};

    #[test]
    fn every_level_of_detail_is_one_closed_manifold() {
        for (cell, off, least, most) in [
            (0.02, 0.0, 5000, 8000),
            (0.035, 0.0, 1200, 2500),
            (0.055, 0.0, 400, 1000),
            (0.1, 0.05, 100, 500),
        ] {
            let figure = figure_body("body", cell, off);
            let count = figure.positions.len();
            assert!((least..=most).contains(&count), "{count} vertices at {cell}");
            let shape = (figure.positions.clone(), figure.triangles.clone());
            assert_eq!((boundary_edges(&shape), euler(&shape)), (0, 2), "at {cell}");
            assert!((0.05..0.25).contains(&volume(&shape)), "{}", volume(&shape));
        }
    }
}
