//! Draco: compressed primitives are read as their uncompressed twins are, come back uncompressed, and hostile streams are
//! refused.

use crate::support::bench::largest_distance;
use crate::support::data::data_folder;
use crate::support::gltf_parsed::parse;
use crate::support::gltf_sets::{file_set, gltf_files};
use crate::support::khronos;
use crate::support::recipes::read_back;
use crate::support::skinning::list;
use glam::DVec3;
use pliant::asset::{FileSet, Format, Limits, Model, WrittenFiles};
use serde_json::Value;
use std::path::PathBuf;

const MODELS: [&str; 4] = [
    "2CylinderEngine_draco/2CylinderEngine.gltf",
    "BoxDraco/BoxDraco.gltf",
    "DracoSparseMesh/DracoSparseMesh.gltf",
    "DenseSphere.glb",
];

/// The files of the data folder that have Draco in them.
fn draco_models() -> Vec<PathBuf> {
    let Some(folder) = data_folder("Draco").map(|data| data.join("gltf")) else {
        return Vec::new();
    };
    let name = b"\"KHR_draco_mesh_compression\"";
    let has_draco = |path: &PathBuf| {
        std::fs::read(path)
            .expect("a file")
            .windows(name.len())
            .any(|w| w == name)
    };
    let found: Vec<PathBuf> = gltf_files(&folder).into_iter().filter(has_draco).collect();
    assert!(found.len() >= MODELS.len(), "{found:?}");
    found
}

fn read(files: FileSet) -> Model {
    let name = files.name.clone();
    Model::read(files, None, &Limits::default()).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// The JSON of a written model.
fn document(written: &WrittenFiles) -> Value {
    parse(&written.main, &written.companions).json
}

/// The sum of a number of every item of a section.
fn sum_of(json: &Value, section: &str) -> u64 {
    list(&json[section])
        .iter()
        .filter_map(|item| item["byteLength"].as_u64())
        .sum()
}

fn buffer_bytes(json: &Value) -> u64 {
    sum_of(json, "buffers")
}

fn view_bytes(json: &Value) -> u64 {
    sum_of(json, "bufferViews")
}

/// Views that nothing in a document names.
fn unnamed_views(json: &Value) -> Vec<usize> {
    fn collect(value: &Value, named: &mut Vec<u64>) {
        match value {
            Value::Object(members) => members.iter().for_each(|(key, value)| match value.as_u64() {
                Some(view) if key == "bufferView" => named.push(view),
                _ => collect(value, named),
            }),
            Value::Array(items) => items.iter().for_each(|item| collect(item, named)),
            _ => {}
        }
    }
    let mut named = Vec::new();
    collect(json, &mut named);
    let count = list(&json["bufferViews"]).len();
    (0..count).filter(|view| !named.contains(&(*view as u64))).collect()
}

#[test]
fn compressed_models_come_back_as_they_were_or_uncompressed() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut written_files = Vec::new();
    for (k, path) in draco_models().into_iter().enumerate() {
        let files = file_set(&path);
        let model = read(files.clone());
        let place = path.display();
        assert!(
            model.warnings.iter().any(|w| w.0 == "draco-decoded"),
            "{place}: {:?}",
            model.warnings
        );
        let same = model.write(&model.positions, model.format).expect("writable");
        assert!(
            same.main == files.main,
            "{place}: nothing was done, and the file is another"
        );

        let moved: Vec<DVec3> = model
            .positions
            .iter()
            .map(|p| *p + DVec3::new(0.0, p.x.abs(), 0.0))
            .collect();
        for (format, name) in [(model.format, "same"), (Format::GLB, "glb")] {
            let written = model.write(&moved, format).expect("writable");
            let json = document(&written);
            assert!(!json.to_string().contains("KHR_draco_mesh_compression"), "{place}");
            let compressed = document(&same);
            let (before, after) = (unnamed_views(&compressed), unnamed_views(&json));
            assert!(
                after.iter().all(|v| before.contains(v)),
                "{place}: {after:?} of {before:?}"
            );
            // What lies between views is no more than alignment: the streams are gone.
            let (bytes, views) = (buffer_bytes(&json), list(&json["bufferViews"]).len());
            let idle = bytes.saturating_sub(view_bytes(&json));
            let idle_before = buffer_bytes(&compressed).saturating_sub(view_bytes(&compressed));
            assert!(
                idle <= idle_before + 11 * views as u64,
                "{place}: {idle} of {bytes} bytes are in no view"
            );
            let at = folder.path().join(format!("{k}{name}/model.{format}"));
            khronos::store(&written, &at);
            let again = read_back(&written, format);
            assert_eq!(again.triangles, model.triangles, "{place}");
            let worst = largest_distance(&again.positions, &moved);
            let size = moved.iter().map(|p| p.length()).fold(0.0, f64::max);
            assert!(worst <= 1e-6 * size, "{place}: off by {worst}");
            written_files.push((path.clone(), at));
        }
    }
    let all: Vec<PathBuf> = written_files.iter().flat_map(|(a, b)| [a.clone(), b.clone()]).collect();
    if all.is_empty() {
        return;
    }
    let Some(findings) = khronos::validate(&all) else {
        return;
    };
    for (before, after) in &written_files {
        // The validator does not look into Draco: weights that it rounded were so before, and it reported none.
        let unseen = "ACCESSOR_WEIGHTS_NON_NORMALIZED";
        let found = findings[after].difference(&findings[before]);
        let new: Vec<_> = found.filter(|code| *code != unseen).collect();
        assert!(new.is_empty(), "{}: {new:?}", after.display());
    }
}

