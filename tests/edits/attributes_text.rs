//! OBJ, PLY, OFF and STL after edits of the topology, and what is kept from one format to another.

use crate::support::bench::largest_distance;
use crate::support::{gltf_parsed, khronos, recipes};

use crate::support::data::{data_path, files_below};
use glam::{DAffine3, DVec3};
use pliant::asset::{
    BaseModel, EditedModel, FileSet, Format, Limits, Model, PrimitiveRun, VertexBlends, sample, write_edited_model,
};
use proptest::prelude::*;
use recipes::{Edited, at_rest, read_back, size};
use std::path::{Path, PathBuf};

fn open(name: &str, main: impl Into<Vec<u8>>) -> Model {
    Model::read(FileSet::single(name, main.into()), None, &Limits::default()).expect("readable")
}

fn write(edited: &Edited, model: &Model) -> String {
    String::from_utf8(edited.write(model, model.format).expect("writable").main).expect("text")
}

/// For each face of an OBJ text the last `usemtl`, and its corners: position, texture coordinates, normal.
type Corner = ([f64; 3], Option<[f64; 2]>, Option<[f64; 3]>);

fn faces(text: &str) -> Vec<(String, Vec<Corner>)> {
    let (mut v, mut vt, mut vn, mut material) = (Vec::new(), Vec::new(), Vec::new(), String::new());
    let mut faces = Vec::new();
    for line in text.lines() {
        let mut words = line.split_whitespace();
        let keyword = words.next().unwrap_or_default();
        let numbers = || {
            line.split_whitespace()
                .skip(1)
                .map(|w| w.parse::<f64>().expect("a number"))
                .collect::<Vec<_>>()
        };
        match keyword {
            "v" => v.push(<[f64; 3]>::try_from(&numbers()[..3]).expect("three")),
            "vt" => vt.push(<[f64; 2]>::try_from(&numbers()[..2]).expect("two")),
            "vn" => vn.push(<[f64; 3]>::try_from(&numbers()[..3]).expect("three")),
            "usemtl" => material = words.next().unwrap_or_default().to_owned(),
            "f" => {
                let corner = |word: &str| {
                    let mut parts = word.split('/').map(|p| p.parse::<usize>().ok().map(|i| i - 1));
                    let mut next = || parts.next().flatten();
                    let position = v[next().expect("a vertex")];
                    (position, next().map(|i| vt[i]), next().map(|i| vn[i]))
                };
                faces.push((material.clone(), words.map(corner).collect()));
            }
            _ => {}
        }
    }
    faces
}

/// Two squares side by side. The edge between them is a seam: coordinates, normals and materials differ on both sides.
const SEAM: &str = "# by hand\n# two squares\nmtllib both.mtl\no pair\nv 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nv 1 1 0\nv 2 1 0\n\
    vt 0 0\nvt 0.5 0\nvt 0.5 0.5\nvt 0 0.5\nvt 0.75 0.75\nvt 1 0.75\nvt 1 1\nvt 0.75 1\nvn 0 0 9\nvn 0 0.6 0.8\n\
    usemtl left\ns 1\ng a\nf 1/1/1 2/2/1 5/3/1 4/4/1\nusemtl right\ns off\ng b\nf 2/5/2 3/6/2 6/7/2 5/8/2\n";

/// The texture coordinates of a place on either side.
fn seam_uv(left: bool, x: f64, y: f64) -> [f64; 2] {
    if left {
        [x * 0.5, y * 0.5]
    } else {
        [0.75 + (x - 1.0) * 0.25, 0.75 + y * 0.25]
    }
}

