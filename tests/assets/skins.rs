//! Skinned models stand where they are drawn, and come back so. Runs over every skinned model of the data folder.

use crate::support::bench::largest_distance;
use crate::support::data::data_folder;
use crate::support::gltf_parsed::{Parsed, parse};
use crate::support::gltf_sets::{companions_of, file_set, gltf_files};
use crate::support::recipes;
use crate::support::shapes::bounds;
use crate::support::skinning::{draw, list, numbers, world_transforms};
use glam::DVec3;
use pliant::asset::{Format, Limits, Model, WrittenFiles};
use std::path::PathBuf;

/// Every model of data/gltf that is read and whose document fits, with its path and the document; there are more than `least`.
pub fn models_where(what: &str, least: usize, fits: impl Fn(&Parsed) -> bool) -> Vec<(String, Model, Parsed)> {
    let Some(data) = data_folder(what) else {
        return Vec::new();
    };
    let read = |path: PathBuf| {
        let files = file_set(&path);
        let companions = companions_of(&files);
        let model = Model::read(files, None, &Limits::default()).ok()?;
        let parsed = parse(&model.files.main, &companions);
        fits(&parsed).then(|| (path.display().to_string(), model, parsed))
    };
    let models: Vec<_> = gltf_files(&data.join("gltf")).into_iter().filter_map(read).collect();
    assert!(
        models.len() > least,
        "{what}: the data folder has more than {}",
        models.len()
    );
    models
}

/// Every skinned model.
pub fn skinned_models(what: &str) -> Vec<(String, Model, Parsed)> {
    models_where(what, 12, |parsed| parsed.json["skins"].is_array())
}

pub fn diagonal(positions: &[DVec3]) -> f64 {
    let (low, high) = bounds(positions);
    (high - low).length()
}

/// The largest distance of a model's vertices from where a plain player of the file draws them; `None` for files that it does
/// not read.
pub fn off_from_drawn(model_positions: &[DVec3], model: &Model, file: &Parsed) -> Option<f64> {
    let drawn = draw(file, None, &[])?;
    let mut worst = 0.0_f64;
    for row in &model.primitives {
        let own = drawn
            .iter()
            .find(|d| (d.node, d.primitive) == (row.node as usize, row.primitive as usize));
        // The plain player reads no Draco; such models are compared with their originals.
        let own = own?;
        let here = &model_positions[row.first_vertex as usize..(row.first_vertex + row.vertex_count) as usize];
        let off = own.positions.iter().zip(here).map(|(a, b)| (*a - *b).length());
        worst = off.fold(worst, f64::max);
    }
    Some(worst)
}

#[test]
fn a_skinned_model_stands_where_it_is_drawn() {
    let mut compared = 0;
    for (path, model, file) in skinned_models("rest poses") {
        let size = diagonal(&model.positions);
        if let Some(off) = off_from_drawn(&model.positions, &model, &file) {
            assert!(off <= 3e-6 * size, "{path}: off by {off} of {size}");
            compared += 1;
        }
        let codes: Vec<&str> = model.warnings.iter().map(|w| w.0.as_str()).collect();
        assert!(!codes.contains(&"skin-not-applied"), "{path}: {:?}", model.warnings);
    }
    assert!(compared == 0 || compared > 9, "{compared}");
}

#[test]
fn compressed_skins_stand_where_their_originals_do() {
    let models = skinned_models("compressed rest poses");
    let size_of = |name: &str| {
        let found = models.iter().find(|(path, _, _)| path.ends_with(name))?;
        Some(bounds(&found.1.positions))
    };
    for (packed, original) in [
        ("BrainStem_gltfpack_c.glb", "BrainStem.glb"),
        ("Fox_gltfpack_cc.glb", "Fox.glb"),
        ("RiggedFigure_noq_meshopt_fallback.gltf", "RiggedFigure.glb"),
    ] {
        let (Some(a), Some(b)) = (size_of(packed), size_of(original)) else {
            continue;
        };
        let size = (b.1 - b.0).length();
        let off = (a.0 - b.0).length().max((a.1 - b.1).length());
        assert!(off < 2e-3 * size, "{packed}: {off} of {size}");
    }
}

