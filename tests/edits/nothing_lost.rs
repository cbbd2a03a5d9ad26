//! Nothing of a file vanishes without a word: what it has beside triangles is counted before and after, and a difference has a
//! warning that names it.

use crate::support::data::data_folder;
use crate::support::gltf_parsed::parse;
use crate::support::gltf_sets::{companions_of, file_set, models_below};
use pliant::asset::{Format, WrittenFiles};
use pliant::batch;
use pliant::engine::DeformerLimits;
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::{json::from_json, pb};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Larger files take too long for a sweep.
const LARGEST: u64 = 30_000;

/// Extensions of how numbers are packed, which pliant writes as plain floats; and what other formats take of materials.
const PACKINGS: [&str; 4] = [
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_mesh_quantization",
];
const TAKEN: [&str; 5] = [
    "KHR_texture_transform",
    "KHR_texture_basisu",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "MSFT_texture_dds",
];

/// What a file has beside triangles, each by the word that a warning has for it.
fn contents(main: &[u8], companions: &BTreeMap<String, Vec<u8>>, format: Format) -> BTreeMap<String, usize> {
    let mut found = BTreeMap::new();
    let text = || String::from_utf8_lossy(main).into_owned();
    let lines_of = |keyword: &str| {
        text()
            .lines()
            .filter(|line| line.trim_start().starts_with(keyword))
            .count()
    };
    if format == Format::GLB || format == Format::GLTF {
        let json = parse(main, companions).json;
        let count = |list: &Value| list.as_array().map_or(0, Vec::len);
        let primitives: Vec<&Value> = (json["meshes"].as_array().into_iter().flatten())
            .flat_map(|mesh| mesh["primitives"].as_array().into_iter().flatten())
            .collect();
        let drawn = primitives
            .iter()
            .filter(|p| p["mode"].as_u64().is_some_and(|mode| mode < 4));
        found.insert("skin".into(), count(&json["skins"]));
        found.insert("animation".into(), count(&json["animations"]));
        found.insert("camera".into(), count(&json["cameras"]));
        found.insert(
            "morph target".into(),
            primitives.iter().map(|p| count(&p["targets"])).max().unwrap_or(0),
        );
        found.insert("of points or lines".into(), drawn.count());
        let used = json["extensionsUsed"].as_array().cloned().unwrap_or_default();
        let used = used
            .iter()
            .filter_map(Value::as_str)
            .filter(|name| !PACKINGS.contains(name));
        found.extend(used.map(|name| (name.to_owned(), 1)));
    } else if format == Format::OBJ {
        found.insert("line".into(), lines_of("l "));
        found.insert("points".into(), lines_of("p "));
    } else if format == Format::PLY {
        let header = text();
        let rows = header.lines().find_map(|line| line.strip_prefix("element edge "));
        found.insert(
            "edge".into(),
            rows.map_or(0, |rows| rows.trim().parse().expect("a number")),
        );
    }
    found.retain(|_, count| *count > 0);
    found
}

/// What is fewer in the second and not named by a warning.
fn silently_lost(
    before: &BTreeMap<String, usize>,
    written: &WrittenFiles,
    format: Format,
    is_converted: bool,
) -> Vec<String> {
    let after = contents(&written.main, &written.companions, format);
    let named = |what: &str| written.warnings.iter().any(|w| w.message.contains(what));
    let mut lost = Vec::new();
    for (what, count) in before {
        let is_kept = after.get(what).is_some_and(|left| left >= count);
        let is_taken = is_converted && TAKEN.contains(&what.as_str());
        if !(is_kept || is_taken || named(what)) {
            lost.push(format!("{what}: {count} to {}", after.get(what).copied().unwrap_or(0)));
        }
    }
    lost
}

#[test]
fn every_element_and_extension_is_there_or_named() {
    let Some(data) = data_folder("elements and extensions through poses, edits and conversions") else {
        return;
    };
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let pose = json!({"handles": [{"id": "all", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": -1e30}},
        "pose": {"translation": [0, 0.5, 0]}}]});
    let edits = [
        json!({"subdivide": {"scheme": "MIDPOINT"}}),
        json!({"decimate": {"ratio": 0.5}}),
    ];
    let edit = |edit: &Value| json!({"steps": [{"edit": edit}]});
    let jobs: Vec<Value> = std::iter::once(pose)
        .chain(edits.iter().map(edit))
        .chain([json!({})])
        .collect();
    let (mut seen, mut silent) = (0, Vec::new());
    for path in models_below(&data, &["gltf", "field", "meshes"]) {
        let format = Format::from_file_name(&path.to_string_lossy());
        let is_small = std::fs::metadata(&path).is_ok_and(|about| about.len() <= LARGEST);
        let Some(format) =
            format.filter(|f| is_small && [Format::GLB, Format::GLTF, Format::OBJ, Format::PLY].contains(f))
        else {
            continue;
        };
        let files = file_set(&path);
        let run = |job: &Value, to: Format| {
            let job: pb::Job = from_json(job.to_string().as_bytes()).expect("a job");
            batch::run(
                files.clone(),
                &job,
                Some(to),
                &DeformerLimits::default(),
                &exec,
                &|| 0.0,
            )
        };
        if run(&json!({}), format).is_err() {
            continue;
        }
        let before = contents(&files.main, &companions_of(&files), format);
        let other = if format == Format::OBJ {
            Format::PLY
        } else {
            Format::OBJ
        };
        for (job, to) in jobs.iter().flat_map(|job| [(job, format), (job, other)]) {
            // What cannot be edited says so by its error.
            let Ok(done) = run(job, to) else { continue };
            seen += 1;
            for lost in silently_lost(&before, &done.written, to, to != format) {
                silent.push(format!("{}: {job} to {to}: {lost}", path.display()));
            }
        }
    }
    assert!(seen > 50, "{seen} results");
    assert!(
        silent.is_empty(),
        "{} of {seen} lose something silently:\n{}",
        silent.len(),
        silent.join("\n")
    );
}
