//! The built-in figure is a character as game tools expect one.

use crate::support::data::tell_skipped;
use crate::support::gltf_parsed::parse;
use crate::support::khronos;
use crate::support::skinning::{ClipTime, clip_length, draw};
use glam::DVec3;
use pliant::asset::sample::BuiltInModel;
use std::collections::BTreeMap;

#[test]
fn the_validator_finds_nothing_wrong_with_the_figure() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path().join("figure.glb");
    std::fs::write(&at, BuiltInModel::Figure.glb()).expect("written");
    let Some(findings) = khronos::validate(std::slice::from_ref(&at)) else {
        return tell_skipped("the figure by the validator", "it cannot be had");
    };
    assert!(findings[&at].is_empty(), "{:?}", findings[&at]);
}

#[test]
fn the_figure_walks_and_waves_without_tearing() {
    let file = parse(BuiltInModel::Figure.glb(), &BTreeMap::new());
    let body = |at: Option<ClipTime>| {
        draw(&file, at, &[])
            .expect("a plain player draws it")
            .swap_remove(0)
            .positions
    };
    let rest = body(None);
    let foot = (0..rest.len())
        .min_by(|&a, &b| {
            (rest[a] - DVec3::new(0.11, 0.0, 0.15))
                .length()
                .total_cmp(&(rest[b] - DVec3::new(0.11, 0.0, 0.15)).length())
        })
        .expect("a vertex");
    let hand = (0..rest.len())
        .min_by(|&a, &b| rest[a].x.total_cmp(&rest[b].x))
        .expect("a vertex");
    for (clip, watched, least) in [(0, foot, 0.3), (1, hand, 0.6)] {
        let length = clip_length(&file, clip);
        let frames: Vec<Vec<DVec3>> = (0..=8)
            .map(|k| {
                body(Some(ClipTime {
                    clip,
                    seconds: length * f64::from(k) / 8.0,
                }))
            })
            .collect();
        let way = |a: &[DVec3], b: &[DVec3]| a[watched].distance(b[watched]);
        let farthest = frames.iter().map(|frame| way(frame, &frames[0])).fold(0.0, f64::max);
        assert!(farthest > least, "clip {clip}: {farthest}");
        assert!(way(&frames[0], &frames[8]) < 1e-6, "clip {clip} ends as it begins");
        // Nobody's foot goes deep into the ground.
        let lowest = frames.iter().flatten().map(|p| p.y).fold(f64::INFINITY, f64::min);
        assert!(lowest > -0.06, "clip {clip}: {lowest}");
    }
}