/// What a joint node is an ancestor of, itself included.
fn is_below(file: &Parsed, node: u64, ancestor: u64) -> bool {
    let mut children = list(&file.json["nodes"][ancestor as usize]["children"])
        .iter()
        .filter_map(|c| c.as_u64());
    node == ancestor || children.any(|c| is_below(file, node, c))
}

#[test]
fn the_lowest_vertices_in_the_world_are_those_of_the_feet() {
    let models = skinned_models("feet at the feet");
    // The nodes of the lower legs, as one finds them by following the hips' children down.
    for name in ["Fox.glb", "CesiumMan.glb", "BrainStem.glb", "RiggedFigure.glb"] {
        let Some((_, model, file)) = models.iter().find(|(path, _, _)| path.ends_with(name)) else {
            continue;
        };
        let (low, high) = bounds(&model.positions);
        assert!(
            low.y.abs() < 0.06 * (high.y - low.y),
            "{name} stands on the ground: {low} {high}"
        );
        let world = world_transforms(file, None).expect("not compressed");
        let joints: Vec<u64> = list(&file.json["skins"][0]["joints"])
            .iter()
            .filter_map(|j| j.as_u64())
            .collect();
        let feet_height = low.y + 0.06 * (high.y - low.y);
        let mut counted = 0;
        for row in &model.primitives {
            let primitive = &file.json["meshes"][row.mesh as usize]["primitives"][row.primitive as usize];
            let of = |key: &str| numbers(file, &primitive["attributes"][key]).expect("not compressed");
            let (joint, weight) = (of("JOINTS_0"), of("WEIGHTS_0"));
            for v in 0..row.vertex_count as usize {
                if model.positions[row.first_vertex as usize + v].y > feet_height {
                    continue;
                }
                counted += 1;
                let heaviest = (0..4)
                    .max_by(|&a, &b| weight[4 * v + a].total_cmp(&weight[4 * v + b]))
                    .expect("four");
                let held = joints[joint[4 * v + heaviest] as usize];
                // The joint that holds it is in the lower half of the body, and so is all below it.
                let below = joints.iter().filter(|&&j| is_below(file, j, held));
                let top = below
                    .map(|&j| world[j as usize].translation.y)
                    .fold(f64::NEG_INFINITY, f64::max);
                assert!(
                    top < low.y + 0.5 * (high.y - low.y),
                    "{name}: vertex {v} is held by node {held}"
                );
            }
        }
        assert!(counted > 10, "{name}: {counted}");
    }
}

/// A smooth motion that turns and stretches.
fn leant(positions: &[DVec3]) -> Vec<DVec3> {
    let (low, high) = bounds(positions);
    let size = (high - low).max_element();
    let lean = |p: &DVec3| {
        let t = (p.y - low.y) / size;
        *p + DVec3::new(0.2 * size * t * t, 0.15 * size * t, -0.1 * size * t)
    };
    positions.iter().map(lean).collect()
}

pub fn read_back(written: &WrittenFiles, format: Format) -> (Model, Parsed) {
    (
        recipes::read_back(written, format),
        parse(&written.main, &written.companions),
    )
}

#[test]
fn what_is_written_is_drawn_where_it_was_put() {
    for (path, model, _) in skinned_models("skinned results at rest") {
        let wanted = leant(&model.positions);
        let (again, file) = read_back(&model.write(&wanted, model.format).expect("writable"), model.format);
        let size = diagonal(&wanted);
        let off = largest_distance(&again.positions, &wanted);
        assert!(off <= 1e-5 * size, "{path}: read again off by {off} of {size}");
        if let Some(off) = off_from_drawn(&wanted, &model, &file) {
            assert!(off <= 1e-5 * size, "{path}: drawn off by {off} of {size}");
        }
    }
}
