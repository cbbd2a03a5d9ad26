//! What the command line writes: files that are there and folders that are not, and the files that belong to a model.

use crate::support::commands::{Ran, Workplace, pliant_in};
use crate::support::data::data_folder;
use crate::support::gltf_sets::read_model;
use crate::support::khronos;
use crate::support::shapes::bounds;
use pliant::asset::sample;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Every file below a folder, by its path there.
fn files_in(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).expect("a folder").flatten() {
            if entry.path().is_dir() {
                open.push(entry.path());
            } else {
                let bytes = fs::read(entry.path()).expect("a file");
                let name = entry.path().strip_prefix(folder).expect("inside").to_owned();
                found.insert(name, bytes);
            }
        }
    }
    found
}

/// A picture by its first bytes; no one looks at the rest.
fn picture(mark: &[u8]) -> Vec<u8> {
    [mark, b" not a picture that anybody looks at"].concat()
}

/// A tall box as a .gltf whose buffer and pictures lie outside, one of them in a folder of its own.
fn box_gltf(folder: &Path) {
    let mut points = Vec::new();
    let mut indices: Vec<u16> = Vec::new();
    for ring in 0..7u16 {
        points.extend([[0, 0], [1, 0], [1, 1], [0, 1]].map(|[x, z]| [x as f32, f32::from(ring), z as f32]));
        if ring > 0 {
            let (a, b) = (4 * (ring - 1), 4 * ring);
            indices.extend((0..4).flat_map(|i| {
                let j = (i + 1) % 4;
                [a + i, b + i, b + j, a + i, b + j, a + j]
            }));
        }
    }
    indices.extend([0, 1, 2, 0, 2, 3, 24, 26, 25, 24, 27, 26]);
    let mut bytes: Vec<u8> = points.iter().flatten().flat_map(|v: &f32| v.to_le_bytes()).collect();
    let first = bytes.len();
    bytes.extend(indices.iter().flat_map(|i| i.to_le_bytes()));
    let document = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "normalTexture": {"index": 1}}],
        "textures": [{"source": 0}, {"source": 1}],
        "images": [{"uri": "textures/base%20colour.png"}, {"uri": "./normal.jpg"}],
        "buffers": [{"byteLength": bytes.len(), "uri": "the%20box.bin"}],
        "bufferViews": [{"buffer": 0, "byteLength": first}, {"buffer": 0, "byteOffset": first, "byteLength": bytes.len() - first}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": points.len(), "type": "VEC3", "min": [0, 0, 0], "max": [1, 6, 1]},
            {"bufferView": 1, "componentType": 5123, "count": indices.len(), "type": "SCALAR"}],
    });
    fs::create_dir_all(folder.join("textures")).expect("made");
    fs::write(folder.join("box.gltf"), document.to_string()).expect("written");
    fs::write(folder.join("the box.bin"), bytes).expect("written");
    fs::write(folder.join("textures/base colour.png"), picture(b"\x89PNG\r\n\x1a\n")).expect("written");
    fs::write(folder.join("normal.jpg"), picture(b"\xff\xd8\xff")).expect("written");
}

/// A job that holds the lower third of a model and turns the upper one.
fn job_for(model: &Path, folder: &Path) -> PathBuf {
    let (low, high) = bounds(&read_model(model).expect("a model").positions);
    let (low, high) = (low.y, high.y);
    let third = (high - low) / 3.0;
    let job = json!({
        "handles": [
            {"id": "low", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -(low + third)}}},
            {"id": "high", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": high - third}}}],
        "steps": [{"pose": {"handles": [{"id": "high", "pose": {"rotationVector": [0, 0, 0.3]}}]}}],
    });
    let path = folder.join("job.json");
    fs::write(&path, job.to_string()).expect("written");
    path
}

fn decoded(uri: &str) -> String {
    let name = percent_encoding::percent_decode_str(uri)
        .decode_utf8_lossy()
        .into_owned();
    name.strip_prefix("./").map(str::to_owned).unwrap_or(name)
}

/// The bytes of every image of a written model, and the names of the files that it still names.
fn images_of(model: &Path) -> (Vec<Vec<u8>>, BTreeSet<String>) {
    let file = fs::read(model).expect("written");
    let (json, bin) = if file.starts_with(b"glTF") {
        let length = u32::from_le_bytes(file[12..16].try_into().expect("four bytes")) as usize;
        (file[20..20 + length].to_vec(), file[28 + length..].to_vec())
    } else {
        (file, Vec::new())
    };
    let document: Value = serde_json::from_slice(&json).expect("JSON");
    let list = |key: &str| document[key].as_array().cloned().unwrap_or_default();
    let mut named = BTreeSet::new();
    for item in list("images").iter().chain(&list("buffers")) {
        named.extend(item["uri"].as_str().map(decoded));
    }
    let images = list("images").into_iter().map(|image| match image["uri"].as_str() {
        Some(uri) => fs::read(model.parent().expect("a folder").join(decoded(uri))).expect("an image beside it"),
        None => {
            assert!(image["mimeType"].as_str().is_some_and(|t| t.starts_with("image/")));
            let view = &document["bufferViews"][image["bufferView"].as_u64().expect("a view") as usize];
            let first = view["byteOffset"].as_u64().unwrap_or(0) as usize;
            bin[first..first + view["byteLength"].as_u64().expect("a length") as usize].to_vec()
        }
    });
    (images.collect(), named)
}

