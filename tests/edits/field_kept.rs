//! Files as users have them, each with its right answer from `field/README.md` of the data folder: what they hold beside their shape, and
//! what comes of it in edits and other formats.

use crate::field_rows::{bend, bent, farthest, run};
use crate::support::data::{data_bytes, data_path};
use crate::support::gltf_parsed::{Parsed, parse};
use crate::support::khronos;
use crate::support::skinning::{draw, list, numbers};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use pliant::asset::{FileSet, Format, Limits, Model};
use pliant::exec::Exec;
use pliant::mesh::query::TriangleBvh;
use pliant::mesh::signed_volume;
use pliant::pool::Pool;
use pliant::progress::Silent;
use serde_json::{Value, json};
use std::collections::BTreeMap;

fn file(name: &str) -> Option<FileSet> {
    Some(FileSet::single(name, data_bytes(&format!("field/{name}"))?))
}

fn read(files: FileSet) -> Model {
    Model::read(files, None, &Limits::default()).expect("readable")
}

fn parsed(main: &[u8]) -> Parsed {
    parse(main, &BTreeMap::new())
}

fn with_pool(test: impl FnOnce(&Exec<'_>) -> Option<()>) {
    let pool = Pool::new(2).expect("threads");
    // `None` without the data, which is said.
    let _ = test(&Exec::new(&pool, &Silent));
}

#[test]
fn edges_of_a_cad_part_go_with_its_surface() {
    with_pool(|exec| {
        let (rest, done) = bent("bar_cad_edges.glb", exec)?;
        let before = TriangleBvh::build(&rest.positions, &rest.triangles, exec.pool);
        let after = TriangleBvh::build(&done.positions, &rest.triangles, exec.pool);
        let mut moved = 0.0_f64;
        for v in rest.primitives[1].vertices() {
            let place = |surface: &TriangleBvh<'_>, at| surface.closest_point(at).expect("a surface").distance;
            let (was, is) = (place(&before, rest.positions[v]), place(&after, done.positions[v]));
            assert!((was - is).abs() < 2e-3, "vertex {v}: {was} and {is} off the surface");
            moved = moved.max(rest.positions[v].distance(done.positions[v]));
        }
        assert!(moved > 1.0, "{moved}");
        Some(())
    });
}

#[test]
fn placed_texture_coordinates_are_those_of_an_obj() {
    with_pool(|_| {
        let model = read(file("board_uv_offset_scale.glb")?);
        let source = parsed(&model.files.main);
        let uv = numbers(
            &source,
            &source.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"],
        )?;
        // Of the transform: offset 0.5, scale 0.4. An OBJ counts from below.
        let wanted = uv.as_chunks::<2>().0.iter();
        let wanted = wanted.map(|[u, v]| [0.5 + 0.4 * u, 1.0 - (0.5 + 0.4 * v)]);
        let written = model.write(&model.positions, Format::OBJ).expect("writable");
        let text = String::from_utf8(written.main).expect("text");
        let rows: Vec<[f64; 2]> = (text.lines().filter_map(|line| line.strip_prefix("vt ")))
            .map(|row| {
                let words: Vec<f64> = row.split_whitespace().map(|w| w.parse().expect("a number")).collect();
                [words[0], words[1]]
            })
            .collect();
        for want in wanted {
            let off = |row: &[f64; 2]| (row[0] - want[0]).abs().max((row[1] - want[1]).abs());
            assert!(rows.iter().any(|row| off(row) < 1e-6), "no {want:?}");
        }
        assert!(rows.len() <= 170 && !text.contains("-o "), "{} rows", rows.len());
        Some(())
    });
}

#[test]
fn corners_that_share_six_normals_have_those_of_their_places() {
    with_pool(|exec| {
        let (_, done) = bent("bar_shared_normals.obj", exec)?;
        let text = String::from_utf8(done.written.main).expect("text");
        let vectors = |keyword: &str| -> Vec<DVec3> {
            let rows = text.lines().filter_map(|line| line.strip_prefix(keyword));
            let number = |word: &str| word.parse::<f64>().expect("a number");
            rows.map(|row| DVec3::from_slice(&row.split_whitespace().map(number).collect::<Vec<_>>()))
                .collect()
        };
        let (places, normals) = (vectors("v "), vectors("vn "));
        assert!(normals.len() > 100, "{}", normals.len());
        let (mut worst, mut turned) = (0.0_f64, 0.0_f64);
        for row in text.lines().filter_map(|line| line.strip_prefix("f ")) {
            let corners: Vec<[usize; 2]> = row
                .split_whitespace()
                .map(|word| {
                    let mut parts = word.split('/').filter(|part| !part.is_empty());
                    [0, 1].map(|_| parts.next().and_then(|p| p.parse::<usize>().ok()).expect("a number") - 1)
                })
                .collect();
            let at = |k: usize| places[corners[k][0]];
            let facet = (at(1) - at(0)).cross(at(2) - at(0)).normalize();
            for corner in &corners {
                worst = worst.max(normals[corner[1]].angle_between(facet));
                turned = turned.max(normals[corner[1]].dot(DVec3::new(0.5, 0.5, 0.0)).abs());
            }
        }
        assert!(worst < 0.25, "a normal is {worst} off its face");
        assert!(turned > 0.6, "some have turned: {turned}");
        Some(())
    });
}

#[test]
fn a_bar_a_million_times_smaller_bends_the_same() {
    with_pool(|exec| {
        let (_, large) = bent("bar_origin.obj", exec)?;
        let mut job = bend();
        for (handle, offset) in [(0, -0.5e-6), (1, 3.5e-6)] {
            job["handles"][handle]["region"]["halfSpace"]["offset"] = json!(offset);
        }
        job["steps"][0]["pose"]["handles"][0]["pose"]["translation"] = json!([1.1e-6, -0.7e-6, 0]);
        let small = run(file("bar_micro.obj")?, &job, exec);
        let grown: Vec<DVec3> = small.positions.iter().map(|p| *p * 1e6).collect();
        // A millionth is not a binary number: nodes inside lie a little elsewhere.
        let off = farthest(&grown, &large.positions);
        assert!(off < 2e-3, "{off} of 4");
        Some(())
    });
}

#[test]
fn stl_files_keep_solids_colours_and_are_read_with_lines_of_colour() {
    with_pool(|exec| {
        let half = json!({"steps": [{"edit": {"decimate": {"ratio": 0.5}}}]});
        let done = run(file("bar_two_solids.stl")?, &half, exec);
        let text = String::from_utf8(done.written.main).expect("a text");
        for name in ["left arm", "right arm"] {
            for word in ["solid", "endsolid"] {
                assert!(
                    text.lines().any(|line| line.trim() == format!("{word} {name}")),
                    "{word} {name}"
                );
            }
        }
        let (rest, done) = bent("bar_colours_viscam.stl", exec)?;
        let colours = |bytes: &[u8]| -> Vec<[u8; 2]> {
            let facets = bytes[84..].as_chunks::<50>().0.iter();
            facets.map(|facet| [facet[48], facet[49]]).collect()
        };
        let was = colours(&rest.files.main);
        assert_eq!(was, colours(&done.written.main));
        assert!(was.iter().any(|colour| *colour != was[0]), "there are several");
        assert_eq!(rest.files.main[..80], done.written.main[..80]);
        for name in ["stl_color_lines.stl", "off_counts_on_first_word.off"] {
            assert!(read(file(name)?).triangles.len() > 100, "{name}");
        }
        Some(())
    });
}

#[test]
fn what_shares_an_accessor_parts_where_it_must() {
    with_pool(|exec| {
        for name in ["ball_normal_is_position.glb", "two_meshes_one_accessor.glb"] {
            let mut job = bend();
            if name.starts_with("ball") {
                job["handles"][0]["region"]["halfSpace"]["offset"] = json!(0.5);
                job["handles"][1]["region"]["halfSpace"]["offset"] = json!(0.5);
            }
            let done = run(file(name)?, &job, exec);
            let file = parsed(&done.written.main);
            let drawn = draw(&file, None, &[]).expect("not compressed");
            let drawn: Vec<DVec3> = drawn.into_iter().flat_map(|primitive| primitive.positions).collect();
            assert!(farthest(&drawn, &done.positions) < 1e-6, "{name}");
            for mesh in list(&file.json["meshes"]) {
                let attributes = &mesh["primitives"][0]["attributes"];
                assert_ne!(attributes["NORMAL"], attributes["POSITION"], "{name}");
                let normals = numbers(&file, &attributes["NORMAL"])?;
                let off = |n: &[f64; 3]| (DVec3::from_array(*n).length() - 1.0).abs();
                assert!(
                    normals.as_chunks::<3>().0.iter().map(off).fold(0.0, f64::max) < 1e-5,
                    "{name}"
                );
            }
        }
        Some(())
    });
}

#[test]
fn variants_and_52_targets_of_a_head_live_through_an_edit() {
    with_pool(|exec| {
        let half = json!({"steps": [{"edit": {"decimate": {"ratio": 0.5}}}]});
        let source = file("variants.glb")?;
        let mappings = |main: &[u8]| parsed(main).json["meshes"][0]["primitives"][0]["extensions"].clone();
        let was = mappings(&source.main);
        let done = run(source, &half, exec);
        assert!(was["KHR_materials_variants"].is_object());
        assert_eq!(was, mappings(&done.written.main));

        // A quarter turn of all turns every displacement exactly.
        let source = file("head_arkit52.glb")?;
        let all = json!({"halfSpace": {"normal": [0, 1, 0], "offset": -1e9}});
        let turn = json!({"handles": [{"id": "all", "region": all}], "steps": [{"pose": {"handles": [
            {"id": "all", "pose": {"rotationVector": [0, 0, std::f64::consts::FRAC_PI_2], "pivot": [0, 0, 0]}}]}}]});
        let [before, turned] =
            [source.main.to_vec(), run(source.clone(), &turn, exec).written.main].map(|m| parsed(&m));
        let targets = |file: &Parsed| list(&file.json["meshes"][0]["primitives"][0]["targets"]).to_vec();
        assert_eq!((targets(&before).len(), targets(&turned).len()), (52, 52));
        let names = |file: &Parsed| file.json["meshes"][0]["extras"]["targetNames"].clone();
        assert_eq!(names(&before), names(&turned));
        for (k, (was, is)) in targets(&before).iter().zip(targets(&turned)).enumerate() {
            let accessor = |value: &Value, file: &Parsed| {
                file.json["accessors"][value.as_u64().expect("a number") as usize].clone()
            };
            let is_sparse = |value: &Value, file: &Parsed| accessor(value, file)["sparse"].is_object();
            assert!(
                is_sparse(&was["POSITION"], &before) && is_sparse(&is["POSITION"], &turned),
                "{k}"
            );
            for what in ["POSITION", "NORMAL"] {
                let [a, b] = [numbers(&before, &was[what])?, numbers(&turned, &is[what])?];
                for (a, b) in a.as_chunks::<3>().0.iter().zip(b.as_chunks::<3>().0) {
                    let off = DVec3::new(-a[1], a[0], a[2]).distance(DVec3::from_array(*b));
                    assert!(off < 1e-6, "target {k} {what}: {off}");
                }
            }
        }
        let thinned = parsed(&run(source, &half, exec).written.main);
        assert_eq!(targets(&thinned).len(), 52);
        for (k, target) in targets(&thinned).iter().enumerate() {
            let moves = numbers(&thinned, &target["POSITION"])?;
            assert!(moves.iter().any(|lane| lane.abs() > 1e-4), "target {k} is dead");
        }
        Some(())
    });
}

#[test]
fn rods_of_cad_bend_in_an_even_arc_once_they_are_fine_enough() {
    with_pool(|exec| {
        let ends = |low: f64, high: f64| {
            json!([{"id": "base", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -low}}},
                   {"id": "top", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": high}}}])
        };
        let pose = |translation: [f64; 3]| {
            json!({"pose": {"handles": [{"id": "top", "pose":
                {"rotationVector": [0, 0, -1.2], "pivot": [0, 4, 0], "translation": translation}}]}})
        };
        let finer = json!({"edit": {"on": "REST", "subdivide": {"auto": true}}});
        let coarse = json!({"edit": {"remesh": {"edgeLength": 0.1}}});
        for (name, first, most) in [
            ("box_cad.obj", &coarse, 0.01),
            ("box_cad.obj", &finer, 0.06),
            ("rod_clean.stl", &finer, 0.04),
            ("rod_cad.stl", &finer, 0.04),
        ] {
            let rest = read(file(name)?);
            let job = json!({"handles": ends(0.05, 3.95), "steps": [first, pose([2.1256, -0.8932, 0.0])]});
            let done = run(file(name)?, &job, exec);
            let after = read(FileSet::single(name, done.written.main.clone()));
            let volumes = [&rest, &after].map(|m| signed_volume(&m.positions, &m.triangles).abs());
            let change = volumes[1] / volumes[0] - 1.0;
            assert!(change.abs() < most, "{name}: volume {:+.2} %", 100.0 * change);
        }
        Some(())
    });
}

#[test]
fn a_map_bar_stands_where_it_stood_in_each_format() {
    with_pool(|_| {
        let model = read(file("bar_utm.obj")?);
        let glb = model.write(&model.positions, Format::GLB).expect("writable").main;
        let node = parsed(&glb).json["nodes"][0]["translation"].clone();
        assert!(node[1].as_f64().expect("a number") > 5e6, "{node}");
        let again = read(FileSet::single("a.glb", glb));
        assert!(farthest(&again.positions, &model.positions) < 1e-4);
        let stl = model.write(&model.positions, Format::STL).expect("writable");
        assert!(
            stl.warnings.iter().any(|w| w.code == "places-rounded"),
            "{:?}",
            stl.warnings
        );
        let text = read(file("bar_utm_ascii.stl")?);
        let kept = text.write(&text.positions, Format::STL).expect("writable").main;
        assert!(farthest(&read(FileSet::single("a.stl", kept)).positions, &text.positions) < 1e-6);
        Some(())
    });
}

#[test]
fn vertices_without_weights_of_an_fbx_make_a_valid_glb() {
    with_pool(|_| {
        data_path("an FBX with vertices without weights", "field/half_weighted.fbx")?;
        let model = read(file("half_weighted.fbx")?);
        let written = model.write(&model.positions, Format::GLB).expect("writable");
        let at = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("field half_weighted.glb");
        khronos::store(&written, &at);
        // Skinned meshes below other nodes are a matter of taste, and the file has them so.
        let found = khronos::validate(std::slice::from_ref(&at))?
            .remove(&at)
            .expect("of the file");
        let wrong: Vec<_> = found
            .iter()
            .filter(|code| !code.starts_with("NODE_SKINNED_MESH"))
            .collect();
        assert!(wrong.is_empty(), "{wrong:?}");
        Some(())
    });
}

#[test]
fn a_hat_that_is_merged_brings_its_material_and_its_picture() {
    with_pool(|exec| {
        let (base, hat) = (file("base.glb")?, data_bytes("field/hat.glb")?);
        let parts = [parsed(&base.main), parsed(&hat)].map(|part| part.json);
        let merge = json!({"merge": {"model": STANDARD.encode(&hat), "how": "LOOSE"}});
        let merged = run(base, &json!({"steps": [{"edit": merge}]}), exec);
        let whole = parsed(&merged.written.main).json;
        for list in ["materials", "images"] {
            let entries = |of: &Value| of[list].as_array().map_or(0, Vec::len);
            assert!(parts.iter().all(|part| entries(part) > 0), "{list}");
            assert_eq!(entries(&whole), entries(&parts[0]) + entries(&parts[1]), "{list}");
        }
        Some(())
    });
}
