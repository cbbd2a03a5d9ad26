//! OBJ, PLY, OFF and STL in and out: real meshes survive a round trip, hostile files are refused, nothing panics.

use crate::support::data::{data_path, files_below, report_skipped};
use crate::support::recipes::file_set;
use crate::support::shapes::bounds;
use glam::DVec3;
use pliant::asset::{Error, FileSet, Format, Geometry, Limits, Model, sample};
use proptest::prelude::*;
use std::path::{Path, PathBuf};

fn files_of(folder: &Path, extensions: &[&str]) -> Vec<PathBuf> {
    files_below(folder, |p| {
        p.parent() == Some(folder) && p.extension().is_some_and(|e| extensions.iter().any(|x| e == *x))
    })
}

fn load(path: &Path) -> FileSet {
    let name = path.file_name().expect("it has a name").to_string_lossy().into_owned();
    FileSet::single(name, std::fs::read(path).expect("it can be read"))
}

fn read(files: FileSet) -> Result<Model, Error> {
    Model::read(files, None, &Limits::default())
}

fn write(model: &Model, positions: &[DVec3], format: Format, name: impl std::fmt::Display) -> Vec<u8> {
    let written = model.write(positions, format).unwrap_or_else(|e| panic!("{name}: {e}"));
    written.main
}

/// A smooth motion that moves every vertex, so that rounding shows everywhere.
fn twist(positions: &[DVec3]) -> Vec<DVec3> {
    let (low, high) = bounds(positions);
    let size = (high - low).max_element();
    let turn = |p: &DVec3| {
        let (sin, cos) = libm::sincos((p.y - low.y) / size + 0.3);
        DVec3::new(cos * p.x - sin * p.z, p.y * 1.1 + size / 3.0, sin * p.x + cos * p.z)
    };
    positions.iter().map(turn).collect()
}

#[test]
fn every_mesh_comes_back_as_it_was_and_as_it_was_moved() {
    let Some(folder) = data_path("text formats", "meshes") else {
        return;
    };
    let paths = files_of(&folder, &["obj", "ply", "off"]);
    assert!(paths.len() > 30, "only {} meshes in {}", paths.len(), folder.display());
    for path in paths {
        let name = path.display();
        let files = load(&path);
        let model = read(files.clone()).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(Some(model.format), Format::from_file_name(&files.name), "{name}");

        let same = write(&model, &model.positions, model.format, &name);
        assert!(same == files.main[..], "{name}: the rest pose changes the file");

        let moved = twist(&model.positions);
        let written = write(&model, &moved, model.format, &name);
        let reread = read(FileSet::single(files.name.clone(), written)).unwrap_or_else(|e| panic!("{name}: {e}"));
        let single = model.format == Format::PLY;
        for (i, (seen, wanted)) in reread.positions.iter().zip(&moved).enumerate() {
            let wanted = if single { wanted.as_vec3().as_dvec3() } else { *wanted };
            assert!(*seen == wanted, "{name}: vertex {i} is {seen}, not {wanted}");
        }
        let unmoved = |m: &Model| {
            let mut geometry = m.geometry.clone();
            geometry.positions.clear();
            geometry.normals.clear();
            // Concave polygons are cut according to their shape.
            geometry.triangles.iter_mut().for_each(|t| t.sort_unstable());
            if m.format == Format::OBJ {
                Geometry {
                    triangles: Vec::new(),
                    ..geometry
                }
            } else {
                geometry
            }
        };
        assert_eq!(reread.positions.len(), moved.len(), "{name}");
        assert_eq!(reread.triangles.len(), model.triangles.len(), "{name}");
        assert!(
            unmoved(&reread) == unmoved(&model),
            "{name}: more than positions changed"
        );

        // Moving back gives the file's own numbers, if perhaps in other digits.
        let back = write(&reread, &model.positions, reread.format, &name);
        let back = read(FileSet::single(files.name.clone(), back)).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(
            back.positions == model.positions,
            "{name}: moving back does not restore the positions"
        );
    }
}

#[test]
fn one_moved_vertex_changes_one_line() {
    let Some(folder) = data_path("text formats", "meshes") else {
        return;
    };
    for path in files_of(&folder, &["obj", "off"]) {
        let files = load(&path);
        let model = read(files.clone()).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let mut moved = model.positions.clone();
        let middle = moved.len() / 2;
        moved[middle] += DVec3::splat(0.1);
        let written = write(&model, &moved, model.format, path.display());
        let lines = |bytes: &[u8]| bytes.split(|&b| b == b'\n').map(<[u8]>::to_vec).collect::<Vec<_>>();
        let (old, new) = (lines(&files.main), lines(&written));
        let has_normals = old.iter().any(|l| l.starts_with(b"vn"));
        let differing = old.iter().zip(&new).filter(|(a, b)| a != b).count();
        assert!(
            has_normals || (old.len() == new.len() && differing == 1),
            "{}: {differing} lines",
            path.display()
        );
    }
}

