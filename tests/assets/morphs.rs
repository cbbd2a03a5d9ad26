//! Morph targets follow the shape under them. Runs over every model of the data folder that has any.

use crate::skins::models_where;
use crate::support::gltf_parsed::{Parsed, parse};
use crate::support::skinning::{draw, list, numbers};
use glam::{DQuat, DVec3};
use pliant::asset::{Following, Model, MorphTargetRule, WrittenFiles};

/// Every model with morph targets that is read and not compressed.
fn morphed_models(what: &str) -> Vec<(String, Model, Parsed)> {
    models_where(what, 7, |parsed| {
        let mut primitives = list(&parsed.json["meshes"]).iter().flat_map(|m| list(&m["primitives"]));
        primitives.any(|p| p["targets"].is_array()) && draw(parsed, None, &[]).is_some()
    })
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
            assert!(off <= 2e-6 * size, "{path}: off by {off} of {size}");
            let still = drawn(&again, &[]);
            assert!(
                after.iter().zip(&still).any(|(a, b)| a != b),
                "{path}: the targets do something"
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
            let primitives = list(&file.json["meshes"]).iter().flat_map(|m| list(&m["primitives"]));
            let targets = primitives.flat_map(|p| list(&p["targets"]));
            let accessors = targets.flat_map(|t| t.as_object().expect("an object").values());
            accessors.map(|a| numbers(file, a).expect("not compressed")).collect()
        };
        assert_eq!(targets(&again), targets(&file), "{path}");
    }
}
