//! What a program reads on stdout when a command fails: with `--json` one document that says why, else nothing.

use crate::program::{pliant, workplace};
use pliant::asset::{FileSet, Format, Limits, Model};
use serde_json::Value;
use std::fs;

#[test]
fn a_command_that_fails_says_why_in_the_document_that_was_asked_for() {
    let folder = workplace();
    fs::write(folder.path().join("job.json"), r#"{"handels": []}"#).expect("written");
    let cases: [(&[&str], &str); 6] = [
        (
            &["deform", "creature.glb", "--job", "job.json", "-o", "out.glb"],
            "handels",
        ),
        (
            &["deform", "creature.glb", "--job", "none.json", "-o", "out.glb"],
            "none.json",
        ),
        (&["deform", "creature.glb"], "--job"),
        (&["inspect", "none.glb"], "none.glb"),
        (&["rig", "creature.glb", "--preset", "cmu", "-o", "rig.txt"], "rig.txt"),
        (&["store", "list", "--data-dir", "none"], "no store of sessions"),
    ];
    for (arguments, word) in cases {
        let plain = pliant(folder.path(), arguments);
        assert_eq!((plain.0, plain.1.as_str()), (Some(2), ""), "{arguments:?}: {}", plain.2);
        let (code, out, last) = pliant(folder.path(), &[arguments, &["--json"]].concat());
        assert_eq!((code, &last), (Some(2), &plain.2), "{arguments:?}");
        let document: Value = serde_json::from_str(&out).unwrap_or_else(|e| panic!("{arguments:?}: {e}: {out}"));
        let error = &document["error"];
        assert_eq!(
            (&error["kind"], &error["exitCode"]),
            (&"input".into(), &2.into()),
            "{out}"
        );
        let message = error["message"].as_str().expect("a text");
        assert!(message.contains(word) && last == format!("pliant: {message}"), "{out}");
    }
}

#[test]
fn a_check_that_does_not_hold_tells_its_report_and_nothing_more() {
    let folder = workplace();
    let job = r#"{"expect": {"digest": "xxh3:0000000000000000"}}"#;
    fs::write(folder.path().join("job.json"), job).expect("written");
    let arguments = ["deform", "creature.glb", "--job", "job.json", "-o", "out.glb", "--json"];
    let (code, out, last) = pliant(folder.path(), &arguments);
    assert_eq!(code, Some(1), "{last}");
    let report: Value = serde_json::from_str(&out).expect("one document");
    assert!(report["digest"].is_string() && report.get("error").is_none(), "{out}");
}

#[test]
fn a_figure_that_was_made_for_other_axes_is_told_its_turn() {
    let folder = tempfile::tempdir().expect("a folder");
    let (code, _, last) = pliant(folder.path(), &["sample", "body", "-o", "body.glb"]);
    assert_eq!(code, Some(0), "{last}");
    let bytes = fs::read(folder.path().join("body.glb")).expect("a model");
    let model = Model::read(FileSet::single("body.glb", bytes), None, &Limits::default()).expect("readable");
    let rig = |name: &str, turned: fn([f64; 3]) -> [f64; 3]| {
        let places: Vec<_> = model.positions.iter().map(|p| turned(p.to_array()).into()).collect();
        let written = model.write(&places, Format::STL).expect("writable");
        fs::write(folder.path().join(name), written.main).expect("written");
        pliant(
            folder.path(),
            &["rig", name, "-o", "rig.json", "--no-picture", "--force"],
        )
    };
    assert_eq!(rig("upright.stl", |p| p).0, Some(0));
    for (name, turned, words) in [
        (
            "aside.stl",
            (|[x, y, z]| [-z, y, x]) as fn([f64; 3]) -> [f64; 3],
            "a turn by 90 degrees about y corrects that",
        ),
        (
            "lying.stl",
            |[x, y, z]| [x, -z, y],
            "a turn by -90 degrees about x corrects that",
        ),
    ] {
        let (code, _, last) = rig(name, turned);
        assert!(code == Some(2) && last.contains(words), "{name}: {last}");
    }
    let (code, _, last) = rig("ball.stl", |[x, y, z]| {
        let length = (x * x + y * y + z * z).sqrt().max(1e-6);
        [x / length, y / length, z / length]
    });
    assert!(code == Some(2) && !last.contains("a turn by"), "{last}");
}