/// Deforms a model into a .gltf and a .glb elsewhere: every image must be there to the byte, and the .glb must stand alone.
fn check_companions(model: &Path, folder: &Path) -> Vec<PathBuf> {
    fs::create_dir_all(folder).expect("made");
    let job = job_for(model, folder);
    let (before, named) = images_of(model);
    assert!(!before.is_empty());
    let [model_name, job] = [model, &job].map(|p| p.to_string_lossy().into_owned());
    let mut written = Vec::new();
    for (name, more) in [("out.gltf", named), ("alone/out.glb", BTreeSet::new())] {
        let arguments = ["deform", &model_name, "--job", &job, "-o", name, "--parents"];
        let said = Ran::of(&mut pliant_in(folder, &arguments)).exits(0).err;
        assert!(!said.contains("image-missing"), "{said}");
        let (images, still_named) = images_of(&folder.join(name));
        assert_eq!(images, before, "{name}");
        assert_eq!(still_named, more, "{name}");
        written.push(folder.join(name));
    }
    assert_eq!(files_in(&folder.join("alone")).len(), 1, "a GLB stands alone");
    written
}

#[test]
fn nothing_is_replaced_without_force_and_no_folder_made_without_parents() {
    let folder = Workplace::empty();
    let path = folder.path();
    folder.put("creature.glb", sample::creature_glb());
    folder.put("job.json", r#"{"handles": []}"#);
    folder.put("precious.obj", "not a model");
    folder.put("precious.png", "not a picture");
    fs::create_dir(path.join("folder.obj")).expect("made");
    let before = files_in(path);
    let (deform, render) = ("deform creature.glb --job job.json -o", "render creature.glb -o");
    for (command, output, why) in [
        (deform, "precious.obj", "precious.obj: it exists; --force replaces it"),
        (render, "precious.png", "precious.png: it exists; --force replaces it"),
        (deform, "precious.obj --parents", "--force"),
        (
            deform,
            "a/b/out.obj",
            "the folder a/b does not exist; --parents makes it",
        ),
        (
            render,
            "a/out.png --force",
            "the folder a does not exist; --parents makes it",
        ),
        (deform, "folder.obj --force --parents", "it is a folder"),
        (deform, "precious.png/out.obj --parents", "precious.png is not a folder"),
        (
            "check suite --junit",
            "precious.obj",
            "precious.obj: it exists; --force replaces it",
        ),
    ] {
        let arguments = format!("{command} {output}");
        folder.refused(&arguments, &[why]);
        assert_eq!(files_in(path), before, "{arguments:?} wrote something");
    }
    folder.done(&format!("{deform} precious.obj --force"));
    folder.done(&format!("{render} precious.png --force --size 64x64"));
    folder.done(&format!("{deform} a/b/out.obj --parents"));
    let after = files_in(path);
    assert!(after[Path::new("precious.png")].starts_with(b"\x89PNG"));
    assert_eq!(after[Path::new("precious.obj")], after[Path::new("a/b/out.obj")]);
    assert_eq!(after.len(), before.len() + 1, "no other file is left");
}

#[cfg(unix)]
#[test]
fn a_link_stays_a_link_and_a_device_is_never_replaced() {
    let folder = Workplace::empty();
    let path = folder.path();
    folder.put("creature.glb", sample::creature_glb());
    folder.put("job.json", r#"{"handles": []}"#);
    fs::create_dir(path.join("elsewhere")).expect("made");
    folder.put("elsewhere/real.obj", "old");
    std::os::unix::fs::symlink("elsewhere/real.obj", path.join("link.obj")).expect("a link");
    std::os::unix::fs::symlink("/dev/null", path.join("null.obj")).expect("a link");
    let to = |name| format!("deform creature.glb --job job.json -o {name} --force");
    folder.done(&to("link.obj"));
    assert!(fs::symlink_metadata(path.join("link.obj")).expect("there").is_symlink());
    assert!(folder.bytes("elsewhere/real.obj").starts_with(b"# pliant"));
    folder.refused(&to("null.obj"), &["it is not a regular file"]);
}

#[test]
fn a_file_with_the_name_of_a_companion_alone_is_replaced_by_force() {
    let folder = Workplace::empty();
    let path = folder.path();
    box_gltf(path);
    let job = job_for(&path.join("box.gltf"), path);
    let job = job.to_string_lossy();
    let to = vec!["deform", "box.gltf", "--job", &job, "-o", "bent.obj"];
    folder.done(&to);
    let library = folder.bytes("box.mtl");
    // The model was read without it, so it is not the model's.
    folder.put("box.mtl", "newmtl other\n");
    fs::remove_file(path.join("bent.obj")).expect("removed");
    folder.refused(&to, &["box.mtl: it exists; --force replaces it"]);
    folder.done(&[&to[..], &["--force"]].concat());
    assert_eq!(folder.bytes("box.mtl"), library);
}

#[test]
fn files_beside_the_result_are_looked_at_before_anything_is_written() {
    let folder = Workplace::empty();
    let path = folder.path();
    box_gltf(path);
    let job = job_for(&path.join("box.gltf"), path);
    let job = job.to_string_lossy();
    let to = |name| vec!["deform", "box.gltf", "--job", &job, "-o", name];
    let before = files_in(path);
    // In the model's own folder its buffer would be replaced, with --force too.
    for arguments in [to("bent.gltf"), [to("bent.gltf"), vec!["--force"]].concat()] {
        folder.refused(&arguments, &["the model's own the box.bin"]);
    }
    fs::create_dir_all(path.join("out")).expect("made");
    folder.refused(&to("out/bent.gltf"), &["textures does not exist; --parents makes it"]);
    assert_eq!(files_in(path), before);
    folder.put("out/normal.jpg", "precious");
    let parents = [to("out/bent.gltf"), vec!["--parents"]].concat();
    folder.refused(&parents, &["out/normal.jpg: it exists; --force replaces it"]);
    assert_eq!(files_in(&path.join("out")).len(), 1);
    folder.done(&[&parents[..], &["--force"]].concat());
    let written = files_in(&path.join("out"));
    assert_eq!(written.len(), 4);
    // Companions that are there already, byte for byte, are in no one's way.
    fs::remove_file(path.join("out/bent.gltf")).expect("removed");
    folder.done(&to("out/bent.gltf"));
    assert_eq!(files_in(&path.join("out")), written);
    // Over itself a model takes its buffer along.
    folder.done(&[to("box.gltf"), vec!["--force"]].concat());
    let after = files_in(path);
    assert_eq!(after[Path::new("the box.bin")], written[Path::new("the box.bin")]);
    assert_ne!(after[Path::new("the box.bin")], before[Path::new("the box.bin")]);
}

#[test]
fn images_and_buffers_come_along_and_a_glb_stands_alone() {
    let folder = Workplace::empty();
    box_gltf(folder.path());
    check_companions(&folder.path().join("box.gltf"), &folder.path().join("made"));

    // Without its image the model is read all the same, and says so.
    fs::remove_file(folder.path().join("normal.jpg")).expect("removed");
    let job = job_for(&folder.path().join("box.gltf"), folder.path());
    let said = folder
        .done(&["deform", "box.gltf", "--job", &job.to_string_lossy(), "-o", "less.glb"])
        .err;
    assert!(
        said.contains("warning image-missing: ") && said.contains("normal.jpg"),
        "{said}"
    );
    fs::remove_file(folder.path().join("the box.bin")).expect("removed");
    folder.refused("inspect box.gltf", &["\"the box.bin\" is missing"]);
}

#[test]
fn nothing_outside_the_folder_of_a_model_is_read() {
    let folder = Workplace::empty();
    let inside = folder.path().join("model");
    box_gltf(&inside);
    folder.put("secret.png", picture(b"\x89PNG\r\n\x1a\n"));
    let text = fs::read_to_string(inside.join("box.gltf")).expect("text");
    let job = job_for(&inside.join("box.gltf"), folder.path());
    let job = job.to_string_lossy();
    for (uri, code) in [
        ("../secret.png", "image-outside"),
        ("%2e%2e/secret.png", "image-outside"),
        ("a/../../secret.png", "image-outside"),
        ("/etc/hostname", "image-outside"),
    ] {
        let hostile = text.replace("./normal.jpg", uri);
        assert_ne!(hostile, text);
        fs::write(inside.join("hostile.gltf"), &hostile).expect("written");
        let arguments = [
            "deform",
            "model/hostile.gltf",
            "--job",
            &job,
            "-o",
            "out.glb",
            "--force",
        ];
        let said = folder.done(&arguments).err;
        assert!(said.contains(&format!("warning {code}: ")), "{uri}: {said}");
        let out = folder.bytes("out.glb");
        let secret = picture(b"\x89PNG\r\n\x1a\n");
        let times = out.windows(secret.len()).filter(|w| *w == secret).count();
        assert_eq!(times, 1, "the model's own picture and no other");
    }
}

#[test]
fn real_models_keep_every_image() {
    let Some(data) = data_folder("images of real models") else {
        return;
    };
    let folder = Workplace::empty();
    let (mut models, mut written) = (Vec::new(), Vec::new());
    for name in ["WaterBottle", "BoomBox", "AnimatedCube"] {
        let model = data.join(format!("gltf/{name}_separate/{name}.gltf"));
        written.push(check_companions(&model, &folder.path().join(name)));
        models.push(model);
    }
    let files: Vec<PathBuf> = models
        .iter()
        .cloned()
        .chain(written.iter().flatten().cloned())
        .collect();
    let Some(findings) = khronos::validate(&files) else {
        return;
    };
    for (model, written) in models.iter().zip(&written) {
        for file in written {
            let new: Vec<_> = findings[file].difference(&findings[model]).collect();
            assert!(new.is_empty(), "{}: {new:?}", file.display());
        }
    }
}

/// Writes the figure as fox.gltf, whose buffer is in a file of this name.
fn figure_beside(folder: &Path, buffer: &str) {
    let glb = sample::figure_glb();
    let length_at = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().expect("four bytes")) as usize;
    let json_end = 20 + length_at(12);
    let mut document: Value = serde_json::from_slice(&glb[20..json_end]).expect("JSON");
    document["buffers"][0]["uri"] = buffer.into();
    fs::write(folder.join("fox.gltf"), document.to_string()).expect("written");
    let bytes = &glb[json_end + 8..json_end + 8 + length_at(json_end)];
    fs::write(folder.join(buffer), bytes).expect("written");
}

#[test]
fn nothing_that_is_written_replaces_a_file_of_its_model() {
    let still = r#"{"handles": [{"id": "a", "region": {"halfSpace": {"normal": [0, 1, 0], "offset": 0}}}]}"#;
    let animate = "animate fox.gltf --clip walk --frames 0:2 -o";
    let ways = [
        ("fox.pc2", animate),
        ("fox.png", animate),
        ("fox.glb", animate),
        ("fox.obj", "deform fox.gltf --job job.json -o"),
        ("fox.png", "rig fox.gltf --preset cmu -o rig.json --picture"),
    ];
    for (buffer, way) in ways {
        let folder = Workplace::empty();
        folder.put("job.json", still);
        figure_beside(folder.path(), buffer);
        let before = files_in(folder.path());
        let wanted = format!("fox.gltf is made of it, as \"{buffer}\"");
        folder.refused(&format!("{way} {buffer} --force"), &[&wanted]);
        assert_eq!(files_in(folder.path()), before, "{way:?}");
        // Beside it there is room.
        folder.done(&format!("{way} new-{buffer}"));
    }
}

#[test]
fn an_edited_text_stl_keeps_its_solids() {
    let folder = Workplace::empty();
    let (points, faces) = pliant::asset::shapes::box_with_cells(glam::DVec3::new(1.0, 4.0, 1.0), [2, 8, 2]);
    let mut text = String::new();
    for (name, low) in [("Lower Half", true), ("upper half", false)] {
        text += &format!("SOLID {name}\r\n");
        for corners in faces.iter().map(|t| t.map(|v| points[v as usize])) {
            let middle = corners.iter().map(|p| p.y).sum::<f64>() / 3.0;
            if (middle < 2.0) == low {
                text += "facet normal 0 0 0\r\nouter loop\r\n";
                text.extend(corners.map(|p| format!("vertex {} {} {}\r\n", p.x, p.y, p.z)));
                text += "endloop\r\nendfacet\r\n";
            }
        }
        text += &format!("ENDSOLID {name}\r\n");
    }
    folder.put("bar.stl", &text);
    let job = r#"{"steps": [{"edit": {"decimate": {"ratio": 0.5}}}]}"#;
    folder.put("job.json", job);
    folder.done("deform bar.stl --job job.json -o thin.stl");
    let thin = fs::read_to_string(folder.path().join("thin.stl")).expect("a text");
    let (lower, upper) = thin
        .split_once("endsolid Lower Half\r\nsolid upper half\r\n")
        .expect("both solids");
    assert!(lower.starts_with("solid Lower Half\r\n") && upper.ends_with("endsolid upper half\r\n"));
    let facets = |text: &str| text.matches("facet normal").count();
    assert_eq!(2 * facets(&thin), facets(&text));
    let below = |line: &str| {
        line.split(' ')
            .nth(8)
            .is_some_and(|y| y.parse::<f64>().is_ok_and(|y| y <= 2.0))
    };
    let vertices =
        |solid: &'_ str| -> Vec<bool> { solid.lines().filter(|l| l.contains("vertex")).map(below).collect() };
    assert!(facets(lower) > 4 && vertices(lower).iter().all(|below| *below));
    assert!(facets(upper) > 4 && vertices(upper).iter().any(|below| !below));
}