#[test]
fn an_obj_keeps_both_sides_of_its_seams() {
    let model = open("seam.obj", SEAM);
    let edited = Edited::of(&model, true);
    let text = write(&edited, &model);
    assert!(
        text.starts_with("# by hand\n# two squares\nmtllib both.mtl\n"),
        "{text}"
    );
    let seen = faces(&text);
    assert_eq!(seen.len(), 16);
    for (i, (material, corners)) in seen.iter().enumerate() {
        let left = i < 8;
        assert_eq!(material, if left { "left" } else { "right" });
        for ([x, y, _], uv, normal) in corners {
            // Both maps are affine, so every corner can be checked, also the middles on the seam itself.
            assert_eq!(*uv, Some(seam_uv(left, *x, *y)), "at {x} {y}");
            let wanted = if left { [0.0, 0.0, 9.0] } else { [0.0, 0.6, 0.8] };
            assert_eq!(*normal, Some(wanted), "unmoved lines stay as they are");
        }
    }
    let statements = |word: &str| {
        text.lines()
            .filter(|l| l.split_whitespace().next() == Some(word))
            .count()
    };
    assert_eq!(
        (statements("o"), statements("g"), statements("s"), statements("usemtl")),
        (1, 2, 2, 2)
    );
    let again = open("again.obj", text.as_bytes());
    assert_eq!(
        (&again.positions, &again.triangles),
        (&edited.positions, &edited.triangles)
    );

    // Turned as a whole, normals turn with it; coordinates do not.
    let mut turned = Edited::of(&model, true);
    let turn = glam::DQuat::from_rotation_x(1.0);
    turned.positions.iter_mut().for_each(|p| *p = turn * *p);
    for (_, corners) in &faces(&write(&turned, &model))[8..] {
        for corner in corners {
            let normal = DVec3::from_array(corner.2.expect("a normal"));
            assert!(normal.distance(turn * DVec3::new(0.0, 0.6, 0.8)) < 1e-6);
        }
    }
}

#[test]
fn an_obj_distinguishes_back_to_back_faces_and_keeps_objects_whole() {
    let text = "o one\nusemtl front\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nusemtl back\nf 3 2 1\no two\nusemtl front\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf 4 5 6\n";
    let model = open("sides.obj", text);
    let mut edited = Edited::of(&model, false);
    edited.triangles = vec![[2, 1, 0], [3, 4, 5], [0, 1, 2]];
    let text = write(&edited, &model);
    assert_eq!(
        text.matches("\no ").count() + usize::from(text.starts_with("o ")),
        2,
        "{text}"
    );
    let seen: Vec<(String, f64)> = faces(&text).into_iter().map(|(m, c)| (m, c[0].0[0])).collect();
    let wanted = [("back", 0.0), ("front", 0.0), ("front", 5.0)];
    assert_eq!(seen, wanted.map(|(m, x)| (m.to_owned(), x)));
}

#[test]
fn a_vertex_blended_from_afar_stays_on_its_side_of_a_seam() {
    // Three squares in a row; between the second and the third is a seam. Left of it u is x / 10, right of it more.
    let mut text = String::new();
    for x in 0..4 {
        text += &format!("v {x} 0 0\nv {x} 1 0\nvt 0.{x} 0\nvt 0.{x} 1\n");
    }
    text += "vt 0.7 0\nvt 0.7 1\nvt 0.8 0\nvt 0.8 1\n";
    for x in 0..2 {
        let [a, b, c, d] = [1, 3, 4, 2].map(|i| 2 * x + i);
        text += &format!("f {a}/{a} {b}/{b} {c}/{c}\nf {a}/{a} {c}/{c} {d}/{d}\n");
    }
    text += "f 5/9 7/11 8/12\nf 5/9 8/12 6/10\n";
    let model = open("row.obj", text);
    let mut edited = Edited::of(&model, false);
    let triangles = model.triangles.clone();
    // The first triangle's corner at x = 1 becomes one between x = 0 and the seam at x = 2.
    edited.recipes.push_blend(&[(0, 0.5), (4, 0.5)]);
    edited.positions.push(DVec3::new(1.0, 0.0, 0.5));
    edited.triangles = triangles;
    edited.triangles[0][1] = 8;
    edited.runs[0].vertex_count = 9;
    let seen = faces(&write(&edited, &model));
    let uv = seen[0].1[1].1.expect("coordinates");
    assert!((uv[0] - 0.1).abs() < 1e-6, "{uv:?}");
    let seam: Vec<f64> = seen
        .iter()
        .flat_map(|f| &f.1)
        .filter(|c| c.0 == [2.0, 0.0, 0.0])
        .map(|c| c.1.expect("uv")[0])
        .collect();
    assert_eq!(seam, [0.2, 0.7, 0.7]);
}

