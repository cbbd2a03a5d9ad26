//! What an inspection reports of a model and of the files that it names.

use crate::support::commands::Workplace;
use crate::support::shapes::{both, moved, obj_text};
use glam::DVec3;
use pliant::asset::sample;
use pliant::asset::shapes::box_with_cells;
use serde_json::{Value, json};

/// A square of two triangles as an OBJ that names a library.
pub const SQUARE: &str = "mtllib square.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl a\nf 1 2 3\nf 1 3 4\n";

#[test]
fn files_that_an_obj_names_and_that_are_not_there_are_warned_of() {
    let folder = Workplace::new();
    let inspect = || folder.done("inspect square.obj").out;
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
fn one_of_a_thing_is_reported_as_one() {
    let folder = Workplace::new();
    folder.put("square.obj", SQUARE.replace("mtllib square.mtl\n", ""));
    let text = folder.done("inspect square.obj").out;
    assert!(text.contains("4 in 1 primitive\n"), "{text}");
    assert!(text.contains("1 hole, "), "{text}");
}

/// Two slabs on top of each other, a hair apart, and a box far from them.
fn workplace() -> Workplace {
    let slab = || box_with_cells(DVec3::new(1.0, 0.5, 1.0), [4; 3]);
    let far = moved(box_with_cells(DVec3::splat(0.3), [4; 3]), |p| p + DVec3::X * 2.0);
    let slabs = both(slab(), moved(slab(), |p| p + DVec3::Y * 0.5001));
    Workplace::with("parts.obj", obj_text(&both(slabs, far)))
}

/// The report of a job that lifts the upper slab, opened with `create`; or what is said when it is refused.
fn lifted(folder: &Workplace, create: &Value) -> Result<Value, String> {
    let half = |normal: f64, offset: f64| json!({"halfSpace": {"normal": [0, normal, 0], "offset": offset}});
    let job = json!({
        "create": create,
        "handles": [
            {"id": "below", "region": half(-1.0, -0.4)},
            {"id": "above", "region": half(1.0, 0.9), "pose": {"translation": [0, 0.2, 0]}},
        ],
    });
    folder.put("job.json", job.to_string());
    let ran = folder.run("deform parts.obj --job job.json -o out.obj --json --force");
    match ran.code {
        Some(0) => Ok(ran.json()),
        _ => Err(ran.err),
    }
}

#[test]
fn inspection_reports_parts_ties_and_what_is_loose() {
    let folder = workplace();
    let text = folder.done("inspect parts.obj").out;
    let line = |name: &str| {
        let found = text
            .lines()
            .find(|l| l.starts_with(name))
            .unwrap_or_else(|| panic!("{name} in {text}"));
        found[22..].trim().to_owned()
    };
    assert_eq!(line("parts "), "3");
    assert_eq!(
        line("primitive 0"),
        "without a name: 294 vertices from 0, 576 triangles"
    );
    assert!(line("ties ").parse::<u32>().expect("a number") >= 25, "{text}");
    assert_eq!(line("loose parts "), "1: part 2 (98 vertices)");
    let found = folder.done("inspect parts.obj --json").json();
    let solver = &found["solver"];
    assert_eq!(
        (&solver["looseParts"], &solver["loose"][0]["component"]),
        (&json!(1), &json!(2))
    );
}

#[test]
fn options_tie_parts_or_leave_them_to_themselves() {
    let folder = workplace();
    let run = |create: Value| lifted(&folder, &create).expect("solved");
    let tied = run(json!({}));
    let ties = |report: &Value| {
        report["solver"]["ties"]
            .as_str()
            .map_or(0, |t| t.parse::<u32>().unwrap_or(0))
    };
    assert!(ties(&tied) > 0, "{}", tied["solver"]);
    let separate = run(json!({"parts": "SEPARATE"}));
    assert_eq!(ties(&separate), 0);
    assert_ne!(tied["digest"], separate["digest"]);
    let apart = run(json!({"keepApart": {"components": [1]}}));
    assert_eq!(apart["digest"], separate["digest"], "nothing else was tied");
    assert_eq!(
        run(json!({"tieDistance": 1e-6}))["digest"],
        separate["digest"],
        "nothing is that near"
    );
}

#[test]
fn options_that_do_not_fit_are_refused_with_their_place() {
    let folder = workplace();
    for (create, reply) in [
        (
            json!({"keepApart": {"components": [3]}}),
            "keepApart.components[0]: is 3, the model has 3 connected parts",
        ),
        (
            json!({"keepApart": {"primitives": [0, 9]}}),
            "keepApart.primitives[1]: is 9, the model has 1 primitive,",
        ),
        (
            json!({"tieDistance": -1}),
            "tieDistance: is -1, it must not be negative",
        ),
        (
            json!({"parts": "SEPARATE", "tieDistance": 1}),
            "tieDistance: is given, but parts SEPARATE have no ties",
        ),
    ] {
        let error = lifted(&folder, &create).expect_err("refused");
        assert!(error.contains(reply), "{error}");
    }
}

#[test]
fn a_pose_that_pulls_tied_parts_apart_is_reported_in_the_report() {
    let folder = workplace();
    let half = |normal: f64, offset: f64| json!({"halfSpace": {"normal": [0, normal, 0], "offset": offset}});
    let job = json!({"handles": [
        {"id": "below", "region": half(-1.0, -0.5)},
        {"id": "above", "region": half(1.0, 0.50005), "pose": {"translation": [0, 0.3, 0]}},
    ]});
    folder.put("pull.json", job.to_string());
    let report = folder.done("deform parts.obj --job pull.json -o out.obj --json").json();
    let warnings = report["warnings"].as_array().expect("warnings");
    let pulled = warnings
        .iter()
        .find(|w| w["code"] == "parts-pulled-apart")
        .expect("the warning");
    let message = pulled["message"].as_str().unwrap_or_default();
    assert!(
        ["\"below\"", "\"above\"", "0.300"]
            .iter()
            .all(|word| message.contains(word)),
        "{message}"
    );
}

#[test]
fn a_recording_is_described_by_its_frames_joints_and_size() {
    let folder = Workplace::empty();
    let clip = "HIERARCHY\nROOT hips\n{\n OFFSET 0 1 0\n CHANNELS 3 Xposition Yposition Zposition\n JOINT spine\n {\n  OFFSET 0 2 0\n  \
                CHANNELS 1 Yrotation\n  End Site\n  {\n   OFFSET 0 0.5 0\n  }\n }\n}\nMOTION\nFrames: 3\nFrame Time: 0.5\n\
                1 1 0 0\n2 1 0 9\n4 1 0 30\n";
    folder.put("clip.bvh", clip);
    let text = folder.done("inspect clip.bvh").out;
    for line in [
        "frames                3 at 2 a second\n",
        "seconds               1\n",
        "joints                3: hips, spine, spine.end\n",
        "size of rest pose     0 × 2.5 × 0\n",
        "root moves by         (3, 0, 0)\n",
    ] {
        assert!(text.contains(line), "{line:?} in {text}");
    }
    let facts = folder.done("inspect clip.bvh --json").json();
    let found = &facts["clip"];
    assert_eq!((&found["frames"], &found["frameSeconds"]), (&json!(3), &json!(0.5)));
    assert_eq!(found["joints"][1], json!({"name": "spine", "parent": 0}));
    folder.put("short.bvh", clip.replacen("Frames: 3", "Frames: 4", 1));
    folder.refused("inspect short.bvh", &["short.bvh: ", "4 frames are declared, 3 follow"]);
}
