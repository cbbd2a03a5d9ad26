//! glTF and GLB come back as they went in, but for what was moved. Runs over every glTF file of the data folder.

use crate::support::gltf_parsed;
use crate::support::gltf_sets;
use crate::support::khronos;

use crate::support::data::data_folder;
use crate::support::recipes::read_back;
use crate::support::shapes::bounds;
use crate::support::skinning::list;
use glam::DVec3;
use gltf_parsed::{Parsed, parse};
use gltf_sets::{companions_of, file_set, gltf_files};
use pliant::asset::{FileSet, Following, Format, Limits, Model, Primitive, RigRule, WrittenFiles};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

fn format_of(path: &Path) -> Format {
    if path.extension().is_some_and(|e| e == "glb") {
        Format::GLB
    } else {
        Format::GLTF
    }
}

/// Every model of data/gltf that is read, with its path.
fn models(what: &str) -> Vec<(PathBuf, Model)> {
    let Some(data) = data_folder(what) else {
        return Vec::new();
    };
    let read = |path: PathBuf| {
        let model = Model::read(file_set(&path), Some(format_of(&path)), &Limits::default()).ok()?;
        Some((path, model))
    };
    let models: Vec<_> = gltf_files(&data.join("gltf")).into_iter().filter_map(read).collect();
    assert!(
        models.len() > 100,
        "the data folder has far more readable models than {}",
        models.len()
    );
    models
}

/// A smooth motion of the whole of space that keeps nothing where it was.
fn swayed(model: &Model) -> Vec<DVec3> {
    let (low, high) = bounds(&model.positions);
    let size = (high - low).max_element().max(f64::MIN_POSITIVE);
    // A parabola is as good as a sine and the same on every machine.
    let sway = |p: &DVec3| {
        let t = (p.y - low.y) / size;
        *p + DVec3::new(0.25 * size * (1.0 + t - t * t), 0.125 * size, -0.0625 * size * t * t)
    };
    model.positions.iter().map(sway).collect()
}

/// Writes a model while its skeleton stays as it is.
fn write_without_rig(model: &Model, positions: &[DVec3]) -> WrittenFiles {
    let following = Following {
        rig: RigRule::Keep,
        ..Following::default()
    };
    model
        .write_following(positions, model.format, following)
        .expect("writable")
}

#[test]
fn readable_models_are_read_and_the_others_say_why() {
    let Some(data) = data_folder("reading of data/gltf") else {
        return;
    };
    for path in gltf_files(&data.join("gltf")) {
        let name = path.display();
        match Model::read(file_set(&path), None, &Limits::default()) {
            Ok(model) => {
                assert_eq!(model.format, format_of(&path), "{name}");
                assert!(
                    !model.triangles.is_empty() && model.positions.iter().all(|p| p.is_finite()),
                    "{name}"
                );
                let ends = model.primitives.last().expect("a primitive");
                assert_eq!(
                    (ends.first_vertex + ends.vertex_count) as usize,
                    model.positions.len(),
                    "{name}"
                );
            }
            Err(e) => {
                let text = e.to_string();
                let known = ["no mesh", "Draco", "minVersion"]
                    .iter()
                    .any(|reason| text.contains(reason));
                assert!(known && !text.contains('\n'), "{name}: {text}");
            }
        }
    }
}

#[test]
fn an_unmoved_model_is_written_byte_for_byte() {
    for (path, model) in models("identity round trips") {
        let written = model.write(&model.positions, model.format).expect("writable");
        assert!(written.main[..] == model.files.main[..], "{}", path.display());
        assert_eq!(written.companions, companions_of(&model.files), "{}", path.display());
    }
}

