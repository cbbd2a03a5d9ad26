//! Bones keep their lengths where the option asks for it: in the rest pose, in clips, and without tearing what is drawn. Runs over the built-in
//! figure and every skinned model of the data folder.

use crate::rigs::{Reshaping, joints, largest, stretches};
use crate::skins::{diagonal, off_from_drawn, read_back, skinned_models};
use crate::support::bench::largest_distance;
use crate::support::gltf_parsed::{Parsed, parse};
use crate::support::skinning::{ClipTime, clip_length, list, world_transforms};
use glam::DVec3;
use pliant::asset::sample::BuiltInModel;
use pliant::asset::{BoneLengthRule, FileSet, Following, Limits, Model, WrittenFiles};
use std::collections::BTreeMap;

/// The figure, and the skinned models of the data folder.
fn models(what: &str) -> Vec<(String, Model, Parsed)> {
    let bytes = BuiltInModel::Figure.glb();
    let files = FileSet::single("figure.glb", bytes);
    let figure = Model::read(files, None, &Limits::default()).expect("readable");
    let mut all = vec![("figure.glb".into(), figure, parse(bytes, &BTreeMap::new()))];
    all.extend(skinned_models(what));
    all
}

fn write_with(model: &Model, positions: &[DVec3], bone_lengths: BoneLengthRule) -> WrittenFiles {
    let following = Following {
        bone_lengths,
        ..Following::default()
    };
    model
        .write_following(positions, model.format, following)
        .expect("writable")
}

fn parents(file: &Parsed) -> Vec<Option<usize>> {
    let nodes = list(&file.json["nodes"]);
    let mut parents = vec![None; nodes.len()];
    for (i, node) in nodes.iter().enumerate() {
        for child in list(&node["children"]) {
            parents[child.as_u64().expect("an index") as usize] = Some(i);
        }
    }
    parents
}

/// Every joint with the nearest joint above it.
fn bones(file: &Parsed) -> Vec<(usize, usize)> {
    let (parents, joints) = (parents(file), joints(file));
    let above = |joint: usize| {
        let mut at = parents[joint];
        while let Some(node) = at.filter(|node| !joints.contains(node)) {
            at = parents[node];
        }
        at
    };
    joints
        .iter()
        .filter_map(|&joint| Some((joint, above(joint)?)))
        .collect()
}

fn lengths(file: &Parsed, at: Option<ClipTime>, bones: &[(usize, usize)]) -> Option<Vec<f64>> {
    let world = world_transforms(file, at)?;
    let length = |&(a, b): &(usize, usize)| world[a].translation.distance(world[b].translation);
    Some(bones.iter().map(length).collect())
}

#[test]
fn kept_bones_are_as_long_as_they_were_and_draw_the_shape_all_the_same() {
    let (mut checked, mut grown) = (0, 0);
    for (path, model, file) in models("kept bone lengths") {
        let bones = bones(&file);
        let before = lengths(&file, None, &bones).expect("transforms are never compressed");
        let size = diagonal(&model.positions);
        for how in Reshaping::ALL {
            let name = format!("{path} {how:?}");
            let wanted = how.of(&model.positions);
            let written = write_with(&model, &wanted, BoneLengthRule::Keep);
            let (again, after) = read_back(&written, model.format);
            let now = lengths(&after, None, &bones).expect("transforms are never compressed");
            for ((before, now), bone) in before.iter().zip(&now).zip(&bones) {
                assert!(
                    (before - now).abs() <= 2e-7 * size,
                    "{name}: bone {bone:?} is {now} long, it was {before}"
                );
                checked += 1;
            }
            let off = largest_distance(&again.positions, &wanted);
            let size = diagonal(&wanted);
            assert!(off <= 1e-5 * size, "{name}: off by {off} of {size}");
            if let Some(off) = off_from_drawn(&wanted, &model, &after) {
                assert!(off <= 1e-5 * size, "{name}: drawn off by {off} of {size}");
            }
            // Without the option some become longer, and it does not stop the rest from following.
            let free = write_with(&model, &wanted, BoneLengthRule::Follow);
            let free = lengths(&read_back(&free, model.format).1, None, &bones).expect("as above");
            let longest = before.iter().zip(&free).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            grown += usize::from(longest > 0.01 * size);
            let has_moved = largest_distance(&model.positions, &wanted) > 1e-3 * size;
            assert_eq!(file.json["nodes"] != after.json["nodes"], has_moved, "{name}");
        }
    }
    assert!(
        checked > 50 && grown > 0,
        "{checked} bones, {grown} shapes make them longer"
    );
}

#[test]
fn clips_keep_the_lengths_of_bones_and_do_not_tear_the_body_much_more() {
    for (path, model, file) in models("clips with kept bone lengths") {
        let bones = bones(&file);
        let size = diagonal(&model.positions);
        for how in Reshaping::ALL {
            let name = format!("{path} {how:?}");
            let wanted = how.of(&model.positions);
            let of_rule = |rule| read_back(&write_with(&model, &wanted, rule), model.format);
            let (again, kept) = of_rule(BoneLengthRule::Keep);
            for clip in 0..list(&file.json["animations"]).len() {
                for step in 0..4 {
                    let seconds = clip_length(&file, clip) * f64::from(step) / 4.0;
                    let at = Some(ClipTime { clip, seconds });
                    let (Some(before), Some(now)) = (lengths(&file, at, &bones), lengths(&kept, at, &bones)) else {
                        continue;
                    };
                    for ((before, now), bone) in before.iter().zip(&now).zip(&bones) {
                        assert!(
                            (before - now).abs() <= 1e-6 * size,
                            "{name}: in clip {clip} at {seconds} bone {bone:?} is {now} long, it was {before}"
                        );
                    }
                }
            }
            let (again_free, free) = of_rule(BoneLengthRule::Follow);
            if let (Some(kept), Some(free)) = (stretches(&again, &kept), stretches(&again_free, &free)) {
                let ([kept, kept_many], [free, free_many]) = (largest(&kept), largest(&free));
                // Joints of a body that is longer by almost a third are far from where it bends.
                let [most, most_many] = match how {
                    Reshaping::Longer => [3.5, 3.2],
                    _ => [1.2, 1.6],
                };
                assert!(
                    kept <= most * free,
                    "{name}: an edge becomes {kept} times as long, {free} without"
                );
                assert!(
                    kept_many <= most_many * free_many,
                    "{name}: one edge in a thousand becomes {kept_many} times as long, {free_many} without"
                );
            }
        }
    }
}
