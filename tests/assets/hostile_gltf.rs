//! Malformed and hostile glTF: a clear refusal or a sound result, never a panic. What the data folder's table demands
//! of each file is read from the table itself.

use crate::support::gltf_sets;

use crate::support::data::data_folder;
use crate::support::recipes::read_back;
use glam::DVec3;
use gltf_sets::{file_set, gltf_files};
use pliant::asset::{Error, FileSet, Format, Limits, Model};
use pliant::progress::CancelFlag;
use proptest::prelude::*;
use std::collections::BTreeMap;

/// What the table says about a file.
#[derive(Debug, PartialEq)]
enum Demand {
    Refuse,
    Read,
    Either,
}

fn demand(name: &str, what: &str, answer: &str) -> Demand {
    let answer = answer.trim();
    if what.starts_with("VALID") && !answer.contains("or 4xx") && !answer.contains("4xx \"no mesh\"") {
        Demand::Read
    } else if answer.starts_with("4xx")
        && !answer.contains("(or ")
        && !answer.contains(", or ")
        && !answer.contains("or an ")
    {
        Demand::Refuse
    } else if answer.starts_with("200") && !answer.contains("4xx") {
        Demand::Read
    } else if name.contains("khronos-validator") {
        // Errors in these folders touch geometry, nodes, buffers or the container.
        let touches = [
            "accessor/",
            "buffer/",
            "buffer_view/",
            "glb/",
            "json/",
            "mesh/",
            "node/",
            "root/",
            "scene/",
            "asset/",
        ];
        let touches = touches.iter().any(|t| name.contains(&format!("khronos-validator/{t}")));
        if touches && !what.starts_with("0 errors") {
            Demand::Refuse
        } else {
            Demand::Either
        }
    } else {
        Demand::Either
    }
}

/// The rows of the table that name glTF files: file, what it is, what the right answer is.
fn hostile_rows(manifest: &str) -> Vec<(String, String, String)> {
    let row = |line: &str| {
        let mut cells = line.strip_prefix("| hostile/")?.split(" | ");
        let name = format!("hostile/{}", cells.next()?.trim());
        let what = cells.next()?.trim_end_matches(" |").to_owned();
        let answer = cells.next().unwrap_or_default().trim_end_matches(" |").to_owned();
        (name.ends_with(".glb") || name.ends_with(".gltf")).then_some((name, what, answer))
    };
    manifest.lines().filter_map(row).collect()
}

fn nudged(model: &Model) -> Vec<DVec3> {
    let size = model
        .positions
        .iter()
        .fold(0.0, |a: f64, p| a.max(p.abs().max_element()));
    let shift = DVec3::new(0.1, -0.05, 0.2) * size.max(1e-3);
    model.positions.iter().map(|&p| p + shift).collect()
}

/// Reads, and where that succeeds, moves everything, writes and reads again.
fn exercise(files: FileSet, format: Format) -> Result<Model, Error> {
    let limits = Limits {
        vertices: 1_000_000,
        triangles: 2_000_000,
        decoded_bytes: 1 << 28,
        ..Limits::default()
    };
    let model = Model::read(files, Some(format), &limits)?;
    assert!(model.positions.iter().all(|p| p.is_finite()));
    assert!(model.normals.iter().all(|n| n.is_finite()));
    assert!(model.tangents.iter().all(|t| t.is_finite()));
    for format in [Format::GLB, Format::GLTF] {
        match model.write(&nudged(&model), format) {
            Ok(written) => {
                let again = read_back(&written, format);
                assert!(again.triangles == model.triangles, "topology is kept");
                assert_eq!(again.positions.len(), model.positions.len());
                assert!(again.positions.iter().all(|p| p.is_finite()));
            }
            Err(Error::Unwritable { .. }) => {}
            Err(e) => panic!("writing fails for another reason than the positions: {e}"),
        }
    }
    Ok(model)
}

fn format_of(name: &str) -> Format {
    if name.ends_with(".glb") {
        Format::GLB
    } else {
        Format::GLTF
    }
}