#[test]
fn moved_positions_are_read_back_to_float_precision() {
    for (path, model) in models("moved round trips") {
        let wanted = swayed(&model);
        for format in [Format::GLB, Format::GLTF] {
            let again = read_back(&model.write(&wanted, format).expect("writable"), format);
            assert!(again.triangles == model.triangles, "{}", path.display());
            // Instances have parted, so the mesh may be another; all else is the same.
            let without_mesh = |m: &Model| -> Vec<_> {
                m.primitives
                    .iter()
                    .map(|p| Primitive { mesh: 0, ..p.clone() })
                    .collect()
            };
            assert!(without_mesh(&again) == without_mesh(&model), "{}", path.display());
            for p in &model.primitives {
                let run = p.first_vertex as usize..(p.first_vertex + p.vertex_count) as usize;
                // Floats are rounded in mesh space, whose numbers are as large as the node's shift makes them.
                let largest = wanted[run.clone()].iter().chain(&model.positions[run.clone()]);
                let largest = largest.fold(0.0, |a: f64, p| a.max(p.abs().max_element()));
                let off = run
                    .map(|i| (again.positions[i] - wanted[i]).abs().max_element())
                    .fold(0.0, f64::max);
                assert!(off <= 4e-7 * largest, "{}: off by {off} of {largest}", path.display());
            }
            let unit = |n: &glam::Vec3| n.is_finite() && (*n == glam::Vec3::ZERO || (n.length() - 1.0).abs() < 1e-5);
            assert!(again.normals.iter().all(unit), "{}", path.display());
            assert!(again.tangents.iter().all(|t| unit(&t.truncate())), "{}", path.display());
            assert_eq!(again.normals.len(), model.normals.len());
            assert_eq!(again.tangents.len(), model.tangents.len());
        }
    }
}

#[test]
fn normals_turn_with_a_turned_model() {
    let turn = glam::DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.0);
    for (path, model) in models("turned normals") {
        let turned: Vec<DVec3> = model.positions.iter().map(|&p| turn * p).collect();
        let again = read_back(&model.write(&turned, model.format).expect("writable"), model.format);
        let used: BTreeSet<u32> = model.triangles.iter().flatten().copied().collect();
        let mut compared = (0_usize, 0_usize);
        for v in used.into_iter().map(|v| v as usize) {
            let Some(normal) = model.normals.get(v).filter(|n| **n != glam::Vec3::ZERO) else {
                continue;
            };
            let off = (again.normals[v].as_dvec3() - turn * normal.as_dvec3()).length();
            compared.0 += 1;
            // A vertex in nothing but slivers has no gradient worth the name.
            compared.1 += usize::from(off > 1e-3);
        }
        assert!(
            compared.1 * 100 <= compared.0,
            "{}: {} of {} normals are off",
            path.display(),
            compared.1,
            compared.0
        );
    }
}

#[test]
fn a_part_that_stays_keeps_its_bytes() {
    for (path, model) in models("partial moves") {
        let [first, rest @ ..] = model.primitives.as_slice() else {
            continue;
        };
        if rest.is_empty() {
            continue;
        }
        let mut wanted = model.positions.clone();
        wanted[..first.vertex_count as usize]
            .iter_mut()
            .for_each(|p| p.y += 0.125);
        // Where joints follow, what stays is drawn by other matrices; the laws of rigs look at its bytes there.
        let again = read_back(&write_without_rig(&model, &wanted), model.format);
        for p in rest {
            let run = p.first_vertex as usize..(p.first_vertex + p.vertex_count) as usize;
            let used = model
                .triangles
                .iter()
                .flatten()
                .copied()
                .filter(|v| run.contains(&(*v as usize)));
            let used: BTreeSet<u32> = used.collect();
            for v in used.into_iter().map(|v| v as usize) {
                let name = path.display();
                assert_eq!(again.positions[v], model.positions[v], "{name}: vertex {v}");
                assert_eq!(again.normals.get(v), model.normals.get(v), "{name}: vertex {v}");
            }
        }
    }
}

/// Pointers to what a write may change, each checked on its own elsewhere.
fn may_change(pointer: &str, before: &Parsed) -> bool {
    let parts: Vec<&str> = pointer.split('/').skip(1).collect();
    let beyond = |section: &str, index: &str| {
        let count = list(&before.json[section]).len();
        index.parse::<usize>().is_ok_and(|i| i >= count)
    };
    match parts[..] {
        ["accessors", _, "min" | "max", ..] | ["buffers", _, "byteLength" | "uri"] | ["nodes", _, "mesh"] => true,
        ["meshes", _, "primitives", _, "attributes", name] | ["meshes", _, "primitives", _, "targets", _, name]
            if ["POSITION", "NORMAL", "TANGENT"].contains(&name) =>
        {
            true
        }
        ["accessors" | "bufferViews" | "buffers" | "meshes" | "extensionsUsed" | "extensionsRequired"] => true,
        [section, index, ..] => beyond(section, index),
        _ => false,
    }
}