#[test]
fn an_edge_of_a_box_is_where_it_was_before_compression() {
    let Some(folder) = data_folder("Draco") else { return };
    let compressed = read(file_set(&folder.join("gltf/BoxDraco/BoxDraco.gltf")));
    let plain = read(file_set(&folder.join("gltf/Box.glb")));
    let sorted = |model: &Model| {
        let place = |&v: &u32| {
            model.positions[v as usize]
                .to_array()
                .map(|x| (x * 1000.0).round() as i64)
        };
        let mut corners: Vec<[i64; 3]> = model.triangles.as_flattened().iter().map(place).collect();
        corners.sort_unstable();
        corners
    };
    assert_eq!(sorted(&compressed), sorted(&plain));
}

#[test]
fn streams_that_are_damaged_are_refused_or_read_and_never_panic() {
    for path in draco_models() {
        let files = file_set(&path);
        let limits = Limits {
            vertices: 200_000,
            triangles: 200_000,
            decoded_bytes: 64 << 20,
            ..Limits::default()
        };
        // Places all over where the streams may be, turned over.
        let holds = |name: Option<&String>| match name {
            Some(name) => files.companions[name].clone(),
            None => files.main.clone(),
        };
        let target = files.companions.keys().find(|name| name.ends_with(".bin"));
        let bytes = holds(target);
        let start = if target.is_some() {
            0
        } else {
            20 + u32::from_le_bytes(bytes[12..16].try_into().expect("four")) as usize
        };
        let step = ((bytes.len() - start) / 24).max(1);
        for at in (start..bytes.len()).step_by(step) {
            let mut damaged = bytes.to_vec();
            damaged[at] ^= 0xff;
            let mut hostile = files.clone();
            match target {
                Some(name) => drop(hostile.companions.insert(name.clone(), damaged.into())),
                None => hostile.main = damaged.into(),
            }
            if let Ok(model) = Model::read(hostile, None, &limits) {
                assert!(model.positions.iter().all(|p| p.is_finite()));
            }
        }
    }
}

/// A document with one Draco primitive whose stream has these bytes.
fn gltf_of(stream: &[u8], extension: &str) -> FileSet {
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "extensionsUsed":["KHR_draco_mesh_compression"],"extensionsRequired":["KHR_draco_mesh_compression"],
        "buffers":[{{"byteLength":{length},"uri":"s.bin"}}],"bufferViews":[{{"buffer":0,"byteLength":{length}}}],
        "accessors":[{{"componentType":5126,"count":3,"type":"VEC3"}},{{"componentType":5123,"count":3,"type":"SCALAR"}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1,
        "extensions":{{"KHR_draco_mesh_compression":{extension}}}}}]}}]}}"#,
        length = stream.len()
    );
    let mut files = FileSet::single("s.gltf", json);
    files.companions.insert("s.bin".into(), stream.to_vec().into());
    files
}

#[test]
fn what_is_wrong_with_a_stream_is_reported_with_its_place() {
    let whole = r#"{"bufferView":0,"attributes":{"POSITION":0}}"#;
    for (stream, extension, wanted) in [
        (&b"no Draco at all"[..], whole, "the Draco stream cannot be decoded"),
        (b"DRACO", whole, "the Draco stream cannot be decoded"),
        (
            b"DRACO\x02\x02\x01\x01\0\0\xff\xff\xff\xff\x0f\xff\xff\xff\xff\x0f",
            whole,
            "the Draco stream cannot be decoded",
        ),
        (
            b"x",
            r#"{"bufferView":7,"attributes":{}}"#,
            "buffer view 7 does not exist",
        ),
        (b"x", r#"{"attributes":{}}"#, "bufferView"),
        (b"x", "3", "KHR_draco_mesh_compression"),
    ] {
        let error = Model::read(gltf_of(stream, extension), None, &Limits::default());
        let text = error.expect_err("no stream").to_string();
        assert!(
            text.contains("meshes/0/primitives/0") && text.contains(wanted),
            "{extension}: {text}"
        );
    }
}