#[test]
fn hostile_files_get_the_answer_that_the_table_demands() {
    let Some(data) = data_folder("hostile glTF files") else {
        return;
    };
    let manifest = std::fs::read_to_string(data.join("MANIFEST.md")).expect("the table of the data folder");
    let rows = hostile_rows(&manifest);
    assert!(rows.len() > 150, "the table names {} glTF files", rows.len());
    let mut demands = BTreeMap::new();
    for (name, what, answer) in rows {
        let demand = demand(&name, &what, &answer);
        *demands.entry(format!("{demand:?}")).or_insert(0) += 1;
        match (exercise(file_set(&data.join(&name)), format_of(&name)), demand) {
            (Ok(_), Demand::Refuse) => panic!("{name} ({what}) is read, but should be refused: {answer}"),
            (Err(e), Demand::Read) => panic!("{name} ({what}) should be read: {e}"),
            (Err(e), _) => {
                let text = e.to_string();
                assert!(
                    text.len() > 15 && text.len() < 500 && !text.contains('\n'),
                    "{name}: {text}"
                );
            }
            (Ok(_), _) => {}
        }
    }
    println!("demands: {demands:?}");
}

#[test]
fn refusals_name_the_place_and_the_way_out() {
    let Some(data) = data_folder("texts of refusals") else {
        return;
    };
    let cases: [(&str, &[&str]); 12] = [
        (
            "accessor/index_out_of_range.glb",
            &["accessors/1", "60000", "162 vertices"],
        ),
        ("accessor/normal_count_mismatch.glb", &["NORMAL", "10 elements", "162"]),
        ("accessor/count_negative.glb", &["accessors/0/count", "-5"]),
        (
            "accessor/component_type_bad.glb",
            &["accessors/0/componentType", "5124"],
        ),
        (
            "buffer/path_traversal.gltf",
            &["buffers/0/uri", "../../../../etc/passwd"],
        ),
        (
            "buffer/http_uri.gltf",
            &["buffers/0/uri", "http://127.0.0.1:9", "nothing is ever fetched"],
        ),
        (
            "assimp/IndexOutOfRange.gltf",
            &["IndexOutOfRange.bin", "multipart", "beside the .gltf"],
        ),
        (
            "compressed/draco_garbage.glb",
            &["KHR_draco_mesh_compression", "Draco stream cannot be decoded"],
        ),
        ("nodes/cycle_two_nodes.glb", &["nodes/0", "its own ancestor"]),
        ("nodes/two_parents.glb", &["nodes/2", "node 0", "node 1"]),
        ("real/gltf1_Cesium_Air.glb", &["version 1", "glTF 2.0"]),
        ("values/nan_position.glb", &["POSITION of vertex", "NaN"]),
    ];
    for (name, parts) in cases {
        let error = Model::read(file_set(&data.join("hostile").join(name)), None, &Limits::default());
        let text = error.err().unwrap_or_else(|| panic!("{name} is refused")).to_string();
        assert!(parts.iter().all(|part| text.contains(part)), "{name}: {text}");
    }
}

#[test]
fn moving_under_a_flattening_node_is_refused_when_writing() {
    let Some(data) = data_folder("a node with scale zero") else {
        return;
    };
    let flat = file_set(&data.join("hostile/nodes/scale_zero.glb"));
    let model = Model::read(flat, None, &Limits::default()).expect("readable");
    assert!(model.warnings.iter().any(|(code, ..)| code == "singular-transform"));
    assert!(model.write(&model.positions, Format::GLB).is_ok());
    let text = model
        .write(&nudged(&model), Format::GLB)
        .expect_err("not invertible")
        .to_string();
    assert!(text.contains("cannot be inverted"), "{text}");
}

#[test]
fn sizes_above_the_limits_are_refused_before_anything_is_read() {
    let glb = seeds().remove(0).1;
    let small = |vertices, triangles, decoded_bytes| Limits {
        vertices,
        triangles,
        decoded_bytes,
        ..Limits::default()
    };
    let cases = [
        (small(10, 1 << 20, 1 << 20), "vertices"),
        (small(1 << 20, 10, 1 << 20), "triangles"),
    ];
    for (limits, what) in cases {
        let refused = Model::read(FileSet::single("a.glb", glb.clone()), None, &limits).err();
        assert!(
            matches!(refused, Some(Error::TooLarge { what: w, .. }) if w == what),
            "{refused:?}"
        );
    }
    // An accessor without bytes may not claim vertices at no cost.
    let json = r#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "accessors":[{"componentType":5126,"count":15000000,"type":"VEC3"}]}"#;
    let refused = Model::read(FileSet::single("a.gltf", json), None, &Limits::default()).err();
    assert!(
        matches!(refused, Some(Error::TooLarge { seen: 180_000_000, .. })),
        "{refused:?}"
    );
}