#[test]
fn conversion_keeps_positions_triangles_and_normals() {
    let Some(folder) = data_path("text formats", "meshes") else {
        return;
    };
    for name in ["spot.obj", "cow.off", "non_manif_hole.ply", "suzanne.obj"] {
        let model = read(load(&folder.join(name))).unwrap_or_else(|e| panic!("{name}: {e}"));
        let moved = twist(&model.positions);
        for format in Format::ALL.into_iter().filter(|f| *f != model.format) {
            let written = write(&model, &moved, format, format!("{name} to {format}"));
            let reread =
                read(FileSet::single("converted", written)).unwrap_or_else(|e| panic!("{name} to {format}: {e}"));
            assert_eq!(reread.format, format);
            assert_eq!(reread.triangles.len(), model.triangles.len(), "{name} to {format}");
            if name == "suzanne.obj" && [Format::PLY, Format::OFF].contains(&format) {
                // Its quads come back whole, and are divided along the diagonal that is the shorter one there.
                assert_eq!(reread.positions.len(), model.positions.len(), "{name} to {format}");
                continue;
            }
            for (old, new) in model.triangles.iter().zip(&reread.triangles) {
                for k in 0..3 {
                    let (wanted, seen) = (moved[old[k] as usize], reread.positions[new[k] as usize]);
                    let exact = seen == wanted || seen == wanted.as_vec3().as_dvec3();
                    assert!(exact, "{name} to {format}: {seen}, not {wanted}");
                }
            }
        }
    }
}

/// What the notes beside the data say of each text file: 4xx is an error, 200 is a model.
#[test]
fn hostile_texts_get_the_answer_they_should() {
    let Some(folder) = data_path("hostile text files", "hostile") else {
        return;
    };
    for (name, good) in [
        ("text/obj_index_zero.obj", false),
        ("text/obj_negative_indices.obj", true),
        ("text/obj_nan.obj", false),
        ("text/off_counts_too_large.off", false),
        ("text/ply_count_huge.ply", false),
        ("assimp/OutOfMemory.off", false),
        ("topology/one_triangle.obj", true),
        ("topology/degenerate_indices.obj", true),
        ("topology/duplicate_faces.obj", true),
        ("topology/nonmanifold_edge_fan.obj", true),
        ("topology/random_winding.obj", true),
        ("topology/unreferenced_vertices.obj", true),
    ] {
        let path = folder.join(name);
        if !path.is_file() {
            report_skipped("a hostile text file", &format!("{} is not there", path.display()));
            continue;
        }
        match read(load(&path)) {
            Ok(model) => {
                assert!(good, "{name} should be refused");
                let out = write(&model, &twist(&model.positions), model.format, name);
                assert_eq!(
                    read(FileSet::single(name, out)).map(|m| m.triangles.len()),
                    Ok(model.triangles.len())
                );
            }
            Err(error) => {
                assert!(!good, "{name}: {error}");
                let text = error.to_string();
                assert!(text.len() < 300 && !text.ends_with('.'), "{name}: {text}");
            }
        }
    }
}

#[test]
fn a_name_or_a_first_word_gives_the_format() {
    let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    assert_eq!(read(FileSet::single("", obj)).map(|m| m.format), Ok(Format::OBJ));
    assert_eq!(
        read(FileSet::single("a.OBJ", format!("shadow 1\n{obj}"))).map(|m| m.format),
        Ok(Format::OBJ)
    );
    let error = read(FileSet::single("picture.png", &b"\x89PNG\r\n"[..])).expect_err("no model");
    assert_eq!(
        error.to_string(),
        "picture.png: not a known model format; allowed are glb, gltf, obj, ply, off, stl, 3mf, fbx, splat and spz"
    );
    let forced = Model::read(FileSet::single("a.obj", obj), Some(Format::PLY), &Limits::default());
    assert!(
        matches!(forced, Err(Error::Malformed { format, .. }) if format == Format::PLY),
        "a format that is given wins"
    );
}