const PLY: &str = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
    property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float quality\nproperty int label\nelement face 2\n\
    property list uchar int vertex_indices\nproperty uchar flag\nproperty list uchar float texcoord\nelement edge 1\n\
    property int vertex1\nproperty int vertex2\nelement material 1\nproperty float shine\nend_header\n\
    0 0 0 255 0 0 0.5 7\n1 0 0 0 255 0 1.5 9\n1 1 0 0 0 255 2 11\n0 1 0 1 2 3 4 13\n\
    3 0 1 2 1 6 0 0 1 0 1 1\n3 0 2 3 2 6 0.5 0.5 0 0 1 0\n0 1\n0.25\n";

/// The rows of the body of an ASCII PLY.
fn rows(text: &str) -> Vec<Vec<f64>> {
    let body = text.split_once("end_header\n").expect("a body").1;
    body.lines()
        .map(|l| l.split_whitespace().map(|w| w.parse().expect("a number")).collect())
        .collect()
}

#[test]
fn a_ply_blends_what_its_vertices_have_and_keeps_what_its_faces_have() {
    let model = open("square.ply", PLY);
    let edited = Edited::of(&model, true);
    let text = write(&edited, &model);
    let head = text.split_once("end_header").expect("a header").0;
    let wanted = PLY.split_once("end_header").expect("a header").0;
    let wanted = wanted.replace("vertex 4", "vertex 9").replace("face 2", "face 8");
    assert_eq!(head, wanted.replace("element edge 1", "element edge 2"));
    let rows = rows(&text);
    assert_eq!(rows.len(), 9 + 8 + 2 + 1);
    assert_eq!(rows[1], [1.0, 0.0, 0.0, 0.0, 255.0, 0.0, 1.5, 9.0]);
    // Between 0 and 1: halves are rounded away from zero, a label is one of both.
    assert_eq!(rows[4][..7], [0.5, 0.0, 0.0, 128.0, 128.0, 0.0, 1.0]);
    assert!([7.0, 9.0].contains(&rows[4][7]));
    // The first corner triangle of the second face: 0, 0-2, 3-0.
    assert_eq!(
        rows[13],
        [3.0, 0.0, 6.0, 8.0, 2.0, 6.0, 0.5, 0.5, 0.25, 0.25, 0.75, 0.25]
    );
    assert_eq!(rows[17..], [vec![0.0, 4.0], vec![4.0, 1.0], vec![0.25]]);
    let again = open("again.ply", text);
    assert_eq!(
        (&again.positions, &again.triangles),
        (&edited.positions, &edited.triangles)
    );
}

