//! What a program reads on stdout when a command fails: with `--json` one document that says why, else nothing.

use crate::program::Workplace;
use pliant::asset::{FileSet, Format, Limits, Model};

#[test]
fn a_command_that_fails_says_why_in_the_document_that_was_asked_for() {
    let folder = Workplace::new();
    folder.put("job.json", r#"{"handels": []}"#);
    let cases: [(&str, &str); 6] = [
        ("deform creature.glb --job job.json -o out.glb", "handels"),
        ("deform creature.glb --job none.json -o out.glb", "none.json"),
        ("deform creature.glb", "--job"),
        ("inspect none.glb", "none.glb"),
        ("rig creature.glb --preset cmu -o rig.txt", "rig.txt"),
        ("store list --data-dir none", "no store of sessions"),
    ];
    for (arguments, word) in cases {
        let plain = folder.refused(arguments, &[word]);
        assert_eq!(plain.out, "", "{arguments:?}");
        let ran = folder.run(&format!("{arguments} --json"));
        assert_eq!((ran.code, ran.last()), (Some(2), plain.last()), "{arguments:?}");
        let (document, out, last) = (ran.json(), &ran.out, ran.last());
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
    let folder = Workplace::new();
    let job = r#"{"expect": {"digest": "xxh3:0000000000000000"}}"#;
    folder.put("job.json", job);
    let arguments = "deform creature.glb --job job.json -o out.glb --json";
    let report = folder.run(arguments).exits(1).json();
    assert!(
        report["digest"].is_string() && report.get("error").is_none(),
        "{report}"
    );
}

#[test]
fn a_figure_that_was_made_for_other_axes_is_told_its_turn() {
    let folder = Workplace::empty();
    folder.done("sample body -o body.glb");
    let bytes = folder.bytes("body.glb");
    let model = Model::read(FileSet::single("body.glb", bytes), None, &Limits::default()).expect("readable");
    let rig = |name: &str, turned: fn([f64; 3]) -> [f64; 3]| {
        let places: Vec<_> = model.positions.iter().map(|p| turned(p.to_array()).into()).collect();
        let written = model.write(&places, Format::STL).expect("writable");
        folder.put(name, written.main);
        folder.run(&format!("rig {name} -o rig.json --no-picture --force"))
    };
    rig("upright.stl", |p| p).exits(0);
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
        rig(name, turned).exits(2).gives(&[words]);
    }
    let ran = rig("ball.stl", |[x, y, z]| {
        let length = (x * x + y * y + z * z).sqrt().max(1e-6);
        [x / length, y / length, z / length]
    });
    assert!(ran.code == Some(2) && !ran.last().contains("a turn by"), "{}", ran.err);
}