#[test]
fn positions_that_do_not_fit_are_refused() {
    let model = read(FileSet::single("", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")).expect("a triangle");
    let error = model
        .write(&model.positions[..2], Format::OBJ)
        .expect_err("one is missing");
    assert_eq!(
        error.to_string(),
        "cannot write obj: 2 positions are given, the model has 3 vertices"
    );
    let error = model
        .write(&[DVec3::ZERO, DVec3::NAN, DVec3::ZERO], Format::GLB)
        .expect_err("not finite");
    assert!(error.to_string().contains("vertex 1"), "{error}");
}

/// Small valid files of every kind, to break.
fn seeds() -> Vec<(Format, Vec<u8>)> {
    let obj = "# seed\r\nmtllib a.mtl\nv 0 0 0 1 0 0\nv 1 0 0\nv 1 1 \\\n 0\nv .5 .4 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nvn 0 1 0\n\
        o a\nf 1/1/1 2/1/1 3/1/2 4//1 5//1\nf -5//-1 -4 -3//-2\ng b\nusemtl c\ns 1\nl 1 2\n";
    let off = "COFF\n5 3 0 # seed\n0 0 0 1 0 0 1\n1 0 0\n1 1 0\n.5 .4 0\n0 1 0\n5 0 1 2 3 4 255 0 0\n3 0 1 2\n2 0 1\n";
    let ply = "ply\nformat ascii 1.0\ncomment seed\nelement vertex 5\nproperty float x\nproperty double y\nproperty char z\n\
        property float nx\nproperty float ny\nproperty float nz\nelement face 2\nproperty uchar a\n\
        property list uchar int vertex_indices\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n\
        0 0 0 0 0 1\n1 0 0 0 0 1\n1 1 0 0 0 1\n.5 .4 0 0 0 1\n0 1 0 0 0 1\n1 5 0 1 2 3 4\n2 3 0 1 2\n6 0 1 2 -1 3 4\n";
    let stl = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n";
    let mut seeds: Vec<_> = [
        (Format::OBJ, obj),
        (Format::OFF, off),
        (Format::PLY, ply),
        (Format::STL, stl),
    ]
    .map(|(format, text)| (format, text.as_bytes().to_vec()))
    .to_vec();
    let model = read(FileSet::single("", obj)).expect("a valid seed");
    for format in Format::ALL {
        let written = model
            .write(&twist(&model.positions), format)
            .expect("it fits every format");
        seeds.push((format, written.main));
    }
    for (format, bytes) in &seeds {
        assert!(
            read(FileSet::single("", bytes.clone())).is_ok_and(|m| m.format == *format),
            "a {format} seed is not valid"
        );
    }
    seeds
}

/// Reads bytes as a format; if they are a model, uses it: none of this may panic, and what is written reads back.
fn exercise(bytes: Vec<u8>, format: Option<Format>) {
    let limits = Limits {
        vertices: 100_000,
        triangles: 100_000,
        decoded_bytes: 10_000_000,
        ..Limits::default()
    };
    let Ok(model) = Model::read(FileSet::single("", bytes), format, &limits) else {
        return;
    };
    assert!(model.positions.iter().all(|p| p.is_finite()) && !model.triangles.is_empty());
    assert!(
        model
            .triangles
            .iter()
            .flatten()
            .all(|&v| (v as usize) < model.positions.len())
    );
    for format in [model.format, Format::OBJ, Format::PLY] {
        if let Ok(written) = model.write(&twist(&model.positions), format) {
            let files = file_set("", written);
            let reread = Model::read(files, Some(format), &Limits::default());
            assert_eq!(
                reread.map(|m| m.positions.len()),
                Ok(model.positions.len()),
                "written as {format}"
            );
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400), format in 0..Format::ALL.len()) {
        exercise(bytes, Some(Format::ALL[format]));
    }

    #[test]
    fn random_words_never_panic(
        words in prop::collection::vec(
            prop::sample::select(vec![
                "v", "vn", "f", "OFF", "NOFF", "ply", "format ascii 1.0", "element vertex", "element face", "end_header", "solid",
                "property list uchar int vertex_indices", "property int x", "facet normal", "outer loop", "vertex", "endloop",
                "endfacet", "\n", "\n", "\n", "\\\n", "#", "0", "1", "2", "3", "-1", "1//1", "1e308", "-1e308", "nan", "4294967295", "/",
            ]),
            0..60,
        ),
        head in prop::sample::select(vec!["", "OFF\n", "ply\nformat ascii 1.0\nelement vertex 3\n", "solid\nfacet normal 0 0 1\nouter loop\n"]),
        format in 2..Format::ALL.len(),
    ) {
        exercise((head.to_string() + &words.join(" ")).into_bytes(), Some(Format::ALL[format]));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn broken_files_never_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in any::<prop::sample::Index>(),
        truncate in any::<bool>(),
    ) {
        for (format, mut bytes) in seeds() {
            for (place, value) in &edits {
                let at = place.index(bytes.len());
                // Digits often, so that numbers stay numbers.
                bytes[at] = if value % 2 == 0 { b'0' + value % 10 } else { *value };
            }
            if truncate {
                bytes.truncate(cut.index(bytes.len()));
            }
            exercise(bytes, Some(format));
        }
    }
}

#[test]
fn the_sample_can_be_had_in_every_format() {
    let model = read(FileSet::single("creature.glb", sample::creature_glb())).expect("the sample is a model");
    for format in Format::ALL {
        let written = write(&model, &twist(&model.positions), format, format);
        assert_eq!(
            read(FileSet::single("", written)).map(|m| m.triangles.len()),
            Ok(model.triangles.len())
        );
    }
}