#[test]
fn empty_items_are_refused_before_they_take_memory() {
    for section in ["nodes", "scenes"] {
        let items = vec!["{}"; 1_000_000].join(",");
        let json = format!(r#"{{"asset":{{"version":"2.0"}},"{section}":[{items}]}}"#);
        let bytes = json.len();
        let refused = Model::read(FileSet::single("a.gltf", json), None, &Limits::default()).expect_err("refused");
        let text = refused.to_string();
        let reported = "1000000 items, of which many are empty, take";
        assert!(
            text.contains(reported) && text.contains(&format!("{bytes} bytes of text")),
            "{text}"
        );
    }
    // As many as a small file may have are only useless.
    let items = vec!["{}"; 10_000].join(",");
    let json = format!(r#"{{"asset":{{"version":"2.0"}},"nodes":[{items}]}}"#);
    let files = FileSet::single("a.gltf", json);
    let refused = Model::read(files.clone(), None, &Limits::default()).expect_err("no mesh");
    assert!(matches!(refused, Error::NoMesh { .. }), "{refused}");
    let narrow = Limits {
        document_bytes: 1 << 20,
        ..Limits::default()
    };
    let refused = Model::read(files, None, &narrow).expect_err("no room");
    assert!(
        matches!(refused, Error::TooLarge { what: "the bytes of the parsed document", limit, .. } if limit == 1 << 20),
        "{refused}"
    );
}

#[test]
fn a_read_that_is_cancelled_stops() {
    let flag = CancelFlag::default();
    flag.cancel();
    let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let (_, glb) = seeds().remove(0);
    for files in [FileSet::single("a.obj", obj), FileSet::single("a.glb", glb)] {
        let read = |flag: &CancelFlag| Model::read_watched(files.clone(), None, &Limits::default(), flag);
        assert!(matches!(read(&flag), Err(Error::Cancelled)), "{}", files.name);
        read(&CancelFlag::default()).expect("readable while it is wanted");
    }
}

#[test]
fn a_small_file_cannot_ask_for_endless_work() {
    let many = |what: &str, count: usize| vec![what; count].join(",");
    let document = |nodes: usize, primitives: &str, accessors: &str| {
        let roots: Vec<String> = (0..nodes).map(|i| i.to_string()).collect();
        let json = format!(
            concat!(
                r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[{}]}}],"nodes":[{}],"#,
                r#""meshes":[{{"primitives":[{}]}}],"accessors":[{}],"#,
                r#""bufferViews":[{{"buffer":0,"byteLength":36}}],"buffers":[{{"byteLength":36}}]}}"#
            ),
            roots.join(","),
            many(r#"{"mesh":0}"#, nodes),
            primitives,
            accessors
        );
        FileSet::single("many.glb", glb(&json, &[0; 36]))
    };
    const THREE: &str = r#"{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}"#;
    const POINTS: &str = r#"{"attributes":{"POSITION":0},"mode":0}"#;
    const TRIANGLE: &str = r#"{"attributes":{"POSITION":0}}"#;

    // A billion rows of points are refused before they are made.
    let points = document(20_000, &many(POINTS, 50_000), THREE);
    assert!(matches!(
        Model::read(points, None, &Limits::default()),
        Err(Error::TooLarge { seen: 262_145, .. })
    ));
    // A million rows of triangles are, too, and so are copies that would be far larger than what they were made from.
    let rows = document(1000, &many(TRIANGLE, 1000), THREE);
    assert!(matches!(
        Model::read(rows, None, &Limits::default()),
        Err(Error::TooLarge { seen: 262_145, .. })
    ));
    let long = format!(
        r#"{{"attributes":{{"POSITION":0}},"extras":"{}"}}"#,
        "x".repeat(100_000)
    );
    let model = Model::read(document(10_000, &long, THREE), None, &Limits::default()).expect("readable");
    let apart: Vec<DVec3> = (0..model.positions.len()).map(|i| DVec3::splat(i as f64)).collect();
    let text = model
        .write(&apart, Format::GLB)
        .expect_err("a gigabyte of copies")
        .to_string();
    assert!(text.contains("9999 instances"), "{text}");
    // Many users of the same bytes part, and quickly.
    let users: Vec<String> = (0..20_000)
        .map(|i| format!(r#"{{"attributes":{{"POSITION":{i}}}}}"#))
        .collect();
    let model = Model::read(
        document(1, &users.join(","), &many(THREE, 20_000)),
        None,
        &Limits::default(),
    );
    let model = model.expect("readable");
    let apart: Vec<DVec3> = (0..model.positions.len()).map(|i| DVec3::splat(i as f64)).collect();
    let written = model.write(&apart, Format::GLB).expect("writable");
    let again = Model::read(FileSet::single("again.glb", written.main), None, &Limits::default()).expect("readable");
    assert!(again.positions == apart);
}

/// A GLB of a JSON text and a binary chunk.
fn glb(json: &str, bin: &[u8]) -> Vec<u8> {
    let json = format!("{json}{}", " ".repeat(json.len().next_multiple_of(4) - json.len()));
    let mut bin = bin.to_vec();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let total = 12 + 8 + json.len() + 8 + bin.len();
    let mut out = b"glTF".to_vec();
    for word in [2, total as u32, json.len() as u32, u32::from_le_bytes(*b"JSON")] {
        out.extend(word.to_le_bytes());
    }
    out.extend(json.as_bytes());
    out.extend((bin.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(bin);
    out
}

/// Small models that between them use most of the reader and the writer.
fn seeds() -> Vec<(&'static str, Vec<u8>)> {
    let grid: Vec<[f32; 3]> = (0..16)
        .map(|i| [(i % 4) as f32, (i / 4) as f32, 0.1 * i as f32])
        .collect();
    let cells = (0..11_u16).filter(|i| i % 4 != 3);
    let lists: Vec<u16> = cells.flat_map(|i| [i, i + 1, i + 5, i, i + 5, i + 4]).collect();
    let strip: Vec<u8> = vec![0, 4, 1, 5, 2, 6, 3, 7];
    let quantised: Vec<u8> = grid
        .iter()
        .flat_map(|p| p.map(|v| (v * 1000.0) as u16))
        .flat_map(u16::to_le_bytes)
        .collect();
    let quantised: Vec<u8> = quantised.chunks(6).flat_map(|c| [c, &[0, 0]].concat()).collect();
    let blocks: Vec<[u8; 8]> = quantised.as_chunks::<8>().0.to_vec();
    let packed = meshopt::encode_vertex_buffer_level(&blocks, 2, Some(0)).expect("encodable");
    let packed_indices =
        meshopt::encode_index_buffer(&lists.iter().map(|&i| i.into()).collect::<Vec<u32>>(), 16).expect("encodable");

    let floats = |values: &[[f32; 3]]| -> Vec<u8> { values.iter().flatten().flat_map(|v| v.to_le_bytes()).collect() };
    let interleaved: Vec<u8> = grid.iter().flat_map(|p| floats(&[*p, [0.0, 0.0, 1.0]])).collect();
    let mut bin = Vec::new();
    let mut views = Vec::new();
    let mut view = |bytes: &[u8], more: &str| {
        bin.resize(Vec::len(&bin).next_multiple_of(4), 0);
        views.push(format!(
            r#"{{"buffer":0,"byteOffset":{},"byteLength":{}{more}}}"#,
            bin.len(),
            bytes.len()
        ));
        bin.extend_from_slice(bytes);
    };
    view(&interleaved, r#","byteStride":24"#);
    view(&lists.iter().flat_map(|i| i.to_le_bytes()).collect::<Vec<u8>>(), "");
    view(&strip, "");
    view(&[3, 9], "");
    view(&floats(&[[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]), "");
    view(&quantised, r#","byteStride":8"#);
    view(&floats(&grid), "");
    view(&packed, "");
    view(&packed_indices, "");
    let compressed = |at: usize, source: &str, length: usize, stride: usize, count: usize, mode: &str| {
        let source = source.replace(r#""buffer":0,"#, "").replace(['{', '}'], "");
        format!(
            concat!(
                r#"{{"buffer":1,"byteOffset":{},"byteLength":{},"extensions":{{"EXT_meshopt_compression":{{"#,
                r#""buffer":0,{},"byteStride":{},"count":{},"mode":"{}"}}}}{}}}"#
            ),
            at,
            length,
            source,
            stride,
            count,
            mode,
            if mode == "ATTRIBUTES" {
                format!(r#","byteStride":{stride}"#)
            } else {
                String::new()
            }
        )
    };
    let attributes = compressed(0, &views[7], 128, 8, 16, "ATTRIBUTES");
    let triangles = compressed(128, &views[8], 2 * lists.len(), 2, lists.len(), "TRIANGLES");
    views.extend([attributes, triangles]);
    let json = format!(
        concat!(
            r#"{{"asset":{{"version":"2.0"}},"extensionsUsed":["KHR_mesh_quantization","EXT_meshopt_compression"],"scene":0,"#,
            r#""scenes":[{{"nodes":[0,3]}}],"nodes":[{{"children":[1,2],"rotation":[0,0,0.6,0.8],"scale":[1,-2,1]}},"#,
            r#"{{"mesh":0}},{{"mesh":0,"translation":[5,0,0]}},{{"mesh":1,"matrix":[1,0,0,0,0,2,0,0,0,0,1,0,7,0,0,1]}}],"#,
            r#""meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":1}},"indices":2}},"#,
            r#"{{"attributes":{{"POSITION":0,"NORMAL":1}},"indices":3,"mode":5}},{{"attributes":{{"POSITION":4}},"mode":6}}]}},"#,
            r#"{{"primitives":[{{"attributes":{{"POSITION":5}},"indices":2}},{{"attributes":{{"POSITION":6}},"indices":7,"#,
            r#""targets":[{{"POSITION":8}}]}}]}}],"accessors":["#,
            r#"{{"bufferView":0,"componentType":5126,"count":16,"type":"VEC3","min":[0,0,0],"max":[3,3,1.5]}},"#,
            r#"{{"bufferView":0,"byteOffset":12,"componentType":5126,"count":16,"type":"VEC3"}},"#,
            r#"{{"bufferView":1,"componentType":5123,"count":{count},"type":"SCALAR"}},"#,
            r#"{{"bufferView":2,"componentType":5121,"count":8,"type":"SCALAR"}},"#,
            r#"{{"bufferView":6,"componentType":5126,"count":16,"type":"VEC3","sparse":{{"count":2,"#,
            r#""indices":{{"bufferView":3,"componentType":5121}},"values":{{"bufferView":4}}}}}},"#,
            r#"{{"bufferView":5,"componentType":5123,"count":16,"type":"VEC3","normalized":true}},"#,
            r#"{{"bufferView":9,"componentType":5123,"count":16,"type":"VEC3"}},"#,
            r#"{{"bufferView":10,"componentType":5123,"count":{count},"type":"SCALAR"}},"#,
            r#"{{"bufferView":6,"componentType":5126,"count":16,"type":"VEC3"}}],"#,
            r#""bufferViews":[{views}],"buffers":[{{"byteLength":{length}}},"#,
            r#"{{"byteLength":{fallback},"extensions":{{"EXT_meshopt_compression":{{"fallback":true}}}}}}]}}"#
        ),
        count = lists.len(),
        views = views.join(","),
        length = bin.len(),
        fallback = 128 + 2 * lists.len(),
    );
    let plain = concat!(
        r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],"#,
        r#""meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"#,
        r#""accessors":[{"bufferView":0,"componentType":5126,"count":15,"type":"VEC3"}],"#,
        r#""bufferViews":[{"buffer":0,"byteLength":180}],"buffers":[{"byteLength":180}]}"#
    );
    vec![("rich", glb(&json, &bin)), ("plain", glb(plain, &floats(&grid[..15])))]
}

#[test]
fn the_seeds_are_read_whole() {
    let read = |i: usize| exercise(FileSet::single("seed.glb", seeds().remove(i).1), Format::GLB).expect("readable");
    let rich = read(0);
    assert_eq!(
        rich.primitives.len(),
        8,
        "three under each of two nodes, two under the last"
    );
    assert_eq!(rich.warnings, []);
    // Quantised in the file, compressed beside it, and moved seven to the right and stretched by the node's matrix.
    let last = rich.primitives.last().expect("a primitive");
    let at = rich.positions[last.first_vertex as usize + 5];
    assert_eq!(at, DVec3::new(1000.0 + 7.0, 2000.0, 500.0));
    assert_eq!(read(1).triangles.len(), 5);
}

/// The JSON of a GLB or glTF with some digits replaced, in the container that it came in.
fn with_other_digits(main: &[u8], changes: impl IntoIterator<Item = (usize, usize)>) -> Vec<u8> {
    const INSTEAD: [&str; 8] = ["0", "1", "2", "7", "99999999999", "-1", "0.5", "1e300"];
    let container = main
        .starts_with(b"glTF")
        .then(|| gltf::binary::Glb::from_slice(main).expect("a valid seed"));
    let json = container.as_ref().map_or(main, |c| &c.json);
    let mut json = String::from_utf8(json.to_vec()).expect("text");
    for (at, with) in changes {
        let digits: Vec<_> = json
            .match_indices(|c: char| c.is_ascii_digit())
            .map(|(i, _)| i)
            .collect();
        let at = digits[at % digits.len()];
        json.replace_range(at..at + 1, INSTEAD[with % INSTEAD.len()]);
    }
    match container {
        Some(container) => glb(&json, &container.bin.unwrap_or_default()),
        None => json.into_bytes(),
    }
}

#[test]
fn real_models_with_changed_numbers_never_panic() {
    let Some(data) = data_folder("changed real models") else {
        return;
    };
    let mut random = 0x9e37_79b9_7f4a_7c15_u64;
    let mut next = || {
        random ^= random << 13;
        random ^= random >> 7;
        random ^= random << 17;
        (random >> 20) as usize
    };
    let mut read = [0, 0];
    for path in gltf_files(&data.join("gltf")) {
        let files = file_set(&path);
        if files.total_bytes() > 100_000 {
            continue;
        }
        for _ in 0..25 {
            let main = with_other_digits(
                &files.main,
                (0..1 + next() % 3).map(|_| (next(), next())).collect::<Vec<_>>(),
            );
            let mutant = FileSet {
                main: main.into(),
                ..files.clone()
            };
            read[usize::from(exercise(mutant, format_of(&path.to_string_lossy())).is_ok())] += 1;
        }
    }
    assert!(
        read[0] > 100 && read[1] > 100,
        "some are refused and some are read: {read:?}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn changed_bytes_never_panic(seed in 0_usize..2, changes in prop::collection::vec((any::<u32>(), any::<u8>()), 1..6)) {
        let mut file = seeds().remove(seed).1;
        let length = file.len() as u32;
        changes.into_iter().for_each(|(at, byte)| file[(at % length) as usize] = byte);
        let _ = exercise(FileSet::single("mutant.glb", file), Format::GLB);
    }

    #[test]
    fn changed_numbers_never_panic(seed in 0_usize..2, changes in prop::collection::vec((any::<u32>(), 0_usize..8), 1..5)) {
        let changes = changes.into_iter().map(|(at, with)| (at as usize, with));
        let mutant = with_other_digits(&seeds().remove(seed).1, changes);
        let _ = exercise(FileSet::single("mutant.glb", mutant), Format::GLB);
    }

    #[test]
    fn cut_files_never_panic(seed in 0_usize..2, keep in 0.0..1.0_f64) {
        let file = seeds().remove(seed).1;
        let mut cut = file[..(keep * file.len() as f64) as usize].to_vec();
        prop_assert!(Model::read(FileSet::single("cut.glb", cut.clone()), Some(Format::GLB), &Limits::default()).is_err());
        if cut.len() >= 12 {
            let length = cut.len() as u32;
            cut[8..12].copy_from_slice(&length.to_le_bytes());
            prop_assert!(Model::read(FileSet::single("cut.glb", cut), Some(Format::GLB), &Limits::default()).is_err());
        }
    }
}
