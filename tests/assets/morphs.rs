//! Morph targets follow the shape under them. Runs over every model of the data folder that has any.

use crate::support::data::data_folder;
use crate::support::gltf_parsed::{Parsed, parse};
use crate::support::gltf_sets::{companions_of, file_set, gltf_files};
use crate::support::skinning::{draw, numbers};
use glam::{DQuat, DVec3};
use pliant::asset::{Following, Limits, Model, MorphTargetRule, WrittenFiles};
use std::path::PathBuf;

/// Every model with morph targets that is read and not compressed.
fn morphed_models(what: &str) -> Vec<(PathBuf, Model, Parsed)> {
    let Some(data) = data_folder(what) else {
        return Vec::new();
    };
    let read = |path: PathBuf| {
        let files = file_set(&path);
        let companions = companions_of(&files);
        let model = Model::read(files, None, &Limits::default()).ok()?;
        let parsed = parse(&model.files.main, &companions);
        let meshes = parsed.json["meshes"].as_array()?;
        let mut primitives = meshes.iter().flat_map(|m| m["primitives"].as_array()).flatten();
        let has_targets = primitives.any(|p| p["targets"].is_array());
        (has_targets && draw(&parsed, None, &[]).is_some()).then_some((path, model, parsed))
    };
    let models: Vec<_> = gltf_files(&data.join("gltf")).into_iter().filter_map(read).collect();
    assert!(
        models.len() > 7,
        "the data folder has more models with targets than {}",
        models.len()
    );
    models
}

fn reread(written: &WrittenFiles) -> Parsed {
    parse(&written.main, &written.companions)
}

fn drawn(file: &Parsed, weights: &[f64]) -> Vec<DVec3> {
    let all = draw(file, None, weights).expect("not compressed");
    all.into_iter().flat_map(|d| d.positions).collect()
}

#[test]
fn a_turned_and_grown_model_shows_its_targets_turned_and_grown() {
    let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.0);
    let place = |p: DVec3| turn * p * 1.25 + DVec3::new(0.5, -0.25, 2.0);
    for (path, model, file) in morphed_models("turned targets") {
        let positions: Vec<DVec3> = model.positions.iter().map(|&p| place(p)).collect();
        let again = reread(&model.write(&positions, model.format).expect("writable"));
        for weights in [vec![1.0; 16], vec![-0.5, 2.0, 0.25]] {
            let (before, after) = (drawn(&file, &weights), drawn(&again, &weights));
            let size = before.iter().fold(0.0_f64, |size, p| size.max(p.length())) * 1.25 + 2.0;
            let off = before
                .iter()
                .zip(&after)
                .map(|(a, b)| (place(*a) - *b).length())
                .fold(0.0, f64::max);
            assert!(off <= 2e-6 * size, "{}: off by {off} of {size}", path.display());
            let still = drawn(&again, &[]);
            assert!(
                after.iter().zip(&still).any(|(a, b)| a != b),
                "{}: the targets do something",
                path.display()
            );
        }
    }
}

#[test]
fn targets_that_are_to_stay_keep_their_numbers() {
    let following = Following {
        morph_targets: MorphTargetRule::Keep,
        ..Following::default()
    };
    for (path, model, file) in morphed_models("kept targets") {
        let positions: Vec<DVec3> = model.positions.iter().map(|p| DVec3::new(p.y, p.z, p.x)).collect();
        let again = reread(
            &model
                .write_following(&positions, model.format, following.clone())
                .expect("writable"),
        );
        let targets = |file: &Parsed| -> Vec<Vec<f64>> {
            let meshes = file.json["meshes"].as_array().expect("meshes").iter();
            let primitives = meshes.flat_map(|m| m["primitives"].as_array()).flatten();
            let targets = primitives.flat_map(|p| p["targets"].as_array()).flatten();
            let accessors = targets.flat_map(|t| t.as_object().expect("an object").values());
            accessors.map(|a| numbers(file, a).expect("not compressed")).collect()
        };
        assert_eq!(targets(&again), targets(&file), "{}", path.display());
    }
}