fn differences(a: &Value, b: &Value, pointer: String, out: &mut Vec<String>) {
    match (a, b) {
        (Value::Object(x), Value::Object(y)) => {
            // Kept keys in their order, new ones after them.
            let kept: Vec<&String> = y.keys().filter(|k| x.contains_key(*k)).collect();
            let had: Vec<&String> = x.keys().filter(|k| y.contains_key(*k)).collect();
            if kept != had {
                out.push(format!("{pointer} (order of keys)"));
            }
            for key in x.keys().chain(y.keys().filter(|k| !x.contains_key(*k))) {
                let missing = Value::Null;
                let (x, y) = (x.get(key).unwrap_or(&missing), y.get(key).unwrap_or(&missing));
                differences(x, y, format!("{pointer}/{key}"), out);
            }
        }
        (Value::Array(x), Value::Array(y)) => {
            if x.len() != y.len() {
                out.push(pointer.clone());
            }
            x.iter()
                .zip(y)
                .enumerate()
                .for_each(|(i, (x, y))| differences(x, y, format!("{pointer}/{i}"), out));
            (x.len()..y.len()).for_each(|i| out.push(format!("{pointer}/{i}")));
        }
        _ if a == b => {}
        _ => out.push(pointer),
    }
}

/// Which bytes of each buffer belong to positions, normals and tangents of triangles and of their morph targets.
fn geometry_bytes(file: &Parsed) -> Vec<Vec<bool>> {
    let json = &file.json;
    let mut mask: Vec<Vec<bool>> = file.buffers.iter().map(|b| vec![false; b.len()]).collect();
    let whole = |v: &Value, missing: u64| v.as_u64().unwrap_or(missing) as usize;
    for primitive in list(&json["meshes"]).iter().flat_map(|m| list(&m["primitives"])) {
        if whole(&primitive["mode"], 4) < 4 {
            continue;
        }
        let own = [("POSITION", 3), ("NORMAL", 3), ("TANGENT", 4)]
            .map(|(name, lanes)| (&primitive["attributes"][name], lanes));
        let targets = primitive["targets"].as_array().into_iter().flatten();
        let of_targets = targets.flat_map(|t| ["POSITION", "NORMAL", "TANGENT"].map(|name| (&t[name], 3)));
        for (accessor, lanes) in own.into_iter().chain(of_targets) {
            let accessor = &json["accessors"][whole(accessor, u64::MAX)];
            if accessor["componentType"] != 5126 {
                continue;
            }
            if let Some(values) = accessor["sparse"]["values"].as_object() {
                let view = &json["bufferViews"][whole(&values["bufferView"], 0)];
                let start = whole(&view["byteOffset"], 0);
                mask[whole(&view["buffer"], 0)][start..start + whole(&view["byteLength"], 0)].fill(true);
            }
            if accessor["bufferView"].is_null() {
                continue;
            }
            let view = &json["bufferViews"][whole(&accessor["bufferView"], 0)];
            let stride = whole(&view["byteStride"], 4 * lanes);
            let start = whole(&view["byteOffset"], 0) + whole(&accessor["byteOffset"], 0);
            for i in 0..whole(&accessor["count"], 0) {
                let place = start + i * stride..start + i * stride + 4 * lanes as usize;
                if let Some(bytes) = mask[whole(&view["buffer"], 0)].get_mut(place) {
                    bytes.fill(true);
                }
            }
        }
    }
    mask
}

#[test]
fn a_moved_model_differs_in_geometry_only() {
    for (path, model) in models("comparison of documents") {
        let name = path.display();
        // What was Draco comes back as plain data, which a test of its own looks at.
        if model.warnings.iter().any(|w| w.0 == "draco-decoded") {
            continue;
        }
        let before = parse(&model.files.main, &companions_of(&model.files));
        let written = write_without_rig(&model, &swayed(&model));
        let after = parse(&written.main, &written.companions);

        let mut found = Vec::new();
        differences(&before.json, &after.json, String::new(), &mut found);
        found.retain(|pointer| !may_change(pointer, &before));
        assert!(found.is_empty(), "{name}: {found:?}");

        let mask = geometry_bytes(&before);
        for (b, (old, new)) in before.buffers.iter().zip(&after.buffers).enumerate() {
            assert!(new.len() >= old.len(), "{name}: buffer {b} only ever grows");
            let changed = (0..old.len()).find(|&i| old[i] != new[i] && !mask[b][i]);
            assert_eq!(changed, None, "{name}: a byte of buffer {b} that is not geometry");
        }
        for (uri, bytes) in &model.files.companions {
            let is_buffer = list(&before.json["buffers"]).iter().any(|x| x["uri"] == uri.as_str());
            assert!(written.companions[uri][..] == bytes[..] || is_buffer, "{name}: {uri}");
        }
        check_bounds(&after, &name.to_string());
    }
}

