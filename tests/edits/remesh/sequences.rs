//! Random edits one after another.

use super::edit_support::*;
use super::measures::*;
use glam::DVec3;
use pliant::edit::{
    CreaseOptions, Error, RemeshTarget, SubdivisionScheme, SurfacePatch, decimate_region, remesh_region,
    subdivide_region, weld_points,
};
use pliant::progress::Silent;
use proptest::prelude::*;

#[derive(Debug, Clone, Copy)]
enum Step {
    Subdivide(SubdivisionScheme),
    Decimate(f64),
    Remesh(f64),
    Weld(f64),
}

fn steps() -> impl Strategy<Value = Vec<(Step, [f64; 3], f64)>> {
    let step = prop_oneof![
        Just(Step::Subdivide(SubdivisionScheme::Midpoint)),
        Just(Step::Subdivide(SubdivisionScheme::Loop)),
        (0.1..0.9f64).prop_map(Step::Decimate),
        (0.4..2.0f64).prop_map(Step::Remesh),
        (0.0..0.3f64).prop_map(Step::Weld),
    ];
    let place = [-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64];
    prop::collection::vec((step, place, 0.2..1.5f64), 1..7)
}

fn run(model: &Model, step: Step, faces: &[u32]) -> Result<SurfacePatch, Error> {
    let surface = model.surface();
    let length = mean_length(model);
    match step {
        Step::Subdivide(scheme) => subdivide_region(&surface, faces, scheme, &CreaseOptions::default(), &Silent),
        Step::Decimate(ratio) => decimate_region(&surface, faces, ratio, &Silent),
        Step::Remesh(factor) => {
            let options = RemeshTarget::Length(length * factor).into();
            remesh_region(&surface, faces, &options, &Silent)
        }
        Step::Weld(factor) => weld_points(&surface, length * factor, &Silent),
    }
}

fn check_sequence(mut model: Model, steps: &[(Step, [f64; 3], f64)]) {
    let before = topology(&model);
    let box_size = model
        .positions
        .iter()
        .fold(DVec3::ZERO, |m, p| m.max(p.abs()))
        .max_element();
    for &(step, place, radius) in steps {
        let middle = DVec3::from_array(place) * box_size;
        let faces = region(&model, |p| p.distance(middle) < radius * box_size);
        let too_many = model.triangles.len() > 20_000 && matches!(step, Step::Subdivide(_));
        if faces.is_empty() || too_many {
            continue;
        }
        let patch = match run(&model, step, &faces) {
            Ok(patch) => patch,
            Err(Error::Impossible { .. }) => continue,
            Err(e) => panic!("{step:?}: {e}"),
        };
        assert_eq!(Ok(&patch), run(&model, step, &faces).as_ref(), "the same twice");
        assert_blends(&model, &patch);
        let next = after(&model, &patch);
        let t = topology(&next);
        let last = topology(&model);
        let worse = t.crowded_edges > last.crowded_edges || t.twisted_edges > last.twisted_edges;
        // Dividing divides edges with too many faces as well.
        let divided = matches!(step, Step::Subdivide(_)) && last.crowded_edges + last.twisted_edges > 0;
        assert!(!worse || divided, "{step:?}: {last:?} {t:?}");
        if before.is_manifold() {
            assert!(t.is_manifold(), "{step:?}: {t:?}");
        }
        if before.is_closed() {
            assert!(t.is_closed(), "{step:?}: {t:?}");
        }
        if before.is_closed() && !matches!(step, Step::Weld(_)) {
            assert_eq!(t.euler, last.euler, "{step:?}");
        }
        model = next;
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn closed_shapes_stay_closed(steps in steps(), shape in 0..4usize) {
        let model = match shape {
            0 => Model::of(sphere(3, 1.0)),
            1 => Model::of(torus(24, 12, 1.0, 0.4)),
            2 => with_seams(&Model::of(cube(4)), box_side, false),
            _ => with_seams(&Model::of(sphere(3, 1.0)), box_side, true),
        };
        check_sequence(model, &steps);
    }

    #[test]
    fn open_and_broken_shapes_get_no_worse(steps in steps(), shape in 0..3usize) {
        let model = match shape {
            0 => Model::of(sheet(12, 9)),
            1 => fins(),
            _ => needles(),
        };
        check_sequence(model, &steps);
    }
}

/// Three sheets that meet at one line, and a pair of faces that touch at a point.
fn fins() -> Model {
    let (flat, faces) = sheet(6, 6);
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for k in 0..3 {
        let angle = f64::from(k) * 2.1;
        let first = positions.len() as u32;
        positions.extend(
            flat.iter()
                .map(|p| DVec3::new(p.x * angle.cos(), p.x * angle.sin(), p.y)),
        );
        triangles.extend(faces.iter().map(|t| t.map(|v| v + first)));
    }
    let first = positions.len() as u32;
    positions.extend([
        DVec3::new(6.0, 0.0, 0.0),
        DVec3::new(8.0, 0.0, 0.0),
        DVec3::new(8.0, 1.0, 0.0),
    ]);
    triangles.push([first, first + 1, first + 2]);
    Model::of((positions, triangles))
}

/// A sheet with faces without area and faces there twice.
fn needles() -> Model {
    let (mut positions, mut triangles) = sheet(8, 8);
    for i in [20usize, 40, 41] {
        positions[i] = positions[i + 1] * 0.5 + positions[i - 1] * 0.5;
    }
    for i in [10usize, 50] {
        positions[i] = positions[i + 9] + DVec3::splat(1e-14);
    }
    triangles.push(triangles[5]);
    let [a, b, c] = triangles[17];
    triangles.push([b, a, c]);
    let count = triangles.len();
    Model {
        point_of: (0..positions.len() as u32).collect(),
        points: positions.len() as u32,
        positions,
        triangles,
        primitive_of: vec![0; count],
        first_vertex: vec![0],
    }
}