#[test]
fn an_off_and_an_stl_keep_colours_and_attributes() {
    let text = "COFF\n# colours\n4 2 0\n0 0 0 255 0 0 255\n1 0 0 0 255 0 255\n1 1 0 0 0 255 255\n0 1 0 0 0 0 255\n3 0 1 2 9 8 7\n3 0 2 3 0.5 0.5 0.5\n";
    let model = open("square.off", text);
    let text = write(&Edited::of(&model, true), &model);
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[..2], ["COFF", "9 8 0"]);
    assert_eq!(lines[2 + 4], "0.5 0 0 128 128 0 255");
    assert_eq!((lines[11], lines[18]), ("3 0 4 6 9 8 7", "3 6 7 8 0.5 0.5 0.5"));

    let mut bytes = [b"a header".to_vec(), vec![0; 72], 2_u32.to_le_bytes().to_vec()].concat();
    for (i, facet) in [[0.0, 0.0, 1.0, 0.0, 1.0, 1.0], [0.0, 0.0, 1.0, 1.0, 0.0, 1.0_f32]]
        .iter()
        .enumerate()
    {
        bytes.extend([0; 12]);
        let corners = facet
            .chunks(2)
            .flat_map(|c| [c[0], c[1], 0.0])
            .flat_map(f32::to_le_bytes);
        bytes.extend(corners);
        bytes.extend([0xa0, i as u8]);
    }
    let model = open("square.stl", bytes);
    let out = Edited::of(&model, true)
        .write(&model, Format::STL)
        .expect("writable")
        .main;
    assert!(out.starts_with(b"a header") && out.len() == 84 + 8 * 50);
    let attributes: Vec<u8> = out[84..].chunks(50).map(|f| f[49]).collect();
    assert_eq!(attributes, [0, 0, 0, 0, 1, 1, 1, 1]);
}

fn real_models() -> Vec<(String, Model)> {
    let Some(folder) = data_path("text formats after edits", "meshes") else {
        return Vec::new();
    };
    let is_text = |p: &Path| {
        p.extension()
            .is_some_and(|e| e == "obj" || e == "ply" || e == "off" || e == "stl")
    };
    let paths = files_below(&folder, |p| p.parent() == Some(&folder) && is_text(p));
    let read = |path: PathBuf| {
        let name = path.file_name()?.to_string_lossy().into_owned();
        let bytes = std::fs::read(&path).ok().filter(|b| b.len() < 8 << 20)?;
        let model = Model::read(FileSet::single(name.clone(), bytes), None, &Limits::default()).ok()?;
        Some((name, model))
    };
    let models: Vec<_> = paths.into_iter().filter_map(read).collect();
    assert!(models.len() > 20, "only {} meshes", models.len());
    models
}

#[test]
fn real_meshes_come_back_as_they_were_edited() {
    for (name, model) in real_models() {
        for subdivide in [false, true] {
            let edited = Edited::of(&model, subdivide);
            let written = edited
                .write(&model, model.format)
                .unwrap_or_else(|e| panic!("{name}: {e}"));
            let again = read_back(&written, model.format);
            if model.format == Format::STL {
                assert_eq!(again.triangles.len(), edited.triangles.len(), "{name}");
                continue;
            }
            assert_eq!(again.positions.len(), edited.positions.len(), "{name}");
            let off = largest_distance(&again.positions, &edited.positions);
            assert!(off <= 1e-6 * size(&edited.positions), "{name}: {off}");
            if model.format == Format::OBJ {
                let sorted = |list: &[[u32; 3]]| {
                    let mut list = list.to_vec();
                    list.sort_unstable();
                    list
                };
                assert!(sorted(&again.triangles) == sorted(&edited.triangles), "{name}");
                if !subdivide && model.positions.len() < 20_000 {
                    same_corners(&name, &model.files.main, &written.main);
                }
            } else {
                assert!(again.triangles == edited.triangles, "{name}");
            }
            if model.normals.len() == model.positions.len() {
                let normals = model.normals.iter().zip(&again.normals);
                let turned = normals
                    .filter(|(a, b)| a.length() > 0.5 && a.distance(**b) > 1e-3)
                    .count();
                assert_eq!(turned, 0, "{name}: normals of unmoved vertices");
            }
        }
    }
}

/// Every corner of a triangle of the old text has the same coordinates and normal in the new one.
fn same_corners(name: &str, before: &[u8], after: &[u8]) {
    let list = |bytes: &[u8]| {
        let text = String::from_utf8_lossy(bytes).replace("\\\n", " ");
        let key = |(material, corners): (String, Vec<Corner>)| {
            let bits = |c: &Corner| format!("{:?} {:?}", c.1, c.2);
            let mut corners: Vec<String> = corners.iter().map(bits).collect();
            corners.sort();
            (material, corners)
        };
        let mut all: Vec<_> = faces(&text).into_iter().filter(|f| f.1.len() == 3).map(key).collect();
        all.sort();
        all
    };
    let text = String::from_utf8_lossy(before);
    // The little parser here knows neither negative numbers nor faces before their lines.
    if text.lines().any(|l| l.starts_with("f ") && l.contains('-')) {
        return;
    }
    let (before, after) = (list(before), list(after));
    let missing = before.iter().find(|face| after.binary_search(face).is_err());
    assert!(missing.is_none(), "{name}: {missing:?} is gone");
}