/// The stated bounds of every float POSITION of triangles are those of its values.
fn check_bounds(file: &Parsed, name: &str) {
    let json = &file.json;
    for primitive in list(&json["meshes"]).iter().flat_map(|m| list(&m["primitives"])) {
        let accessor = &json["accessors"][primitive["attributes"]["POSITION"].as_u64().unwrap_or(u64::MAX) as usize];
        let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap_or(u64::MAX) as usize];
        let skip = primitive["mode"].as_u64().is_some_and(|m| m < 4) || accessor["componentType"] != 5126;
        if skip || view.is_null() || !accessor["sparse"].is_null() || !view["extensions"].is_null() {
            continue;
        }
        let whole = |v: &Value, missing: u64| v.as_u64().unwrap_or(missing) as usize;
        let stride = whole(&view["byteStride"], 12);
        let start = whole(&view["byteOffset"], 0) + whole(&accessor["byteOffset"], 0);
        let (mut least, mut most) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for i in 0..whole(&accessor["count"], 0) {
            for lane in 0..3 {
                let at = start + i * stride + 4 * lane;
                let bytes = &file.buffers[whole(&view["buffer"], 0)][at..at + 4];
                let v = f32::from_le_bytes(bytes.try_into().expect("four bytes"));
                (least[lane], most[lane]) = (least[lane].min(v), most[lane].max(v));
            }
        }
        for lane in 0..3 {
            let stated = |key: &str| accessor[key][lane].as_f64().map(|v| v as f32);
            assert_eq!(stated("min"), Some(least[lane]), "{name}");
            assert_eq!(stated("max"), Some(most[lane]), "{name}");
        }
    }
}

#[test]
fn the_khronos_validator_finds_nothing_new() {
    let models = models("the Khronos validator");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut pairs = Vec::new();
    let mut all = Vec::new();
    for (i, (path, model)) in models.iter().enumerate() {
        let moved = swayed(model);
        for format in [Format::GLB, Format::GLTF] {
            let at = folder
                .path()
                .join(format!("{i}-{}/model.{}", format.name(), format.name()));
            khronos::store(&model.write(&moved, format).expect("writable"), &at);
            pairs.push((path, at.clone()));
            all.push(at);
        }
        all.push(path.clone());
    }
    for (i, name) in ["spot.obj", "arap_cactus_highres.off", "armadillo.obj"]
        .into_iter()
        .enumerate()
    {
        let Some(data) = data_folder("assets made from other formats") else {
            return;
        };
        let Ok(bytes) = std::fs::read(data.join("meshes").join(name)) else {
            continue;
        };
        let model = Model::read(FileSet::single(name, bytes), None, &Limits::default()).expect("readable");
        for format in [Format::GLB, Format::GLTF] {
            let at = folder
                .path()
                .join(format!("fresh-{i}-{}/model.{}", format.name(), format.name()));
            khronos::store(&model.write(&swayed(&model), format).expect("writable"), &at);
            all.push(at);
        }
    }
    let Some(findings) = khronos::validate(&all) else {
        return;
    };
    let known = models.iter().filter(|(path, _)| path.ends_with("CesiumMan.glb"));
    known.for_each(|(path, _)| {
        assert!(
            findings[path].contains("ACCESSOR_WEIGHTS_NON_NORMALIZED"),
            "the validator looks"
        )
    });
    for (before, after) in pairs {
        // A GLB that keeps an embedded second buffer is valid, if unusual.
        let new: Vec<_> = findings[&after]
            .difference(&findings[before])
            .filter(|code| *code != "DATA_URI_GLB")
            // The validator does not look into Draco, and so sees the weights of the model first in what is written.
            .filter(|code| *code != "ACCESSOR_WEIGHTS_NON_NORMALIZED" || !before.to_string_lossy().contains("draco"))
            .collect();
        assert!(new.is_empty(), "{} has new findings: {new:?}", before.display());
    }
    for at in all.iter().filter(|at| at.to_string_lossy().contains("fresh-")) {
        assert!(findings[at].is_empty(), "{}: {:?}", at.display(), findings[at]);
    }
}
