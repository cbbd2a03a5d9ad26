//! Real skinned models whose own clips are solved anew: what is drawn is what was solved, and nothing else is lost.

use super::{animate, farthest, read_cache, read_glb};
use crate::support::data::{data_path, tell_skipped};
use crate::support::gltf_parsed::Parsed;
use crate::support::khronos;
use crate::support::skinning::{ClipTime, draw};
use glam::{DVec3, Vec3};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The models, by the folder of the samples.
const MODELS: [&str; 3] = ["CesiumMan", "Fox", "BrainStem"];

fn find(name: &str) -> Option<PathBuf> {
    data_path(name, &format!("gltf/{name}.glb"))
}

fn everything(file: &Parsed, at: Option<ClipTime>) -> Vec<DVec3> {
    let drawn = draw(file, at, &[]).expect("a plain player draws it");
    drawn.into_iter().flat_map(|d| d.positions).collect()
}

/// Runs the first frames of a model's first clip.
fn solve(folder: &Path, model: &Path, output: &str) {
    let model = model.display().to_string();
    let done = animate(
        folder,
        &[
            &model, "--clip", "0", "--frames", "0:3", "--fps", "10", "--refine", "0", "-o", output,
        ],
    );
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(done.status.success(), "{model}: {said}");
}

#[test]
fn skinned_models_play_what_was_solved_as_morphs() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut written = Vec::new();
    let mut sources = Vec::new();
    for name in MODELS {
        let Some(model) = find(name) else { continue };
        let (glb, cache) = (format!("{name}.glb"), format!("{name}.pc2"));
        solve(folder.path(), &model, &glb);
        solve(folder.path(), &model, &cache);
        let (before, after) = (read_glb(&model), read_glb(&folder.path().join(&glb)));
        let rest = everything(&before, None);
        let rest: Vec<Vec3> = rest.iter().map(|p| p.as_vec3()).collect();
        let (low, high) = rest
            .iter()
            .fold((rest[0], rest[0]), |(low, high), p| (low.min(*p), high.max(*p)));
        let diagonal = f64::from(low.distance(high));
        let off = farthest(&everything(&after, None), &rest);
        assert!(off < 1e-5 * diagonal, "{name} at rest: {off} of {diagonal}");
        let (_, frames) = read_cache(&folder.path().join(&cache));
        for (k, frame) in frames.iter().enumerate() {
            let at = ClipTime {
                clip: after.json["animations"].as_array().expect("clips").len() - 1,
                seconds: 0.1 * k as f64,
            };
            let off = farthest(&everything(&after, Some(at)), frame);
            assert!(off < 1e-5 * diagonal, "{name}, frame {k}: {off} of {diagonal}");
        }
        for key in ["materials", "textures", "images", "samplers"] {
            assert_eq!(before.json[key], after.json[key], "{name}: {key}");
        }
        let uses_skin = |n: &serde_json::Value| !n["skin"].is_null();
        assert!(!after.json["nodes"].as_array().expect("nodes").iter().any(uses_skin));
        written.push(folder.path().join(&glb));
        sources.push(model);
    }
    if written.is_empty() {
        return;
    }
    let asked: Vec<PathBuf> = written.iter().chain(&sources).cloned().collect();
    let Some(findings) = khronos::validate(&asked) else {
        return tell_skipped("played models by the validator", "it cannot be had");
    };
    for (file, source) in written.iter().zip(&sources) {
        let new: BTreeSet<&String> = findings[file].difference(&findings[source]).collect();
        assert!(new.is_empty(), "{}: {new:?}", file.display());
    }
}