#[test]
fn coordinates_colours_and_materials_go_from_one_format_to_another() {
    let model = open("seam.obj", SEAM);
    let written = model.write(&model.positions, Format::GLB).expect("writable");
    let parsed = gltf_parsed::parse(&written.main, &written.companions);
    assert_eq!(parsed.buffers.len(), 1);
    let names: Vec<&str> = parsed.json["materials"]
        .as_array()
        .expect("materials")
        .iter()
        .filter_map(|m| m["name"].as_str())
        .collect();
    assert_eq!(names, ["left", "right"]);
    let glb = read_back(&written, Format::GLB);
    assert_eq!((glb.positions.len(), glb.triangles.len()), (8, 4), "parted at the seam");

    let back = glb.write(&glb.positions, Format::OBJ).expect("writable");
    let seen = faces(&String::from_utf8(back.main).expect("text"));
    for (i, (material, corners)) in seen.iter().enumerate() {
        let left = i < 2;
        assert_eq!(material, if left { "left" } else { "right" });
        for ([x, y, _], uv, normal) in corners {
            assert_eq!(*uv, Some(seam_uv(left, *x, *y)));
            assert!(normal.is_some());
        }
    }

    let model = open("square.ply", PLY);
    let written = model.write(&model.positions, Format::GLB).expect("writable");
    let parsed = gltf_parsed::parse(&written.main, &written.companions);
    let colour = parsed.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
        .as_u64()
        .expect("colours");
    assert_eq!(parsed.json["accessors"][colour as usize]["type"], "VEC4");
    let glb = read_back(&written, Format::GLB);
    let back = glb.write(&glb.positions, Format::PLY).expect("writable").main;
    let again = Edited::of(&open("back.ply", back.clone()), false)
        .write(&open("back.ply", back), Format::PLY)
        .expect("writable");
    let rows = vertex_rows(&again.main, "red");
    assert_eq!(rows[0][..4], [255, 0, 0, 255]);
    assert_eq!(rows[1][..4], [0, 255, 0, 255]);
    // Corners that differ around a vertex have parted on the way, so that each has its own.
    assert_eq!(rows.len(), 6);
    let first = vertex_rows(&again.main, "s");
    let uv = |row: &Vec<u8>| [0, 4].map(|k| f32::from_le_bytes(row[k..k + 4].try_into().expect("four bytes")));
    assert_eq!(uv(&first[1]), [1.0, 0.0]);
}

/// The bytes of each vertex of a binary PLY from a property on.
fn vertex_rows(ply: &[u8], property: &str) -> Vec<Vec<u8>> {
    let mark = b"end_header\n";
    let end = ply.windows(mark.len()).position(|w| w == mark).expect("a header");
    let head = String::from_utf8_lossy(&ply[..end]).into_owned();
    let reported = head.split_once("element vertex ").expect("vertices").1;
    let count: usize = reported
        .lines()
        .next()
        .and_then(|n| n.trim().parse().ok())
        .expect("a count");
    let (mut size, mut start) = (0, None);
    for line in reported.lines().skip(1).take_while(|line| line.starts_with("property")) {
        let [kind, name] = [1, 2].map(|k| line.split_whitespace().nth(k).expect("a word"));
        start = start.or((name == property).then_some(size));
        size += match kind {
            "double" => 8,
            "float" => 4,
            "uchar" => 1,
            _ => panic!("{line}"),
        };
    }
    let start = start.unwrap_or_else(|| panic!("no {property} in {head}"));
    let rows = ply[end + mark.len()..].chunks_exact(size).take(count);
    rows.map(|row| row[start..].to_vec()).collect()
}

