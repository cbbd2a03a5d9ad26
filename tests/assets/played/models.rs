//! Real skinned models whose own clips are solved again: what is drawn is what was solved, and nothing else is lost.

use super::{animate, farthest, read_cache, read_glb};
use crate::support::commands::Workplace;
use crate::support::data::{data_path, files_below};
use crate::support::gltf_parsed::Parsed;
use crate::support::gltf_sets::read_model;
use crate::support::khronos;
use crate::support::shapes::bounds;
use crate::support::skinning::{ClipTime, draw};
use glam::{DVec3, Vec3};
use pliant::asset::{Format, MorphClip, NodeKeys, NodePlace, PlayedJoint, SkinnedClip};
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
fn solve(folder: &Workplace, model: &Path, output: &str) {
    let model = model.display().to_string();
    let options = format!("{model} --clip 0 --frames 0:3 --fps 10 --refine 0 -o {output}");
    animate(folder, &options).well();
}

#[test]
fn skinned_models_play_what_was_solved_as_morphs() {
    let folder = Workplace::empty();
    let mut made = Vec::new();
    for name in MODELS {
        let Some(model) = find(name) else { continue };
        let (glb, cache) = (format!("{name}.glb"), format!("{name}.pc2"));
        solve(&folder, &model, &glb);
        solve(&folder, &model, &cache);
        let (before, after) = (read_glb(&model), read_glb(&folder.join(&glb)));
        let rest = everything(&before, None);
        let rest: Vec<Vec3> = rest.iter().map(|p| p.as_vec3()).collect();
        let (low, high) = bounds(&everything(&before, None));
        let diagonal = low.distance(high);
        let off = farthest(&everything(&after, None), &rest);
        assert!(off < 1e-5 * diagonal, "{name} at rest: {off} of {diagonal}");
        let (_, frames) = read_cache(&folder.join(&cache));
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
        made.push((folder.join(&glb), model));
    }
    khronos::assert_nothing_new("played models", &made);
}

#[test]
fn every_model_takes_shapes_and_joints() {
    let Some(data) = data_path("clips on every model", "gltf") else {
        return;
    };
    let is_model = |p: &Path| p.extension().is_some_and(|e| e == "glb" || e == "gltf");
    let folder = Workplace::empty();
    let mut pairs = Vec::new();
    for (k, path) in files_below(&data, is_model).into_iter().enumerate() {
        let Some(model) = read_model(&path) else {
            continue;
        };
        let (low, high) = bounds(&model.positions);
        let diagonal = low.distance(high);
        let rest: Vec<Vec3> = model.positions.iter().map(|p| p.as_vec3()).collect();
        let shift = (DVec3::new(0.3, -0.2, 0.1) * diagonal).as_vec3();
        let clip = MorphClip {
            name: "shift",
            times: &[0.0, 1.0],
            shapes: &[rest.clone(), rest.iter().map(|p| *p + shift).collect()],
            root: Some(NodeKeys {
                times: &[0.0, 1.0],
                places: &[NodePlace::IDENTITY; 2],
            }),
            beside: None,
        };
        let joint = PlayedJoint {
            name: "one".into(),
            parent: None,
            rest: NodePlace::IDENTITY,
        };
        let skinned = SkinnedClip {
            name: "still",
            influences: &vec![[(0, 1.0); 8]; rest.len()],
            joints: &[joint],
            times: &[0.0],
            frames: &[vec![NodePlace::IDENTITY]],
            root: None,
            correctives: None,
            beside: None,
        };
        // What a conversion has against it is not a clip's.
        let source = folder.join(format!("plain_{k}.glb"));
        khronos::store(&model.write(&model.positions, Format::GLB).expect("a GLB"), &source);
        for (what, written) in [
            ("shapes", model.write_morph_clip(&clip)),
            ("joints", model.write_skinned_clip(&skinned)),
        ] {
            let written = written.unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            let at = folder.join(format!("{what}_{k}.glb"));
            khronos::store(&written, &at);
            let played = read_model(&at).unwrap_or_else(|| panic!("{}", path.display()));
            assert_eq!(played.triangles.len(), model.triangles.len(), "{}", path.display());
            for (seen, wanted) in <[DVec3; 2]>::from(bounds(&played.positions)).iter().zip([low, high]) {
                let off = seen.distance(wanted);
                assert!(
                    off < 1e-5 * diagonal,
                    "{what} of {}: {off} of {diagonal}",
                    path.display()
                );
            }
            pairs.push((at, source.clone()));
        }
    }
    assert!(pairs.len() > 20, "the folder has models");
    khronos::assert_nothing_new("clips on every model", &pairs);
}
