//! Cleaning: small parts and hidden copies go by rule.

use super::edit_support::{cube, moved};
use crate::support::data::data_bytes;
use crate::support::shapes::{both, obj_text};
use glam::DVec3;
use pliant::asset::FileSet;
use pliant::batch::{self, BatchOutcome};
use pliant::engine::DeformerLimits;
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::{Error, json::from_json, pb};
use serde_json::{Value, json};

fn cleaned(files: FileSet, rules: &Value) -> Result<BatchOutcome, Error> {
    let job: pb::Job = from_json(json!({"steps": [{"edit": {"clean": rules}}]}).to_string().as_bytes()).expect("a job");
    let pool = Pool::new(2).expect("threads");
    batch::run(
        files,
        &job,
        None,
        &DeformerLimits::default(),
        &Exec::new(&pool, &Silent),
        &|| 0.0,
    )
}

/// Cubes of edge 1, 0.5 and 0.1 beside each other, and one on the first, turned inside out and a little beside it.
fn scene() -> FileSet {
    let of_size = |size: f64, x: f64| moved(cube(1), |p| p * size + DVec3::X * x);
    let (points, faces) = of_size(1.0, 1e-7);
    let copy = (points, faces.into_iter().map(|[a, b, c]| [a, c, b]).collect());
    let three = both(both(of_size(1.0, 0.0), of_size(0.5, 5.0)), of_size(0.1, 9.0));
    FileSet::single("scene.obj", obj_text(&both(three, copy)))
}

#[test]
fn each_rule_takes_what_it_names() {
    let one = cube(1).1.len();
    for (rules, left) in [
        (json!({"duplicatesWithin": 1e-6}), 3),
        (json!({"smallestShare": 0.2}), 3),
        (json!({"smallestShare": 0.3, "duplicatesWithin": 1e-6}), 1),
        (json!({"keepLargest": 1}), 1),
        (json!({"keepLargest": 2, "duplicatesWithin": 1e-6}), 2),
        (json!({"keepLargest": 9}), 4),
    ] {
        let done = cleaned(scene(), &rules).unwrap_or_else(|e| panic!("{rules}: {e}"));
        assert_eq!(done.triangles.len(), left * one, "{rules}");
    }
    let size = cube(1)
        .0
        .iter()
        .fold(0.0, |most: f64, p| most.max(p.distance(cube(1).0[0])));
    let done = cleaned(scene(), &json!({"smallestSize": 0.3 * size})).expect("cleaned");
    assert_eq!(done.triangles.len(), 3 * one);
}

#[test]
fn rules_that_take_nothing_or_all_are_told() {
    let noticed = |rules: Value| -> Vec<String> {
        let report = cleaned(scene(), &rules).expect("cleaned").report;
        let edit = report.steps[0].edit.clone().expect("an edit");
        edit.warnings.into_iter().map(|w| w.code).collect()
    };
    assert_eq!(noticed(json!({"keepLargest": 4})), ["clean-nothing"]);
    for (rules, field) in [
        (json!({}), "steps[0].clean"),
        (json!({"smallestShare": 1.5}), "steps[0].clean.smallestShare"),
        (json!({"smallestSize": 1e9}), "steps[0].clean.smallestSize"),
        (json!({"duplicatesWithin": -1.0}), "steps[0].clean.duplicatesWithin"),
    ] {
        match cleaned(scene(), &rules) {
            Err(Error::Invalid { field: seen, .. }) => assert_eq!(seen, field),
            other => panic!("{rules}: {:?}", other.map(|done| done.triangles.len())),
        }
    }
}

#[test]
fn floaters_of_a_scan_go() {
    let Some(bytes) = data_bytes("field/scan_holes_floaters.ply") else {
        return;
    };
    let done = cleaned(FileSet::single("scan.ply", bytes), &json!({"keepLargest": 1})).expect("cleaned");
    assert_eq!(
        done.report.model.expect("facts").triangles as usize,
        done.triangles.len()
    );
    let again = cleaned(
        FileSet::single("scan.ply", done.written.main),
        &json!({"keepLargest": 1}),
    )
    .expect("cleaned");
    let edit = again.report.steps[0].edit.clone().expect("an edit");
    assert_eq!(edit.warnings[0].code, "clean-nothing", "one part is left");
}
