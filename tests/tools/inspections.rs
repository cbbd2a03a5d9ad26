//! What an inspection tells of a model and of the files that it names.

use crate::program::Workplace;
use pliant::asset::sample;

/// A square of two triangles as an OBJ that names a library.
pub const SQUARE: &str = "mtllib square.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl a\nf 1 2 3\nf 1 3 4\n";

#[test]
fn files_that_an_obj_names_and_that_are_not_there_are_warned_of() {
    let folder = Workplace::new();
    let inspect = || {
        let text = folder.done("inspect square.obj").out;
        text
    };
    folder.put("square.obj", SQUARE);
    let text = inspect();
    assert!(
        text.contains("warning library-missing") && text.contains("square.mtl"),
        "{text}"
    );
    folder.put("square.mtl", "newmtl a\nmap_Kd rust.png\nbump bumps.png\n");
    folder.put("bumps.png", "any");
    let text = inspect();
    assert!(!text.contains("library-missing"), "{text}");
    let warning = text.lines().find(|line| line.starts_with("warning image-missing"));
    let warning = warning.unwrap_or_else(|| panic!("{text}"));
    assert!(
        warning.contains("rust.png") && !warning.contains("bumps.png"),
        "{warning}"
    );
    let job = r#"{"handles": [{"id": "a", "region": {"component": {}}, "pose": {"translation": [1, 0, 0]}}]}"#;
    folder.put("job.json", job);
    let ran = folder.done("deform square.obj --job job.json -o out.obj");
    let said = &ran.err;
    assert!(
        said.contains("warning image-missing: ") && said.contains("rust.png"),
        "{said}"
    );
    folder.put("rust.png", "any");
    assert!(!inspect().contains("missing"));
}

#[test]
fn an_inspection_lists_clips_skins_materials_and_pictures() {
    let folder = Workplace::new();
    folder.put("figure.glb", sample::figure_glb());
    let text = folder.done("inspect figure.glb").out;
    let line = |name: &str| {
        let line = text.lines().find(|line| line.starts_with(name));
        line.unwrap_or_else(|| panic!("{name}: {text}")).to_owned()
    };
    assert!(
        line("clips ").contains("2: \"walk\" (") && line("clips ").ends_with(" s)"),
        "{text}"
    );
    assert!(line("skins ").contains(" joints)"), "{text}");
    line("materials ");
    assert!(line("images ").ends_with('0'), "{text}");
    let found = folder.done("inspect figure.glb --json").json();
    assert_eq!(found["clips"][0]["name"], "walk");
    assert!(
        found["clips"][1]["seconds"].as_f64().is_some_and(|s| s > 0.1),
        "{found}"
    );
    assert!(found["skins"][0]["joints"].as_u64().is_some_and(|n| n > 10), "{found}");
    assert!(
        found["materials"].is_array() && found["images"] == serde_json::json!([]),
        "{found}"
    );
    // A picture is called by its file where it has no name.
    let mut gltf = serde_json::json!({
        "asset": {"version": "2.0"}, "images": [{"uri": "rust.png"}, {"name": "moss", "uri": "m.png"}],
        "materials": [{"name": "old"}], "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"uri": "a.bin", "byteLength": 36}],
    });
    gltf["asset"]["generator"] = "test".into();
    folder.put("a.gltf", gltf.to_string());
    let corners = [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let bytes: Vec<u8> = corners.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    folder.put("a.bin", bytes);
    let text = folder.done("inspect a.gltf").out;
    assert!(
        text.contains("2: \"rust.png\", \"moss\"\n") && text.contains("1: \"old\"\n"),
        "{text}"
    );
}

#[test]
fn one_of_a_thing_is_told_as_one() {
    let folder = Workplace::new();
    folder.put("square.obj", SQUARE.replace("mtllib square.mtl\n", ""));
    let text = folder.done("inspect square.obj").out;
    assert!(text.contains("4 in 1 primitive\n"), "{text}");
    assert!(text.contains("1 hole, "), "{text}");
}