/// Measures of a shape that do not depend on the order of its triangles: its area as a vector, and area times place.
fn moments(positions: &[DVec3], triangles: &[[u32; 3]]) -> [DVec3; 2] {
    let mut sum = [DVec3::ZERO; 2];
    for t in triangles {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        let area = (b - a).cross(c - a);
        sum[0] += area;
        sum[1] += (a + b + c) * area.length();
    }
    sum
}

#[test]
fn models_of_any_format_merge_into_any_other() {
    let all = [
        open("a.obj", SEAM),
        open("b.ply", PLY),
        open("c.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
        open(
            "d.stl",
            "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n",
        ),
        open("e.glb", sample::creature_glb()),
    ];
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut files = Vec::new();
    let put = DAffine3::from_translation(DVec3::new(0.0, 0.0, 4.0));
    for (i, first) in all.iter().enumerate() {
        for (k, second) in all.iter().enumerate() {
            let mut edited = Edited::of(first, true);
            let mut other = Edited::of(second, true);
            other.positions.iter_mut().for_each(|p| *p = put.transform_point3(*p));
            edited.merge(&other);
            let bases = [
                at_rest(first),
                BaseModel {
                    model: second,
                    world_from_model: put,
                },
            ];
            let remade = edited.remade(&bases);
            for format in Format::ALL {
                let place = format!("{i} and {k} as {format}");
                let written =
                    write_edited_model(&remade, &edited.positions, format).unwrap_or_else(|e| panic!("{place}: {e}"));
                let again = read_back(&written, format);
                assert_eq!(again.triangles.len(), edited.triangles.len(), "{place}");
                let wanted = moments(&edited.positions, &edited.triangles);
                let seen = moments(&again.positions, &again.triangles);
                let off = seen
                    .iter()
                    .zip(wanted)
                    .map(|(a, b)| (a - b).abs().max_element())
                    .fold(0.0, f64::max);
                assert!(off < 1e-4, "{place}: {seen:?} is not {wanted:?}");
                if [Format::GLB, Format::GLTF].contains(&format) {
                    let at = folder.path().join(format!("{i}{k}/model.{format}"));
                    khronos::store(&written, &at);
                    files.push(at);
                }
            }
        }
    }
    for (file, codes) in khronos::validate(&files).unwrap_or_default() {
        assert!(codes.is_empty(), "{}: {codes:?}", file.display());
    }
}

#[test]
fn a_bare_surface_has_the_normals_of_its_triangles() {
    let model = open("seam.obj", SEAM);
    let mut edited = Edited::of(&model, false);
    for old in [0, 1, 4] {
        edited.recipes.push_vertex(old);
        edited.positions.push(model.positions[old as usize] - DVec3::Z);
    }
    edited.triangles.push([8, 7, 6]);
    edited.runs[0].vertex_count += 3;
    edited.runs[0].triangle_count += 1;
    let bases = [at_rest(&model)];
    let bare = [false, false, false, false, false, false, true, true, true];
    let remade = EditedModel {
        bare: &bare,
        ..edited.remade(&bases)
    };
    let written = write_edited_model(&remade, &edited.positions, Format::OBJ).expect("writable");
    let seen = faces(&String::from_utf8(written.main).expect("text"));
    let below: Vec<_> = seen.iter().flat_map(|f| &f.1).filter(|c| c.0[2] < 0.0).collect();
    assert!(
        below.len() == 3 && below.iter().all(|c| c.2 == Some([0.0, 0.0, -1.0])),
        "{below:?}"
    );
}

#[test]
fn descriptions_that_do_not_hold_together_are_refused_with_the_reason() {
    let model = open("c.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n");
    let refusal = |change: &dyn Fn(&mut Edited)| {
        let mut edited = Edited::of(&model, true);
        change(&mut edited);
        edited.write(&model, Format::OFF).expect_err("refused").to_string()
    };
    type Change<'a> = &'a dyn Fn(&mut Edited);
    let cases: [(&str, Change<'_>); 7] = [
        ("5 positions are given, the model has 6", &|e| e.positions.truncate(5)),
        ("not finite", &|e| e.positions[2].x = f64::NAN),
        ("primitive 1 of base 0", &|e| e.runs[0].primitive = 1),
        ("reaches past", &|e| e.runs[0].vertex_count = u32::MAX),
        ("does not begin where", &|e| e.runs[0].first_triangle = 1),
        ("its vertices are 0..6", &|e| e.triangles[0] = [0, 1, 6]),
        ("made of vertex 3", &|e| {
            e.recipes.push_vertex(3);
            e.positions.push(DVec3::ZERO);
            e.runs[0].vertex_count = 7;
        }),
    ];
    for (phrase, change) in cases {
        let text = refusal(change);
        assert!(text.contains(phrase), "{text}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Whatever the description, the answer is a file that is read again, or a reason.
    #[test]
    fn no_description_panics(
        which in 0usize..3,
        blends in prop::collection::vec(prop::collection::vec((0u32..6, 0.0..1.0f64), 1..12), 4..20),
        triangles in prop::collection::vec([0u32..22, 0u32..22, 0u32..22], 1..30),
        wild in any::<bool>(),
        split in (0u32..20, 0u32..30),
        origins in prop::collection::vec(0u32..12, 0..30),
        format in 0..Format::ALL.len(),
    ) {
        let model = match which {
            0 => open("a.obj", SEAM),
            1 => open("b.ply", PLY),
            _ => open("d.glb", open("b.ply", PLY).write(&open("b.ply", PLY).positions, Format::GLB).expect("writable").main),
        };
        // Nearly all wild descriptions are refused; the tame ones are all written.
        let most = if wild { 6 } else { model.primitives[0].vertex_count };
        let mut recipes = VertexBlends::default();
        for blend in &blends {
            recipes.push_blend(&blend.iter().map(|&(v, w)| (v % most, w)).collect::<Vec<_>>());
        }
        let count = recipes.len() as u32;
        let triangles: Vec<[u32; 3]> = triangles.iter().map(|t| if wild { *t } else { t.map(|v| v % count) }).collect();
        let origins = if wild { origins } else { origins.iter().copied().cycle().take(if origins.is_empty() { 0 } else { triangles.len() }).collect() };
        let positions: Vec<DVec3> = (0..count).map(|i| DVec3::new(f64::from(i), f64::from(i * i % 7), f64::from(i % 3))).collect();
        let runs = if wild && split.0 < 9 {
            let run = |first_vertex, vertex_count, first_triangle, triangle_count| PrimitiveRun {
                base: 0, primitive: 0, first_vertex, vertex_count, first_triangle, triangle_count,
            };
            let (v, t) = (split.0.min(count), split.1.min(triangles.len() as u32));
            vec![run(0, v, 0, t), run(v, count - v, t, triangles.len() as u32 - t)]
        } else {
            vec![PrimitiveRun {
                base: 0, primitive: 0, first_vertex: 0, vertex_count: count, first_triangle: 0, triangle_count: triangles.len() as u32,
            }]
        };
        let bases = [at_rest(&model)];
        let remade = EditedModel { bases: &bases, runs: &runs, blends: &recipes, triangles: &triangles, origins: &origins, bare: &[], caps: Default::default() };
        match write_edited_model(&remade, &positions, Format::ALL[format]) {
            // A triangle with a corner twice is not an error, but the readers may leave it out.
            Ok(written) => drop(Model::read(
                FileSet::single("written", written.main), Some(Format::ALL[format]), &Limits::default()
            ).expect("what was written is read")),
            Err(e) => prop_assert!(wild, "{e}"),
        }
    }
}
