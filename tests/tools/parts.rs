//! Models of several parts on the command line: what is told of ties, and what options make of them.

use crate::program::Workplace;
use glam::DVec3;
use pliant::asset::shapes::box_with_cells;
use serde_json::{Value, json};

/// Two slabs on top of each other, a hair apart, and a box far from them.
fn workplace() -> Workplace {
    let (mut text, mut first) = (String::new(), 1);
    for (size, place) in [
        (DVec3::new(1.0, 0.5, 1.0), DVec3::ZERO),
        (DVec3::new(1.0, 0.5, 1.0), DVec3::new(0.0, 0.5001, 0.0)),
        (DVec3::splat(0.3), DVec3::new(2.0, 0.0, 0.0)),
    ] {
        let (points, faces) = box_with_cells(size, [4; 3]);
        for p in points.iter().map(|p| *p + place) {
            text += &format!("v {} {} {}\n", p.x, p.y, p.z);
        }
        for t in &faces {
            text += &format!("f {} {} {}\n", t[0] + first, t[1] + first, t[2] + first);
        }
        first += points.len() as u32;
    }
    Workplace::with("parts.obj", text)
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
fn inspection_tells_parts_ties_and_what_is_loose() {
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
    for (create, told) in [
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
        assert!(error.contains(told), "{error}");
    }
}

#[test]
fn a_pose_that_pulls_tied_parts_apart_is_told_in_the_report() {
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
